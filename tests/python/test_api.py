"""Registration from Python: does it find the pose, and say the same whatever form the clouds come in?"""

from __future__ import annotations

import copy
import dataclasses
import doctest
import importlib
import json
import math
import pickle
import pkgutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scenes import QUICK, Floats, field, moved, pair, pose

import tmchho
from tmchho import errors


@pytest.fixture(scope="module")
def clouds() -> tuple[Floats, Floats]:
    return pair()


@pytest.fixture(scope="module")
def found(clouds: tuple[Floats, Floats]) -> tmchho.Registration:
    """The source turned and shifted by pose 7, registered with all defaults."""
    return tmchho.register(moved(np.linalg.inv(pose(7)), clouds[0]), clouds[1])


def without_seconds(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: without_seconds(item) for key, item in value.items() if key != "seconds"}
    return [without_seconds(item) for item in value] if isinstance(value, list) else value


def same(one: tmchho.Registration, other: tmchho.Registration) -> bool:
    """Whether two results are equal to the last bit, but for the time they took."""
    texts = [json.dumps(without_seconds(result.to_dict()), allow_nan=False) for result in (one, other)]
    return texts[0] == texts[1]


def farthest(one: Floats, other: Floats) -> float:
    return float(np.linalg.norm(one - other, axis=1).max())


# ---- the pose


def test_the_known_pose_is_found(clouds: tuple[Floats, Floats], found: tmchho.Registration) -> None:
    source = moved(np.linalg.inv(pose(7)), clouds[0])
    assert found.verdict == "accepted"
    assert farthest(found.apply(source), clouds[0]) < 0.1
    assert farthest(moved(found.transformation, source), clouds[0]) < 0.1


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_poses_from_all_over_so3_are_found(seed: int) -> None:
    source, target = pair(scene=seed)
    away = moved(np.linalg.inv(pose(seed)), source)
    result = tmchho.register(away, target, seed=seed)
    assert result.verdict != "rejected"
    assert farthest(result.apply(away), source) < 0.2  # points lie 0.6 m apart


def test_millimetres_give_the_same_pose_as_metres(
    clouds: tuple[Floats, Floats], found: tmchho.Registration
) -> None:
    source = moved(np.linalg.inv(pose(7)), clouds[0])
    in_mm = tmchho.register(1000 * source, 1000 * clouds[1])
    assert in_mm.verdict == found.verdict
    assert farthest(in_mm.apply(1000 * source) / 1000, found.apply(source)) < 1e-6
    assert in_mm.inlier_rmse == pytest.approx(1000 * found.inlier_rmse)


def test_national_grid_coordinates_cost_nothing(
    clouds: tuple[Floats, Floats], found: tmchho.Registration
) -> None:
    source = moved(np.linalg.inv(pose(7)), clouds[0])
    grid, other_grid = np.array([5.1e5, 4.2e6, 250.0]), np.array([3.4e6, 5.6e6, -80.0])
    on_grid = tmchho.register(source + other_grid, clouds[1] + grid)
    assert farthest(on_grid.apply(source + other_grid) - grid, found.apply(source)) < 1e-6
    assert on_grid.n_inliers == found.n_inliers
    # The full matrix is as good in float64; only as text of a few digits it would not be.
    assert farthest(moved(on_grid.transformation, source + other_grid) - grid, found.apply(source)) < 1e-6


def test_swapped_clouds_give_the_inverse(clouds: tuple[Floats, Floats], found: tmchho.Registration) -> None:
    source = moved(np.linalg.inv(pose(7)), clouds[0])
    back = tmchho.register(clouds[1], source)
    assert back.verdict == "accepted"
    there_and_back = moved(back.transformation, moved(found.transformation, source))
    assert farthest(there_and_back, source) < 0.1


def test_identical_clouds_give_the_identity(clouds: tuple[Floats, Floats]) -> None:
    result = tmchho.register(clouds[0], clouds[0], config=QUICK)
    np.testing.assert_allclose(result.transformation, np.eye(4), atol=1e-9)
    assert result.fitness == 1.0
    assert result.inlier_rmse == pytest.approx(0.0, abs=1e-9)
    assert result.source_to_target.worst == pytest.approx(0.0, abs=1e-9)


def test_the_pose_that_the_files_have_is_a_candidate(clouds: tuple[Floats, Floats]) -> None:
    # Two rotations drawn at random do not lead there; only the pose as given does.
    config = {"coarse": {"rotations_per_round": [2], "n_verified": 1}}
    result = tmchho.register(*clouds, config=config)
    assert farthest(result.apply(clouds[0]), clouds[0]) < 0.1
    best = result.candidates[0]
    assert best.score == max(candidate.score for candidate in result.candidates)
    assert farthest(moved(best.transformation, clouds[0]), clouds[0]) < 0.5


def test_clouds_that_do_not_belong_together_are_not_accepted() -> None:
    result = tmchho.register(field(5000, 0, 50, scene=1), field(6000, 8, 60, scene=2))
    assert result.verdict in ("review", "rejected")
    assert result.reasons


# ---- what the figures say


def test_the_figures_agree_with_each_other(clouds: tuple[Floats, Floats], found: tmchho.Registration) -> None:
    source = moved(np.linalg.inv(pose(7)), clouds[0])
    assert found.mode == "robust"
    assert found.seed == 0
    assert found.version == tmchho.__version__
    assert (found.source_name, found.target_name) == ("source", "target")
    assert found.converged == (found.icp_stop_reason == "converged")
    assert len(found.icp_history) == found.n_icp_iterations
    names = [record.name for record in found.stages]
    assert names == ["outliers", "voxel", "coarse", "icp", "verdict", "evaluate"]
    assert found.stages[0].n_source_in == len(source)
    assert found.fitness == pytest.approx(found.n_inliers / found.stages[1].n_source_out)
    assert sum(record.seconds for record in found.stages) <= found.seconds
    measured = tmchho.evaluate(source, clouds[1], found, tolerance=found.max_distance)
    assert measured.share_within == pytest.approx((found.overlap_of_source, found.overlap_of_target))
    for field_ in dataclasses.fields(tmchho.DistanceStatistics):
        ours = getattr(found.source_to_target, field_.name)
        assert getattr(measured.source_to_target_statistics, field_.name) == pytest.approx(ours, rel=1e-9)
    about_pivots = source - found.source_pivot
    again = moved(found.pivot_transformation, about_pivots) + found.target_pivot
    assert farthest(again, found.apply(source)) < 1e-12


def test_the_dictionary_is_json_and_keeps_every_digit(found: tmchho.Registration) -> None:
    read_back = json.loads(json.dumps(found.to_dict(), allow_nan=False))
    np.testing.assert_array_equal(read_back["transformation"], found.transformation)
    assert read_back["inlier_rmse"] == found.inlier_rmse
    assert read_back["source_to_target"]["percentile_95"] == found.source_to_target.percentile_95
    assert set(read_back) == {field_.name for field_ in dataclasses.fields(found)}
    assert read_back["config"]["voxel"]["voxel_size_m"] == found.voxel_size
    assert "n_threads" not in read_back["config"]
    assert "n_threads" in found.config


def test_the_summary_names_what_matters(found: tmchho.Registration) -> None:
    lines = found.summary().splitlines()
    assert lines[0].startswith("accepted: ")
    assert any(f"{found.overlap_of_source:.1%}" in line for line in lines)
    turn_deg = math.degrees(math.acos((np.trace(pose(7)[:3, :3]) - 1) / 2))
    assert any(f"turned by {turn_deg:.1f}"[:-1] in line for line in lines)


@pytest.mark.parametrize(
    "duplicate", [copy.copy, copy.deepcopy, lambda result: pickle.loads(pickle.dumps(result))]
)
def test_results_can_be_copied_and_pickled_and_stay_read_only(
    found: tmchho.Registration, duplicate: Any
) -> None:
    other = duplicate(found)
    assert other.to_dict() == found.to_dict()
    for result in (found, other):
        with pytest.raises(ValueError, match="read-only"):
            result.transformation[0, 0] = 2.0
        with pytest.raises(dataclasses.FrozenInstanceError):
            result.fitness = 1.0


# ---- the same whatever


@pytest.mark.parametrize("n_threads", [1, 2, 4])
def test_the_number_of_threads_changes_nothing(
    clouds: tuple[Floats, Floats], found: tmchho.Registration, n_threads: int
) -> None:
    source = moved(np.linalg.inv(pose(7)), clouds[0])
    result = tmchho.register(source, clouds[1], config={"n_threads": n_threads})
    assert same(result, found)
    fused = [tmchho.fuse(source, clouds[1], registration) for registration in (result, found)]
    for one, other in zip(*(vars(cloud).values() for cloud in fused), strict=True):
        np.testing.assert_array_equal(one, other)


def test_another_seed_is_another_search(clouds: tuple[Floats, Floats]) -> None:
    results = [tmchho.register(*clouds, seed=seed, config=QUICK) for seed in (0, 0, 2**64 - 1)]
    assert same(results[0], results[1])
    assert results[2].seed == 2**64 - 1
    assert list(results[0].history) != list(results[2].history)


def test_points_that_are_not_finite_are_dropped_and_counted(clouds: tuple[Floats, Floats]) -> None:
    source, target = clouds
    nan = np.full((3, 3), [1.0, np.nan, 2.0])
    infinite = np.full((2, 3), [np.inf, 0.0, -np.inf])
    plain = tmchho.register(source, target, config=QUICK)
    holed = tmchho.register(
        np.concatenate([nan, source[:100], nan, source[100:]]),
        np.concatenate([target, infinite]),
        config=QUICK,
    )
    assert holed.n_non_finite == (6, 2)
    np.testing.assert_array_equal(holed.transformation, plain.transformation)


class _Frame:
    """What a data frame is to numpy."""

    def __init__(self, values: Floats) -> None:
        self.values = values

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> Floats:
        return self.values.astype(dtype or np.float64)


_FORMS = {
    "float32": lambda points: points.astype(np.float32),
    "Fortran": np.asfortranarray,
    "strided": lambda points: np.repeat(points, 2, axis=0)[::2],
    "columns": lambda points: np.column_stack([points, points])[:, :3],
    "reversed twice": lambda points: points[::-1].copy()[::-1],
    "big-endian": lambda points: points.astype(">f8"),
    "list": lambda points: points.tolist(),
    "tuples": lambda points: [tuple(point) for point in points.tolist()],
    "objects": lambda points: points.astype(object),
    "data frame": _Frame,
    "cloud": lambda points: tmchho.PointCloud(points, name="source"),
}


@pytest.fixture(scope="module")
def single_precision(clouds: tuple[Floats, Floats]) -> tuple[Floats, tmchho.Registration]:
    """A source that float32 holds exactly, and its registration."""
    source = clouds[0].astype(np.float32).astype(np.float64)
    return source, tmchho.register(source, clouds[1], config=QUICK)


@pytest.mark.parametrize("form", _FORMS)
def test_clouds_come_in_every_form(
    clouds: tuple[Floats, Floats], single_precision: tuple[Floats, tmchho.Registration], form: str
) -> None:
    source, expected = single_precision
    given = _FORMS[form](source)
    assert same(tmchho.register(given, clouds[1], config=QUICK), expected)


def test_integers_are_coordinates_too(clouds: tuple[Floats, Floats]) -> None:
    in_mm = [np.rint(1000 * points).astype(np.int32) for points in clouds]
    as_floats = [points.astype(np.float64) for points in in_mm]
    assert same(tmchho.register(*in_mm, config=QUICK), tmchho.register(*as_floats, config=QUICK))


def test_what_is_given_is_only_read(clouds: tuple[Floats, Floats]) -> None:
    given = [points.copy() for points in clouds]
    for points in given:
        points.setflags(write=False)
    matrix = np.eye(4)
    matrix.setflags(write=False)
    result = tmchho.register(*given, config=QUICK)
    tmchho.fuse(*given, matrix)
    tmchho.evaluate(*given, result)
    for points, original in zip(given, clouds, strict=True):
        np.testing.assert_array_equal(points, original)


def test_paths_are_read_and_name_the_result(clouds: tuple[Floats, Floats], tmp_path: Path) -> None:
    paths = [tmp_path / "uav.npy", tmp_path / "tls.npy"]
    for path, points in zip(paths, clouds, strict=True):
        np.save(path, points)
    from_files = tmchho.register(str(paths[0]), paths[1], config=QUICK)
    assert (from_files.source_name, from_files.target_name) == (str(paths[0]), str(paths[1]))
    from_arrays = tmchho.register(*clouds, config=QUICK)
    np.testing.assert_array_equal(from_files.transformation, from_arrays.transformation)


# ---- paper mode


def test_paper_mode_reports_as_the_paper_does(clouds: tuple[Floats, Floats]) -> None:
    config = {"paper": {"hawks": {"n_hawks": 10, "n_iterations": 20}}}
    results = [tmchho.register(*clouds, mode="paper", seed=5, config=config) for _ in range(2)]
    assert same(*results)
    result = results[0]
    assert [record.name for record in result.stages][2:4] == ["keypoints", "coarse"]
    assert len(result.history) == 20
    assert np.all(np.diff(result.history) <= 0)  # the best RMS so far
    assert result.candidates[0].score == -result.history[-1]
    assert math.isnan(result.ambiguity_ratio)
    assert result.to_dict()["ambiguity_ratio"] is None
    assert result.verdict != "accepted"
    assert result.config["icp"]["method"] == "point_to_point"


# ---- what cannot be


_LINE = np.outer(np.arange(50.0), [1.0, 2.0, 3.0])
_HOPELESS = {
    "empty": (np.zeros((0, 3)), "0 usable points"),
    "three points": (np.eye(3), "3 usable points"),
    "all NaN": (np.full((50, 3), np.nan), "0 usable points"),
    "identical": (np.ones((50, 3)), "identical"),
    "collinear": (_LINE, "one line"),
    "coplanar": (_LINE * [1, 0, 0] + np.random.default_rng(0).random((50, 3)) * [1, 1, 0], "one plane"),
    "far too large": (np.random.default_rng(0).random((50, 3)) * 1e15, "beyond"),
}


@pytest.mark.parametrize("kind", _HOPELESS)
@pytest.mark.parametrize("role", ["source", "target"])
def test_a_cloud_without_a_pose_is_refused_by_its_name(
    clouds: tuple[Floats, Floats], kind: str, role: str
) -> None:
    points, problem = _HOPELESS[kind]
    named = tmchho.PointCloud(points, name="uav.las")
    both = (named, clouds[1]) if role == "source" else (clouds[0], named)
    with pytest.raises(errors.InvalidCloudError, match=f"^uav.las: the {role} cloud .*{problem}"):
        tmchho.register(*both)
    unnamed = (points, clouds[1]) if role == "source" else (clouds[0], points)
    with pytest.raises(ValueError, match=f"^the {role} cloud .*{problem}"):
        tmchho.register(*unnamed)


@pytest.mark.parametrize(
    "points", [np.zeros(3), np.zeros((5, 2)), np.zeros((5, 4)), np.zeros((2, 5, 3)), [], 3.0, [[1, 2], [3]]]
)
def test_another_shape_is_refused_by_the_name_of_the_argument(points: Any) -> None:
    good = field(100, 0, 50)
    with pytest.raises(errors.InvalidCloudError, match=r"^source: "):
        tmchho.register(points, good)
    with pytest.raises(errors.InvalidCloudError, match=r"^target: "):
        tmchho.register(good, points)


@pytest.mark.parametrize("points", [[["a", "b", "c"]] * 9, np.ones((9, 3), dtype=complex), None])
def test_what_is_not_a_number_is_refused(points: Any) -> None:
    with pytest.raises(errors.InvalidCloudError, match=r"^target: "):
        tmchho.register(field(100, 0, 50), points)


def test_a_missing_file_is_a_read_error(tmp_path: Path) -> None:
    with pytest.raises(errors.ReadError, match=r"nowhere\.las"):
        tmchho.register(tmp_path / "nowhere.las", field(100, 0, 50))


@pytest.mark.parametrize("size", [0, -1.0, 0.0])
def test_a_voxel_without_size_is_refused(clouds: tuple[Floats, Floats], size: float) -> None:
    with pytest.raises(errors.InvalidArgumentError, match="voxel_size_m must be a number above 0"):
        tmchho.register(*clouds, config={"voxel": {"voxel_size_m": size}})


def test_a_voxel_too_small_names_the_smallest_possible(clouds: tuple[Floats, Floats]) -> None:
    with pytest.raises(errors.InvalidArgumentError, match="smallest possible is ") as refused:
        tmchho.voxel_downsample(clouds[0], 1e-9)
    smallest = float(str(refused.value).split()[-1])
    assert len(tmchho.voxel_downsample(clouds[0], smallest * 1.01).points) == len(clouds[0])
    with pytest.raises(errors.InvalidArgumentError, match="smallest possible is "):
        tmchho.register(*clouds, config={"voxel": {"voxel_size_m": 1e-9}})


@pytest.mark.parametrize("mode", ["Robust", "fast", 3])
def test_an_unknown_mode_is_refused(clouds: tuple[Floats, Floats], mode: Any) -> None:
    with pytest.raises(errors.InvalidArgumentError, match="robust"):
        tmchho.register(*clouds, mode=mode)


@pytest.mark.parametrize("seed", [-1, 2**64, 1.5, "1", True])
def test_a_wrong_seed_is_refused(clouds: tuple[Floats, Floats], seed: Any) -> None:
    with pytest.raises(errors.InvalidArgumentError, match="seed"):
        tmchho.register(*clouds, seed=seed)


# ---- measuring and fusing with a pose


def test_a_matrix_that_is_no_pose_is_refused(clouds: tuple[Floats, Floats]) -> None:
    mirror, flat, uneven = (np.diag([1.0, 1, z, 1]) for z in (-1, 0, 2))
    sheared, projective, weighted = np.eye(4), np.eye(4), 2 * np.eye(4)
    sheared[0, 1] = projective[3, 0] = 0.1
    for matrix in (
        mirror,
        flat,
        uneven,
        sheared,
        projective,
        weighted,
        np.full((4, 4), np.nan),
        np.eye(3),
        "identity",
        [[1, 2], [3]],
    ):
        for use in (tmchho.evaluate, tmchho.fuse):
            with pytest.raises(errors.InvalidArgumentError, match="transformation"):
                use(*clouds, matrix)


def test_measuring_and_fusing_need_a_point() -> None:
    for use in (lambda *both: tmchho.evaluate(*both), lambda *both: tmchho.fuse(*both, np.eye(4))):
        with pytest.raises(errors.InvalidCloudError, match="source cloud"):
            use(np.full((4, 3), np.nan), np.ones((1, 3)))


@pytest.mark.parametrize(
    ("arguments", "name"),
    [
        ({"tolerance": -1.0}, "tolerance"),
        ({"tolerance": math.nan}, "tolerance"),
        ({"tolerance": "1"}, "tolerance"),
    ],
)
def test_a_wrong_tolerance_is_refused(arguments: dict[str, Any], name: str) -> None:
    with pytest.raises(errors.InvalidArgumentError, match=name):
        tmchho.evaluate(np.ones((1, 3)), np.ones((1, 3)), **arguments)


@pytest.mark.parametrize(
    ("arguments", "name"),
    [
        ({"mode": "join"}, "mode"),
        ({"hole_radius": 0.0}, "^hole_radius "),
        ({"hole_radius": "x"}, "hole_radius"),
    ],
)
def test_a_wrong_way_of_fusing_is_refused(arguments: dict[str, Any], name: str) -> None:
    with pytest.raises(errors.InvalidArgumentError, match=name):
        tmchho.fuse(np.ones((1, 3)), np.ones((1, 3)), np.eye(4), **arguments)


# ---- documentation


def _modules() -> list[str]:
    found = pkgutil.walk_packages(tmchho.__path__, "tmchho.")
    return sorted(module.name for module in found if not module.name.endswith(("__main__", "_core")))


@pytest.mark.parametrize("name", ["tmchho", *_modules()])
def test_the_examples_in_the_documentation_are_true(name: str) -> None:
    assert doctest.testmod(importlib.import_module(name)).failed == 0


def test_everything_exported_is_documented() -> None:
    for name in tmchho.__all__:
        item = getattr(tmchho, name)
        if name != "CloudLike" and not isinstance(item, str):
            assert item.__doc__, name
