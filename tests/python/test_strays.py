"""Registration of clouds full of strays: above the surface in one cloud and below it in the other."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import Floats, moved
from scipy.spatial.transform import Rotation

import tmchho

SIDE_M = 100.0


def hills(survey: int, stray_share: float, depth_m: float, noise_m: float, n_points: int = 20_000) -> Floats:
    """Return hills on a square, a share of the points up to `depth_m` above them (below, where negative)."""
    rng = np.random.default_rng([5, survey])
    xy = rng.uniform(0, SIDE_M, (n_points, 2))
    z = noise_m * rng.normal(size=n_points)
    shape = np.random.default_rng(5)
    for _ in range(40):
        centre, height, width = shape.uniform(0, SIDE_M, 2), shape.uniform(-8, 8), shape.uniform(5, 18)
        z += height * np.exp(-np.sum((xy - centre) ** 2, axis=1) / width**2)
    n_strays = round(stray_share * n_points)
    z[:n_strays] += depth_m * rng.uniform(size=n_strays)
    return np.column_stack([xy, z])


def pose() -> Floats:
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_euler("z", 0.7).as_matrix()
    matrix[:3, 3] = [30, -20, 5]
    return matrix


# Strays on strays agree 5 m off, where no surface is even: there they hide that the hills do not meet.
# Of the fewest strays about a quarter of the voxels are.
@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize(("stray_share", "depth_m"), [(0.3, 6.0), (0.5, 4.0), (0.5, 6.0)])
def test_strays_on_strays_are_no_pose(stray_share: float, depth_m: float, seed: int) -> None:
    there, target = hills(1, stray_share, depth_m, 0.05), hills(2, stray_share, -depth_m, 0.05)
    source = moved(pose(), there)
    found = tmchho.register(source, target, seed=seed)
    off_m = float(np.linalg.norm(found.apply(source) - there, axis=1).max())
    assert found.verdict != "accepted" or off_m < found.voxel_size, off_m


def test_strays_that_draw_surfaces_apart_are_left_out_of_the_fit() -> None:
    there, target = hills(1, 0.45, 2.5, 0.05), hills(2, 0.45, -2.5, 0.05)
    source = moved(pose(), there)
    found = tmchho.register(source, target, seed=0)
    assert found.verdict == "accepted", found.reasons
    # Once with them, and once without.
    assert [stage.name for stage in found.stages].count("icp") == 2
    assert found.surface_offset < 0.0006 * found.extent
    off_m = np.linalg.norm(found.apply(source) - there, axis=1).max()
    assert off_m < 0.2 * found.voxel_size
