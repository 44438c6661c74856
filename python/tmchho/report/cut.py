"""A thin upright cut through both clouds, at full density: in it people see whether a pose is right."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tmchho.stages import estimate_normals

if TYPE_CHECKING:
    from tmchho.cloud import PointCloud

_WANTED = 2_500  # points of the sparser cloud
_MOST = 20_000  # points of either
_LEAST = 100
_N_PLACES = 40
_N_AT_ONCE = 1_000_000


def cut_through(
    common: NDArray[np.float64],
    is_source: NDArray[np.bool_],
    clouds: tuple[PointCloud, PointCloud],
    move: Callable[[NDArray[np.float64]], NDArray[np.float64]],
    random: np.random.Generator,
) -> tuple[NDArray[np.float32], NDArray[np.bool_], float]:
    """Return the points of a cut through the place where both clouds have most of what they share.

    Parameters
    ----------
    common : (k, 3) float64 array
        A choice of the points that have a counterpart in the other cloud, in the frame of the target.
    is_source : (k,) bool array
        Which of them are the source's.
    clouds : (PointCloud, PointCloud)
        Source and target, in their own frames.
    move : callable
        Takes source to target coordinates.
    random : numpy.random.Generator
        Settles which points are kept where there are too many.

    Returns
    -------
    (n, 2) float32 array
        Along the cut and upwards, from the middle of the common points; no rows where they share too little.
    (n,) bool array
        Which points are the source's.
    float
        Thickness of the cut.

    Notes
    -----
    The cut lies across the common surface: the direction from which it is looked at is the level one that is
    most nearly parallel to the surface everywhere, so that a slope or a wall is seen as a line.
    """
    nothing = np.empty((0, 2), dtype=np.float32), np.empty(0, dtype=bool), 0.0
    if min(np.count_nonzero(is_source), np.count_nonzero(~is_source)) < _LEAST:
        return nothing
    middle = np.median(common, axis=0)
    along = _along(common[~is_source])
    across = np.array([-along[1], along[0]])
    off = (common[:, :2] - middle[:2]) @ across
    low, high = np.percentile(off, [2, 98])
    if not high > low:
        return nothing
    counts = [
        np.histogram(off[side], bins=_N_PLACES, range=(low, high))[0] for side in (is_source, ~is_source)
    ]
    place = int(np.argmax(np.minimum(*counts)))
    width = (high - low) / _N_PLACES
    middle[:2] += (low + (place + 0.5) * width) * across
    kept = [
        _slab(cloud.xyz, to_target, middle, across, width / 2)
        for cloud, to_target in zip(clouds, (move, _stay), strict=True)
    ]
    fewest = min(map(len, kept))
    if fewest < _LEAST:
        return nothing
    thickness = float(f"{width * min(1.0, _WANTED / fewest):.1g}")
    parts = []
    for points in kept:
        points = points[np.abs((points[:, :2] - middle[:2]) @ across) <= thickness / 2]
        if len(points) > _MOST:
            points = points[random.choice(len(points), _MOST, replace=False)]
        parts.append(np.column_stack([(points[:, :2] - middle[:2]) @ along, points[:, 2] - middle[2]]))
    cut = np.concatenate(parts).astype(np.float32)
    return cut, np.arange(len(cut)) < len(parts[0]), thickness


def _stay(points: NDArray[np.float64]) -> NDArray[np.float64]:
    return points


def _along(surface: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the level direction in which the surface has most slope."""
    normals, _ = estimate_normals(surface[:20_000])
    level = normals[np.isfinite(normals).all(axis=1), :2]
    direction = np.linalg.eigh(level.T @ level)[1][:, 1]
    return np.asarray(direction if direction[np.argmax(np.abs(direction))] > 0 else -direction)


def _slab(
    xyz: NDArray[np.float64],
    move: Callable[[NDArray[np.float64]], NDArray[np.float64]],
    middle: NDArray[np.float64],
    across: NDArray[np.float64],
    reach: float,
) -> NDArray[np.float64]:
    """Return the points near the cut, moved; some at a time, so that no second copy of a cloud is made."""
    kept = [np.empty((0, 3))]
    for start in range(0, len(xyz), _N_AT_ONCE):
        points = move(xyz[start : start + _N_AT_ONCE])
        with np.errstate(invalid="ignore"):
            kept.append(points[np.abs((points[:, :2] - middle[:2]) @ across) <= reach])
    return np.concatenate(kept)
