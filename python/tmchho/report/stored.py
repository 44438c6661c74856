"""What a command has left in its folder, as far as a report is made from it."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from tmchho.errors import ReadError


def read_document(path: Path, *, needed: Sequence[str], what: str, command: str) -> Mapping[str, Any]:
    """Return the content of the JSON file that a command leaves.

    Parameters
    ----------
    path : Path
        The file.
    needed : sequence of str
        Keys by which it is known to be that file.
    what : str
        What it is the result of, such as ``registration``.
    command : str
        Who writes it, such as ``tmchho register``.

    Raises
    ------
    ReadError
        If it is missing, damaged or of something else.
    """
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ReadError(
            f"{path}: cannot be read ({error.strerror}); give the folder that {command} wrote into"
        ) from error
    except ValueError as error:
        raise ReadError(f"{path}: is not JSON ({error}); run {command} once more") from error
    if not isinstance(document, dict) or any(key not in document for key in needed):
        raise ReadError(f"{path}: is not the result of a {what}; give a folder of {command}")
    return document


def day_of(path: Path) -> str:
    """Return the day on which a file was written, as people write it."""
    written = datetime.fromtimestamp(path.stat().st_mtime, tz=timezone.utc)
    return f"{written.day} {written:%B %Y}"
