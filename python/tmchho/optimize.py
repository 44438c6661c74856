"""`minimize`: search a box for the lowest value of a function, with Harris hawks and their rivals."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tmchho import _core
from tmchho.arguments import checked_callable, checked_count
from tmchho.benchmarks import BenchmarkProblem
from tmchho.config import Method, MutationReading
from tmchho.errors import InvalidArgumentError
from tmchho.optimizer import (
    Bounds,
    MinimizeResult,
    StopCallback,
    answering,
    box,
    checked_order,
    result_of,
)


def minimize(
    fun: str | BenchmarkProblem | Callable[[NDArray[np.float64]], Any],
    bounds: Bounds | None = None,
    *,
    method: Method = "tmchho",
    dimension: int | None = None,
    population_size: int | None = None,
    n_iterations: int | None = None,
    max_evaluations: int | None = None,
    max_seconds: float | None = None,
    seed: int = 0,
    callback: StopCallback | None = None,
    x0: ArrayLike | None = None,
    vectorized: bool = False,
    n_threads: int | None = None,
    levy_factor: float | None = None,
    mutation_variance: float | None = None,
    chaotic_start: bool | None = None,
    trigonometric_mutation: bool | None = None,
    mutation_reading: MutationReading | None = None,
) -> MinimizeResult:
    """Search a box for the lowest value of a function.

    What to expect: all methods but 'tmchho_free' and 'pso' are pulled towards the origin of the coordinates
    by their rules. Minima there are found to many digits, minima elsewhere are not.

    Parameters
    ----------
    fun : callable, BenchmarkProblem or {'f1', …, 'f7'}
        Takes a (d,) float64 array of its own and returns a float; called from the calling thread, one point
        at a time. The name of a function of the paper's Table 1, or a `BenchmarkProblem`, is evaluated wholly
        in Rust.
    bounds : sequence of (low, high), or an object with ``lb`` and ``ub``
        The box, one pair for each coordinate; equal ends hold a coordinate fixed. For a built-in function the
        paper's box, where not given.
    method : {'tmchho', 'tmchho_free', 'hho', 'pso', 'woa', 'boa', 'doa'}
        Harris hawks with the chaotic start and the trigonometric mutation (the paper's), the same without the
        pull towards the origin (ours), Harris hawks without either, particles, whales, butterflies, dingoes.
    dimension : int, optional
        Number of coordinates; needed for a name without bounds.
    population_size : int, optional
        At least 4; 30 where not given.
    n_iterations : int, optional
        How often the whole population is evaluated, at least 1; 500 where not given.
    max_evaluations : int, optional
        Points after which the search ends, at least 1; no limit where not given.
    max_seconds : float, optional
        Time after which the search ends, at least 0; no limit where not given. A search that ends by the
        clock cannot be repeated.
    seed : int
        The same seed gives the same result.
    callback : callable, optional
        Gets the best point and its value after each iteration, and answers True to stop.
    x0 : (d,) or (k, d) array_like, optional
        Points to start from; they are clipped to the box and replace the last ones of the population.
    vectorized : bool
        Whether `fun` takes an (n, d) array and returns n values. n is as many as the method can name at once:
        all for 'pso' and 'woa', often one for the others, whose members move one after another.
    n_threads : int, optional
        Threads that share a built-in function where it is dear; all cores where not given. Never changes the
        result. They look ahead; what they evaluate in vain is not in `nfev`.
    levy_factor, mutation_variance : float, optional
        Factor of the Lévy flight and variance of the mutation's factor o, at least 0 (hawks only).
    chaotic_start, trigonometric_mutation : bool, optional
        Each improvement alone; as `method` says where not given (hawks only).
    mutation_reading : {'stagnant', 'every_hawk', 'after_dives', 'after_besieges'}, optional
        Which hawks are mutated, see `HawkOptions`; the first where not given (hawks only).

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

    See Also
    --------
    Optimizer : the same search for functions that are evaluated elsewhere.

    Notes
    -----
    Heidari et al. (2019); Ren, Zhao & Han (2023), Sections 4.3 and 4.4, Eqs. (5) to (7); their rivals with
    the parameters of their Table 2.

    Examples
    --------
    >>> found = minimize("f5", dimension=10)
    >>> found.fun, found.success
    (0.0, True)
    >>> found = minimize(lambda x: float(x @ x), [(-5, 5)] * 3, n_iterations=50)
    >>> found.fun < 1e-6, found.nit
    (True, 50)
    """
    if not isinstance(fun, (str, BenchmarkProblem)) and not callable(fun):
        raise InvalidArgumentError(f"fun must be callable or the name of a function, got {fun!r}")
    checked_callable("callback", callback)
    n = None if dimension is None else checked_count("dimension", dimension, 1, 10**6)
    if bounds is None and isinstance(fun, str) and n is not None:
        fun = BenchmarkProblem(fun, n)
    if bounds is None and isinstance(fun, BenchmarkProblem):
        bounds = fun.bounds
    if bounds is None:
        raise InvalidArgumentError(
            "bounds must be given: a (low, high) pair for each coordinate; only a function called by its "
            "name can do with dimension instead"
        )
    n_pairs = len(box(bounds)[0])
    if isinstance(fun, str):
        fun = BenchmarkProblem(fun, n_pairs)
    for needed in (n, fun.dimension if isinstance(fun, BenchmarkProblem) else None):
        if needed not in (None, n_pairs):
            raise InvalidArgumentError(f"dimension = {needed} does not agree with {n_pairs} pairs of bounds")
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
    told = None if callback is None else answering(callback)
    if isinstance(fun, BenchmarkProblem):
        threads = None if n_threads is None else checked_count("n_threads", n_threads, 1, 1024)
        return result_of(_core.minimize(fun.in_rust, *order, told, threads))
    if n_threads is not None:
        raise InvalidArgumentError(
            "n_threads is for built-in functions; a callable is called from the calling thread"
        )
    values_at = _many(fun) if vectorized else _one_by_one(fun)
    search = _core.Search(*order)
    while not search.is_over():
        search.tell(values_at(search.ask()), told)
    return result_of(search.minimum())


def _one_by_one(fun: Callable[[NDArray[np.float64]], Any]) -> Callable[..., NDArray[np.float64]]:
    def values_at(points: NDArray[np.float64]) -> NDArray[np.float64]:
        values = np.empty(len(points))
        for i, x in enumerate(points):
            value = fun(x)
            try:
                values[i] = float(value)
            except (TypeError, ValueError) as error:
                raise InvalidArgumentError(f"fun must return a number, got {value!r}") from error
        return values

    return values_at


def _many(fun: Callable[[NDArray[np.float64]], Any]) -> Callable[..., NDArray[np.float64]]:
    def values_at(points: NDArray[np.float64]) -> NDArray[np.float64]:
        answer = fun(points)
        try:
            values = np.ascontiguousarray(answer, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise InvalidArgumentError(f"fun must return numbers, got {answer!r}") from error
        if values.shape != (len(points),):
            raise InvalidArgumentError(
                f"fun must return one number for each of the {len(points)} points, got shape {values.shape}"
            )
        return values

    return values_at
