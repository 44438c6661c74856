"""Project files: what a surveyor writes is what the network gets, and a slip of the pen is said."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from tmchho.errors import InvalidArgumentError, ReadError
from tmchho.network.project import project_of_files, read_project

WHOLE = """
name = "Dam, spring survey"
files = ["more/*.laz"]
control_points = "targets.csv"

[network]
voxel_size_m = 0.1

[registration]
seed = 3
icp.max_iterations = 40

[[station]]
file = "scans/S01.e57"
pose = [[1, 0, 0, 500000.0], [0, 1, 0, 5400000.0], [0, 0, 1, 200.0], [0, 0, 0, 1]]
fixed = true

[[station]]
name = "pier, left"
file = "scans/left.laz"
position = [500020.0, 5400010.0, 201.0]
position_sigma_m = [0.02, 0.02, 0.05]
place = [0.0, 0.0, 1.6]

[[station]]
file = "scans/rough.laz"
pose = "scans/rough.txt"
pose_sigma_deg = 5
pose_sigma_m = 2.0

[[block]]
name = "UAV"
file = "uav/block.laz"
position = [500010.0, 5400005.0, 230.0]
free_scale = true

[[control_point]]
station = "UAV"
place = [1.0, 2.0, 3.0]
position = [500001.0, 5400002.0, 203.0]
sigma_m = 0.01
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name in ("scans", "more", "uav"):
        (tmp_path / name).mkdir()
    for name in ("b.laz", "a.laz", "notes.txt"):
        (tmp_path / "more" / name).touch()
    (tmp_path / "scans" / "rough.txt").write_text("0 -1 0 10\n1 0 0 20\n0 0 1 30\n0 0 0 1\n")
    (tmp_path / "targets.csv").write_text(
        "# total station, 3 May\n"
        "target;station;place_x;place_y;place_z;x;y;z;sigma_m\n"
        "T1;pier, left;0.5;1.5;2.5;500020.5;5400011.5;203.5;0.004\n"
        "\n"
        "T2;a;1;2;3;500000;5400000;200;0.004\n"
    )
    return tmp_path


def write_project(folder: Path, text: str) -> Path:
    path = folder / "PROJECT.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_a_whole_project_is_read(folder: Path) -> None:
    project = read_project(write_project(folder, WHOLE))
    assert project.name == "Dam, spring survey"
    assert [station.name for station in project.stations] == ["S01", "pier, left", "rough", "UAV", "a", "b"]
    first, left, rough, block, *others = project.stations
    assert first.fixed
    assert np.asarray(first.pose)[:3, 3].tolist() == [500000.0, 5400000.0, 200.0]
    assert first.cloud == folder / "scans" / "S01.e57"
    assert left.position == (500020.0, 5400010.0, 201.0)
    assert left.position_sigma_m == (0.02, 0.02, 0.05)
    assert left.place == (0.0, 0.0, 1.6)
    assert np.asarray(rough.pose)[:3, 3].tolist() == [10.0, 20.0, 30.0]
    assert rough.pose_sigma_rad == pytest.approx(math.radians(5))
    assert (block.kind, block.free_scale, first.kind, first.free_scale) == ("block", True, "scan", False)
    assert [station.cloud for station in others] == [folder / "more" / "a.laz", folder / "more" / "b.laz"]
    assert [(point.station, point.sigma_m) for point in project.control_points] == [
        ("UAV", 0.01),
        ("pier, left", 0.004),
        ("a", 0.004),
    ]
    assert project.control_points[1].place == (0.5, 1.5, 2.5)
    assert project.control_points[1].position == (500020.5, 5400011.5, 203.5)
    assert project.network == {"voxel_size_m": 0.1}
    assert project.registration == {"seed": 3, "icp": {"max_iterations": 40}}


def test_a_file_that_has_a_table_is_no_second_station(folder: Path) -> None:
    text = 'files = ["more/*.laz"]\n[[station]]\nfile = "more/b.laz"\nname = "tower"\n'
    project = read_project(write_project(folder, text))
    assert [station.name for station in project.stations] == ["tower", "a"]
    assert project.name == "PROJECT"


TWO = '[[station]]\nfile = "a.laz"\n[[station]]\nfile = "b.laz"\n'


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("stations = 3\n" + TWO, "unknown key 'stations'"),
        (TWO + 'colour = "red"\n', r"unknown key 'colour' in \[\[station\]\] number 2"),
        ("[network]\nvoxel = 1\n" + TWO, r"unknown key 'voxel' in \[network\]"),
        (TWO + "free_scale = true\n", "unknown key 'free_scale'"),
        (TWO + '[[block]]\nfile = "c.laz"\nscale = 1\n', r"unknown key 'scale' in \[\[block\]\] number 1"),
        (TWO + '[[control_point]]\nname = "T1"\n', r"unknown key 'name' in \[\[control_point\]\] number 1"),
        (TWO + '[[control_point]]\nstation = "a"\n', "needs the key place"),
        ('[[station]]\nname = "a"\n' + TWO, r"\[\[station\]\] number 1: needs the key file"),
        ('[[station]]\nfile = "a.laz"\n', "names 1 clouds"),
        ("", "names 0 clouds"),
        ('[[station]]\nfile = "a.laz"\n[[station]]\nfile = "x/A.laz"\n', "both called 'A'"),
        (TWO + 'fixed = "yes"\n', "fixed must be true or false"),
        (TWO + "name = 7\n", "name must be text"),
        (TWO + "position = [1, 2]\n", r"position must have shape \(3,\)"),
        (TWO + "pose_sigma_deg = nan\n", "pose_sigma_deg must be a number"),
        (TWO + "position_sigma_m = 0.1\n", "needs a position"),
        ("station = 3\n", r"must be tables, each headed \[\[station\]\]"),
        ("network = 3\n" + TWO, r"must be a table headed \[network\]"),
        ('files = "*.laz"\n', "files must be a list"),
        ('[[station]]\nfile = "../other/a.laz"\n' + TWO, "leads out of the project's folder"),
        ('[[station]]\nfile = "x/../../a.laz"\n' + TWO, "leads out of the project's folder"),
        ('files = ["../*.laz"]\n', "leads out of the project's folder"),
        ('control_points = "../t.csv"\n' + TWO, "leads out of the project's folder"),
        (
            TWO + '[[control_point]]\nstation = "c"\nplace = [0,0,0]\nposition = [0,0,0]\nsigma_m = 1\n',
            "station 'c', which is not there",
        ),
        ("[[station]\n", "is not valid TOML"),
    ],
)
def test_a_slip_is_said_with_the_file_and_the_key(tmp_path: Path, text: str, said: str) -> None:
    path = write_project(tmp_path, text)
    with pytest.raises(InvalidArgumentError, match=said) as caught:
        read_project(path)
    assert str(caught.value).startswith(str(path))


def test_an_absolute_path_is_meant_and_a_link_in_the_folder_is_followed(tmp_path: Path) -> None:
    folder, elsewhere = tmp_path / "project", tmp_path / "disk"
    folder.mkdir()
    elsewhere.mkdir()
    (elsewhere / "b.laz").touch()
    (folder / "scans").symlink_to(elsewhere)
    text = f"files = ['scans/*.laz']\n[[station]]\nfile = '{elsewhere / 'a.laz'}'\n"
    project = read_project(write_project(folder, text))
    assert [station.cloud for station in project.stations] == [
        elsewhere / "a.laz",
        folder / "scans" / "b.laz",
    ]


def test_a_pattern_may_stand_in_a_folder_with_odd_characters(tmp_path: Path) -> None:
    folder = tmp_path / "site [2]"
    (folder / "scans").mkdir(parents=True)
    for name in ("a.laz", "b.laz"):
        (folder / "scans" / name).touch()
    project = read_project(write_project(folder, 'files = ["scans/*.laz"]'))
    assert [station.name for station in project.stations] == ["a", "b"]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "is empty"),
        ("station,x,y,z\n", "no one column called place_x, place_y, place_z, sigma_m"),
        ("station,place_x,place_y,place_z,x,y,z,sigma_m\na,1,2\n", "line 2: has 3 cells where 8"),
        ("station,place_x,place_y,place_z,x,y,z,sigma_m\na,1,2,3,4,5,six,0.1\n", "line 2: .*six"),
        ("station,place_x,place_y,place_z,x,y,z,sigma_m\na,1,2,3,4,5,6,0\n", "line 2: .*sigma_m"),
    ],
)
def test_a_table_of_control_points_with_a_slip_is_refused(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "t.csv").write_text(text)
    with pytest.raises(ReadError, match=said):
        read_project(write_project(tmp_path, 'control_points = "t.csv"\n' + TWO))


def test_missing_files_are_said(tmp_path: Path) -> None:
    with pytest.raises(ReadError, match=r"PROJECT\.toml: cannot be read"):
        read_project(tmp_path / "PROJECT.toml")
    with pytest.raises(ReadError, match="no file has such a name"):
        read_project(write_project(tmp_path, 'files = ["scans/*.laz"]'))


def test_files_alone_are_a_project() -> None:
    project = project_of_files(["scans/S01.laz", Path("S02.e57")])
    assert [station.name for station in project.stations] == ["S01", "S02"]
    with pytest.raises(InvalidArgumentError, match="both called"):
        project_of_files(["x/S01.laz", "y/s01.e57"])
