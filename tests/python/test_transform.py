"""Transforms that people paste: read by the rules of other programs, they move points to the same places.

The rules of PDAL and CloudCompare are written down here once more, independently, from their documentation.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from tmchho.errors import InvalidArgumentError, ReadError
from tmchho.outputs import PDAL, TRANSFORM, TRANSFORM_JSON, pose_files
from tmchho.transform import Transform, read_matrix, read_target_crs, read_transform, transform_document

GRID = np.array([500_000.0, 4_000_000.0, 300.0])
Floats = NDArray[np.float64]

angles = st.floats(-np.pi, np.pi)


def survey(seed: int = 0) -> Floats:
    """Return points of 400 m by 400 m by 60 m round E 500000 N 4000000."""
    return GRID + np.random.default_rng(seed).uniform(-1, 1, (500, 3)) * [200, 200, 30]


def on_the_grid(vector: tuple[float, ...], scale: float = 1.0) -> Transform:
    local = np.eye(4)
    local[:3, :3] = scale * Rotation.from_rotvec(vector).as_matrix()
    local[:3, 3] = [3.25, -8.5, 0.375]
    return Transform.about(local, GRID + np.array([12.5, 7, 1]), GRID + np.array([-31, 4.25, 2]))


def true_places(transform: Transform, points: Floats) -> Floats:
    """Return where the points go, in extended precision and about the pivots."""
    long = np.longdouble
    local = points.astype(long) - transform.source_pivot.astype(long)
    turned = local @ transform.local_matrix[:3, :3].T.astype(long) + transform.local_matrix[:3, 3].astype(
        long
    )
    return np.asarray(turned + transform.target_pivot.astype(long))


def written(folder: Path, transform: Transform) -> Path:
    for name, write in pose_files(transform, "uav.laz", "theirs", "ours", (0.001, 0.001, 0.001)).items():
        write(folder / name)
    return folder


def by_pdal(path: Path, points: Floats) -> Floats:
    """Apply a pipeline as ``filters.transformation`` does: 16 numbers row by row, column vectors."""
    (stage,) = [s for s in json.loads(path.read_text())["pipeline"] if isinstance(s, dict) and "matrix" in s]
    assert stage["type"] == "filters.transformation"
    numbers = [float(word) for word in stage["matrix"].split(" ")]
    x, y, z = points.T
    return np.column_stack(
        [
            numbers[4 * r] * x + numbers[4 * r + 1] * y + numbers[4 * r + 2] * z + numbers[4 * r + 3]
            for r in range(3)
        ]
    )


def by_cloudcompare(lines: list[str], shift: Floats, points: Floats) -> Floats:
    """Apply four lines of four numbers as CloudCompare does to a cloud that was loaded with a global shift.

    It keeps ``local = float32(global + shift)``, moves that, and saves ``local - shift``.
    """
    matrix = np.array([[float(word) for word in line.split()] for line in lines])
    local = (points + shift).astype(np.float32).astype(np.float64)
    moved = (local @ matrix[:3, :3].T + matrix[:3, 3]).astype(np.float32).astype(np.float64)
    return moved - shift


@settings(max_examples=25)  # each one writes three files
@given(st.tuples(angles, angles, angles))
def test_other_programs_move_points_to_the_same_places(
    tmp_path_factory: pytest.TempPathFactory, vector: tuple[float, ...]
) -> None:
    transform, points = on_the_grid(vector), survey()
    wanted = true_places(transform, points)
    folder = written(tmp_path_factory.mktemp("pose"), transform)
    assert np.abs(transform.apply(points) - wanted).max() < 1e-8
    assert np.abs(by_pdal(folder / PDAL, points) - wanted).max() < 1e-7
    matrix = np.loadtxt(folder / TRANSFORM)
    assert np.abs(points @ matrix[:3, :3].T + matrix[:3, 3] - wanted).max() < 1e-7
    document = json.loads((folder / TRANSFORM_JSON).read_text())
    shifted = document["cloudcompare"]
    shift = np.array(shifted["global_shift"])
    assert np.abs(points + shift).max() < 1000
    assert np.abs(by_cloudcompare(shifted["matrix_after_shift"], shift, points) - wanted).max() < 1e-4


@given(st.tuples(angles, angles, angles), st.sampled_from([1.0, 0.3048, 1000.0]))
def test_every_form_is_the_same_rotation(vector: tuple[float, ...], scale: float) -> None:
    transform = on_the_grid(vector, scale)
    document = transform_document(transform)
    wanted = Rotation.from_rotvec(vector).as_matrix()
    w, x, y, z = document["quaternion_wxyz"]
    roll_pitch_yaw = Rotation.from_euler("xyz", document["roll_pitch_yaw_deg"], degrees=True)
    article = Rotation.from_euler("xyz", document["euler_deg"], degrees=True).inv()
    for rotation in (Rotation.from_quat([x, y, z, w]), roll_pitch_yaw, article):
        assert np.abs(rotation.as_matrix() - wanted).max() < 1e-7
    assert document["scale"] == pytest.approx(scale, rel=1e-12)
    matrix = np.array(document["matrix"])
    assert np.abs(matrix[:3, :3] - scale * wanted).max() < 1e-9 * scale


@given(st.tuples(angles, angles, angles))
def test_the_e57_pose_places_the_scan(vector: tuple[float, ...]) -> None:
    transform, points = on_the_grid(vector), survey()
    pose = transform_document(transform)["e57_pose"]
    rotation = Rotation.from_quat([pose["rotation"][key] for key in "xyzw"])
    moved = rotation.apply(points) + [pose["translation"][key] for key in "xyz"]
    # A quaternion as E57 stores it loses nothing; the shift of 4e6 leaves 1e-8.
    assert np.abs(moved - true_places(transform, points)).max() < 1e-7


def test_a_scale_has_no_e57_pose() -> None:
    assert transform_document(on_the_grid((0, 0, 1), 2.0))["e57_pose"] is None


@pytest.mark.parametrize("name", [TRANSFORM, TRANSFORM_JSON, PDAL])
def test_every_file_is_read_back(tmp_path: Path, name: str) -> None:
    transform, points = on_the_grid((0.3, -0.2, 2.9)), survey()
    path = written(tmp_path, transform) / name
    assert np.array_equal(read_matrix(path), transform.matrix)
    assert np.abs(read_transform(path).apply(points) - true_places(transform, points)).max() < 1e-7
    assert read_target_crs(path) == ("ours" if name == TRANSFORM_JSON else None)


def test_there_and_back() -> None:
    transform, points = on_the_grid((0.3, -0.2, 2.9), 1.7), survey()
    assert np.abs(transform.inverse().apply(transform.apply(points)) - points).max() < 1e-8
    again = transform.inverse().matrix @ transform.matrix
    assert np.abs(again[:3, :3] - np.eye(3)).max() < 1e-12


def test_from_a_local_frame_to_the_grid_cloudcompare_gets_no_needless_shift() -> None:
    local = np.eye(4)
    to_grid = Transform.about(local, [1.0, 2.0, 3.0], GRID)
    assert transform_document(to_grid)["cloudcompare"]["global_shift"] == [-500_000.0, -4_000_000.0, 0.0]
    at_home = Transform.about(local, [1.0, 2.0, 3.0], [9.0, 9.0, 9.0])
    assert transform_document(at_home)["cloudcompare"]["global_shift"] == [0.0, 0.0, 0.0]


@pytest.mark.parametrize(
    ("matrix", "complaint"),
    [
        (np.diag([1.0, -1, 1, 1]), "mirrors"),
        (np.diag([1.0, 2, 1, 1]), "distorts"),
        (np.diag([1.0, 1, 1, 2]), "last row"),
        (np.full((4, 4), np.nan), "finite"),
    ],
)
def test_what_is_no_motion_is_refused(tmp_path: Path, matrix: Floats, complaint: str) -> None:
    with pytest.raises(InvalidArgumentError, match=complaint):
        Transform.of(matrix)
    if np.isfinite(matrix).all():
        np.savetxt(tmp_path / "t.txt", matrix)
        with pytest.raises(ReadError, match=rf"t\.txt.*{complaint}"):
            read_transform(tmp_path / "t.txt")


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ('{"pipeline": ["a.laz", {"type": "writers.las"}]}', "0 stages"),
        (
            '{"local_matrix": [1, 2], "source_pivot": [0, 0, 0], "target_pivot": [0, 0, 0]}',
            "cannot|can be used",
        ),
        ('{"local_matrix": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]}', "source_pivot"),
    ],
)
def test_a_document_without_a_transform_is_refused(tmp_path: Path, text: str, complaint: str) -> None:
    path = tmp_path / "t.json"
    path.write_text(text)
    with pytest.raises(ReadError, match=complaint) as caught:
        read_transform(path)
    assert str(path) in str(caught.value)
