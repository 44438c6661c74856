"""The functions of Table 1, where they are and moved away from there."""

from __future__ import annotations

import numpy as np

from tmchho.benchmarks import BenchmarkProblem, benchmark_functions

FUNCTIONS = ("f1", "f2", "f3", "f4", "f5", "f6", "f7")
PLACES = ("origin", "shifted", "rotated")

# The minimum lies within this share of the range: in the box, and not on its rim.
_SHARE_OF_RANGE = 0.8


def problem(function: str, dimension: int, place: str, seed: int) -> BenchmarkProblem:
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
    BenchmarkProblem
    """
    if place == "origin":
        return BenchmarkProblem(function, dimension)
    half_range = {known.name: known.range for known in benchmark_functions()}[function]
    rng = np.random.default_rng([seed, dimension, FUNCTIONS.index(function)])
    return BenchmarkProblem(
        function,
        dimension,
        shift=rng.uniform(-1.0, 1.0, dimension) * _SHARE_OF_RANGE * half_range,
        rotation_seed=seed if place == "rotated" else None,
    )
