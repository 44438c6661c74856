"""Pairs of generated clouds of which no pose may be accepted, or only the one that is known.

Each maker takes a random generator, whose seed is the variant of the pair, and returns the clouds at rest
and, where there is a true pose all the same, True: then they lie in their true place, and only an acceptance
anywhere else is false. Every cloud is drawn anew: no two share a point. Lengths are about those of a room.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from common import Array
from numpy.random import Generator

from tmchho.simulate import make_pair

Maker = Callable[[Generator], tuple[Array, Array, bool]]

N_POINTS = 9000
NOISE = 0.004
SITE_NOISE_M = 0.5
MIRROR = np.array([1.0, 1.0, -1.0])


def noisy(points: Array, rng: Generator, noise: float = NOISE) -> Array:
    return points + rng.normal(0, noise, points.shape)


# --- surfaces that slide or turn on themselves -------------------------------------------------------


def planes(rng: Generator) -> tuple[Array, Array, bool]:
    def plane() -> Array:
        return noisy(np.pad(rng.uniform(0, rng.uniform(1, 4, 2), (N_POINTS, 2)), ((0, 0), (0, 1))), rng)

    return plane(), plane(), False


def spheres(rng: Generator) -> tuple[Array, Array, bool]:
    lowest = rng.choice([-1.0, -0.5, 0.0, 0.4])

    def cap() -> Array:
        z, turn = rng.uniform(lowest, 1, N_POINTS), rng.uniform(0, 2 * np.pi, N_POINTS)
        level = np.sqrt(1 - z**2)
        return noisy(np.column_stack([level * np.cos(turn), level * np.sin(turn), z]), rng)

    return cap(), cap() * rng.choice([1.0, 1.0, 1.1]), False


def cylinders(rng: Generator) -> tuple[Array, Array, bool]:
    length, arc, capped = rng.uniform(1, 5), rng.choice([np.pi, 2 * np.pi]), rng.random() < 0.5

    def tube() -> Array:
        z, turn = rng.uniform(0, length, N_POINTS), rng.uniform(0, arc, N_POINTS)
        radius = np.ones(N_POINTS)
        if capped:
            radius[::5], z[::5] = np.sqrt(rng.random(len(z[::5]))), 0.0
        return noisy(np.column_stack([radius * np.cos(turn), radius * np.sin(turn), z]), rng)

    return tube(), tube(), False


def cones(rng: Generator) -> tuple[Array, Array, bool]:
    height, top = rng.uniform(0.5, 3), rng.choice([0.0, 0.5])

    def cone() -> Array:
        radius, turn = np.sqrt(rng.uniform(top**2, 1, N_POINTS)), rng.uniform(0, 2 * np.pi, N_POINTS)
        z = height * (1 - radius)
        return noisy(np.column_stack([radius * np.cos(turn), radius * np.sin(turn), z]), rng)

    return cone(), cone(), False


def tori(rng: Generator) -> tuple[Array, Array, bool]:
    tube, arc = rng.uniform(0.1, 0.6), rng.choice([2 * np.pi, 2 * np.pi, 1.2 * np.pi])

    def ring() -> Array:
        turn, around = rng.uniform(0, arc, N_POINTS), rng.uniform(0, 2 * np.pi, N_POINTS)
        level = 1 + tube * np.cos(around)
        return noisy(
            np.column_stack([level * np.cos(turn), level * np.sin(turn), tube * np.sin(around)]), rng
        )

    return ring(), ring(), False


def furrows(rng: Generator) -> tuple[Array, Array, bool]:
    wave, height = rng.uniform(0.2, 0.8), rng.uniform(0.02, 0.2)

    def field() -> Array:
        xy = rng.uniform(0, 4, (N_POINTS, 2))
        return noisy(np.column_stack([xy, height * np.sin(2 * np.pi * xy[:, 0] / wave)]), rng)

    return field(), field(), False


# --- things that repeat ------------------------------------------------------------------------------


def box_surface(low: Array, high: Array, rng: Generator, n_points: int) -> Array:
    """Points spread evenly over the six faces of a box."""
    size = high - low
    areas = np.array([size[1] * size[2], size[0] * size[2], size[0] * size[1]])
    axis = rng.choice(3, n_points, p=areas / areas.sum())
    points = rng.random((n_points, 3))
    points[np.arange(n_points), axis] = rng.integers(0, 2, n_points)
    return np.asarray(low + points * size)


def piers(rng: Generator) -> tuple[Array, Array, bool]:
    """Make five of nine equal piers on level ground, and another five: one to four whole piers apart."""
    pitch, height, shift = rng.uniform(1.5, 3), rng.uniform(1, 3), int(rng.integers(1, 5))
    is_round = rng.random() < 0.5

    def row(first: int) -> Array:
        parts = []
        for number in range(first, first + 5):
            z = rng.uniform(0, height, 1400)
            if is_round:
                turn = rng.uniform(0, 2 * np.pi, 1400)
                pier = np.column_stack([0.4 * np.cos(turn), 0.4 * np.sin(turn), z])
            else:
                pier = box_surface(np.array([-0.4, -0.6, 0]), np.array([0.4, 0.6, height]), rng, 1400)
            parts.append(pier + np.array([pitch * number, 0, 0]))
        low, high = [pitch * (first - 0.5), -1.5], [pitch * (first + 4.5), 1.5]
        parts.append(np.pad(rng.uniform(low, high, (3000, 2)), ((0, 0), (0, 1))))
        return noisy(np.concatenate(parts), rng)

    return row(0), row(shift), True


def stairs(rng: Generator) -> tuple[Array, Array, bool]:
    """Make ten of many equal steps, and ten others: one to five steps apart."""
    rise, run, width = rng.uniform(0.15, 0.2), rng.uniform(0.25, 0.32), rng.uniform(0.8, 2)
    shift = int(rng.integers(1, 6))

    def flight(first: int) -> Array:
        step = rng.integers(first, first + 10, N_POINTS)
        along, is_tread = rng.random(N_POINTS), rng.random(N_POINTS) < run / (rise + run)
        x = (step + np.where(is_tread, along, 0)) * run
        z = (step + np.where(is_tread, 1, along)) * rise
        return noisy(np.column_stack([x, rng.uniform(0, width, N_POINTS), z]), rng, 0.002)

    return flight(0), flight(shift), True


def facades(rng: Generator) -> tuple[Array, Array, bool]:
    """Make a wall with a grid of equal windows, and the same wall seen some windows further."""
    pitch_x, pitch_z, depth = rng.uniform(1.5, 3), rng.uniform(2.5, 3.5), rng.uniform(0.1, 0.3)
    shift = int(rng.integers(1, 4))

    def wall(first: int) -> Array:
        x = pitch_x * rng.uniform(first, first + 6, 2 * N_POINTS)
        z = rng.uniform(0, 4 * pitch_z, 2 * N_POINTS)
        is_window = (np.abs(x % pitch_x - pitch_x / 2) < 0.5) & (np.abs(z % pitch_z - pitch_z / 2) < 0.8)
        return noisy(np.column_stack([x, depth * is_window, z]), rng, 0.005)

    return wall(0), wall(shift), True


# --- rooms and boxes ---------------------------------------------------------------------------------


def room(size: Array, n_things: int, rng: Generator) -> Array:
    """Make walls, floor and ceiling with boxes of random size on the floor."""
    parts = [box_surface(np.zeros(3), size, rng, N_POINTS)]
    for _ in range(n_things):
        half = rng.uniform([0.2, 0.2, 0.3], [0.9, 0.9, 1.9]) / 2
        middle = np.append(rng.uniform(half[:2], size[:2] - half[:2]), half[2])
        parts.append(box_surface(middle - half, middle + half, rng, 500))
    return noisy(np.concatenate(parts), rng, 0.005)


def empty_rooms(rng: Generator) -> tuple[Array, Array, bool]:
    size = rng.uniform([3, 3, 2.4], [8, 6, 3])
    return room(size, 0, rng), room(size, 0, rng), False


def other_rooms(rng: Generator) -> tuple[Array, Array, bool]:
    sizes = rng.uniform([3, 3, 2.4], [8, 6, 3], (2, 3))
    return room(sizes[0], 8, rng), room(sizes[1], 8, rng), False


def rooms_of_one_plan(rng: Generator) -> tuple[Array, Array, bool]:
    """Make two storeys: the same walls with other things between them."""
    size = rng.uniform([3, 3, 2.4], [8, 6, 3])
    return room(size, 8, rng), room(size, 8, rng), False


def boxes(rng: Generator) -> tuple[Array, Array, bool]:
    sizes = rng.uniform(0.4, 1.5, (2, 3))
    if rng.random() < 0.5:
        sizes[1] = sizes[0]
    one, other = (noisy(box_surface(np.zeros(3), size, rng, N_POINTS), rng) for size in sizes)
    return one, other, False


# --- ground and bodies -------------------------------------------------------------------------------


class Hills:
    """A smooth random height field without repeats."""

    def __init__(self, rng: Generator) -> None:
        self.waves = rng.normal(0, 2.5, (24, 2))
        self.phases = rng.uniform(0, 2 * np.pi, 24)
        self.heights = 0.12 / (0.6 + np.linalg.norm(self.waves, axis=1))

    def survey(self, west: float, east: float, rng: Generator) -> Array:
        """Draw points between two abscissae."""
        xy = rng.uniform([west, 0], [east, 4], (N_POINTS, 2))
        z = np.sin(xy @ self.waves.T + self.phases) @ self.heights
        return noisy(np.column_stack([xy, z]), rng)


def other_hills(rng: Generator) -> tuple[Array, Array, bool]:
    return Hills(rng).survey(0, 4, rng), Hills(rng).survey(0, 4, rng), False


def hills_without_overlap(rng: Generator) -> tuple[Array, Array, bool]:
    hills = Hills(rng)
    return hills.survey(0, 4, rng), hills.survey(4.2, 8.2, rng), False


def mirrored_hills(rng: Generator) -> tuple[Array, Array, bool]:
    hills = Hills(rng)
    return hills.survey(0, 4, rng) * MIRROR, hills.survey(0.5, 4.5, rng), False


def strewn(hills: Array, depth: float, share: float, rng: Generator) -> Array:
    """Move a share of the points up by as much as a depth, or down where it is negative."""
    is_stray = rng.random(len(hills)) < share
    return hills + np.array([0, 0, depth]) * (is_stray * rng.random(len(hills)))[:, None]


def strays_of(rng: Generator) -> tuple[float, float]:
    """Draw how deep strays lie above the one cloud and below the other, and the share of them."""
    return rng.uniform(0.1, 0.4), rng.uniform(0.3, 0.5)


def strewn_hills(rng: Generator) -> tuple[Array, Array, bool]:
    """Strays stand above the one and below the other: where they lie on each other, the hills do not."""
    hills, (depth, share) = Hills(rng), strays_of(rng)
    one, other = (hills.survey(0, 4, rng) for _ in range(2))
    return strewn(one, depth, share, rng), strewn(other, -depth, share, rng), True


def strewn_other_hills(rng: Generator) -> tuple[Array, Array, bool]:
    one, other, is_true = other_hills(rng)
    depth, share = strays_of(rng)
    return strewn(one, depth, share, rng), strewn(other, rng.choice([-1, 1]) * depth, share, rng), is_true


class Body:
    """A lumpy closed body: a sphere whose radius is a smooth random function of the direction."""

    def __init__(self, rng: Generator) -> None:
        self.waves = rng.normal(0, 2.2, (16, 3))
        self.phases = rng.uniform(0, 2 * np.pi, 16)

    def scan(self, seen_from: Array, rng: Generator) -> Array:
        """Draw points on the side that faces a direction."""
        directions = rng.normal(size=(2 * N_POINTS, 3))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        directions = directions[directions @ seen_from > -0.2]
        radius = 1 + 0.06 * np.sin(directions @ self.waves.T + self.phases).sum(axis=1)
        return noisy(directions * radius[:, None], rng)


UP, ASIDE = np.array([0.0, 0.0, 1.0]), np.array([0.5, 0.0, 0.866])


def other_bodies(rng: Generator) -> tuple[Array, Array, bool]:
    return Body(rng).scan(UP, rng), Body(rng).scan(UP, rng), False


def mirrored_bodies(rng: Generator) -> tuple[Array, Array, bool]:
    body = Body(rng)
    return body.scan(UP, rng) * MIRROR, body.scan(ASIDE, rng), False


def noise_clouds(rng: Generator) -> tuple[Array, Array, bool]:
    kind = rng.integers(3)
    size = (N_POINTS, 3)
    if kind == 0:
        return rng.normal(size=size), rng.normal(size=size), False
    if kind == 1:
        return rng.random(size), rng.random(size), False
    # Random walks: thin, tangled, like nothing that was scanned.
    return np.cumsum(rng.normal(size=size), axis=0), np.cumsum(rng.normal(size=size), axis=0), False


# --- sites -------------------------------------------------------------------------------------------


def surveys(seed: int, area_ratio: float, overlap: float = 1.0, size_m: float = 80.0) -> tuple[Array, Array]:
    """Return photogrammetry and scanner survey of one site in one frame."""
    pair = make_pair(
        size_m=size_m,
        area_ratio=area_ratio,
        overlap=overlap,
        n_photogrammetry_points=int(20_000 * area_ratio),
        n_scanner_points=30_000,
        stations=5,
        national_grid=False,
        pose="identity",
        seed=seed,
    )
    return pair.source.xyz, pair.target.xyz


def other_sites(rng: Generator) -> tuple[Array, Array, bool]:
    """Make sites of other ground and other size, so of other shape."""
    seeds, area_ratio = rng.choice(1000, 2, replace=False), float(rng.choice([1.0, 2.0, 4.0]))
    size_m = float(rng.choice([100.0, 125.0, 150.0]))
    return surveys(int(seeds[0]), area_ratio, size_m=size_m)[0], surveys(int(seeds[1]), 1.0)[1], False


def sites_of_one_plan(rng: Generator) -> tuple[Array, Array, bool]:
    """Make sites of other ground and one size: dam, ramp and roads lie within metres of each other."""
    seeds, area_ratio = rng.choice(1000, 2, replace=False), float(rng.choice([1.0, 2.0, 4.0]))
    return surveys(int(seeds[0]), area_ratio)[0], surveys(int(seeds[1]), 1.0)[1], False


def mirrored_sites(rng: Generator) -> tuple[Array, Array, bool]:
    flown, scanned = surveys(int(rng.integers(1000)), float(rng.choice([1.0, 2.0, 4.0])))
    return flown * MIRROR, scanned, False


def sites_without_overlap(rng: Generator) -> tuple[Array, Array, bool]:
    """Take the part of the photogrammetry that lies beside the scanner's area."""
    flown, scanned = surveys(int(rng.integers(1000)), 4.0, 0.5)
    return flown[flown[:, 0] < scanned[:, 0].min() - 2.0], scanned, False


def noisy_other_sites(rng: Generator) -> tuple[Array, Array, bool]:
    return flown_roughly(other_sites, rng)


def noisy_sites_of_one_plan(rng: Generator) -> tuple[Array, Array, bool]:
    return flown_roughly(sites_of_one_plan, rng)


def noisy_mirrored_sites(rng: Generator) -> tuple[Array, Array, bool]:
    return flown_roughly(mirrored_sites, rng)


def noisy_sites_without_overlap(rng: Generator) -> tuple[Array, Array, bool]:
    return flown_roughly(sites_without_overlap, rng)


def flown_roughly(maker: Maker, rng: Generator) -> tuple[Array, Array, bool]:
    """Make the photogrammetry noisy by about a voxel: then surfaces no longer show that they lie apart."""
    flown, scanned, is_true = maker(rng)
    return noisy(flown, rng, SITE_NOISE_M), scanned, is_true


# How many variants of each are run.
MAKERS: dict[Maker, int] = {
    planes: 4,
    spheres: 6,
    cylinders: 6,
    cones: 4,
    tori: 6,
    furrows: 4,
    piers: 8,
    stairs: 6,
    facades: 6,
    empty_rooms: 4,
    other_rooms: 6,
    rooms_of_one_plan: 6,
    boxes: 6,
    other_hills: 6,
    hills_without_overlap: 6,
    mirrored_hills: 6,
    other_bodies: 6,
    mirrored_bodies: 6,
    noise_clouds: 6,
    sites_of_one_plan: 6,
    mirrored_sites: 6,
    sites_without_overlap: 4,
    other_sites: 6,
    noisy_other_sites: 6,
    noisy_sites_of_one_plan: 72,  # two of them, 60 and 68, are all but one place
    noisy_mirrored_sites: 6,
    noisy_sites_without_overlap: 4,
    strewn_hills: 8,
    strewn_other_hills: 8,
}
