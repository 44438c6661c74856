"""Argument checks and named random streams of the simulation."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any
from zlib import crc32

import numpy as np

from tmchho.arguments import checked_count, checked_number
from tmchho.errors import InvalidArgumentError


def stream(seed: int, name: str, *cell: int) -> np.random.Generator:
    """Return the random generator of one named purpose (and, if given, of one cell of the map).

    Every purpose draws from its own stream, so that changing one argument leaves all the others'
    random numbers as they were.
    """
    # Cell numbers may be negative, the words of a seed may not.
    words = [value & 0xFFFFFFFF for value in cell]
    return np.random.default_rng([seed, crc32(name.encode()), *words])


def checked_n_points(name: str, value: Any) -> int:
    """Return a number of points that a survey can have."""
    return checked_count(name, value, 1, 50_000_000)


def checked_noise(name: str, value: Any) -> float:
    """Return a standard deviation in metres that a sensor can have."""
    return checked_number(name, value, 0.0, 2.0)


def checked_outlier_share(name: str, value: Any) -> float:
    """Return a share of wrong points that a survey can have."""
    return checked_number(name, value, 0.0, 0.5)


def checked_offset(name: str, value: Any) -> tuple[float, float]:
    """Return two numbers within [-1, 1], or raise `InvalidArgumentError` naming the argument."""
    if not isinstance(value, (Sequence, np.ndarray)) or isinstance(value, str) or len(value) != 2:
        raise InvalidArgumentError(f"{name} must be two numbers (east, north), got {value!r}")
    east, north = value
    return checked_number(f"{name}[0]", east, -1.0, 1.0), checked_number(f"{name}[1]", north, -1.0, 1.0)
