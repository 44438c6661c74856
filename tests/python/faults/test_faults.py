"""Faults put in on purpose: nothing is lost, no half file appears, no input is touched."""

from __future__ import annotations

import os
import random
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from faults import Faults, changes, full_disks, interrupts, kills, little_memory, two_at_once
from faults import read_only as read_only_folders

import tmchho
from tmchho import room
from tmchho.cli import main
from tmchho.errors import BudgetError, ReadError, WriteError
from tmchho.io.atomic import own_mark, sweep
from tmchho.outputs import write_together


def test_killed_runs_leave_no_half_of_a_result(faults: Faults) -> None:
    assert "4 kills" in kills(faults, 4, random.Random(1))


def test_interrupts_leave_nothing(faults: Faults) -> None:
    assert "3 interrupts" in interrupts(faults, 3, random.Random(2), within_s=None)


def test_inputs_that_change_are_noticed(faults: Faults) -> None:
    assert "4 inputs changed" in changes(faults, 4, random.Random(3))


def test_a_full_disk_is_said_and_leaves_nothing(faults: Faults) -> None:
    assert "exit 5" in full_disks(faults)


def test_a_read_only_folder_is_refused(faults: Faults) -> None:
    assert "exit 5, nothing left" in read_only_folders(faults)


def test_little_memory_is_refused_with_a_figure(faults: Faults) -> None:
    assert "exit codes" in little_memory(faults)


def test_two_runs_into_one_folder_leave_one_result(faults: Faults) -> None:
    assert "one whole result" in two_at_once(faults, 1)


def test_memory_that_is_not_there_is_named_before_it_is_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(room, "room_left", lambda: 61_000_000)
    cloud = np.random.default_rng(0).uniform(0, 9, (3000, 3))
    for call in (tmchho.register, tmchho.evaluate, tmchho.m3c2):
        with pytest.raises(BudgetError, match=r"6,000 points need about 62 MB .* only 61 MB more"):
            call(cloud, cloud)
    with pytest.raises(BudgetError, match="takes about 600 MB"):
        room.check_room_for_parts()


def changing(path: Path, when: str) -> Callable[..., Any]:
    """Return a `tmchho.read` after which somebody else writes into the file."""
    read = tmchho.read

    def read_then_change(given: Any, **options: Any) -> tmchho.PointCloud:
        cloud = read(given, **options)
        if Path(given) == path:
            data = path.read_bytes()
            if when == "truncated":
                os.truncate(path, len(data) // 2)
            else:
                path.write_bytes(data[:-1] + bytes([data[-1] ^ 1]))
                os.utime(path, (time.time() + 5, time.time() + 5))
        return cloud

    return read_then_change


@pytest.mark.parametrize("when", ["truncated", "rewritten"])
@pytest.mark.parametrize("command", ["register", "evaluate"])
def test_a_file_that_changes_meanwhile_is_noticed(
    faults: Faults, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, when: str, command: str
) -> None:
    paths = [tmp_path / path.name for path in faults.inputs]
    for path, original in zip(paths, faults.inputs, strict=True):
        path.write_bytes(original.read_bytes())
    monkeypatch.setattr(tmchho, "read", changing(paths[0], when))
    result = CliRunner().invoke(main, [command, *map(str, paths), "-o", str(tmp_path / "out")])
    assert result.exit_code == 3, result.output
    assert "changed while it was read" in result.stderr
    assert str(paths[0]) in result.stderr
    assert not (tmp_path / "out").exists()


def test_a_clock_that_jumps_changes_nothing(
    faults: Faults, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ticks = iter(range(10_000))
    monkeypatch.setattr(time, "time", lambda: 2e9 - 1e6 * next(ticks))
    words = ["register", *map(str, faults.inputs), "-o", str(tmp_path / "out"), "--no-report"]
    result = CliRunner().invoke(main, words)
    assert result.exit_code == 0, result.stderr
    assert faults.result(tmp_path / "out") == faults.wanted


def test_only_what_dead_processes_left_is_swept(tmp_path: Path) -> None:
    ended = os.fork()
    if ended == 0:
        os._exit(0)
    os.waitpid(ended, 0)
    mark = own_mark()
    dead = mark.rpartition("-")[0] + f"-{ended}"
    left = [f".fused.{dead}-00000000.laz", f".{dead}-abcd", f".probe-{dead}-00000000"]
    kept = [f".fused.{mark}-00000000.laz", "fused.laz", ".tmchho-00000000-1-other", "notes-tmchho-1-.txt"]
    (tmp_path / left[1]).mkdir()
    (tmp_path / left[1] / "points").write_bytes(b"1")
    for name in (left[0], left[2], *kept):
        (tmp_path / name).write_bytes(b"1")
    sweep(tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(kept)


def test_what_appeared_meanwhile_is_not_mixed_with_ours(tmp_path: Path) -> None:
    def late(path: Path) -> None:
        path.write_text("ours")
        (tmp_path / "result.json").write_text("theirs")

    with pytest.raises(WriteError, match="exists already"):
        write_together(tmp_path, {"result.json": late, "fused.laz": lambda path: path.write_text("ours")})
    assert [path.name for path in tmp_path.iterdir()] == ["result.json"]
    assert (tmp_path / "result.json").read_text() == "theirs"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_among_the_names_finds_all_or_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: signal.Signals
) -> None:
    def interrupt(_number: int, _frame: object) -> None:
        raise KeyboardInterrupt

    before, replace = signal.signal(number, interrupt), os.replace

    def interrupted(source: Path, target: Path) -> None:
        replace(source, target)
        signal.raise_signal(number)

    monkeypatch.setattr(os, "replace", interrupted)
    try:
        with pytest.raises(KeyboardInterrupt):
            write_together(tmp_path, {name: lambda path: path.write_text("1") for name in ("a", "b", "c")})
        assert signal.getsignal(number) is interrupt
    finally:
        signal.signal(number, before)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a", "b", "c"]


@pytest.fixture
def read_only(tmp_path: Path) -> Iterator[Path]:
    if os.geteuid() == 0:
        pytest.skip("root may write everywhere")
    folder = tmp_path / "read_only"
    folder.mkdir(mode=0o500)
    yield folder
    folder.chmod(0o700)


def test_a_read_only_folder_is_refused_before_anything_is_read(faults: Faults, read_only: Path) -> None:
    result = CliRunner().invoke(main, ["register", "missing", "missing", "-o", str(read_only)])
    assert result.exit_code == 5
    assert "no file can be written" in result.stderr


@pytest.mark.parametrize("kind", ["fifo", "device", "folder", "text"])
def test_what_is_no_file_of_points_is_named_at_once(faults: Faults, tmp_path: Path, kind: str) -> None:
    path = tmp_path / "given"
    if kind == "fifo":
        os.mkfifo(path)
    elif kind == "device":
        path = Path("/dev/zero")
    elif kind == "folder":
        path.mkdir()
    else:
        path.write_text("this is a letter, not a cloud\n")
    with pytest.raises(ReadError, match=str(path)):
        tmchho.read(path)
