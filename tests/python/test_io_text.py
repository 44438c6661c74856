"""Plain text: every spelling that people send, and a line number when it is none."""

from __future__ import annotations

import logging
import struct
from pathlib import Path

import numpy as np
import pytest

import tmchho.io
from tmchho.cli.display import display
from tmchho.cloud import PointCloud
from tmchho.errors import ReadError

XYZ = [[500_000.123, 4_000_000.456, 101.789], [500_001.5, 4_000_002.25, -3.0]]
PLAIN = "500000.123 4000000.456 101.789\n500001.5 4000002.25 -3\n"


def read_text(folder: Path, text: str | bytes, name: str = "a.xyz") -> PointCloud:
    (folder / name).write_bytes(text if isinstance(text, bytes) else text.encode())
    return tmchho.io.read(folder / name)


def message_of(folder: Path, text: str | bytes, name: str = "a.xyz") -> str:
    with pytest.raises(ReadError) as caught:
        read_text(folder, text, name)
    assert str(caught.value).startswith(str(folder / name))
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize(
    "text",
    [
        PLAIN,
        PLAIN.rstrip("\n"),
        PLAIN.replace("\n", "\r\n"),
        PLAIN.replace("\n", "\r"),
        "\ufeff" + PLAIN,
        PLAIN.encode("utf-16"),
        PLAIN.replace(" ", "\t"),
        PLAIN.replace(" ", ","),
        PLAIN.replace(" ", " , "),
        PLAIN.replace(" ", ";"),
        PLAIN.replace(" ", ", "),
        PLAIN.replace(".", ",").replace(" ", ";"),
        PLAIN.replace(".", ",").replace(" ", "\t"),
        PLAIN.replace(".", ","),
        PLAIN.replace(" ", "   "),
        "  " + PLAIN.replace("\n", "  \n  "),
        "\n\n" + PLAIN.replace("\n", "\n\n"),
        "# a comment\n// another\n% and another\n" + PLAIN,
        PLAIN.replace("\n", "\n# in between\n", 1),
        "X Y Z\n" + PLAIN,
        "x,y,z\n" + PLAIN.replace(" ", ","),
        '"X","Y","Z"\n' + PLAIN.replace(" ", ","),
        '"X","Y","Z"\n' + PLAIN,
        "Z Y X\n101.789 4000000.456 500000.123\n-3 4000002.25 500001.5\n",
        "Easting;Northing;Height\n" + PLAIN.replace(" ", ";"),
        "E N H\n" + PLAIN,
        "2\n" + PLAIN,
        "//X Y Z\n2\n" + PLAIN,
        "Name,Code,X,Y,Z\nP1,tree,500000.123,4000000.456,101.789\nP2,wall,500001.5,4000002.25,-3\n",
        "P1 500000.123 4000000.456 101.789\nP2 500001.5 4000002.25 -3\n",
        PLAIN.replace(" ", ",").replace("\n", ",\n"),
        '"500000.123","4000000.456","101.789"\n"500001.5","4000002.25","-3"\n',
        "500000.123e0 4.000000456E6 101.789\n+500001.5 4000002.25 -3\n",
    ],
)
@pytest.mark.parametrize("name", ["a.xyz", "a.txt", "a.csv", "a.asc", "a.pts"])
def test_one_cloud_in_many_spellings(tmp_path: Path, text: str | bytes, name: str) -> None:
    np.testing.assert_array_equal(read_text(tmp_path, text, name).xyz, XYZ)


def test_a_single_point_and_special_numbers(tmp_path: Path) -> None:
    np.testing.assert_array_equal(read_text(tmp_path, "1 2 3").xyz, [[1, 2, 3]])
    cloud = read_text(tmp_path, "1 2 3\nnan -inf 6\n")
    np.testing.assert_array_equal(cloud.xyz, [[1, 2, 3], [np.nan, -np.inf, 6]])


# --- names ---


def test_header_names_become_those_of_las(tmp_path: Path) -> None:
    text = "X,Y,Z,R,G,B,Intensity,GpsTime,C2C absolute distances\n1,2,3,255,0,7,40,5,0.25\n"
    cloud = read_text(tmp_path, text, "a.csv")
    assert list(cloud.attributes) == [
        *("red", "green", "blue", "intensity", "gps_time"),
        "C2C absolute distances",
    ]
    assert cloud.attributes["red"].dtype == np.uint8
    assert cloud.attributes["gps_time"].dtype == np.float64


def test_a_comment_that_names_the_columns(tmp_path: Path) -> None:
    assert list(read_text(tmp_path, "//X Y Z Intensity\n1 2 3 0.5\n").attributes) == ["intensity"]
    assert list(read_text(tmp_path, "# four words, but no\n1 2 3 0.5\n").attributes) == ["column_4"]


@pytest.mark.parametrize(
    ("name", "line", "expected"),
    [
        ("a.pts", "1 2 3 -512", ["intensity"]),
        ("a.pts", "1 2 3 10 20 30", ["red", "green", "blue"]),
        ("a.pts", "1 2 3 -512 10 20 30", ["intensity", "red", "green", "blue"]),
        ("a.xyz", "1 2 3 -512", ["column_4"]),
        ("a.xyz", "1 2 3 10 20 30", ["red", "green", "blue"]),
        ("a.xyz", "1 2 3 10 20 30 7.5", ["red", "green", "blue", "column_7"]),
        ("a.xyz", "1 2 3 0.0 -1.0 0.5", ["column_4", "column_5", "column_6"]),
        ("a.xyz", "1 2 3 0 1 0", ["nx", "ny", "nz"]),
        ("a.xyz", "1 2 3 0.6 0 -0.8 7", ["nx", "ny", "nz", "column_7"]),
        ("a.xyz", "1 2 3 10 20 30 0.6 0 -0.8", ["red", "green", "blue", "nx", "ny", "nz"]),
        ("a.xyz", "1 2 3 10 20 3000", ["column_4", "column_5", "column_6"]),
    ],
)
def test_names_without_a_header(tmp_path: Path, name: str, line: str, expected: list[str]) -> None:
    assert list(read_text(tmp_path, f"{line}\n{line}\n", name).attributes) == expected


def test_several_scans_with_a_count_each(tmp_path: Path) -> None:
    cloud = read_text(tmp_path, "2\n1 2 3 -512\n4 5 6 7\n1\n7 8 9 100\n", "a.pts")
    np.testing.assert_array_equal(cloud.xyz, np.arange(1, 10).reshape(3, 3))
    assert cloud.attributes["intensity"].tolist() == [-512, 7, 100]


def test_assumptions_and_doubts_are_logged(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.INFO, logger="tmchho.io"):
        read_text(tmp_path, "Name;a;b;c\nP1;1,5;2,5;3,5\n")
        read_text(tmp_path, "1 500000.5 4000000.5 9\n2 500001.5 4000001.5 9\n3 500002.5 4000002.5 9\n")
        read_text(tmp_path, "1\n1 2 3\n4 5 6\n", "a.pts")
    assert "semicolons between values, decimal ',', numbers from line 2 on" in caplog.text
    assert "columns without numbers are left out: Name" in caplog.text
    assert "no column is called x, y or z; taking a, b, c" in caplog.text
    assert "is it a point number?" in caplog.text
    assert "announces 1 points and holds 2" in caplog.text


@pytest.mark.parametrize("quiet", [False, True])
def test_the_command_line_says_what_was_assumed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], quiet: bool
) -> None:
    with display(quiet):
        read_text(tmp_path, "1,5;2,5;3,5;10;20;30\n")
    told = (
        "assumed semicolons between values, decimal ',', numbers from line 1 on, columns x y z red green blue"
    )
    assert (told in capsys.readouterr().err) != quiet


# --- damage ---


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("1 2\n3 4\n", "line 1 has 2 values; x, y and z are needed; choose one with all three"),
        ("# c\n\n7.5\n", "line 3 has 1 value; x, y and z are needed; choose one with all three"),
        ("1 2 3\n4 5\n", "line 2 has 2 values where 3 are expected"),
        ("1 2 3\n\n# c\n4 5 6 7\n", "line 4 has 4 values where 3 are expected"),
        ("1,2,3\n4,five,6\n", "line 2, column 2: 'five' is not a number"),
        ("1,2,3\n4,,6\n", "line 2, column 2: '' is not a number"),
        ("1,5;2,5;3,5\n4,5;5,5;six\n", "line 2, column 3: 'six' is not a number"),
        ("1 2 3\n4 5 0x6\n", "line 2, column 3: '0x6' is not a number"),
        ("1 2 3\n1_000 5 6\n", "line 2, column 1: '1_000' is not a number"),
        ("x,y,height_of_tree,h\n1,2,3,4\n", "has no z field"),
        ("x,y\n1,2,3\n", "line 1 names 2 columns but the numbers have 3"),
        ("ncols 4\nnrows 4\n1 2 3 4\n", "is an ESRI grid of heights"),
        ("rows\n4\nnrows 4\n1 2 3 4\n", "line 3 is not a line of numbers"),
        ("1a 2 3 4\n5 6 7 8\n9 10 11 12\n", "line 1, column 1 is not a number, but those below it are"),
        ("Dear Sir,\n", "has no line of numbers (line 1 begins 'Dear Sir,'); choose a point cloud"),
        ("# nothing but this\n", "contains no points"),
        ("\n \n", "contains no points"),
        ("5\n", "contains no points"),
        ("2\n1 2 3\n4 5 6\n3\n7 8 9\n", "is truncated: expected 5 points, file holds 3; copy it again"),
        ("5\n1 2 3\n4 5 6\n", "is truncated: expected 5 points, file holds 2; copy it again"),
        ("99999999999999999999\n1 2 3\n", "expected 99999999999999999999 points, file holds 1"),
    ],
)
def test_what_is_not_a_table_of_points(tmp_path: Path, text: str, words: str) -> None:
    assert words in message_of(tmp_path, text)


# --- writing ---


@pytest.mark.parametrize("name", ["a.xyz", "a.txt", "a.csv", "a.asc", "a.pts"])
def test_any_float_survives(tmp_path: Path, name: str) -> None:
    """The digits written are as few as possible and still mean the same number, down to the last bit."""
    rng = np.random.default_rng(0)
    bits = rng.integers(0, 2**64, 30_000, dtype=np.uint64)
    numbers = np.frombuffer(struct.pack(f"<{len(bits)}Q", *bits.tolist()), dtype="<f8").reshape(-1, 3)
    xyz = np.vstack([numbers, [[0.1, -0.0, 5e-324], [1.7976931348623157e308, 448122.431, 1e22]]])
    tmchho.io.write(PointCloud(xyz), tmp_path / name)
    back = tmchho.io.read(tmp_path / name).xyz
    np.testing.assert_array_equal(back, xyz)
    assert "448122.431" in (tmp_path / name).read_text()


def test_what_is_written_can_be_read_by_eye(tmp_path: Path) -> None:
    cloud = PointCloud(
        np.array(XYZ),
        {
            "intensity": np.array([40, 50]),
            **{name: np.array([0, 255], dtype=np.uint8) for name in ("blue", "green", "red")},
        },
    )
    plain = PointCloud(np.array(XYZ))
    expected = {
        "a.xyz": "//x y z intensity blue green red\n500000.123 4000000.456 101.789 40 0 0 0\n",
        "a.csv": "x,y,z,intensity,blue,green,red\n500000.123,4000000.456,101.789,40,0,0,0\n",
        "a.pts": "2\n500000.123 4000000.456 101.789 40 0 0 0\n",  # Leica's order, so no names
    }
    for name, start in expected.items():
        tmchho.io.write(cloud, tmp_path / name)
        assert (tmp_path / name).read_text().startswith(start)
        back = tmchho.io.read(tmp_path / name).attributes
        for key, values in cloud.attributes.items():
            assert back[key].tolist() == values.tolist()
    tmchho.io.write(plain, tmp_path / "b.pts")
    assert (tmp_path / "b.pts").read_text().startswith("2\n500000.123 4000000.456 101.789\n")


def test_more_points_than_one_block_of_lines(tmp_path: Path) -> None:
    xyz = np.random.default_rng(0).normal(5e5, 100, (100_001, 3)).round(3)
    tmchho.io.write(PointCloud(xyz, {"origin": np.arange(100_001) % 2 == 1}), tmp_path / "a.csv")
    back = tmchho.io.read(tmp_path / "a.csv")
    np.testing.assert_array_equal(back.xyz, xyz)
    np.testing.assert_array_equal(back.attributes["origin"], np.arange(100_001) % 2)
