"""Parts of files: boxes of any format, boxes and resolutions of COPC, with laspy's reader as the judge."""

from __future__ import annotations

import struct
from pathlib import Path

import laspy
import numpy as np
import pytest
from copc_files import CENTRE, HALF, N_POINTS, SPACING, write_copc
from laspy.copc import Bounds, CopcReader

import tmchho.io
from tmchho.cloud import PointCloud
from tmchho.errors import InvalidArgumentError, ReadError
from tmchho.io import copc

BOX = [CENTRE - [6, 7, 8], CENTRE - [0, 2, -8]]


@pytest.fixture(params=[False, True], ids=["one page", "two pages"])
def file(tmp_path: Path, request: pytest.FixtureRequest) -> Path:
    write_copc(tmp_path / "a.copc.laz", further_page=request.param)
    return tmp_path / "a.copc.laz"


def same(ours: PointCloud, theirs: laspy.ScaleAwarePointRecord) -> None:
    """Compare as sets: laspy gives the nodes in another order where groups of them are apart."""
    expected = np.column_stack([theirs.x, theirs.y, theirs.z, theirs.intensity])
    found = np.column_stack([ours.xyz, ours.attributes["intensity"]])
    assert found.shape == expected.shape
    np.testing.assert_array_equal(found[np.lexsort(found.T)], expected[np.lexsort(expected.T)])


def test_a_box_of_a_copc_file(file: Path) -> None:
    whole = tmchho.io.read(file)
    assert len(whole) == sum(N_POINTS)
    with CopcReader.open(file) as reader:
        same(whole, reader.query())
        part = tmchho.io.read(file, box=BOX)
        assert 0 < len(part) < len(whole)
        same(part, reader.query(bounds=Bounds(BOX[0], BOX[1])))
        flat = tmchho.io.read(file, box=np.array(BOX)[:, :2])
        same(flat, reader.query(bounds=Bounds(BOX[0][:2], BOX[1][:2])))
    assert part.metadata["header"] == whole.metadata["header"]


@pytest.mark.parametrize("resolution", [5.0, SPACING, 0.9, 0.5, 0.3, 0.1, 1e-300])
def test_a_resolution_of_a_copc_file(file: Path, resolution: float) -> None:
    cloud = tmchho.io.read(file, resolution=resolution)
    with CopcReader.open(file) as reader:
        same(cloud, reader.query(resolution=max(resolution, 1e-9)))
    both = tmchho.io.read(file, resolution=resolution, box=BOX)
    inside = ((cloud.xyz >= BOX[0]) & (cloud.xyz <= BOX[1])).all(axis=1)
    np.testing.assert_array_equal(both.xyz, cloud.xyz[inside])


def test_only_the_nodes_of_the_box_are_read(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    n_points: list[int] = []

    def spy(*arguments: object) -> int:
        chunks = arguments[3]
        assert isinstance(chunks, list)
        n_points.append(sum(chunk.n_points for chunk in chunks))
        return n_points[-1]

    monkeypatch.setattr(copc, "check_layers", spy)
    tmchho.io.read(file, box=[CENTRE - HALF, CENTRE - 0.9 * HALF])
    assert n_points[0] < sum(N_POINTS) / 3


def test_a_box_of_any_other_format(tmp_path: Path) -> None:
    xyz = np.random.default_rng(0).uniform(0, 10, (100, 3)).round(3)
    cloud = PointCloud(xyz, {"intensity": np.arange(100)})
    inside = ((xyz >= [2, 2, 0]) & (xyz <= [7, 7, 10])).all(axis=1)
    for suffix in tmchho.io.known_extensions(writable=True):
        if suffix == ".e57":
            pytest.importorskip("pye57")
        tmchho.io.write(cloud, tmp_path / f"a{suffix}")
        part = tmchho.io.read(tmp_path / f"a{suffix}", box=[[2, 2], [7, 7]])
        np.testing.assert_allclose(part.xyz, xyz[inside], atol=1e-6, err_msg=suffix)
        np.testing.assert_array_equal(part.attributes["intensity"], np.arange(100)[inside])
        with pytest.raises(ReadError, match="contains no points in that box"):
            tmchho.io.read(tmp_path / f"a{suffix}", box=[[20, 2], [27, 7]])
        with pytest.raises(ReadError, match="is no COPC file"):
            tmchho.io.read(tmp_path / f"a{suffix}", resolution=1.0)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"box": [[0, 0, 0]]}, "give the lowest and the highest corner"),
        ({"box": [[5, 0], [1, 1]]}, "give the lowest and the highest corner"),
        ({"box": [[float("nan"), 0], [1, 1]]}, "give the lowest and the highest corner"),
        ({"box": [["a", 0], [1, 1]]}, "not a number"),
        ({"resolution": 0}, "give a distance above 0"),
        ({"resolution": float("nan")}, "give a distance above 0"),
    ],
)
def test_boxes_and_resolutions_that_are_none(file: Path, options: dict[str, object], words: str) -> None:
    with pytest.raises(InvalidArgumentError, match=words):
        tmchho.io.read(file, **options)  # type: ignore[arg-type]


def message_of(path: Path) -> str:
    with pytest.raises(ReadError) as caught:
        tmchho.io.read(path, box=BOX)
    assert str(caught.value).startswith(f"{path}: ")
    return str(caught.value)


def test_a_damaged_octree(tmp_path: Path) -> None:
    write_copc(tmp_path / "a.copc.laz", further_page=True)
    valid = (tmp_path / "a.copc.laz").read_bytes()
    info_at = 375 + 54
    page_at, n_page = struct.unpack_from("<2Q", valid, info_at + 40)
    entries = [struct.unpack_from("<4iQ2i", valid, page_at + at) for at in range(0, n_page, 32)]
    further = next(number for number, entry in enumerate(entries) if entry[-1] == -1)
    damage = {
        "half an edge of": (info_at + 24, "<d", float("nan")),
        "a page of its octree should be at byte": (info_at + 40, "<Q", 2**62),
        f"should be at byte {page_at};": (page_at + 32 * further + 16, "<Q", page_at),  # points at itself
        "of its points should be at byte": (page_at + 16, "<Q", 2**40),
        "its octree holds": (page_at + 28, "<i", 5000),
        "nodes of its octree overlap": (page_at + 28, "<i", 2**30),
        "is damaged in compressed chunk 1": (page_at + 24, "<i", 500),
    }
    for words, (at, kind, value) in damage.items():
        changed = bytearray(valid)
        struct.pack_into(kind, changed, at, value)
        (tmp_path / "b.copc.laz").write_bytes(changed)
        assert words in message_of(tmp_path / "b.copc.laz")


def test_the_real_copc_files(data_dir: Path) -> None:
    files = sorted(data_dir.rglob("*.copc.laz"))
    assert files
    for path in files:
        whole = tmchho.io.read(path)
        lowest, highest = whole.xyz.min(axis=0), whole.xyz.max(axis=0)
        everything = tmchho.io.read(path, box=[lowest, highest])
        np.testing.assert_array_equal(everything.xyz, whole.xyz, err_msg=str(path))
        with CopcReader.open(path) as reader:
            for times in (1, 2, 4):
                resolution = reader.copc_info.spacing / times
                assert len(tmchho.io.read(path, resolution=resolution)) == len(
                    reader.query(resolution=resolution)
                )
