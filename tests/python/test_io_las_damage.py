"""Damaged, truncated and hostile LAS and LAZ files: one sentence, never a crash, never garbage."""

from __future__ import annotations

import logging
import random
import struct
from pathlib import Path

import laspy
import numpy as np
import pytest

import tmchho.io
from tmchho.cloud import PointCloud
from tmchho.errors import ReadError

N_POINTS = 60_000  # two LAZ chunks


def sample(folder: Path, suffix: str, point_format: int = 3, n_points: int = N_POINTS) -> bytes:
    """Write a walk through a national grid by laspy and return the file's bytes."""
    rng = np.random.default_rng(0)
    header = laspy.LasHeader(version="1.4" if point_format > 5 else "1.2", point_format=point_format)
    header.scales, header.offsets = [0.001] * 3, [500_000, 4_000_000, 0]
    las = laspy.LasData(header)
    las.X, las.Y, las.Z = np.cumsum(rng.integers(-50, 50, (3, n_points)), axis=1)
    las.gps_time = np.arange(n_points) * 1e-5
    path = folder / f"sample{suffix}"
    las.write(path)
    return path.read_bytes()


def refusal(folder: Path, data: bytes, suffix: str) -> str:
    path = folder / f"damaged{suffix}"
    path.write_bytes(data)
    with pytest.raises(ReadError) as caught:
        tmchho.io.read(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: ")
    assert "\n" not in message
    return message


def cloud_or_refusal(path: Path) -> PointCloud | None:
    """Return the cloud, or None if it is refused in one line; any other error fails the test."""
    try:
        return tmchho.io.read(path)
    except ReadError as error:
        if "\n" in str(error):
            raise
        return None


@pytest.mark.parametrize("share", [0.001, 0.1, 0.5, 0.9, 0.999])
def test_truncated_las_says_how_many_points_are_left(tmp_path: Path, share: float) -> None:
    data = sample(tmp_path, ".las")
    kept = data[: int(len(data) * share)]
    n_left = (len(kept) - 227) // 34
    assert f"expected {N_POINTS} points, file holds {n_left}" in refusal(tmp_path, kept, ".las")


@pytest.mark.parametrize("n_bytes", [4, 100, 226])
def test_a_cut_header_is_named(tmp_path: Path, n_bytes: int) -> None:
    data = sample(tmp_path, ".las")
    assert "too few for a LAS header" in refusal(tmp_path, data[:n_bytes], ".las")


@pytest.mark.parametrize("point_format", [3, 7])
def test_truncated_laz_is_refused_wherever_it_is_cut(tmp_path: Path, point_format: int) -> None:
    data = sample(tmp_path, ".laz", point_format)
    for share in (0.01, 0.1, 0.5, 0.9, 0.99, 0.9999):
        message = refusal(tmp_path, data[: int(len(data) * share)], ".laz")
        assert "truncated" in message or "damaged" in message
        if share > 0.02:
            assert f"expected {N_POINTS} points" in message
    refusal(tmp_path, data[:-1], ".laz")


@pytest.mark.parametrize("point_format", [3, 7])
def test_bytes_changed_in_laz_never_escape_as_another_error(tmp_path: Path, point_format: int) -> None:
    """Either the file is refused, or the points are finite numbers inside bounds that could be true."""
    data = sample(tmp_path, ".laz", point_format)
    header = laspy.read(tmp_path / "sample.laz").header
    lowest, highest = np.array(header.mins), np.array(header.maxs)
    diagonal = np.linalg.norm(highest - lowest)
    choose = random.Random(1)
    n_refused = 0
    for _ in range(40):
        changed = bytearray(data)
        at = choose.randrange(header.offset_to_point_data + 8, len(data) - 20)
        changed[at : at + 20] = choose.randbytes(20)
        path = tmp_path / "changed.laz"
        path.write_bytes(changed)
        cloud = cloud_or_refusal(path)
        if cloud is None:
            n_refused += 1
        else:
            assert len(cloud) == N_POINTS
            assert (cloud.xyz >= lowest - diagonal).all()
            assert (cloud.xyz <= highest + diagonal).all()
    assert n_refused > 10


def test_any_byte_of_the_header_may_be_wrong(tmp_path: Path) -> None:
    """Whatever the header says, the answer is a cloud or a sentence, at once and in little memory."""
    choose = random.Random(2)
    for suffix in (".las", ".laz"):
        data = sample(tmp_path, suffix, 7, n_points=500)
        n_header = 375 if suffix == ".las" else 375 + 54 + 46
        for at in range(4, n_header):
            changed = bytearray(data)
            changed[at] = choose.choice([0, 1, 127, 255])
            path = tmp_path / f"changed{suffix}"
            path.write_bytes(changed)
            cloud_or_refusal(path)


HEADER_FIELDS = {
    "points": (107, "<I", 0xFFFFFFFF, "expected 4294967295 points"),
    "records": (100, "<I", 0xFFFFFFFF, "4294967295 variable length records do not fit"),
    "point size": (105, "<H", 65535, "file holds"),
    "tiny point size": (105, "<H", 3, "too few for point format 3"),
    "start of points": (96, "<I", 0x7FFFFFFF, "its points begin at byte 2147483647"),
    "header size": (94, "<H", 0, "damaged header"),
    "point format": (104, "<B", 33, "unknown point format 33"),
    "version": (25, "<B", 9, "unknown LAS version 1.9"),
    "zero scale": (131, "<d", 0.0, "damaged header"),
    "scale that is no number": (131, "<d", float("nan"), "damaged header"),
    "infinite offset": (155, "<d", float("inf"), "damaged header"),
    "no points": (107, "<I", 0, "contains no points"),
}


@pytest.mark.parametrize("name", HEADER_FIELDS)
def test_hostile_header(tmp_path: Path, name: str) -> None:
    at, kind, value, words = HEADER_FIELDS[name]
    data = bytearray(sample(tmp_path, ".las"))
    struct.pack_into(kind, data, at, value)
    assert words in refusal(tmp_path, bytes(data), ".las")


def test_hostile_counts_of_las_1_4_and_laz(tmp_path: Path) -> None:
    for suffix, words in ((".las", "file holds 60000"), (".laz", "which cannot be")):
        data = bytearray(sample(tmp_path, suffix, 7))
        struct.pack_into("<Q", data, 247, 2**62)
        assert words in refusal(tmp_path, bytes(data), suffix)


def test_a_little_too_many_points_promised_in_laz(tmp_path: Path) -> None:
    data = bytearray(sample(tmp_path, ".laz"))
    struct.pack_into("<I", data, 107, 150_000)
    message = refusal(tmp_path, bytes(data), ".laz")
    assert "expected 150000 points, file holds" in message


def test_hostile_chunk_table(tmp_path: Path) -> None:
    data = bytearray(sample(tmp_path, ".laz"))
    points_at = struct.unpack_from("<I", data, 96)[0]
    table_at = struct.unpack_from("<q", data, points_at)[0]
    struct.pack_into("<I", data, table_at + 4, 0xFFFFFFFF)
    assert "4294967295 compressed chunks do not fit" in refusal(tmp_path, bytes(data), ".laz")
    struct.pack_into("<q", data, points_at, 2**62)
    assert "table of compressed chunks should be at byte" in refusal(tmp_path, bytes(data), ".laz")
    struct.pack_into("<q", data, points_at, -5)
    assert "truncated" in refusal(tmp_path, bytes(data), ".laz")


def test_laz_without_the_record_of_its_compression(tmp_path: Path) -> None:
    data = sample(tmp_path, ".laz").replace(b"laszip encoded", b"something else")
    assert "how it is compressed is missing" in refusal(tmp_path, data, ".laz")


def test_a_chunk_table_named_at_the_end_of_the_file_is_found(tmp_path: Path) -> None:
    """Writers to a stream cannot go back: they put -1 in front and the place behind."""
    data = bytearray(sample(tmp_path, ".laz"))
    points_at = struct.unpack_from("<I", data, 96)[0]
    place = data[points_at : points_at + 8]
    struct.pack_into("<q", data, points_at, -1)
    (tmp_path / "stream.laz").write_bytes(bytes(data + place))
    expected = tmchho.io.read(tmp_path / "sample.laz").xyz
    np.testing.assert_array_equal(tmchho.io.read(tmp_path / "stream.laz").xyz, expected)


def test_a_cut_extended_record_costs_only_itself(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    header = laspy.LasHeader(version="1.4", point_format=6)
    las = laspy.LasData(header)
    las.x = las.y = las.z = np.arange(5.0)
    las.evlrs = laspy.vlrs.vlrlist.VLRList(
        [laspy.VLR("Mine", 1, "", b"a" * 500), laspy.VLR("Mine", 2, "", b"b")]
    )
    las.write(tmp_path / "a.las")
    assert [
        record.data for record in tmchho.io.read(tmp_path / "a.las").metadata["header"].extended_records
    ] == [
        b"a" * 500,
        b"b",
    ]
    (tmp_path / "b.las").write_bytes((tmp_path / "a.las").read_bytes()[:-1])
    with caplog.at_level(logging.WARNING, logger="tmchho.io"):
        cloud = tmchho.io.read(tmp_path / "b.las")
    assert len(cloud) == 5
    assert len(cloud.metadata["header"].extended_records) == 1
    assert "an extended record is cut off" in caplog.text
