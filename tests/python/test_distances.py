"""Distances by every method against scipy and numpy; their files and colours."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pytest
from numpy.typing import NDArray
from scenes import field, moved, pose
from scipy.spatial import cKDTree

import tmchho
from tmchho import errors
from tmchho.evaluation.colours import ColourScale
from tmchho.evaluation.files import FORMS, write_evaluation

Floats = NDArray[np.float64]


@pytest.fixture(scope="module")
def clouds() -> tuple[Floats, Floats, Floats]:
    matrix = pose(3)
    target = field(5000, 8, 60, survey=2)
    return moved(np.linalg.inv(matrix), field(4000, 0, 50, survey=1)), target, matrix


def planes(points: Floats, to: Floats, n: int) -> tuple[Floats, Floats, Floats]:
    """Return signed distances to planes through the points round the nearest one, or NaN; by numpy."""
    tree = cKDTree(to)
    nearest, foot = tree.query(points)
    around = to[tree.query(to[foot], n)[1]]
    middle = around.mean(axis=1)
    local = around - middle[:, None]
    _, _, axes = np.linalg.svd(local)
    normals = axes[:, 2] * np.sign(axes[:, 2, 2])[:, None]
    signed = ((points - middle) * normals).sum(axis=1)
    beside = np.linalg.norm(points - middle - signed[:, None] * normals, axis=1)
    reach = np.linalg.norm(local, axis=2).max(axis=1)
    return np.where(beside <= reach, signed, np.nan), nearest, normals


def test_distances_to_planes_are_those_of_numpy(clouds: Any) -> None:
    source, target, matrix = clouds
    at = moved(matrix, source)
    for method in ("plane", "normal"):
        for n in (16, 6):
            found = tmchho.evaluate(source, target, matrix, method=method, n_neighbors=n)
            for got, (points, to) in (
                (found.source_to_target, (at, target)),
                (found.target_to_source, (target, at)),
            ):
                signed, nearest, _ = planes(points, to, n)
                wanted = signed if method == "normal" else np.fmin(np.abs(signed), nearest)
                assert np.array_equal(np.isnan(got), np.isnan(wanted))
                assert np.nanmax(np.abs(got - wanted)) < 1e-7
        assert found.method == method


def test_heights_are_those_of_numpy(clouds: Any) -> None:
    source, target, matrix = clouds
    at = moved(matrix, source)
    got = tmchho.evaluate(source, target, matrix, method="vertical", n_neighbors=10).source_to_target
    _, rows = cKDTree(target[:, :2]).query(at[:, :2], 10)
    n_finite = 0
    for point, around, value in zip(at[:500], target[rows[:500]], got[:500], strict=True):
        middle = around.mean(axis=0)
        local = around - middle
        slope, *_ = np.linalg.lstsq(local[:, :2], local[:, 2], rcond=None)
        beside = np.linalg.norm(point[:2] - middle[:2])
        if beside > np.linalg.norm(local[:, :2], axis=1).max() or np.hypot(*slope) > np.tan(np.radians(80)):
            assert np.isnan(value)
        else:
            n_finite += 1
            assert value == pytest.approx(point[2] - middle[2] - slope @ (point - middle)[:2], abs=1e-7)
    assert n_finite > 300


def test_signed_statistics_keep_the_sign_where_it_means_something(clouds: Any) -> None:
    source, target, matrix = clouds
    lifted = matrix.copy()
    lifted[2, 3] += 0.25
    result = tmchho.evaluate(source, target, lifted, method="vertical", tolerance=0.3, max_distance=1.0)
    values = result.source_to_target
    kept = values[np.isfinite(values) & (np.abs(values) <= 1.0)]
    summed_up = result.source_to_target_statistics
    assert summed_up is not None
    assert summed_up.mean == pytest.approx(kept.mean())
    assert 0.2 < summed_up.median == pytest.approx(np.median(kept))
    assert summed_up.worst == np.abs(kept).max()
    assert summed_up.percentile_95 == pytest.approx(np.percentile(np.abs(kept), 95))
    assert result.share_within is not None
    assert result.share_within[0] == (np.abs(kept) <= 0.3).mean()
    assert result.n_beyond[0] == len(source) - len(kept)
    back = result.target_to_source_statistics
    assert back is not None
    assert back.median < -0.2


def test_distances_limited_by_the_spacing_are_warned_of() -> None:
    rng = np.random.default_rng(0)
    flat = [np.column_stack([rng.uniform(0, 20, (n, 2)), rng.normal(0, 0.002, n)]) for n in (4000, 1500)]
    result = tmchho.evaluate(*flat)
    assert len(result.warnings) == 2
    assert "point spacing of the target" in result.warnings[0]
    wanted = cKDTree(flat[1]).query(flat[1], 2)[0][cKDTree(flat[1]).query(flat[0])[1], 1]
    assert result.spacing[1] == pytest.approx(np.median(wanted), rel=0.02)
    # Three spacings apart, the distance is one.
    apart = tmchho.evaluate(flat[0] + [0, 0, 1.5], flat[1])
    assert apart.warnings == ()
    assert tmchho.evaluate(*flat, method="plane").warnings == ()


def test_classes_and_legend_account_for_every_point() -> None:
    distances = np.array([0.0, 0.004, 0.01, 0.0999, 0.1, 0.3, np.nan])
    scale = ColourScale.of(distances, tolerance=0.05)
    assert np.allclose(scale.borders, np.linspace(0, 0.1, 11))
    assert scale.classes(distances).tolist() == [0, 0, 1, 9, 9, 10, 10]
    legend = scale.legend(distances)
    assert [row["n_points"] for row in legend] == [2, 1, 0, 0, 0, 0, 0, 0, 0, 2, 1, 1]
    assert sum(row["share"] for row in legend) == pytest.approx(1)
    colours = np.column_stack(list(scale.apply(distances).values()))
    named = [(row["red"], row["green"], row["blue"]) for row in legend]
    assert len(set(named)) == len(named)
    assert [named.index(tuple(rgb)) for rgb in colours] == [0, 0, 1, 9, 9, 10, 11]

    signed = ColourScale.of(np.array([-0.2, 0.03]), is_signed=True, tolerance=0.05)
    assert (signed.borders[0], signed.borders[-1]) == (-0.1, 0.1)
    quiet = np.array([True, False])
    rows = signed.legend(np.array([-0.2, 0.03]), quiet)
    assert [row["n_points"] for row in rows] == [1] + [0] * 9 + [1, 0]
    assert (rows[0]["from"], rows[9]["to"]) == (None, None)
    assert signed.apply(np.array([-0.2, 0.03]), quiet)["red"].tolist() == [rows[0]["red"], rows[10]["red"]]


@pytest.mark.parametrize(
    ("largest", "limit"), [(0.0, 1.0), (0.011, 0.02), (0.05, 0.05), (0.21, 0.5), (7.0, 10.0), (1e-7, 1e-7)]
)
def test_scales_end_at_round_numbers(largest: float, limit: float) -> None:
    assert ColourScale.of(np.full(9, largest)).borders[-1] == pytest.approx(limit)


def test_files_hold_what_was_measured(clouds: Any, tmp_path: Path) -> None:
    points, target_points, matrix = clouds
    colours = {name: np.full(len(points), 7, dtype=np.uint16) for name in ("red", "green", "blue")}
    points = np.vstack([points, [[np.nan, 0, 0]]])
    attributes = {"intensity": np.arange(len(points), dtype=np.uint16)}
    attributes |= {name: np.append(values, 9).astype(np.uint16) for name, values in colours.items()}
    source = tmchho.PointCloud(points, attributes)
    target = tmchho.PointCloud(target_points)
    result = tmchho.evaluate(source, target, matrix, tolerance=0.1, areas="automatic")
    document = result.to_dict()
    paths = write_evaluation(tmp_path / "out", result, source, target, matrix, document, forms=FORMS)
    assert {path.name for path in paths} == {path.name for path in (tmp_path / "out").iterdir()}
    name = "C2C_absolute_distances"
    with laspy.open(tmp_path / "out" / "source_to_target.laz") as reader:
        las = reader.read()
    assert np.array_equal(las[name], result.source_to_target[:-1])
    assert np.array_equal(las.intensity, attributes["intensity"][:-1])
    assert (np.asarray(las.red) == 7).all()
    assert np.abs(las.xyz - moved(matrix, points[:-1])).max() < 1e-3
    text = tmchho.read(tmp_path / "out" / "target_to_source.csv")
    assert np.array_equal(text.attributes[name], result.target_to_source)
    scale = ColourScale.of(
        np.concatenate([result.source_to_target[:-1], result.target_to_source]), tolerance=0.1
    )
    for form in ("laz", "ply"):
        coloured = tmchho.read(tmp_path / "out" / f"source_to_target_coloured.{form}")
        factor = 256 if form == "laz" else 1
        wanted = scale.apply(result.source_to_target[:-1])["green"].astype(int) * factor
        assert np.array_equal(coloured.attributes["green"], wanted)
    with (tmp_path / "out" / "areas.csv").open(encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    assert [float(row["avg"]) for row in rows] == [area.mean for area in result.areas]
    with (tmp_path / "out" / "legend.csv").open(encoding="utf-8") as stream:
        legend = list(csv.DictReader(stream))
    assert sum(int(row["n_points"]) for row in legend) == len(points) - 1 + len(target_points)
    assert json.loads((tmp_path / "out" / "evaluation.json").read_text()) == document


def test_wrong_arguments_are_named(clouds: Any) -> None:
    source, target, matrix = clouds
    for arguments, word in (
        ({"method": "mesh"}, "method"),
        ({"n_neighbors": 2, "method": "plane"}, "n_neighbors"),
        ({"tolerance": -0.1}, "tolerance"),
        ({"max_distance": float("nan")}, "max_distance"),
    ):
        with pytest.raises(errors.InvalidArgumentError, match=word):
            tmchho.evaluate(source, target, matrix, **arguments)
