"""The rockfill-dam construction site as a scene: ground, solids on it, and the two survey areas."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tmchho.arguments import checked_number, checked_seed
from tmchho.errors import InvalidArgumentError
from tmchho.simulate.arguments import checked_offset
from tmchho.simulate.earthworks import build_ground, draw_plan
from tmchho.simulate.furniture import furnish
from tmchho.simulate.ground import Area, Ground
from tmchho.simulate.solids import Solid

# Ground beyond the survey areas, for slopes and shadows at their rims, in metres.
MARGIN_M = 3.0
# The finest ground grid, and the most cells along a side before the grid gets coarser.
FINEST_CELL_M = 0.25
MAX_CELLS = 2400


@dataclass(frozen=True, eq=False)
class Site:
    """A made construction site in its own frame: metres, x east, y north, z up.

    Parameters
    ----------
    ground : Ground
        The terrain with its earthworks.
    solids : tuple of Solid
        Boulders, machines, the building and whatever else stands on the ground.
    scanner_area : Area
        The square that the scanner surveys, around the origin.
    photogrammetry_area : Area
        The square that the photogrammetry covers.
    """

    ground: Ground
    solids: tuple[Solid, ...]
    scanner_area: Area
    photogrammetry_area: Area

    def surface(self, area: Area) -> tuple[Ground, NDArray[np.int32]]:
        """Return what is seen from above: the top surface as a grid, and the number of the solid there.

        Parameters
        ----------
        area : Area
            Part of the site to cover, in metres.

        Returns
        -------
        top : Ground
            Heights and materials of the top surface at the nodes of the ground's grid.
        owner : (n_y, n_x) int32 array
            Index into `solids`, -1 where the bare ground is on top.
        """
        ground, cell = self.ground, self.ground.cell_m
        n_y, n_x = ground.heights.shape
        column_0 = int(np.clip(np.floor((area.west - ground.west) / cell), 0, n_x - 2))
        column_1 = int(np.clip(np.ceil((area.east - ground.west) / cell), 1, n_x - 1)) + 1
        row_0 = int(np.clip(np.floor((area.south - ground.south) / cell), 0, n_y - 2))
        row_1 = int(np.clip(np.ceil((area.north - ground.south) / cell), 1, n_y - 1)) + 1
        heights = ground.heights[row_0:row_1, column_0:column_1].copy()
        materials = ground.materials[row_0:row_1, column_0:column_1].copy()
        owner = np.full(heights.shape, -1, dtype=np.int32)
        west, south = ground.west + column_0 * cell, ground.south + row_0 * cell
        for index, solid in enumerate(self.solids):
            radius = solid.radius_m
            reach = [(solid.centre[0] - west) / cell, (solid.centre[1] - south) / cell]
            columns = _window(reach[0], radius / cell, heights.shape[1])
            rows = _window(reach[1], radius / cell, heights.shape[0])
            if columns.start >= columns.stop or rows.start >= rows.stop:
                continue
            x = west + cell * np.arange(columns.start, columns.stop)
            y = south + cell * np.arange(rows.start, rows.stop)
            above = solid.centre[2] + radius + 1.0
            starts = np.empty((len(y), len(x), 3))
            starts[..., 0], starts[..., 1], starts[..., 2] = x[None, :], y[:, None], above
            fall = solid.first_hit(starts.reshape(-1, 3), np.array([0.0, 0.0, -1.0]))
            top = above - fall.reshape(len(y), len(x))
            higher = top > heights[rows, columns]
            heights[rows, columns][higher] = top[higher]
            materials[rows, columns][higher] = solid.material
            owner[rows, columns][higher] = index
        return Ground(heights, materials, west, south, cell), owner


def _window(middle: float, reach: float, length: int) -> slice:
    """Grid indices within `reach` of a fractional index."""
    start = max(int(np.ceil(middle - reach)), 0)
    return slice(start, max(min(int(np.floor(middle + reach)) + 1, length), start))


def make_site(
    *,
    size_m: float = 120.0,
    area_ratio: float = 4.0,
    overlap: float = 1.0,
    centre_offset: tuple[float, float] = (-0.55, 0.35),
    cell_m: float | None = None,
    seed: int = 0,
) -> Site:
    """Make a rockfill-dam construction site: the same one for the same seed and size.

    A valley with two unlike abutments, a stepped embankment in two blocks of different height, haul
    roads, a building pad, a pond, stockpiles and a quarry; on it an office with eaves, silos, a
    crusher with its conveyor, containers, machines and hundreds of boulders. Nothing repeats, so
    there is only one right pose between two surveys of it.

    Parameters
    ----------
    size_m : float, default 120
        Side of the square that the scanner surveys, in metres; 80 to 600.
    area_ratio : float, default 4
        Area of the photogrammetry's square over that of the scanner's; 1 to 16.
    overlap : float, default 1
        Share of the scanner's square that the photogrammetry covers; 0.3 to 1.
    centre_offset : (float, float), default (-0.55, 0.35)
        Where the photogrammetry's square lies relative to the scanner's (east, north): 0 is
        centred, ±1 lets them share that edge. Where `overlap` is below 1 the first number gives
        way to it.
    cell_m : float, optional
        Cell of the ground's grid. By default 0.25 m, coarser where a side would have more than
        2400 cells.
    seed : int, default 0
        Fixes everything.

    Returns
    -------
    Site

    Raises
    ------
    InvalidArgumentError
        If an argument is out of its range.
    """
    size_m = checked_number("size_m", size_m, 80.0, 600.0)
    ratio = checked_number("area_ratio", area_ratio, 1.0, 16.0)
    overlap = checked_number("overlap", overlap, 0.3, 1.0)
    offset = checked_offset("centre_offset", centre_offset)
    seed = checked_seed(seed)

    half = 0.5 * size_m
    scanner_area = Area(-half, -half, half, half)
    wide = half * float(np.sqrt(ratio))
    middle_x, middle_y = offset[0] * (wide - half), offset[1] * (wide - half)
    if overlap < 1.0:
        # Its eastern edge cuts the scanner's square.
        middle_x = -half + overlap * size_m - wide
    flown = Area(middle_x - wide, middle_y - wide, middle_x + wide, middle_y + wide)
    whole = Area(
        min(-half, flown.west) - MARGIN_M,
        min(-half, flown.south) - MARGIN_M,
        max(half, flown.east) + MARGIN_M,
        max(half, flown.north) + MARGIN_M,
    )
    longest = max(whole.east - whole.west, whole.north - whole.south)
    if cell_m is None:
        cell_m = max(FINEST_CELL_M, longest / MAX_CELLS)
    else:
        cell_m = checked_number("cell_m", cell_m, 0.05, 2.0)
        if longest / cell_m > 4 * MAX_CELLS:
            raise InvalidArgumentError(
                f"cell_m = {cell_m:g} would make a grid of {longest / cell_m:.0f} cells along a side; "
                f"use at least {longest / (4 * MAX_CELLS):.2g}"
            )
    plan = draw_plan(size_m, seed)
    ground = build_ground(plan, whole, cell_m, seed)
    solids = furnish(plan, ground, whole, seed)
    return Site(ground, tuple(solids), scanner_area, flown)
