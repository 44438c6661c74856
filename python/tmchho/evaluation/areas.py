"""Areas of a survey, and how far the clouds lie apart in each: the rows of the article's Table 7.

Why: one figure for a whole site hides the corner that does not fit. A surveyor signs for named areas.
Source: Ren, Zhao & Han (2023), Section 5.3, Table 7 and Figure 15: five areas, which the article does not
define. Deviates: areas are polygons of the caller, or five strips along the overlap of equal surface.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from tmchho.arguments import checked_count, checked_number
from tmchho.errors import InvalidArgumentError
from tmchho.results import DistanceStatistics

N_AUTOMATIC_AREAS = 5
# Fewer points than this say little about an area; its row says so.
FEW_POINTS = 30
# Cells in which completeness is counted; a large area gets larger cells.
_MOST_CELLS = 1 << 20
# Automatic areas differ by about one part in as many.
_CELLS_PER_AREA, _MOST_HALVINGS = 20, 8

Floats = NDArray[np.float64]
Outline = tuple[tuple[tuple[tuple[float, float], ...], ...], ...]


@dataclass(frozen=True, eq=False)
class Area:
    """A part of the site, seen from above.

    Parameters
    ----------
    name : str
        How its row is called.
    geometry : shapely Polygon or MultiPolygon
        Its outline in the coordinates of the target; holes belong to it. Outlines that cross themselves are
        repaired.
    heights : tuple of float, optional
        Lowest and highest z that still belong to it; all heights where not given.

    Raises
    ------
    InvalidArgumentError
        If the geometry has no surface.

    Examples
    --------
    >>> Area.box("pad", 0, 0, 4, 2).contains([[1.0, 1.0, 0.0], [5.0, 1.0, 0.0]])
    array([ True, False])
    """

    name: str
    geometry: Any
    heights: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "geometry", _polygons(self.name, self.geometry))
        shapely.prepare(self.geometry)

    @classmethod
    def box(
        cls,
        name: str,
        x_min: float,
        y_min: float,
        x_max: float,
        y_max: float,
        heights: tuple[float, float] | None = None,
    ) -> Area:
        """Return a rectangle whose sides follow the axes."""
        return cls(name, shapely.box(x_min, y_min, x_max, y_max), heights)

    def contains(self, points: Any) -> NDArray[np.bool_]:
        """Tell which points lie inside or on the outline.

        Parameters
        ----------
        points : (n, 3) or (n, 2) array_like
            Without heights, only the outline is asked. NaN lies outside.

        Returns
        -------
        (n,) bool array
        """
        xyz = np.asarray(points, dtype=np.float64)
        inside = self.box_contains(xyz)
        near = np.flatnonzero(inside)
        inside[near] = shapely.intersects_xy(self.geometry, xyz[near, 0], xyz[near, 1])
        return inside

    def box_contains(self, points: Floats) -> NDArray[np.bool_]:
        """Tell the same of the box around the area, whose sides follow the axes."""
        x_min, y_min, x_max, y_max = self.geometry.bounds
        x, y = points[:, 0], points[:, 1]
        inside = (x >= x_min) & (x <= x_max) & (y >= y_min) & (y <= y_max)
        if self.heights is not None and points.shape[1] == 3:
            inside &= (points[:, 2] >= self.heights[0]) & (points[:, 2] <= self.heights[1])
        return np.asarray(inside)

    @property
    def outline(self) -> Outline:
        """Polygons, each a closed outer ring and then its holes, each a row of (x, y)."""
        return tuple(
            tuple(
                tuple((float(x), float(y)) for x, y in shapely.get_coordinates(ring))
                for ring in (polygon.exterior, *polygon.interiors)
            )
            for polygon in shapely.get_parts(self.geometry)
        )


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


def automatic_areas(overlap: Floats, cell: float, n_areas: int = N_AUTOMATIC_AREAS) -> tuple[Area, ...]:
    """Cut the overlap into strips across its main axis, each with the same surface seen from above.

    Parameters
    ----------
    overlap : (n, 2) or (n, 3) float64 array
        Points of the overlap. Each occupied cell counts once, so that a place full of points is no larger.
    cell : float
        Edge of the cells, above 0; halved where the overlap has few of them.
    n_areas : int, default 5
        At least 1.

    Returns
    -------
    tuple of Area
        Rectangles called "area 1", … from west to east (from south to north on an axis nearer to that); none
        where the overlap has fewer places than there are to be areas.
    """
    cell = checked_number("cell", cell)
    n_areas = checked_count("n_areas", n_areas, 1)
    if len(overlap) == 0:
        return ()
    origin = overlap[:, :2].min(axis=0)
    local = overlap[:, :2] - origin
    cells = np.unique(np.floor(local / cell), axis=0)
    for _ in range(_MOST_HALVINGS):  # a small overlap is cut finely enough for even areas
        if len(cells) >= _CELLS_PER_AREA * n_areas:
            break
        cell /= 2
        cells = np.unique(np.floor(local / cell), axis=0)
    if len(cells) < n_areas:
        return ()
    centres = (cells + 0.5) * cell
    middle = centres.mean(axis=0)
    # Of a square either axis will do: eigh answers the same way every time.
    _, axes = np.linalg.eigh(np.cov(centres.T) if len(centres) > 1 else np.eye(2))
    along = axes[:, 1]
    along = along * np.sign(along[np.argmax(np.abs(along))])
    across = np.array([-along[1], along[0]])
    t, u = (centres - middle) @ along, (centres - middle) @ across
    margin = 0.5 * cell * np.abs(along).sum()
    limits = np.quantile(t, np.linspace(0.0, 1.0, n_areas + 1))
    limits[0], limits[-1] = limits[0] - margin, limits[-1] + margin
    areas = []
    for number, (low, high) in enumerate(pairwise(limits), start=1):
        width = u[(t >= low) & (t <= high)]
        if len(width) == 0 or not high > low:
            return ()
        left, right = width.min() - margin, width.max() + margin
        corners = [(low, left), (high, left), (high, right), (low, right)]
        ring = [tuple(origin + middle + a * along + b * across) for a, b in corners]
        areas.append(Area(f"area {number}", shapely.Polygon(ring)))
    return tuple(areas)


def measure_areas(
    areas: Sequence[Area],
    points: Floats,
    distances: Floats,
    target: Floats,
    *,
    cell: float,
    tolerance: float | None = None,
    max_distance: float | None = None,
    significant: NDArray[np.bool_] | None = None,
    other: Floats | None = None,
) -> tuple[AreaStatistics, ...]:
    """Sum up the distances of the points in each area.

    Parameters
    ----------
    areas : sequence of Area
        In target coordinates.
    points : (n, 3) float64 array
        Source points, or cores, in target coordinates.
    distances : (n,) float64 array
        Of these points, perhaps signed; NaN where there is none.
    target : (m, 3) float64 array
        The other cloud, for completeness.
    cell : float
        Edge of the cells in which completeness is counted, above 0: some spacings. Doubled where an area
        would have more than a million cells.
    tolerance : float, optional
        For `share_within`.
    max_distance : float, optional
        Points farther away have no counterpart: they are counted apart. All are measured where not given.
    significant : (n,) bool array, optional
        Whether the change at these points is.
    other : (k, 3) float64 array, optional
        Points that make the target complete, in target coordinates; `points` where not given.

    Returns
    -------
    tuple of AreaStatistics
        One for each area, in their order, also where there is no data.
    """
    counts = np.isfinite(distances)
    other = points if other is None else other
    if max_distance is not None:
        counts &= np.abs(distances) <= max_distance
    rows = []
    for area in areas:
        inside = area.contains(points)
        measured = distances[inside & counts]
        summed_up = DistanceStatistics.of(measured)
        before, after = _completeness(area, target, other[area.contains(other)], cell)
        few = "no data" if summed_up is None else f"fewer than {FEW_POINTS} points"
        shared: dict[str, Any] = {
            name: None if summed_up is None else getattr(summed_up, name)
            for name in ("mean", "best", "worst", "std", "rms", "median", "percentile_95")
        }
        within = np.abs(measured) <= (np.inf if tolerance is None else tolerance)
        rows.append(
            AreaStatistics(
                name=area.name,
                n_points=len(measured),
                **shared,
                share_within=None if tolerance is None or summed_up is None else float(within.mean()),
                share_significant=(
                    None
                    if significant is None or summed_up is None
                    else float(significant[inside & counts].mean())
                ),
                n_beyond=int(np.count_nonzero(inside)) - len(measured),
                completeness_before=before,
                completeness_after=after,
                remark=few if len(measured) < FEW_POINTS else "",
                outline=area.outline,
            )
        )
    return tuple(rows)


def _completeness(
    area: Area, target: Floats, source_inside: Floats, cell: float
) -> tuple[float | None, float | None]:
    """Return the share of the area's cells with a point of the target, and with one of either cloud."""
    x_min, y_min, x_max, y_max = area.geometry.bounds
    while np.ceil((x_max - x_min) / cell) * np.ceil((y_max - y_min) / cell) > _MOST_CELLS:
        cell *= 2
    n_x, n_y = int(np.ceil((x_max - x_min) / cell)), int(np.ceil((y_max - y_min) / cell))
    column, row = (index.ravel() for index in np.meshgrid(np.arange(n_x), np.arange(n_y)))
    belongs = shapely.intersects_xy(area.geometry, x_min + (column + 0.5) * cell, y_min + (row + 0.5) * cell)
    if not belongs.any():
        return None, None

    def occupied(points: Floats) -> NDArray[np.bool_]:
        at_x = np.minimum(((points[:, 0] - x_min) / cell).astype(np.intp), n_x - 1)
        at_y = np.minimum(((points[:, 1] - y_min) / cell).astype(np.intp), n_y - 1)
        found = np.zeros(n_x * n_y, dtype=bool)
        found[at_y * n_x + at_x] = True
        return np.asarray(found & belongs)

    # A cell on the rim belongs by its centre; a point in it may lie outside the outline.
    before = occupied(target[area.box_contains(target)])
    after = before | occupied(source_inside)
    n_cells = np.count_nonzero(belongs)
    return float(np.count_nonzero(before) / n_cells), float(np.count_nonzero(after) / n_cells)


def _polygons(name: str, geometry: Any) -> Any:
    """Return the polygons of a geometry as one, repaired where it crosses itself."""
    if not isinstance(geometry, shapely.Geometry):
        raise InvalidArgumentError(
            f"area '{name}': geometry must be of shapely, got {type(geometry).__name__}"
        )
    geometry = shapely.force_2d(geometry)
    if not np.isfinite(shapely.get_coordinates(geometry)).all():
        raise InvalidArgumentError(f"area '{name}': a coordinate of the outline is not finite")
    if not shapely.is_valid(geometry):
        geometry = shapely.make_valid(geometry)
    parts = [part for part in _flat_parts(geometry) if part.geom_type == "Polygon" and part.area > 0]
    if not parts:
        raise InvalidArgumentError(
            f"area '{name}': a {geometry.geom_type} has no surface; give a polygon of three corners or more"
        )
    return parts[0] if len(parts) == 1 else shapely.MultiPolygon(parts)


def _flat_parts(geometry: Any) -> list[Any]:
    parts = list(shapely.get_parts(geometry))
    return [
        inner
        for part in parts
        for inner in (_flat_parts(part) if part.geom_type.startswith(("Multi", "GeometryC")) else [part])
    ]
