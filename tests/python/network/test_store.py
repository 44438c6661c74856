"""Resume: whatever ends a run, the next one goes on from what was finished and ends with the same bytes."""

from __future__ import annotations

import json
import logging
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from network_units import file_made, file_read, squared

from tmchho.network.engine import InProcess, Item, Unit
from tmchho.network.store import Resumed, Store, input_reference, made_reference, unit_key

N_FILES = 8


class Counting(InProcess):
    """Remembers how many units it was asked for."""

    n_asked = 0

    def run(self, stage: str, unit: Unit, items: Any, *, finished: Any = None) -> list[Item]:
        self.n_asked += len(items)
        return super().run(stage, unit, items, finished=finished)


def make_and_read(engine: Any, folder: Path, seconds: float = 0.0) -> list[Item]:
    """Make files, and read each with the next: the shape of a network, without its arithmetic."""
    items = [{"value": value, "folder": str(folder), "seconds": seconds} for value in range(N_FILES)]
    made = [result["made"] for result in engine.run("prepare", file_made, items)]
    pairs = [{"first": first, "second": second, "seconds": seconds} for first, second in pairwise(made)]
    found: list[Item] = engine.run("pairs", file_read, pairs)
    return found


def stored_bytes(folder: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def test_a_second_run_does_nothing_and_gives_the_same(tmp_path: Path) -> None:
    plain = make_and_read(InProcess(2), tmp_path / "plain")
    first, second = Counting(2), Counting(1)
    store = Store(tmp_path / "work")
    assert make_and_read(Resumed(first, store), tmp_path / "files") == plain
    assert make_and_read(Resumed(second, store), tmp_path / "files") == plain
    assert (first.n_asked, second.n_asked) == (2 * N_FILES - 1, 0)


def test_results_of_the_store_are_reported_like_new_ones(tmp_path: Path) -> None:
    store = Store(tmp_path)
    items = [{"value": value} for value in range(5)]
    Resumed(InProcess(1), store).run("squaring", squared, items[1:3])
    seen: dict[int, Item] = {}
    results = Resumed(InProcess(2), store).run("squaring", squared, items, finished=seen.__setitem__)
    assert [seen[place] for place in range(5)] == results
    assert [result["square"] for result in results] == [0, 1, 4, 9, 16]


def test_the_key_depends_on_stage_function_item_and_version(monkeypatch: pytest.MonkeyPatch) -> None:
    item = {"value": 1.0, "settings": {"voxel": 0.1}}
    keys = {
        unit_key("squaring", squared, item),
        unit_key("cubing", squared, item),
        unit_key("squaring", file_read, item),
        unit_key("squaring", squared, {**item, "value": 1.0 + 2**-52}),
        unit_key("squaring", squared, {**item, "settings": {"voxel": 0.2}}),
    }
    monkeypatch.setattr("tmchho.network.store.__version__", "0.0.0")
    keys.add(unit_key("squaring", squared, item))
    assert len(keys) == 6
    # The order of the keys of a dict means nothing.
    turned = {"settings": {"voxel": 0.1}, "value": 1.0}
    assert unit_key("squaring", squared, item) == unit_key("squaring", squared, turned)


def test_a_result_keeps_the_order_of_its_keys(tmp_path: Path) -> None:
    fresh = Resumed(InProcess(1), Store(tmp_path)).run("squaring", squared, [{"value": 2}])
    stored = Resumed(InProcess(1), Store(tmp_path)).run("squaring", squared, [{"value": 2}])
    assert list(stored[0]) == list(fresh[0]) == ["square", "as_tuple"]


def test_a_file_that_was_made_counts_by_its_content_alone(tmp_path: Path) -> None:
    here, there = tmp_path / "here.bin", tmp_path / "there.bin"
    here.write_bytes(b"points")
    there.write_bytes(b"points")
    keys = [unit_key("reading", squared, {"cloud": made_reference(path)}) for path in (here, there)]
    assert keys[0] == keys[1]
    there.write_bytes(b"others")
    assert unit_key("reading", squared, {"cloud": made_reference(there)}) != keys[0]


def test_a_file_that_was_brought_counts_by_place_size_and_time(tmp_path: Path) -> None:
    path, twin = tmp_path / "scan.laz", tmp_path / "twin.laz"
    path.write_bytes(b"points")
    shutil.copy2(path, twin)
    before = input_reference(path)
    assert before == input_reference(path)
    assert before != input_reference(twin)
    os.utime(path, ns=(0, 0))
    assert input_reference(path) != before


@pytest.mark.parametrize(
    "damage",
    [
        lambda text: "",
        lambda text: text[:20],
        lambda text: "\udcff",
        lambda text: "[1, 2]",
        lambda text: text.replace("36", "37"),
        lambda text: json.dumps({"result": {"square": 36}}),
    ],
)
def test_a_damaged_entry_is_said_and_computed_anew(
    tmp_path: Path, damage: Any, caplog: pytest.LogCaptureFixture
) -> None:
    store, items = Store(tmp_path), [{"value": 6}, {"value": 7}]
    expected = Resumed(InProcess(1), store).run("squaring", squared, items)
    before = stored_bytes(tmp_path)
    key = unit_key("squaring", squared, items[0])
    entry = tmp_path / "squaring" / key[:2] / f"{key}.json"
    text = damage(entry.read_text(encoding="utf-8"))
    entry.write_bytes(text.encode("utf-8", "surrogateescape"))
    engine = Counting(1)
    with caplog.at_level(logging.WARNING, "tmchho"):
        assert Resumed(engine, store).run("squaring", squared, items) == expected
    assert engine.n_asked == 1
    assert f"{key}.json" in caplog.text
    assert "computed anew" in caplog.text
    assert stored_bytes(tmp_path) == before


@pytest.mark.parametrize("loss", [Path.unlink, lambda path: path.write_bytes(b"x")], ids=["gone", "changed"])
def test_a_file_that_is_lost_is_made_again(
    tmp_path: Path, loss: Any, caplog: pytest.LogCaptureFixture
) -> None:
    store, engine = Store(tmp_path / "work"), Counting(1)
    expected = make_and_read(Resumed(InProcess(2), store), tmp_path / "files")
    loss(tmp_path / "files" / "made-3.bin")
    with caplog.at_level(logging.WARNING, "tmchho"):
        assert make_and_read(Resumed(engine, store), tmp_path / "files") == expected
    # The file is the same again, so that what was made of it still holds.
    assert engine.n_asked == 1
    assert "made-3.bin" in caplog.text


def test_killed_at_random_moments_it_ends_with_the_same_bytes(tmp_path: Path) -> None:
    seconds = 0.05
    whole, killed = tmp_path / "whole", tmp_path / "killed"
    _process(whole, seconds).wait(timeout=60)
    generator = random.Random(20261122)
    n_killed = 0
    for _ in range(100):
        process = _process(killed, seconds)
        # From the first entry on, or the time would go into starting Python.
        n_entries = len(list(killed.rglob("*.json")))
        while process.poll() is None and len(list(killed.rglob("*.json"))) == n_entries:
            time.sleep(0.002)
        time.sleep(generator.uniform(0.0, 5 * seconds))
        if process.poll() is not None:
            break
        process.send_signal(signal.SIGKILL)
        process.wait(timeout=60)
        n_killed += 1
    assert process.returncode == 0
    assert n_killed >= 2
    assert (killed / "result.txt").read_bytes() == (whole / "result.txt").read_bytes()
    Store(killed / "work").tidy()
    assert [path.name for path in killed.rglob("*.tmp-*")] == []
    # Each run has files of its own, whose place is not part of the pairs' keys but is of the files'.
    assert stored_bytes(killed / "work" / "pairs") == stored_bytes(whole / "work" / "pairs")


def _process(folder: Path, seconds: float) -> subprocess.Popen[bytes]:
    script = (
        "import sys\n"
        "from pathlib import Path\n"
        "from test_store import make_and_read\n"
        "from tmchho.io import atomic_path\n"
        "from tmchho.network.engine import InProcess\n"
        "from tmchho.network.store import Resumed, Store\n"
        "folder, seconds = Path(sys.argv[1]), float(sys.argv[2])\n"
        "found = make_and_read(Resumed(InProcess(2), Store(folder / 'work')), folder / 'files', seconds)\n"
        "with atomic_path(folder / 'result.txt', overwrite=True) as path:\n"
        "    path.write_text(repr(found))\n"
    )
    return subprocess.Popen(
        [sys.executable, "-c", script, str(folder), str(seconds)], cwd=Path(__file__).parent
    )
