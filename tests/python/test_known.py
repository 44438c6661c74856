"""Registration with more than two clouds: degrees of freedom, priors, control points, crops, a time limit."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scenes import QUICK, Floats, field, moved, pair, pose
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

import tmchho
from tmchho import Config, ControlPoint, PosePrior, errors
from tmchho.config import config_json
from tmchho.simulate import SimulatedPair, make_pair

SIDES = np.array([20.0, 12.0, 6.0])


@pytest.fixture(scope="module")
def clouds() -> tuple[Floats, Floats]:
    return pair()


def farthest(one: Floats, other: Floats) -> float:
    return float(np.linalg.norm(one - other, axis=1).max())


def levelled() -> Floats:
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_euler("z", 2.0).as_matrix()
    matrix[:3, 3] = [50.0, -30.0, 9.0]
    return matrix


def box(survey: int, n_points: int = 4000) -> Floats:
    """Return the surface of a box about the origin, which half turns about its axes take to itself."""
    rng = np.random.default_rng([4, survey])
    points, rows = rng.uniform(-0.5, 0.5, (n_points, 3)), np.arange(n_points)
    points[rows, rng.integers(0, 3, n_points)] = rng.choice([-0.5, 0.5], n_points)
    return points * SIDES + rng.normal(0, 0.01, (n_points, 3))


# ---- degrees of freedom


def test_levelled_clouds_are_turned_about_the_vertical_alone(clouds: tuple[Floats, Floats]) -> None:
    source = moved(np.linalg.inv(levelled()), clouds[0])
    found = tmchho.register(source, clouds[1], dof=4)
    assert found.verdict == "accepted"
    assert found.config["dof"] == 4
    np.testing.assert_array_equal(found.transformation[2, :3], [0, 0, 1])
    assert farthest(found.apply(source), clouds[0]) < 0.1
    assert found.covariance is not None
    assert not found.covariance[[0, 1, 6]].any()  # neither tilt nor scale were free


def test_a_tilted_source_is_not_accepted_as_levelled(clouds: tuple[Floats, Floats]) -> None:
    source = moved(np.linalg.inv(pose(7)), clouds[0])
    assert tmchho.register(source, clouds[1], dof=4, config=QUICK).verdict != "accepted"


def sparse_and_noisy(area_ratio: float, overlap: float, **settings: Any) -> SimulatedPair:
    """Return photogrammetry of fewer points than the scan, with a voxel of noise, a third of both strays."""
    return make_pair(
        size_m=120.0,
        area_ratio=area_ratio,
        overlap=overlap,
        density_ratio=50.0,
        n_scanner_points=100_000,
        photogrammetry_noise_m=0.75,
        photogrammetry_outlier_share=0.3,
        scanner_outlier_share=0.3,
        national_grid=False,
        seed=0,
        **settings,
    )


def displacement_m(found: tmchho.Registration, made: SimulatedPair, truth: Floats) -> float:
    """Return how far the scan lies from where it belongs, root mean squared."""
    there = moved(found.transformation @ np.linalg.inv(truth), made.target.xyz)
    return float(np.sqrt(np.mean(np.sum((there - made.target.xyz) ** 2, axis=1))))


def test_sparse_noisy_photogrammetry_of_many_times_the_area_is_found_without_being_told_what_is_up() -> None:
    # The scan, of more points, has to find its place in it all the same.
    made = sparse_and_noisy(16.0, 0.8, pose="identity")
    found = tmchho.register(moved(np.linalg.inv(levelled()), made.source.xyz), made.target.xyz, dof=6)
    assert displacement_m(found, made, levelled()) < 2 * found.voxel_size
    assert found.verdict != "rejected"


@pytest.mark.parametrize("seed", [0, 1])
def test_it_is_found_turned_anywhere_too_as_its_ground_tells_what_is_up(seed: int) -> None:
    made = sparse_and_noisy(4.0, 0.6)
    turn = np.eye(4)
    turn[:3, :3] = Rotation.random(random_state=seed).as_matrix()
    found = tmchho.register(moved(turn, made.source.xyz), made.target.xyz, seed=seed)
    truth = made.target_from_source @ np.linalg.inv(turn)
    assert displacement_m(found, made, truth) < 2 * found.voxel_size
    assert found.verdict != "rejected"


@pytest.fixture(scope="module")
def scaled(clouds: tuple[Floats, Floats]) -> tuple[Floats, tmchho.Registration]:
    """A source whose unit is 1.1 of the target's, and its registration."""
    source = moved(np.linalg.inv(pose(7)), clouds[0]) / 1.1
    return source, tmchho.register(source, clouds[1], dof=7, config={"scale_bounds": [1.0, 1.25]})


def test_a_scale_is_found(clouds: tuple[Floats, Floats], scaled: tuple[Floats, tmchho.Registration]) -> None:
    source, found = scaled
    assert found.verdict == "accepted"
    assert found.scale == pytest.approx(1.1, rel=0.005)
    assert found.scale_standard_error is not None
    assert abs(found.scale / 1.1 - 1) < 5 * found.scale_standard_error < 0.005
    assert np.cbrt(np.linalg.det(found.transformation[:3, :3])) == pytest.approx(found.scale)
    assert farthest(found.apply(source), clouds[0]) < 0.1
    assert farthest(moved(found.transformation, source), clouds[0]) < 0.1
    text = found.summary()
    assert f"scale      {found.scale:.8g}" in text
    turn_deg = np.degrees(np.arccos((np.trace(pose(7)[:3, :3]) - 1) / 2))
    assert f"turned by {turn_deg:.1f}"[:-1] in text  # the scale does not count as a turn


def test_a_scaled_pose_is_measured_and_fused_in_the_unit_of_the_target(
    clouds: tuple[Floats, Floats], scaled: tuple[Floats, tmchho.Registration]
) -> None:
    source, found = scaled
    places, target = found.apply(source), clouds[1]
    for transformation in (found, found.transformation):
        measured = tmchho.evaluate(source, target, transformation)
        np.testing.assert_allclose(measured.source_to_target, cKDTree(target).query(places)[0], atol=1e-9)
        np.testing.assert_allclose(measured.target_to_source, cKDTree(places).query(target)[0], atol=1e-9)
        fused = tmchho.fuse(source, target, transformation)
        np.testing.assert_allclose(fused.points[fused.origin == 1], places, atol=1e-9)
    assert measured.source_to_target_statistics.rms == pytest.approx(found.source_to_target.rms)


def test_a_scale_of_icp_starts_from_a_scaled_pose(
    clouds: tuple[Floats, Floats], scaled: tuple[Floats, tmchho.Registration]
) -> None:
    source, found = scaled
    again = tmchho.icp(
        source, clouds[1], init=found.transformation, method="point_to_plane", max_distance=0.7
    )
    assert again.scale == pytest.approx(found.scale, rel=1e-12)  # not free, and so kept
    assert farthest(moved(again.transformation, source), found.apply(source)) < 0.05


@pytest.mark.parametrize("dof", [5, "six", 6.5])
def test_other_degrees_of_freedom_are_refused(clouds: tuple[Floats, Floats], dof: Any) -> None:
    with pytest.raises(errors.InvalidArgumentError, match="configuration"):
        tmchho.register(*clouds, dof=dof)
    with pytest.raises(errors.InvalidArgumentError, match="dof must be 6 in paper mode"):
        tmchho.register(*clouds, dof=4, mode="paper")


# ---- what is known


def test_a_box_alone_is_ambiguous() -> None:
    found = tmchho.register(moved(np.linalg.inv(pose(1)), box(1)), box(2), config=QUICK)
    assert found.verdict == "review"
    assert "another pose fits almost as well" in found.reasons[0]


@pytest.mark.parametrize("turn", [[0, 0, 0], [np.pi, 0, 0], [0, np.pi, 0], [0, 0, np.pi]])
def test_a_prior_tells_the_right_twin(turn: list[float]) -> None:
    source = moved(np.linalg.inv(pose(1)), box(1))
    twin = np.eye(4)
    twin[:3, :3] = Rotation.from_rotvec(turn).as_matrix()
    rough = np.eye(4)
    rough[:3, :3], rough[:3, 3] = Rotation.from_rotvec([0.1, -0.1, 0.15]).as_matrix(), [0.5, -0.4, 0.6]
    prior = PosePrior(rough @ twin @ pose(1), rotation_rad=[0.2] * 3, translation_m=[1.0] * 3)
    found = tmchho.register(source, box(2), prior=prior)
    assert farthest(found.apply(source), moved(twin @ pose(1), source)) < 0.02
    assert found.verdict == "accepted"
    assert found.registration_error is not None
    assert found.registration_error < 0.02


def test_control_points_tell_the_right_twin() -> None:
    corners = SIDES / 2 * [[1, 1, 1], [-1, 1, 1], [1, -1, 1]]
    places = moved(np.linalg.inv(pose(1)), corners)
    points = [ControlPoint(p, q, 0.05) for p, q in zip(places, corners, strict=True)]
    source = moved(np.linalg.inv(pose(1)), box(1))
    found = tmchho.register(source, box(2), control_points=points)
    assert farthest(found.apply(source), moved(pose(1), source)) < 0.02
    assert found.verdict == "accepted"
    assert found.config["known"]["control_points"][1]["sigma_m"] == 0.05


def test_a_prior_that_contradicts_the_clouds_is_named(clouds: tuple[Floats, Floats]) -> None:
    away = np.eye(4)
    away[:3, 3] = [0.0, 0.0, 1.0]
    prior = PosePrior(away, rotation_rad=[0.01] * 3, translation_m=[0.02] * 3)
    found = tmchho.register(*clouds, prior=prior, config=QUICK)
    assert found.verdict != "accepted"
    assert any("from the prior or the control points" in reason for reason in found.reasons)


def test_every_way_of_giving_what_is_known_says_the_same(tmp_path: Path) -> None:
    prior = PosePrior(np.eye(4), rotation_rad=np.array([0.1, 0.1, 0.2]), about=[1, 2, 3])
    points = [ControlPoint(np.zeros(3), (5e5, 4e6, 1.5), 0.25)]
    path = tmp_path / "settings.toml"
    path.write_text(
        "dof = 7\nscale_bounds = [0.25, 4.0]\nsource_crop_m = [[0, 0, 0], [1, 2, 3]]\n[known.prior]\n"
        "target_from_source = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]\n"
        "rotation_rad = [0.1, 0.1, 0.2]\nabout = [1, 2, 3]\n"
        "[[known.control_points]]\nsource = [0, 0, 0]\ntarget = [5e5, 4e6, 1.5]\nsigma_m = 0.25\n"
    )
    as_class = Config(
        dof=7,
        known=tmchho.Observations(prior, points),
        scale_bounds=(0.25, 4.0),
        source_crop_m=((0.0, 0.0, 0.0), (1.0, 2.0, 3.0)),
    )
    assert Config.from_toml(path) == as_class
    assert Config.from_dict(as_class.to_dict()) == as_class
    rest = {"dof": 7, "scale_bounds": (0.25, 4), "source_crop_m": np.array([[0, 0, 0], [1, 2, 3]])}
    mixed = {**rest, "known": {"prior": prior, "control_points": points}}
    by_key = {**rest, "known__prior": prior, "known__control_points": points}
    texts = {config_json(given) for given in (path, as_class, as_class.to_dict(), mixed)}
    assert texts == {config_json(None, **by_key)}


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        ({"prior": np.eye(4)}, "prior must be a PosePrior"),
        ({"prior": PosePrior(np.eye(4))}, "prior says nothing"),
        ({"prior": PosePrior(np.eye(3), rotation_rad=[1, 1, 1])}, "prior.target_from_source must have shape"),
        ({"prior": PosePrior(2 * np.eye(4), rotation_rad=[1, 1, 1])}, "prior.target_from_source"),
        ({"control_points": [ControlPoint([0, 0], [0, 0, 0], 1.0)]}, r"control_points\[0\].source"),
        ({"control_points": [ControlPoint([0] * 3, [0] * 3, 0)]}, r"control_points\[0\].sigma_m"),
        ({"control_points": np.zeros((3, 7))}, "control_points must be a sequence"),
        ({"control_points": [[0, 0, 0, 1, 1, 1, 0.1]]}, r"control_points\[0\] must be a ControlPoint"),
        ({"source_crop": [0, 0, 0, 1, 1, 1]}, "source_crop must have shape"),
        ({"target_crop": [[1, 1, 1], [0, 0, 0]]}, "target_crop_m"),
        ({"max_seconds": 0}, "max_seconds"),
        ({"max_seconds": "1"}, "max_seconds"),
    ],
)
def test_what_cannot_be_known_is_refused(
    clouds: tuple[Floats, Floats], arguments: dict[str, Any], problem: str
) -> None:
    with pytest.raises(errors.InvalidArgumentError, match=problem):
        tmchho.register(*clouds, **arguments)


# ---- control points in files


@pytest.mark.parametrize(
    "text",
    [
        "1,2,3,10,20,30,0.1\n\n# more\n4,5,6,40,50,60,0.2\n",
        "source_x;source_y;source_z;target_x;target_y;target_z;sigma\n1;2;3;10;20;30;0.1\n4;5;6;40;50;60;.2",
        "name\tSigma\ttarget_x\ttarget_y\ttarget_z\tsource_x\tsource_y\tsource_z\n"
        'east\t0.1\t10\t20\t30\t1\t2\t3\n"west"\t0.2\t40\t50\t60\t4\t5\t6\n',
        "\ufeff  1 2  3 10 20 30 0.1\r\n4 5 6 40 50 60 0.2\r\n",
    ],
    ids=["commas", "header", "other order", "blanks"],
)
def test_control_points_are_read_from_text(tmp_path: Path, text: str) -> None:
    path = tmp_path / "points.csv"
    path.write_text(text, encoding="utf-8", newline="")
    assert tmchho.read_control_points(path) == (
        ControlPoint([1.0, 2.0, 3.0], [10.0, 20.0, 30.0], 0.1),
        ControlPoint([4.0, 5.0, 6.0], [40.0, 50.0, 60.0], 0.2),
    )


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (None, "cannot be read"),
        (b"\xff\xfe\x00\x01", "not a text file"),
        (b"# nothing\n\n", "holds no control points"),
        (b"source_x,source_y,source_z,target_x,target_y,target_z,sigma\n", "holds no control points"),
        (
            b"x,y,z,target_x,target_y,target_z,sigma\n1,2,3,4,5,6,7\n",
            "line 1: .* source_x, source_y, source_z",
        ),
        (b"1,2,3,4,5,6,.1\n\n1,2,3,4,5,6\n", "line 3: has 6 values where 7"),
        (b"1,2,3,4,5,6,.1\n1,2,3,4,five,6,.1\n", "line 2: target_y must be a finite number, got 'five'"),
        (b"1,2,nan,4,5,6,.1\n", "line 1: source_z"),
        (b"1,2,3,4,5,6,0\n", "line 1: sigma must be above 0"),
        (b"1;2;3;4;5;6;0,1\n", "line 1: sigma must be a finite number, got '0,1'"),
    ],
)
def test_a_bad_file_of_control_points_is_named(tmp_path: Path, content: bytes | None, problem: str) -> None:
    path = tmp_path / "points.csv"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(errors.ReadError, match=problem) as refused:
        tmchho.read_control_points(path)
    assert str(refused.value).startswith(str(path))


# ---- crops, time, doubts


def test_only_what_lies_in_the_crops_takes_part(clouds: tuple[Floats, Floats]) -> None:
    # A second copy of the field, elsewhere: one of two equal places, unless the crop leaves it out.
    twin = np.concatenate([clouds[1], field(7000, 8, 60, survey=3) + np.array([0.0, 200.0, 30.0])])
    assert tmchho.register(clouds[0], twin).verdict != "accepted"
    crop = [[0.0, -5.0, -50.0], [70.0, 60.0, 50.0]]
    found = tmchho.register(clouds[0], twin, target_crop=crop)
    assert found.verdict == "accepted"
    assert farthest(found.apply(clouds[0]), clouds[0]) < 0.1
    assert found.stages[0].n_target_out <= len(clouds[1]) < found.stages[0].n_target_in
    assert found.target_to_source.n_points == len(twin)
    beside = [[500.0, 0.0, 0.0], [600.0, 1.0, 1.0]]
    with pytest.raises(errors.InvalidCloudError, match="source cloud, in its crop"):
        tmchho.register(*clouds, source_crop=beside)


def test_a_search_whose_time_is_up_hands_over_what_it_has(clouds: tuple[Floats, Floats]) -> None:
    source = moved(np.linalg.inv(pose(7)), clouds[0])
    found = tmchho.register(source, clouds[1], max_seconds=1e-6)
    assert found.ended_early
    assert found.verdict != "accepted"
    assert any("the time was up" in reason for reason in found.reasons)
    assert "ended before the search was done" in found.summary()
    assert not tmchho.register(*clouds, max_seconds=1e6, config=QUICK).ended_early


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (np.array([-1.0, 1.0, 1.0]), "fits well when mirrored"),
        (np.full(3, 1 / 0.3048), "as if in feet beside metres"),
        (np.full(3, 0.001), "as if in metres beside millimetres"),
    ],
    ids=["mirrored", "feet", "metres"],
)
def test_what_is_wrong_with_the_source_is_named(
    clouds: tuple[Floats, Floats], wrong: Floats, words: str
) -> None:
    config = {"coarse": {"rotations_per_round": [60]}}
    source = moved(np.linalg.inv(pose(7)), clouds[0]) * wrong
    found = tmchho.register(source, clouds[1], seed=1, config=config)
    assert found.verdict != "accepted"
    assert any(words in reason for reason in found.reasons), found.reasons


def test_what_is_wrong_is_named_where_no_point_finds_a_partner(clouds: tuple[Floats, Floats]) -> None:
    # A thousand times too small, the source lies between points of the target; with some seeds at all poses.
    config = {"coarse": {"rotations_per_round": [60]}}
    source = moved(np.linalg.inv(pose(7)), clouds[0]) * 0.001
    refusals = []
    for seed in range(13, 60):
        try:
            assert tmchho.register(source, clouds[1], seed=seed, config=config).verdict == "rejected"
        except errors.NoSolutionError as error:
            refusals.append(str(error))
            break
    assert refusals
    assert re.search("find a partner.*as if in metres beside millimetres", refusals[0])


def test_the_figures_of_accuracy_are_those_of_the_covariance(clouds: tuple[Floats, Floats]) -> None:
    found = tmchho.register(*clouds, config=QUICK)
    covariance, middle = found.covariance, found.covariance_middle
    assert covariance is not None
    assert middle is not None
    np.testing.assert_allclose(covariance, covariance.T)
    assert np.linalg.eigvalsh(covariance[:6, :6]).min() > 0
    # Displacements of the points of the overlap by poses drawn from the covariance.
    overlap = clouds[1][cKDTree(clouds[0]).query(clouds[1])[0] < found.max_distance] - middle
    drawn = np.random.default_rng(6).multivariate_normal(np.zeros(6), covariance[:6, :6], 400)
    apart = [np.cross(motion[:3], overlap) + motion[3:] for motion in drawn]
    rms = np.sqrt(np.mean([(shifts**2).sum(axis=1).mean() for shifts in apart]))
    assert found.registration_error == pytest.approx(rms, rel=0.2)
    true_error = np.sqrt(((found.apply(clouds[0]) - clouds[0]) ** 2).sum(axis=1).mean())
    assert true_error < 5 * rms
    assert found.inlier_rmse_back == pytest.approx(found.inlier_rmse, rel=0.2)
    assert 0.5 < found.held_out_ratio < 1.5
    assert found.misfit < 1
    assert found.lead_over_chance > 1.2
