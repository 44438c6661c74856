"""The valley and its earthworks: stepped embankment, haul roads, building pad, pond, stockpiles, quarry.

Lengths that belong to the plan (where the dam stands, how high it is) grow with the size of the
site; lengths that belong to people and machines (berms, roads, the pad) do not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tmchho.simulate.arguments import stream
from tmchho.simulate.ground import Area, Array, Ground, grade, terrace, value_noise
from tmchho.simulate.materials import Material

# Distance between berms (drops), as shares of the embankment's height, from the crest down.
LIFT_SHARES = (0.18, 0.22, 0.19, 0.22, 0.19)
# Rows of the grid that are shaped at once.
BAND_ROWS = 128


@dataclass(frozen=True)
class Plan:
    """The numbers of one site, drawn from its seed; metres and radians."""

    size_m: float
    axis_rad: float
    crest_height_m: float
    crest_m: float
    curvature_m: float
    downstream_run: float
    berm_m: float
    low_block_share: float
    pad: tuple[float, float]
    pad_half_m: tuple[float, float]
    pad_yaw_rad: float
    pond: tuple[float, float]
    stockpiles: tuple[tuple[float, float, float], ...]
    ramp: tuple[tuple[float, float, float], ...]
    valley_road: tuple[tuple[float, float, float], ...]

    def floor(self, x: Array | float, y: Array | float) -> Array | float:
        """Height of the valley floor, which falls downstream (to the south) and a little to the west."""
        return 0.018 * y + 0.006 * x


def draw_plan(size_m: float, seed: int) -> Plan:
    """Draw the numbers of a site whose working area is `size_m` wide."""
    rng = stream(seed, "plan")

    def near(u: float, v: float, spread_m: float = 1.5) -> tuple[float, float]:
        shift = rng.uniform(-spread_m, spread_m, 2)
        return u * size_m + float(shift[0]), v * size_m + float(shift[1])

    height = size_m * float(rng.uniform(0.190, 0.210))
    low_block_share = float(rng.uniform(0.62, 0.70))

    def floor(u: float, v: float) -> float:
        return 0.018 * v * size_m + 0.006 * u * size_m

    ramp = [(0.62, -0.30, 0.0), (0.46, -0.125, 0.02), (0.16, 0.01, 0.28), (-0.12, 0.10, 0.56)]
    ramp += [(-0.37, 0.21, 0.90), (-0.43, 0.34, 1.0)]
    road = [(0.90, -2.90), (0.78, -0.85), (0.62, -0.30), (0.34, -0.205), (0.12, -0.185), (-0.08, -0.185)]
    road += [(-0.21, -0.30), (-0.19, -0.62), (0.12, -0.86), (0.78, -0.85)]
    return Plan(
        size_m=size_m,
        axis_rad=float(np.deg2rad(rng.uniform(7.0, 12.0))),
        crest_height_m=height,
        crest_m=size_m * float(rng.uniform(0.325, 0.345)),
        curvature_m=size_m * 0.10,
        downstream_run=float(rng.uniform(1.30, 1.45)),
        berm_m=float(rng.uniform(3.6, 4.6)),
        low_block_share=low_block_share,
        pad=near(-0.05, -0.345),
        pad_half_m=(13.5, 9.0),
        pad_yaw_rad=float(rng.uniform(0.15, 0.45)),
        pond=near(-0.295, -0.20),
        stockpiles=(
            (*near(0.27, -0.36), float(rng.uniform(6.0, 7.0))),
            (*near(0.435, -0.375), float(rng.uniform(3.4, 4.2))),
            (*near(0.13, -0.455), float(rng.uniform(2.4, 3.2))),
        ),
        ramp=tuple((u * size_m, v * size_m, floor(u, v) * (1.0 - s) + 0.4 + s * height) for u, v, s in ramp),
        valley_road=tuple((u * size_m, v * size_m, floor(u, v) + 0.3) for u, v in road),
    )


def build_ground(plan: Plan, area: Area, cell_m: float, seed: int) -> Ground:
    """Shape the ground of `area` as a grid of `cell_m`, without anything that stands on it."""
    # Nodes lie at whole multiples of the cell, so that areas of one site share their nodes.
    x = np.arange(np.floor(area.west / cell_m), np.ceil(area.east / cell_m) + 1.0) * cell_m
    y = np.arange(np.floor(area.south / cell_m), np.ceil(area.north / cell_m) + 1.0) * cell_m
    heights = np.empty((len(y), len(x)))
    materials = np.empty(heights.shape, dtype=np.uint8)
    # Every step looks at one place at a time: bands of rows keep the memory small.
    for first in range(0, len(y), BAND_ROWS):
        band = slice(first, first + BAND_ROWS)
        heights[band], materials[band] = _shape_ground(plan, x, y[band], seed)
    return Ground(heights, materials, float(x[0]), float(y[0]), cell_m)


def _shape_ground(plan: Plan, x: Array, y: Array, seed: int) -> tuple[Array, NDArray[np.uint8]]:
    """Heights and materials on the grid spanned by two axes."""
    heights, materials, roughness = _valley(plan, x, y, seed)
    _embankment(plan, x, y, heights, materials, roughness, seed)
    _works(plan, x, y, heights, materials, roughness)
    for wavelength_m, amplitude_m in ((3.1, 0.24), (1.37, 0.14), (0.61, 0.05)):
        noise = value_noise(x, y, wavelength_m, seed, f"rough {wavelength_m}")
        noise *= amplitude_m * roughness
        heights += noise
    _pond(plan, x, y, heights, materials)
    return heights, materials


def _valley(plan: Plan, x: Array, y: Array, seed: int) -> tuple[Array, NDArray[np.uint8], Array]:
    """Valley floor between two unlike abutments, a quarry in the western one."""
    size = plan.size_m
    east, north = x[None, :], y[:, None]
    broad = value_noise(x, y, 0.83 * size, seed, "broad")
    middle = value_noise(x, y, 0.31 * size, seed, "middle")
    fine = value_noise(x, y, 11.3, seed, "fine")

    toe_west = -0.385 * size + 0.10 * north + (9.0 / 120.0) * size * broad + 2.5 * fine
    toe_east = 0.93 * size - 0.16 * north + 0.12 * size * middle + 2.0 * fine
    rise_west = np.maximum(toe_west - east, 0.0)
    rise_east = np.maximum(east - toe_east, 0.0)
    top = 0.62 * size
    west = top * (1.0 - np.exp(-1.15 * rise_west / top))
    west += np.minimum(0.25 * rise_west, 4.0) * (1.0 - np.abs(fine)) * 1.2
    off_quarry = np.hypot(east + 0.86 * size, north + 0.42 * size) - 0.33 * size
    share = np.clip(-off_quarry / (0.05 * size), 0.0, 1.0)
    west += share * (terrace(west, 7.5, 0.55) - west)
    slopes = west + 0.85 * top * (1.0 - np.exp(-0.72 * rise_east / top))
    climb = np.minimum(slopes / 6.0, 1.0)
    slopes += climb * (0.030 * size * middle + 1.6 * fine)

    heights = np.asarray(plan.floor(east, north) + 0.9 * middle + 0.28 * fine * (1.0 - climb) + slopes)
    grassy = broad + 0.6 * middle + 0.5 * fine + np.where(slopes < 1.0, -0.25, 0.0)
    materials = np.where(slopes > 1.2, Material.ROCK, Material.EARTH).astype(np.uint8)
    # Nothing grows where people work: less and less towards the middle.
    grassy = grassy - np.clip(5.0 * (0.78 - np.hypot(east, north) / size), 0.0, 2.0)
    materials[(grassy > 0.22) & (share == 0.0)] = Material.GRASS
    return heights, materials, 0.30 + 1.5 * climb * (1.0 - 0.6 * share)


def _embankment(
    plan: Plan,
    x: Array,
    y: Array,
    heights: Array,
    materials: NDArray[np.uint8],
    roughness: Array,
    seed: int,
) -> None:
    """Raise the dam: stepped downstream face, two blocks of different height, plain upstream face."""
    east, north = x[None, :], y[:, None]
    along = east * np.cos(plan.axis_rad) + north * np.sin(plan.axis_rad)
    across = north * np.cos(plan.axis_rad) - east * np.sin(plan.axis_rad)
    out = plan.crest_m - plan.curvature_m * (along / plan.size_m) ** 2 - across
    out += 0.9 * value_noise(x, y, 17.0, seed, "edge") + 0.45 * value_noise(x, y, 4.3, seed, "edge fine")

    crest_width = 0.62 * plan.size_m
    # Run and height of the cross-section's corners, from deep under the upstream face to downstream.
    corners = [(-crest_width - 1.5 * (plan.crest_height_m + 60.0), -60.0)]
    corners += [(-crest_width, plan.crest_height_m), (0.0, plan.crest_height_m)]
    run, level = 0.0, plan.crest_height_m
    on_berm = np.zeros(out.shape, dtype=bool)
    for share in LIFT_SHARES:
        drop = share * plan.crest_height_m
        run, level = run + drop * plan.downstream_run, level - drop
        corners.append((run, level))
        on_berm |= (out > run) & (out < run + plan.berm_m)
        run, level = run + plan.berm_m, level - 0.12
        corners.append((run, level))
    corners[-1] = (corners[-2][0] + 60.0 * plan.downstream_run, corners[-2][1] - 60.0)
    profile = np.interp(out, *np.transpose(corners))

    low = plan.low_block_share * plan.crest_height_m
    ends = (-0.10 * plan.size_m, 0.09 * plan.size_m)
    top = np.interp(along + 0.12 * across, ends, (plan.crest_height_m, low))
    top = top + 0.006 * across + 0.10 * value_noise(x, y, 23.0, seed, "top")
    body = np.minimum(profile, top)

    raised = body > heights
    heights[raised] = body[raised]
    flat = raised & ((profile >= top) | (out < 0.0) | on_berm)
    materials[raised] = Material.ROCKFILL
    materials[flat] = Material.FILL
    roughness[raised] = 1.0
    roughness[flat] = 0.22


def _works(
    plan: Plan, x: Array, y: Array, heights: Array, materials: NDArray[np.uint8], roughness: Array
) -> None:
    """Cut and fill the haul roads and the building pad, heap up the stockpiles."""
    for line, half_width_m in ((plan.valley_road, 3.4), (plan.ramp, 4.2)):
        bed = grade(heights, x, y, line, half_width_m, 0.85)
        materials[bed] = Material.ROAD
        roughness[bed] = 0.12

    # The pad is a short and very wide road.
    level = float(plan.floor(*plan.pad)) + 0.7
    half_long, half_wide = plan.pad_half_m
    reach = half_long - half_wide
    step = (reach * np.cos(plan.pad_yaw_rad), reach * np.sin(plan.pad_yaw_rad))
    ends = [(plan.pad[0] + sign * step[0], plan.pad[1] + sign * step[1], level) for sign in (-1.0, 1.0)]
    bed = grade(heights, x, y, ends, half_wide, 0.7)
    materials[bed] = Material.CONCRETE
    roughness[bed] = 0.06

    for centre_x, centre_y, top in plan.stockpiles:
        distance = np.hypot(x[None, :] - centre_x, 1.15 * (y[:, None] - centre_y))
        cone = float(plan.floor(centre_x, centre_y)) + top - np.maximum(distance - 0.6, 0.0) * 0.72
        raised = cone > heights
        heights[raised] = cone[raised]
        materials[raised] = Material.GRAVEL
        roughness[raised] = 0.5


def _pond(plan: Plan, x: Array, y: Array, heights: Array, materials: NDArray[np.uint8]) -> None:
    """Dig the seepage pond at the toe of the western abutment and fill it with still water."""
    distance = np.hypot((x[None, :] - plan.pond[0]) / 1.0, (y[:, None] - plan.pond[1]) / 1.35)
    water = float(plan.floor(*plan.pond)) - 1.3
    bottom = water - 1.0 + np.maximum(distance - 3.5, 0.0) * 0.8
    dug = bottom < heights
    heights[dug] = bottom[dug]
    under = dug & (heights < water)
    heights[under] = water
    materials[under] = Material.WATER
