"""What the registry knows about one family of files."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tmchho.cloud import PointCloud

Reader = Callable[[Path], PointCloud]
Writer = Callable[[PointCloud, Path, Mapping[str, Any]], None]


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
    first_bytes : tuple of bytes
        What gives a file of the family away; empty for plain text.
    mark_is_needed : bool
        Whether a file that begins with none of `first_bytes` cannot be of this family.
    read : callable
        Reads an existing, not empty file.
    write : callable, optional
        Writes a cloud to a path; the mapping is the metadata of the cloud whose layout is to be kept.
        None if the family can only be read.
    """

    name: str
    extensions: tuple[str, ...]
    first_bytes: tuple[bytes, ...]
    mark_is_needed: bool
    read: Reader
    write: Writer | None
