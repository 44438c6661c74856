"""The stage functions: what they do with NaN, odd arguments and attributes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scenes import field

import tmchho
from tmchho import PointCloud, errors

POINTS = field(300, 0, 15)
NAN_ROWS = [0, 7, 299]
HOLED = POINTS.copy()
HOLED[NAN_ROWS, 1] = [np.nan, np.inf, -np.inf]
FINITE = np.delete(np.arange(300), NAN_ROWS)


# ---- rows that are not finite


def test_indices_are_rows_of_what_was_given() -> None:
    cleaned, whole = tmchho.remove_outliers(HOLED), tmchho.remove_outliers(POINTS[FINITE])
    np.testing.assert_array_equal(cleaned.indices, FINITE[whole.indices])
    assert (cleaned.n_non_finite, whole.n_non_finite) == (3, 0)
    assert cleaned.radius == whole.radius
    keypoints = tmchho.iss_keypoints(HOLED, radius=2.5)
    np.testing.assert_array_equal(keypoints, FINITE[tmchho.iss_keypoints(POINTS[FINITE], radius=2.5)])


def test_voxels_count_what_they_leave_out() -> None:
    thinned = tmchho.voxel_downsample(HOLED, 1.0)
    np.testing.assert_array_equal(thinned.points, tmchho.voxel_downsample(POINTS[FINITE], 1.0).points)
    assert thinned.counts.sum() == 297
    assert thinned.n_non_finite == 3


def test_values_for_each_row_are_nan_in_such_rows() -> None:
    distances = tmchho.nearest_distances(HOLED, POINTS + 1.0)
    normals, curvatures = tmchho.estimate_normals(HOLED)
    result = tmchho.evaluate(HOLED, HOLED + 1.0)
    for values in (distances, normals[:, 0], curvatures, result.source_to_target, result.target_to_source):
        np.testing.assert_array_equal(np.flatnonzero(np.isnan(values)), NAN_ROWS)
    assert result.source_to_target_statistics.n_points == 297


def test_fusion_leaves_them_out_and_keeps_count_of_rows() -> None:
    fused = tmchho.fuse(HOLED, POINTS, np.eye(4))
    np.testing.assert_array_equal(fused.index[fused.origin == 1], FINITE)


@pytest.mark.parametrize(
    "use",
    [
        lambda points: tmchho.kabsch(points, POINTS),
        lambda points: tmchho.icp(POINTS, points),
        lambda points: tmchho.rms_fitness(points, POINTS, [0.0] * 6),
        lambda points: tmchho.median_spacing(points),
    ],
)
def test_they_are_refused_where_nobody_would_notice(use: Callable[[Any], object]) -> None:
    use(POINTS)
    with pytest.raises(errors.InvalidCloudError, match=r"3 points .* the first in row 0"):
        use(HOLED)
    with pytest.raises(errors.InvalidCloudError, match=r"^tls\.las: "):
        use(PointCloud(HOLED, name="tls.las"))


# ---- empty clouds


def test_nothing_gives_nothing() -> None:
    empty = np.zeros((0, 3))
    assert len(tmchho.remove_outliers(empty).indices) == 0
    assert tmchho.voxel_downsample(empty, 1.0).points.shape == (0, 3)
    assert tmchho.iss_keypoints(empty, radius=1.0).shape == (0,)
    assert tmchho.estimate_normals(empty)[0].shape == (0, 3)
    assert tmchho.nearest_distances(empty, POINTS).shape == (0,)
    assert tmchho.nearest_distances(empty, empty).shape == (0,)
    assert tmchho.median_spacing(empty) == 0.0
    assert np.isnan(tmchho.rms_fitness(empty, POINTS, [0.0] * 6))
    assert np.isinf(tmchho.rms_fitness(POINTS, empty, [0.0] * 6))
    assert tmchho.icp(POINTS, empty).stop_reason == "no_partners"
    for use in (tmchho.kabsch, lambda a, b: tmchho.nearest_distances(POINTS, b)):
        with pytest.raises(errors.InvalidCloudError):
            use(empty, empty)


# ---- arguments


@pytest.mark.parametrize(
    ("use", "name"),
    [
        (lambda: tmchho.remove_outliers(POINTS, radius=0.0), "radius"),
        (lambda: tmchho.remove_outliers(POINTS, radius=float("nan")), "radius"),
        (lambda: tmchho.remove_outliers(POINTS, radius="1"), "radius"),  # type: ignore[arg-type]
        (lambda: tmchho.remove_outliers(POINTS, min_neighbors=-1), "min_neighbors"),
        (lambda: tmchho.remove_outliers(POINTS, min_neighbors=1.5), "min_neighbors"),  # type: ignore[arg-type]
        (lambda: tmchho.voxel_downsample(POINTS, -1.0), "voxel_size"),
        (lambda: tmchho.voxel_downsample(POINTS, 0), "voxel_size"),
        (lambda: tmchho.voxel_downsample(POINTS, float("inf")), "voxel_size"),
        (lambda: tmchho.iss_keypoints(POINTS, radius=-2.0), "radius"),
        (lambda: tmchho.iss_keypoints(POINTS, radius=1.0, non_max_radius=0.0), "non_max_radius"),
        (
            lambda: tmchho.iss_keypoints(POINTS, radius=1.0, max_ratio_third_to_second=0.0),
            "max_ratio_third_to_second",
        ),
        (lambda: tmchho.estimate_normals(POINTS, n_neighbors=2), "n_neighbors"),
        (lambda: tmchho.icp(POINTS, POINTS, max_distance=0.0), "max_distance"),
        (lambda: tmchho.icp(POINTS, POINTS, kept_share=1.5), "kept_share"),
        (lambda: tmchho.icp(POINTS, POINTS, kept_share=0.0), "kept_share"),
        (lambda: tmchho.icp(POINTS, POINTS, max_iterations=0), "max_iterations"),
        (lambda: tmchho.icp(POINTS, POINTS, relative_tolerance=-1.0), "relative_tolerance"),
        (lambda: tmchho.icp(POINTS, POINTS, method="plane"), "method"),  # type: ignore[arg-type]
        (lambda: tmchho.icp(POINTS, POINTS, init=np.eye(3)), "init"),
        (lambda: tmchho.kabsch(POINTS, POINTS[:-1]), "target"),
        (lambda: tmchho.rms_fitness(POINTS, POINTS, [0.0] * 5), "parameters"),
        (lambda: tmchho.euler_to_matrix([0.0] * 7), "parameters"),
        (lambda: tmchho.euler_to_matrix([np.nan] * 6), "parameters"),
        (lambda: tmchho.euler_to_matrix("123456"), "parameters"),
        (lambda: tmchho.matrix_to_euler(np.eye(3)), "matrix"),
        (lambda: tmchho.chaotic_sequence(-1), "n"),
        (lambda: tmchho.chaotic_sequence(10**15), "n"),
        (lambda: tmchho.chaotic_sequence(5, seed=-1), "seed"),
        (lambda: tmchho.levy_steps(5, factor=float("nan")), "factor"),
    ],
)
def test_a_wrong_argument_is_refused_by_its_name(use: Callable[[], object], name: str) -> None:
    with pytest.raises(errors.InvalidArgumentError, match=rf"^{name} must "):
        use()


def test_defaults_are_those_of_the_configuration() -> None:
    defaults = tmchho.default_config()
    explicit = tmchho.remove_outliers(POINTS, min_neighbors=defaults["outliers"]["min_neighbors"])
    np.testing.assert_array_equal(tmchho.remove_outliers(POINTS).indices, explicit.indices)
    keys = ("min_neighbors", "max_ratio_second_to_first", "max_ratio_third_to_second")
    given = {key: defaults["keypoints"][key] for key in keys}
    np.testing.assert_array_equal(
        tmchho.iss_keypoints(POINTS, radius=2.5), tmchho.iss_keypoints(POINTS, radius=2.5, **given)
    )


def test_files_are_read(tmp_path: Path) -> None:
    path = tmp_path / "cloud.npy"
    np.save(path, POINTS)
    np.testing.assert_array_equal(
        tmchho.remove_outliers(path).indices, tmchho.remove_outliers(POINTS).indices
    )
    assert tmchho.median_spacing(str(path)) == tmchho.median_spacing(POINTS)


# ---- random numbers


def test_the_chaotic_sequence_follows_equation_6() -> None:
    values = tmchho.chaotic_sequence(2000, seed=3)
    np.testing.assert_array_equal(values, tmchho.chaotic_sequence(2000, seed=3))
    assert not np.array_equal(values, tmchho.chaotic_sequence(2000, seed=4))
    assert ((values > 0) & (values < 1)).all()
    r = values[:-1]
    expected = np.select(
        [r < 0.4, r <= 0.5, r <= 0.6], [r / 0.4, (r - 0.4) / 0.1, (0.6 - r) / 0.1], (1 - r) / 0.4
    )
    # Now and then a value from which the map cannot go on is replaced.
    assert (np.abs(values[1:] - expected) < 1e-12).mean() > 0.99
    assert np.histogram(values, 10, (0, 1))[0].min() > 120


def test_levy_steps_have_heavy_tails_and_the_scale_of_equation_5() -> None:
    steps = tmchho.levy_steps(200_000, seed=1)
    np.testing.assert_allclose(0.01 * steps, tmchho.levy_steps(200_000, seed=1, factor=0.01), rtol=1e-12)
    rng = np.random.default_rng(0)
    sigma = 0.6965745025576968
    twin = rng.normal(0, sigma, 200_000) / np.abs(rng.normal(0, 1, 200_000)) ** (1 / 1.5)
    for share in (0.1, 0.25, 0.75, 0.9, 0.99):
        assert np.quantile(steps, share) == pytest.approx(np.quantile(twin, share), rel=0.05)
    assert np.median(steps) == pytest.approx(0.0, abs=0.02)


# ---- attributes of the fused cloud


def test_fused_attributes_come_from_the_right_rows() -> None:
    target = PointCloud(
        POINTS[:3],
        {"intensity": np.array([1, 2, 3], dtype=np.uint16), "red": np.array([10, 20, 255], dtype=np.uint8)},
        crs="EPSG:25832",
    )
    source = PointCloud(
        [[0.0, 0.0, 500.0], [np.nan, 0.0, 0.0], [0.0, 0.0, 900.0]],
        {
            "red": np.array([300, 1, 60000], dtype=np.uint16),
            "classification": np.array([6, 7, 8], dtype=np.uint8),
            "flow": np.arange(6.0).reshape(3, 2),
        },
        crs="EPSG:4978",
    )
    fused = tmchho.fuse(source, target, np.eye(4))
    cloud = fused.to_point_cloud(source, target)
    assert cloud.crs == "EPSG:25832"
    assert cloud.attributes["intensity"].tolist() == [1, 2, 3, 0, 0]
    assert cloud.attributes["red"].tolist() == [2560, 5120, 65280, 300, 60000]
    assert cloud.attributes["classification"].tolist() == [0, 0, 0, 6, 8]
    assert np.isnan(cloud.attributes["flow"][:3]).all()
    assert cloud.attributes["flow"][3:].tolist() == [[0, 1], [4, 5]]
    assert cloud.attributes["origin"].tolist() == [0, 0, 0, 1, 1]
    np.testing.assert_allclose(cloud.attributes["C2C_absolute_distances"], fused.distance, rtol=1e-7)
    np.testing.assert_array_equal(cloud.attributes["fills_hole"], fused.fills_hole)
    assert cloud.attributes["classification"].dtype == np.uint8


def test_attributes_that_do_not_fit_together_are_refused() -> None:
    one = PointCloud(POINTS[:2], {"flow": np.zeros(2)})
    other = PointCloud(POINTS[:2], {"flow": np.zeros((2, 2))})
    fused = tmchho.fuse(one, other, np.eye(4))
    with pytest.raises(errors.InvalidArgumentError, match="flow"):
        fused.to_point_cloud(one, other)
    with pytest.raises(errors.InvalidArgumentError, match="were given to fuse"):
        fused.to_point_cloud(PointCloud(POINTS[:1]), other)


def test_the_fused_cloud_can_be_written_and_read_back(tmp_path: Path) -> None:
    source = PointCloud(POINTS[:200], {"intensity": np.arange(200, dtype=np.uint16)})
    target = PointCloud(POINTS[100:], {"red": np.full(200, 7, dtype=np.uint16)})
    cloud = tmchho.fuse(source, target, np.eye(4)).to_point_cloud(source, target)
    tmchho.write(cloud, tmp_path / "fused.laz")
    again = tmchho.read(tmp_path / "fused.laz")
    np.testing.assert_allclose(again.xyz, cloud.xyz, atol=1e-3)
    for name in ("origin", "intensity", "red", "C2C_absolute_distances"):
        np.testing.assert_array_equal(again.attributes[name], cloud.attributes[name])
