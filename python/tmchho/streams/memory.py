"""How much memory there is, and what fits into it."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable

from tmchho.errors import InvalidArgumentError
from tmchho.io import is_las, open_las
from tmchho.room import machine_memory, room_left

_SHARE = 0.5  # of the machine's, where nothing is said
_LEAST = 200_000_000  # the interpreter, its libraries and one part of a file

# Measured: reading, registering, fusing and writing two clouds as wholes takes 350 to 600 bytes a point.
_BYTES_PER_POINT = 600
# Of the memory that is allowed, what goes to the two thinned clouds while the pose is sought, and what one
# of their points takes then.
_THINNED_SHARE = 0.3
_BYTES_PER_CENTROID = 250
_MOST_CENTROIDS = 4_000_000  # more make a pose slower, not better
_FEWEST_CENTROIDS = 20_000
# What a point of a tile takes: its record, its coordinates, its place in two trees.
_TILE_SHARE = 0.25
_BYTES_PER_TILE_POINT = 350
_MOST_TILE_POINTS = 3_000_000
_FEWEST_TILE_POINTS = 50_000


def parse_bytes(text: str) -> int:
    """Return a number of bytes from words such as ``2GB``, ``800 MB`` or ``1.5G``.

    Examples
    --------
    >>> parse_bytes("1.5 GB"), parse_bytes("800M")
    (1500000000, 800000000)

    Raises
    ------
    InvalidArgumentError
        If it is no amount of memory, or less than the 200 MB that the program itself takes.
    """
    found = re.fullmatch(r"\s*(\d+(?:\.\d*)?)\s*(?:([KMGT])(i?))?B?\s*", text, re.IGNORECASE)
    if found is None:
        raise InvalidArgumentError(f"memory must be an amount such as 2GB or 800MB, got {text!r}")
    unit = 1024 if found[3] else 1000
    n_bytes = int(float(found[1]) * unit ** (1 + "KMGT".index(found[2].upper()) if found[2] else 0))
    if n_bytes < _LEAST:
        raise InvalidArgumentError(f"memory must be at least 200MB, got {text!r}")
    return n_bytes


def default_max_memory() -> int:
    """Return half of the memory of the machine, or of what this process is confined to."""
    room = room_left()
    limits = [machine_memory(), *([] if room is None else [room])]
    return max(_LEAST, int(_SHARE * min(limits)))


def needs_streams(paths: Iterable[str | os.PathLike[str]], max_memory: int) -> bool:
    """Return whether these files would take more memory as wholes than is allowed.

    Of files other than LAS and LAZ nothing can be told, and nothing done: they count as nothing.
    """
    n_points = sum(len(open_las(path)) for path in paths if is_las(path))
    return n_points * _BYTES_PER_POINT > max_memory


def n_centroids(max_memory: int) -> int:
    """Return how many centroids each of two thinned clouds may have."""
    fitting = int(_THINNED_SHARE * max_memory / _BYTES_PER_CENTROID / 2)
    return max(_FEWEST_CENTROIDS, min(_MOST_CENTROIDS, fitting))


def n_tile_points(max_memory: int) -> int:
    """Return how many points of both clouds one tile may have, its margin not counted."""
    fitting = int(_TILE_SHARE * max_memory / _BYTES_PER_TILE_POINT)
    return max(_FEWEST_TILE_POINTS, min(_MOST_TILE_POINTS, fitting))
