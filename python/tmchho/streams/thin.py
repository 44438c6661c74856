"""A file thinned to one centroid per voxel, while only the centroids are in memory."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tmchho import _core
from tmchho.errors import InvalidCloudError
from tmchho.io import las_parts
from tmchho.io.las_stream import LasPoints, Records
from tmchho.results import ReadOnlyArrays

Keep = Callable[[NDArray[np.float64], Records], NDArray[np.bool_]]

# Finer than this share of the box no grid needs to be: it is made coarser until its voxels fit.
_FINEST = 2.0**-15
_COLOURS = ("red", "green", "blue")


@dataclass(frozen=True, eq=False)
class ThinnedFile(ReadOnlyArrays):
    """What remains of a file.

    Parameters
    ----------
    points : (n, 3) float64 array
        Centroids, sorted by voxel.
    counts : (n,) uint32 array
        Points that each of them stands for.
    voxel_size : float
        Edge of the voxels.
    lowest, highest : (3,) float64 array
        Box of all points of the file.
    n_points, n_kept : int
        Points in the file, and points that were kept and thinned.
    brightest : int
        Largest colour value; 0 where there are no colours.
    """

    points: NDArray[np.float64]
    counts: NDArray[np.uint32]
    voxel_size: float
    lowest: NDArray[np.float64]
    highest: NDArray[np.float64]
    n_points: int
    n_kept: int
    brightest: int


def thin_file(
    file: LasPoints,
    *,
    voxel_size: float | None = None,
    max_voxels: int | None = None,
    keep: Keep | None = None,
) -> ThinnedFile:
    """Thin a LAS or LAZ file part by part.

    Parameters
    ----------
    file : LasPoints
        See `tmchho.io.open_las`.
    voxel_size : float, optional
        Edge of the voxels; the centroids are then, to the bit, those of `tmchho.voxel_downsample` of the
        whole file, unless `max_voxels` is exceeded. Where not given, as fine as `max_voxels` allows.
    max_voxels : int, optional
        Most voxels; the edge is doubled until there are no more.
    keep : callable, optional
        Gets the coordinates and the records of a part and returns which of its points to keep.

    Returns
    -------
    ThinnedFile

    Raises
    ------
    ReadError
        If the file is damaged.
    InvalidCloudError
        If no point is kept.
    """
    lowest, highest = np.array(file.header.minima), np.array(file.header.maxima)
    longest = float((highest - lowest).max())
    if not (np.isfinite(longest) and (highest - lowest).min() >= 0):
        lowest, highest = _box(file)
        longest = float((highest - lowest).max())
    edge = voxel_size if voxel_size is not None else max(longest, 1e-6) * _FINEST
    most = 2**32 - 2 if max_voxels is None else max_voxels
    voxels = _core.RunningVoxels(tuple(lowest), tuple(highest), edge, most)
    lowest, highest = np.full(3, np.inf), np.full(3, -np.inf)
    has_colours = all(name in file.point_format.dimension_names for name in _COLOURS)
    n_kept = brightest = 0
    for records in las_parts(file):
        xyz = file.xyz(file.steps(records))
        lowest, highest = np.minimum(lowest, xyz.min(axis=0)), np.maximum(highest, xyz.max(axis=0))
        if has_colours:
            brightest = max(brightest, *(int(records[name].max()) for name in _COLOURS))
        if keep is not None:
            xyz = xyz[keep(xyz, records)]
        n_kept += len(xyz)
        voxels.add(np.ascontiguousarray(xyz))
    if n_kept == 0:
        raise InvalidCloudError(
            f"{file.path}: no point is left in the crop and the classes that were asked for; "
            "`tmchho info` tells its box and classes"
        )
    found: dict[str, Any] = voxels.finish()
    return ThinnedFile(
        points=found["points"],
        counts=found["counts"],
        voxel_size=found["voxel_size"],
        lowest=lowest,
        highest=highest,
        n_points=len(file),
        n_kept=n_kept,
        brightest=brightest,
    )


def _box(file: LasPoints) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    lowest, highest = np.full(3, np.inf), np.full(3, -np.inf)
    for records in las_parts(file):
        xyz = file.xyz(file.steps(records))
        lowest, highest = np.minimum(lowest, xyz.min(axis=0)), np.maximum(highest, xyz.max(axis=0))
    return lowest, highest
