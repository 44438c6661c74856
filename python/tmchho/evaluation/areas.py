"""Areas of a survey, and how far the clouds lie apart in each: the rows of the article's Table 7.

Why: one figure for a whole site hides the corner that does not fit. A surveyor signs for named areas.
Source: Ren, Zhao & Han (2023), Section 5.3, Table 7 and Figure 15: five areas, which the article does not
define. Deviates: areas are polygons of the caller, or five strips along the overlap of equal surface.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from tmchho.arguments import checked_count, checked_number
from tmchho.errors import InvalidArgumentError
from tmchho.evaluation.lengths import Lengths
from tmchho.evaluation.tally import AreaStatistics, AreaTally, Outline

N_AUTOMATIC_AREAS = 5
# Automatic areas differ by about one part in as many.
_CELLS_PER_AREA, _MOST_HALVINGS = 20, 8

Floats = NDArray[np.float64]


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
    return areas_of_parts(lambda: [overlap], cell, n_areas)


def areas_of_parts(
    parts: Callable[[], Iterable[Floats]], cell: float, n_areas: int = N_AUTOMATIC_AREAS
) -> tuple[Area, ...]:
    """Do what `automatic_areas` does with an overlap that `parts` gives part by part, as often as asked."""
    cell = checked_number("cell", cell)
    n_areas = checked_count("n_areas", n_areas, 1)
    lowest = [part[:, :2].min(axis=0) for part in parts() if len(part)]
    if not lowest:
        return ()
    origin = np.min(lowest, axis=0)

    def occupied(cell: float) -> Floats:
        cells = np.empty((0, 2))
        for part in parts():
            here = np.unique(np.floor((part[:, :2] - origin) / cell), axis=0)
            cells = np.unique(np.concatenate([cells, here]), axis=0) if len(cells) else here
        return cells

    cells = occupied(cell)
    for _ in range(_MOST_HALVINGS):  # a small overlap is cut finely enough for even areas
        if len(cells) >= _CELLS_PER_AREA * n_areas:
            break
        cell /= 2
        cells = occupied(cell)
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
    rows = []
    for area in areas:
        tally = AreaTally(area, cell, Lengths(), tolerance=tolerance, max_distance=max_distance)
        tally.add(points, distances, significant, covers=other is None)
        tally.cover_by_target(target)
        if other is not None:
            tally.cover(other)
        rows.append(tally.row())
    return tuple(rows)


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
