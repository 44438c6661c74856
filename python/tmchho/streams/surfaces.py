"""The distance of every point of a tiled file to another one, by any method and however far: exact."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tmchho import _core
from tmchho.evaluation.distances import DistanceMethod
from tmchho.streams.neighbours import Blocks
from tmchho.streams.pair import TiledPair
from tmchho.streams.tiles import TiledFile

Floats = NDArray[np.float64]

_AT_ONCE = 1_000_000
_ROUNDS_AT_ONCE = 20_000


@dataclass(frozen=True, eq=False)
class SurfaceDistances:
    """A number for each point of a file, in its order, on disk; NaN where the method has none."""

    path: Path
    n_points: int

    def part(self, start: int, stop: int) -> Floats:
        """Return those of some points."""
        return np.fromfile(self.path, count=stop - start, offset=8 * start)

    def of(self, index: NDArray[np.uint32]) -> Floats:
        """Return those of points anywhere in the file."""
        kept = np.memmap(self.path, dtype=np.float64, mode="r", shape=(self.n_points,))
        return np.array(kept[index])

    def parts(self) -> Iterator[Floats]:
        """Give all, part by part."""
        for start in range(0, self.n_points, _AT_ONCE):
            yield self.part(start, min(start + _AT_ONCE, self.n_points))

    def measured(self, max_distance: float | None) -> Iterator[Floats]:
        """Give those that are there and do not exceed a limit."""
        for part in self.parts():
            kept = part[np.isfinite(part)]
            yield kept if max_distance is None else kept[np.abs(kept) <= max_distance]


def measure_surfaces(
    pair: TiledPair,
    start: TiledFile,
    end: TiledFile,
    method: DistanceMethod,
    options: str,
    reach: float,
    path: Path,
) -> SurfaceDistances:
    """Measure from every point of `start` to `end`, tile by tile; see `tmchho.evaluate`.

    What the points within `reach` of a tile do not settle is found among all blocks of the file.
    """
    with path.open("wb") as stream:
        stream.truncate(8 * len(start.file))
    found = SurfaceDistances(path, len(start.file))
    blocks, plan = Blocks(end), Blocks(end, flat=True)
    for tile in range(pair.cuts.n_tiles):
        places, index = start.read(tile)
        if not len(places):
            continue
        low, high = places.min(axis=0) - reach, places.max(axis=0) + reach
        # Beyond the file there is nothing that could be nearer.
        low, high = np.where(low <= end.lowest, -np.inf, low), np.where(high >= end.highest, np.inf, high)
        if method == "vertical":
            low[2], high[2] = -np.inf, np.inf
        others, _ = end.within(low, high)
        if len(others):
            distances, settled = _core.surface_within(places, others, low, high, options)
        else:
            distances, settled = np.full(len(places), np.nan), np.zeros(len(places), dtype=bool)
        open_rows = np.flatnonzero(~settled)
        groups = pair.cuts.block_of(places[open_rows])
        for group in np.unique(groups):
            rows = open_rows[groups == group]
            for some in np.array_split(rows, -(-len(rows) // _ROUNDS_AT_ONCE)):
                searched = plan if method == "vertical" else blocks
                distances[some] = _far(places[some], searched, method, options)
        kept = np.memmap(path, dtype=np.float64, mode="r+", shape=(found.n_points,))
        kept[index] = distances
        del kept  # closed, so that the pages may leave memory
    return found


def _far(places: Floats, blocks: Blocks, method: DistanceMethod, options: str) -> Floats:
    if method == "nearest":
        return np.asarray(blocks.nearest(places, 1)[0][:, 0])
    middles = places if method == "vertical" else blocks.nearest(places, 1)[1][:, 0]
    rounds = blocks.nearest(middles, _core.plane_points(options))[1]
    return _core.surface_of_rounds(places, np.ascontiguousarray(rounds.reshape(-1, 3)), options)
