"""Neighbours of places among the points of a tiled file, however far away: exact, and never all in memory."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from tmchho import _core
from tmchho.streams.tiles import Cuts, TiledFile

Floats = NDArray[np.float64]

# Points whose blocks are kept with their indices, about 100 bytes each.
_KEPT_POINTS = 500_000
_FIRST_REACH = 8.0


class Blocks:
    """Finds neighbours block by block, the nearest blocks first.

    Parameters
    ----------
    tiled : TiledFile
        The file.
    flat : bool, default False
        Distances are those in plan.
    """

    def __init__(self, tiled: TiledFile, *, flat: bool = False) -> None:
        self._tiled, self._n_axes = tiled, 2 if flat else 3
        self._used = np.flatnonzero(np.isfinite(tiled.lows).all(axis=1))
        self._kept: OrderedDict[int, tuple[Floats, _core.PointIndex]] = OrderedDict()

    def nearest(self, places: Floats, k: int) -> tuple[Floats, Floats]:
        """Return the `k` nearest points of each place.

        Parameters
        ----------
        places : (n, 3) float64 array
            The nearer they are to each other, the fewer blocks are read.
        k : int
            Fewer are found where the file has fewer.

        Returns
        -------
        (n, k) float64 array, (n, k, 3) float64 array
            Distances, rising, and points.
        """
        k = min(k, len(self._tiled.file))
        axes = slice(self._n_axes)
        lows, highs = self._tiled.lows[self._used, axes], self._tiled.highs[self._used, axes]
        here = places[:, axes]
        gaps = np.maximum(lows - here.max(axis=0), here.min(axis=0) - highs)
        gaps = np.linalg.norm(np.maximum(gaps, 0), axis=1)
        best, found = np.full((len(places), k), np.inf), np.zeros((len(places), k, 3))
        for at in np.argsort(gaps, kind="stable"):
            if gaps[at] > best[:, -1].max():
                break
            beside = np.maximum(np.maximum(lows[at] - here, here - highs[at]), 0)
            rows = np.flatnonzero(np.linalg.norm(beside, axis=1) <= best[:, -1])
            if not len(rows):
                continue
            points, index = self._block(int(self._used[at]))
            distances, numbers = (
                values.reshape(-1, k) for values in index.k_nearest(self._flat(places[rows]), k)
            )
            both = np.concatenate([best[rows], distances], axis=1)
            order = np.argsort(both, axis=1, kind="stable")[:, :k]
            best[rows] = np.take_along_axis(both, order, axis=1)
            of_both = np.concatenate([found[rows], points[numbers]], axis=1)
            found[rows] = np.take_along_axis(of_both, order[:, :, None], axis=1)
        return best, found

    def _block(self, block: int) -> tuple[Floats, _core.PointIndex]:
        if block not in self._kept:
            points = self._tiled.read_block(block)
            self._kept[block] = points, _core.PointIndex(self._flat(points))
            while len(self._kept) > 1 and sum(len(kept) for kept, _ in self._kept.values()) > _KEPT_POINTS:
                self._kept.popitem(last=False)
        self._kept.move_to_end(block)
        return self._kept[block]

    def _flat(self, points: Floats) -> Floats:
        if self._n_axes == 3:
            return np.ascontiguousarray(points)
        return np.column_stack([points[:, :2], np.zeros(len(points))])


def gathered(tiled: TiledFile, places: Floats, reach: float) -> Floats:
    """Return all points that lie within a reach of a place: little, where the places are few."""
    wider = reach * (1 + 1e-6)  # distances are compared as float32
    found = [np.empty((0, 3))]
    for tile in range(len(tiled.lows) // Cuts.blocks_of(0)[1]):
        points, _ = tiled.read(tile)
        if len(points):
            distances, _ = _core.distances_within(points, len(points), places, wider, False)
            found.append(points[np.isfinite(distances)])
    return np.concatenate(found)


def first_reach(tiled: TiledFile) -> float:
    """Return some spacings of a file: a reach that is probably long enough for the nearest neighbours."""
    fullest = int(np.diff(tiled.bounds, axis=1).sum(axis=0).argmax())
    spacings = _core.spacing_sample(tiled.read_block(fullest), 100)
    usual = float(np.median(spacings)) if len(spacings) else 0.0
    return max(_FIRST_REACH * usual, 1e-9 * _diagonal(tiled), 1e-12)


def spacing_at(tiled: TiledFile, places: Floats, rank_of: Callable[[int], int]) -> float:
    """Return one of the distances from points of a file to the nearest one elsewhere, by its rank.

    Parameters
    ----------
    tiled : TiledFile
        The file.
    places : (n, 3) float64 array
        Some of its points.
    rank_of : callable
        Gets the number of distances and returns which of them, from the shortest up, is asked for.

    Returns
    -------
    float
        0 where the file has one place only.
    """
    if not len(places):
        return 0.0
    reach = first_reach(tiled)
    while True:
        near = _core.PointIndex(gathered(tiled, places, reach))
        distances = np.sort(near.nearest_elsewhere(np.ascontiguousarray(places)))
        # What is longer than the reach is not known, but that it is longer.
        known = distances[distances <= reach]
        rank = rank_of(len(distances))
        if rank < len(known):
            return float(known[rank])
        if reach > _diagonal(tiled):
            return float(known[rank_of(len(known))]) if len(known) else 0.0
        reach *= 2


def _diagonal(tiled: TiledFile) -> float:
    return float(np.linalg.norm(tiled.highest - tiled.lowest))
