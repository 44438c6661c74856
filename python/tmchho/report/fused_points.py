"""The points of a report, from a fused cloud of any size, where they were not kept beside it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from tmchho.cloud import PointCloud
from tmchho.errors import ReadError
from tmchho.io import open_las
from tmchho.report.points import MAX_POINTS, ReportPoints, choose

_NEEDED = ("origin", "fills_hole", "C2C_absolute_distances")
_SHOWN = (*_NEEDED, "red", "green", "blue", "intensity")
# So many points are held of each cloud, by chance, before they are spread evenly.
_HELD = 4 * MAX_POINTS

# Keys that settle which points are held, coordinates, and attributes.
_Kept: TypeAlias = tuple[NDArray[np.float64], NDArray[np.float64], dict[str, NDArray[Any]]]


@dataclass(frozen=True, eq=False)
class _Held:
    origin: NDArray[np.uint8]
    index: NDArray[np.uint32]
    fills_hole: NDArray[np.bool_]
    distance: NDArray[np.float64]


def points_of_fused(parts: Iterable[PointCloud], seed: int, edge: float) -> ReportPoints:
    """Choose the points that the report of a registration shows, part by part.

    Parameters
    ----------
    parts : iterable of PointCloud
        Together the fused cloud, with the attributes that `tmchho.FusedCloud.to_point_cloud` gives it.
    seed : int
        Settles the choice.
    edge : float
        Of the cubes in which points are counted, to spread them evenly.

    Returns
    -------
    ReportPoints
        Of a source that was fused in part, only that part.

    Raises
    ------
    ReadError
        If an attribute is missing.
    """
    held: dict[int, _Kept] = {}
    for number, part in enumerate(parts):
        missing = [name for name in _NEEDED if name not in part.attributes]
        if missing:
            raise ReadError(f"{part.name}: has no attribute '{missing[0]}'; give a cloud that tmchho fused")
        key = np.random.default_rng([seed, number]).random(len(part))
        for origin in (0, 1):
            rows = np.flatnonzero(np.asarray(part.attributes["origin"]) == origin)
            values = {
                name: np.asarray(part.attributes[name])[rows] for name in _SHOWN if name in part.attributes
            }
            held[origin] = _fewest(held.get(origin), (key[rows], part.xyz[rows], values))
    clouds = [PointCloud(held[origin][1], held[origin][2]) for origin in (0, 1)]
    target, source = clouds
    counts = [len(cloud) for cloud in clouds]
    fused = _Held(
        np.repeat(np.array([0, 1], dtype=np.uint8), counts),
        np.concatenate([np.arange(count, dtype=np.uint32) for count in counts]),
        np.concatenate([cloud.attributes["fills_hole"] for cloud in clouds]).astype(bool),
        np.concatenate([cloud.attributes["C2C_absolute_distances"] for cloud in clouds]).astype(np.float64),
    )
    return choose(source, target, np.asarray, fused, seed, edge)


def points_of_fused_file(path: Path, seed: int, edge: float) -> ReportPoints:
    """Do what `points_of_fused` does with a LAS or LAZ file of any size."""
    file = open_las(path)
    parts = (PointCloud(file.xyz(file.steps(part)), file.attributes(part)) for part in file.parts())
    return points_of_fused(parts, seed, edge)


def _fewest(before: _Kept | None, new: _Kept) -> _Kept:
    """Return the points of both with the smallest keys."""
    if before is not None:
        values = {name: np.concatenate([before[2][name], new[2][name]]) for name in before[2]}
        new = np.concatenate([before[0], new[0]]), np.concatenate([before[1], new[1]]), values
    if len(new[0]) <= _HELD:
        return new
    kept = np.sort(np.argpartition(new[0], _HELD)[:_HELD])
    return new[0][kept], new[1][kept], {name: values[kept] for name, values in new[2].items()}
