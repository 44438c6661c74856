"""A site surveyed from many stations and from the air, each cloud in a frame of its own.

Why: where every station truly stands is known here, and nowhere else. Every scan is of one tripod place
with a short reach, so that neighbours share a part and most pairs share nothing.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from tmchho.arguments import checked_choice, checked_count, checked_number, checked_seed
from tmchho.cloud import PointCloud
from tmchho.errors import InvalidArgumentError
from tmchho.simulate.arguments import checked_n_points, stream
from tmchho.simulate.ground import Area, Array
from tmchho.simulate.materials import Material
from tmchho.simulate.photogrammetry import survey_photogrammetry
from tmchho.simulate.scanner import survey_scanner
from tmchho.simulate.site import MARGIN_M, Site, make_site
from tmchho.simulate.solids import Solid, random_rotation, turned
from tmchho.simulate.stations import INSTRUMENT_HEIGHT_M

# Stations are this far apart, by their reach: neighbours then share a third to half of what they see.
SPACING_BY_REACH = 0.85
# The pad that is levelled round a pier.
PAD_M, PAD_RIM_M = 20.0, 26.0
SMALL_TILT_RAD = np.deg2rad(2.0)


@dataclass(frozen=True, eq=False)
class SimulatedNetwork:
    """Clouds of one site, and the truth about their frames.

    Parameters
    ----------
    names : tuple of str
        ``S01`` … for the scans, ``pier A`` and ``pier B`` where asked for, ``UAV`` for the block.
    clouds : tuple of PointCloud
        Each in its own frame; a scan has its instrument at the origin.
    world_from_station : tuple of (4, 4) float64 array
        Takes a cloud's coordinates to those of the site; that of the block may contain a scale.
    site : Site
        The scene.
    """

    names: tuple[str, ...]
    clouds: tuple[PointCloud, ...]
    world_from_station: tuple[Array, ...]
    site: Site


def make_network(
    *,
    n_stations: int = 22,
    reach_m: float = 50.0,
    n_points: int = 60_000,
    n_block_points: int = 400_000,
    block_scale: float = 1.0,
    frames: Literal["random", "levelled"] = "random",
    equal_piers: bool = False,
    pier_reach_m: float = 17.0,
    seed: int = 0,
) -> SimulatedNetwork:
    """Survey a dam site from tripod places spread over it, and from the air.

    Parameters
    ----------
    n_stations : int, default 22
        Number of scans; 2 to 400.
    reach_m : float, default 50
        How far a scan sees, in metres; 10 to 200. The site is made as large as the stations need.
    n_points : int, default 60000
        Points of each scan.
    n_block_points : int, default 400000
        Points of the block; 0 for none. It covers the stations' area.
    block_scale : float, default 1
        True length of what is one unit long in the block; 0.1 to 10.
    frames : {'random', 'levelled'}
        How the clouds are turned: evenly over all rotations, or about the vertical with a tilt of up to 2°.
    equal_piers : bool, default False
        Build the same pier twice, each scanned from the same side by one more station: the two scans look
        alike though they share nothing.
    pier_reach_m : float, default 17
        How far these two see, in metres; 10 to 200. With 17 m they see little but pier and pad, which are the
        same; with 27 m a sixth of a scan is what lies about them, which is not.
    seed : int, default 0
        Fixes everything.

    Returns
    -------
    SimulatedNetwork

    Raises
    ------
    InvalidArgumentError
        If an argument is out of its range.
    """
    n_stations = checked_count("n_stations", n_stations, 2, 400)
    reach_m = checked_number("reach_m", reach_m, 10.0, 200.0)
    n_points = checked_n_points("n_points", n_points)
    n_block_points = checked_count("n_block_points", n_block_points, 0, 50_000_000)
    pier_reach_m = checked_number("pier_reach_m", pier_reach_m, 10.0, 200.0)
    block_scale = checked_number("block_scale", block_scale, 0.1, 10.0)
    checked_choice("frames", frames, ("random", "levelled"))
    seed = checked_seed(seed)
    size_m = float(np.clip(np.sqrt(n_stations) * SPACING_BY_REACH * reach_m, 80.0, 600.0))
    site = make_site(size_m=size_m, area_ratio=1.0, seed=seed)
    piers: list[Array] = []
    if equal_piers:
        site, piers = _with_piers(site)
    eyes = [*_spread_places(site, n_stations, seed), *piers]
    names = [f"S{number:02d}" for number in range(1, n_stations + 1)]
    names += ["pier A", "pier B"] if equal_piers else []
    clouds, poses = [], []
    for number, (name, eye) in enumerate(zip(names, eyes, strict=True)):
        reach = pier_reach_m if number >= n_stations else reach_m
        # Nothing farther than the reach is seen or in the way; a smaller scene is traced sooner.
        window = Area(eye[0] - reach, eye[1] - reach, eye[0] + reach, eye[1] + reach)
        area = site.scanner_area
        window = Area(
            max(window.west, area.west),
            max(window.south, area.south),
            min(window.east, area.east),
            min(window.north, area.north),
        )
        seen = survey_scanner(
            replace(site, scanner_area=window),
            stations=eye[None, :2],
            n_points=n_points,
            max_range_m=reach,
            seed=seed + 1000 * (number + 1),
        )
        pose = _frame(frames, eye, stream(seed, "frame", number))
        clouds.append(_in_frame(seen, pose, name))
        poses.append(pose)
    if n_block_points:
        block = survey_photogrammetry(site, n_points=n_block_points, seed=seed)
        pose = _frame(frames, block.xyz.mean(axis=0), stream(seed, "frame", len(eyes)))
        pose[:3, :3] *= block_scale
        names.append("UAV")
        clouds.append(_in_frame(block, pose, "UAV"))
        poses.append(pose)
    return SimulatedNetwork(tuple(names), tuple(clouds), tuple(poses), site)


def _spread_places(site: Site, count: int, seed: int) -> list[Array]:
    """Choose dry, clear places one after the other, each as far as possible from those before."""
    area = site.scanner_area
    size = area.east - area.west
    rng = stream(seed, "network stations")
    x, y = np.array([[area.west], [area.south]]) + size * rng.uniform(0.06, 0.94, (2, 40 * count))
    around = np.stack([site.ground.height(x + dx, y + dy) for dx in (-1.5, 1.5) for dy in (-1.5, 1.5)])
    good = (np.ptp(around, axis=0) < 1.5) & (site.ground.material(x, y) != Material.WATER)
    for solid in site.solids:
        good &= np.hypot(x - solid.centre[0], y - solid.centre[1]) > solid.radius_m + 1.0
    places = np.column_stack([x, y])[good]
    if len(places) < count:
        raise InvalidArgumentError(
            f"n_stations: only {len(places)} level places found, {count} wanted; ask for fewer"
        )
    chosen = [0]
    apart = np.linalg.norm(places - places[0], axis=1)
    for _ in range(count - 1):
        chosen.append(int(np.argmax(apart)))
        apart = np.minimum(apart, np.linalg.norm(places - places[chosen[-1]], axis=1))
    return [_instrument(site, places[row]) for row in chosen]


def _instrument(site: Site, place: Array) -> Array:
    height = float(site.ground.height(place[:1], place[1:2])[0])
    return np.array([place[0], place[1], height + INSTRUMENT_HEIGHT_M])


def _with_piers(site: Site) -> tuple[Site, list[Array]]:
    """Return the site with a pier built twice, and where its two stations stand."""
    ground, area = site.ground, site.scanner_area
    size = area.east - area.west
    heights = ground.heights.copy()
    materials = ground.materials.copy()
    n_y, n_x = heights.shape
    x = ground.west + ground.cell_m * np.arange(n_x)
    y = ground.south + ground.cell_m * np.arange(n_y)
    solids, eyes, middles = list(site.solids), [], []
    for east, north in ((0.22, 0.25), (0.76, 0.72)):
        middle = np.array([area.west + east * size, area.south + north * size])
        level = float(ground.height(middle[:1], middle[1:2])[0])
        away = np.hypot(x[None, :] - middle[0], y[:, None] - middle[1])
        share = np.clip((PAD_RIM_M - away) / (PAD_RIM_M - PAD_M), 0.0, 1.0)
        heights = heights * (1.0 - share) + level * share
        materials[away < PAD_M] = Material.CONCRETE
        middles.append((middle, level))
    for middle, _ in middles:
        reach = PAD_RIM_M + MARGIN_M
        solids = [s for s in solids if np.hypot(*(s.centre[:2] - middle)) > reach + s.radius_m]
    for middle, level in middles:
        foot = np.array([middle[0], middle[1], level])
        solids += [replace(part, centre=part.centre + foot) for part in _pier_parts()]
        eyes.append(np.array([middle[0] - 6.0, middle[1] - 8.0, level + INSTRUMENT_HEIGHT_M]))
    return replace(
        site, ground=replace(ground, heights=heights, materials=materials), solids=tuple(solids)
    ), eyes


def _pier_parts() -> list[Solid]:
    """Return a pier with footing, shaft, head, a tube and blocks about it: nothing is symmetrical."""
    parts: list[tuple[Literal["box", "cylinder"], tuple[float, ...], tuple[float, ...], float]] = [
        ("box", (0.0, 0.0, 0.5), (4.0, 2.5, 0.5), 0.2),
        ("box", (0.0, 0.0, 4.5), (2.2, 1.1, 3.5), 0.2),
        ("box", (0.4, 0.2, 8.6), (3.4, 1.6, 0.6), 0.2),
        ("cylinder", (-2.9, 1.2, 4.0), (0.6, 0.6, 4.0), 0.0),
        ("box", (5.5, -3.0, 0.7), (0.9, 0.6, 0.7), 0.7),
        ("box", (-6.5, 2.5, 0.5), (1.2, 0.5, 0.5), -0.4),
        ("box", (2.0, 6.5, 1.0), (0.7, 1.6, 1.0), 1.1),
        ("cylinder", (6.0, 5.0, 0.6), (0.8, 0.8, 0.6), 0.0),
    ]
    return [
        Solid(shape, np.array(centre), turned(yaw), np.array(half), Material.CONCRETE)
        for shape, centre, half, yaw in parts
    ]


def _frame(frames: str, origin: Array, rng: np.random.Generator) -> Array:
    """Draw ``world_from_station`` of a frame whose origin lies at a place of the site."""
    pose = np.eye(4)
    if frames == "random":
        pose[:3, :3] = random_rotation(rng)
    else:
        lean = SMALL_TILT_RAD * rng.uniform(-1.0, 1.0, 2)
        pose[:3, :3] = turned(float(rng.uniform(-np.pi, np.pi)), float(lean[0]), float(lean[1]))
    pose[:3, 3] = origin
    return pose


def _in_frame(cloud: PointCloud, world_from_station: Array, name: str) -> PointCloud:
    back = np.linalg.inv(world_from_station)
    return replace(cloud, xyz=cloud.xyz @ back[:3, :3].T + back[:3, 3], name=name)
