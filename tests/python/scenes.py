"""A field with boulders, surveyed twice at random, made by numpy alone."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Floats = NDArray[np.float64]


def field(n_points: int, low: float, high: float, *, scene: int = 0, survey: int = 0) -> Floats:
    """Return points of the strip low < x < high of a field of 60 m by 40 m, drawn anew for each survey."""
    shape = np.random.default_rng([1, scene])
    waves = shape.uniform(0.05, 0.35, (6, 2)) * shape.choice([-1, 1], (6, 2))
    phases, heights = shape.uniform(0, 2 * np.pi, 6), shape.uniform(0.3, 1.2, 6)
    middles, radii = shape.uniform([0, 0], [60, 40], (50, 2)), shape.uniform(0.8, 2.5, 50)

    drawn = np.random.default_rng([2, scene, survey])
    xy = drawn.uniform([low, 0], [high, 40], (n_points, 2))
    z = (heights * np.sin(xy @ waves.T + phases)).sum(axis=1)
    squared = radii**2 - ((xy[:, None] - middles) ** 2).sum(axis=2)
    z += np.sqrt(np.maximum(squared, 0)).max(axis=1)
    return np.column_stack([xy, z]) + drawn.normal(0, 0.01, (n_points, 3))


def pose(seed: int, shift: float = 100.0) -> Floats:
    """Return a random rigid (4, 4) transform: any rotation, shifts within ± `shift`."""
    rng = np.random.default_rng([3, seed])
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_quat(rng.normal(size=4)).as_matrix()
    matrix[:3, 3] = rng.uniform(-shift, shift, 3)
    return matrix


def moved(matrix: Floats, points: Floats) -> Floats:
    """Return the points moved by a (4, 4) transform."""
    return points @ matrix[:3, :3].T + matrix[:3, 3]


def pair(n_points: int = 6000, scene: int = 0) -> tuple[Floats, Floats]:
    """Return two surveys in one frame; each has a margin of 8 to 10 m that the other lacks."""
    return field(n_points, 0, 50, scene=scene, survey=1), field(n_points + 1000, 8, 60, scene=scene, survey=2)


# A search of a fraction of a second, for tests that are not about the search; it finds poses near the
# identity, which is always tried.
QUICK = {"coarse": {"rotations_per_round": [8], "n_verified": 2}}
