"""PCD: encodings, packed colours, damage; pypcd4 is the judge where it is installed."""

from __future__ import annotations

import struct
import tracemalloc
from pathlib import Path
from typing import Any

import lzf
import numpy as np
import pytest
from numpy.typing import NDArray

import tmchho.io
from tmchho.cloud import PointCloud
from tmchho.errors import ReadError

XYZ = np.array([[500_000.123, 4_000_000.456, 101.789], [1 / 3, -2 / 3, 1e-9], [7, 8, 9]])
ENCODINGS = ["ascii", "binary", "binary_compressed"]


def pcd_bytes(encoding: str, columns: dict[str, NDArray[Any]], **replaced: str) -> bytes:
    """Build a file by hand; `replaced` overrides header entries, an empty string leaves one out."""
    n_points = len(next(iter(columns.values())))
    flat = {name: values.reshape(n_points, -1) for name, values in columns.items()}
    header = {
        "VERSION": "0.7",
        "FIELDS": " ".join(flat),
        "SIZE": " ".join(str(values.dtype.itemsize) for values in flat.values()),
        "TYPE": " ".join(values.dtype.kind.upper() for values in flat.values()),
        "COUNT": " ".join(str(values.shape[1]) for values in flat.values()),
        "WIDTH": str(n_points),
        "HEIGHT": "1",
        "VIEWPOINT": "0 0 0 1 0 0 0",
        "POINTS": str(n_points),
        "DATA": encoding,
        **replaced,
    }
    text = "# .PCD v0.7\n" + "".join(f"{key} {value}\n" for key, value in header.items() if value)
    if encoding == "ascii":
        rows = zip(*(values.tolist() for values in flat.values()), strict=True)
        body = "".join(" ".join(str(x) for part in row for x in part) + "\n" for row in rows).encode()
    elif encoding == "binary":
        rows_of_bytes = np.hstack([np.ascontiguousarray(values).view("u1") for values in flat.values()])
        body = rows_of_bytes.tobytes()
    else:
        plain = b"".join(np.ascontiguousarray(values).tobytes() for values in flat.values())
        packed = lzf.compress(plain, 2 * len(plain) + 100)
        body = struct.pack("<II", len(packed), len(plain)) + packed
    return text.encode() + body


def read_bytes(folder: Path, data: bytes) -> PointCloud:
    (folder / "a.pcd").write_bytes(data)
    return tmchho.io.read(folder / "a.pcd")


def message_of(folder: Path, data: bytes) -> str:
    with pytest.raises(ReadError) as caught:
        read_bytes(folder, data)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def axes(xyz: NDArray[Any] = XYZ) -> dict[str, NDArray[Any]]:
    return {axis: xyz[:, index].copy() for index, axis in enumerate("xyz")}


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_doubles_to_the_last_bit(tmp_path: Path, encoding: str) -> None:
    np.testing.assert_array_equal(read_bytes(tmp_path, pcd_bytes(encoding, axes())).xyz, XYZ)


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_every_type_counts_and_padding(tmp_path: Path, encoding: str) -> None:
    kinds = ("u1", "i1", "u2", "i2", "u4", "i4", "f4", "f8")
    columns: dict[str, NDArray[Any]] = {"_": np.zeros((3, 2), dtype="u1"), **axes()}
    columns |= {f"a_{kind}": np.array([0, 1, 100], dtype=kind) for kind in kinds}
    columns["histogram"] = np.arange(12, dtype="f4").reshape(3, 4)
    cloud = read_bytes(tmp_path, pcd_bytes(encoding, columns))
    np.testing.assert_array_equal(cloud.xyz, XYZ)
    assert sorted(cloud.attributes) == sorted([*(f"a_{kind}" for kind in kinds), "histogram"])
    for name, values in cloud.attributes.items():
        np.testing.assert_array_equal(values, columns[name])
        assert values.dtype == columns[name].dtype


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("name", ["rgb", "rgba"])
def test_packed_colours_are_unpacked(tmp_path: Path, encoding: str, name: str) -> None:
    packed = np.array([0x7F_01_80_FF, 0x00_FF_00_10, 0], dtype="<u4")
    cloud = read_bytes(tmp_path, pcd_bytes(encoding, {**axes(), name: packed}))
    assert cloud.attributes["red"].tolist() == [0x01, 0xFF, 0]
    assert cloud.attributes["green"].tolist() == [0x80, 0x00, 0]
    assert cloud.attributes["blue"].tolist() == [0xFF, 0x10, 0]
    assert ("alpha" in cloud.attributes) == (name == "rgba")
    if name == "rgba":
        assert cloud.attributes["alpha"].tolist() == [0x7F, 0, 0]


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_colours_packed_into_a_float(tmp_path: Path, encoding: str) -> None:
    packed = np.array([0x01_80_FF, 0xFF_00_10, 0], dtype="<u4").view("<f4")
    cloud = read_bytes(tmp_path, pcd_bytes(encoding, {**axes(), "rgb": packed}))
    assert cloud.attributes["red"].tolist() == [0x01, 0xFF, 0]
    assert cloud.attributes["blue"].tolist() == [0xFF, 0x10, 0]


def test_old_headers_commas_and_return_characters(tmp_path: Path) -> None:
    data = pcd_bytes("ascii", axes(), VERSION=".5", VIEWPOINT="", COUNT="", POINTS="")
    np.testing.assert_array_equal(read_bytes(tmp_path, data).xyz, XYZ)
    head, mark, body = pcd_bytes("ascii", axes()).partition(b"DATA ascii\n")
    np.testing.assert_array_equal(read_bytes(tmp_path, head + mark + body.replace(b" ", b",")).xyz, XYZ)
    np.testing.assert_array_equal(read_bytes(tmp_path, head + mark + body.replace(b" ", b" \t")).xyz, XYZ)
    crlf = (head + mark + body).replace(b"\n", b"\r\n")
    np.testing.assert_array_equal(read_bytes(tmp_path, crlf).xyz, XYZ)


def test_text_with_declared_floats_keeps_its_digits(tmp_path: Path) -> None:
    data = pcd_bytes("ascii", axes(), SIZE="4 4 4")
    np.testing.assert_array_equal(read_bytes(tmp_path, data).xyz, XYZ)


def test_organised_clouds_keep_their_nan(tmp_path: Path) -> None:
    xyz = np.array([[1, 2, 3], [np.nan] * 3, [4, 5, 6], [np.nan] * 3])
    cloud = read_bytes(tmp_path, pcd_bytes("ascii", axes(xyz), WIDTH="2", HEIGHT="2"))
    np.testing.assert_array_equal(cloud.xyz, xyz)
    tmchho.io.write(cloud, tmp_path / "b.pcd")
    assert b"WIDTH 2\nHEIGHT 2\n" in (tmp_path / "b.pcd").read_bytes()


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_truncation(tmp_path: Path, encoding: str) -> None:
    xyz = np.random.default_rng(0).normal(size=(100, 3)).round(3)
    data = pcd_bytes(encoding, axes(xyz))
    body_at = data.index(b"DATA") + len(f"DATA {encoding}\n")
    assert "the mark at its start is missing" in message_of(tmp_path, data[:5])
    for n_bytes in (30, body_at - len(encoding) - 4):
        assert "no DATA line" in message_of(tmp_path, data[:n_bytes])
    assert "expected 100 points, file holds 0" in message_of(tmp_path, data[:body_at])
    if encoding == "ascii":
        left = b"\n".join(data[body_at:].split(b"\n")[:42])
        assert "expected 100 points, file holds 42" in message_of(tmp_path, data[:body_at] + left)
    elif encoding == "binary":
        assert "expected 100 points, file holds 42" in message_of(tmp_path, data[: body_at + 42 * 24 + 5])
    else:
        assert "is truncated: expected 100 points" in message_of(tmp_path, data[:-1])


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_hostile_counts_allocate_nothing(tmp_path: Path, encoding: str) -> None:
    data = pcd_bytes(encoding, axes(), WIDTH="999999999999", POINTS="999999999999")
    assert "expected 999999999999 points, file holds 3" in message_of(tmp_path, data)


def test_hostile_compressed_sizes(tmp_path: Path) -> None:
    data = bytearray(pcd_bytes("binary_compressed", axes()))
    at = data.index(b"compressed\n") + 11
    changed = bytearray(data)
    struct.pack_into("<I", changed, at, 2**32 - 1)
    assert "in 4294967295 compressed bytes, file holds" in message_of(tmp_path, bytes(changed))
    changed = bytearray(data)
    struct.pack_into("<I", changed, at + 4, 2**32 - 1)
    assert "contradicts itself" in message_of(tmp_path, bytes(changed))
    many = pcd_bytes("binary_compressed", axes(), WIDTH="100000000", POINTS="100000000").replace(
        data[at + 4 : at + 8], struct.pack("<I", 2_400_000_000)
    )
    assert "which cannot be" in message_of(tmp_path, many)
    changed = bytearray(data)
    changed[at + 8] = 0xFF  # a reference to bytes before the first
    assert "damaged" in message_of(tmp_path, bytes(changed))


@pytest.mark.parametrize(
    ("replaced", "words"),
    [
        ({"POINTS": "7"}, "3 × 1 points but POINTS 7"),
        ({"POINTS": "-3"}, "broken header: POINTS -3"),
        ({"WIDTH": "three"}, "broken header: WIDTH three"),
        ({"SIZE": "8 8"}, "3 FIELDS, 2 SIZE"),
        ({"TYPE": "F F Q"}, "unknown type Q 8"),
        ({"SIZE": "8 8 3"}, "unknown type F 3"),
        ({"COUNT": "1 1 0"}, "unknown type F 8 × 0"),
        ({"FIELDS": "x y intensity"}, "has no z field, only x y intensity"),
        ({"FIELDS": ""}, "broken header: 0 FIELDS"),
        ({"DATA": "morse"}, "unknown encoding 'morse'"),
        ({"WIDTH": "0", "POINTS": "0"}, "contains no points"),
    ],
)
def test_broken_headers(tmp_path: Path, replaced: dict[str, str], words: str) -> None:
    assert words in message_of(tmp_path, pcd_bytes("binary", axes(), **replaced))


def test_wrong_lines_are_numbered(tmp_path: Path) -> None:
    data = pcd_bytes("ascii", axes()).replace(b"7.0 8.0 9.0", b"7.0 eight 9.0")
    assert "line 14, column 2: 'eight' is not a number" in message_of(tmp_path, data)
    data = pcd_bytes("ascii", axes()).replace(b"7.0 8.0 9.0", b"7.0 8.0")
    assert "line 14 has 2 values where 3 are expected" in message_of(tmp_path, data)


def test_any_number_of_values_a_point_may_be_promised(tmp_path: Path) -> None:
    for encoding, count, words in (
        ("ascii", 200_000_000, "line 12 has fewer than the 200000002 values expected"),
        ("binary", 200_000_000, "expected 3 points, file holds 0"),
        ("binary_compressed", 200_000_000, "expected 3 points, file holds 0"),
        *((encoding, 300_000_000, "promises 2400000016 bytes for each point") for encoding in ENCODINGS),
    ):
        data = pcd_bytes(encoding, axes(), COUNT=f"{count} 1 1")
        tracemalloc.start()
        try:
            message = message_of(tmp_path, data)
            _, peak = tracemalloc.get_traced_memory()
        finally:
            tracemalloc.stop()
        assert words in message
        assert peak < 10e6


# --- writing ---


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_written_attributes_types_and_viewpoint(tmp_path: Path, encoding: str) -> None:
    attributes: dict[str, NDArray[Any]] = {
        kind: np.array([0, 1, 100], dtype=kind)
        for kind in ("u1", "i1", "u2", "i2", "u4", "i4", "u8", "i8", "f4", "f8")
    }
    attributes["histogram"] = np.arange(12.0).reshape(3, 4)
    attributes["nx"] = np.array([0.0, 1.0, 0.0])
    attributes |= {name: np.array([0, 7, 255], dtype="u1") for name in ("red", "green", "blue", "alpha")}
    metadata = {
        "format": "pcd",
        "viewpoint": (1.0, 2.0, 3.0, 1.0, 0.0, 0.0, 0.0),
        "encoding": encoding,
    }
    tmchho.io.write(PointCloud(XYZ, attributes, metadata=metadata), tmp_path / "a.pcd")
    back = tmchho.io.read(tmp_path / "a.pcd")
    np.testing.assert_array_equal(back.xyz, XYZ)
    assert sorted(back.attributes) == sorted(attributes)
    for key, values in attributes.items():
        np.testing.assert_array_equal(back.attributes[key], values)
        assert back.attributes[key].dtype == values.dtype
    assert back.metadata["viewpoint"] == metadata["viewpoint"]
    assert back.metadata["encoding"] == encoding
    head = (tmp_path / "a.pcd").read_bytes().split(b"DATA")[0].decode()
    assert " rgba" in head  # PCL's names
    assert " normal_x" in head


def test_large_whole_numbers_are_not_written_as_text(tmp_path: Path) -> None:
    values = np.array([0, -1, 2**62 + 1])
    metadata = {"format": "pcd", "encoding": "ascii"}
    tmchho.io.write(PointCloud(XYZ, {"a": values}, metadata=metadata), tmp_path / "a.pcd")
    back = tmchho.io.read(tmp_path / "a.pcd")
    assert back.metadata["encoding"] == "binary"
    np.testing.assert_array_equal(back.attributes["a"], values)


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_pypcd4_reads_every_encoding(tmp_path: Path, encoding: str) -> None:
    pypcd4 = pytest.importorskip("pypcd4")
    rng = np.random.default_rng(0)  # noise, which does not compress
    xyz, values = rng.random((400, 3)), rng.random(400).astype(np.float32)
    metadata = {"format": "pcd", "encoding": encoding}
    tmchho.io.write(PointCloud(xyz, {"curvature": values}, metadata=metadata), tmp_path / "a.pcd")
    theirs = pypcd4.PointCloud.from_path(tmp_path / "a.pcd")
    assert theirs.metadata.data == encoding
    for index, axis in enumerate("xyz"):
        np.testing.assert_array_equal(theirs.pc_data[axis], xyz[:, index])
    np.testing.assert_array_equal(theirs.pc_data["curvature"], values)


def test_pypcd4_reads_what_we_write_and_we_read_what_it_writes(tmp_path: Path) -> None:
    pypcd4 = pytest.importorskip("pypcd4")
    cloud = PointCloud(XYZ, {"intensity": np.array([1, 2, 3], dtype=np.uint16)})
    tmchho.io.write(cloud, tmp_path / "a.pcd")
    theirs = pypcd4.PointCloud.from_path(tmp_path / "a.pcd")
    for index, axis in enumerate("xyz"):
        np.testing.assert_array_equal(theirs.pc_data[axis], XYZ[:, index])
    for encoding in (pypcd4.Encoding.BINARY, pypcd4.Encoding.BINARY_COMPRESSED):
        theirs.save(tmp_path / "b.pcd", encoding)
        back = tmchho.io.read(tmp_path / "b.pcd")
        np.testing.assert_array_equal(back.xyz, XYZ)
        assert back.attributes["intensity"].tolist() == [1, 2, 3]
