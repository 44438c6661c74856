"""The points of a report: spread evenly, where the clouds are, with what was measured there."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from report_tools import Registered
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

import tmchho
from tmchho.errors import ReadError
from tmchho.report.fused_points import points_of_fused
from tmchho.report.points import ReportPoints, colour_of, points_of, quantised, spread
from tmchho.report.scene import Field, angle_and_axis, before_pose


@pytest.fixture(scope="module")
def points(registered: Registered) -> ReportPoints:
    return ReportPoints.load(registered.folder / "report_points.npz")


def test_the_points_lie_where_the_clouds_are(registered: Registered, points: ReportPoints) -> None:
    target = tmchho.read(registered.target).xyz
    moved = tmchho.read(registered.folder / "source_registered.laz").xyz
    half_a_step = np.linalg.norm(points.step) / 2
    for places, cloud in ((points.xyz[~points.is_source], target), (points.xyz[points.is_source], moved)):
        distances, rows = cKDTree(cloud).query(places)
        assert distances.max() <= half_a_step + 2e-3  # the second is the grid of the LAS file
        assert len(np.unique(rows)) == len(rows) == len(cloud)  # so few that all of them are taken


def test_the_distances_are_those_of_the_other_cloud(points: ReportPoints) -> None:
    source, target = points.xyz[points.is_source], points.xyz[~points.is_source]
    tolerance = np.linalg.norm(points.step)
    for side, places, other in ((points.is_source, source, target), (~points.is_source, target, source)):
        assert np.abs(cKDTree(other).query(places)[0] - points.distance[side]).max() <= tolerance
    assert points.is_fused.all()
    radius = points.distance[points.fills_hole].min()
    assert points.distance[~points.fills_hole].max() <= radius


def test_saved_points_come_back_and_equal_points_give_equal_bytes(
    points: ReportPoints, tmp_path: Path
) -> None:
    points.save(tmp_path / "a.npz")
    again = ReportPoints.load(tmp_path / "a.npz")
    again.save(tmp_path / "b.npz")
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()
    assert np.array_equal(again.xyz, points.xyz)
    assert again.n_target == points.n_target


@pytest.mark.parametrize("content", [b"", b"no points", b"PK\x03\x04 cut off"])
def test_a_damaged_file_is_refused_by_name(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "report_points.npz").write_bytes(content)
    with pytest.raises(ReadError, match=r"report_points\.npz"):
        ReportPoints.load(tmp_path / "report_points.npz")


def test_few_points_of_a_dense_cloud_are_spread_evenly() -> None:
    random = np.random.default_rng(5)
    # A scanner: 100 times denser on the left half than on the right.
    left, right = (
        random.uniform((0, 0, 0), (10, 10, 0.1), (200_000, 3)),
        random.uniform((10, 0, 0), (20, 10, 0.1), (2_000, 3)),
    )
    xyz = np.concatenate([left, right])
    kept = spread(xyz, 1_500, 0.5, np.random.default_rng(0))
    assert len(np.unique(kept)) == 1_500
    share = np.count_nonzero(xyz[kept, 0] < 10) / 1_500
    assert 0.4 < share < 0.6  # it is 0.99 of all points
    first = xyz[kept[:300], 0] < 10
    assert 0.35 < first.mean() < 0.65  # every beginning is even as well
    assert np.array_equal(kept, spread(xyz, 1_500, 0.5, np.random.default_rng(0)))


def test_a_cloud_that_needs_less_than_half_leaves_the_rest_to_the_other(registered: Registered) -> None:
    found = tmchho.register(registered.pair.source, registered.pair.target)
    thinned = points_of(found, registered.pair.source, registered.pair.target, None, max_points=15_000)
    assert (len(thinned.steps), thinned.n_target) == (15_000, 7_500)
    thinned = points_of(found, registered.pair.source, registered.pair.target, None, max_points=20_000)
    assert (len(thinned.steps), thinned.n_target) == (20_000, 9_000)
    assert np.isnan(thinned.distance).all()  # without fusion none was measured
    assert len(thinned.cut) == 0


@settings(max_examples=30)
@given(st.floats(-1e7, 1e7), st.floats(1e-3, 1e4))
def test_a_position_is_kept_to_half_a_step(offset: float, size: float) -> None:
    xyz = offset + size * np.random.default_rng(1).random((50, 3))
    origin, step, steps = quantised(xyz)
    assert (np.abs(origin + step * steps - xyz) <= step / 2 * (1 + 1e-6) + 1e-8).all()


def test_colours_are_8_bit_and_black_ones_give_way_to_the_intensity() -> None:
    deep = np.array([[65_280, 256, 0], [0, 0, 0], [0, 0, 0]], dtype=np.uint16)
    names = ("red", "green", "blue")
    attributes = dict(zip(names, deep.T, strict=True))
    rows = np.arange(3)
    colour = colour_of(attributes, rows)
    assert colour is not None
    assert colour.tolist() == [[255, 1, 0], [150, 150, 150], [150, 150, 150]]
    attributes["intensity"] = np.array([0, 0, 1000], dtype=np.uint16)
    colour = colour_of(attributes, rows)
    assert colour is not None
    assert colour[0].tolist() == [255, 1, 0]
    assert colour[2, 0] > colour[1, 0]
    assert colour_of({}, rows) is None


def test_the_cut_holds_the_points_of_both_clouds_near_one_plane(points: ReportPoints) -> None:
    assert np.count_nonzero(points.cut_is_source) >= 100
    assert np.count_nonzero(~points.cut_is_source) >= 100
    # On a line where the pose is right: most points of the source have one of the target nearby in the cut.
    tree = cKDTree(points.cut[~points.cut_is_source])
    near, _ = tree.query(points.cut[points.cut_is_source])
    assert np.median(near) < 2 * np.median(points.distance[points.is_source])


@settings(max_examples=40)
@given(st.tuples(*[st.floats(-3.2, 3.2)] * 3))
def test_angle_and_axis_are_those_of_scipy(vector: tuple[float, ...]) -> None:
    rotation = Rotation.from_rotvec(vector)
    angle, axis = angle_and_axis(rotation.as_matrix())
    back = Rotation.from_rotvec(angle * axis).as_matrix()
    assert np.abs(back - rotation.as_matrix()).max() < 1e-7


def test_the_source_as_given_is_where_it_was(registered: Registered, points: ReportPoints) -> None:
    document = json.loads((registered.folder / "result.json").read_text())
    before = before_pose(document, points)
    assert before["is_shifted"]
    turn = Rotation.from_rotvec(before["angle"] * np.array(before["axis"])).as_matrix()
    middle = points.origin + points.step * 65_535 / 2
    local = points.xyz[points.is_source] - middle
    given = (local - before["centre"]) @ turn.T + before["centre"] + before["shift"] + middle
    distances, _ = cKDTree(tmchho.read(registered.source).xyz).query(given)
    assert distances.max() < np.linalg.norm(points.step)


def test_a_field_is_encoded_over_all_its_values() -> None:
    values = np.array([0.0, 0.25, 3.0, np.nan])
    described, codes = Field("distance", " m", values, 0.0, 0.5).encoded()
    decoded = described["low_end"] + codes * described["value_step"]
    assert np.abs(decoded[:3] - values[:3]).max() <= described["value_step"] / 2
    assert codes[3] == 65_535  # which means: none
    assert (described["low"], described["high"]) == (0.0, 0.5)


def test_the_fused_cloud_gives_the_same_points_in_parts_of_any_size(
    registered: Registered, points: ReportPoints
) -> None:
    fused = tmchho.read(registered.folder / "fused.laz")

    def part(rows: slice) -> tmchho.PointCloud:
        values = {name: np.asarray(values)[rows] for name, values in fused.attributes.items()}
        return tmchho.PointCloud(fused.xyz[rows], values)

    edge = json.loads((registered.folder / "result.json").read_text())["voxel_size"]
    for size in (5_000, 21_000):
        parts = [part(slice(start, start + size)) for start in range(0, len(fused), size)]
        found = points_of_fused(parts, 0, edge)
        assert found.n_target == points.n_target
        for side in (found.is_source, ~found.is_source):
            apart, rows = cKDTree(points.xyz).query(found.xyz[side])
            assert apart.max() < np.linalg.norm(points.step) + 2e-3
            assert np.abs(points.distance[rows] - found.distance[side]).max() < 2e-3
        assert np.count_nonzero(found.fills_hole) == np.count_nonzero(points.fills_hole)
        assert np.count_nonzero(found.cut_is_source) >= 100


def test_a_cloud_that_was_not_fused_here_is_refused(registered: Registered) -> None:
    with pytest.raises(ReadError, match="origin"):
        points_of_fused([registered.pair.target], 0, 1.0)
