"""PTX: grids with gaps, poses, several scans; and back."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
import pytest

import tmchho.io
from tmchho.cloud import PointCloud
from tmchho.errors import ReadError
from tmchho.io.scans import Scan
from tmchho.simulate import random_pose

# Turned a quarter to the left and moved to a national grid: (x, y, z) -> (500000 - y, 4000000 + x, 100 + z).
HEADER = """{columns}
{rows}
500000 4000000 100
0 1 0
-1 0 0
0 0 1
0 1 0 0
-1 0 0 0
0 0 1 0
500000 4000000 100 1
"""
POINTS = "1 2 3 0.25 10 20 30\n0 0 0 0.5 0 0 0\n4 5 6 1 40 50 60\n-1 0 0.5 0 255 0 1\n"
WORLD = [[499_998, 4_000_001, 103], [499_995, 4_000_004, 106], [500_000, 3_999_999, 100.5]]


def ptx(points: str = POINTS, columns: int = 2, rows: int = 2) -> str:
    return HEADER.format(columns=columns, rows=rows) + points


def read_text(folder: Path, text: str, name: str = "a.ptx") -> PointCloud:
    (folder / name).write_bytes(text.encode())
    return tmchho.io.read(folder / name)


def message_of(folder: Path, text: str) -> str:
    with pytest.raises(ReadError) as caught:
        read_text(folder, text)
    assert str(caught.value).startswith(f"{folder / 'a.ptx'}: ")
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize("line_end", ["\n", "\r\n", "\r", "\n\n"])
@pytest.mark.parametrize("name", ["a.ptx", "a.txt", "a.xyz", "a"])
def test_the_pose_is_applied_whatever_the_name(tmp_path: Path, line_end: str, name: str) -> None:
    cloud = read_text(tmp_path, ptx().replace("\n", line_end), name)
    np.testing.assert_allclose(cloud.xyz, WORLD, atol=1e-9)
    assert cloud.attributes["intensity"].tolist() == [0.25, 1, 0]
    assert cloud.attributes["red"].tolist() == [10, 40, 255]
    assert cloud.attributes["red"].dtype == np.uint8


def test_cells_without_a_point_are_left_out_and_counted(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.INFO, logger="tmchho.io"):
        cloud = read_text(tmp_path, ptx())
    assert "1 of 4 points of scan 1 are invalid and left out" in caplog.text
    assert cloud.attributes["column_index"].tolist() == [0, 1, 1]
    assert cloud.attributes["row_index"].tolist() == [0, 0, 1]


def test_several_scans(tmp_path: Path) -> None:
    cloud = read_text(tmp_path, ptx() + ptx("7 8 9 0.5\n", 1, 1) + ptx("", 0, 0) + ptx("0 0 0 0.5\n", 1, 1))
    assert len(cloud) == 4
    assert cloud.attributes["scan_index"].tolist() == [0, 0, 0, 1]
    assert len(cloud.metadata["scans"]) == 2
    np.testing.assert_allclose(cloud.xyz[3], [499_992, 4_000_007, 109])


def test_a_grid_with_gaps_comes_back_as_it_was(tmp_path: Path) -> None:
    first = read_text(tmp_path, ptx() + ptx())
    tmchho.io.write(first, tmp_path / "b.ptx")
    text = (tmp_path / "b.ptx").read_text()
    assert text.startswith("2\n2\n500000.0 4000000.0 100.0\n0.0 1.0 0.0\n")
    assert "\n0.0 0.0 0.0 0.5 0 0 0\n" in text
    back = tmchho.io.read(tmp_path / "b.ptx")
    np.testing.assert_allclose(back.xyz, first.xyz, atol=1e-9)
    assert list(back.attributes) == list(first.attributes)
    for name, values in first.attributes.items():
        np.testing.assert_array_equal(back.attributes[name], values, err_msg=name)


def test_poses_and_attributes_survive(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    rng = np.random.default_rng(0)
    poses = [random_pose(rng, 100.0) for _ in range(2)]
    xyz = np.array([500_000, 4_000_000, 100]) + rng.normal(0, 20, (50, 3))
    attributes = {
        "intensity": rng.random(50),
        **{name: rng.integers(0, 256, 50).astype(np.uint8) for name in ("red", "green", "blue")},
        "scan_index": np.repeat(np.arange(2, dtype=np.uint16), 25),
        "gps_time": rng.random(50),
    }
    cloud = PointCloud(xyz, attributes, metadata={"scans": tuple(Scan("", pose) for pose in poses)})
    with caplog.at_level(logging.WARNING, logger="tmchho.io"):
        tmchho.io.write(cloud, tmp_path / "a.ptx")
    assert "left out: gps_time" in caplog.text
    back = tmchho.io.read(tmp_path / "a.ptx")
    np.testing.assert_allclose(back.xyz, xyz, atol=2e-9, rtol=0)
    for name in ("intensity", "red", "green", "blue", "scan_index"):
        np.testing.assert_array_equal(back.attributes[name], attributes[name])
        assert back.attributes[name].dtype == attributes[name].dtype
    for scan, pose in zip(back.metadata["scans"], poses, strict=True):
        np.testing.assert_array_equal(scan.world_from_scan, pose)


def test_rows_and_columns_that_are_no_grid(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    cloud = PointCloud(
        np.arange(1.0, 10.0).reshape(3, 3),
        {"row_index": np.array([0, 0, 10**6]), "column_index": np.array([0, 0, 10**6])},
    )
    with caplog.at_level(logging.INFO, logger="tmchho.io"):
        tmchho.io.write(cloud, tmp_path / "a.ptx")
    assert "not those of one grid" in caplog.text
    np.testing.assert_array_equal(tmchho.io.read(tmp_path / "a.ptx").xyz, cloud.xyz)


def test_a_point_in_the_scanner_is_warned_of(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    tmchho.io.write(PointCloud(np.array([[0.0, 0, 0], [1, 2, 3]])), tmp_path / "a.ptx")
    assert "1 points lie in the scanner itself" in caplog.text


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (ptx(columns=3), "expected 6 points in scan 1, file holds 4"),
        (ptx(columns=99999, rows=99999), "expected 9999800001 points in scan 1, file holds 4"),
        (ptx(columns=1), "line 13 does not begin the header of scan 2"),
        (ptx().replace("40 50", "40"), "line 13 has 6 values where 7 are expected"),
        (ptx().replace("0.25", "a"), "line 11, column 4: 'a' is not a number"),
        (ptx("1 2 3 4 5\n", 1, 1), "line 11 has 5 values; 3, 4 or 7 are known"),
        (ptx("0 0 0 0.5\n", 1, 1), "every cell of its grids is empty"),
        (ptx().replace("-1 0 0 0\n", "0 1 0 0\n"), "impossible pose in scan 1"),
        (ptx().replace("0 1 0 0\n", "0 nan 0 0\n"), "impossible pose in scan 1"),
        (ptx().replace("0 1 0 0\n", "0 one 0 0\n"), "the matrix of scan 1 is not of numbers"),
    ],
)
def test_damage(tmp_path: Path, text: str, words: str) -> None:
    assert words in message_of(tmp_path, text)


def test_the_real_ptx_files(data_dir: Path) -> None:
    folder = data_dir / "formats" / "text_pdal"
    moved = tmchho.io.read(folder / "multiple-and-transform.ptx")
    plain = tmchho.io.read(folder / "no-color.ptx")
    for point in moved.xyz:  # the same points, scaled and shifted away and back by the matrix
        assert np.abs(plain.xyz - point).max(axis=1).min() < 0.01
    coloured = tmchho.io.read(folder / "1.2-with-color.ptx")
    las = tmchho.io.read(data_dir / "formats" / "las_pdal" / "1.2-with-color.las")
    np.testing.assert_allclose(coloured.xyz, las.xyz, atol=1e-6)
