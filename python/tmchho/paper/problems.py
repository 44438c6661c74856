"""The functions of Table 1, where they are and moved away from there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tmchho.optimize import benchmark_functions, benchmark_value

FUNCTIONS = ("f1", "f2", "f3", "f4", "f5", "f6", "f7")
PLACES = ("origin", "shifted", "rotated")

# The minimum lies within this share of the range: in the box, and not on its rim.
_SHARE_OF_RANGE = 0.8


@dataclass(frozen=True, eq=False)
class Problem:
    """One function to be minimised within the paper's box.

    Parameters
    ----------
    function : str
        ``f1`` to ``f7``.
    half_range : float
        Each coordinate lies within ± this.
    minimum_at : (d,) float64 array
        Where the minimum is.
    rotation : (d, d) float64 array, optional
        Turns the function about its minimum.
    """

    function: str
    half_range: float
    minimum_at: NDArray[np.float64]
    rotation: NDArray[np.float64] | None

    @property
    def dimension(self) -> int:
        """Number of coordinates."""
        return len(self.minimum_at)

    def __call__(self, x: NDArray[np.float64]) -> float:
        """Return the value at `x`."""
        from_minimum = x - self.minimum_at
        return benchmark_value(
            self.function, from_minimum if self.rotation is None else self.rotation @ from_minimum
        )


def problem(function: str, dimension: int, place: str, seed: int) -> Problem:
    """Return a function of Table 1 at one of three places.

    Parameters
    ----------
    function : str
        ``f1`` to ``f7``.
    dimension : int
        Number of coordinates.
    place : {'origin', 'shifted', 'rotated'}
        As printed; with its minimum anywhere within 0.8 of the range; the same and turned at random.
    seed : int
        Of the shift and the rotation: all methods get the same ones in the same run.

    Returns
    -------
    Problem
    """
    half_range = {known.name: known.range for known in benchmark_functions()}[function]
    rng = np.random.default_rng([seed, dimension, FUNCTIONS.index(function)])
    minimum_at, rotation = np.zeros(dimension), None
    if place != "origin":
        minimum_at = rng.uniform(-1.0, 1.0, dimension) * _SHARE_OF_RANGE * half_range
    if place == "rotated":
        # Even over all rotations, because the signs of the triangle's diagonal are taken out (Stewart 1980).
        orthogonal, triangle = np.linalg.qr(rng.standard_normal((dimension, dimension)))
        rotation = orthogonal * np.sign(np.diag(triangle))
    return Problem(function, half_range, minimum_at, rotation)
