"""The files of a registration: every digit is kept, and they appear together or not at all."""

from __future__ import annotations

import hashlib
import json
import math
import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from tmchho import outputs
from tmchho.cloud import PointCloud
from tmchho.equations import euler_to_matrix
from tmchho.errors import ReadError, WriteError

angles = st.floats(-math.pi, math.pi)
rotation_vectors = st.tuples(angles, angles, angles)


def pose(
    rotation: NDArray[np.float64], translation: tuple[float, float, float] = (0, 0, 0)
) -> NDArray[np.float64]:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation, translation
    return matrix


def files_in(folder: Path) -> list[str]:
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))


# ---- numbers


@settings(max_examples=25)  # each one writes three files
@given(rotation_vectors, st.tuples(*[st.floats(-1e7, 1e7)] * 3))
def test_a_matrix_survives_its_text(
    tmp_path_factory: pytest.TempPathFactory, vector: tuple[float, ...], shift: tuple[float, float, float]
) -> None:
    matrix = pose(Rotation.from_rotvec(vector).as_matrix(), shift)
    folder = tmp_path_factory.mktemp("matrix")
    (folder / "lines.txt").write_text(outputs.matrix_text(matrix))
    (folder / "pdal.txt").write_text(outputs.pdal_text(matrix))
    (folder / "result.json").write_text(outputs.json_text({"transformation": matrix.tolist()}))
    for name in ("lines.txt", "pdal.txt", "result.json"):
        assert np.array_equal(outputs.read_matrix(folder / name), matrix)


def test_the_text_is_what_cloudcompare_reads() -> None:
    text = outputs.matrix_text(
        pose(Rotation.from_rotvec([0.1, 0.2, 0.3]).as_matrix(), (5e5 + 1 / 3, 4e6, -0.0))
    )
    lines = text.splitlines()
    assert [len(line.split(" ")) for line in lines] == [4, 4, 4, 4]
    assert lines[3] == "0 0 0 1"
    assert lines[0].split()[3] == "500000.33333333331"  # 17 significant digits
    assert lines[2].split()[3] == "0"  # no minus zero
    assert outputs.pdal_text(np.eye(4)) == "1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1"


@given(rotation_vectors)
def test_euler_angles_are_those_of_equation_1(vector: tuple[float, ...]) -> None:
    rotation = Rotation.from_rotvec(vector).as_matrix()
    theta_x, theta_y, theta_z = outputs.euler_deg(pose(rotation))
    # Turning about the fixed axes x, y, z in this order is Rz·Ry·Rx.
    again = Rotation.from_euler("xyz", [theta_x, theta_y, theta_z], degrees=True).as_matrix().T
    assert np.abs(again - rotation).max() < 1e-7  # asin loses half the digits near 90°
    assert -90 <= theta_y <= 90


@given(rotation_vectors, st.floats(1e-3, 1e3))
def test_a_scale_is_no_part_of_the_rotation(vector: tuple[float, ...], scale: float) -> None:
    rigid = pose(Rotation.from_rotvec(vector).as_matrix())
    scaled = pose(scale * rigid[:3, :3])
    assert outputs.quaternion_wxyz(scaled) == pytest.approx(outputs.quaternion_wxyz(rigid), abs=1e-6)
    again = [euler_to_matrix([*np.radians(outputs.euler_deg(m)), 0, 0, 0]) for m in (scaled, rigid)]
    assert np.abs(again[0] - again[1]).max() < 1e-7


@pytest.mark.parametrize("theta_y", [90.0, -90.0])
def test_euler_angles_in_gimbal_lock(theta_y: float) -> None:
    rotation = Rotation.from_euler("xyz", [30, theta_y, -50], degrees=True).as_matrix().T
    found = outputs.euler_deg(pose(rotation))
    assert found[2] == 0.0
    assert np.abs(Rotation.from_euler("xyz", found, degrees=True).as_matrix().T - rotation).max() < 1e-7


@given(rotation_vectors)
def test_the_quaternion_agrees_with_scipy(vector: tuple[float, ...]) -> None:
    rotation = Rotation.from_rotvec(vector)
    wanted = rotation.as_quat(scalar_first=True)
    found = np.array(outputs.quaternion_wxyz(pose(rotation.as_matrix())))
    assert found[0] >= 0
    assert abs(np.linalg.norm(found) - 1) < 1e-15 * 4
    assert min(np.abs(found - wanted).max(), np.abs(found + wanted).max()) < 1e-12


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_the_quaternion_of_half_a_turn(axis: int) -> None:
    rotation = -np.eye(3)
    rotation[axis, axis] = 1
    found = outputs.quaternion_wxyz(pose(rotation))
    assert np.abs(found).tolist() == np.eye(4)[axis + 1].tolist()


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("1 0 0 0\n0 1 0 0\n0 0 1 0\n", "12 numbers"),
        ("one two three", "does not hold a matrix"),
        ("1 0 0 nan\n0 1 0 0\n0 0 1 0\n0 0 0 1\n", "16 finite"),
        ('{"verdict": "accepted"}', "'transformation'"),
        ('{"transformation": [[1, 2], [3]]}', "does not hold a matrix"),
        ('{"transformation": ', "does not hold a matrix"),
        ("", "does not hold a matrix"),
    ],
)
def test_what_is_no_matrix_is_refused_by_name(tmp_path: Path, text: str, complaint: str) -> None:
    path = tmp_path / "transform.txt"
    path.write_text(text)
    with pytest.raises(ReadError, match=complaint) as caught:
        outputs.read_matrix(path)
    assert str(path) in str(caught.value)


def test_a_missing_or_binary_matrix_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ReadError, match="No such file"):
        outputs.read_matrix(tmp_path / "missing.txt")
    (tmp_path / "binary.txt").write_bytes(b"\xff\xfe\x00\x80\x81")
    with pytest.raises(ReadError, match="not a text file"):
        outputs.read_matrix(tmp_path / "binary.txt")


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
    max_leaves=20,
)


@given(st.dictionaries(st.text(), json_values))
def test_json_text_is_json_with_every_digit(document: dict[str, object]) -> None:
    assert json.loads(outputs.json_text(document)) == document


def test_json_text_keeps_a_matrix_readable_and_refuses_nan() -> None:
    text = outputs.json_text({"matrix": np.eye(2).tolist(), "reasons": ["a", "b"]})
    assert "    [1.0, 0.0],\n    [0.0, 1.0]\n" in text
    with pytest.raises(ValueError, match="JSON"):
        outputs.json_text({"rmse": math.nan})


def test_an_input_is_known_by_its_checksum(tmp_path: Path) -> None:
    path = tmp_path / "cloud.xyz"
    path.write_bytes(os.urandom(3_000_000))
    described = outputs.InputFile.of(path, 7)
    assert described == outputs.InputFile("cloud.xyz", 7, hashlib.sha256(path.read_bytes()).hexdigest())
    with pytest.raises(ReadError, match=r"missing\.xyz"):
        outputs.InputFile.of(tmp_path / "missing.xyz", 7)


# ---- the moved source


def test_the_moved_source_keeps_attributes_and_drops_what_is_not_finite() -> None:
    xyz = np.array([[1.0, 2, 3], [np.nan, 0, 0], [4, 5, 6], [0, np.inf, 0]])
    source = PointCloud(xyz, {"intensity": np.arange(4), "normal": np.arange(12).reshape(4, 3)}, crs="theirs")
    target = PointCloud(np.zeros((1, 3)), crs="ours")
    moved = outputs.moved_source(pose(np.eye(3), (10, 10, 10)), source, target)
    assert moved.xyz.tolist() == [[11, 12, 13], [14, 15, 16]]
    assert moved.attributes["intensity"].tolist() == [0, 2]
    assert moved.attributes["normal"].tolist() == [[0, 1, 2], [6, 7, 8]]
    assert moved.crs == "ours"
    assert np.isnan(source.xyz[1, 0])  # the given cloud is not touched


# ---- folders


def test_checking_a_folder_makes_nothing(tmp_path: Path) -> None:
    outputs.check_folder(tmp_path / "new" / "deeper")
    outputs.check_folder(tmp_path)
    assert files_in(tmp_path) == []


def test_a_folder_below_a_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    for folder in (tmp_path / "file", tmp_path / "file" / "out" / "deeper"):
        with pytest.raises(WriteError, match="is a file"):
            outputs.check_folder(folder)


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root may write everywhere")
def test_a_folder_without_rights_is_refused(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    try:
        with pytest.raises(WriteError, match="no file can be written"):
            outputs.check_folder(tmp_path / "out")
    finally:
        tmp_path.chmod(0o700)


def test_results_of_an_earlier_run_are_replaced_only_on_request(tmp_path: Path) -> None:
    (tmp_path / "result.json").write_text("{}")
    with pytest.raises(WriteError, match=r"result\.json: exists already.*--overwrite"):
        outputs.check_folder(tmp_path)
    outputs.check_folder(tmp_path, overwrite=True)
    with pytest.raises(WriteError, match="is an input"):
        outputs.check_folder(tmp_path, overwrite=True, inputs=[tmp_path / "." / "result.json"])


def test_files_appear_together(tmp_path: Path) -> None:
    folder = tmp_path / "new" / "deeper"
    seen: list[str] = []

    def second(path: Path) -> None:
        seen.extend(name for name in ("a.txt", "b.txt") if (folder / name).exists())
        path.write_text("b")

    outputs.write_together(folder, {"a.txt": lambda path: path.write_text("a"), "b.txt": second})
    assert seen == []
    assert files_in(folder) == ["a.txt", "b.txt"]
    assert (folder / "a.txt").read_text() == "a"


@pytest.mark.parametrize("error", [KeyboardInterrupt, MemoryError, OSError("disk full"), ValueError])
def test_after_any_failure_nothing_is_left(
    tmp_path: Path, error: BaseException | type[BaseException]
) -> None:
    def fail(path: Path) -> None:
        path.write_text("half")
        raise error

    with pytest.raises((KeyboardInterrupt, MemoryError, WriteError, ValueError)):
        outputs.write_together(
            tmp_path / "new" / "deeper", {"a.txt": lambda path: path.write_text("a"), "b.txt": fail}
        )
    assert files_in(tmp_path) == []


def test_after_a_failure_the_old_files_are_as_they_were(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text("old")

    def fail(path: Path) -> None:
        raise WriteError(f"{path}: will not")

    with pytest.raises(WriteError, match="will not") as caught:
        outputs.write_together(
            tmp_path, {"a.txt": lambda path: path.write_text("new"), "b.txt": fail}, overwrite=True
        )
    assert str(caught.value) == f"{tmp_path / 'b.txt'}: will not"  # not the temporary name
    assert files_in(tmp_path) == ["a.txt"]
    assert (tmp_path / "a.txt").read_text() == "old"
