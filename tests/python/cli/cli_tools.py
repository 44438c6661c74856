"""Running commands within the test's own process."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from click.testing import CliRunner, Result

from tmchho.cli import main

# The pairs of real clouds that `TMCHHO_DATA` holds.
REAL_PAIRS = (
    "forest_ALS_to_UAS",
    "strips_bcts1",
    "strips_amsterdam",
    "facade_2_to_1",
    "room_2_to_1",
    "hippo_1_to_2",
)


def run(*arguments: object) -> Result:
    """Run a command within this process; it must end by an exit code, not by an exception.

    No report is made, which has tests of its own and would take most of the time here.
    """
    words = [str(argument) for argument in arguments]
    if words[:1] in (["register"], ["demo"]) and "--help" not in words:
        words.append("--no-report")
    result = CliRunner().invoke(main, words)
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return result


def names_in(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def assert_refused(result: Result, exit_code: int, *words: str) -> None:
    assert result.exit_code == exit_code, result.output
    assert result.stdout == ""
    last = result.stderr.splitlines()[-1]
    assert "rror: " in last
    assert "Traceback" not in result.stderr
    for word in words:
        assert word in last


def write_points(path: Path, points: Any) -> Path:
    np.savetxt(path, np.asarray(points, dtype=float))
    return path
