"""PLY: spellings of the header, byte orders, damage; plyfile is the judge where it is installed."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import tmchho.io
from tmchho.cloud import PointCloud
from tmchho.errors import ReadError, WriteError

XYZ = np.array([[500_000.123, 4_000_000.456, 101.789], [1 / 3, -2 / 3, 1e-9], [7, 8, 9]])
TYPES = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"},
    **{"float": "f4", "double": "f8", "int8": "i1", "uint16": "u2", "float32": "f4", "float64": "f8"},
}


def ply_bytes(
    encoding: str,
    properties: list[tuple[str, str]],
    rows: list[tuple[Any, ...]],
    extra: str = "",
    tail: bytes = b"",
) -> bytes:
    """Build a file by hand."""
    lines = ["ply", f"format {encoding} 1.0", f"element vertex {len(rows)}"]
    lines += [f"property {kind} {name}" for kind, name in properties]
    header = "\n".join([*lines, *extra.split("\n"), "end_header\n"]).replace("\n\n", "\n").encode()
    if encoding == "ascii":
        return header + "".join(" ".join(map(str, row)) + "\n" for row in rows).encode() + tail
    order = "<" if "little" in encoding else ">"
    dtype = np.dtype([(f"p{i}", order + TYPES[kind]) for i, (kind, _) in enumerate(properties)])
    return header + np.array(rows, dtype=dtype).tobytes() + tail


def read_bytes(folder: Path, data: bytes) -> PointCloud:
    (folder / "a.ply").write_bytes(data)
    return tmchho.io.read(folder / "a.ply")


def message_of(folder: Path, data: bytes) -> str:
    with pytest.raises(ReadError) as caught:
        read_bytes(folder, data)
    assert "\n" not in str(caught.value)
    return str(caught.value)


DOUBLES = [("double", "x"), ("double", "y"), ("double", "z")]
ROWS = [tuple(row) for row in XYZ.tolist()]
ENCODINGS = ["ascii", "binary_little_endian", "binary_big_endian"]


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_doubles_to_the_last_bit(tmp_path: Path, encoding: str) -> None:
    np.testing.assert_array_equal(read_bytes(tmp_path, ply_bytes(encoding, DOUBLES, ROWS)).xyz, XYZ)


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_every_type_and_any_order_of_properties(tmp_path: Path, encoding: str) -> None:
    kinds = list(TYPES)
    properties = [(kind, f"a_{kind}") for kind in kinds]
    properties[3:3] = [("float", "z"), ("int", "y"), ("double", "x")]
    rows = [tuple(range(row, row + len(properties))) for row in (1, 40, 100)]
    cloud = read_bytes(tmp_path, ply_bytes(encoding, properties, rows))
    np.testing.assert_array_equal(cloud.xyz, [[row[5], row[4], row[3]] for row in rows])
    for kind in kinds:
        values = cloud.attributes[f"a_{kind}"]
        assert values.dtype == np.dtype(TYPES[kind])
        column = [name for _, name in properties].index(f"a_{kind}")
        assert values.tolist() == [row[column] for row in rows]


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_only_the_vertices_are_read(tmp_path: Path, encoding: str) -> None:
    extra = "element face 2\nproperty list uchar int vertex_indices\n"
    extra += "element range_grid 4\nproperty list uchar int vertex_indices"
    data = ply_bytes(encoding, DOUBLES, ROWS, extra, tail=b"3 0 1 2\n3 2 1 0\n1 0\n0\n1 1\n1 2\n")
    assert len(read_bytes(tmp_path, data)) == 3


def test_an_element_before_the_vertices_is_skipped(tmp_path: Path) -> None:
    header = b"ply\nformat %s 1.0\nelement camera 1\nproperty float f\nproperty uchar m\nelement vertex 1\n"
    header += b"property float x\nproperty float y\nproperty float z\nend_header\n"
    binary = header % b"binary_little_endian" + np.float32(50).tobytes() + b"\7"
    binary += np.array([1, 2, 3], dtype="<f4").tobytes()
    np.testing.assert_array_equal(read_bytes(tmp_path, binary).xyz, [[1, 2, 3]])
    np.testing.assert_array_equal(read_bytes(tmp_path, header % b"ascii" + b"50 7\n1 2 3\n").xyz, [[1, 2, 3]])


@pytest.mark.parametrize("line_end", [b"\n", b"\r\n", b"\r"])
@pytest.mark.parametrize("encoding", ENCODINGS)
def test_line_ends_of_the_header(tmp_path: Path, encoding: str, line_end: bytes) -> None:
    data = ply_bytes(encoding, DOUBLES, [(10, 13, 10), *ROWS])  # line ends among the numbers' bytes, too
    head, mark, body = data.partition(b"end_header\n")
    data = (head + mark).replace(b"\n", line_end) + body
    np.testing.assert_array_equal(read_bytes(tmp_path, data).xyz, [[10, 13, 10], *XYZ])


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_stray_lines_in_the_header(tmp_path: Path, encoding: str) -> None:
    stray = (
        "obj_info num_cols 512\nobj_info echo_rgb_offset_x 0.013000\nbye\n\ncomment end_header is not here"
    )
    cloud = read_bytes(tmp_path, ply_bytes(encoding, DOUBLES, ROWS, stray))
    np.testing.assert_array_equal(cloud.xyz, XYZ)
    assert "obj_info num_cols 512" in cloud.metadata["comments"]


def test_text_with_declared_floats_keeps_its_digits(tmp_path: Path) -> None:
    data = ply_bytes("ascii", [("float", axis) for axis in "xyz"], [(500_000.123, 4_000_000.456, 1.5)])
    np.testing.assert_array_equal(read_bytes(tmp_path, data).xyz, [[500_000.123, 4_000_000.456, 1.5]])


def test_names_become_those_of_las(tmp_path: Path) -> None:
    names = ["X", "Y", "Z", "scalar_Intensity", "GpsTime", "diffuse_red", "green", "Blue", "scalar_Roughness"]
    cloud = read_bytes(tmp_path, ply_bytes("ascii", [("float", name) for name in names], [tuple(range(9))]))
    assert list(cloud.attributes) == ["intensity", "gps_time", "red", "green", "blue", "scalar_Roughness"]


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_truncation_says_how_many_points_are_left(tmp_path: Path, encoding: str) -> None:
    data = ply_bytes(encoding, DOUBLES, [(1.0, 2.0, 3.0)] * 100)
    body_at = data.index(b"end_header\n") + 11
    row = (len(data) - body_at) // 100
    assert "expected 100 points, file holds 42" in message_of(tmp_path, data[: body_at + 42 * row])
    for n_bytes in (4, 20, body_at - 5):
        assert "no 'end_header' line" in message_of(tmp_path, data[:n_bytes])
    assert "holds 0" in message_of(tmp_path, data[:body_at])


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("count", ["999999999999", "9" * 40])
def test_hostile_counts_allocate_nothing(tmp_path: Path, encoding: str, count: str) -> None:
    data = ply_bytes(encoding, DOUBLES, ROWS).replace(b"element vertex 3", f"element vertex {count}".encode())
    assert f"expected {count} points, file holds 3" in message_of(tmp_path, data)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (b"ply\n", b"plx\n", "mark at its start is missing"),
        (b"format ascii", b"format morse", "unknown encoding 'morse'"),
        (b"format ascii 1.0\n", b"", "unknown encoding ''"),
        (b"property double y", b"property complex y", "line 5 of the header is not understood"),
        (b"element vertex 3", b"element vertex -3", "line 3 of the header is not understood"),
        (b"element vertex 3", b"element vertex 0", "contains no points"),
        (b"element vertex 3", b"element points 3", "no vertices, only the elements: points"),
        (b"property double y", b"property double i", "has no y field, only x i z"),
        (b"property double y", b"property list uchar int y", "lists of variable length"),
        (b"7.0 8.0 9.0", b"7.0 8.0 nine", "line 10, column 3: 'nine' is not a number"),
        (b"7.0 8.0 9.0", b"7.0 8.0", "line 10 has 2 values where 3 are expected"),
    ],
)
def test_broken_text_files(tmp_path: Path, old: bytes, new: bytes, words: str) -> None:
    data = ply_bytes("ascii", DOUBLES, ROWS)
    assert data.count(old) == 1
    assert words in message_of(tmp_path, data.replace(old, new))


@pytest.mark.parametrize("order", ["<", ">"])
def test_lists_before_the_vertices_are_skipped(tmp_path: Path, order: str) -> None:
    rng = np.random.default_rng(0)
    lengths = [3] * 25_000 + rng.integers(0, 6, 500).tolist() + [4] * 300
    faces = b"".join(
        struct.pack(f"{order}B{n}iH", n, *range(n), number % 100) for number, n in enumerate(lengths)
    )
    encoding = "binary_little_endian" if order == "<" else "binary_big_endian"
    header = (
        f"ply\nformat {encoding} 1.0\nelement face {len(lengths)}\nproperty list uchar int vertex_indices\n"
        f"property ushort material\nelement vertex 3\n"
        "property double x\nproperty double y\nproperty double z\nend_header\n"
    ).encode()
    cloud = read_bytes(tmp_path, header + faces + XYZ.astype(f"{order}f8").tobytes())
    np.testing.assert_array_equal(cloud.xyz, XYZ)
    for cut in (len(header), len(header) + 5, len(header) + len(faces) - 1):
        assert "truncated" in message_of(tmp_path, (header + faces)[:cut])
    assert "a list of" in message_of(tmp_path, header.replace(b"uchar", b"float") + b"\xff" * 40)
    assert "a list of" in message_of(tmp_path, header.replace(b"uchar int", b"int int") + b"\xff" * 40)


# --- writing ---


@pytest.mark.parametrize("byte_order", [None, "<", ">"], ids=["text", "little", "big"])
def test_written_attributes_and_types(tmp_path: Path, byte_order: str | None) -> None:
    attributes: dict[str, NDArray[Any]] = {
        kind: np.array([0, 1, 100], dtype=kind) for kind in ("u1", "i1", "u2", "i2", "u4", "i4", "f4", "f8")
    }
    cloud = PointCloud(XYZ, attributes, metadata={"format": "ply", "byte_order": byte_order})
    tmchho.io.write(cloud, tmp_path / "a.ply")
    back = tmchho.io.read(tmp_path / "a.ply")
    assert back.metadata["byte_order"] == byte_order
    np.testing.assert_array_equal(back.xyz, XYZ)
    plyfile = pytest.importorskip("plyfile")
    theirs = plyfile.PlyData.read(tmp_path / "a.ply")["vertex"]
    np.testing.assert_array_equal(theirs["y"], XYZ[:, 1])
    np.testing.assert_array_equal(theirs["f4"], attributes["f4"])
    for key, values in attributes.items():
        np.testing.assert_array_equal(back.attributes[key], values)
        assert back.attributes[key].dtype == values.dtype


def test_64_bit_integers_become_what_holds_them(tmp_path: Path) -> None:
    for values, kind in (([-5, 7, 9], "i4"), ([0, 1, 2**32 - 1], "u4"), ([0, 1, 2**52], "f8")):
        tmchho.io.write(PointCloud(XYZ, {"a": np.array(values)}), tmp_path / "a.ply", overwrite=True)
        back = tmchho.io.read(tmp_path / "a.ply").attributes["a"]
        assert back.tolist() == values
        assert back.dtype == kind
    with pytest.raises(WriteError, match="64-bit integers of attribute 'a'"):
        tmchho.io.write(PointCloud(XYZ, {"a": np.array([0, 1, 2**62 + 1])}), tmp_path / "b.ply")


@pytest.mark.parametrize(
    ("stored", "written"),
    [([0, 7, 255], [0, 7, 255]), ([0, 7 * 256, 65280], [0, 7, 255]), ([0, 7 * 257, 65535], [0, 7, 255])],
)
def test_16_bit_colours_become_8_bit_ones(tmp_path: Path, stored: list[int], written: list[int]) -> None:
    colour = np.array(stored, dtype=np.uint16)
    tmchho.io.write(PointCloud(XYZ, {"red": colour, "green": colour, "blue": colour}), tmp_path / "a.ply")
    back = tmchho.io.read(tmp_path / "a.ply").attributes
    assert back["red"].dtype == np.uint8
    assert back["red"].tolist() == back["green"].tolist() == back["blue"].tolist() == written


def test_colours_survive_the_way_through_las(tmp_path: Path) -> None:
    colour = np.array([0, 7, 255], dtype=np.uint8)
    cloud = PointCloud(XYZ, {"red": colour, "green": colour[::-1], "blue": colour})
    tmchho.io.write(cloud, tmp_path / "a.las")
    tmchho.io.write(tmchho.io.read(tmp_path / "a.las"), tmp_path / "a.ply")
    back = tmchho.io.read(tmp_path / "a.ply").attributes
    for key, values in cloud.attributes.items():
        np.testing.assert_array_equal(back[key], values)


def test_comments_are_kept(tmp_path: Path) -> None:
    cloud = read_bytes(tmp_path, ply_bytes("ascii", DOUBLES, ROWS, "comment by hand\nobj_info x 1"))
    tmchho.io.write(cloud, tmp_path / "b.ply")
    assert tmchho.io.read(tmp_path / "b.ply").metadata["comments"] == ("comment by hand", "obj_info x 1")


def test_vectors_and_blanks_in_names(tmp_path: Path) -> None:
    cloud = PointCloud(XYZ, {"C2C absolute distances": np.arange(3.0), "v": np.arange(6).reshape(3, 2)})
    tmchho.io.write(cloud, tmp_path / "a.ply")
    back = tmchho.io.read(tmp_path / "a.ply").attributes
    assert list(back) == ["C2C_absolute_distances", "v_0", "v_1"]
    assert back["v_1"].tolist() == [1, 3, 5]


def test_plyfile_reads_what_we_write_and_we_read_what_it_writes(tmp_path: Path) -> None:
    plyfile = pytest.importorskip("plyfile")
    cloud = PointCloud(XYZ, {"intensity": np.array([1, 2, 3], dtype=np.uint16)})
    tmchho.io.write(cloud, tmp_path / "a.ply")
    theirs = plyfile.PlyData.read(tmp_path / "a.ply")
    for index, axis in enumerate("xyz"):
        np.testing.assert_array_equal(theirs["vertex"][axis], XYZ[:, index])
    assert theirs["vertex"]["intensity"].tolist() == [1, 2, 3]
    for text, order in ((True, "="), (False, "<"), (False, ">")):
        theirs.text, theirs.byte_order = text, order
        theirs.write(tmp_path / "b.ply")
        back = tmchho.io.read(tmp_path / "b.ply")
        np.testing.assert_allclose(back.xyz, XYZ, rtol=1e-15)
        assert back.attributes["intensity"].tolist() == [1, 2, 3]
