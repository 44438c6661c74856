"""Inputs that no other program may touch while they are read: one that is still being copied, say."""

from __future__ import annotations

import os
from collections.abc import Iterable

from tmchho.errors import ReadError

StrPath = str | os.PathLike[str]


class Unchanged:
    """Remembers files as they are now.

    Parameters
    ----------
    paths : iterable of path
        The files; one that is missing is whoever reads it to complain of.
    """

    def __init__(self, paths: Iterable[StrPath]) -> None:
        self._states = {path: _state(path) for path in paths}

    def check(self) -> None:
        """Raise `ReadError` if one of them is another file now, or has another size or time."""
        for path, before in self._states.items():
            if before is not None and _state(path) != before:
                raise ReadError(
                    f"{path}: changed while it was read, so that the results would belong to no file; run "
                    "again when no other program writes into it"
                )


def _state(path: StrPath) -> tuple[int, ...] | None:
    try:
        found = os.stat(path)
    except OSError:
        return None
    return found.st_dev, found.st_ino, found.st_size, found.st_mtime_ns
