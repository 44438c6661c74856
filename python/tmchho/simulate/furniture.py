"""What stands on the site: machines, the building, containers, silos, the conveyor and boulders."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from tmchho.simulate.arguments import stream
from tmchho.simulate.earthworks import Plan
from tmchho.simulate.ground import Area, Ground
from tmchho.simulate.materials import Material
from tmchho.simulate.solids import Shape, Solid, random_rotation, turned

# Edge of the map cells that draw their boulders and stray machines from a generator of their own.
MAP_CELL_M = 30.0


class Part(NamedTuple):
    """One solid of a model: metres in the model's frame, x forward, z up, origin on the ground."""

    shape: Shape
    centre: tuple[float, float, float]
    size: tuple[float, float, float]
    material: Material
    pitch_deg: float = 0.0
    roll_deg: float = 0.0


def _wheel(x: float, y: float, diameter: float, width: float) -> Part:
    """Return a wheel or drum on the ground, its axis across the machine."""
    size = (diameter, diameter, width)
    return Part("cylinder", (x, y, 0.5 * diameter), size, Material.DARK_STEEL, 0.0, 90.0)


_YELLOW, _DARK, _GLASS = Material.YELLOW_STEEL, Material.DARK_STEEL, Material.GLASS

EXCAVATOR = (
    Part("box", (0.0, 1.25, 0.5), (4.4, 0.7, 1.0), _DARK),
    Part("box", (0.0, -1.25, 0.5), (4.4, 0.7, 1.0), _DARK),
    Part("box", (-0.5, 0.0, 1.75), (4.2, 2.8, 1.3), _YELLOW),
    Part("box", (1.0, 0.85, 2.35), (1.7, 1.0, 1.9), _GLASS),
    Part("box", (3.3, -0.2, 3.5), (5.6, 0.55, 0.75), _YELLOW, 34.0),
    Part("box", (6.15, -0.2, 3.35), (3.6, 0.45, 0.6), _YELLOW, -68.0),
    Part("box", (6.5, -0.2, 1.1), (1.2, 1.4, 1.1), _DARK, -30.0),
)
TRUCK = (
    *(_wheel(x, y, 1.5, 0.6) for x in (2.9, -0.9, -2.5) for y in (1.2, -1.2)),
    Part("box", (0.2, 0.0, 1.15), (7.8, 1.5, 0.5), _DARK),
    Part("box", (3.3, 0.0, 2.2), (1.7, 2.6, 2.0), _YELLOW),
    Part("box", (4.05, 0.0, 2.6), (0.3, 2.3, 0.9), _GLASS),
    Part("box", (-1.0, 0.0, 1.6), (5.4, 2.6, 0.25), _YELLOW, -4.0),
    Part("box", (-1.0, 1.3, 2.25), (5.4, 0.2, 1.2), _YELLOW, -4.0),
    Part("box", (-1.0, -1.3, 2.25), (5.4, 0.2, 1.2), _YELLOW, -4.0),
    Part("box", (1.75, 0.0, 2.6), (0.2, 2.6, 1.9), _YELLOW),
    Part("ellipsoid", (-1.1, 0.0, 2.2), (4.2, 2.3, 1.5), Material.GRAVEL),
)
ROLLER = (
    _wheel(1.9, 0.0, 1.6, 2.2),
    _wheel(-1.5, 0.95, 1.5, 0.5),
    _wheel(-1.5, -0.95, 1.5, 0.5),
    Part("box", (-1.4, 0.0, 1.35), (2.6, 1.7, 0.9), _YELLOW),
    Part("box", (-0.1, 0.0, 2.1), (1.4, 1.5, 1.7), _GLASS),
    Part("box", (-0.1, 0.0, 3.02), (1.8, 1.8, 0.15), _YELLOW),
)
DOZER = (
    Part("box", (0.0, 1.05, 0.6), (3.8, 0.6, 1.2), _DARK),
    Part("box", (0.0, -1.05, 0.6), (3.8, 0.6, 1.2), _DARK),
    Part("box", (0.5, 0.0, 1.3), (3.0, 1.5, 1.3), _YELLOW),
    Part("box", (-1.0, 0.0, 2.2), (1.5, 1.6, 1.6), _GLASS),
    Part("box", (2.7, 0.0, 0.75), (0.35, 3.9, 1.4), _YELLOW, 8.0),
)
OFFICE = (
    Part("box", (0.0, 0.0, 2.1), (13.0, 7.6, 4.6), Material.WALL),
    Part("box", (0.0, 0.0, 4.85), (12.8, 3.4, 1.0), Material.WALL),
    # Two roof slabs of 22 degrees with eaves 1.2 m wide, and a porch on posts.
    Part("box", (0.0, 2.52, 5.08), (15.0, 5.75, 0.22), Material.ROOF, 0.0, -22.0),
    Part("box", (0.0, -2.52, 5.08), (15.0, 5.75, 0.22), Material.ROOF, 0.0, 22.0),
    Part("box", (3.9, 1.3, 6.5), (0.9, 0.9, 2.2), Material.WALL),
    Part("box", (-8.3, -0.8, 3.0), (3.8, 4.6, 0.2), Material.ROOF),
    Part("cylinder", (-9.9, 1.2, 1.4), (0.3, 0.3, 3.0), _DARK),
    Part("cylinder", (-9.9, -2.8, 1.4), (0.3, 0.3, 3.0), _DARK),
)
BLUE_CONTAINER = (Part("box", (0.0, 0.0, 1.25), (6.1, 2.44, 2.6), Material.BLUE_STEEL),)
RED_CONTAINERS = (
    Part("box", (0.0, 0.0, 1.25), (6.1, 2.44, 2.6), Material.RED_STEEL),
    Part("box", (1.1, 0.2, 3.86), (6.1, 2.44, 2.6), Material.WALL),
)
SILOS = (
    Part("cylinder", (0.0, 0.0, 4.6), (3.2, 3.2, 9.4), Material.WALL),
    Part("cylinder", (4.1, 0.6, 3.4), (2.6, 2.6, 7.0), Material.CONCRETE),
    Part("box", (1.6, -2.7, 1.6), (2.6, 2.2, 3.4), Material.BLUE_STEEL),
)
CRUSHER = (
    Part("box", (0.0, 0.0, 1.9), (3.6, 3.0, 4.0), Material.BLUE_STEEL),
    Part("box", (-2.4, 0.0, 3.3), (1.9, 3.8, 1.3), _YELLOW, -25.0),
    Part("box", (6.6, 0.0, 5.1), (11.4, 1.1, 0.5), _YELLOW, 23.0),
    Part("box", (8.3, 0.0, 2.7), (0.4, 1.3, 5.6), _DARK),
)
STRAY_MODELS = (EXCAVATOR, TRUCK, DOZER, BLUE_CONTAINER, RED_CONTAINERS, ROLLER)


def place(parts: Iterable[Part], x: float, y: float, z: float, yaw_rad: float) -> list[Solid]:
    """Stand a model at a place of the site, turned by `yaw_rad` to the left."""
    turn = turned(yaw_rad)
    solids = []
    for part in parts:
        axes = turn @ turned(0.0, np.deg2rad(part.pitch_deg), np.deg2rad(part.roll_deg))
        centre = turn @ np.asarray(part.centre) + (x, y, z)
        solids.append(Solid(part.shape, centre, axes, 0.5 * np.asarray(part.size), part.material))
    return solids


def furnish(plan: Plan, ground: Ground, area: Area, seed: int) -> list[Solid]:
    """Put everything that stands on the ground of `area` into place."""
    works = _working_area(plan, ground, seed)
    boulders = _boulders(plan, ground, area, seed)
    return works + _stray_machines(plan, ground, area, seed) + boulders


def _working_area(plan: Plan, ground: Ground, seed: int) -> list[Solid]:
    """Machines at their work, the office on its pad, silos, and the crusher that feeds a stockpile."""
    rng = stream(seed, "furniture")
    size = plan.size_m
    solids: list[Solid] = []

    def put(model: tuple[Part, ...], x: float, y: float, yaw_rad: float, spread_m: float = 1.5) -> None:
        shift = rng.uniform(-spread_m, spread_m, 2)
        x, y = x + float(shift[0]), y + float(shift[1])
        yaw_rad += float(rng.uniform(-0.3, 0.3)) if spread_m else 0.0
        z = float(ground.height(np.array([x]), np.array([y]))[0])
        solids.extend(place(model, x, y, z - 0.08, yaw_rad))

    cos, sin = np.cos(plan.pad_yaw_rad), np.sin(plan.pad_yaw_rad)
    model: tuple[Part, ...]
    for model, along, across, yaw_rad in (
        (OFFICE, -1.5, -0.5, 0.0),
        (BLUE_CONTAINER, 10.8, 4.0, 1.35),
        (RED_CONTAINERS, 9.5, -4.2, 0.25),
    ):
        x, y = plan.pad[0] + cos * along - sin * across, plan.pad[1] + sin * along + cos * across
        put(model, x, y, plan.pad_yaw_rad + yaw_rad, 0.0)

    heap_x, heap_y, _ = plan.stockpiles[0]
    yaw_rad = float(rng.uniform(-0.5, -0.2))
    put(CRUSHER, heap_x - 11.8 * np.cos(yaw_rad), heap_y - 11.8 * np.sin(yaw_rad), yaw_rad, 0.0)
    put(SILOS, -0.245 * size, -0.40 * size, 0.6)
    for model, u, v, yaw_rad in (
        (EXCAVATOR, 0.37, -0.27, -2.3),
        (TRUCK, 0.24, -0.195, 0.1),
        (TRUCK, -0.19, -0.235, 2.4),
        (EXCAVATOR, -0.24, -0.135, 3.6),
        (DOZER, 0.30, 0.42, 0.5),
        (ROLLER, 0.12, 0.36, -0.2),
        (TRUCK, -0.28, 0.40, 1.9),
        (EXCAVATOR, -0.06, 0.44, 0.3),
    ):
        put(model, u * size, v * size, yaw_rad)
    start, end = np.array(plan.ramp[2]), np.array(plan.ramp[3])
    middle = start + float(rng.uniform(0.3, 0.6)) * (end - start)
    put(TRUCK, middle[0], middle[1], float(np.arctan2(end[1] - start[1], end[0] - start[0])), 0.0)
    return solids


def _map_cells(area: Area) -> list[tuple[int, int]]:
    """Numbers of the map cells that touch an area."""
    rows = range(int(area.south // MAP_CELL_M), int(area.north // MAP_CELL_M) + 1)
    columns = range(int(area.west // MAP_CELL_M), int(area.east // MAP_CELL_M) + 1)
    return [(row, column) for row in rows for column in columns]


def _stray_machines(plan: Plan, ground: Ground, area: Area, seed: int) -> list[Solid]:
    """Machines and containers here and there on gentle ground outside the working area."""
    solids: list[Solid] = []
    for row, column in _map_cells(area):
        rng = stream(seed, "strays", row, column)
        x, y = (np.array([column, row]) + rng.random(2)) * MAP_CELL_M
        yaw_rad, chance = float(rng.uniform(0.0, 2.0 * np.pi)), rng.random()
        model = STRAY_MODELS[int(rng.integers(len(STRAY_MODELS)))]
        place_x, place_y = np.array([x]), np.array([y])
        around = ground.height(x + np.array([-4.0, 4.0, 0.0, 0.0]), y + np.array([0.0, 0.0, -4.0, 4.0]))
        steep = np.ptp(around) > 2.0
        outside = max(abs(x), abs(y)) > 0.5 * plan.size_m + 6.0
        if outside and not steep and chance < 0.35 and area.contains(place_x, place_y)[0]:
            z = float(ground.height(place_x, place_y)[0])
            solids.extend(place(model, float(x), float(y), z - 0.08, yaw_rad))
    return solids


# Boulders per 100 m² of each material; none where people and machines keep the ground clear.
_BOULDERS_PER_100_M2 = {
    Material.ROCK: 1.6,
    Material.EARTH: 0.9,
    Material.GRASS: 0.5,
    Material.ROCKFILL: 1.8,
    Material.FILL: 0.25,
    Material.GRAVEL: 0.3,
}


def _boulders(plan: Plan, ground: Ground, area: Area, seed: int) -> list[Solid]:
    """Boulders of 0.3 to 2.4 m, half sunk into the ground, thicker on rock and rockfill."""
    densest = max(_BOULDERS_PER_100_M2.values())
    share = np.zeros(len(Material))
    for material, density in _BOULDERS_PER_100_M2.items():
        share[material] = density / densest
    solids: list[Solid] = []
    for row, column in _map_cells(area):
        rng = stream(seed, "boulders", row, column)
        count = int(rng.poisson(densest * MAP_CELL_M**2 / 100.0))
        x, y = ((np.array([column, row]) + rng.random((count, 2))) * MAP_CELL_M).T
        sizes = np.clip(np.exp(rng.normal(-0.75, 0.55, count)), 0.3, 2.0)[:, None]
        half_m = sizes * rng.uniform(0.65, 1.2, (count, 3))
        kept = (rng.random(count) < share[ground.material(x, y)]) & area.contains(x, y)
        z = ground.height(x, y) + half_m.min(axis=1) * rng.uniform(0.0, 0.5, count)
        rotations = [random_rotation(rng) for _ in range(count)]
        solids.extend(
            Solid("ellipsoid", np.array([x[i], y[i], z[i]]), rotations[i], half_m[i], Material.BOULDER)
            for i in np.flatnonzero(kept)
        )
    return solids
