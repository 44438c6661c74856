"""`tmchho evaluate` and `tmchho info` in parts give what they give of whole files, within their memory."""

from __future__ import annotations

import csv
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pytest
from click.testing import CliRunner
from scipy.spatial import cKDTree
from test_streams import TRUE, hills, write_las

import tmchho
from tmchho.cli import main
from tmchho.evaluation import lengths
from tmchho.io import open_las
from tmchho.streams import memory, neighbours, pair
from tmchho.streams.neighbours import Blocks, spacing_at
from tmchho.streams.pair import tile_pair
from tmchho.transform import Transform


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, Path]:
    """Source, target in the national grid with two thirds in common, and the pose between them."""
    folder = tmp_path_factory.mktemp("evaluate")
    source, target = hills(12_000, 0, 60, 1), hills(9_000, 20, 80, 2)
    quality = np.random.default_rng(0).integers(1, 9, 12_000).astype(np.uint8)
    write_las(folder / "source.laz", source + np.array([30.0, 40.0, 10.0]), 3, {"quality": quality}, 3, 255)
    write_las(folder / "target.laz", target @ TRUE[:3, :3].T + TRUE[:3, 3], 6, {}, 4, 255)
    local = np.eye(4)
    local[:3, :3] = TRUE[:3, :3]
    matrix = Transform.about(local, [30.0, 40.0, 10.0], TRUE[:3, 3]).matrix
    np.savetxt(folder / "pose.txt", matrix, fmt="%.17g")
    return folder / "source.laz", folder / "target.laz", folder / "pose.txt"


@pytest.fixture
def in_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pair, "n_tile_points", lambda _: 4000)
    monkeypatch.setattr(memory, "_BYTES_PER_POINT", 1_000_000)


def run(*arguments: Any) -> Any:
    result = CliRunner().invoke(main, [str(argument) for argument in arguments])
    assert result.exit_code == 0, result.stderr
    return result


def assert_alike(found: Any, wanted: Any, where: str = "") -> None:
    if isinstance(wanted, dict):
        assert set(found) == set(wanted), where
        for key in wanted:
            assert_alike(found[key], wanted[key], f"{where}/{key}")
    elif isinstance(wanted, list):
        assert len(found) == len(wanted), where
        for at, (a, b) in enumerate(zip(found, wanted, strict=True)):
            assert_alike(a, b, f"{where}/{at}")
    elif isinstance(wanted, float):
        assert found == pytest.approx(wanted, rel=1e-7, abs=1e-8), where
    else:
        assert found == wanted, where


BOX = "some=499990,3999990,520000,4020000"
CASES = {
    "nearest": ("--tolerance", "0.2"),
    "plane": ("--max-distance", "1.5"),
    "normal": ("--max-distance", "1.5", "--area-box", BOX),
    "vertical": ("--tolerance", "0.1"),
    "m3c2": ("--registration-error", "0.01", "--tolerance", "0.05"),
}


@pytest.mark.parametrize("method", CASES)
def test_the_same_figures_and_files_as_of_whole_files(
    files: tuple[Path, Path, Path], method: str, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    source, target, pose = files
    forms = ("laz", "csv", "coloured-laz", "coloured-ply")
    arguments = ["evaluate", source, target, "--transform", pose, "--method", method, *CASES[method]]
    arguments += ["--json", *(word for form in forms for word in ("--form", form))]
    whole = run(*arguments, "-o", tmp_path / "whole")
    request.getfixturevalue("in_parts")
    parts = run(*arguments, "-o", tmp_path / "parts", "--max-memory", "300MB")
    assert "in parts" in parts.stderr
    assert_alike(json.loads(parts.stdout), json.loads(whole.stdout))
    folders = tmp_path / "parts", tmp_path / "whole"
    names = sorted(path.name for path in folders[1].iterdir())
    assert sorted(path.name for path in folders[0].iterdir()) == names
    for name in ("areas.csv", "legend.csv"):
        found, wanted = (list(csv.reader((folder / name).open())) for folder in folders)
        assert len(found) == len(wanted)
        for row, other in zip(found, wanted, strict=True):
            assert row[:2] == other[:2]
    for name in (name for name in names if name.endswith((".laz", ".ply", "t.csv", "e.csv"))):
        found_cloud, wanted_cloud = (tmchho.read(folder / name) for folder in folders)
        order = slice(None), slice(None)
        if method == "m3c2":  # the cores come tile by tile
            order = tuple(np.lexsort(np.round(cloud.xyz, 3).T) for cloud in (found_cloud, wanted_cloud))
        a, b = (cloud.xyz[rows] for cloud, rows in zip((found_cloud, wanted_cloud), order, strict=True))
        assert np.abs(a - b).max() < 0.0011
        for key, values in found_cloud.attributes.items():
            if key in wanted_cloud.attributes and key not in ("red", "green", "blue"):
                wanted_values = wanted_cloud.attributes[key][order[1]]
                np.testing.assert_allclose(
                    values[order[0]].astype(float), wanted_values.astype(float), atol=1e-6, err_msg=key
                )


@pytest.mark.usefixtures("in_parts")
def test_without_a_folder_nothing_stays_behind(
    files: tuple[Path, Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    result = run("evaluate", files[0], files[1], "--transform", files[2])
    assert "source to target" in result.stdout
    assert list(tmp_path.iterdir()) == []


def test_info_tells_the_same_of_parts(
    files: tuple[Path, Path, Path], tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    doubled = laspy.read(files[0])
    doubled.points = laspy.ScaleAwarePointRecord(
        np.concatenate([doubled.points.array, doubled.points.array[:777]]),
        doubled.point_format,
        scales=doubled.header.scales,
        offsets=doubled.header.offsets,
    )
    doubled.write(tmp_path / "doubled.laz")
    paths = *files[:2], tmp_path / "doubled.laz"
    whole = run("info", *paths, "--json"), run("info", *paths)
    request.getfixturevalue("in_parts")
    parts = run("info", *paths, "--json"), run("info", *paths)
    assert "in parts" in parts[1].stderr
    assert json.loads(whole[0].stdout)["files"][2]["wrong"][0].startswith("repeated points: 777")
    assert_alike(json.loads(parts[0].stdout), json.loads(whole[0].stdout))
    assert parts[1].stdout == whole[1].stdout


def test_neighbours_in_blocks_are_those_of_scipy(
    files: tuple[Path, Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pair, "n_tile_points", lambda _: 2000)
    monkeypatch.setattr(neighbours, "_KEPT_POINTS", 500)
    tiled = tile_pair(open_las(files[0]), open_las(files[1]), np.eye(4), tmp_path, 300_000_000).source
    cloud = tmchho.read(files[0]).xyz
    places = np.random.default_rng(0).uniform(-100, 200, (300, 3))
    distances, points = Blocks(tiled).nearest(places, 5)
    wanted, numbers = cKDTree(cloud).query(places, 5)
    np.testing.assert_allclose(distances, wanted, atol=1e-9)
    np.testing.assert_allclose(points, cloud[numbers], atol=1e-9)
    in_plan, _ = Blocks(tiled, flat=True).nearest(places, 5)
    np.testing.assert_allclose(in_plan, cKDTree(cloud[:, :2]).query(places[:, :2], 5)[0], atol=1e-9)
    np.testing.assert_allclose(tiled.sample(100), cloud[::120], atol=1e-9)
    spacing = spacing_at(tiled, tiled.sample(100), lambda n: (n - 1) // 2)
    assert spacing == pytest.approx(np.sort(cKDTree(cloud).query(cloud[::120], 2)[0][:, 1])[49])


@pytest.mark.parametrize("share", [0.0, 0.333, 0.5, 0.95, 1.0])
def test_quantiles_of_parts_are_those_of_numpy(share: float, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lengths, "_SORTED_AT_ONCE", 100)
    rng = np.random.default_rng(0)
    spread = (rng.gamma(2, 3, 5000), rng.integers(0, 5, 5000) * 1.0, rng.normal(size=777), np.ones(5))
    for values in (*spread, np.array([3.0]), np.concatenate([np.zeros(4000), [1e9]])):
        parts = np.array_split(values, 7)
        found = lengths.quantile_of_parts(lambda parts=parts: parts, share)
        assert found == pytest.approx(np.quantile(values, share), rel=1e-12, abs=1e-12)
    assert np.isnan(lengths.quantile_of_parts(lambda: [], share))


def test_the_peak_stays_near_what_is_allowed(tmp_path: Path) -> None:
    """The points of both take 250 MB and more as wholes; the interpreter and its libraries take 120 MB."""
    for name, seed, low in (("a", 1, 0), ("b", 2, 20)):
        header = laspy.LasHeader(version="1.2", point_format=0)
        header.scales = [0.001] * 3
        las = laspy.LasData(header)
        las.xyz = np.concatenate([hills(50_000, low, low + 60, 10 * seed + n) for n in range(8)])
        las.write(tmp_path / f"{name}.las")
    code = (
        "import sys\n"
        "from tmchho.cli import main\n"
        "try:\n"
        "    main(sys.argv[1:])\n"
        "finally:\n"
        "    print(open('/proc/self/status').read().split('VmHWM:')[1].split()[0], file=sys.stderr)\n"
    )
    peaks = []
    for limit in ("200MB", "8GB"):
        command = [sys.executable, "-c", code, "evaluate", "a.las", "b.las", "-q", "--max-memory", limit]
        command += ["--max-distance", "1"]
        ran = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True, timeout=300)
        peaks.append(int(ran.stderr.split()[-1]) / 1000)
    assert peaks[0] < 200 < peaks[1], peaks
