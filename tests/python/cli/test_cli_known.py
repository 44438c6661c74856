"""`tmchho register` with more than two clouds: scale, prior, control points, crops, a time limit."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from cli_tools import assert_refused, names_in, run

import tmchho
from tmchho.outputs import matrix_text, quaternion_wxyz, read_matrix
from tmchho.simulate import SimulatedPair

LOW_QUALITY = "[coarse]\nrotations_per_round = [60]\n"


@pytest.fixture(scope="module")
def prior(pair: SimulatedPair, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("prior") / "rough.txt"
    path.write_text(matrix_text(pair.target_from_source))
    return path


def test_a_scale_goes_into_every_file(pair: SimulatedPair, files: tuple[Path, Path], tmp_path: Path) -> None:
    shrunk, folder, config = tmp_path / "model.npy", tmp_path / "out", tmp_path / "bounds.toml"
    # About its middle, because at national-grid size a coordinate is no small number any more.
    middle = pair.source.xyz.mean(axis=0)
    np.save(shrunk, (pair.source.xyz - middle) / 1.1)
    config.write_text("scale_bounds = [1.0, 1.25]\n")
    result = run("register", shrunk, files[1], "-o", folder, "--dof", 7, "--config", config)
    assert result.exit_code == 0, result.output
    document = json.loads((folder / "result.json").read_text())
    assert document["scale"] == pytest.approx(1.1, rel=0.005)
    assert document["transformation_as"]["scale"] == document["scale"]
    assert document["config"]["dof"] == 7
    assert f"scale      {document['scale']:.8g}" in result.stdout
    assert "accuracy" in result.stdout
    assert "misfit" in result.stdout
    matrix = read_matrix(folder / "transform.txt")
    assert np.cbrt(np.linalg.det(matrix[:3, :3])) == pytest.approx(document["scale"])
    said = document["transformation_as"]
    unscaled = matrix[:3, :3] / document["scale"]
    rotation = tmchho.euler_to_matrix([*np.radians(said["euler_deg"]), 0, 0, 0])[:3, :3]
    np.testing.assert_allclose(rotation, unscaled, atol=1e-7)
    np.testing.assert_allclose(said["quaternion_wxyz"], quaternion_wxyz(pair.target_from_source), atol=5e-3)
    # What was written lies where the true pose takes it, and where the matrix does.
    written = tmchho.read(folder / "source_registered.laz").xyz
    places = np.load(shrunk) @ matrix[:3, :3].T + matrix[:3, 3]
    assert np.abs(written - places).max() < 1e-3
    true = pair.source.xyz @ pair.target_from_source[:3, :3].T + pair.target_from_source[:3, 3]
    assert np.sqrt(((written - true) ** 2).sum(axis=1).mean()) < document["voxel_size"]
    fused = tmchho.read(folder / "fused.laz")
    assert np.abs(fused.xyz[fused.attributes["origin"] == 1] - written).max() < 2e-3
    measured = json.loads(
        run("evaluate", shrunk, files[1], "--transform", folder / "result.json", "--json").stdout
    )
    assert measured["source_to_target"]["rms"] == pytest.approx(document["source_to_target"]["rms"])


def test_what_is_known_counts_and_is_in_the_command_that_replays(
    pair: SimulatedPair, files: tuple[Path, Path], prior: Path, tmp_path: Path
) -> None:
    places = pair.source.xyz[[0, 3000, 7000, 11000]]
    true = places @ pair.target_from_source[:3, :3].T + pair.target_from_source[:3, 3]
    table = tmp_path / "points.csv"
    np.savetxt(table, np.column_stack([places, true, np.full(4, 0.5)]), delimiter=",")
    low, high = pair.target.xyz.min(axis=0) - 1, pair.target.xyz.max(axis=0) + 1
    crop = ",".join(repr(float(value)) for value in [*low, *high])
    options = ["--prior", prior, "--prior-sigma-deg", 5.0, "--prior-sigma", 2.0, "--control-points", table]
    options += ["--crop-target", crop, "--max-seconds", 1000.0]
    result = run("register", *files, "-o", tmp_path / "out", "--json", *options)
    assert result.exit_code == 0, result.output
    document = json.loads(result.stdout)
    for option in options:
        assert str(option) in document["command"]
    known = document["config"]["known"]
    assert known["prior"]["rotation_rad"] == pytest.approx([np.radians(5)] * 3)
    assert known["prior"]["translation_m"] == [2.0] * 3
    np.testing.assert_array_equal(known["prior"]["target_from_source"], read_matrix(prior))
    np.testing.assert_array_equal([point["source"] for point in known["control_points"]], places)
    np.testing.assert_array_equal(document["config"]["target_crop_m"], [low, high])
    assert document["config"]["coarse"]["max_seconds"] == 1000


def test_a_prior_from_another_result_is_read(
    registered: tuple[Path, object], files: tuple[Path, Path], tmp_path: Path
) -> None:
    earlier = registered[0] / "result.json"
    result = run("register", *files, "-o", tmp_path / "out", "--prior", earlier, "--prior-sigma", 1, "--json")
    prior = json.loads(result.stdout)["config"]["known"]["prior"]
    assert prior["target_from_source"] == json.loads(earlier.read_text())["transformation"]
    assert prior["rotation_rad"] is None


def test_a_search_whose_time_is_up_is_not_accepted(files: tuple[Path, Path], tmp_path: Path) -> None:
    result = run("register", *files, "-o", tmp_path / "out", "--max-seconds", 1e-6)
    assert result.exit_code == 4
    assert "the time was up" in result.stdout
    assert json.loads((tmp_path / "out" / "result.json").read_text())["ended_early"] is True


def test_a_mirrored_source_is_named(pair: SimulatedPair, files: tuple[Path, Path], tmp_path: Path) -> None:
    mirrored, config = tmp_path / "mirrored.npy", tmp_path / "quick.toml"
    np.save(mirrored, pair.source.xyz[:, [1, 0, 2]])
    config.write_text(LOW_QUALITY)
    result = run("register", mirrored, files[1], "-o", tmp_path / "out", "--config", config)
    assert result.exit_code == 4
    assert "and the source fits well when mirrored" in result.stdout


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--dof", "5"], ["--dof"]),
        (["--dof", "7", "--mode", "paper"], ["dof must be 6 in paper mode"]),
        (["--prior-sigma", "1"], ["--prior", "missing"]),
        (["--prior", "rough.txt"], ["--prior-sigma"]),
        (["--prior", "rough.txt", "--prior-sigma", "-1"], ["--prior-sigma", "above 0"]),
        (["--crop-source", "0,0,0,1,1"], ["--crop-source", "six numbers"]),
        (["--crop-target", "0,0,5,1,1,1"], ["--crop-target", "min below its max"]),
        (["--crop-target", "-1,nan,0,1,1,1"], ["--crop-target"]),
        (["--max-seconds", "0"], ["--max-seconds", "above 0"]),
    ],
)
def test_wrong_options_are_wrong_usage(
    files: tuple[Path, Path], tmp_path: Path, arguments: list[str], words: list[str]
) -> None:
    assert_refused(run("register", *files, "-o", tmp_path / "out", *arguments), 2, *words)
    assert names_in(tmp_path) == []


def test_bad_files_of_what_is_known_are_named(files: tuple[Path, Path], tmp_path: Path) -> None:
    table = tmp_path / "points.csv"
    table.write_text("# east, north, up\n1,2,3,4,5,6\n")
    result = run("register", *files, "-o", tmp_path / "out", "--control-points", table)
    assert_refused(result, 3, f"{table}, line 2", "6 values where 7")
    missing = tmp_path / "nowhere.txt"
    result = run("register", *files, "-o", tmp_path / "out", "--prior", missing, "--prior-sigma", 1)
    assert_refused(result, 3, str(missing))
    assert names_in(tmp_path) == ["points.csv"]
