"""Minimisers of a function over a box: Harris hawks, plain and with the paper's improvements."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

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
from tmchho.config import options_json
from tmchho.errors import BudgetError, InvalidArgumentError
from tmchho.progress import says_stop
from tmchho.results import ReadOnlyArrays

# Beyond these a search would not fit into memory: 8 bytes each, several times over.
_MOST_HAWKS = 10**6
_MOST_COORDINATES = 10**8
_MOST_ITERATIONS = 10**8

# In the order of their numbers in `MinimizeResult.status`.
_ENDINGS = {
    "max_iterations": "all iterations are done",
    "max_evaluations": "the calls of the function that were allowed are used up",
    "callback": "stopped by the callback",
}


class BenchmarkFunction(NamedTuple):
    """One of the seven functions of the paper's Table 1; all have their minimum at the origin.

    Parameters
    ----------
    name : str
        ``f1`` to ``f7``.
    title : str
        The name that others use.
    range : float
        Each coordinate lies within ± this.
    minimum : float
        The lowest value.
    """

    name: str
    title: str
    range: float
    minimum: float


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
        Calls of the function.
    nit : int
        Iterations done.
    success : bool
        Whether the search ran to its end and found a finite value. That it is the minimum nobody knows.
    status : int
        0: all iterations done, 1: calls of the function used up, 2: stopped by the callback.
    message : str
        The same in words.
    history : (nit,) float64 array
        Best value after each iteration.
    n_nan : int
        Calls whose value was not a number; they count as infinite.
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


def minimize(
    fun: str | Callable[[NDArray[np.float64]], float],
    bounds: Sequence[tuple[float, float]] | ArrayLike | None = None,
    *,
    method: Literal["tmchho", "hho"] = "tmchho",
    dimension: int | None = None,
    n_hawks: int | None = None,
    n_iterations: int | None = None,
    max_evaluations: int | None = None,
    seed: int = 0,
    callback: Callable[[NDArray[np.float64], float], object] | None = None,
    x0: ArrayLike | None = None,
    levy_factor: float | None = None,
    mutation_variance: float | None = None,
    chaotic_start: bool | None = None,
    trigonometric_mutation: bool | None = None,
) -> MinimizeResult:
    """Search a box for the lowest value of a function, by Harris hawks.

    What to expect: two of the rules pull the hawks towards the origin of the coordinates. Minima there are
    found to many digits, minima elsewhere are not.

    Parameters
    ----------
    fun : callable or {'f1', …, 'f7'}
        Takes a (d,) float64 array of its own and returns a float; called from the calling thread, one point
        at a time. The name of a function of the paper's Table 1 is evaluated wholly in Rust.
    bounds : sequence of (low, high), or an object with ``lb`` and ``ub``
        The box, one pair for each coordinate; equal ends hold a coordinate fixed. For a name the paper's box
        of `dimension` coordinates, where not given.
    method : {'tmchho', 'hho'}
        With the chaotic start and the trigonometric mutation, or plain.
    dimension : int, optional
        Number of coordinates; needed for a name without bounds.
    n_hawks : int, optional
        Size of the population, at least 1; the mutation needs 3.
    n_iterations : int, optional
        How often the population is evaluated, at least 1.
    max_evaluations : int, optional
        Calls of the function after which the search ends, at least 1; no limit where not given.
    seed : int
        The same seed gives the same result.
    callback : callable, optional
        Gets the best point and its value after each iteration, and answers True to stop.
    x0 : (d,) or (k, d) array_like, optional
        Points to start from; they are clipped to the box and replace the last ones of the population.
    levy_factor, mutation_variance : float, optional
        Factor of the Lévy flight and variance of the mutation's factor o, at least 0.
    chaotic_start, trigonometric_mutation : bool, optional
        Each improvement alone; as `method` says where not given.

    Returns
    -------
    MinimizeResult

    Raises
    ------
    InvalidArgumentError
        Naming the argument, or if `fun` returns something else than a number. Exceptions of `fun` and
        `callback` come out unchanged.
    BudgetError
        If the population would not fit into memory.

    Notes
    -----
    Heidari et al. (2019); Ren, Zhao & Han (2023), Sections 4.3 and 4.4, Eqs. (5) to (7).

    Examples
    --------
    >>> found = minimize("f5", dimension=10)
    >>> found.fun, found.success
    (0.0, True)
    >>> found = minimize(lambda x: float(x @ x), [(-5, 5)] * 3, n_iterations=50)
    >>> found.fun < 1e-6, found.nit
    (True, 50)
    """
    improved = checked_choice("method", method, ("tmchho", "hho")) == "tmchho"
    is_named = isinstance(fun, str)
    if not is_named and not callable(fun):
        raise InvalidArgumentError(f"fun must be callable or the name of a function, got {fun!r}")
    checked_callable("callback", callback)
    n_hawks = _count("n_hawks", n_hawks, _MOST_HAWKS)
    low, high = _box(fun if isinstance(fun, str) else None, bounds, dimension)
    if n_hawks is not None and n_hawks * len(low) > _MOST_COORDINATES:
        raise BudgetError(
            f"{n_hawks} hawks of {len(low)} coordinates do not fit into memory; "
            f"n_hawks times dimension can be {_MOST_COORDINATES} at most"
        )
    options = options_json(
        n_hawks=n_hawks,
        n_iterations=_count("n_iterations", n_iterations, _MOST_ITERATIONS),
        max_evaluations=_count("max_evaluations", max_evaluations, 2**53),
        levy_factor=None if levy_factor is None else checked_number("levy_factor", levy_factor),
        mutation_variance=(
            None if mutation_variance is None else checked_number("mutation_variance", mutation_variance)
        ),
        chaotic_start=improved if chaotic_start is None else bool(chaotic_start),
        trigonometric_mutation=improved if trigonometric_mutation is None else bool(trigonometric_mutation),
    )
    start = [] if x0 is None else checked_array("x0", np.atleast_2d(np.asarray(x0)), (-1, len(low))).tolist()
    found = _core.minimize(
        fun if isinstance(fun, str) else _objective(fun),
        (low, high),
        options,
        checked_seed(seed),
        start,
        None if callback is None else lambda x, value: says_stop(callback(x, value)),
    )
    ending = found.pop("stop_reason")
    return MinimizeResult(
        **found,
        success=ending != "callback" and bool(np.isfinite(found["fun"])),
        status=list(_ENDINGS).index(ending),
        message=_ENDINGS[ending],
    )


def benchmark_functions() -> tuple[BenchmarkFunction, ...]:
    """Return the seven functions of the paper's Table 1, in its order.

    Examples
    --------
    >>> benchmark_functions()[4]
    BenchmarkFunction(name='f5', title='Rastrigin', range=5.12, minimum=0.0)
    """
    return tuple(BenchmarkFunction(*function) for function in _core.benchmark_functions())


def benchmark_value(name: str, x: ArrayLike) -> float:
    """Return the value of one of the functions of Table 1.

    Parameters
    ----------
    name : {'f1', …, 'f7'}
        Which.
    x : (d,) array_like
        Where.

    Raises
    ------
    InvalidArgumentError
        If there is no such function, or `x` is not a vector of numbers.

    Examples
    --------
    >>> benchmark_value("f1", [3.0, 4.0])
    25.0
    """
    return _core.benchmark_value(name, checked_array("x", x, (-1,)))


def _box(name: str | None, bounds: Any, dimension: int | None) -> tuple[list[float], list[float]]:
    """Return the low and the high ends."""
    n = None if dimension is None else checked_count("dimension", dimension, 1, _MOST_HAWKS)
    if bounds is None:
        ranges = {function.name: function.range for function in benchmark_functions()}
        if name is None or n is None:
            raise InvalidArgumentError(
                "bounds must be given: a (low, high) pair for each coordinate; only a function called by its "
                "name can do with dimension instead"
            )
        if name not in ranges:
            raise InvalidArgumentError(f"fun must be callable or one of {', '.join(ranges)}, got '{name}'")
        return [-ranges[name]] * n, [ranges[name]] * n
    if hasattr(bounds, "lb") and hasattr(bounds, "ub"):
        bounds = np.column_stack([np.atleast_1d(bounds.lb), np.atleast_1d(bounds.ub)])
    pairs = checked_array("bounds", bounds, (-1, 2))
    if n not in (None, len(pairs)):
        raise InvalidArgumentError(f"dimension = {n} does not agree with {len(pairs)} pairs of bounds")
    return pairs[:, 0].tolist(), pairs[:, 1].tolist()


def _objective(fun: Callable[[NDArray[np.float64]], Any]) -> Callable[[NDArray[np.float64]], float]:
    def value_at(x: NDArray[np.float64]) -> float:
        value = fun(x)
        try:
            return float(value)
        except (TypeError, ValueError) as error:
            raise InvalidArgumentError(f"fun must return a number, got {value!r}") from error

    return value_at


def _count(name: str, value: int | None, most: int) -> int | None:
    return None if value is None else checked_count(name, value, 1, most)
