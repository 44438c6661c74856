"""The survey by a terrestrial laser scanner: first hits of equal-angle rays from tripod stations.

The ground is met by marching: along each azimuth the grid gives a profile, whose running maximum of
slope seen from the scanner is the horizon; a ray hits where the horizon first rises above it. Solids
are met by exact intersection, each only with the rays of its own window of angles.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tmchho.arguments import checked_number, checked_seed
from tmchho.cloud import PointCloud
from tmchho.errors import InvalidArgumentError
from tmchho.simulate.arguments import checked_n_points, checked_noise, checked_outlier_share, stream
from tmchho.simulate.ground import Area, Array
from tmchho.simulate.materials import LAS_CLASS, LAS_CLASS_STRAY, REFLECTANCE, Material
from tmchho.simulate.site import Site
from tmchho.simulate.solids import Solid
from tmchho.simulate.stations import station_points

# The scanner looks from steeply down (its tripod hides the rest) to well above the crest.
LOWEST_RAD, HIGHEST_RAD = np.deg2rad(-58.0), np.deg2rad(50.0)
# Returns fade out as the ray grazes the surface: all come back above this cosine of incidence.
FULL_RETURN_COSINE = 0.12
# Rays of the first look, which finds out what share of all rays gives a point.
N_PILOT_RAYS = 40_000
# Profile samples held at once (eight bytes each, a handful of arrays).
MAX_PROFILE_SAMPLES = 1_500_000


class _Returns(NamedTuple):
    """What stations measured, before noise; one row per point."""

    station: NDArray[np.uint16]
    direction: Array
    range_m: Array
    cosine: Array
    material: NDArray[np.uint8]
    edge_gap_m: Array

    @staticmethod
    def join(parts: Sequence[_Returns]) -> _Returns:
        """Put the returns of several stations one after the other."""
        return _Returns._make(np.concatenate(column) for column in zip(*parts, strict=True))

    def take(self, rows: NDArray[np.intp]) -> _Returns:
        """Return the given rows only."""
        return _Returns._make(column[rows] for column in self)


def survey_scanner(
    site: Site,
    *,
    stations: int | Sequence[Sequence[float]] | Array = 8,
    n_points: int = 300_000,
    range_noise_m: float = 0.004,
    max_range_m: float = 200.0,
    thinning_range_m: float = 18.0,
    outlier_share: float = 0.01,
    seed: int = 0,
) -> PointCloud:
    """Survey the scanner's area of a site from tripod stations.

    Density falls with the square of the range, things cast shadows, grazing rays are lost, still
    water hardly answers. Some returns are wrong: mixed pixels between an edge and what lies behind
    it, and dust or birds in the air.

    Parameters
    ----------
    site : Site
        The scene.
    stations : int or (k, 2) array, default 8
        Number of stations, placed by `place_stations`, or their plan coordinates in metres, all
        within the scanner's area. The instrument stands 1.8 m above the ground.
    n_points : int, default 300000
        Exact number of points returned.
    range_noise_m : float, default 0.004
        Standard deviation of the noise along the ray, in metres.
    max_range_m : float, default 200
        Reach of the scanner, in metres; returns get fewer towards it.
    thinning_range_m : float, default 18
        Returns nearer than this are thinned to the angular density they would have had there, as
        scanner software does on export; 0 keeps all.
    outlier_share : float, default 0.01
        Share of the points that are wrong returns; 0 to 0.5.
    seed : int, default 0
        Fixes everything.

    Returns
    -------
    PointCloud
        In the site's frame, ordered by station, with ``intensity`` (uint16), ``point_source_id``
        (uint16, station number from 1) and ``classification`` (uint8; the truth, under LAS codes:
        1 objects, 2 ground, 6 building, 9 water, 18 wrong returns).

    Raises
    ------
    InvalidArgumentError
        If an argument is out of its range, or the stations see nothing.
    """
    n_points = checked_n_points("n_points", n_points)
    range_noise_m = checked_noise("range_noise_m", range_noise_m)
    max_range_m = checked_number("max_range_m", max_range_m, 5.0, 5000.0)
    thinning_range_m = checked_number("thinning_range_m", thinning_range_m, 0.0, 5000.0)
    outlier_share = checked_outlier_share("outlier_share", outlier_share)
    seed = checked_seed(seed)
    eyes = station_points(site, stations, seed)

    # Stations and points lie within one rectangle: what does not touch it never comes between them.
    area = site.scanner_area
    solids = {index: solid for index, solid in enumerate(site.solids) if _touches(solid, area)}
    n_rays, found = float(N_PILOT_RAYS), 0
    while found < n_points:
        rng = stream(seed, "scanner returns")
        parts = [
            _survey_station(site, solids, number, eye, n_rays / len(eyes), max_range_m, thinning_range_m, rng)
            for number, eye in enumerate(eyes, start=1)
        ]
        found = sum(len(part.range_m) for part in parts)
        if found == 0:
            raise InvalidArgumentError(
                "stations see nothing of the scanner's area; move them or raise max_range_m"
            )
        # Should it be too few, a little more than this yield promises is enough.
        n_rays *= 1.04 * n_points / found
    every = _Returns.join(parts)
    chosen = stream(seed, "scanner choice").permutation(found)[:n_points]
    return _measured(eyes, every.take(np.sort(chosen)), range_noise_m, outlier_share, seed)


def _touches(solid: Solid, area: Area) -> bool:
    """Tell whether the sphere around a solid reaches into an area."""
    x, y, radius = solid.centre[0], solid.centre[1], solid.radius_m
    return bool(area.west - radius < x < area.east + radius and area.south - radius < y < area.north + radius)


def _survey_station(
    site: Site,
    solids: dict[int, Solid],
    number: int,
    eye: Array,
    n_rays: float,
    max_range_m: float,
    thinning_range_m: float,
    rng: np.random.Generator,
) -> _Returns:
    """Cast the rays of one station and keep those whose light comes back from the scanner's area."""
    step = np.sqrt(2.0 * np.pi * (HIGHEST_RAD - LOWEST_RAD) / n_rays)
    n_azimuths = max(round(2.0 * np.pi / step), 8)
    azimuths = (np.arange(n_azimuths) + rng.random()) * (2.0 * np.pi / n_azimuths)
    elevations = LOWEST_RAD + (np.arange(max(round((HIGHEST_RAD - LOWEST_RAD) / step), 4)) + 0.5) * step

    ranges = _ground_ranges(site, eye, azimuths, elevations, max_range_m)
    owner = np.full(ranges.shape, -1, dtype=np.int32)
    for index, solid in solids.items():
        _cover(solid, index, eye, azimuths, elevations, ranges, owner)

    gap = np.zeros_like(ranges)
    with np.errstate(invalid="ignore"):
        gap[:, :-1] = ranges[:, 1:] - ranges[:, :-1]
    row, column = np.nonzero(ranges <= max_range_m)
    range_m, owner_of, gap_m = ranges[row, column], owner[row, column], gap[row, column]
    direction = _directions(azimuths[row], elevations[column])
    points = eye + range_m[:, None] * direction
    inside = site.scanner_area.contains(points[:, 0], points[:, 1])
    # Thin the near field before the costly part.
    if thinning_range_m > 0.0:
        inside &= rng.random(len(range_m)) < (range_m / thinning_range_m) ** 2
    points, direction, range_m = points[inside], direction[inside], range_m[inside]
    owner_of, gap_m = owner_of[inside], gap_m[inside]

    normals = site.ground.normals(points[:, 0], points[:, 1])
    material = site.ground.material(points[:, 0], points[:, 1])
    for index in np.unique(owner_of[owner_of >= 0]):
        rows = np.flatnonzero(owner_of == index)
        normals[rows] = site.solids[index].normals(points[rows])
        material[rows] = site.solids[index].material
    cosine = np.abs(np.einsum("ij,ij->i", normals, direction))
    chance = np.minimum(cosine / FULL_RETURN_COSINE, 1.0) * (1.0 - (range_m / max_range_m) ** 4)
    chance *= np.where(material == Material.WATER, 0.04, 1.0)
    back = np.flatnonzero(rng.random(len(chance)) < chance)
    stations = np.full(len(back), number, dtype=np.uint16)
    return _Returns(stations, direction[back], range_m[back], cosine[back], material[back], gap_m[back])


def _ground_ranges(site: Site, eye: Array, azimuths: Array, elevations: Array, max_range_m: float) -> Array:
    """Distance to the ground along every ray, shape (n_azimuths, n_elevations); infinite for the sky."""
    ground, area = site.ground, site.scanner_area
    reach = min(max_range_m, float(np.hypot(area.east - area.west, area.north - area.south)))
    # Fine steps near the tripod, then half a cell: a profile point never skips a cell.
    half_cell = 0.5 * ground.cell_m
    steps = np.concatenate([np.arange(0.1, 4.0, 0.2 * ground.cell_m), np.arange(4.0, reach, half_cell)])
    slopes = np.tan(elevations)
    ranges = np.full((len(azimuths), len(elevations)), np.inf)
    chunk = max(MAX_PROFILE_SAMPLES // len(steps), 1)
    for first in range(0, len(azimuths), chunk):
        cos = np.cos(azimuths[first : first + chunk])[:, None]
        sin = np.sin(azimuths[first : first + chunk])[:, None]
        rise = ground.height(eye[0] + cos * steps, eye[1] + sin * steps) - eye[2]
        horizon = np.maximum.accumulate(rise / steps, axis=1)
        hit = np.stack([np.searchsorted(line, slopes) for line in horizon])
        row, column = np.nonzero((hit > 0) & (hit < len(steps)))
        index, slope = hit[row, column], slopes[column]
        near, far = steps[index - 1], steps[index]
        # Height of the ground above the ray at both ends of the step: below first, then above.
        below = rise[row, index - 1] - near * slope
        above = rise[row, index] - far * slope
        cos, sin = cos[row, 0], sin[row, 0]
        # The ground between is bent a little where the step crosses cell borders: false position
        # finds the bilinear surface to well under a millimetre.
        for _ in range(3):
            guess = near - below * (far - near) / (above - below)
            miss = ground.height(eye[0] + cos * guess, eye[1] + sin * guess) - eye[2] - guess * slope
            under = miss < 0.0
            near, below = np.where(under, guess, near), np.where(under, miss, below)
            far, above = np.where(under, far, guess), np.where(under, above, miss)
        guess = near - below * (far - near) / (above - below)
        ranges[first + row, column] = guess / np.cos(elevations[column])
    return ranges


def _cover(
    solid: Solid,
    index: int,
    eye: Array,
    azimuths: Array,
    elevations: Array,
    ranges: Array,
    owner: NDArray[np.int32],
) -> None:
    """Shorten, in place, the rays that meet a solid before anything else."""
    offset = solid.centre - eye
    distance = float(np.linalg.norm(offset))
    columns, rows = np.arange(len(elevations)), np.arange(len(azimuths))
    if distance > solid.radius_m:
        spread = np.arcsin(solid.radius_m / distance)
        elevation = np.arcsin(offset[2] / distance)
        low, high = np.searchsorted(elevations, (elevation - spread, elevation + spread))
        columns = columns[low:high]
        side = solid.radius_m / np.hypot(offset[0], offset[1]) if offset[:2].any() else 1.0
        if side < 1.0:
            step = azimuths[1] - azimuths[0]
            middle = (np.arctan2(offset[1], offset[0]) - azimuths[0]) / step
            reach = np.arcsin(side) / step
            rows = np.arange(np.ceil(middle - reach), np.floor(middle + reach) + 1).astype(np.intp)
            rows %= len(azimuths)
    if len(rows) == 0 or len(columns) == 0:
        return
    directions = _directions(azimuths[rows][:, None], elevations[columns][None, :]).reshape(-1, 3)
    window = np.ix_(rows, columns)
    hits = solid.first_hit(eye, directions).reshape(len(rows), len(columns))
    nearer = hits < ranges[window]
    ranges[window] = np.where(nearer, hits, ranges[window])
    owner[window] = np.where(nearer, index, owner[window])


def _directions(azimuths: Array, elevations: Array) -> Array:
    """Return unit vectors of given azimuth (from east to north) and elevation, shape (…, 3)."""
    level = np.cos(elevations)
    parts = np.broadcast_arrays(level * np.cos(azimuths), level * np.sin(azimuths), np.sin(elevations))
    return np.stack(parts, axis=-1)


def _measured(
    eyes: Array, returns: _Returns, range_noise_m: float, outlier_share: float, seed: int
) -> PointCloud:
    """Add range noise, wrong returns and attributes."""
    n_points = len(returns.range_m)
    noise = stream(seed, "scanner noise").standard_normal(n_points)
    range_m = returns.range_m + range_noise_m * noise
    classification = LAS_CLASS[returns.material]

    # Half of the wrong returns are mixed pixels where there are edges enough, the others float.
    rng = stream(seed, "scanner strays")
    wrong = rng.permutation(n_points)[: round(outlier_share * n_points)]
    at_edge = (np.abs(returns.edge_gap_m) > 0.3) & (np.abs(returns.edge_gap_m) < 10.0)
    edges = rng.permutation(np.flatnonzero(at_edge))[: len(wrong) // 2]
    floating = np.setdiff1d(wrong, edges, assume_unique=True)[: len(wrong) - len(edges)]
    range_m[edges] += rng.uniform(0.15, 0.85, len(edges)) * returns.edge_gap_m[edges]
    range_m[floating] *= rng.uniform(0.15, 0.9, len(floating))
    classification[edges] = classification[floating] = LAS_CLASS_STRAY

    fading = 1.0 / (1.0 + (returns.range_m / 60.0) ** 2)
    strength = REFLECTANCE[returns.material] * (0.25 + 0.75 * returns.cosine) * (0.35 + 0.65 * fading)
    strength *= 1.0 + 0.05 * stream(seed, "scanner intensity").standard_normal(n_points)
    attributes: dict[str, NDArray[Any]] = {
        "intensity": np.clip(np.rint(65535.0 * strength), 0, 65535).astype(np.uint16),
        "point_source_id": returns.station,
        "classification": classification,
    }
    xyz = eyes[returns.station - 1] + range_m[:, None] * returns.direction
    return PointCloud(xyz, attributes, name="simulated scanner")
