"""Space cut into tiles that hold about equally many points, and the points of two files sorted into them.

Why on disk: neighbours can only be found among points that are in memory, and all of them are not. A point
is kept as its three whole numbers and its place in the file, 16 bytes, so that nothing is rounded twice. Each
tile is cut into blocks, so that the margin round a tile can be read without its neighbours as wholes.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tmchho import _core
from tmchho.io import las_parts
from tmchho.io.las_stream import LasPoints
from tmchho.transform import Transform

Floats = NDArray[np.float64]

_ENTRY = np.dtype([("steps", "<i4", (3,)), ("index", "<u4")])
_MOST_LEVELS = 10  # 1024 tiles
_BLOCK_LEVELS = 5  # 32 blocks in each


@dataclass(frozen=True, eq=False)
class Cuts:
    """A complete binary tree of cuts: at each node an axis and a place; its leaves are the blocks.

    The blocks of a tile have numbers that follow each other.
    """

    axes: list[int]
    places: list[float]

    @property
    def n_blocks(self) -> int:
        """Number of blocks."""
        return len(self.axes) + 1

    @property
    def n_tiles(self) -> int:
        """Number of tiles."""
        return self.n_blocks >> _BLOCK_LEVELS

    @staticmethod
    def blocks_of(tile: int) -> tuple[int, int]:
        """Return the first block of a tile, and the first behind it."""
        return tile << _BLOCK_LEVELS, (tile + 1) << _BLOCK_LEVELS

    def cell_of(self, tile: int) -> tuple[Floats, Floats]:
        """Return the corners of a tile's part of space, infinite at the rim."""
        low, high = np.full(3, -np.inf), np.full(3, np.inf)
        node = tile + self.n_tiles - 1
        while node:
            node, is_above = (node - 1) // 2, node % 2 == 0
            axis, place = self.axes[node], self.places[node]
            if is_above:
                low[axis] = max(low[axis], place)
            else:
                high[axis] = min(high[axis], place)
        return low, high

    def block_of(self, points: Floats) -> NDArray[np.uint16]:
        """Return the number of the block of each point."""
        return _core.tile_of(np.ascontiguousarray(points), self.axes, self.places)


def cut_space(points: Floats, counts: NDArray[np.float64], points_per_tile: int) -> Cuts:
    """Cut space at medians of its longest sides until no tile holds more points than asked for.

    Parameters
    ----------
    points : (n, 3) float64 array
        Centroids of both clouds, in one frame.
    counts : (n,) float64 array
        Points that each of them stands for.
    points_per_tile : int
        Most points in a tile, about; with more than 1024 tiles each holds more.
    """
    n_tiles = max(1.0, float(counts.sum()) / points_per_tile)
    n_levels = min(_MOST_LEVELS, int(np.ceil(np.log2(n_tiles)))) + _BLOCK_LEVELS
    axes, places = [0] * ((1 << n_levels) - 1), [0.0] * ((1 << n_levels) - 1)
    members = {0: np.arange(len(points))}
    for node in range(len(axes)):
        rows = members.pop(node)
        if len(rows):
            here = points[rows]
            axis = int(np.argmax(here.max(axis=0) - here.min(axis=0)))
            order = rows[np.argsort(here[:, axis], kind="stable")]
            weights = np.cumsum(counts[order])
            middle = min(int(np.searchsorted(weights, weights[-1] / 2)), len(order) - 1)
            axes[node], places[node] = axis, float(points[order[middle], axis])
        above = points[rows, axes[node]] > places[node]
        members[2 * node + 1], members[2 * node + 2] = rows[~above], rows[above]
    return Cuts(axes, places)


@dataclass(frozen=True, eq=False)
class TiledFile:
    """A file whose points are sorted by block within each part of it, on disk.

    Parameters
    ----------
    file : LasPoints
        The file.
    transform : Transform, optional
        Takes its coordinates to the tiles' frame.
    path : Path
        The sorted points.
    bounds : (n_parts, n_blocks + 1) int64 array
        Where the points of each block begin, part by part.
    lows, highs : (n_blocks, 3) float64 array
        Boxes of the points of each block, in the tiles' frame.
    """

    file: LasPoints
    transform: Transform | None
    path: Path
    bounds: NDArray[np.int64]
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

    def box(self, tile: int) -> tuple[Floats, Floats]:
        """Return the box of the points of a tile; the lower corner is infinite where there are none."""
        blocks = slice(*Cuts.blocks_of(tile))
        return self.lows[blocks].min(axis=0), self.highs[blocks].max(axis=0)

    def read(self, tile: int) -> tuple[Floats, NDArray[np.uint32]]:
        """Return the points of a tile, in the tiles' frame, and where they stand in the file."""
        entries = self._entries([Cuts.blocks_of(tile)])
        return self._places(entries["steps"]), entries["index"]

    def read_block(self, block: int) -> Floats:
        """Return the points of one block, in the tiles' frame."""
        return self._places(self._entries([(block, block + 1)])["steps"])

    def sample(self, most: int) -> Floats:
        """Return every so-many-th point in the file's order, so that there are at most so many."""
        stride = max(1, -(-len(self.file) // most))
        found = [np.empty(0, dtype=_ENTRY)]
        for tile in range(len(self.lows) >> _BLOCK_LEVELS):
            entries = self._entries([Cuts.blocks_of(tile)])
            found.append(entries[entries["index"] % stride == 0])
        chosen = np.concatenate(found)
        return self._places(chosen[np.argsort(chosen["index"])]["steps"])

    def near(self, tile: int, low: Floats, high: Floats) -> Floats:
        """Return the points of all other tiles that lie in a box."""
        return self.within(low, high, skipped=slice(*Cuts.blocks_of(tile)))[0]

    def within(
        self, low: Floats, high: Floats, skipped: slice = slice(0)
    ) -> tuple[Floats, NDArray[np.uint32]]:
        """Return the points in a box, but those of the blocks `skipped`, and where they stand in the file."""
        meets = np.asarray((self.lows <= high).all(axis=1) & (self.highs >= low).all(axis=1))
        meets[skipped] = False
        # Neighbouring blocks are read at once.
        edges = np.flatnonzero(np.diff(np.concatenate([[False], meets, [False]]).astype(np.int8)))
        entries = self._entries(list(map(tuple, edges.reshape(-1, 2))))
        points = self._places(entries["steps"])
        inside = np.ones(len(points), dtype=bool)
        for axis in range(3):
            inside &= (points[:, axis] >= low[axis]) & (points[:, axis] <= high[axis])
        return points[inside], entries["index"][inside]

    def _entries(self, runs: list[tuple[int, int]]) -> NDArray[np.void]:
        """Read runs of blocks, from the first up to but not including the second number."""
        spans = [(part[first], part[last]) for part in self.bounds for first, last in runs]
        entries = np.empty(sum(stop - start for start, stop in spans), dtype=_ENTRY)
        at = 0
        with self.path.open("rb", buffering=0) as stream:
            for start, stop in spans:
                if stop > start:
                    stream.seek(start * _ENTRY.itemsize)
                    stream.readinto(entries[at : at + stop - start].view(np.uint8))  # type: ignore[arg-type]
                    at += stop - start
        return entries

    def _places(self, steps: NDArray[np.int32]) -> Floats:
        xyz = self.file.xyz(steps)
        return xyz if self.transform is None else self.transform.apply(xyz)


def sort_into_tiles(file: LasPoints, transform: Transform | None, cuts: Cuts, path: Path) -> TiledFile:
    """Sort the points of a file, moved by `transform` where there is one, into a file of their own."""
    lows, highs = np.full((cuts.n_blocks, 3), np.inf), np.full((cuts.n_blocks, 3), -np.inf)
    bounds: list[NDArray[np.int64]] = []
    start = 0
    with path.open("wb") as stream:
        for records in las_parts(file):
            steps = file.steps(records)
            xyz = file.xyz(steps)
            points = xyz if transform is None else transform.apply(xyz)
            blocks = cuts.block_of(points)
            order = np.argsort(blocks, kind="stable")  # of two bytes: counted, not compared
            entries = np.empty(len(records), dtype=_ENTRY)
            entries["steps"] = steps[order]
            entries["index"] = order + start
            stream.write(entries.tobytes())
            counts = np.bincount(blocks, minlength=cuts.n_blocks)
            begins = np.concatenate([[0], np.cumsum(counts)])
            bounds.append(begins + start)
            used = np.flatnonzero(counts)
            sorted_points = points[order]
            lows[used] = np.minimum(lows[used], np.minimum.reduceat(sorted_points, begins[used]))
            highs[used] = np.maximum(highs[used], np.maximum.reduceat(sorted_points, begins[used]))
            start += len(records)
    return TiledFile(file, transform, path, np.array(bounds), lows, highs)
