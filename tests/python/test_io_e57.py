"""E57: poses, spherical coordinates, invalid points, several scans; pye57 is the judge of what is written."""

from __future__ import annotations

import logging
import struct
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mutations import with_checksums
from numpy.typing import NDArray

import tmchho.io
from tmchho.cloud import PointCloud
from tmchho.errors import ReadError, WriteError
from tmchho.io.scans import Scan, moved_scans
from tmchho.simulate import random_pose

pye57 = pytest.importorskip("pye57")
libe57 = pytest.importorskip("pye57.libe57")

XYZ = np.array([[1.5, -2.0, 0.25], [3.0, 4.0, 5.0], [0.0, 0.0, 9.0], [-7.5, 1 / 3, 2.0]])
TURN = np.array([np.cos(0.3), 0.0, 0.0, np.sin(0.3)])  # quaternion about the vertical
SHIFT = np.array([500_000.0, 4_000_000.0, 100.0])


def write_raw(path: Path, *scans: Mapping[str, Any]) -> None:
    """Write scans by pye57 itself: raw fields, and perhaps a pose."""
    with pye57.E57(str(path), mode="w") as file:
        for scan in scans:
            pose = {key: scan[key] for key in ("rotation", "translation") if key in scan}
            file.write_scan_raw({key: scan[key] for key in scan if key not in pose}, **pose)


def columns(xyz: NDArray[np.float64]) -> dict[str, NDArray[Any]]:
    return {f"cartesian{axis}": xyz[:, index].copy() for index, axis in enumerate("XYZ")}


def message_of(path: Path) -> str:
    with pytest.raises(ReadError) as caught:
        tmchho.io.read(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_poses_are_applied_and_scans_joined(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    second = {**columns(XYZ[:2]), "rotation": TURN, "translation": SHIFT}
    write_raw(tmp_path / "a.e57", columns(XYZ), second)
    with caplog.at_level(logging.INFO, logger="tmchho.io"):
        cloud = tmchho.io.read(tmp_path / "a.e57")
    x, y, z = XYZ[:2].T
    cos, sin = np.cos(0.6), np.sin(0.6)
    moved = np.column_stack([cos * x - sin * y, sin * x + cos * y, z]) + SHIFT
    np.testing.assert_allclose(cloud.xyz[:4], XYZ, atol=1e-6)  # pye57 writes float32
    np.testing.assert_allclose(cloud.xyz[4:], moved, atol=1e-6)
    assert cloud.attributes["scan_index"].tolist() == [0] * 4 + [1] * 2
    np.testing.assert_allclose(cloud.metadata["scans"][1].world_from_scan[:3, 3], SHIFT)
    assert "2 scans are joined" in caplog.text
    with pye57.E57(str(tmp_path / "a.e57")) as file:
        theirs = file.read_scan(1, ignore_missing_fields=True)
    expected = np.column_stack([theirs[f"cartesian{axis}"] for axis in "XYZ"])
    np.testing.assert_allclose(cloud.xyz[4:], expected, atol=1e-9)


def test_invalid_points_are_left_out_and_counted(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    state = np.array([0, 1, 0, 2], dtype=np.int8)
    fields = {**columns(XYZ), "cartesianInvalidState": state, "intensity": np.arange(4, dtype=np.float32)}
    write_raw(tmp_path / "a.e57", fields)
    with caplog.at_level(logging.INFO, logger="tmchho.io"):
        cloud = tmchho.io.read(tmp_path / "a.e57")
    np.testing.assert_allclose(cloud.xyz, XYZ[[0, 2]], atol=1e-6)
    assert cloud.attributes["intensity"].tolist() == [0, 2]
    assert "2 of 4 points of scan 1 are invalid and left out" in caplog.text
    described = {name: (double, values) for name, values in columns(XYZ).items()}
    missing = (lambda file: libe57.IntegerNode(file, 0, 0, 2), np.full(4, 2, dtype=np.int8))
    write_fields(tmp_path / "b.e57", {**described, "cartesianInvalidState": missing})
    assert "its 4 points are all invalid" in message_of(tmp_path / "b.e57")


def write_fields(path: Path, fields: Mapping[str, tuple[Any, NDArray[Any]]], **extra: str) -> None:
    """Write one scan of any fields: the node that describes each, made from the file, and its values."""
    file = libe57.ImageFile(str(path), "w")
    file.extensionsAdd("", libe57.E57_V1_0_URI)
    root = file.root()
    for name, text in {"formatName": "ASTM E57 3D Imaging Data File", "guid": "{a}", **extra}.items():
        root.set(name, libe57.StringNode(file, text))
    root.set("versionMajor", libe57.IntegerNode(file, 1))
    root.set("versionMinor", libe57.IntegerNode(file, 0))
    scans = libe57.VectorNode(file, True)
    root.set("data3D", scans)
    root.set("images2D", libe57.VectorNode(file, True))
    node, prototype = libe57.StructureNode(file), libe57.StructureNode(file)
    node.set("guid", libe57.StringNode(file, "{b}"))
    buffers = libe57.VectorSourceDestBuffer()
    n_points = 0
    for name, (describe, values) in fields.items():
        prototype.set(name, describe(file))
        buffers.append(libe57.SourceDestBuffer(file, name, values, len(values), True, True))
        n_points = len(values)
    points = libe57.CompressedVectorNode(file, prototype, libe57.VectorNode(file, True))
    node.set("points", points)
    scans.append(node)
    writer = points.writer(buffers)
    writer.write(n_points)
    writer.close()
    file.close()


def double(file: Any) -> Any:
    return libe57.FloatNode(file, 0.0, libe57.FloatPrecision.E57_DOUBLE)


def test_spherical_coordinates(tmp_path: Path) -> None:
    distance = np.linalg.norm(XYZ, axis=1)
    azimuth = np.arctan2(XYZ[:, 1], XYZ[:, 0])
    elevation = np.arcsin(XYZ[:, 2] / distance)
    fields = {"sphericalRange": distance, "sphericalAzimuth": azimuth, "sphericalElevation": elevation}
    write_fields(tmp_path / "a.e57", {name: (double, values) for name, values in fields.items()})
    cloud = tmchho.io.read(tmp_path / "a.e57")
    np.testing.assert_allclose(cloud.xyz, XYZ, atol=1e-12)
    assert not cloud.attributes


def test_scaled_integers_and_the_kinds_of_fields(tmp_path: Path) -> None:
    def scaled(file: Any) -> Any:
        return libe57.ScaledIntegerNode(file, 0, -(2**30), 2**30, 0.001, 7.0)

    def whole(lowest: int, highest: int) -> Any:
        return lambda file: libe57.IntegerNode(file, lowest, lowest, highest)

    rounded = np.round(XYZ, 3)
    fields: dict[str, tuple[Any, NDArray[Any]]] = {
        f"cartesian{axis}": (scaled, rounded[:, index].copy()) for index, axis in enumerate("XYZ")
    }
    fields |= {
        "intensity": (whole(0, 2**20), np.array([0, 5, 2**20, 9], dtype=np.longlong)),
        "colorRed": (whole(0, 255), np.array([0, 255, 7, 1], dtype=np.uint8)),
        "returnIndex": (whole(0, 3), np.array([0, 1, 2, 3], dtype=np.int8)),
        "returnCount": (whole(1, 4), np.array([4, 4, 4, 4], dtype=np.int8)),
        "rowIndex": (whole(0, 70_000), np.array([0, 70_000, 1, 2], dtype=np.longlong)),
    }
    wkt = 'PROJCS["somewhere"]'
    write_fields(tmp_path / "a.e57", fields, coordinateMetadata=wkt)
    cloud = tmchho.io.read(tmp_path / "a.e57")
    np.testing.assert_allclose(cloud.xyz, rounded, atol=1e-12)
    assert cloud.attributes["intensity"].tolist() == [0, 5, 2**20, 9]
    assert cloud.attributes["red"].dtype == np.uint8
    assert cloud.attributes["return_number"].tolist() == [1, 2, 3, 4]  # LAS counts from 1
    assert cloud.attributes["number_of_returns"].tolist() == [4] * 4
    fields["returnIndex"] = (whole(0, 4), np.array([1, 2, 3, 4], dtype=np.int8))
    write_fields(tmp_path / "b.e57", fields)  # against the standard, but found in the wild
    assert tmchho.io.read(tmp_path / "b.e57").attributes["return_number"].tolist() == [1, 2, 3, 4]
    assert cloud.attributes["row_index"].tolist() == [0, 70_000, 1, 2]
    assert cloud.crs == wkt


def test_a_missing_attribute_of_one_scan_is_zero(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    colours = {f"color{name}": np.full(4, 9, dtype=np.uint8) for name in ("Red", "Green", "Blue")}
    write_raw(tmp_path / "a.e57", columns(XYZ), {**columns(XYZ), **colours})
    with caplog.at_level(logging.INFO, logger="tmchho.io"):
        cloud = tmchho.io.read(tmp_path / "a.e57")
    assert cloud.attributes["red"].tolist() == [0] * 4 + [9] * 4
    assert cloud.attributes["red"].dtype == np.uint8
    assert "not all scans have red, green, blue; the others get 0" in caplog.text


# --- writing ---


def stations() -> dict[str, Any]:
    rng = np.random.default_rng(5)
    scans = []
    for name in ("north", "south"):
        pose = random_pose(rng, 50.0)
        pose[:3, 3] += SHIFT
        scans.append(Scan(name, pose))
    return {"scans": tuple(scans)}


def test_every_attribute_of_every_point_comes_back(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    n_points = 1000
    attributes: dict[str, NDArray[Any]] = {
        kind: rng.integers(0, 100, n_points).astype(kind)
        for kind in ("u1", "i1", "u2", "i2", "u4", "i4", "u8", "i8", "f4", "f8")
    }
    attributes |= {
        name: rng.integers(0, 65536, n_points).astype(np.uint16) for name in ("red", "green", "blue")
    }
    attributes |= {"i8": rng.integers(-(2**62), 2**62, n_points), "u8": attributes["u8"] + np.uint64(2**40)}
    attributes |= {
        "intensity": rng.random(n_points).astype(np.float32),
        "gps_time": rng.random(n_points) * 1e9,
    }
    attributes |= {name: rng.random(n_points).astype(np.float32) for name in ("nx", "ny", "nz")}
    attributes |= {
        "return_number": rng.integers(1, 6, n_points).astype(np.uint8),
        "same": np.full(n_points, 7),
    }
    attributes["scan_index"] = np.sort(rng.integers(0, 2, n_points)).astype(np.uint16)
    cloud = PointCloud(SHIFT + rng.normal(0, 30, (n_points, 3)), attributes, 'PROJCS["x"]', stations())
    tmchho.io.write(cloud, tmp_path / "a.e57")
    back = tmchho.io.read(tmp_path / "a.e57")
    np.testing.assert_allclose(back.xyz, cloud.xyz, atol=2e-9, rtol=0)  # two roundings at 4 000 000 m
    assert sorted(back.attributes) == sorted(attributes)
    for name, values in attributes.items():
        np.testing.assert_array_equal(back.attributes[name], values, err_msg=name)
    assert back.crs == cloud.crs
    for mine, theirs in zip(cloud.metadata["scans"], back.metadata["scans"], strict=True):
        assert mine.name == theirs.name
        np.testing.assert_allclose(mine.world_from_scan, theirs.world_from_scan, atol=1e-9)


def test_without_stations_the_coordinates_come_back_bit_by_bit(tmp_path: Path) -> None:
    xyz = SHIFT + np.random.default_rng(1).normal(0, 30, (500, 3))
    tmchho.io.write(PointCloud(xyz), tmp_path / "a.e57")
    np.testing.assert_array_equal(tmchho.io.read(tmp_path / "a.e57").xyz, xyz)


def test_pye57_reads_what_is_written(tmp_path: Path) -> None:
    attributes = {name: np.array([1, 2, 255, 0], dtype=np.uint8) for name in ("red", "green", "blue")}
    attributes["intensity"] = np.array([0, 0.5, 1, 0.25])
    attributes["scan_index"] = np.array([0, 1, 1, 0])
    cloud = PointCloud(XYZ + SHIFT, attributes, metadata=stations())
    tmchho.io.write(cloud, tmp_path / "a.e57")
    with pye57.E57(str(tmp_path / "a.e57")) as file:
        assert file.scan_count == 2
        for number, rows in ((0, [0, 3]), (1, [1, 2])):
            header = file.get_header(number)
            pose = cloud.metadata["scans"][number].world_from_scan
            np.testing.assert_allclose(header.rotation_matrix, pose[:3, :3], atol=1e-12)
            np.testing.assert_allclose(header.translation, pose[:3, 3])
            data = file.read_scan(number, intensity=True, colors=True, ignore_missing_fields=True)
            found = np.column_stack([data[f"cartesian{axis}"] for axis in "XYZ"])
            np.testing.assert_allclose(found, cloud.xyz[rows], atol=2e-9, rtol=0)
            np.testing.assert_array_equal(data["intensity"], attributes["intensity"][rows])
            np.testing.assert_array_equal(data["colorGreen"], attributes["green"][rows])


def test_stations_move_with_their_points(tmp_path: Path) -> None:
    before = PointCloud(XYZ + SHIFT, metadata=stations())
    motion = random_pose(np.random.default_rng(2), 10.0)
    after = PointCloud(
        before.xyz @ motion[:3, :3].T + motion[:3, 3], metadata=moved_scans(before.metadata, motion)
    )
    local = before.metadata["scans"][0].from_world(before.xyz)
    np.testing.assert_allclose(after.metadata["scans"][0].from_world(after.xyz), local, atol=1e-8)
    doubled = moved_scans(before.metadata, np.diag([2.0, 2.0, 2.0, 1.0]))["scans"][0].world_from_scan
    np.testing.assert_allclose(doubled[:3, :3] @ doubled[:3, :3].T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(doubled[:3, 3], 2 * before.metadata["scans"][0].world_from_scan[:3, 3])
    assert moved_scans({"format": "las"}, motion) == {"format": "las"}


def test_what_e57_cannot_hold(tmp_path: Path) -> None:
    for attributes, words in (
        ({"big": np.full(4, 2**63, dtype=np.uint64)}, "large integers of attribute 'big'"),
        ({"a?": np.arange(4), "a!": np.arange(4)}, "would both be called 'tmchho:a_'"),
    ):
        with pytest.raises(WriteError, match=words):
            tmchho.io.write(PointCloud(XYZ, attributes), tmp_path / "a.e57")
    assert list(tmp_path.iterdir()) == []


# --- damage ---


@pytest.fixture
def valid(tmp_path: Path) -> bytes:
    xyz = np.random.default_rng(0).normal(0, 1, (300, 3))
    tmchho.io.write(PointCloud(xyz, {"intensity": np.arange(300)}), tmp_path / "valid.e57")
    return (tmp_path / "valid.e57").read_bytes()


@pytest.mark.skipif(sys.platform == "win32", reason="no limit of file sizes there")
def test_a_full_disk_ends_in_a_sentence(tmp_path: Path) -> None:
    """In a program of its own, because the library ends the program if it is not handled with care."""
    lines = [
        "import gc, resource, sys, numpy, tmchho",
        "resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, 50_000))",
        "cloud = tmchho.PointCloud(numpy.random.default_rng(0).normal(0, 1, (20_000, 3)))",
        "try:",
        "    tmchho.write(cloud, sys.argv[1])",
        "except tmchho.errors.WriteError as error:",
        "    print(error)",
        "gc.collect()",
    ]
    command = [sys.executable, "-c", "\n".join(lines), str(tmp_path / "a.e57")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    assert "check the disk" in done.stdout
    assert list(tmp_path.iterdir()) == []


def test_truncated_and_damaged_files(tmp_path: Path, valid: bytes) -> None:
    path = tmp_path / "a.e57"
    for share in (0.01, 0.3, 0.9):
        path.write_bytes(valid[: int(len(valid) * share)])
        assert "is truncated" in message_of(path)
        assert path.exists()  # pye57's own class would have deleted it
    changed = bytearray(valid)
    changed[2000] ^= 1
    path.write_bytes(changed)
    assert "the checksum of one of its pages is wrong" in message_of(path)
    path.write_bytes(with_checksums(valid[:8] + struct.pack("<I", 2) + valid[12:]))
    assert "unknown E57 version 2.0" in message_of(path)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (b'recordCount="300"', b'recordCount="9999999999"', "expected 9999999999 points of"),
        (b'recordCount="300"', b'recordCount="301"', "file holds 300"),
        (b"cartesianX", b"cartesianU", "has no coordinates in scan 1, only cartesianU"),
        (b"<?xml", b"<!DOCTYPE a [<!ENTITY b 'c'>]><?xml", "defines entities"),
    ],
)
def test_hostile_descriptions(tmp_path: Path, valid: bytes, old: bytes, new: bytes, words: str) -> None:
    content = b"".join(valid[start : start + 1020] for start in range(0, len(valid), 1024))
    xml_at, n_xml = struct.unpack_from("<QQ", valid, 24)
    start = xml_at // 1024 * 1020 + xml_at % 1024
    xml = content[start : start + n_xml]
    assert old in xml
    changed = content[:start] + xml.replace(old, new)
    changed += b"\0" * (-len(changed) % 1020)
    pages = bytearray(b"".join(changed[at : at + 1020] + b"\0" * 4 for at in range(0, len(changed), 1020)))
    struct.pack_into("<QQQ", pages, 16, len(pages), xml_at, len(xml.replace(old, new)))
    (tmp_path / "a.e57").write_bytes(with_checksums(bytes(pages)))
    assert words in message_of(tmp_path / "a.e57")


def test_points_that_take_no_room_in_the_file(tmp_path: Path) -> None:
    """Values that are all the same are not stored, so that any number of points fits into a few bytes."""

    def same(file: Any) -> Any:
        return libe57.IntegerNode(file, 7, 7, 7)

    names = [*(f"cartesian{axis}" for axis in "XYZ"), "intensity"]
    write_fields(tmp_path / "a.e57", {name: (same, np.full(200_000, 7, np.int16)) for name in names})
    assert (tmp_path / "a.e57").stat().st_size < 20_000
    assert "expected 200000 points of 1 bits in scan 1" in message_of(tmp_path / "a.e57")


def test_the_missing_library_is_named(tmp_path: Path, valid: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pye57.libe57", None)
    assert "pip install 'tmchho[e57]'" in message_of(tmp_path / "valid.e57")
    with pytest.raises(WriteError, match="package pye57 is needed"):
        tmchho.io.write(PointCloud(XYZ), tmp_path / "b.e57")
