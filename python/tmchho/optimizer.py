"""A search that asks for values and is told them, for people who evaluate their function elsewhere."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tmchho import _core
from tmchho.arguments import (
    checked_array,
    checked_callable,
    checked_choice,
    checked_count,
    checked_number,
    checked_seed,
)
from tmchho.config import Method, MutationReading, options_json
from tmchho.errors import BudgetError
from tmchho.progress import says_stop
from tmchho.results import ReadOnlyArrays

# Beyond these a search would not fit into memory: 8 bytes each, several times over.
_MOST_MEMBERS = 10**6
_MOST_COORDINATES = 10**8
_MOST_ITERATIONS = 10**7

# With their numbers in `MinimizeResult.status`.
_ENDINGS = {
    "max_iterations": (0, "all iterations are done"),
    "max_evaluations": (1, "the calls of the function that were allowed are used up"),
    "callback": (2, "stopped by the callback"),
    "max_seconds": (3, "time is up"),
    "not_over": (-1, "not over: values are still asked for"),
}

Bounds = Sequence[tuple[float, float]] | ArrayLike
"""(low, high) for each coordinate, or an object with ``lb`` and ``ub``."""
StopCallback = Callable[[NDArray[np.float64], float], object]
"""Gets the best point and its value after each iteration, and answers True to stop."""


@dataclass(frozen=True, eq=False)
class MinimizeResult(ReadOnlyArrays):
    """What a search found, in the words of scipy.

    Parameters
    ----------
    x : (d,) float64 array
        Best point, always inside the bounds.
    fun : float
        Its value; infinite where the function never gave a number.
    nfev : int
        Points at which the function was evaluated.
    nit : int
        Iterations done.
    success : bool
        Whether the search ran to its end and found a finite value. That it is the minimum nobody knows.
    status : int
        0: all iterations done, 1: calls of the function used up, 2: stopped by the callback, 3: time is up,
        -1: not over.
    message : str
        The same in words.
    history : (nit,) float64 array
        Best value after each iteration.
    n_nan : int
        Points whose value was not a number; they count as infinite.
    """

    x: NDArray[np.float64]
    fun: float
    nfev: int
    nit: int
    success: bool
    status: int
    message: str
    history: NDArray[np.float64]
    n_nan: int


class Optimizer:
    """A search of a box, step by step: `ask` for points, find their values, `tell` them.

    The search is the very one that `minimize` runs.

    Parameters
    ----------
    bounds, method, population_size, n_iterations, max_evaluations, max_seconds, seed, x0
        As in `minimize`.
    levy_factor, mutation_variance, chaotic_start, trigonometric_mutation, mutation_reading
        As in `minimize`.

    Raises
    ------
    InvalidArgumentError, BudgetError
        As `minimize`.

    Examples
    --------
    >>> search = Optimizer([(-5, 5)] * 3, method="pso", n_iterations=80)
    >>> while not search.done:
    ...     search.tell((search.ask() ** 2).sum(axis=1))
    >>> search.result.fun < 1e-3, search.result.nfev
    (True, 2400)
    """

    def __init__(
        self,
        bounds: Bounds,
        *,
        method: Method = "tmchho",
        population_size: int | None = None,
        n_iterations: int | None = None,
        max_evaluations: int | None = None,
        max_seconds: float | None = None,
        seed: int = 0,
        x0: ArrayLike | None = None,
        levy_factor: float | None = None,
        mutation_variance: float | None = None,
        chaotic_start: bool | None = None,
        trigonometric_mutation: bool | None = None,
        mutation_reading: MutationReading | None = None,
    ) -> None:
        order = checked_order(
            bounds,
            method=method,
            population_size=population_size,
            n_iterations=n_iterations,
            max_evaluations=max_evaluations,
            max_seconds=max_seconds,
            seed=seed,
            x0=x0,
            levy_factor=levy_factor,
            mutation_variance=mutation_variance,
            chaotic_start=chaotic_start,
            trigonometric_mutation=trigonometric_mutation,
            mutation_reading=mutation_reading,
        )
        self._search = _core.Search(*order)

    @property
    def done(self) -> bool:
        """Whether the search is over, and nothing is asked any more."""
        return self._search.is_over()

    def ask(self) -> NDArray[np.float64]:
        """Return the points whose values are wanted, an (n, d) float64 array; n is 0 once it is over.

        They stay the same until they are told. n is as many as the method can name without knowing a further
        value: the whole population for 'pso' and 'woa', often a single point for the others.
        """
        return self._search.ask()

    def tell(self, values: ArrayLike, *, callback: StopCallback | None = None) -> None:
        """Take the values at the points of `ask`.

        Parameters
        ----------
        values : (n,) array_like
            In the order of the points; NaN counts as infinite.
        callback : callable, optional
            Gets the best point and its value after each iteration that is completed by these values, and
            answers True to stop.

        Raises
        ------
        InvalidArgumentError
            If there are more or fewer values than points, or they are not numbers.
        """
        checked_callable("callback", callback)
        self._search.tell(
            checked_array("values", values, (-1,)), None if callback is None else answering(callback)
        )

    @property
    def result(self) -> MinimizeResult:
        """What was found up to the end of the last complete iteration."""
        return result_of(self._search.minimum())


def checked_order(
    bounds: Any,
    *,
    method: str,
    population_size: int | None,
    max_seconds: float | None,
    n_iterations: int | None,
    max_evaluations: int | None,
    seed: int,
    x0: ArrayLike | None,
    levy_factor: float | None,
    mutation_variance: float | None,
    **words: object,
) -> tuple[tuple[list[float], list[float]], str, int, list[list[float]]]:
    """Return a search as the core takes it: the box, the options, the seed and the points to start from.

    Raises
    ------
    InvalidArgumentError, BudgetError
        As `minimize`.
    """
    checked_choice("method", method, _core.methods())
    low, high = box(bounds)
    n = (
        None
        if population_size is None
        else checked_count("population_size", population_size, 4, _MOST_MEMBERS)
    )
    if n is not None and n * len(low) > _MOST_COORDINATES:
        raise BudgetError(
            f"{n} points of {len(low)} coordinates do not fit into memory; "
            f"population_size times dimension can be {_MOST_COORDINATES} at most"
        )
    options = options_json(
        method=method,
        population_size=n,
        n_iterations=_count("n_iterations", n_iterations, 1, _MOST_ITERATIONS),
        max_evaluations=_count("max_evaluations", max_evaluations, 1, 2**53),
        max_seconds=_number("max_seconds", max_seconds),
        levy_factor=_number("levy_factor", levy_factor),
        mutation_variance=_number("mutation_variance", mutation_variance),
        **words,
    )
    start = [] if x0 is None else checked_array("x0", np.atleast_2d(np.asarray(x0)), (-1, len(low))).tolist()
    return (low, high), options, checked_seed(seed), start


def box(bounds: Any) -> tuple[list[float], list[float]]:
    """Return the low and the high ends."""
    if hasattr(bounds, "lb") and hasattr(bounds, "ub"):
        bounds = np.column_stack([np.atleast_1d(bounds.lb), np.atleast_1d(bounds.ub)])
    pairs = checked_array("bounds", bounds, (-1, 2))
    return pairs[:, 0].tolist(), pairs[:, 1].tolist()


def result_of(found: dict[str, Any]) -> MinimizeResult:
    """Return what the core found in the words of scipy."""
    status, message = _ENDINGS[found.pop("stop_reason")]
    success = status in (0, 1, 3) and bool(np.isfinite(found["fun"]))
    return MinimizeResult(**found, success=success, status=status, message=message)


def answering(callback: StopCallback) -> Callable[[NDArray[np.float64], float], bool]:
    """Return the callback in the form in which Rust calls it."""
    return lambda x, value: says_stop(callback(x, value))


def _count(name: str, value: int | None, least: int, most: int) -> int | None:
    return None if value is None else checked_count(name, value, least, most)


def _number(name: str, value: float | None) -> float | None:
    return None if value is None else checked_number(name, value)
