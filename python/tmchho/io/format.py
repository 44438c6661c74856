"""What the registry knows about one family of files."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tmchho.cloud import PointCloud
from tmchho.io.window import Window

Reader = Callable[[Path], PointCloud]
PartReader = Callable[[Path, Window], PointCloud]
Writer = Callable[[PointCloud, Path, Mapping[str, Any]], None]

# What a person should hear although nothing is wrong: columns that were guessed, points that were left out.
# Between INFO and WARNING, so that the command line can show these and not the rest.
NOTE = 25
logging.addLevelName(NOTE, "NOTE")


@dataclass(frozen=True)
class Format:
    """One family of files: how it is called, recognised, read and written.

    Readers and writers raise ``ReadError`` and ``WriteError`` with the bare reason; the registry puts the
    name of the file in front, so that no message lacks it.

    Parameters
    ----------
    name : str
        How messages call the family.
    extensions : tuple of str
        Lower case, with the dot.
    recognises : callable
        Whether the first 4 KiB of a file are those of this family.
    read : callable
        Reads an existing, not empty file.
    write : callable, optional
        Writes a cloud to a path; the mapping is the metadata of the cloud whose layout is to be kept.
        None if the family can only be read.
    read_part : callable, optional
        Reads the points of a window; None if the whole file has to be read for that.
    """

    name: str
    extensions: tuple[str, ...]
    recognises: Callable[[bytes], bool]
    read: Reader
    write: Writer | None
    read_part: PartReader | None = None


def starts_with(*marks: bytes) -> Callable[[bytes], bool]:
    """Return a `Format.recognises` for families whose files begin with one of `marks`."""
    return lambda head: head.startswith(marks)
