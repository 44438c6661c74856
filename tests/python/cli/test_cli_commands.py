"""The other commands: evaluate, info, demo, config."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from cli_tools import assert_refused, names_in, run, write_points
from click.testing import Result
from scipy.spatial import cKDTree

import tmchho
from tmchho.outputs import OUTPUTS, read_matrix


def test_evaluate_measures_what_scipy_measures(
    registered: tuple[Path, Result], files: tuple[Path, Path]
) -> None:
    folder, _ = registered
    source, target = (tmchho.read(path).xyz for path in files)
    matrix = read_matrix(folder / "transform.txt")
    moved = source @ matrix[:3, :3].T + matrix[:3, 3]
    forth, _ = cKDTree(target).query(moved)
    back, _ = cKDTree(moved).query(target)
    for transform in ("transform.txt", "result.json"):
        result = run("evaluate", *files, "--transform", folder / transform, "--tolerance", 0.5, "--json")
        assert result.exit_code == 0, result.stderr
        document = json.loads(result.stdout)
        for key, wanted in (("source_to_target", forth), ("target_to_source", back)):
            row = document[key]
            assert row["n_points"] == len(wanted)
            assert row["mean"] == pytest.approx(wanted.mean(), rel=1e-6)
            assert row["best"] == pytest.approx(wanted.min(), abs=1e-6)
            assert row["worst"] == pytest.approx(wanted.max(), rel=1e-6)
            assert row["std"] == pytest.approx(wanted.std(), rel=1e-6)
            assert row["rms"] == pytest.approx(np.sqrt((wanted**2).mean()), rel=1e-6)
            assert row["median"] == pytest.approx(np.median(wanted), rel=1e-6)
            assert row["percentile_95"] == pytest.approx(np.percentile(wanted, 95), rel=1e-6)
            assert row["share_within"] == pytest.approx((wanted <= 0.5).mean(), abs=1e-4)


def test_evaluate_prints_a_table_as_in_the_article(files: tuple[Path, Path]) -> None:
    result = run("evaluate", files[1], files[1], "--tolerance", 0.01)
    lines = result.stdout.splitlines()
    assert lines[0].split() == [
        *(["points", "Avg", "Best", "Worst", "Std", "RMS", "Median"]),
        *(["95", "%", "within", "0.01"]),
    ]
    assert lines[1].split() == ["source", "to", "target", "9,000"] + ["0"] * 7 + ["100.0", "%"]
    assert lines[2].startswith("target to source")


def test_evaluate_refuses_what_is_no_pose(files: tuple[Path, Path], tmp_path: Path) -> None:
    path = tmp_path / "transform.txt"
    path.write_text("2 0 0 0\n0 2 0 0\n0 0 1 0\n0 0 0 1\n")
    assert_refused(run("evaluate", *files, "--transform", path), 2, "rotation")
    path.write_text("one two three")
    assert_refused(run("evaluate", *files, "--transform", path), 3, "transform.txt", "4 lines")


def test_info_tells_what_is_in_a_file(files: tuple[Path, Path]) -> None:
    described = json.loads(run("info", files[1], "--json").stdout)["files"][0]
    cloud = tmchho.read(files[1])
    assert described["n_points"] == 9_000
    assert described["lowest"] == cloud.xyz.min(axis=0).tolist()
    assert described["highest"] == cloud.xyz.max(axis=0).tolist()
    distinct, place = np.unique(cloud.xyz, axis=0, return_inverse=True)
    nearest = cKDTree(distinct).query(distinct, 2)[0][:, 1]
    assert described["spacing"] == pytest.approx(np.percentile(nearest[place.ravel()], 50, method="higher"))
    assert described["crs"] == "WGS 84 / UTM zone 47N (EPSG:32647)"
    assert described["attributes"]["intensity"] == {
        "type": "uint16",
        "lowest": cloud.attributes["intensity"].min(),
        "highest": cloud.attributes["intensity"].max(),
    }
    assert described["wrong"] == []
    words = run("info", files[1]).stdout
    for part in ("9,000", "UTM zone 47N", "intensity", "nothing"):
        assert part in words


def test_info_tells_what_looks_wrong(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    field = rng.uniform(0, 1, (500, 3))
    quantised = (field * 20 + [5e5, 4e6, 0]).astype(np.float32)
    needle = field * [0.01, 0.01, 50] + [99, 36, 0]
    holey = np.vstack([field, field[:7], np.full((2, 3), np.nan)])
    paths = [
        write_points(tmp_path / "quantised.xyz", quantised),
        write_points(tmp_path / "needle.xyz", needle),
        write_points(tmp_path / "holey.xyz", holey),
        write_points(tmp_path / "flat.xyz", field * [1, 1, 0]),
        write_points(tmp_path / "fine.xyz", field * 20 + [5e5, 4e6, 0]),
    ]
    wrong = [file["wrong"] for file in json.loads(run("info", *paths, "--json").stdout)["files"]]
    assert "steps of 0.25 " in " ".join(wrong[0])
    assert [("degrees" in sentence) for sentence in wrong[1]] == [True]
    assert [sentence.split(": ")[1].split()[0] for sentence in wrong[2]] == ["2", "7"]
    assert ["three directions" in sentence for sentence in wrong[3]] == [True]
    assert wrong[4] == []


def test_info_goes_on_after_a_file_that_cannot_be_read(files: tuple[Path, Path]) -> None:
    result = run("info", "missing.laz", files[0])
    assert result.exit_code == 3
    assert "missing.laz: does not exist" in result.stderr
    assert "12,000" in result.stdout


def test_demo_compares_with_the_truth(tmp_path: Path) -> None:
    folder = tmp_path / "demo"
    result = run("demo", "-o", folder, "--points", 24_000, "--seed", 3)
    assert result.exit_code == 0, result.stderr
    assert names_in(folder) == sorted([*OUTPUTS, "uav.laz", "tls.laz"])
    document = json.loads((folder / "result.json").read_text())
    truth = document["truth"]
    source = tmchho.read(folder / "uav.laz").xyz
    wanted, found = np.array(truth["target_from_source"]), read_matrix(folder / "transform.txt")
    apart = source @ (found - wanted)[:3, :3].T + (found - wanted)[:3, 3]
    assert truth["rms_displacement"] == pytest.approx(np.sqrt((apart**2).sum(axis=1).mean()), abs=1e-7)
    assert truth["translation_error_at_centroid"] == pytest.approx(
        np.linalg.norm(apart.mean(axis=0)), abs=1e-7
    )
    turn = found[:3, :3] @ wanted[:3, :3].T
    sine = np.linalg.norm([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / 2
    assert truth["rotation_error_deg"] == pytest.approx(np.degrees(np.arcsin(sine)), abs=1e-7)
    assert truth["rms_displacement_in_voxels"] < 1
    for word in ("accepted", "rotation", "overlap", "voxel edge", "simulate"):
        assert word in result.stdout.lower()
    assert_refused(run("demo", "-o", folder), 5, "exists already", "--overwrite")


def test_the_printed_configuration_can_be_used(tmp_path: Path) -> None:
    printed = run("config").stdout
    defaults = tmchho.default_config()
    path = tmp_path / "settings.toml"
    path.write_text(printed)  # as it is: nothing is changed
    assert tmchho.Config.from_toml(path) == tmchho.Config()
    path.write_text(re.sub(r"^#(\w+ = (?!\.\.\.))", r"\1", printed, flags=re.MULTILINE))
    settings = tmchho.Config.from_toml(path).to_dict()
    assert settings["mode"] == defaults["mode"]
    assert settings["verdict"] == defaults["verdict"]
    assert settings["paper"] == {
        **defaults["paper"],
        "hawks": {key: value for key, value in defaults["paper"]["hawks"].items() if value is not None},
    }
    assert "#voxel_size_m = ...\n" in printed
    assert "# Edge of a voxel in the clouds' unit" in printed
