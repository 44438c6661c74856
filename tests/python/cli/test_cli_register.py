"""`tmchho register`: what it leaves in its folder, and what it says."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import laspy
import numpy as np
from cli_tools import names_in, run
from click.testing import Result
from scipy.spatial import cKDTree

import tmchho
from tmchho.outputs import OUTPUTS, read_matrix
from tmchho.simulate import SimulatedPair


def without_seconds(document: Any) -> Any:
    if isinstance(document, Mapping):
        return {key: without_seconds(value) for key, value in document.items() if key != "seconds"}
    return [without_seconds(value) for value in document] if isinstance(document, list) else document


def test_register_finds_the_pose_and_writes_its_files(
    registered: tuple[Path, Result], pair: SimulatedPair
) -> None:
    folder, result = registered
    assert result.exit_code == 0, result.stderr
    assert names_in(folder) == sorted(OUTPUTS)
    found = read_matrix(folder / "transform.txt")
    places, wanted = ((pair.source.xyz @ m[:3, :3].T + m[:3, 3]) for m in (found, pair.target_from_source))
    voxel = json.loads((folder / "result.json").read_text())["voxel_size"]
    assert np.sqrt(((places - wanted) ** 2).sum(axis=1).mean()) < voxel


def test_the_summary_names_verdict_and_files(registered: tuple[Path, Result]) -> None:
    folder, result = registered
    assert "accepted" in result.stdout.lower()
    for name in OUTPUTS:
        assert str(folder / name) in result.stdout
    assert "tmchho:" not in result.stdout  # notes go to stderr
    assert "12,000 points" in result.stderr


def test_the_matrix_moves_the_source_to_where_it_was_written(
    registered: tuple[Path, Result], files: tuple[Path, Path]
) -> None:
    folder, _ = registered
    matrix = read_matrix(folder / "transform.txt")
    source, moved = tmchho.read(files[0]), tmchho.read(folder / "source_registered.laz")
    assert moved.xyz[:, 0].mean() > 400_000  # in the national grid
    assert moved.xyz[:, 1].mean() > 3_900_000
    apart = source.xyz @ matrix[:3, :3].T + matrix[:3, 3] - moved.xyz
    scale = laspy.open(folder / "source_registered.laz").header.scales.max()
    assert np.abs(apart).max() <= scale / 2 + 1e-6


def test_the_source_keeps_its_attributes_and_gets_the_grid_of_the_target(
    registered: tuple[Path, Result], files: tuple[Path, Path]
) -> None:
    folder, _ = registered
    source, target = tmchho.read(files[0]), tmchho.read(files[1])
    moved = tmchho.read(folder / "source_registered.laz")
    assert source.attributes
    for name, values in source.attributes.items():
        assert np.array_equal(moved.attributes[name], values), name
    assert moved.crs == target.crs
    with laspy.open(folder / "source_registered.laz") as written, laspy.open(files[1]) as wanted:
        assert np.array_equal(written.header.scales, wanted.header.scales)


def test_the_fused_cloud_holds_both_clouds(registered: tuple[Path, Result], files: tuple[Path, Path]) -> None:
    folder, _ = registered
    source, target = tmchho.read(files[0]), tmchho.read(files[1])
    fused = tmchho.read(folder / "fused.laz")
    counts = json.loads((folder / "result.json").read_text())["fused"]
    from_source = fused.attributes["origin"] == 1
    assert len(fused) == len(source) + len(target) == counts["n_points"]
    assert np.count_nonzero(from_source) == len(source) == counts["n_from_source"]
    assert fused.crs == target.crs
    assert np.abs(fused.xyz[~from_source] - target.xyz).max() <= 1e-3
    assert set(source.attributes) | set(target.attributes) <= set(fused.attributes)
    assert np.array_equal(fused.attributes["red"][from_source], source.attributes["red"])
    assert np.array_equal(fused.attributes["intensity"][~from_source], target.attributes["intensity"])
    # Distances and holes, measured again by scipy.
    moved = tmchho.read(folder / "source_registered.laz")
    distances, _ = cKDTree(target.xyz).query(moved.xyz)
    written = fused.attributes["C2C_absolute_distances"][from_source]
    assert np.abs(distances - written).max() < 3e-3
    fills = fused.attributes["fills_hole"].astype(bool)
    assert np.count_nonzero(fills & from_source) == counts["n_filled_by_source"] > 0
    assert written[fills[from_source]].min() > counts["hole_radius"]


def test_fill_holes_takes_only_what_is_missing(
    registered: tuple[Path, Result], files: tuple[Path, Path], tmp_path: Path
) -> None:
    result = run("register", *files, "-o", tmp_path / "out", "--fuse", "fill-holes", "--json")
    counts = json.loads(result.stdout)["fused"]
    merged = json.loads((registered[0] / "result.json").read_text())["fused"]
    assert counts["n_from_source"] == merged["n_filled_by_source"] < merged["n_from_source"]
    assert len(tmchho.read(tmp_path / "out" / "fused.laz")) == counts["n_points"]


def test_result_json_tells_the_pose_in_every_tongue(
    registered: tuple[Path, Result], files: tuple[Path, Path]
) -> None:
    folder, _ = registered
    document = json.loads((folder / "result.json").read_text())
    matrix = read_matrix(folder / "transform.txt")
    assert np.array_equal(document["transformation"], matrix)
    said = document["transformation_as"]
    assert np.array_equal(np.array(said["pdal"].split(), dtype=float).reshape(4, 4), matrix)
    angles = np.radians(said["euler_deg"])
    assert np.abs(tmchho.euler_to_matrix([*angles, 0, 0, 0])[:3, :3] - matrix[:3, :3]).max() < 1e-9
    # About the pivots the same points come out.
    local, points = np.array(document["pivot_transformation"]), tmchho.read(files[0]).xyz
    moved = (points - document["source_pivot"]) @ local[:3, :3].T + local[:3, 3] + document["target_pivot"]
    assert np.abs(points @ matrix[:3, :3].T + matrix[:3, 3] - moved).max() < 1e-6


def test_result_json_tells_how_to_get_it_again(
    registered: tuple[Path, Result], files: tuple[Path, Path]
) -> None:
    document = json.loads((registered[0] / "result.json").read_text())
    assert document["command"] == f"tmchho register {files[0]} {files[1]} -o replay --seed 0"
    assert document["seed"] == 0
    assert document["inputs"]["source"]["name"] == "uav.laz"
    assert document["inputs"]["target"]["n_points"] == 9_000
    assert re.fullmatch("[0-9a-f]{64}", document["inputs"]["target"]["sha256"])
    assert document["versions"]["tmchho"] == tmchho.__version__
    assert document["config"]["voxel"]["voxel_size_m"] == document["voxel_size"]


def test_same_seed_same_bytes_with_any_number_of_threads(files: tuple[Path, Path], tmp_path: Path) -> None:
    for threads in (1, 2, 4):
        result = run("register", *files, "-o", tmp_path / str(threads), "--threads", threads, "--quiet")
        assert result.exit_code == 0
        assert result.stderr == ""
    first = tmp_path / "1"
    for other in (tmp_path / "2", tmp_path / "4"):
        for name in ("fused.laz", "source_registered.laz", "transform.txt", "report_points.npz"):
            assert (other / name).read_bytes() == (first / name).read_bytes(), name
        documents = [json.loads((folder / "result.json").read_text()) for folder in (first, other)]
        assert json.dumps(without_seconds(documents[0])) == json.dumps(without_seconds(documents[1]))


def test_json_is_alone_on_stdout(files: tuple[Path, Path], tmp_path: Path) -> None:
    result = run("register", *files, "-o", tmp_path / "out", "--json")
    assert json.loads(result.stdout)["verdict"] == "accepted"
    assert result.stdout == (tmp_path / "out" / "result.json").read_text(encoding="utf-8")


def test_a_configuration_file_counts_and_options_win(files: tuple[Path, Path], tmp_path: Path) -> None:
    config = tmp_path / "settings.toml"
    config.write_text("seed = 5\n[voxel]\nvoxel_size_m = 1.5\n[fuse]\nmode = 'fill_holes'\n")
    arguments = ("register", *files, "--config", config, "--json")
    document = json.loads(run(*arguments, "-o", tmp_path / "a").stdout)
    assert (document["seed"], document["voxel_size"]) == (5, 1.5)
    assert document["config"]["fuse"]["mode"] == "fill_holes"
    document = json.loads(run(*arguments, "-o", tmp_path / "b", "--seed", 6, "--voxel-size", 1.25).stdout)
    assert (document["seed"], document["voxel_size"]) == (6, 1.25)
