"""Checks of arguments that are neither clouds nor configuration keys.

Why here and not in Rust: a wrong type never reaches Rust, and a caller of Python wants the name of the
argument that he wrote. Ranges that belong to an algorithm are checked there, once.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tmchho.errors import InvalidArgumentError

_MAX_SEED = 2**64 - 1
_NO_LIMIT = 2**53  # whole numbers beyond it do not survive a float


def checked_count(name: str, value: Any, least: int = 0, most: int = _NO_LIMIT) -> int:
    """Return a whole number within [least, most], or raise `InvalidArgumentError` naming the argument."""
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, (int, np.integer)):
        raise InvalidArgumentError(f"{name} must be a whole number, got {value!r}")
    if not least <= value <= most:
        limits = f"at least {least}" if most == _NO_LIMIT and value < least else f"between {least} and {most}"
        raise InvalidArgumentError(f"{name} must be {limits}, got {value}")
    return int(value)


def checked_number(name: str, value: Any, low: float = -math.inf, high: float = math.inf) -> float:
    """Return a finite number within [low, high], or raise `InvalidArgumentError` naming the argument."""
    wrong_kind = isinstance(value, (bool, np.bool_)) or not isinstance(
        value, (int, float, np.integer, np.floating)
    )
    if wrong_kind or not math.isfinite(value):
        raise InvalidArgumentError(f"{name} must be a finite number, got {value!r}")
    if not low <= value <= high:
        limits = f"at least {low:g}" if math.isinf(high) else f"between {low:g} and {high:g}"
        raise InvalidArgumentError(f"{name} must be {limits}, got {value!r}")
    return float(value)


def checked_seed(value: Any) -> int:
    """Return a seed of 64 bits, or raise `InvalidArgumentError`."""
    return checked_count("seed", value, 0, _MAX_SEED)


def checked_choice(name: str, value: Any, choices: Sequence[str]) -> str:
    """Return one of the words in `choices`, or raise `InvalidArgumentError` naming the argument."""
    if not isinstance(value, str) or value not in choices:
        listed = " or ".join(f"'{choice}'" for choice in choices)
        raise InvalidArgumentError(f"{name} must be {listed}, got {value!r}")
    return value


def checked_callable(name: str, value: Any) -> None:
    """Raise `InvalidArgumentError` naming the argument unless it is None or can be called."""
    if value is not None and not callable(value):
        raise InvalidArgumentError(f"{name} must be callable, got {type(value).__name__}")


def checked_array(name: str, value: Any, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Return a C-contiguous float64 array of the shape; -1 stands for any length.

    Raises
    ------
    InvalidArgumentError
        Naming the argument, for another shape or what is not a real number. NaN and infinity pass.
    """
    try:
        array = np.asarray(value)
        if array.dtype.kind not in "iufO":
            raise TypeError(f"dtype {array.dtype}")
        array = np.asarray(array, dtype=np.float64, order="C")
    except (TypeError, ValueError) as error:
        raise InvalidArgumentError(f"{name} must hold real numbers ({error})") from error
    fits = array.ndim == len(shape) and all(
        wanted in (-1, given) for wanted, given in zip(shape, array.shape, strict=True)
    )
    if not fits:
        wanted = "(" + ", ".join("n" if n == -1 else str(n) for n in shape) + ("," * (len(shape) == 1)) + ")"
        raise InvalidArgumentError(f"{name} must have shape {wanted}, got {array.shape}")
    return array
