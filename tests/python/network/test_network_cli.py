"""`tmchho network` from the outside: files, exit codes, resume, and the same bytes wherever it ran."""

from __future__ import annotations

import csv
import json
import random
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner, Result
from made_networks import made_network, make_clouds

import tmchho
from tmchho.cli import main
from tmchho.network.cluster import local_cluster
from tmchho.network.files import links_csv, network_document, pose_names, write_network

N_CLOUDS = 3


@pytest.fixture(scope="module")
def scans(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("scans")
    paths = []
    for number, cloud in enumerate(make_clouds(N_CLOUDS)[0], start=1):
        paths.append(folder / f"S{number}.laz")
        tmchho.write(tmchho.PointCloud(cloud), paths[-1])
    return paths


@pytest.fixture(scope="module")
def finished(scans: list[Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Run a network on threads of this process, with its report and the fused cloud."""
    folder = tmp_path_factory.mktemp("finished") / "out"
    result = run(*scans, "-o", folder, "--fuse", "dedup")
    assert result.exit_code == 0, result.output
    return folder


def run(*arguments: Any) -> Result:
    return CliRunner().invoke(main, ["network", *map(str, arguments)])


def bytes_of(folder: Path) -> dict[str, bytes]:
    """Return every file of the results, but not what is kept for a resume."""
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and "work" not in path.relative_to(folder).parts
    }


def test_all_files_are_there_and_hold_the_poses(finished: Path) -> None:
    names = set(bytes_of(finished))
    poses = {f"poses/S{n}{ending}" for n in (1, 2, 3) for ending in (".txt", ".json", ".pdal.json")}
    assert names == {"network.json", "links.csv", "stations.csv", "report.html", "fused.laz"} | poses
    document = json.loads((finished / "network.json").read_text())
    truths = make_clouds(N_CLOUDS)[1]
    found = [np.array(station["world_from_station"]) for station in document["stations"]]
    for number in range(N_CLOUDS):
        expected = np.linalg.inv(truths[0]) @ truths[number]
        np.testing.assert_allclose(np.linalg.inv(found[0]) @ found[number], expected, atol=0.02)
        pose = tmchho.read_transform(finished / "poses" / f"S{number + 1}.json")
        np.testing.assert_allclose(pose.matrix, found[number], atol=1e-15)
        text = tmchho.read_transform(finished / "poses" / f"S{number + 1}.txt")
        np.testing.assert_array_equal(text.matrix, found[number])
    for station, pose, cloud in zip(document["stations"], found, make_clouds(N_CLOUDS)[0], strict=True):
        middle = np.linalg.inv(pose) @ [*station["middle_m"], 1.0]
        np.testing.assert_allclose(
            middle[:2], cloud[:, :2].mean(axis=0), atol=0.3
        )  # of voxels, not of points
    # Two points of the same ground come to lie on each other.
    assert len(tmchho.read(finished / "fused.laz")) == document["fused"]["n_points"]
    assert document["fused"]["stations"][1]["rms"] < 0.15


def test_tables_are_those_of_the_document(finished: Path) -> None:
    document = json.loads((finished / "network.json").read_text())
    with (finished / "links.csv").open(newline="") as stream:
        links = list(csv.DictReader(stream))
    assert [(row["source"], row["target"]) for row in links] == [
        (link["source"], link["target"]) for link in document["links"]
    ]
    assert {row["kept"] for row in links} <= {"yes", "no"}
    assert float(links[0]["rms_m"]) == document["links"][0]["rms"]
    with (finished / "stations.csv").open(newline="") as stream:
        stations = list(csv.DictReader(stream))
    for row, station in zip(stations, document["stations"], strict=True):
        assert [float(row[axis]) for axis in "xyz"] == [line[3] for line in station["world_from_station"][:3]]
        assert row["file"] == f"{row['name']}.laz" == station["input"]["file"]
    assert (finished / "report.html").read_text(encoding="utf-8").count("<table>") >= 3


def test_an_existing_result_is_refused_and_resume_leaves_the_same_bytes(
    scans: list[Path], finished: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "out"
    shutil.copytree(finished, folder)
    before = bytes_of(folder)
    refused = run(*scans, "-o", folder)
    assert refused.exit_code == 5
    assert "--resume" in refused.output
    assert "--overwrite" in refused.output
    (folder / "network.json").unlink()
    assert run(*scans, "-o", folder).exit_code == 5  # what is finished alone is refused, too
    resumed = run(*scans, "-o", folder, "--fuse", "dedup", "--resume")
    assert resumed.exit_code == 0, resumed.output
    assert "are done already" in resumed.output
    assert bytes_of(folder) == before


def test_without_fuse_no_old_fused_cloud_stays(scans: list[Path], finished: Path, tmp_path: Path) -> None:
    folder = tmp_path / "out"
    shutil.copytree(finished, folder)
    assert run(*scans, "-o", folder, "--resume", "--no-report").exit_code == 0
    assert not (folder / "fused.laz").exists()
    assert not (folder / "report.html").exists()


def test_a_local_cluster_leaves_the_same_bytes(scans: list[Path], finished: Path, tmp_path: Path) -> None:
    folder = tmp_path / "out"
    result = run(*scans, "-o", folder, "--fuse", "dedup", "--workers", "2", "--memory-per-worker", "1GB")
    assert result.exit_code == 0, result.output
    assert bytes_of(folder) == bytes_of(finished)


def test_a_scheduler_address_leaves_the_same_tables(
    scans: list[Path], finished: Path, tmp_path: Path
) -> None:
    with local_cluster(1) as cluster:
        address = cluster.client.scheduler.address
        result = run(*scans, "-o", tmp_path / "out", "--scheduler", address, "--no-report")
    assert result.exit_code == 0, result.output
    assert f"{address}: 1 units at a time" in result.output
    for name in ("links.csv", "stations.csv", "poses/S2.json"):
        assert (tmp_path / "out" / name).read_bytes() == (finished / name).read_bytes()


def test_killed_at_random_moments_resume_leaves_the_same_bytes(
    scans: list[Path], finished: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "out"
    command = [sys.executable, "-m", "tmchho", "network", *map(str, scans), "-o", str(folder)]
    command += ["--fuse", "dedup", "--resume", "-q"]
    generator = random.Random(5)
    work = folder / "work" / "finished"
    n_killed = 0
    while n_killed < 2:
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
        n_entries = len(list(work.rglob("*.json")))
        goal = n_entries + generator.randint(1, 4)
        while process.poll() is None and len(list(work.rglob("*.json"))) < goal:
            time.sleep(0.005)
        time.sleep(generator.uniform(0.0, 0.05))
        assert process.poll() is None, "it ended before it could be killed"
        process.send_signal(signal.SIGKILL)
        process.wait(timeout=60)
        n_killed += 1
    assert not (folder / "network.json").exists()
    subprocess.run(command, stdout=subprocess.DEVNULL, check=True, timeout=120)
    assert bytes_of(folder) == bytes_of(finished)


def test_overwrite_begins_anew_and_keeps_nothing_of_the_old(
    scans: list[Path], finished: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "out"
    shutil.copytree(finished, folder)
    (folder / "poses" / "mine.txt").write_text("not yours")
    result = run(*scans[:2], "-o", folder, "--overwrite")
    assert result.exit_code == 0, result.output
    assert "are done already" not in result.output
    left = {path.name for path in (folder / "poses").iterdir()}
    assert "S3.txt" not in left
    assert {"S1.txt", "S2.json", "mine.txt"} <= left


def test_a_folder_called_work_that_is_not_ours_is_left_alone(scans: list[Path], tmp_path: Path) -> None:
    folder = tmp_path / "out"
    (folder / "work").mkdir(parents=True)
    (folder / "work" / "thesis.txt").write_text("mine")
    for option in ("--overwrite", "--resume"):
        result = run(*scans, "-o", folder, option)
        assert result.exit_code == 5
        assert "was not made by a network" in result.output
    assert (folder / "work" / "thesis.txt").read_text() == "mine"


def test_a_project_says_what_is_known(scans: list[Path], tmp_path: Path) -> None:
    pose = make_clouds(1)[1][0]
    pose[:3, 3] += [500_000.0, 5_400_000.0, 200.0]
    tables = "".join(f"[[station]]\nfile = '{path}'\n" for path in scans[1:])
    text = f"name = 'Slope'\n[network]\nlevelled = true\n{tables}[[station]]\nfile = '{scans[0]}'\n"
    text += f"name = 'base'\nfixed = true\npose = {pose.tolist()}\n"
    (tmp_path / "PROJECT.toml").write_text(text)
    result = run(tmp_path / "PROJECT.toml", "-o", tmp_path / "out", "--json", "--no-report", "-q")
    assert result.exit_code == 0, result.output
    document = json.loads(result.stdout)
    assert document == json.loads((tmp_path / "out" / "network.json").read_text())
    assert document["name"] == "Slope"
    assert document["settings"]["dof"] == 4
    base = document["stations"][2]
    assert base["name"] == "base"
    np.testing.assert_allclose(base["world_from_station"], pose, atol=1e-14)
    truths = make_clouds(2)[1]
    expected = pose @ np.linalg.inv(truths[0]) @ truths[1]
    np.testing.assert_allclose(document["stations"][0]["world_from_station"], expected, atol=0.02)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--resume", "--overwrite"], "give one of them"),
        (["--memory-per-worker", "1GB"], "needs --workers"),
        (["--scheduler", "tcp://x:1", "--workers", "2"], "where the workers are started"),
        (["--workers", "2", "--threads", "2"], "--threads is for this process"),
        (["--repeat-radius", "0.1"], "belongs to --fuse dedup"),
        (["--workers", "0"], "0 is not in the range"),
    ],
)
def test_options_that_contradict_each_other_are_refused(
    scans: list[Path], tmp_path: Path, options: list[str], said: str
) -> None:
    result = run(*scans, "-o", tmp_path / "out", *options)
    assert result.exit_code == 2
    assert said in result.output
    assert not (tmp_path / "out").exists()


def test_a_missing_file_is_said_before_anything_is_made(scans: list[Path], tmp_path: Path) -> None:
    result = run(*scans, tmp_path / "gone.laz", "-o", tmp_path / "out")
    assert result.exit_code == 3
    assert "gone.laz" in result.output
    assert not (tmp_path / "out").exists()


def test_a_project_and_files_together_are_refused(scans: list[Path], tmp_path: Path) -> None:
    (tmp_path / "PROJECT.toml").write_text("")
    assert run(tmp_path / "PROJECT.toml", *scans, "-o", tmp_path / "out").exit_code == 2


def test_help_has_examples_and_exit_codes() -> None:
    said = run("--help").output
    assert "--scheduler tcp://" in said
    assert "Exit codes:" in said


def test_stations_of_any_name_get_files_and_lost_ones_none(tmp_path: Path) -> None:
    found = made_network(12, is_wrong=True)
    inputs = [{"file": f"{station.name}.laz", "n_bytes": 1, "sha256": "0"} for station in found.stations]
    write_network(tmp_path, network_document(found, "Dam", inputs, "tmchho network"))
    assert not (tmp_path / "poses" / "S04.txt").exists()
    assert (tmp_path / "poses" / "S05.txt").exists()
    rows = list(csv.DictReader((tmp_path / "stations.csv").open(newline="")))
    assert (rows[3]["x"], rows[3]["pose_file"], rows[3]["note"]) == ("", "", "no link to it was kept")
    assert pose_names(["../a", "a", ".."]) == ["a", "a-2", "station"]
    assert '"a, b"' in links_csv([{**found.to_dict()["links"][0], "source": "a, b"}])
