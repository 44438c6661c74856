"""Two files in one frame, sorted into tiles."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tmchho.io.las_stream import LasPoints
from tmchho.streams.memory import n_centroids, n_tile_points
from tmchho.streams.thin import ThinnedFile, thin_file
from tmchho.streams.tiles import Cuts, TiledFile, cut_space, sort_into_tiles
from tmchho.transform import about_middle

Floats = NDArray[np.float64]

MOST_CENTROIDS = 200_000  # that space is cut by; with 1024 tiles some hundreds for each


@dataclass(frozen=True, eq=False)
class TiledPair:
    """Two files in the frame of the target, cut alike.

    Parameters
    ----------
    source, target : TiledFile
        The files.
    cuts : Cuts
        How they are cut.
    voxel_size : float
        Edge of the larger voxels that they were thinned by, in the target's unit.
    """

    source: TiledFile
    target: TiledFile
    cuts: Cuts
    voxel_size: float


def tile_pair(
    source: LasPoints, target: LasPoints, matrix: Floats, folder: Path, max_memory: int
) -> TiledPair:
    """Sort two files, the source moved by `matrix`, into tiles: 16 bytes a point in `folder`."""
    thinned: list[ThinnedFile] = [
        thin_file(file, max_voxels=min(MOST_CENTROIDS, n_centroids(max_memory))) for file in (source, target)
    ]
    transform = about_middle(matrix, (thinned[0].lowest + thinned[0].highest) / 2)
    places = np.concatenate([transform.apply(thinned[0].points), thinned[1].points])
    counts = np.concatenate([file.counts for file in thinned]).astype(np.float64)
    cuts = cut_space(places, counts, n_tile_points(max_memory))
    return TiledPair(
        source=sort_into_tiles(source, transform, cuts, folder / "source"),
        target=sort_into_tiles(target, None, cuts, folder / "target"),
        cuts=cuts,
        voxel_size=max(thinned[0].voxel_size * transform.scale, thinned[1].voxel_size),
    )


def tiles_of(tiled: TiledFile, n_tiles: int) -> Iterator[tuple[Floats, NDArray[np.uint32]]]:
    """Give the points of each tile that has some, and where they stand in the file."""
    for tile in range(n_tiles):
        points, index = tiled.read(tile)
        if len(points):
            yield points, index
