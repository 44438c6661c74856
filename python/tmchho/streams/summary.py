"""What a file of any size holds: its box, its spacing, its distinct points."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tmchho.io.las_stream import LasPoints
from tmchho.results import ReadOnlyArrays
from tmchho.streams.evaluate import middle_spacing
from tmchho.streams.memory import n_tile_points
from tmchho.streams.pair import MOST_CENTROIDS, tiles_of
from tmchho.streams.thin import thin_file
from tmchho.streams.tiles import cut_space, sort_into_tiles

_SAMPLE_POINTS = 10_000


@dataclass(frozen=True, eq=False)
class FileSummary(ReadOnlyArrays):
    """What a file holds.

    Parameters
    ----------
    lowest, highest : (3,) float64 array
        Box of its points.
    n_distinct : int
        Places at which there are points.
    spacing : float or None
        Median distance from a point to the nearest one elsewhere; None where all lie at one place.
    sample : (n, 3) float64 array
        Some of its points.
    """

    lowest: NDArray[np.float64]
    highest: NDArray[np.float64]
    n_distinct: int
    spacing: float | None
    sample: NDArray[np.float64]


def summarise(file: LasPoints, folder: Path, max_memory: int) -> FileSummary:
    """Look at every point of a file; 16 bytes a point are needed in `folder` while this runs."""
    thinned = thin_file(file, max_voxels=MOST_CENTROIDS)
    cuts = cut_space(thinned.points, thinned.counts.astype(np.float64), n_tile_points(max_memory))
    tiled = sort_into_tiles(file, None, cuts, folder / "points")
    # Points at one place are in one tile.
    n_distinct = sum(len(np.unique(points, axis=0)) for points, _ in tiles_of(tiled, cuts.n_tiles))
    return FileSummary(
        lowest=tiled.lowest,
        highest=tiled.highest,
        n_distinct=n_distinct,
        spacing=middle_spacing(tiled) if n_distinct > 1 else None,
        sample=tiled.sample(_SAMPLE_POINTS),
    )
