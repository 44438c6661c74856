"""What must not matter does not: where clouds lie, the order of points, the unit, which is moved, copies."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import Floats, field, moved, pose

import tmchho

seeds = st.integers(0, 2**32 - 1)
units = st.sampled_from([1000.0, 0.001, 1 / 0.3048, 1e6])
# Registrations are dear, and must not fail by chance: always the same cases.
few = settings(max_examples=2, deadline=None, derandomize=True)
many = settings(max_examples=40, deadline=None, derandomize=True)


def surveys(seed: int, n_points: int = 1500) -> tuple[Floats, Floats]:
    """Return two surveys of one field, the source in a frame of its own."""
    source, target = field(n_points, 0, 50, survey=seed), field(n_points + 300, 8, 60, survey=seed + 1)
    return moved(np.linalg.inv(pose(seed)), source), target


def farthest(one: Floats, other: Floats) -> float:
    return float(np.linalg.norm(one - other, axis=1).max())


def repeated(points: Floats, rng: np.random.Generator) -> Floats:
    """Return the points, half of them up to three more times, in another order."""
    again = rng.integers(0, len(points), 3 * len(points) // 2)
    return rng.permutation(np.concatenate([points, points[again]]))


# ---- the pose


@few
@given(seeds)
def test_a_motion_of_either_cloud_goes_into_the_pose(seed: int) -> None:
    source, target = surveys(seed)
    found = tmchho.register(source, target)
    first, second = pose(seed + 2), pose(seed + 3)
    elsewhere = tmchho.register(moved(first, source), moved(second, target))
    expected = second @ found.transformation @ np.linalg.inv(first)
    there = moved(first, source)
    assert farthest(elsewhere.apply(there), moved(expected, there)) < 0.5 * found.voxel_size


@few
@given(seeds)
def test_the_order_of_points_and_copies_do_not_matter(seed: int) -> None:
    source, target = surveys(seed)
    rng = np.random.default_rng(seed)
    found = tmchho.register(source, target)
    mixed = tmchho.register(rng.permutation(source), rng.permutation(target))
    assert farthest(mixed.apply(source), found.apply(source)) < 0.5 * found.voxel_size
    assert mixed.verdict == found.verdict
    more = tmchho.register(repeated(source, rng), repeated(target, rng))
    assert farthest(more.apply(source), found.apply(source)) < 0.5 * found.voxel_size


@few
@given(seeds, units)
def test_the_unit_does_not_matter_and_swapped_clouds_give_the_inverse(seed: int, unit: float) -> None:
    source, target = surveys(seed)
    found = tmchho.register(source, target)
    other = tmchho.register(unit * source, unit * target)
    assert farthest(other.apply(unit * source) / unit, found.apply(source)) < 1e-6
    assert other.verdict == found.verdict
    back = tmchho.register(target, source)
    assert farthest(back.apply(found.apply(source)), source) < 0.5 * found.voxel_size


# ---- the stages


@st.composite
def clouds(draw: st.DrawFn) -> tuple[np.random.Generator, Floats, Floats]:
    """Give a generator and two clouds of some points; some places are taken more than once."""
    rng = np.random.default_rng(draw(seeds))
    spread = draw(st.sampled_from([1e-3, 1.0, 500.0]))
    both = [spread * rng.normal(size=(draw(st.integers(4, 60)), 3)) for _ in range(2)]
    return rng, np.concatenate([both[0], both[0][:2]]), both[1]


def rigid(rng: np.random.Generator) -> Floats:
    return pose(int(rng.integers(10**6)))


@many
@given(clouds(), units)
def test_distances_depend_on_the_places_alone(
    drawn: tuple[np.random.Generator, Floats, Floats], unit: float
) -> None:
    rng, source, target = drawn
    expected = tmchho.nearest_distances(source, target)
    size = np.abs(source).max() + np.abs(target).max()
    motion = rigid(rng)
    together = tmchho.nearest_distances(moved(motion, source), moved(motion, target))
    np.testing.assert_allclose(together, expected, atol=1e-12 * (size + 200))
    order = rng.permutation(len(source))
    mixed = tmchho.nearest_distances(source[order], repeated(target, rng))
    np.testing.assert_allclose(mixed, expected[order], rtol=1e-9)
    scaled = tmchho.nearest_distances(unit * source, unit * target)
    np.testing.assert_allclose(scaled / unit, expected, rtol=1e-9, atol=1e-12 * size)


@many
@given(clouds(), units)
def test_the_spacing_depends_on_the_places_alone(
    drawn: tuple[np.random.Generator, Floats, Floats], unit: float
) -> None:
    rng, cloud, _ = drawn
    expected = tmchho.median_spacing(cloud)
    assert np.isclose(tmchho.median_spacing(moved(rigid(rng), cloud)), expected, rtol=1e-6, atol=1e-10)
    assert tmchho.median_spacing(rng.permutation(cloud)) == expected
    assert np.isclose(tmchho.median_spacing(unit * cloud) / unit, expected, rtol=1e-9)


@many
@given(clouds(), units)
def test_the_best_pose_of_pairs_moves_with_them(
    drawn: tuple[np.random.Generator, Floats, Floats], unit: float
) -> None:
    rng, source, _ = drawn
    size = np.abs(source).max()
    target = moved(rigid(rng), source) + 1e-3 * size * rng.normal(size=source.shape)
    expected = tmchho.kabsch(source, target)
    atol = 1e-9 * (size + 200)
    first, second = rigid(rng), rigid(rng)
    elsewhere = tmchho.kabsch(moved(first, source), moved(second, target))
    conjugated = second @ expected @ np.linalg.inv(first)
    np.testing.assert_allclose(moved(elsewhere, source), moved(conjugated, source), atol=atol)
    np.testing.assert_allclose(tmchho.kabsch(target, source) @ expected, np.eye(4), atol=atol)
    order = rng.permutation(len(source))
    again = np.concatenate([order, order])
    np.testing.assert_allclose(
        moved(tmchho.kabsch(source[again], target[again]), source), moved(expected, source), atol=atol
    )
    scaled = tmchho.kabsch(unit * source, unit * target)
    np.testing.assert_allclose(
        moved(scaled, unit * source) / unit, moved(expected, source), atol=atol * max(1, 1 / unit)
    )


@many
@given(clouds())
def test_swapped_clouds_swap_what_is_measured(drawn: tuple[np.random.Generator, Floats, Floats]) -> None:
    rng, source, target = drawn
    forth = tmchho.evaluate(source, target, tolerance=1.0)
    back = tmchho.evaluate(target, source, tolerance=1.0)
    np.testing.assert_allclose(forth.source_to_target, back.target_to_source, rtol=1e-9)
    np.testing.assert_allclose(forth.target_to_source, back.source_to_target, rtol=1e-9)
    motion = rigid(rng)
    there = tmchho.evaluate(moved(motion, source), target, np.linalg.inv(motion))
    size = np.abs(source).max() + np.abs(target).max()
    np.testing.assert_allclose(there.source_to_target, forth.source_to_target, atol=1e-12 * (size + 200))


@many
@given(seeds, units)
def test_outliers_are_the_same_points_in_any_frame_order_and_unit(seed: int, unit: float) -> None:
    rng = np.random.default_rng(seed)
    # On a lattice of odd edges no two neighbours tie at the radius, and the strays are far from all.
    lattice = np.stack(np.meshgrid(np.arange(8.0), np.arange(7.0), np.arange(2.0)), axis=-1).reshape(-1, 3)
    cloud = np.concatenate([lattice * [1.0, 1.03, 1.07], rng.uniform(40, 900, (5, 3))])
    expected = set(tmchho.remove_outliers(cloud).indices.tolist())
    assert expected == set(range(len(lattice)))
    assert set(tmchho.remove_outliers(unit * moved(rigid(rng), cloud)).indices.tolist()) == expected
    order = rng.permutation(len(cloud))
    assert set(order[tmchho.remove_outliers(cloud[order]).indices].tolist()) == expected
