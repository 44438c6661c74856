"""One area summed up, part by part: a row of the article's Table 7."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import shapely
from numpy.typing import NDArray

from tmchho.evaluation.lengths import Lengths

if TYPE_CHECKING:
    from tmchho.evaluation.areas import Area

# Fewer points than this say little about an area; its row says so.
FEW_POINTS = 30
# Cells in which completeness is counted; a large area gets larger cells.
_MOST_CELLS = 1 << 20

Floats = NDArray[np.float64]
Outline = tuple[tuple[tuple[tuple[float, float], ...], ...], ...]


@dataclass(frozen=True)
class AreaStatistics:
    """How far the clouds lie apart in one area: a row of Table 7.

    Lengths are None where nothing could be measured.

    Parameters
    ----------
    name : str
        Of the area.
    n_points : int
        Points of the source, or cores, that were measured there.
    mean, best, worst, std, rms, median, percentile_95 : float or None
        As in `DistanceStatistics`.
    share_within : float or None
        Share of them whose distance does not exceed the tolerance; None without a tolerance.
    share_significant : float or None
        Share of them with a significant change; None unless measured by M3C2.
    n_beyond : int
        Further points there that have no counterpart: farther away than the largest distance that counts, or
        without a distance.
    completeness_before, completeness_after : float or None
        Share of the area's surface, seen from above in cells, on which the target alone has a point, and the
        two clouds together. None for an area smaller than a cell.
    remark : str
        ``"no data"``, ``"fewer than 30 points"``, or nothing.
    outline : nested tuples
        See `Area.outline`.
    """

    name: str
    n_points: int
    mean: float | None
    best: float | None
    worst: float | None
    std: float | None
    rms: float | None
    median: float | None
    percentile_95: float | None
    share_within: float | None
    share_significant: float | None
    n_beyond: int
    completeness_before: float | None
    completeness_after: float | None
    remark: str
    outline: Outline


class AreaTally:
    """Sums up one area, part by part.

    Parameters
    ----------
    area : Area
        In target coordinates.
    cell : float
        See `measure_areas`, as for what else is not said here.
    lengths : Lengths
        Where the distances are kept until all have come.
    tolerance, max_distance : float, optional
    """

    def __init__(
        self,
        area: Area,
        cell: float,
        lengths: Lengths,
        *,
        tolerance: float | None = None,
        max_distance: float | None = None,
    ) -> None:
        self._area, self._lengths = area, lengths
        self._tolerance, self._max_distance = tolerance, max_distance
        self._n_inside = self._n_within = 0
        self._n_significant: int | None = None
        self._cells = _Cells(area, cell)

    def add(
        self,
        points: Floats,
        distances: Floats,
        significant: NDArray[np.bool_] | None = None,
        *,
        covers: bool = True,
    ) -> None:
        """Add points with their distances; they also make the target complete if `covers` says so."""
        inside = self._area.contains(points)
        counts = inside & np.isfinite(distances)
        if self._max_distance is not None:
            counts &= np.abs(distances) <= self._max_distance
        measured = distances[counts]
        self._lengths.add(measured)
        self._n_inside += int(np.count_nonzero(inside))
        if self._tolerance is not None:
            self._n_within += int(np.count_nonzero(np.abs(measured) <= self._tolerance))
        if significant is not None:
            self._n_significant = (self._n_significant or 0) + int(np.count_nonzero(significant[counts]))
        if covers:
            self._cells.occupy(points[inside], by_target=False)

    def cover_by_target(self, points: Floats) -> None:
        """Add points of the target."""
        # A cell on the rim belongs by its centre; a point in it may lie outside the outline.
        self._cells.occupy(points[self._area.box_contains(points)], by_target=True)

    def cover(self, points: Floats) -> None:
        """Add further points that make the target complete."""
        self._cells.occupy(points[self._area.contains(points)], by_target=False)

    def row(self) -> AreaStatistics:
        """Return the row of all that was added."""
        summed_up = self._lengths.statistics()
        n = len(self._lengths)
        few = "no data" if summed_up is None else f"fewer than {FEW_POINTS} points"
        shared: dict[str, Any] = {
            name: None if summed_up is None else getattr(summed_up, name)
            for name in ("mean", "best", "worst", "std", "rms", "median", "percentile_95")
        }
        before, after = self._cells.shares()
        return AreaStatistics(
            name=self._area.name,
            n_points=n,
            **shared,
            share_within=None if self._tolerance is None or n == 0 else self._n_within / n,
            share_significant=None if self._n_significant is None or n == 0 else self._n_significant / n,
            n_beyond=self._n_inside - n,
            completeness_before=before,
            completeness_after=after,
            remark=few if n < FEW_POINTS else "",
            outline=self._area.outline,
        )


class _Cells:
    """The cells of an area in plan, and which of them hold a point."""

    def __init__(self, area: Area, cell: float) -> None:
        x_min, y_min, x_max, y_max = area.geometry.bounds
        while np.ceil((x_max - x_min) / cell) * np.ceil((y_max - y_min) / cell) > _MOST_CELLS:
            cell *= 2
        self._cell, self._low = cell, (x_min, y_min)
        self._shape = int(np.ceil((x_max - x_min) / cell)), int(np.ceil((y_max - y_min) / cell))
        column, row = (index.ravel() for index in np.meshgrid(*map(np.arange, self._shape)))
        self._belongs = shapely.intersects_xy(
            area.geometry, x_min + (column + 0.5) * cell, y_min + (row + 0.5) * cell
        )
        self._by_target = np.zeros(len(self._belongs), dtype=bool)
        self._by_either = np.zeros(len(self._belongs), dtype=bool)

    def occupy(self, points: Floats, *, by_target: bool) -> None:
        """Mark the cells of points that lie in the box of the area."""
        at = [
            np.minimum(((points[:, axis] - self._low[axis]) / self._cell).astype(np.intp), n - 1)
            for axis, n in enumerate(self._shape)
        ]
        cells = at[1] * self._shape[0] + at[0]
        self._by_either[cells] = True
        if by_target:
            self._by_target[cells] = True

    def shares(self) -> tuple[float | None, float | None]:
        """Return the share of the area's cells with a point of the target, and with one of either cloud."""
        n_cells = np.count_nonzero(self._belongs)
        if n_cells == 0:
            return None, None
        before, after = (
            float(np.count_nonzero(held & self._belongs) / n_cells)
            for held in (self._by_target, self._by_either)
        )
        return before, after
