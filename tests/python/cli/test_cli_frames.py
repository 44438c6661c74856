"""What `register` says of coordinate reference systems, and which points take part in finding the pose."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from cli_tools import assert_refused, run

import tmchho
from tmchho.simulate import SimulatedPair
from tmchho.simulate.pair import NATIONAL_CRS

pyproj = pytest.importorskip("pyproj")


def labelled(pair: SimulatedPair, folder: Path, source_crs: object, target_crs: object) -> tuple[Path, Path]:
    paths = folder / "uav.laz", folder / "tls.laz"
    for path, cloud, crs in zip(paths, (pair.source, pair.target), (source_crs, target_crs), strict=True):
        words = None if crs is None else pyproj.CRS.from_user_input(crs).to_wkt("WKT1_GDAL")
        tmchho.write(tmchho.PointCloud(cloud.xyz, crs=words), path)
    return paths


def test_differing_systems_are_refused_with_advice(pair: SimulatedPair, tmp_path: Path) -> None:
    paths = labelled(pair, tmp_path, 32648, NATIONAL_CRS)
    result = run("register", *paths, "-o", tmp_path / "out")
    assert_refused(result, 3, "zone 48N", "zone 47N", "--assume-same-crs", "reprojection")
    assert not (tmp_path / "out").exists()


def test_feet_beside_metres_are_refused(pair: SimulatedPair, tmp_path: Path) -> None:
    paths = labelled(pair, tmp_path, 2229, NATIONAL_CRS)
    assert_refused(run("register", *paths, "-o", tmp_path / "out"), 3, "US survey foot", "metre", "0.3048")


def test_a_wrong_label_can_be_overruled(pair: SimulatedPair, tmp_path: Path) -> None:
    paths = labelled(pair, tmp_path, 32648, NATIONAL_CRS)
    result = run("register", *paths, "-o", tmp_path / "out", "--assume-same-crs", "--json")
    assert result.exit_code == 0, result.stderr
    assert "warning" in result.stderr
    assert "--assume-same-crs" in json.loads(result.stdout)["command"]
    written = tmchho.read(tmp_path / "out" / "source_registered.laz").crs
    assert written == tmchho.read(paths[1]).crs


def test_swapped_axes_are_named(pair: SimulatedPair, tmp_path: Path) -> None:
    tmchho.write(tmchho.PointCloud(pair.target.xyz[:, [1, 0, 2]], crs=NATIONAL_CRS), tmp_path / "tls.laz")
    tmchho.write(tmchho.PointCloud(pair.source.xyz), tmp_path / "uav.laz")
    described = json.loads(run("info", tmp_path / "tls.laz", "--json").stdout)["files"][0]
    assert any("swapped" in sentence for sentence in described["wrong"])
    result = run("register", tmp_path / "uav.laz", tmp_path / "tls.laz", "-o", tmp_path / "out")
    assert "easting and northing are swapped" in result.stderr


@pytest.mark.parametrize("option", ["--crop-target", "--keep-class"])
def test_only_chosen_points_take_part(pair: SimulatedPair, tmp_path: Path, option: str) -> None:
    middle = np.median(pair.target.xyz, axis=0)
    inside = (np.abs(pair.target.xyz - middle) < 40).all(axis=1)
    classes = np.where(inside, 2, 5).astype(np.uint8)
    target = tmchho.PointCloud(pair.target.xyz, {"classification": classes}, crs=NATIONAL_CRS)
    everywhere = np.full(len(pair.source), 2, dtype=np.uint8)
    tmchho.write(target, tmp_path / "tls.laz")
    tmchho.write(tmchho.PointCloud(pair.source.xyz, {"classification": everywhere}), tmp_path / "uav.laz")
    low, high = middle[:2] - 40, middle[:2] + 40
    (tmp_path / "area.txt").write_text(
        f"{low[0]} {low[1]}\n{high[0]} {low[1]}\n{high[0]} {high[1]}\n{low[0]} {high[1]}\n"
    )
    value = str(tmp_path / "area.txt") if option == "--crop-target" else "2"
    paths = tmp_path / "uav.laz", tmp_path / "tls.laz"
    result = run("register", *paths, "-o", tmp_path / "out", option, value, "--json")
    assert result.exit_code in (0, 4), result.stderr
    document = json.loads(result.stdout)
    assert document["stages"][0]["n_target_in"] < len(target)
    assert document["fused"]["n_points"] == len(target) + len(pair.source)  # all are fused
    assert document["target_to_source"]["n_points"] == len(target)  # and measured
    assert f"{option} {value}" in document["command"]


def test_what_is_no_area_and_no_class_is_refused(files: tuple[Path, Path], tmp_path: Path) -> None:
    for option, value in (("--crop", "1,2,3"), ("--keep-class", "ground"), ("--max-memory", "a lot")):
        result = run("register", *files, "-o", tmp_path / "out", option, value)
        assert result.exit_code == 2
        assert option in result.stderr
