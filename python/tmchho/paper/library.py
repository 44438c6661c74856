"""Optimisers of other people, as they come: CMA-ES and differential evolution.

Sources: Hansen's `cma` (CMA-ES with restarts of growing population: Auger & Hansen 2005); scipy's
`differential_evolution` (Storn & Price 1997). Their settings are those of the libraries; only the population
of the latter is made as large as that of the swarms.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from contextlib import suppress
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tmchho.benchmarks import BenchmarkProblem
from tmchho.paper.extras import is_there

_LIBRARIES = {"cma_es": ("cma", "threadpoolctl"), "de": ("scipy",)}
# One search of `cma` at a time: it draws from numpy's global generator, so that two would mix their numbers.
_GLOBAL_GENERATOR = Lock()


def missing_libraries() -> dict[str, str]:
    """Return the methods that cannot run here, with a library that each of them lacks."""
    return {method: name for method, names in _LIBRARIES.items() for name in names if not is_there(name)}


def search_by_library(
    task: BenchmarkProblem, method: str, max_evaluations: int, seed: int
) -> tuple[float, int]:
    """Minimise a function by an optimiser of a library.

    Parameters
    ----------
    task : Problem
        What is minimised, within its box.
    method : {'cma_es', 'de'}
        By what.
    max_evaluations : int
        The search is cut off after so many calls.
    seed : int
        Seed of its random numbers.

    Returns
    -------
    value : float
        The lowest found.
    n_evaluations : int
        Calls of the function.
    """
    counted = _Counted(task, max_evaluations)
    # The usual end: whatever the method would do next, it has no call left.
    with suppress(_SpentError):
        {"cma_es": _cma_es, "de": _differential_evolution}[method](counted, task, seed)
    return counted.best, counted.n_evaluations


class _SpentError(Exception):
    """All calls are used up."""


class _Counted:
    """A function that counts its calls and ends the search with the last of them."""

    def __init__(self, function: Callable[[NDArray[np.float64]], Any], limit: int) -> None:
        self.best = float("inf")
        self.n_evaluations = 0
        self._function, self._limit = function, limit

    def __call__(self, x: NDArray[np.float64]) -> float:
        if self.n_evaluations == self._limit:
            raise _SpentError
        self.n_evaluations += 1
        value = float(self._function(np.asarray(x, dtype=float)))
        self.best = min(self.best, value)
        return value


def _cma_es(function: _Counted, task: BenchmarkProblem, seed: int) -> None:
    import cma
    from threadpoolctl import threadpool_limits

    rng = np.random.default_rng(seed)
    low, high = task.bounds[0]
    options = {
        "bounds": [low, high],
        "seed": seed + 1,  # 0 would take the clock
        "verbose": -9,
        "verb_log": 0,
        "maxfevals": np.inf,
    }
    # One thread for the small matrices: more of them would only wait for each other.
    with _GLOBAL_GENERATOR, threadpool_limits(1), warnings.catch_warnings():
        # It warns of flat functions and of its own numerics; the value found tells enough.
        warnings.simplefilter("ignore")
        before = np.random.get_state()
        try:
            while True:  # until the calls are spent
                start = rng.uniform(low, high, task.dimension)
                # Three tenths of the range, as the library's documentation advises.
                cma.fmin2(function, start, 0.3 * (high - low), options, restarts=9, bipop=False)
        finally:
            np.random.set_state(before)


def _differential_evolution(function: _Counted, task: BenchmarkProblem, seed: int) -> None:
    from scipy.optimize import differential_evolution

    # A population of 30 like that of the others; the library's own is 15 for each coordinate, of which a
    # budget of a few thousand calls would see few generations.
    low, high = task.bounds.T
    start = np.random.default_rng(seed).uniform(low, high, (30, task.dimension))
    # Without tolerances it runs until the calls are spent, or until all of its population is equally good.
    differential_evolution(
        function, task.bounds, init=start, maxiter=10**9, tol=0.0, atol=0.0, polish=False, rng=seed
    )
