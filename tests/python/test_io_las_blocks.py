"""LAS as others write it: the oldest versions, descriptions of extra bytes in several records."""

from __future__ import annotations

import struct
from pathlib import Path

import laspy
import numpy as np
import pytest

import tmchho.io

N_POINTS = 50


@pytest.mark.parametrize("minor", [0, 1])
@pytest.mark.parametrize("point_format", [0, 1])
def test_the_oldest_versions_keep_every_attribute(tmp_path: Path, minor: int, point_format: int) -> None:
    rng = np.random.default_rng(0)
    las = laspy.LasData(laspy.LasHeader(version="1.1", point_format=point_format))
    las.X, las.Y, las.Z = rng.integers(-1000, 1000, (3, N_POINTS))
    las.intensity = rng.integers(0, 65536, N_POINTS)
    las.classification = rng.integers(0, 32, N_POINTS)
    if point_format == 1:
        las.gps_time = rng.normal(0, 1e5, N_POINTS)
    las.write(tmp_path / "a.las")
    data = bytearray((tmp_path / "a.las").read_bytes())
    data[25] = minor
    if minor == 0:  # which puts two bytes in front of the points
        points_at = struct.unpack_from("<I", data, 96)[0]
        data[points_at:points_at] = b"\xdd\xcc"
        struct.pack_into("<I", data, 96, points_at + 2)
    (tmp_path / "b.las").write_bytes(data)

    cloud = tmchho.io.read(tmp_path / "b.las")
    assert cloud.metadata["header"].version == (1, minor)
    np.testing.assert_array_equal(cloud.xyz, np.column_stack([las.x, las.y, las.z]))
    tmchho.io.write(cloud, tmp_path / "c.laz")
    back = laspy.read(tmp_path / "c.laz")
    assert str(back.header.version) == "1.1"  # the oldest that is written
    for name in ("X", "Y", "Z", "intensity", "classification", *(("gps_time",) if point_format else ())):
        np.testing.assert_array_equal(np.array(back[name]), np.array(las[name]), err_msg=name)


def test_extra_bytes_described_in_several_records(tmp_path: Path) -> None:
    header = laspy.LasHeader(version="1.4", point_format=6)
    for name, kind in (("deviation", "u2"), ("confidence", "u1"), ("height", "f8")):
        header.add_extra_dim(laspy.ExtraBytesParams(name, kind))
    las = laspy.LasData(header)
    las.X = las.Y = las.Z = np.arange(N_POINTS)
    las["deviation"], las["confidence"] = np.arange(N_POINTS) * 7, np.arange(N_POINTS) % 5
    las["height"] = np.arange(N_POINTS) / 3
    las.write(tmp_path / "a.las")

    # The one record of three descriptions becomes one of two and one of one.
    data = bytearray((tmp_path / "a.las").read_bytes())
    record_at = data.index(b"LASF_Spec\0") - 2
    head, body_at = bytearray(data[record_at : record_at + 54]), record_at + 54
    assert struct.unpack_from("<H", head, 20) == (3 * 192,)
    struct.pack_into("<H", data, record_at + 20, 2 * 192)
    struct.pack_into("<H", head, 20, 192)
    data[body_at + 2 * 192 : body_at + 2 * 192] = head
    points_at, n_records = struct.unpack_from("<II", data, 96)
    struct.pack_into("<II", data, 96, points_at + 54, n_records + 1)
    (tmp_path / "b.las").write_bytes(data)

    cloud = tmchho.io.read(tmp_path / "b.las")
    tmchho.io.write(cloud, tmp_path / "c.las")
    for name in ("deviation", "confidence", "height"):
        np.testing.assert_array_equal(cloud.attributes[name], np.array(las[name]))
        np.testing.assert_array_equal(np.array(laspy.read(tmp_path / "c.las")[name]), np.array(las[name]))
