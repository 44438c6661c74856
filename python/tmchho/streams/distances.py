"""The distance of every point of two tiled files to the other cloud, kept in files of four bytes a point."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tmchho import _core
from tmchho.evaluation.lengths import statistics_of_parts
from tmchho.results import DistanceStatistics
from tmchho.streams.thin import ThinnedFile
from tmchho.streams.tiles import TiledFile

Floats = NDArray[np.float64]

_FAR_CENTROIDS = 100_000
_SPACING_BLOCKS = 48
_FEWEST_IN_BLOCK = 100  # of fewer, too many have their neighbours in the next block
_SPACINGS = 10_000
_AT_ONCE = 4_000_000


@dataclass(frozen=True, eq=False)
class FarCloud:
    """Centroids that stand for a cloud where it is far away.

    Parameters
    ----------
    index : PointIndex
        Finds the nearest of them.
    error : float
        By how much a distance to them can differ from that to the nearest point: the diagonal of their voxel.
    """

    index: _core.PointIndex
    error: float

    @classmethod
    def of(cls, thinned: ThinnedFile, places: Floats, scale: float = 1.0) -> FarCloud:
        """Thin centroids, which are at `places` in the tiles' frame, until few enough are left."""
        low, high = places.min(axis=0), places.max(axis=0)
        size = thinned.voxel_size * scale
        voxels = _core.RunningVoxels(tuple(low), tuple(high), size, _FAR_CENTROIDS)
        voxels.add(np.ascontiguousarray(places))
        found = voxels.finish()
        # A point lies within one diagonal of its centroid, and that within another of the coarser one.
        coarser = found["voxel_size"] if len(found["points"]) < len(places) else 0.0
        return cls(_core.PointIndex(found["points"]), float(np.sqrt(3.0) * (size + coarser)))


@dataclass(frozen=True, eq=False)
class DistanceFile:
    """Distances of all points of a file, in its order.

    Parameters
    ----------
    path : Path
        Four bytes a point.
    n_points : int
        How many.
    """

    path: Path
    n_points: int

    def part(self, start: int, stop: int) -> NDArray[np.float32]:
        """Return the distances of some points; a minus sign means a repetition of the other cloud."""
        return np.fromfile(self.path, dtype=np.float32, count=stop - start, offset=4 * start)

    def of(self, index: NDArray[np.uint32]) -> Floats:
        """Return the distances of points anywhere in the file."""
        kept = np.memmap(self.path, dtype=np.float32, mode="r", shape=(self.n_points,))
        return np.abs(kept[index]).astype(np.float64)

    def measured(self, max_distance: float | None) -> Iterator[Floats]:
        """Give all distances that do not exceed a limit, part by part."""
        for start in range(0, self.n_points, _AT_ONCE):
            part = np.abs(self.part(start, min(start + _AT_ONCE, self.n_points))).astype(np.float64)
            yield part if max_distance is None else part[part <= max_distance]

    def statistics(self) -> DistanceStatistics:
        """Sum up all distances, part by part."""
        found = statistics_of_parts(lambda: self.measured(None))
        assert found is not None  # no file is without points
        return found

    def share_within(self, distance: float) -> float:
        """Return the share of points whose distance does not exceed this."""
        return sum(int(np.count_nonzero(part <= distance)) for part in self.measured(None)) / self.n_points


def spacing_quantile(tiled: TiledFile, quantile: float) -> float:
    """Return a quantile of the distance to the nearest other point, over samples of some blocks."""
    sizes = np.diff(tiled.bounds, axis=1).sum(axis=0)
    used = np.flatnonzero(sizes > _FEWEST_IN_BLOCK)
    if not len(used):
        used = np.flatnonzero(sizes == sizes.max())
    chosen = used[np.unique(np.linspace(0, len(used) - 1, _SPACING_BLOCKS).round().astype(int))]
    samples = []
    for block in chosen:
        points = tiled.read_block(int(block))
        n_sampled = max(1, round(_SPACINGS * len(points) / sizes[chosen].sum()))
        samples.append(_core.spacing_sample(points, n_sampled))
    spacings = np.concatenate(samples)
    return float(np.quantile(spacings, quantile)) if len(spacings) else 0.0


def measure_tiles(
    source: TiledFile,
    target: TiledFile,
    far_source: FarCloud,
    far_target: FarCloud,
    n_tiles: int,
    reach: float,
    folder: Path,
    *,
    repeated_within: float | None = None,
) -> tuple[DistanceFile, DistanceFile]:
    """Measure every point of both clouds, tile by tile.

    Parameters
    ----------
    source, target : TiledFile
        In one frame, cut alike.
    far_source, far_target : FarCloud
        What stands for them beyond the reach.
    n_tiles : int
        Into how many tiles both are cut.
    reach : float
        Distances up to this are exact.
    folder : Path
        Where the files of distances go.
    repeated_within : float, optional
        Mark the points of the source that repeat a point of the target within this, at most half the reach.

    Returns
    -------
    tuple of DistanceFile
        Of source and target.
    """
    files = []
    for name, tiled in (("source", source), ("target", target)):
        path = folder / f"{name}.distances"
        with path.open("wb") as stream:
            stream.truncate(4 * len(tiled.file))
        files.append(DistanceFile(path, len(tiled.file)))
    for tile in range(n_tiles):
        corners = [tiled.box(tile) for tiled in (source, target)]
        low = np.minimum(corners[0][0], corners[1][0]) - reach
        high = np.maximum(corners[0][1], corners[1][1]) + reach
        if not np.isfinite(low).all():
            continue
        sides = []
        for tiled in (source, target):
            own, index = tiled.read(tile)
            sides.append((np.concatenate([own, tiled.near(tile, low, high)]), index))
        (of_source, source_index), (of_target, target_index) = sides
        for file, places, index, others, far, marked in (
            (files[0], of_source, source_index, of_target, far_target, repeated_within),
            (files[1], of_target, target_index, of_source, far_source, None),
        ):
            if not len(index):
                continue
            distances, repeated = _core.distances_within(
                places, len(index), others, reach, marked is not None
            )
            is_far = ~np.isfinite(distances)
            if is_far.any():
                beyond = far.index.distances(np.ascontiguousarray(places[: len(index)][is_far]))
                distances[is_far] = np.maximum(beyond, reach)
            if repeated is not None and marked is not None:
                repeated &= distances <= marked
                distances[repeated] *= -1  # of 0 this makes -0, whose sign is kept, too
            kept = np.memmap(file.path, dtype=np.float32, mode="r+", shape=(file.n_points,))
            kept[index] = distances
            del kept  # closed, so that the pages may leave memory
    return files[0], files[1]
