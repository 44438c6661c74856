"""Running `tmchho paper` within the test's own process, and reading what it leaves."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

from click.testing import CliRunner, Result

from tmchho.cli import main


def run_paper(*arguments: object) -> Result:
    """Run `tmchho paper`; it must end by an exit code, not by an exception."""
    result = CliRunner().invoke(main, ["paper", *map(str, arguments)])
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return result


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def runs_of(folder: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (folder / "runs.jsonl").read_text().splitlines()]


def files_of(folder: Path) -> dict[str, bytes]:
    """Return every result by name; not the runs, whose order is that of chance."""
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.name != "runs.jsonl"}
