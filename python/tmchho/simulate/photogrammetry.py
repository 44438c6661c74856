"""The survey by photogrammetry: even points over everything that cameras see from above.

Dense matching works on small patches, so it sees a low-passed surface: edges come out round. It
matches slanted patches badly, so steep faces get fewer points and more noise. Walls are seen by the
oblique cameras only, and not at all below overhangs.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tmchho.arguments import checked_number, checked_seed
from tmchho.cloud import PointCloud
from tmchho.simulate.arguments import checked_n_points, checked_noise, checked_outlier_share, stream
from tmchho.simulate.ground import Array, Ground, value_noise
from tmchho.simulate.materials import COLOURS, LAS_CLASS, LAS_CLASS_STRAY, Material
from tmchho.simulate.site import Site
from tmchho.simulate.solids import Solid

# Four oblique cameras look down at 50 degrees from four sides.
CAMERA_ELEVATION_RAD = np.deg2rad(50.0)
CAMERA_AZIMUTHS_RAD = np.deg2rad([20.0, 110.0, 200.0, 290.0])
# A wall is matched only where a camera sees it at less than about 75 degrees from its normal.
LEAST_CAMERA_COSINE = 0.25
# Whatever is farther than this from a wall's solid does not hide it.
CLEAR_M = 8.0
# The largest spacing that still sets the size of what is smoothed, in metres.
MAX_PATCH_M = 1.5
# Points per area of a wall, relative to level ground.
WALL_SHARE = 0.6
# Share of the points on still water that match at all.
WATER_SHARE = 0.12
# Sun in the south-west: horizontal direction to it, and the tangent of its elevation.
SUN_EAST, SUN_NORTH, SUN_TANGENT = -0.69, -0.72, 0.85


class _Samples(NamedTuple):
    """Points as matched; one row per point."""

    xyz: Array
    normals: Array
    material: NDArray[np.uint8]

    @staticmethod
    def join(parts: Sequence[_Samples]) -> _Samples:
        """Put several sets of points one after the other."""
        return _Samples._make(np.concatenate(column) for column in zip(*parts, strict=True))

    def take(self, rows: NDArray[Any]) -> _Samples:
        """Return the given rows only."""
        return _Samples._make(column[rows] for column in self)


def survey_photogrammetry(
    site: Site,
    *,
    n_points: int = 400_000,
    noise_m: float = 0.03,
    smoothing_spacings: float = 2.5,
    outlier_share: float = 0.005,
    seed: int = 0,
) -> PointCloud:
    """Survey the photogrammetry's area of a site from the air, straight down and from four sides.

    Density is even over the area, less on steep faces, least on walls; nothing is seen below eaves.
    Edges are smoothed; noise is partly common to neighbours and grows on steep faces.

    Parameters
    ----------
    site : Site
        The scene.
    n_points : int, default 400000
        Exact number of points returned.
    noise_m : float, default 0.03
        Standard deviation of the noise along the normal on level ground, in metres; about two
        and a half times as large on a wall.
    smoothing_spacings : float, default 2.5
        Full width at half maximum of the low-pass, in point spacings (of 1.5 m at most); 0 keeps
        edges sharp.
    outlier_share : float, default 0.005
        Share of mismatched points, metres above or below the surface; 0 to 0.5.
    seed : int, default 0
        Fixes everything.

    Returns
    -------
    PointCloud
        In the site's frame, ordered from south to north (walls after the ground), with ``red``,
        ``green``, ``blue`` (uint16) and ``classification`` (uint8; the truth, under LAS codes: 1
        objects, 2 ground, 6 building, 9 water, 18 mismatches).

    Raises
    ------
    InvalidArgumentError
        If an argument is out of its range.
    """
    n_points = checked_n_points("n_points", n_points)
    noise_m = checked_noise("noise_m", noise_m)
    smoothing_spacings = checked_number("smoothing_spacings", smoothing_spacings, 0.0, 10.0)
    outlier_share = checked_outlier_share("outlier_share", outlier_share)
    seed = checked_seed(seed)

    area = site.photogrammetry_area
    spacing_m = float(np.sqrt(area.square_metres / n_points))
    sharp, _ = site.surface(area)
    # Sparse clouds are thinned dense ones: their patches do not grow without end.
    patch_m = min(spacing_m, MAX_PATCH_M)
    # A part of the noise is common to neighbours, unless nothing is smoothed.
    lumps_m = 0.6 * noise_m if smoothing_spacings > 0.0 else 0.0
    seen = _matched_surface(sharp, smoothing_spacings * patch_m, lumps_m, seed)
    weights = _points_per_cell(sharp, seen, patch_m)
    pitch_m = spacing_m * float(np.sqrt(weights.mean() / 1.03))
    samples = _sample(site, seen, weights, pitch_m, seed)
    while len(samples.xyz) < n_points:
        pitch_m *= 0.99 * float(np.sqrt(max(len(samples.xyz), 1) / n_points))
        samples = _sample(site, seen, weights, pitch_m, seed)
    chosen = stream(seed, "matching choice").permutation(len(samples.xyz))[:n_points]
    own_noise_m = float(np.sqrt(noise_m**2 - lumps_m**2))
    return _matched(sharp, samples.take(np.sort(chosen)), own_noise_m, outlier_share, seed)


def _matched_surface(sharp: Ground, width_m: float, lumps_m: float, seed: int) -> Ground:
    """Low-pass the top surface, with smooth lumps of standard deviation `lumps_m` added."""
    sigma_cells = width_m / np.sqrt(8.0 * np.log(2.0)) / sharp.cell_m
    heights = sharp.heights
    if lumps_m > 0.0:
        # The low-pass leaves 1 / (2 sqrt(pi) sigma) of white noise's deviation.
        white = stream(seed, "matching lumps").standard_normal(heights.shape)
        heights = heights + lumps_m * max(2.0 * np.sqrt(np.pi) * sigma_cells, 1.0) * white
    return Ground(_low_pass(heights, sigma_cells), sharp.materials, sharp.west, sharp.south, sharp.cell_m)


def _low_pass(grid: Array, sigma_cells: float) -> Array:
    """Gaussian filter with the rim repeated outwards."""
    radius = int(np.ceil(3.0 * sigma_cells))
    kernel = np.exp(-0.5 * (np.arange(-radius, radius + 1) / max(sigma_cells, 1e-9)) ** 2)
    kernel /= kernel.sum()
    for _ in range(2):
        padded = np.pad(grid, ((radius, radius), (0, 0)), mode="edge")
        filtered = np.zeros_like(grid)
        for offset, weight in enumerate(kernel):
            filtered += weight * padded[offset : offset + len(grid)]
        grid = np.ascontiguousarray(filtered.T)
    return grid


def _points_per_cell(sharp: Ground, seen: Ground, patch_m: float) -> Array:
    """Relative number of points in plan at every node: the slope's area times the share that matches.

    The share falls from 60 to 80 degrees of steepness, and where a patch spans a jump, which shows
    as one to two patches between the sharp and the smooth surface.
    """
    north, east = np.gradient(seen.heights, seen.cell_m)
    slope = np.hypot(east, north)
    share = np.clip((np.deg2rad(80.0) - np.arctan(slope)) / np.deg2rad(20.0), 0.0, 1.0)
    share *= np.clip(2.0 - np.abs(seen.heights - sharp.heights) / patch_m, 0.0, 1.0)
    weights = np.sqrt(1.0 + slope * slope) * share
    weights[seen.materials == Material.WATER] *= WATER_SHARE
    return np.asarray(weights)


def _sample(site: Site, seen: Ground, weights: Array, pitch_m: float, seed: int) -> _Samples:
    """Draw points about `pitch_m` apart: over the top surface, then over the walls in view."""
    area = site.photogrammetry_area
    rng = stream(seed, "matching places")
    n_x = max(int(np.ceil((area.east - area.west) / pitch_m)), 1)
    n_y = max(int(np.ceil((area.north - area.south) / pitch_m)), 1)
    size_x, size_y = (area.east - area.west) / n_x, (area.north - area.south) / n_y
    column, row = (index.ravel() for index in np.meshgrid(np.arange(n_x), np.arange(n_y)))
    node_column = ((area.west + (column + 0.5) * size_x - seen.west) / seen.cell_m).astype(np.intp)
    node_row = ((area.south + (row + 0.5) * size_y - seen.south) / seen.cell_m).astype(np.intp)
    # One point in each cell of level ground; elsewhere the number is rounded at random.
    count = np.floor(weights[node_row, node_column] + rng.random(len(row))).astype(np.intp)
    column, row = np.repeat(column, count), np.repeat(row, count)
    # Not quite to the cells' borders: image pixels spread their points more evenly than chance.
    x = area.west + (column + rng.uniform(0.15, 0.85, len(column))) * size_x
    y = area.south + (row + rng.uniform(0.15, 0.85, len(row))) * size_y
    top = _Samples(np.column_stack([x, y, seen.height(x, y)]), seen.normals(x, y), seen.material(x, y))
    walls = _walls(site, pitch_m / np.sqrt(WALL_SHARE), seed)
    return _Samples.join([top, walls])


def _walls(site: Site, spacing_m: float, seed: int) -> _Samples:
    """Points on the steep sides of solids that an oblique camera sees."""
    area = site.photogrammetry_area
    rng = stream(seed, "matching walls")
    centres = np.stack([solid.centre for solid in site.solids])
    radii = np.array([solid.radius_m for solid in site.solids])
    parts = [_Samples(np.empty((0, 3)), np.empty((0, 3)), np.empty(0, dtype=np.uint8))]
    for index, solid in enumerate(site.solids):
        points = solid.side_points(spacing_m, rng)
        normals = solid.normals(points)
        kept = area.contains(points[:, 0], points[:, 1]) & (np.abs(normals[:, 2]) < 0.6)
        kept &= points[:, 2] > site.ground.height(points[:, 0], points[:, 1])
        if not kept.any():
            continue
        points, normals = points[kept], normals[kept]
        near = np.linalg.norm(centres - solid.centre, axis=1) < radii + radii[index] + CLEAR_M
        near[index] = False
        in_view = _in_view(site, points, normals, [site.solids[other] for other in np.flatnonzero(near)])
        material = np.full(len(points), solid.material, dtype=np.uint8)
        parts.append(_Samples(points, normals, material).take(in_view))
    return _Samples.join(parts)


def _in_view(site: Site, points: Array, normals: Array, others: Sequence[Solid]) -> NDArray[np.bool_]:
    """Tell which points of shape (n, 3) at least one oblique camera sees, past the ground and solids."""
    level, rise = np.cos(CAMERA_ELEVATION_RAD), np.sin(CAMERA_ELEVATION_RAD)
    steps = np.arange(0.3, 12.0, 0.6)
    outside = np.ones(len(points), dtype=bool)
    for other in others:
        outside &= ~other.contains(points)
    in_view = np.zeros(len(points), dtype=bool)
    for azimuth in CAMERA_AZIMUTHS_RAD:
        camera = np.array([level * np.cos(azimuth), level * np.sin(azimuth), rise])
        rows = np.flatnonzero(outside & ~in_view & (normals @ camera > LEAST_CAMERA_COSINE))
        if len(rows) == 0:
            continue
        start = points[rows]
        path = start[:, None, :] + steps[:, None] * camera
        free = (site.ground.height(path[..., 0], path[..., 1]) < path[..., 2]).all(axis=1)
        for other in others:
            free &= np.isinf(other.first_hit(start, camera))
        in_view[rows] = free
    return in_view


def _matched(sharp: Ground, samples: _Samples, noise_m: float, outlier_share: float, seed: int) -> PointCloud:
    """Add noise, mismatches and attributes."""
    n_points = len(samples.xyz)
    colours = _colours(sharp, samples, seed)
    classification = LAS_CLASS[samples.material]

    upright = np.abs(samples.normals[:, 2])
    noise = noise_m * (1.0 + 2.0 * (1.0 - upright)) * stream(seed, "matching noise").standard_normal(n_points)
    noise *= np.where(samples.material == Material.WATER, 6.0, 1.0)
    xyz = samples.xyz + noise[:, None] * samples.normals

    rng = stream(seed, "matching strays")
    strays = rng.permutation(n_points)[: round(outlier_share * n_points)]
    xyz[strays, 2] += rng.choice([-1.0, 1.0], len(strays)) * (0.3 + rng.exponential(1.2, len(strays)))
    classification[strays] = LAS_CLASS_STRAY

    attributes: dict[str, NDArray[Any]] = {
        "red": colours[:, 0],
        "green": colours[:, 1],
        "blue": colours[:, 2],
        "classification": classification,
    }
    return PointCloud(xyz, attributes, name="simulated photogrammetry")


def _colours(sharp: Ground, samples: _Samples, seed: int) -> NDArray[np.uint16]:
    """Colour of each material in sunlight and shadow, mottled and noisy, shape (n, 3)."""
    x, y, z = samples.xyz.T
    n_y, n_x = sharp.heights.shape
    axis_x: Array = sharp.west + sharp.cell_m * np.arange(n_x, dtype=np.float64)
    axis_y: Array = sharp.south + sharp.cell_m * np.arange(n_y, dtype=np.float64)
    mottle = value_noise(axis_x, axis_y, 5.7, seed, "mottle")
    column = np.clip(np.rint((x - sharp.west) / sharp.cell_m).astype(np.intp), 0, n_x - 1)
    row = np.clip(np.rint((y - sharp.south) / sharp.cell_m).astype(np.intp), 0, n_y - 1)

    sun = np.array([SUN_EAST, SUN_NORTH, SUN_TANGENT * np.hypot(SUN_EAST, SUN_NORTH)])
    lit = z > _shadow_heights(sharp.heights, sharp.cell_m)[row, column] - 0.15
    light = 0.5 + 0.62 * np.where(lit, np.maximum(samples.normals @ (sun / np.linalg.norm(sun)), 0.0), 0.0)
    light *= 1.0 + 0.09 * mottle[row, column]
    light *= 1.0 + 0.05 * stream(seed, "matching light").standard_normal(len(x))
    tint = 1.0 + 0.025 * stream(seed, "matching tint").standard_normal((len(x), 3))
    colours = COLOURS[samples.material] * light[:, None] * tint
    return np.clip(np.rint(65535.0 * colours), 0, 65535).astype(np.uint16)


def _shadow_heights(heights: Array, cell_m: float) -> Array:
    """Height below which each node lies in shadow, by one sweep of the rows away from the sun."""
    drop = cell_m * SUN_TANGENT * np.hypot(SUN_EAST, SUN_NORTH) / abs(SUN_NORTH)
    # From one row to the next the shadow also moves sideways, by whole nodes.
    sideways = np.rint(np.arange(len(heights)) * (SUN_EAST / SUN_NORTH)).astype(np.intp)
    shadow = np.empty_like(heights)
    shadow[0] = -np.inf
    for row in range(1, len(heights)):
        shift = int(sideways[row] - sideways[row - 1])
        shadow[row] = np.maximum(heights[row - 1], shadow[row - 1])
        if shift:
            shadow[row, shift:] = shadow[row, :-shift].copy()
        shadow[row] -= drop
    return shadow
