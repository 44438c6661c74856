"""Finished runs on disk, one line each, so that a killed experiment goes on where it was.

A line is written whole, after its run has ended. What a kill may leave is an unfinished last line, which is
dropped; the order of the lines is that of chance and means nothing.
"""

from __future__ import annotations

import json
import os
from pathlib import Path

from tmchho import __version__
from tmchho.errors import ReadError, WriteError
from tmchho.io.atomic import reason
from tmchho.paper.plan import Job, Result

RUNS = "runs.jsonl"


class RunStore:
    """The runs that are done, in a file that only grows.

    Parameters
    ----------
    folder : Path
        Where `runs.jsonl` is or will be.

    Raises
    ------
    ReadError
        If the file holds something else than runs.
    """

    def __init__(self, folder: Path) -> None:
        self._path = folder / RUNS
        self._results: dict[str, Result] = {}
        self._read()

    def get(self, job: Job) -> Result | None:
        """Return what came of a job, or None if it is still to be done."""
        return self._results.get(_key(job))

    def add(self, job: Job, result: Result, seconds: float) -> None:
        """Write down a finished job, and how long it took, which is for people only.

        Raises
        ------
        WriteError
            If the line cannot be written.
        """
        # What is remembered is what a later reading of the line will give.
        entry = {"version": __version__, "seconds": round(seconds, 3), "job": job, "result": result}
        line = json.dumps(entry)
        try:
            # In one write, so that a kill can only cut the last line short.
            with self._path.open("ab", buffering=0) as stream:
                stream.write(f"{line}\n".encode())
        except OSError as error:
            raise WriteError(f"{self._path}: cannot be written ({reason(error)}); check the disk") from error
        self._results[_key(job)] = json.loads(line)["result"]

    def _read(self) -> None:
        if not self._path.exists():
            return
        try:
            content = self._path.read_bytes()
            n_whole = content.rfind(b"\n") + 1
            if n_whole < len(content):
                os.truncate(self._path, n_whole)
        except OSError as error:
            raise ReadError(f"{self._path}: cannot be read ({reason(error)}); check the rights") from error
        for number, line in enumerate(content[:n_whole].splitlines(), start=1):
            try:
                entry = json.loads(line)
                # Another version may find something else.
                if entry["version"] == __version__:
                    self._results[_key(entry["job"])] = entry["result"]
            except (ValueError, KeyError, TypeError) as error:
                raise ReadError(
                    f"{self._path}: line {number} is not a finished run; move the file away to start anew"
                ) from error


def _key(job: Job) -> str:
    return json.dumps(job, sort_keys=True)
