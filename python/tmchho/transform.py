"""One rigid motion in every form that people paste somewhere else, and back again.

Why: CloudCompare, PDAL, a scanner's software and a spreadsheet each want the same pose written another way,
and each of them has its own trap at national-grid coordinates. All of them are written from one object, so
that they cannot differ.

Source: CloudCompare's wiki, "Global Shift and Scale" (local = global + shift); PDAL's documentation of
``filters.transformation``; ASTM E2807-11, Sec. 8.4.13 (the pose of a scan in E57).
"""

from __future__ import annotations

import json
import math
import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tmchho.equations import matrix_to_euler
from tmchho.errors import InvalidArgumentError, ReadError
from tmchho.inputs import CloudLike, open_points
from tmchho.results import ReadOnlyArrays, Registration, pose_matrix

StrPath = str | os.PathLike[str]
Matrix = NDArray[np.float64]

_SKEW = 1e-4  # of a rotation that was typed with few digits
_SHIFT_STEP = 100.0  # CloudCompare's shifts are easier to check when they are round
_SHIFT_ABOVE = 1e4  # CloudCompare asks for a shift above this size


@dataclass(frozen=True, eq=False)
class Transform(ReadOnlyArrays):
    """A rotation and a shift, perhaps with a scale, from source to target coordinates.

    Parameters
    ----------
    matrix : (4, 4) float64 array
        ``q = matrix[:3, :3] @ p + matrix[:3, 3]``, for coordinates as they stand in the files.
    local_matrix : (4, 4) float64 array
        The same about the pivots, with small numbers: ``q = local_matrix[:3, :3] @ (p - source_pivot) +
        local_matrix[:3, 3] + target_pivot``.
    source_pivot, target_pivot : (3,) float64 array
        Places in the middle of source and target.
    """

    matrix: Matrix
    local_matrix: Matrix
    source_pivot: NDArray[np.float64]
    target_pivot: NDArray[np.float64]

    @classmethod
    def of(cls, found: Registration | Transform | ArrayLike) -> Transform:
        """Return the transform of a registration, or the one that a 4 × 4 matrix stands for.

        Raises
        ------
        InvalidArgumentError
            If a matrix is not 4 × 4 and finite, or not a rotation with a shift and perhaps a scale.
        """
        if isinstance(found, Transform):
            return found
        if isinstance(found, Registration):
            return cls(
                found.transformation, found.pivot_transformation, found.source_pivot, found.target_pivot
            )
        matrix = _as_matrix(found).copy()
        _check_rigid(matrix)
        return cls(matrix, matrix, np.zeros(3), np.zeros(3))

    @classmethod
    def about(cls, local_matrix: ArrayLike, source_pivot: ArrayLike, target_pivot: ArrayLike) -> Transform:
        """Return the transform that is stated about two pivots; see `Transform`.

        Examples
        --------
        >>> turned = Transform.about(np.diag([-1, -1, 1, 1]), [500000, 4000000, 0], [0, 0, 10])
        >>> turned.apply([[500001.0, 4000002.0, 3.0]])
        array([[-1., -2., 13.]])
        """
        local = _as_matrix(local_matrix).copy()
        _check_rigid(local)
        source = np.array(source_pivot, dtype=np.float64).reshape(3)
        target = np.array(target_pivot, dtype=np.float64).reshape(3)
        matrix = local.copy()
        # With more digits than float64 where the machine has them: the terms are 1e6, their sum may be 1.
        long = np.longdouble
        matrix[:3, 3] = local[:3, 3].astype(long) + target.astype(long) - local[:3, :3].astype(long) @ source
        return cls(matrix, local, source, target)

    @property
    def scale(self) -> float:
        """Length in the target of what is one unit long in the source."""
        scale = float(np.cbrt(np.linalg.det(self.local_matrix[:3, :3])))
        return 1.0 if abs(scale - 1.0) < 1e-12 else scale

    def apply(self, points: CloudLike) -> NDArray[np.float64]:
        """Move points, (n, 3), from source to target coordinates, turning about the pivots."""
        local = open_points(points, "points") - self.source_pivot
        local = local @ self.local_matrix[:3, :3].T
        local += self.local_matrix[:3, 3]
        local += self.target_pivot
        return local

    def inverse(self) -> Transform:
        """Return the transform from target to source coordinates."""
        return Transform.about(np.linalg.inv(self.local_matrix), self.target_pivot, self.source_pivot)

    def turn(self, vectors: NDArray[Any]) -> NDArray[np.float64]:
        """Turn directions, (n, 3), such as normals: neither shifted nor scaled."""
        return np.asarray(vectors @ _rotation(self.local_matrix).T)


def about_middle(matrix: Matrix, middle: NDArray[np.float64]) -> Transform:
    """Return a pose stated about the middle of the source, so that nothing is lost at national-grid size."""
    checked = pose_matrix(matrix)
    turned = np.eye(4)
    turned[:3, :3] = checked[:3, :3]
    return Transform.about(turned, middle, checked[:3, :3] @ middle + checked[:3, 3])


def transform_document(
    found: Registration | Transform | ArrayLike,
    *,
    source_crs: str | None = None,
    target_crs: str | None = None,
) -> dict[str, Any]:
    """Return what ``transform.json`` holds: one transform in every form.

    Parameters
    ----------
    found : Registration, Transform or (4, 4) array_like
        Takes source to target coordinates.
    source_crs, target_crs : str, optional
        Coordinate reference systems as WKT.

    Returns
    -------
    dict
        Numbers have as many digits as float64 has. ``e57_pose`` is None where there is a scale, which a pose
        of E57 has no room for.
    """
    transform = Transform.of(found)
    matrix, scale = transform.matrix, transform.scale
    quaternion = quaternion_wxyz(transform.local_matrix)
    shift = cloudcompare_shift(transform)
    return {
        "applies_as": "target = matrix[0:3][0:3] * source + matrix[0:3][3]; the same about the pivots: "
        "target = local[0:3][0:3] * (source - source_pivot) + local[0:3][3] + target_pivot",
        "matrix": matrix.tolist(),
        "local_matrix": transform.local_matrix.tolist(),
        "source_pivot": transform.source_pivot.tolist(),
        "target_pivot": transform.target_pivot.tolist(),
        "scale": scale,
        "euler_deg": euler_deg(transform.local_matrix),
        "roll_pitch_yaw_deg": roll_pitch_yaw_deg(transform.local_matrix),
        "quaternion_wxyz": quaternion,
        "e57_pose": None
        if scale != 1.0
        else {
            "rotation": dict(zip("wxyz", quaternion, strict=True)),
            "translation": dict(zip("xyz", matrix[:3, 3].tolist(), strict=True)),
        },
        "pdal_matrix": pdal_text(matrix),
        "cloudcompare": {
            "global_shift": shift.tolist(),
            "matrix_after_shift": matrix_text(shifted_matrix(transform, shift)).splitlines(),
        },
        "source_crs": source_crs,
        "target_crs": target_crs,
    }


def pdal_pipeline(
    found: Registration | Transform | ArrayLike,
    source: str,
    output: str,
    *,
    scales: ArrayLike | None = None,
    crs: str | None = None,
) -> dict[str, Any]:
    """Return a PDAL pipeline that moves the source and keeps everything else.

    Parameters
    ----------
    found : Registration, Transform or (4, 4) array_like
        Takes source to target coordinates.
    source, output : str
        File to read and file to write.
    scales : (3,) array_like, optional
        Steps of the coordinates in the output: those of the target.
    crs : str, optional
        Coordinate reference system of the target as WKT.
    """
    writer: dict[str, Any] = {
        "type": "writers.las",
        "filename": output,
        "forward": "all",
        "extra_dims": "all",
        "offset_x": "auto",
        "offset_y": "auto",
        "offset_z": "auto",
    }
    if scales is not None:
        numbers = np.asarray(scales, dtype=np.float64).reshape(3).tolist()
        writer |= {f"scale_{axis}": value for axis, value in zip("xyz", numbers, strict=True)}
    if crs is not None:
        writer["a_srs"] = crs
    mover = {"type": "filters.transformation", "matrix": pdal_text(Transform.of(found).matrix)}
    return {"pipeline": [source, mover, writer]}


def cloudcompare_shift(transform: Transform) -> NDArray[np.float64]:
    """Return a global shift for both clouds in CloudCompare, which adds it to what it reads.

    Zero along axes where the target's coordinates are small, else the nearest hundred that makes them so.
    """
    middle = transform.apply(transform.source_pivot[None])[0]
    rounded = -np.round(middle / _SHIFT_STEP) * _SHIFT_STEP
    return np.where(np.abs(middle) > _SHIFT_ABOVE, rounded, 0.0) + 0.0


def shifted_matrix(transform: Transform, shift: ArrayLike) -> Matrix:
    """Return the matrix between coordinates to which `shift` was added, in source and target alike."""
    shift = np.asarray(shift, dtype=np.float64)
    moved = Transform.about(
        transform.local_matrix, transform.source_pivot + shift, transform.target_pivot + shift
    )
    return moved.matrix


def matrix_text(matrix: ArrayLike) -> str:
    """Return a 4 × 4 matrix as CloudCompare reads it: four lines of four numbers, 17 significant digits.

    Examples
    --------
    >>> print(matrix_text([[0, -1, 0, 0.1], [1, 0, 0, 2e6], [0, 0, 1, -3], [0, 0, 0, 1]]), end="")
    0 -1 0 0.10000000000000001
    1 0 0 2000000
    0 0 1 -3
    0 0 0 1
    """
    return "".join(" ".join(map(_digits, row)) + "\n" for row in _as_matrix(matrix))


def pdal_text(matrix: ArrayLike) -> str:
    """Return a 4 × 4 matrix as PDAL's ``filters.transformation`` reads it: 16 numbers, row by row."""
    return " ".join(map(_digits, _as_matrix(matrix).ravel()))


def read_matrix(path: StrPath) -> Matrix:
    """Read a 4 × 4 matrix from any file that `read_transform` knows.

    Parameters
    ----------
    path : str or path
        JSON is told from text by its first character.

    Returns
    -------
    (4, 4) float64 array

    Raises
    ------
    ReadError
        If the file is missing or does not hold a finite 4 × 4 matrix.
    """
    return _matrix_in(path, _parsed(path))


def read_transform(path: StrPath) -> Transform:
    """Read a transform: ``transform.json``, ``result.json``, ``transform.txt`` or a PDAL pipeline.

    Parameters
    ----------
    path : str or path
        The first two state the transform about pivots, which keeps every digit; text may be any 16 numbers.

    Returns
    -------
    Transform

    Raises
    ------
    ReadError
        If the file is missing or holds no transform, or one that mirrors or distorts.
    """
    parsed = _parsed(path)
    try:
        if isinstance(parsed, dict):
            local = parsed.get("local_matrix", parsed.get("pivot_transformation"))
            if local is not None:
                return Transform.about(local, parsed["source_pivot"], parsed["target_pivot"])
        return Transform.of(_matrix_in(path, parsed))
    except (InvalidArgumentError, KeyError, TypeError, ValueError) as error:
        raise ReadError(
            f"{path}: does not hold a transform that can be used ({error}); give the transform.json, "
            "result.json or transform.txt of a registration"
        ) from error


def read_target_crs(path: StrPath) -> str | None:
    """Return the coordinate reference system that a ``transform.json`` leads to, None where it names none."""
    parsed = _parsed(path)
    crs = parsed.get("target_crs") if isinstance(parsed, dict) else None
    return crs if isinstance(crs, str) else None


def _parsed(path: StrPath) -> Any:
    """Return what a JSON file holds, or the words of any other."""
    try:
        text = Path(path).read_text(encoding="utf-8-sig")
    except OSError as error:
        raise ReadError(
            f"{path}: cannot be read ({error.strerror}); check the name and the rights"
        ) from error
    except UnicodeDecodeError as error:
        raise ReadError(f"{path}: is not a text file; give a transform.txt or a result.json") from error
    try:
        return (
            json.loads(text) if text.lstrip().startswith(("{", "[")) else re.split(r"[\s,;]+", text.strip())
        )
    except ValueError as error:
        raise ReadError(f"{path}: does not hold a matrix ({error}); give 4 lines of 4 numbers") from error


def _matrix_in(path: StrPath, parsed: Any) -> Matrix:
    try:
        if isinstance(parsed, dict) and "pipeline" in parsed:
            parsed = parsed["pipeline"]
        if isinstance(parsed, dict):
            values = parsed["matrix"] if "matrix" in parsed else parsed["transformation"]
        elif any(isinstance(stage, dict) for stage in parsed):
            movers = [s for s in parsed if isinstance(s, dict) and s.get("type") == "filters.transformation"]
            if len(movers) != 1:
                raise ReadError(f"{path}: has {len(movers)} stages filters.transformation; give one with one")
            values = [float(word) for word in str(movers[0]["matrix"]).split()]
        else:
            values = [float(word) for word in parsed]
        matrix = np.array(values, dtype=np.float64)
    except KeyError as error:
        raise ReadError(
            f"{path}: has no key {error}; give the result.json or the transform.json of a registration"
        ) from error
    except (TypeError, ValueError) as error:
        raise ReadError(f"{path}: does not hold a matrix ({error}); give 4 lines of 4 numbers") from error
    if matrix.size != 16 or not np.isfinite(matrix).all():
        raise ReadError(f"{path}: holds {matrix.size} numbers; give 16 finite ones, in 4 lines of 4")
    return matrix.reshape(4, 4)


def euler_deg(matrix: ArrayLike) -> list[float]:
    """Return the angles θx, θy, θz of the article's Eq. (1) in degrees, θy from -90 to 90.

    Parameters
    ----------
    matrix : (4, 4) array_like
        A rigid transform, or one with a scale, which is left out.

    Notes
    -----
    Ren, Zhao & Han (2023), Eq. (1): the rotation is the transpose of Rz(θz)·Ry(θy)·Rx(θx). Where θy is
    ±90°, θx and θz turn about the same axis; the whole turn is then given as θx.
    """
    unscaled = np.eye(4)
    unscaled[:3, :3] = _rotation(matrix)
    return [math.degrees(angle) for angle in matrix_to_euler(unscaled)[:3]]


def roll_pitch_yaw_deg(matrix: ArrayLike) -> list[float]:
    """Return roll, pitch and yaw in degrees: the rotation is Rz(yaw)·Ry(pitch)·Rx(roll).

    Parameters
    ----------
    matrix : (4, 4) array_like
        A rigid transform, or one with a scale, which is left out. At a pitch of ±90° the yaw is 0.
    """
    r = _rotation(matrix)
    flat = math.hypot(r[0, 0], r[1, 0])
    if flat < 1e-12:
        angles = (math.atan2(-r[1, 2], r[1, 1]), math.atan2(-r[2, 0], flat), 0.0)
    else:
        angles = (
            math.atan2(r[2, 1], r[2, 2]),
            math.atan2(-r[2, 0], flat),
            math.atan2(r[1, 0], r[0, 0]),
        )
    return [math.degrees(angle) + 0.0 for angle in angles]


def quaternion_wxyz(matrix: ArrayLike) -> list[float]:
    """Return the rotation of a 4 × 4 transform, its scale left out, as a quaternion (w, x, y, z), w ≥ 0."""
    r = _rotation(matrix)
    # Four times each product of two components; the row of the largest component loses no digits.
    products = np.empty((4, 4))
    products[0] = 1 + np.trace(r), r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]
    products[1:, 0] = products[0, 1:]
    products[1:, 1:] = r + r.T
    np.fill_diagonal(products[1:, 1:], 1 - np.trace(r) + 2 * np.diag(r))
    row = products[int(np.argmax(np.diag(products)))]
    unit = row / np.linalg.norm(row)
    return [float(value) + 0.0 for value in (unit if unit[0] >= 0 else -unit)]


def _rotation(matrix: ArrayLike) -> NDArray[np.float64]:
    part = _as_matrix(matrix)[:3, :3]
    return np.asarray(part / np.cbrt(np.linalg.det(part)))


def _check_rigid(matrix: Matrix) -> None:
    part = matrix[:3, :3]
    is_finite = bool(np.isfinite(matrix).all())
    volume = float(np.linalg.det(part)) if is_finite else 0.0
    if not is_finite or np.abs(matrix[3] - [0, 0, 0, 1]).max() > _SKEW:
        raise InvalidArgumentError("transformation must be finite, with 0 0 0 1 in its last row")
    if volume <= 0:
        raise InvalidArgumentError("transformation mirrors, which no motion does: two axes are swapped")
    unscaled = part / np.cbrt(volume)
    if np.abs(unscaled @ unscaled.T - np.eye(3)).max() > _SKEW:
        raise InvalidArgumentError("transformation distorts: its 3 × 3 part is no rotation times a scale")


def _as_matrix(matrix: ArrayLike) -> Matrix:
    return np.asarray(matrix, dtype=np.float64).reshape(4, 4)


def _digits(value: float) -> str:
    return format(float(value) + 0.0, ".17g")  # the sum turns -0 into 0
