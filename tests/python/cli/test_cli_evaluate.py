"""`tmchho evaluate` with areas, methods and files; `register` with areas."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import laspy
import numpy as np
import pytest
from cli_tools import assert_refused, names_in, run, write_points
from click.testing import Result
from scipy.spatial import cKDTree

import tmchho

DAM = "499970,3999970,500010,4000020"


@pytest.fixture(scope="module")
def areas(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("areas") / "areas.wkt"
    path.write_text(
        "crest; POLYGON ((499980 4000000, 500020 4000000, 500020 4000040, 499980 4000040, 499980 4000000),"
        " (499990 4000010, 500000 4000010, 500000 4000020, 499990 4000020, 499990 4000010))\n"
        "elsewhere; POLYGON ((0 0, 1 0, 1 1, 0 0))\n"
    )
    return path


def test_register_records_areas_and_distances(registered: tuple[Path, Result]) -> None:
    document = json.loads((registered[0] / "result.json").read_text())
    assert [row["name"] for row in document["areas"]] == [f"area {n}" for n in range(1, 6)]
    limit = document["fused"]["hole_radius"]
    assert document["distances"]["max_distance"] == limit
    for row in document["areas"]:
        assert 0 <= row["best"] <= row["median"] <= row["percentile_95"] <= row["worst"] <= limit
        assert 0 < row["completeness_before"] <= row["completeness_after"] <= 1
        assert len(row["outline"][0][0]) == 5
    fused = tmchho.read(registered[0] / "fused.laz")
    forth = fused.attributes["C2C_absolute_distances"][fused.attributes["origin"] == 1]
    summed_up = document["distances"]["source_to_target"]
    assert summed_up["n_points"] == (forth <= limit).sum()
    assert summed_up["n_beyond"] == (forth > limit).sum()
    assert summed_up["mean"] == pytest.approx(forth[forth <= limit].mean())
    assert sum(row["n_points"] for row in document["areas"]) <= 1.01 * summed_up["n_points"]


def test_register_takes_areas_and_a_tolerance(files: tuple[Path, Path], areas: Path, tmp_path: Path) -> None:
    folder = tmp_path / "out"
    result = run(
        "register", *files, "-o", folder, "--areas", areas, "--tolerance", 0.3, "--fuse", "fill-holes"
    )
    assert result.exit_code == 0, result.stderr
    document = json.loads((folder / "result.json").read_text())
    crest, elsewhere = document["areas"]
    assert (crest["name"], elsewhere["remark"], elsewhere["n_points"]) == ("crest", "no data", 0)
    assert 0 < crest["share_within"] < 1
    assert "--areas" in document["command"]
    # With only the holes filled, distances are of all points still.
    fused = tmchho.read(folder / "fused.laz")
    assert document["distances"]["source_to_target"]["n_points"] > (fused.attributes["origin"] == 1).sum()


def test_evaluate_by_area_prints_and_writes_the_same(
    registered: tuple[Path, Result], files: tuple[Path, Path], areas: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "check"
    arguments = ("evaluate", *files, "--transform", registered[0] / "result.json", "--areas", areas)
    arguments += ("--area-box", f"dam={DAM}", "--tolerance", 0.3)
    shown = run(*arguments)
    lines = shown.stdout.splitlines()
    assert [line.split()[0] for line in lines[-3:]] == ["crest", "elsewhere", "dam"]
    assert "no data" in lines[-2]
    result = run(*arguments, "-o", folder, "--json")
    assert result.exit_code == 0, result.stderr
    document = json.loads(result.stdout)
    assert json.loads((folder / "evaluation.json").read_text()) == document
    assert names_in(folder) == sorted(
        [
            *("areas.csv", "evaluation.json", "legend.csv"),
            *(
                f"{way}{kind}"
                for way in ("source_to_target", "target_to_source")
                for kind in (".laz", ".csv", "_coloured.laz")
            ),
        ]
    )
    moved = tmchho.read(folder / "source_to_target.laz")
    inside = (moved.xyz[:, :2] >= [499970, 3999970]).all(axis=1)
    inside &= (moved.xyz[:, :2] <= [500010, 4000020]).all(axis=1)
    wanted = cKDTree(tmchho.read(files[1]).xyz).query(moved.xyz[inside])[0]
    with (folder / "areas.csv").open(encoding="utf-8") as stream:
        dam = list(csv.DictReader(stream))[-1]
    assert int(dam["n_points"]) == pytest.approx(inside.sum(), abs=2)  # the file has steps of a millimetre
    assert float(dam["avg"]) == pytest.approx(wanted.mean(), abs=1e-3)
    with laspy.open(folder / "target_to_source.laz") as reader:
        assert "C2C_absolute_distances" in reader.header.point_format.extra_dimension_names
    assert_refused(run(*arguments, "-o", folder), 5, "exists already")
    assert run(*arguments, "-o", folder, "--overwrite").exit_code == 0


def test_change_is_measured_with_the_recorded_error(
    registered: tuple[Path, Result], files: tuple[Path, Path], tmp_path: Path
) -> None:
    folder = tmp_path / "change"
    found = registered[0] / "result.json"
    result = run("evaluate", *files, "--transform", found, "--method", "m3c2", "-o", folder, "--json")
    assert result.exit_code == 0, result.stderr
    document = json.loads(result.stdout)
    assert document["registration_error"] == json.loads(found.read_text())["registration_error"] > 0
    cloud = tmchho.read(folder / "change.laz")
    assert len(cloud) == document["target_to_source"]["n_points"] + document["target_to_source"]["n_beyond"]
    assert set(np.unique(cloud.attributes["significant_change"])) <= {0, 1}
    assert "M3C2_distance" in (folder / "change.csv").read_text().splitlines()[0]
    assert "share_significant" in document["areas"][0]
    bare = run("evaluate", *files, "--method", "m3c2", "--normal-radius", 2, "--cylinder-radius", 1)
    assert "counts as 0" in bare.stderr
    assert "significant" in bare.stdout.splitlines()[0]


def test_points_beyond_a_distance_have_a_column(files: tuple[Path, Path]) -> None:
    assert "beyond" in run("evaluate", *files, "--max-distance", 5).stdout.splitlines()[0]
    assert "beyond" not in run("evaluate", *files).stdout.splitlines()[0]


def test_a_sparse_pair_is_warned_of(tmp_path: Path) -> None:
    points = np.random.default_rng(0).uniform(0, 9, (2, 900, 3)) * [1, 1, 0.001]
    paths = [write_points(tmp_path / f"{name}.xyz", cloud) for name, cloud in zip("ab", points, strict=True)]
    result = run("evaluate", *paths)
    assert result.exit_code == 0
    assert "tells about the spacing" in result.stderr
    assert "tells about the spacing" not in run("evaluate", *paths, "--method", "plane").stderr


@pytest.mark.parametrize(
    ("arguments", "exit_code", "word"),
    [
        (("--areas", "missing.geojson"), 3, "missing.geojson"),
        (("--area-box", "1,2,3"), 2, "four or six"),
        (("--area-box", "1,2,0,4"), 2, "minimum"),
        (("--method", "mesh"), 2, "mesh"),
        (("--method", "m3c2", "--normal-radius", "-1"), 2, "normal_radii"),
        (("--registration-error", "-1"), 2, "registration-error"),
        (("-o", "FILE"), 5, "is a file"),
    ],
)
def test_what_cannot_be_evaluated_is_refused(
    files: tuple[Path, Path], arguments: tuple[str, ...], exit_code: int, word: str
) -> None:
    arguments = tuple(str(files[0]) if word == "FILE" else word for word in arguments)
    assert_refused(run("evaluate", *files, *arguments), exit_code, word)
