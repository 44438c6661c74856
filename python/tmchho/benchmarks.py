"""The seven functions on which the paper compares optimisers; as printed, moved and turned."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tmchho import _core
from tmchho.arguments import checked_array, checked_count, checked_seed
from tmchho.errors import InvalidArgumentError

_MOST_COORDINATES = 10**6


class BenchmarkFunction(NamedTuple):
    """One of the seven functions of the paper's Table 1; all have their minimum at the origin.

    Attributes
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


class BenchmarkProblem:
    """A function of Table 1 with its box: f(R (x − s)), evaluated in Rust.

    Why moved and turned: all seven functions have their minimum at the origin and most treat each coordinate
    alone. A method that is drawn to the origin, or that works along the axes, looks better there than it is.

    `minimize` takes it as `fun` and searches wholly in Rust; it can also be called, and so be given to any
    other optimiser.

    Parameters
    ----------
    name : {'f1', …, 'f7'}
        Which.
    dimension : int
        Number of coordinates, at least 1.
    shift : (d,) array_like, optional
        s, where the minimum is put; at the origin where not given.
    rotation_seed : int, optional
        Seed of R, a random orthogonal matrix; not turned where not given.

    Attributes
    ----------
    name, dimension
        As given.
    bounds : (d, 2) float64 array
        The paper's box, which neither shift nor rotation moves.
    x_min : (d,) float64 array
        Where the minimum is.
    minimum : float
        The lowest value.

    Raises
    ------
    InvalidArgumentError
        Naming the argument.

    Examples
    --------
    >>> problem = BenchmarkProblem("f1", 2, shift=[3.0, -1.0])
    >>> problem([3.0, 1.0]), problem([[3.0, 1.0], [3.0, -1.0]])
    (4.0, array([4., 0.]))
    """

    def __init__(
        self,
        name: str,
        dimension: int,
        *,
        shift: ArrayLike | None = None,
        rotation_seed: int | None = None,
    ) -> None:
        table = {function.name: function for function in benchmark_functions()}
        if name not in table:
            raise InvalidArgumentError(f"the function must be one of {', '.join(table)}, got {name!r}")
        self.name = name
        self.dimension = checked_count("dimension", dimension, 1, _MOST_COORDINATES)
        self.minimum = table[name].minimum
        self.bounds = _read_only(np.tile([-table[name].range, table[name].range], (self.dimension, 1)))
        self.x_min = _read_only(
            np.zeros(self.dimension)
            if shift is None
            else checked_array("shift", shift, (self.dimension,)).copy()
        )
        self.rotation_seed = None if rotation_seed is None else checked_seed(rotation_seed)
        self.in_rust = _core.Problem(
            name, self.dimension, None if shift is None else self.x_min.tolist(), self.rotation_seed
        )

    def __call__(self, x: ArrayLike) -> float | NDArray[np.float64]:
        """Return the value at a (d,) array_like, or the (n,) values at the rows of an (n, d) one."""
        if np.ndim(x) == 1:
            return float(self.in_rust.values(checked_array("x", [x], (1, self.dimension)))[0])
        return self.in_rust.values(checked_array("x", x, (-1, self.dimension)))

    def __repr__(self) -> str:
        shift = f", shift={self.x_min.tolist()}" if self.x_min.any() else ""
        rotation = "" if self.rotation_seed is None else f", rotation_seed={self.rotation_seed}"
        return f"BenchmarkProblem({self.name!r}, {self.dimension}{shift}{rotation})"


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
    place = checked_array("x", x, (-1,))
    value = BenchmarkProblem(name, len(place))(place)
    return float(value)


def _read_only(array: NDArray[np.float64]) -> NDArray[np.float64]:
    array.flags.writeable = False
    return array
