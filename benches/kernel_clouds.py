"""The clouds on which kernels are measured: the simulated dam site, surveyed with as many points as wanted.

Rows keep the order of the survey, which suits libraries that do not sort their queries: the photogrammetry
comes from south to north, the scanner's points station by station and much denser near each of them.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from common import Array, moved

from tmchho.simulate import make_pair, make_site, survey_photogrammetry, survey_scanner

SHARE_OF_DUPLICATES = 0.3
SIDE_M = 120.0
START_DEG, START_M = 2.0, 0.62
EDGE_SEARCH_STEPS = 25


@lru_cache(maxsize=4)
def surveyed(n: int, sensor: str, seed: int = 0) -> Array:
    """Return one survey of the same site: 120 m × 120 m, `n` points, lower corner at the origin."""
    site = make_site(area_ratio=1.0)
    if sensor == "photogrammetry":
        cloud = survey_photogrammetry(site, n_points=n, seed=seed)
    elif sensor == "scanner":
        cloud = survey_scanner(site, n_points=n, seed=seed)
    else:
        raise ValueError(f"sensor must be 'photogrammetry' or 'scanner', got {sensor!r}")
    area = site.scanner_area
    return np.ascontiguousarray(cloud.xyz - [area.west, area.south, 0.0])


def flat(cloud: Array) -> Array:
    """Lay the cloud into one level plane."""
    return np.ascontiguousarray(cloud * [1.0, 1.0, 0.0])


def with_duplicates(cloud: Array) -> Array:
    """Put copies of other points in the place of three points in ten."""
    rng = np.random.default_rng(0)
    n_copies = round(SHARE_OF_DUPLICATES * len(cloud))
    chosen = rng.permutation(len(cloud))
    copied = cloud.copy()
    copied[chosen[:n_copies]] = cloud[rng.choice(chosen[n_copies:], n_copies)]
    return copied


def start_pose(cloud: Array) -> Array:
    """Return a pose that is off by a small turn about the cloud's middle and a shift."""
    axis = np.array([0.36, -0.48, 0.8])
    angle = np.radians(START_DEG)
    cross = np.cross(np.eye(3), axis)
    pose = np.eye(4)
    pose[:3, :3] += np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    middle = cloud.mean(axis=0)
    pose[:3, 3] = middle - pose[:3, :3] @ middle + START_M * np.array([0.6, 0.64, -0.48])
    return pose


def voxel_keys(cloud: Array, edge: float, low: Array) -> Array:
    """Return one number for each point, the same for all points of a voxel."""
    places = np.floor((cloud - low) / edge).astype(np.int64)
    n_x, n_y = places[:, 0].max() + 1, places[:, 1].max() + 1
    return np.asarray((places[:, 2] * n_y + places[:, 1]) * n_x + places[:, 0])


def edge_for_share(cloud: Array, share: float) -> float:
    """Return the voxel edge that leaves this share of the points, to 1 %."""
    low = cloud.min(axis=0)
    smallest, largest = 1e-3, float(np.ptp(cloud, axis=0).max())
    for _ in range(EDGE_SEARCH_STEPS):
        edge = float(np.sqrt(smallest * largest))
        found = len(np.unique(voxel_keys(cloud, edge, low))) / len(cloud)
        if abs(found / share - 1) < 0.01:
            break
        smallest, largest = (edge, largest) if found > share else (smallest, edge)
    return edge


def in_the_corner(cloud: Array) -> Array:
    """Shift the cloud so that grids that stand on 0 and on the lower corner are one."""
    return np.ascontiguousarray(cloud - cloud.min(axis=0))


def away(cloud: Array) -> Array:
    """Return the cloud moved so that `start_pose` is what ICP has to undo."""
    return moved(np.asarray(np.linalg.inv(start_pose(cloud)), np.float64), cloud)


def route_pair(n: int) -> tuple[Array, Array, Array]:
    """Return source, target and the true pose of two surveys of `n` points each."""
    pair = make_pair(n_photogrammetry_points=n, n_scanner_points=n, national_grid=False)
    return pair.source.xyz, pair.target.xyz, pair.target_from_source
