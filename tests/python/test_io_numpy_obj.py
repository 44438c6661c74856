"""NumPy files and the vertices of OBJ meshes."""

from __future__ import annotations

import io
import pickle
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import tmchho.io
from tmchho.cloud import PointCloud
from tmchho.errors import ReadError

XYZ = np.array([[500_000.123, 4_000_000.456, 101.789], [1 / 3, -2 / 3, 1e-9], [7, 8, 9]])


def message_of(path: Path) -> str:
    with pytest.raises(ReadError) as caught:
        tmchho.io.read(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize(
    "array",
    [
        XYZ,
        np.asfortranarray(XYZ),
        XYZ.astype(">f8"),
        np.array([tuple(row) for row in XYZ], dtype=[("x", "f8"), ("y", "f8"), ("z", "f8")]),
        np.array([tuple(row[::-1]) for row in XYZ], dtype=[("Z", "f8"), ("Y", "f8"), ("X", "f8")]),
    ],
)
def test_arrays_of_coordinates(tmp_path: Path, array: NDArray[Any]) -> None:
    np.save(tmp_path / "a.npy", array)
    np.testing.assert_array_equal(tmchho.io.read(tmp_path / "a.npy").xyz, XYZ)


def test_integers_float32_and_further_columns(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.arange(10, dtype=np.int16).reshape(2, 5))
    cloud = tmchho.io.read(tmp_path / "a.npy")
    np.testing.assert_array_equal(cloud.xyz, [[0, 1, 2], [5, 6, 7]])
    assert cloud.attributes["column_5"].tolist() == [4, 9]
    np.save(tmp_path / "b.npy", XYZ.astype(np.float32))
    np.testing.assert_array_equal(tmchho.io.read(tmp_path / "b.npy").xyz, XYZ.astype(np.float32))


@pytest.mark.parametrize("extension", [".npy", ".npz"])
def test_attributes_and_types(tmp_path: Path, extension: str) -> None:
    attributes: dict[str, NDArray[Any]] = {
        kind: np.array([0, 1, 100], dtype=kind)
        for kind in ("u1", "i1", "u2", "i2", "u4", "i4", "u8", "i8", "f4", "f8")
    }
    attributes["normal"] = np.arange(9.0).reshape(3, 3)
    attributes["file"] = np.arange(3)  # a name that numpy's own writer cannot take
    tmchho.io.write(PointCloud(XYZ, attributes), tmp_path / f"a{extension}")
    back = tmchho.io.read(tmp_path / f"a{extension}")
    np.testing.assert_array_equal(back.xyz, XYZ)
    assert sorted(back.attributes) == sorted(attributes)
    for key, values in attributes.items():
        np.testing.assert_array_equal(back.attributes[key], values)
        assert back.attributes[key].dtype == values.dtype


def test_numpy_reads_what_we_write(tmp_path: Path) -> None:
    tmchho.io.write(PointCloud(XYZ), tmp_path / "a.npy")
    np.testing.assert_array_equal(np.load(tmp_path / "a.npy"), XYZ)
    tmchho.io.write(PointCloud(XYZ, {"intensity": np.arange(3)}), tmp_path / "a.npz")
    with np.load(tmp_path / "a.npz") as archive:
        np.testing.assert_array_equal(archive["xyz"], XYZ)
        np.testing.assert_array_equal(archive["intensity"], np.arange(3))


def test_archives_of_others(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", points=XYZ, intensity=np.arange(3), faces=np.zeros((7, 3)))
    cloud = tmchho.io.read(tmp_path / "a.npz")
    np.testing.assert_array_equal(cloud.xyz, XYZ)
    assert list(cloud.attributes) == ["intensity"]
    np.savez_compressed(tmp_path / "b.npz", X=XYZ[:, 0], Y=XYZ[:, 1], Z=XYZ[:, 2])
    np.testing.assert_array_equal(tmchho.io.read(tmp_path / "b.npz").xyz, XYZ)
    np.savez(tmp_path / "c.npz", weights=XYZ)
    assert "has no x y z field" in message_of(tmp_path / "c.npz")


class Touch:
    """Leaves a file behind when it is unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Any, ...]:
        return (Path.touch, (self.path,))


def test_pickles_are_never_loaded(tmp_path: Path) -> None:
    trap = np.array([Touch(tmp_path / "sprung")], dtype=object)
    np.save(tmp_path / "a.npy", trap, allow_pickle=True)
    np.savez(tmp_path / "b.npz", points=trap)
    (tmp_path / "c.npy").write_bytes(pickle.dumps(Touch(tmp_path / "sprung")))
    assert "Python objects, which are never loaded" in message_of(tmp_path / "a.npy")
    assert "Python objects, which are never loaded" in message_of(tmp_path / "b.npz")
    message_of(tmp_path / "c.npy")
    assert not (tmp_path / "sprung").exists()


@pytest.mark.parametrize(
    ("array", "words"),
    [
        (XYZ[:, :2], r"shape (3, 2) instead of (n, 3)"),
        (np.zeros((3, 2)), r"transpose it"),
        (np.zeros(9), r"shape (9,)"),
        (np.zeros((4, 3, 3)), r"shape (4, 3, 3)"),
        (np.zeros((0, 3)), r"contains no points"),
        (np.array([["a", "b", "c"]]), r"not numbers"),
        (np.zeros((4, 3), dtype=complex), r"not numbers"),
        (np.zeros(4, dtype=[("x", "f8"), ("y", "f8")]), r"has no z field"),
    ],
)
def test_arrays_that_are_no_points(tmp_path: Path, array: NDArray[Any], words: str) -> None:
    np.save(tmp_path / "a.npy", array)
    assert words in message_of(tmp_path / "a.npy")


def test_truncated_arrays(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.zeros((100, 3)))
    data = (tmp_path / "a.npy").read_bytes()
    (tmp_path / "a.npy").write_bytes(data[: 128 + 42 * 24 + 7])
    assert "expected 100 points, file holds 42" in message_of(tmp_path / "a.npy")
    for n_bytes in (6, 9, 60):
        (tmp_path / "a.npy").write_bytes(data[:n_bytes])
        message_of(tmp_path / "a.npy")
    tmchho.io.write(PointCloud(XYZ), tmp_path / "b.npz")
    data = (tmp_path / "b.npz").read_bytes()
    for share in (0.1, 0.5, 0.9):
        (tmp_path / "b.npz").write_bytes(data[: int(len(data) * share)])
        message_of(tmp_path / "b.npz")


@pytest.mark.parametrize("shape", [(10**15, 3), (10**9, 10**9), (10**30, 3), (-1, 3)])
def test_hostile_shapes_allocate_nothing(tmp_path: Path, shape: tuple[int, int]) -> None:
    stream = io.BytesIO()
    np.lib.format.write_array_header_1_0(stream, {"descr": "<f8", "fortran_order": False, "shape": shape})
    (tmp_path / "a.npy").write_bytes(stream.getvalue() + XYZ.tobytes())
    message_of(tmp_path / "a.npy")
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        archive.writestr("xyz.npy", stream.getvalue() + XYZ.tobytes())
    message_of(tmp_path / "a.npz")


# --- OBJ ---

OBJ = """# a comment
mtllib some.mtl
o thing
v 500000.123 4000000.456 101.789
vn 0 0 1
vt 0.5 0.5
v 1 2 3
  v 4 5 6
usemtl one
f 1//1 2//1 3//1
usemtl two
f 3/1/1 2/1/1 1/1/1
v 1 2 3
"""
VERTICES = [[500_000.123, 4_000_000.456, 101.789], [1, 2, 3], [4, 5, 6], [1, 2, 3]]


@pytest.mark.parametrize("line_end", ["\n", "\r\n", "\r"])
def test_vertices_in_the_order_of_the_file_each_once(tmp_path: Path, line_end: str) -> None:
    (tmp_path / "a.obj").write_bytes(OBJ.replace("\n", line_end).encode())
    cloud = tmchho.io.read(tmp_path / "a.obj")
    np.testing.assert_array_equal(cloud.xyz, VERTICES)
    assert not cloud.attributes


def test_vertex_colours_and_weights(tmp_path: Path) -> None:
    (tmp_path / "a.obj").write_text("v 1 2 3 0.5 1 0\nv 4 5 6 1 1 1\n")
    attributes = tmchho.io.read(tmp_path / "a.obj").attributes
    assert attributes["red"].tolist() == [0.5, 1]
    (tmp_path / "b.obj").write_text("v 1 2 3 1.0\nv 4 5 6 1.0\n")
    assert not tmchho.io.read(tmp_path / "b.obj").attributes
    (tmp_path / "c.obj").write_text("v 1 2 3 1.0\nv 4 5 6 2.0\n")
    assert tmchho.io.read(tmp_path / "c.obj").attributes["weight"].tolist() == [1, 2]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("o thing\nf 1 2 3\n", "no 'v' lines"),
        ("# c\nv 1 2 3\nf 1 1 1\nv 1 2\n", "line 4 has 2 values where 3 are expected"),
        ("v 1 2 3\nv 1 two 3\n", "line 2, column 2: 'two' is not a number"),
        ("v 1 2\n", "vertices of 2 values"),
    ],
)
def test_broken_meshes(tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / "a.obj").write_text(text)
    assert words in message_of(tmp_path / "a.obj")


@pytest.mark.filterwarnings("ignore:.*:RuntimeWarning")  # of its texture code
def test_trimesh_finds_the_same_vertices(data_dir: Path) -> None:
    trimesh = pytest.importorskip("trimesh")
    path = data_dir / "survey" / "hippo" / "hippo1.obj"
    theirs = trimesh.load(path, process=False, maintain_order=True)
    np.testing.assert_array_equal(tmchho.io.read(path).xyz, theirs.vertices)
