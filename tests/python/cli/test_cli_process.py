"""The command as a process: exit codes, the two streams, interrupts, terminals."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from cli_tools import names_in

import tmchho
from tmchho.outputs import OUTPUTS, REPORT

PACKAGE = Path(tmchho.__file__).resolve().parents[1]
# Long enough for a slow machine; nothing here depends on speed.
PATIENCE_S = 120


def command(*arguments: object) -> list[str]:
    return [sys.executable, "-m", "tmchho", *map(str, arguments)]


def environment(**more: str) -> dict[str, str]:
    paths = [str(PACKAGE), *filter(None, [os.environ.get("PYTHONPATH")])]
    return {**os.environ, "PYTHONPATH": os.pathsep.join(paths), **more}


def finish(*arguments: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        command(*arguments),
        capture_output=True,
        text=True,
        env=environment(),
        timeout=PATIENCE_S,
        check=False,
    )


@pytest.fixture
def started(files: tuple[Path, Path], tmp_path: Path) -> Iterator[subprocess.Popen[str]]:
    """Start a registration and wait until it searches."""
    process = subprocess.Popen(
        command("register", *files, "-o", tmp_path / "out"),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=environment(),
    )
    assert process.stderr is not None
    for line in process.stderr:
        if "searching" in line:
            break
    yield process
    process.kill()
    process.communicate()


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_ends_it_and_leaves_nothing(
    started: subprocess.Popen[str], tmp_path: Path, number: signal.Signals
) -> None:
    started.send_signal(number)
    stdout, stderr = started.communicate(timeout=PATIENCE_S)
    assert started.returncode == 130
    assert stdout == ""
    assert stderr.splitlines()[-1] == "tmchho: interrupted; no unfinished file is left"
    assert "Traceback" not in stderr
    assert names_in(tmp_path) == []


def test_the_result_goes_to_stdout_and_the_rest_to_stderr(files: tuple[Path, Path], tmp_path: Path) -> None:
    done = finish("register", *files, "-o", tmp_path / "out", "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["verdict"] == "accepted"
    assert "\x1b" not in done.stderr  # no colours and no moving line where nobody looks
    lines = done.stderr.splitlines()
    assert all(line.startswith("tmchho: ") for line in lines)
    assert any("searching for the pose" in line for line in lines)
    assert names_in(tmp_path / "out") == sorted([*OUTPUTS, REPORT])


@pytest.mark.parametrize(
    ("arguments", "exit_code", "word"),
    [
        (["register", "a.laz"], 2, "TARGET"),
        (["registre"], 2, "registre"),
        (["register", "missing-a.laz", "missing-b.laz", "-o", "out"], 3, "missing-a.laz"),
        (["evaluate", "missing-a.laz", "missing-b.laz"], 3, "missing-a.laz"),
        (["register", "a.laz", "b.laz", "-o", __file__], 5, "is a file"),
    ],
)
def test_exit_codes(arguments: list[str], exit_code: int, word: str) -> None:
    done = finish(*arguments)
    assert done.returncode == exit_code, done.stderr
    assert done.stdout == ""
    assert word in done.stderr.splitlines()[-1]


def test_nobody_listening_is_no_error() -> None:
    process = subprocess.Popen(
        command("config"), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment()
    )
    assert process.stdout is not None
    process.stdout.close()
    assert process.stderr is not None
    stderr = process.stderr.read()
    process.wait(timeout=PATIENCE_S)
    process.stderr.close()
    assert "Traceback" not in stderr
    assert "unexpected" not in stderr


@pytest.mark.skipif(os.name != "posix", reason="pseudo-terminals of POSIX")
def test_a_terminal_gets_a_moving_line(files: tuple[Path, Path], tmp_path: Path) -> None:
    import pty

    ours, theirs = pty.openpty()
    config = tmp_path / "long.toml"  # long enough for the line to be seen, and the best score in it
    never_enough = "[verdict]\naccept_share_times_ratio = 1e12\n"
    text = f"[coarse]\nrotations_per_round = {[2000] * 3}\nn_verified = 300\n{never_enough}"
    config.write_text(text)
    process = subprocess.Popen(
        command("register", *files, "-o", tmp_path / "out", "--config", config, "--json"),
        stdout=subprocess.PIPE,
        stderr=theirs,
        env=environment(TERM="xterm", NO_COLOR="1", COLUMNS="100"),
    )
    os.close(theirs)
    shown = b""
    while chunk := _read(ours):
        shown += chunk
    os.close(ours)
    assert process.stdout is not None
    assert json.loads(process.stdout.read())["verdict"] == "review"
    process.stdout.close()
    assert process.wait(timeout=PATIENCE_S) == 4
    text = shown.decode()
    assert "searching for the pose" in text
    assert "best" in text
    assert "\x1b[3" not in text  # NO_COLOR: the cursor moves, but nothing is coloured


def _read(terminal: int) -> bytes:
    try:
        return os.read(terminal, 65536)
    except OSError:  # how Linux says that the other side has closed
        return b""
