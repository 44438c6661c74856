"""Single equations of the paper, for those who build a search of their own.

Where a point with a coordinate that is not finite would not show in the result, it is refused.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tmchho import _core
from tmchho.arguments import checked_array, checked_count, checked_number, checked_seed
from tmchho.inputs import CloudLike, open_points

_MOST_DRAWN = 10**8


def euler_to_matrix(parameters: ArrayLike) -> NDArray[np.float64]:
    """Return the matrix of the six parameters.

    Parameters
    ----------
    parameters : (6,) array_like
        θx, θy, θz in radians, then Vx, Vy, Vz.

    Returns
    -------
    (4, 4) float64 array
        Its rotation is the transpose of Rz(θz)·Ry(θy)·Rx(θx), as printed in Eq. (1).

    Raises
    ------
    InvalidArgumentError
        If `parameters` are not six finite numbers.

    Notes
    -----
    Ren, Zhao & Han (2023), Eq. (1).
    """
    return _core.euler_to_matrix(_six(parameters))


def matrix_to_euler(matrix: ArrayLike) -> NDArray[np.float64]:
    """Return the six parameters of a rigid transform; the inverse of `euler_to_matrix`.

    Parameters
    ----------
    matrix : (4, 4) array_like
        Finite, orthonormal to 1e-6, not a reflection.

    Returns
    -------
    (6,) float64 array
        θx, θy, θz in radians, θy in [-π/2, π/2], then Vx, Vy, Vz. Where θy is ±π/2, the whole turn about the
        common axis is put into θx.

    Raises
    ------
    InvalidArgumentError
        If the matrix is not rigid.
    """
    return _core.matrix_to_euler(checked_array("matrix", matrix, (4, 4)))


def rms_fitness(source: CloudLike, target: CloudLike, parameters: ArrayLike) -> float:
    """Return what paper mode minimises: the RMS distance of the moved source points to the target.

    Parameters
    ----------
    source, target : CloudLike
        (n, 3) and (m, 3), finite. The neighbours of `target` are indexed anew in each call.
    parameters : (6,) array_like
        θx, θy, θz in radians, then Vx, Vy, Vz in the clouds' unit.

    Returns
    -------
    float
        NaN for an empty source, infinite for an empty target.

    Raises
    ------
    InvalidArgumentError, InvalidCloudError, ReadError
        Naming the argument or the file.

    Notes
    -----
    Ren, Zhao & Han (2023), Eq. (1), with the R that the printed sum lacks; N_s is all source points.

    Examples
    --------
    >>> rms_fitness([[0.0, 3.0, 0.0], [10.0, 4.0, 0.0]], [[0.0, 0.0, 0.0], [10.0, 0.0, 0.0]], [0.0] * 6)
    3.5355339059327378
    """
    clouds = open_points(source, "source", finite=True), open_points(target, "target", finite=True)
    return _core.rms_fitness(*clouds, _six(parameters))


def kabsch(source: CloudLike, target: CloudLike) -> NDArray[np.float64]:
    """Return the rigid transform that moves paired points onto each other best, in closed form.

    Parameters
    ----------
    source, target : CloudLike
        (n, 3) each, finite; row i belongs to row i. At least one pair; fewer than three, or pairs on one
        line, leave the rotation open, and one of the best is returned.

    Returns
    -------
    (4, 4) float64 array
        Takes source to target coordinates; never a reflection.

    Raises
    ------
    InvalidArgumentError, InvalidCloudError, ReadError
        If the numbers of rows differ or are zero, a coordinate is not finite, or a file cannot be read.

    Notes
    -----
    Kabsch (1976), Umeyama (1991); Ren, Zhao & Han (2023), Section 4.5.
    """
    return _core.kabsch(
        open_points(source, "source", finite=True), open_points(target, "target", finite=True)
    )


def chaotic_sequence(n: int, *, seed: int = 0) -> NDArray[np.float64]:
    """Return values of the piecewise linear chaotic map, all strictly between 0 and 1.

    Parameters
    ----------
    n : int
        How many.
    seed : int
        Seed of the first value, and of those that replace values from which the map cannot go on.

    Returns
    -------
    (n,) float64 array

    Notes
    -----
    Ren, Zhao & Han (2023), Section 4.4, Eq. (6).
    """
    return _core.chaotic_sequence(checked_count("n", n, 0, _MOST_DRAWN), checked_seed(seed))


def levy_steps(n: int, *, seed: int = 0, factor: float | None = None) -> NDArray[np.float64]:
    """Return steps of the Lévy flight: many short ones and, now and then, a very long one.

    Parameters
    ----------
    n : int
        How many.
    seed : int
        Seed of the random numbers.
    factor : float, optional
        All steps are multiplied by it; that of the search where not given.

    Returns
    -------
    (n,) float64 array

    Notes
    -----
    Ren, Zhao & Han (2023), Eq. (5), with the exponent 1.5 of Table 2; Heidari et al. (2019), Eq. (9).
    """
    return _core.levy_steps(
        checked_count("n", n, 0, _MOST_DRAWN),
        checked_seed(seed),
        None if factor is None else checked_number("factor", factor),
    )


def _six(parameters: ArrayLike) -> list[float]:
    values = checked_array("parameters", parameters, (6,))
    return [checked_number("parameters", value) for value in values]
