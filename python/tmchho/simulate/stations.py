"""Where the scanner stands: places given by the caller, or chosen so that together they see most."""

from __future__ import annotations

from typing import Any

import numpy as np

from tmchho.arguments import checked_count, checked_seed
from tmchho.errors import InvalidArgumentError
from tmchho.simulate.arguments import stream
from tmchho.simulate.ground import Array
from tmchho.simulate.materials import Material
from tmchho.simulate.site import Site

INSTRUMENT_HEIGHT_M = 1.8
# Places among which the stations are chosen.
N_CANDIDATES = 80


def place_stations(site: Site, count: int, *, seed: int = 0) -> Array:
    """Choose tripod places in the scanner's area, as a surveyor would: those that together see most.

    The places are level, dry and clear of solids. One after the other is chosen so that the sum of
    log(1 + point density) over the area grows most: an unseen place counts more than a dense one.

    Parameters
    ----------
    site : Site
        The scene.
    count : int
        Number of stations; 1 to 80.
    seed : int, default 0
        Fixes the choice.

    Returns
    -------
    (count, 3) float64 array
        Places of the instrument, 1.8 m above the ground, in metres.

    Raises
    ------
    InvalidArgumentError
        If `count` is out of its range.
    """
    count = checked_count("stations", count, 1, N_CANDIDATES)
    area = site.scanner_area
    size = area.east - area.west
    rng = stream(checked_seed(seed), "stations")
    x, y = np.array([[area.west], [area.south]]) + size * rng.uniform(0.04, 0.96, (2, 20 * N_CANDIDATES))
    around = np.stack([site.ground.height(x + dx, y + dy) for dx in (-1.5, 1.5) for dy in (-1.5, 1.5)])
    good = (np.ptp(around, axis=0) < 1.0) & (site.ground.material(x, y) != Material.WATER)
    for solid in site.solids:
        good &= np.hypot(x - solid.centre[0], y - solid.centre[1]) > solid.radius_m + 1.0
    eyes = _instruments(site, np.stack([x, y], axis=1)[good][:N_CANDIDATES])
    if len(eyes) < count:
        raise InvalidArgumentError(
            f"stations: only {len(eyes)} level places found, {count} wanted; ask for fewer"
        )

    density = _expected_density(site, eyes)
    total = np.zeros(density.shape[1])
    chosen: list[int] = []
    for _ in range(count):
        gain = np.log1p(300.0 * (total + density)).sum(axis=1)
        gain[chosen] = -np.inf
        chosen.append(int(np.argmax(gain)))
        total += density[chosen[-1]]
    return eyes[chosen]


def _expected_density(site: Site, eyes: Array) -> Array:
    """Relative point density that each place gives each of 24 x 24 ground targets, (n_eyes, 576)."""
    area = site.scanner_area
    ground, _ = site.surface(area)
    share = (np.arange(24) + 0.5) / 24.0
    x, y = (axis.ravel() for axis in np.meshgrid(share, share))
    x, y = area.west + x * (area.east - area.west), area.south + y * (area.north - area.south)
    targets = np.column_stack([x, y, ground.height(x, y)])
    normals = ground.normals(x, y)
    on_the_way = np.linspace(0.03, 0.96, 32)[:, None]
    density = np.empty((len(eyes), len(targets)))
    for row, eye in enumerate(eyes):
        ray = targets - eye
        range_sq = np.einsum("ij,ij->i", ray, ray)
        facing = -np.einsum("ij,ij->i", ray, normals) / np.sqrt(range_sq)
        under = ground.height(eye[0] + on_the_way * ray[:, 0], eye[1] + on_the_way * ray[:, 1])
        free = (under < eye[2] + on_the_way * ray[:, 2]).all(axis=0)
        # In units of the density that a surface across the ray has in 20 m, at most that.
        density[row] = np.where(free, np.maximum(facing, 0.0) * np.minimum(400.0 / range_sq, 1.0), 0.0)
    return density


def _instruments(site: Site, places: Array) -> Array:
    """Lift plan coordinates of shape (k, 2) to the height of the instrument."""
    height = site.ground.height(places[:, 0], places[:, 1]) + INSTRUMENT_HEIGHT_M
    return np.column_stack([places, height])


def station_points(site: Site, stations: Any, seed: int) -> Array:
    """Turn the argument `stations` into instrument places of shape (k, 3)."""
    if isinstance(stations, (int, np.integer)):
        return place_stations(site, checked_count("stations", stations, 1, N_CANDIDATES), seed=seed)
    try:
        places = np.asarray(stations, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InvalidArgumentError(f"stations must be a count or plan coordinates ({error})") from error
    if places.ndim != 2 or places.shape[1] != 2 or len(places) == 0:
        raise InvalidArgumentError(f"stations must be a count or have shape (k, 2), got shape {places.shape}")
    if not site.scanner_area.contains(places[:, 0], places[:, 1]).all():
        raise InvalidArgumentError(f"stations must lie within the scanner's area {tuple(site.scanner_area)}")
    eyes = _instruments(site, places)
    for solid in site.solids:
        if solid.contains(eyes).any():
            raise InvalidArgumentError("stations: one of them stands inside a solid; move it")
    return eyes
