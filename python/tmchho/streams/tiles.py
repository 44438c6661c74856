"""Space cut into tiles that hold about equally many points, and the points of two files sorted into them.

Why on disk: neighbours can only be found among points that are in memory, and all of them are not. A point is
kept as its three whole numbers and its place in the file, 16 bytes, so that nothing is rounded twice.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tmchho.io import las_parts
from tmchho.io.las_stream import LasPoints
from tmchho.transform import Transform

Floats = NDArray[np.float64]

_ENTRY = np.dtype([("steps", "<i4", (3,)), ("index", "<u4")])
_MOST_LEVELS = 8  # 256 tiles: each has two open files


@dataclass(frozen=True, eq=False)
class Cuts:
    """A complete binary tree of cuts: at each node an axis and a place; its leaves are the tiles."""

    axes: NDArray[np.int64]
    places: Floats
    n_levels: int

    @property
    def n_tiles(self) -> int:
        """Number of tiles."""
        return 1 << self.n_levels

    def tile_of(self, points: Floats) -> NDArray[np.int64]:
        """Return the number of the tile of each point."""
        node = np.zeros(len(points), dtype=np.int64)
        rows = np.arange(len(points))
        for _ in range(self.n_levels):
            node = 2 * node + 1 + (points[rows, self.axes[node]] > self.places[node])
        return np.asarray(node - (self.n_tiles - 1))


def cut_space(points: Floats, counts: NDArray[np.float64], points_per_tile: int) -> Cuts:
    """Cut space at medians of its longest sides until no tile holds more points than asked for.

    Parameters
    ----------
    points : (n, 3) float64 array
        Centroids of both clouds, in one frame.
    counts : (n,) float64 array
        Points that each of them stands for.
    points_per_tile : int
        Most points in a tile, about; with more than 256 tiles each holds more.
    """
    n_levels = int(np.clip(np.ceil(np.log2(max(1.0, counts.sum() / points_per_tile))), 0, _MOST_LEVELS))
    axes, places = np.zeros((1 << n_levels) - 1, dtype=np.int64), np.zeros((1 << n_levels) - 1)
    members = {0: np.arange(len(points))}
    for node in range(len(axes)):
        rows = members.pop(node)
        if len(rows):
            here = points[rows]
            axis = int(np.argmax(here.max(axis=0) - here.min(axis=0)))
            order = rows[np.argsort(here[:, axis], kind="stable")]
            weights = np.cumsum(counts[order])
            middle = int(np.searchsorted(weights, weights[-1] / 2))
            axes[node], places[node] = axis, points[order[min(middle, len(order) - 1)], axis]
        above = points[rows, axes[node]] > places[node]
        members[2 * node + 1], members[2 * node + 2] = rows[~above], rows[above]
    return Cuts(axes, places, n_levels)


@dataclass(frozen=True, eq=False)
class TiledFile:
    """A file whose points are sorted into tiles on disk; `lows` and `highs` are the boxes of their points."""

    file: LasPoints
    transform: Transform | None
    folder: Path
    n_in_tile: NDArray[np.int64]
    lows: Floats
    highs: Floats

    @property
    def lowest(self) -> Floats:
        """Lower corner of the box of all points, in the tiles' frame."""
        return np.asarray(self.lows.min(axis=0))

    @property
    def highest(self) -> Floats:
        """Upper corner of that box."""
        return np.asarray(self.highs.max(axis=0))

    def read(self, tile: int) -> tuple[Floats, NDArray[np.uint32]]:
        """Return the points of a tile, in the tiles' frame, and where they stand in the file."""
        if not self.n_in_tile[tile]:
            return np.empty((0, 3)), np.empty(0, dtype=np.uint32)
        entries = np.fromfile(self.folder / str(tile), dtype=_ENTRY)
        return self._places(entries["steps"]), entries["index"]

    def near(self, tile: int, low: Floats, high: Floats) -> Floats:
        """Return the points of all other tiles that lie in a box."""
        found = [np.empty((0, 3))]
        for other in np.flatnonzero((self.lows <= high).all(axis=1) & (self.highs >= low).all(axis=1)):
            if other != tile:
                points, _ = self.read(int(other))
                inside = (points >= low) & (points <= high)
                found.append(points[inside[:, 0] & inside[:, 1] & inside[:, 2]])
        return np.concatenate(found)

    def _places(self, steps: NDArray[np.int32]) -> Floats:
        xyz = self.file.xyz(steps)
        return xyz if self.transform is None else self.transform.apply(xyz)


def sort_into_tiles(file: LasPoints, transform: Transform | None, cuts: Cuts, folder: Path) -> TiledFile:
    """Sort the points of a file, moved by `transform` where there is one, into files of `folder`."""
    folder.mkdir()
    n_in_tile = np.zeros(cuts.n_tiles, dtype=np.int64)
    lows, highs = np.full((cuts.n_tiles, 3), np.inf), np.full((cuts.n_tiles, 3), -np.inf)
    tiled = TiledFile(file, transform, folder, n_in_tile, lows, highs)
    with ExitStack() as stack:
        streams = [stack.enter_context((folder / str(tile)).open("wb")) for tile in range(cuts.n_tiles)]
        start = 0
        for records in las_parts(file):
            entries = np.empty(len(records), dtype=_ENTRY)
            entries["steps"] = file.steps(records)
            entries["index"] = np.arange(start, start + len(records), dtype=np.uint32)
            start += len(records)
            points = tiled._places(entries["steps"])
            for tile, rows in _by_tile(cuts.tile_of(points)):
                streams[tile].write(entries[rows].tobytes())
                n_in_tile[tile] += len(rows)
                here = points[rows]
                lows[tile] = np.minimum(lows[tile], here.min(axis=0))
                highs[tile] = np.maximum(highs[tile], here.max(axis=0))
    return tiled


def _by_tile(tiles: NDArray[np.int64]) -> Iterator[tuple[int, NDArray[np.int64]]]:
    """Give each tile that occurs, and the rows in it in their order."""
    order = np.argsort(tiles.astype(np.uint16), kind="stable")  # of two bytes: counted, not compared
    numbers, starts = np.unique(tiles[order], return_index=True)
    for number, rows in zip(numbers, np.split(order, starts[1:]), strict=True):
        yield int(number), rows
