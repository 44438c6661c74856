"""Every stage against a twin made of numpy and scipy alone."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from itertools import islice

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import Floats, field, moved, pair, pose
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

import tmchho

_RNG = np.random.default_rng(11)
_GRID = np.stack(np.meshgrid(*[np.arange(7.0)] * 3), axis=-1).reshape(-1, 3)

# Random ones, and those on which trees, grids and eigenvalues come to grief.
CLOUDS: dict[str, Floats] = {
    "uniform": _RNG.random((800, 3)) * 10,
    "field": field(800, 0, 20),
    "national grid": _RNG.random((500, 3)) * 30 + [5.1e5, 4.2e6, 300.0],
    "clusters": np.repeat(_RNG.random((8, 3)) * 100, 60, axis=0) + _RNG.normal(0, 0.1, (480, 3)),
    "plane": _RNG.random((500, 3)) * [10, 10, 0],
    "line": np.outer(_RNG.random(300) * 50, [1.0, 2.0, -1.0]),
    "lattice": _GRID,
    "doubles": np.concatenate([_GRID[:100]] * 3),
    "identical": np.full((60, 3), 3.25),
    "two points": np.array([[0.0, 0.0, 0.0], [1.0, 2.0, 2.0]]),
    "one point": np.array([[1.0, 2.0, 3.0]]),
}
every_cloud = pytest.mark.parametrize("name", CLOUDS)


# ---- Eq. (1)

angles = st.floats(-10, 10)
shifts = st.floats(-1e6, 1e6)


@given(st.tuples(angles, angles, angles, shifts, shifts, shifts))
def test_the_matrix_is_that_of_scipy(parameters: tuple[float, ...]) -> None:
    matrix = tmchho.euler_to_matrix(parameters)
    expected = Rotation.from_euler("xyz", parameters[:3]).as_matrix().T
    np.testing.assert_allclose(matrix[:3, :3], expected, atol=1e-14)
    np.testing.assert_array_equal(matrix[:3, 3], parameters[3:])
    np.testing.assert_array_equal(matrix[3], [0, 0, 0, 1])
    back = tmchho.matrix_to_euler(matrix)
    assert abs(back[1]) <= math.pi / 2
    np.testing.assert_allclose(tmchho.euler_to_matrix(back), matrix, atol=1e-7)


@pytest.mark.parametrize("theta_y", [math.pi / 2, -math.pi / 2])
def test_parameters_are_found_where_two_axes_fall_together(theta_y: float) -> None:
    matrix = tmchho.euler_to_matrix([0.4, theta_y, -1.1, 1, 2, 3])
    back = tmchho.matrix_to_euler(matrix)
    assert back[2] == 0.0
    np.testing.assert_allclose(tmchho.euler_to_matrix(back), matrix, atol=1e-7)


@settings(max_examples=20)
@given(st.integers(0, 10**6))
def test_rms_is_the_formula(seed: int) -> None:
    rng = np.random.default_rng(seed)
    source, target = rng.random((60, 3)) * 10, rng.random((80, 3)) * 10
    parameters = [*rng.uniform(-4, 4, 3), *rng.uniform(-9, 9, 3)]
    rotation = Rotation.from_euler("xyz", parameters[:3]).as_matrix().T
    distances = cKDTree(target).query(source @ rotation.T + parameters[3:])[0]
    expected = math.sqrt((distances**2).mean())
    assert tmchho.rms_fitness(source, target, parameters) == pytest.approx(expected, rel=1e-12)


# ---- neighbours


@every_cloud
def test_nearest_distances_are_those_of_a_tree(name: str) -> None:
    target = CLOUDS[name]
    source = np.concatenate([target[::3], target[:50] + 0.37, target[:1] - 1e3])
    expected = cKDTree(target).query(source)[0]
    scale = np.abs(target).max() * 1e-15
    np.testing.assert_allclose(
        tmchho.nearest_distances(source, target), expected, rtol=1e-12, atol=max(scale, 1e-12)
    )


@every_cloud
def test_the_spacing_is_the_median_distance_to_somewhere_else(name: str) -> None:
    places = np.unique(CLOUDS[name], axis=0)
    if len(places) < 2:
        assert tmchho.median_spacing(CLOUDS[name]) == 0.0
        return
    nearest = cKDTree(places).query(CLOUDS[name], k=2)[0][:, 1]
    ours = tmchho.median_spacing(CLOUDS[name])
    assert ours == pytest.approx(np.quantile(nearest, 0.5, method="nearest"), rel=1e-9, abs=1e-9) or (
        np.sort(nearest)[(len(nearest) - 1) // 2] <= ours <= np.sort(nearest)[len(nearest) // 2]
    )


@every_cloud
@pytest.mark.parametrize("min_neighbors", [0, 1, 3, 10])
def test_outliers_are_those_with_few_neighbours(name: str, min_neighbors: int) -> None:
    points = CLOUDS[name]
    extent = np.ptp(points, axis=0).max()
    for radius in (0.11 * extent + 0.013, 1.7):
        # A distance that rounding could put on either side of the rim decides nothing here.
        inner, outer = (cKDTree(points).query_ball_point(points, radius * f) for f in (1 - 1e-9, 1 + 1e-9))
        sure = np.array([len(a) == len(b) for a, b in zip(inner, outer, strict=True)])
        expected = np.array([len(a) > min_neighbors for a in inner])
        kept = np.isin(
            np.arange(len(points)),
            tmchho.remove_outliers(points, radius=radius, min_neighbors=min_neighbors).indices,
        )
        np.testing.assert_array_equal(kept[sure], expected[sure])


@every_cloud
def test_the_radius_of_outliers_is_derived_from_the_spacing(name: str) -> None:
    points = CLOUDS[name]
    radius = tmchho.remove_outliers(points).radius
    places = np.unique(points, axis=0)
    if len(places) < 2:
        assert radius == 0.0
        return
    nearest = np.sort(cKDTree(places).query(points, k=2)[0][:, 1])
    rank = 0.9 * (len(nearest) - 1)
    low, high = nearest[math.floor(rank)], nearest[math.ceil(rank)]
    assert 4 * low * (1 - 1e-9) <= radius <= 4 * high * (1 + 1e-9)


# ---- voxels


@every_cloud
@pytest.mark.parametrize("size", [0.3, 2.5, 1e4])
def test_voxels_hold_the_means_of_their_points(name: str, size: float) -> None:
    points = CLOUDS[name]
    result = tmchho.voxel_downsample(points, size)
    # The grid stands on the lower corner, about the middle of the box.
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    local = points - middle
    cells = np.floor((local - local.min(axis=0)) / size).astype(int)
    order = np.lexsort(cells.T)
    _, first, counts = np.unique(cells[order][:, ::-1], axis=0, return_index=True, return_counts=True)
    sums = np.add.reduceat(local[order], first, axis=0)
    np.testing.assert_array_equal(result.counts, counts)
    np.testing.assert_allclose(result.points, sums / counts[:, None] + middle, rtol=1e-12, atol=1e-9)


# ---- surfaces


def _eigenvalues(points: Floats, weights: Floats | None = None) -> tuple[Floats, Floats]:
    centred = points - points.mean(axis=0) if weights is None else points
    weights = np.ones(len(points)) if weights is None else weights
    return np.linalg.eigh((centred * weights[:, None]).T @ centred / weights.sum())


@pytest.mark.parametrize(
    "name", ["uniform", "field", "national grid", "clusters", "plane", "line", "identical"]
)
def test_normals_are_principal_components(name: str) -> None:
    points, k = CLOUDS[name], 12
    normals, curvatures = tmchho.estimate_normals(points, n_neighbors=k)
    local = points - points.mean(axis=0)
    neighbors = cKDTree(local).query(local, k=k)[1]
    for normal, curvature, rows in zip(normals, curvatures, neighbors, strict=True):
        values, vectors = _eigenvalues(local[rows])
        if name in ("line", "identical"):
            np.testing.assert_array_equal(normal, 0.0)
            assert curvature == 0.0
            continue
        assert np.linalg.norm(normal) == pytest.approx(1.0)
        assert normal[np.argmax(np.abs(normal))] > 0
        assert curvature == pytest.approx(max(values[0], 0.0) / values.sum(), abs=1e-9)
        if values[1] - values[0] > 1e-3 * values[2]:
            assert abs(normal @ vectors[:, 0]) == pytest.approx(1.0, abs=1e-9)


@pytest.mark.parametrize(
    "name", ["uniform", "field", "national grid", "clusters", "lattice", "doubles", "line"]
)
def test_keypoints_follow_equations_2_to_4(name: str) -> None:
    points, radius = CLOUDS[name], 2.05
    found = tmchho.iss_keypoints(points, radius=radius)
    local = points - points.mean(axis=0)
    expected, unsure = [], []
    for i, rows in enumerate(cKDTree(local).query_ball_point(local, radius)):
        offsets = local[i] - local[rows]
        distances = np.linalg.norm(offsets, axis=1)
        inside = (distances > 0) & (distances < radius)
        if inside.sum() < 5:
            continue
        values = _eigenvalues(offsets[inside], 1 / distances[inside])[0][::-1]
        if values[1] <= 1e-12 * values[0]:
            continue
        margins = [values[1] / values[0] - 0.65, values[2] / values[1] - 0.6]
        if any(abs(margin) < 1e-9 for margin in margins):
            unsure.append(i)
        elif max(margins) < 0:
            expected.append(i)
    assert np.setdiff1d(found, unsure).tolist() == expected


def test_only_the_most_salient_keypoint_of_its_surroundings_is_kept() -> None:
    points = CLOUDS["field"]
    every = set(tmchho.iss_keypoints(points, radius=2.0).tolist())
    few = tmchho.iss_keypoints(points, radius=2.0, non_max_radius=3.0)
    assert set(few.tolist()) < every
    assert cKDTree(points[few]).query(points[few], k=2)[0][:, 1].min() > 3.0
    assert tmchho.nearest_distances(points[sorted(every)], points[few]).max() <= 9.0


# ---- closed form and ICP


def _kabsch(source: Floats, target: Floats) -> Floats:
    """Umeyama's closed form, in numpy."""
    middles = source.mean(axis=0), target.mean(axis=0)
    u, _, v_t = np.linalg.svd((target - middles[1]).T @ (source - middles[0]))
    matrix = np.eye(4)
    matrix[:3, :3] = u @ np.diag([1, 1, np.sign(np.linalg.det(u @ v_t))]) @ v_t
    matrix[:3, 3] = middles[1] - matrix[:3, :3] @ middles[0]
    return matrix


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("noise", [0.0, 0.5])
def test_kabsch_is_that_of_umeyama_and_of_scipy(seed: int, noise: float) -> None:
    rng = np.random.default_rng(seed)
    source = rng.random((40, 3)) * [10, 5, 1]
    target = moved(pose(seed), source) + rng.normal(0, noise, source.shape)
    ours = tmchho.kabsch(source, target)
    np.testing.assert_allclose(ours, _kabsch(source, target), atol=1e-10)
    scipys = Rotation.align_vectors(target - target.mean(axis=0), source - source.mean(axis=0))[0]
    np.testing.assert_allclose(ours[:3, :3], scipys.as_matrix(), atol=1e-10)


def test_kabsch_never_mirrors_and_keeps_its_digits_far_away() -> None:
    source = CLOUDS["uniform"]
    mirrored = tmchho.kabsch(source, source * [1, 1, -1])
    assert np.linalg.det(mirrored[:3, :3]) == pytest.approx(1.0)
    far = np.array([5.1e5, 4.2e6, 300.0])
    matrix = pose(3, shift=10.0)
    found = tmchho.kabsch(source + far, moved(matrix, source) + far)
    np.testing.assert_allclose(found[:3, :3], matrix[:3, :3], atol=1e-9)
    assert np.abs(moved(found, source + far) - far - moved(matrix, source)).max() < 1e-8


def _icp_steps(
    source: Floats, target: Floats, start: Floats, max_distance: float
) -> Iterator[tuple[Floats, float]]:
    """Point-to-point ICP of numpy and scipy: the pose and the mean squared distance after each step."""
    tree, matrix = cKDTree(target), start
    while True:
        distances, rows = tree.query(moved(matrix, source), distance_upper_bound=max_distance)
        near = np.isfinite(distances)
        matrix = _kabsch(source[near], target[rows[near]])
        yield matrix, float(((moved(matrix, source[near]) - target[rows[near]]) ** 2).sum(axis=1).mean())


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("max_distance", [None, 1.0])
def test_icp_goes_the_way_of_its_twin(seed: int, max_distance: float | None) -> None:
    source, target = pair(1500, scene=seed)
    target = target[target[:, 0] < 50]
    source = source[source[:, 0] > 8]
    start = np.eye(4)
    start[:3, :3] = Rotation.from_rotvec(np.random.default_rng(seed).normal(0, 0.01, 3)).as_matrix()
    start[:3, 3] = [0.2, -0.1, 0.15]
    result = tmchho.icp(source, target, init=start, max_distance=max_distance)
    twin = _icp_steps(source, target, start, max_distance or np.inf)
    steps = list(islice(twin, result.n_iterations))
    np.testing.assert_allclose(result.history, [squared for _, squared in steps], rtol=1e-6)
    places = moved(result.transformation, source)
    assert np.abs(places - moved(steps[-1][0], source)).max() < 1e-6
    # It stopped because there was nothing more to gain: the twin's next step leaves the points in place.
    assert result.converged
    assert np.abs(moved(next(twin)[0], source) - places).max() < 0.02 * result.inlier_rmse


@pytest.mark.parametrize("method", ["point_to_point", "point_to_plane"])
def test_icp_undoes_a_small_motion(method: str) -> None:
    points = field(3000, 0, 30)
    away = np.eye(4)
    away[:3, :3] = Rotation.from_rotvec([0.004, -0.003, 0.006]).as_matrix()
    away[:3, 3] = [0.05, -0.04, 0.03]
    for far in (np.zeros(3), np.array([5.1e5, 4.2e6, 300.0])):
        source = moved(np.linalg.inv(away), points) + far
        result = tmchho.icp(source, points + far, method=method, relative_tolerance=0.0)
        assert result.converged
        assert np.abs(moved(result.transformation, source) - far - points).max() < 1e-6


def test_trimmed_icp_is_not_led_astray_by_what_the_target_lacks() -> None:
    points = field(4000, 0, 30)
    target = points[points[:, 0] < 22]
    away = np.eye(4)
    away[:3, 3] = [0.2, 0.1, -0.1]
    source = moved(np.linalg.inv(away), points)
    share = len(target) / len(points)
    errors = {
        kept: np.abs(moved(tmchho.icp(source, target, kept_share=kept).transformation, source) - points).max()
        for kept in (1.0, 0.9 * share)
    }
    assert errors[0.9 * share] < 0.02 < errors[1.0]


# ---- distances and fusion


def test_statistics_are_those_of_numpy() -> None:
    source, target = pair(2000)
    matrix = pose(4, shift=1.0)
    result = tmchho.evaluate(source, target, matrix, tolerance=0.8)
    forth = cKDTree(target).query(moved(matrix, source))[0]
    back = cKDTree(moved(matrix, source)).query(target)[0]
    both = (
        (result.source_to_target, result.source_to_target_statistics, forth),
        (result.target_to_source, result.target_to_source_statistics, back),
    )
    for distances, statistics, expected in both:
        np.testing.assert_allclose(distances, expected, rtol=1e-9)
        assert statistics.n_points == len(expected)
        assert statistics.mean == pytest.approx(expected.mean())
        assert statistics.best == pytest.approx(expected.min())
        assert statistics.worst == pytest.approx(expected.max())
        assert statistics.std == pytest.approx(expected.std())
        assert statistics.rms == pytest.approx(math.sqrt((expected**2).mean()))
        assert statistics.median == pytest.approx(np.median(expected))
        assert statistics.percentile_95 == pytest.approx(np.percentile(expected, 95))
    assert result.share_within == pytest.approx(((forth <= 0.8).mean(), (back <= 0.8).mean()))


@pytest.mark.parametrize("mode", ["merge", "fill_holes"])
def test_fusion_is_a_matter_of_nearest_neighbours(mode: str) -> None:
    source, target = pair(2000)
    matrix = pose(5)
    away = moved(np.linalg.inv(matrix), source)
    fused = tmchho.fuse(away, target, matrix, mode=mode, hole_radius=1.2)
    from_source = cKDTree(target).query(source)[0]
    from_target = cKDTree(source).query(target)[0]
    taken = np.arange(len(source)) if mode == "merge" else np.flatnonzero(from_source > 1.2)
    np.testing.assert_array_equal(fused.index, [*range(len(target)), *taken])
    np.testing.assert_array_equal(fused.origin, [0] * len(target) + [1] * len(taken))
    np.testing.assert_allclose(fused.points, np.concatenate([target, source[taken]]), atol=1e-9)
    expected = np.concatenate([from_target, from_source[taken]])
    np.testing.assert_allclose(fused.distance, expected, atol=1e-9)
    np.testing.assert_array_equal(fused.fills_hole, expected > 1.2)
    assert fused.n_filled_by_target == (from_target > 1.2).sum()
    assert fused.n_filled_by_source == (from_source > 1.2).sum()


def test_the_derived_hole_radius_is_three_wide_spacings_of_the_sparser_cloud() -> None:
    sparse, dense = _GRID * 2.0, _GRID * 0.5
    assert tmchho.fuse(sparse, dense, np.eye(4)).hole_radius == pytest.approx(6.0)
    assert tmchho.fuse(dense, sparse, np.eye(4)).hole_radius == pytest.approx(6.0)


def test_a_registration_judges_by_the_distances_that_scipy_finds() -> None:
    source, target = pair(3000)
    found = tmchho.register(source, target, config={"coarse": {"rotations_per_round": [8], "n_verified": 2}})
    distances = cKDTree(target).query(found.apply(source))[0]
    assert found.overlap_of_source == pytest.approx((distances <= found.max_distance).mean(), abs=1e-3)
    assert found.source_to_target.mean == pytest.approx(distances.mean(), rel=1e-9)
    voxels = [
        tmchho.voxel_downsample(points[tmchho.remove_outliers(points).indices], found.voxel_size).points
        for points in (source, target)
    ]
    nearest = cKDTree(voxels[1]).query(found.apply(voxels[0]))[0]
    near = nearest <= found.max_distance
    assert found.n_inliers == pytest.approx(near.sum(), abs=2)
    assert found.fitness == pytest.approx(near.mean(), abs=1e-3)
    assert found.inlier_rmse == pytest.approx(math.sqrt((nearest[near] ** 2).mean()), rel=1e-3)
    assert json.dumps(found.to_dict())
