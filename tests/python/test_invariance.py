"""What must not change the answer does not: the unit and the place on Earth.

Poses are compared on what they do with points: a difference of 1e-6 m anywhere on the cloud fails. That the
number of threads changes no bit is in tests/python/test_api.py.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scenes import Floats, moved, pair, pose

import tmchho

GRID = np.array([500_000.0, 4_000_000.0, 200.0])
TOLERANCE_M = 1e-6


@cache
def clouds() -> tuple[Floats, Floats]:
    """Return two surveys of one field, the source turned and shifted."""
    source, target = pair()
    return moved(pose(1), source), target


@cache
def found() -> tmchho.Registration:
    source, target = clouds()
    return tmchho.register(source, target)


def test_the_pose_is_the_true_one() -> None:
    """Or the others would only show that the same mistake is made everywhere."""
    source, _ = clouds()
    away = found().apply(source) - moved(np.linalg.inv(pose(1)), source)
    assert np.abs(away).max() < 0.05
    assert found().verdict == "accepted"


@pytest.mark.parametrize("unit", [1000.0, 1 / 0.3048], ids=["millimetres", "feet"])
def test_the_unit_does_not_matter(unit: float) -> None:
    source, target = clouds()
    other = tmchho.register(source * unit, target * unit)
    assert np.abs(other.apply(source * unit) / unit - found().apply(source)).max() < TOLERANCE_M
    assert np.abs(other.transformation[:3, :3] - found().transformation[:3, :3]).max() < 1e-8
    assert other.verdict == found().verdict
    assert other.ambiguity_ratio == pytest.approx(found().ambiguity_ratio, rel=1e-6)
    assert other.voxel_size / unit == pytest.approx(found().voxel_size, rel=1e-9)
    assert other.inlier_rmse / unit == pytest.approx(found().inlier_rmse, abs=TOLERANCE_M)


@pytest.mark.parametrize(
    ("source_at", "target_at"),
    [(GRID, GRID), (GRID, 0 * GRID), (0 * GRID, GRID)],
    ids=["both", "source", "target"],
)
def test_the_place_on_earth_does_not_matter(source_at: Floats, target_at: Floats) -> None:
    source, target = clouds()
    there = tmchho.register(source + source_at, target + target_at)
    away = there.apply(source + source_at) - target_at - found().apply(source)
    assert np.abs(away).max() < TOLERANCE_M
    assert there.verdict == found().verdict
    assert there.inlier_rmse == pytest.approx(found().inlier_rmse, abs=TOLERANCE_M)
    # The matrix alone does it, too, to what its numbers of some millions can hold.
    by_matrix = moved(there.transformation, source + source_at) - target_at
    assert np.abs(by_matrix - found().apply(source)).max() < TOLERANCE_M
