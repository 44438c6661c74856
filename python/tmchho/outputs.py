"""The files that a registration leaves in its folder, and how they get there: all of them or none.

Why one module: the command line, the demo and a script that wants the same files must not differ in a digit.
Numbers are written with as many digits as a float64 has, because a matrix cut to twelve decimals loses
millimetres at national-grid coordinates.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import platform
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tmchho.cloud import PointCloud
from tmchho.equations import matrix_to_euler
from tmchho.errors import ReadError, WriteError
from tmchho.io import atomic_path, check_output, check_writable_folder

if TYPE_CHECKING:
    from tmchho.fused import FusedCloud
    from tmchho.results import Registration

FUSED = "fused.laz"
SOURCE_REGISTERED = "source_registered.laz"
TRANSFORM = "transform.txt"
RESULT = "result.json"
REPORT_POINTS = "report_points.npz"
OUTPUTS = (FUSED, SOURCE_REGISTERED, TRANSFORM, RESULT, REPORT_POINTS)
# Made of the two before, by `tmchho.report`.
REPORT, REPORT_PDF, FIGURES = "report.html", "report.pdf", "figures"

StrPath = str | os.PathLike[str]
_CHUNK_BYTES = 1 << 20


@dataclass(frozen=True)
class InputFile:
    """A file that was read, told apart from all others by its checksum.

    Parameters
    ----------
    name : str
        File name without its folder.
    n_points : int
        Points in it.
    sha256 : str
        Checksum of its bytes, in hexadecimal digits.
    """

    name: str
    n_points: int
    sha256: str

    @classmethod
    def of(cls, path: StrPath, n_points: int) -> InputFile:
        """Describe the file at `path`, from which `n_points` points were read."""
        digest = hashlib.sha256()
        try:
            with open(path, "rb") as stream:
                while chunk := stream.read(_CHUNK_BYTES):
                    digest.update(chunk)
        except OSError as error:
            raise ReadError(f"{path}: cannot be read ({error.strerror}); check the rights") from error
        return cls(Path(path).name, n_points, digest.hexdigest())


def check_folder(
    folder: StrPath,
    *,
    names: Iterable[str] = OUTPUTS,
    overwrite: bool = False,
    inputs: Iterable[StrPath] = (),
) -> None:
    """Raise if files could not be written into a folder: a cheap test before a long computation.

    Nothing is left behind, and a folder that does not exist is not made.

    Parameters
    ----------
    folder : str or path
        Where the files are going to be.
    names : iterable of str
        Their names.
    overwrite : bool, default False
        Whether existing files may be replaced.
    inputs : iterable of str or path
        Files that must never be replaced, even with `overwrite`.

    Raises
    ------
    WriteError
        If the folder cannot be made or written into, or a file of these names stands in the way.
    """
    folder = Path(folder)
    inputs = tuple(inputs)
    existing = next(path for path in (folder, *folder.absolute().parents) if os.path.lexists(path))
    if not existing.is_dir():
        raise WriteError(f"{folder}: cannot be a folder because {existing} is a file; choose another")
    check_writable_folder(existing)
    if existing != folder:
        return
    for path in (folder / name for name in names):
        check_output(path, True, inputs)
        if path.exists() and not overwrite:
            raise WriteError(f"{path}: exists already; choose another folder or give --overwrite")


def write_together(
    folder: StrPath,
    files: Mapping[str, Callable[[Path], object]],
    *,
    overwrite: bool = False,
    inputs: Iterable[StrPath] = (),
) -> None:
    """Write several files into a folder: every one of them is complete before the first one appears.

    Parameters
    ----------
    folder : str or path
        Made if it does not exist.
    files : mapping of str to callable
        For each name what writes the file, given a temporary path. The file named last appears first.
    overwrite : bool, default False
        Replace existing files.
    inputs : iterable of str or path
        Files that must never be replaced, even with `overwrite`.

    Raises
    ------
    WriteError
        If one of them cannot be written. No file of this call stays behind, nor a folder that it made;
        this holds for an interrupt, too.
    """
    folder = Path(folder)
    with _made_folder(folder), ExitStack() as stack:
        for name, write in files.items():
            path = folder / name
            temporary = stack.enter_context(atomic_path(path, overwrite, inputs))
            try:
                write(temporary)
            except WriteError as error:
                raise WriteError(str(error).replace(str(temporary), str(path))) from error.__cause__


@contextmanager
def _made_folder(folder: Path) -> Iterator[None]:
    missing = [path for path in (folder, *folder.absolute().parents) if not path.exists()]
    check_writable_folder(folder)
    try:
        yield
    except BaseException:
        for path in missing:  # the innermost first; what is not empty is not ours
            with suppress(OSError):
                path.rmdir()
        raise


def moved_source(registration: Registration, source: PointCloud, target: PointCloud) -> PointCloud:
    """Return the source in the target's frame, with every attribute it had.

    Points whose coordinates are not finite are left out, because they cannot be moved.

    Parameters
    ----------
    registration : Registration
        Its transform is applied about the pivots, so that nothing is lost at national-grid size.
    source, target : PointCloud
        The clouds that were registered; the result takes over the target's coordinate reference system.

    Returns
    -------
    PointCloud
    """
    finite = np.isfinite(source.xyz).all(axis=1)
    xyz, attributes = source.xyz, dict(source.attributes)
    if not finite.all():
        xyz = xyz[finite]
        attributes = {name: np.asarray(values)[finite] for name, values in attributes.items()}
    return replace(source, xyz=registration.apply(xyz), attributes=attributes, crs=target.crs)


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


def read_matrix(path: StrPath) -> NDArray[np.float64]:
    """Read a 4 × 4 matrix from ``transform.txt``, from any text with 16 numbers, or from ``result.json``.

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
    try:
        text = Path(path).read_text(encoding="utf-8-sig")
    except OSError as error:
        raise ReadError(
            f"{path}: cannot be read ({error.strerror}); check the name and the rights"
        ) from error
    except UnicodeDecodeError as error:
        raise ReadError(f"{path}: is not a text file; give a transform.txt or a result.json") from error
    try:
        if text.lstrip().startswith("{"):
            values = json.loads(text)["transformation"]
        else:
            values = [float(word) for word in re.split(r"[\s,;]+", text.strip())]
        matrix = np.array(values, dtype=np.float64)
    except KeyError as error:
        raise ReadError(
            f"{path}: has no key 'transformation'; give the result.json of a registration"
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


def result_document(
    registration: Registration,
    source: InputFile,
    target: InputFile,
    fused: FusedCloud | None,
    command: str,
) -> dict[str, Any]:
    """Return what ``result.json`` holds.

    Two runs with the same files, settings and seed give the same document, except for values under keys
    called ``seconds``. How many threads there were is left out, because it changes nothing.

    Parameters
    ----------
    registration : Registration
        What was found.
    source, target : InputFile
        From what.
    fused : FusedCloud, optional
        What it was fused to; None where the pose was rejected.
    command : str
        Command line that gives the same result again.

    Returns
    -------
    dict
        Only what JSON knows; numbers that are not finite are None.
    """
    document: dict[str, Any] = registration.to_dict()
    matrix = registration.transformation
    document |= {
        "transformation_as": {
            "pdal": pdal_text(matrix),
            "scale": registration.scale,
            "euler_deg": euler_deg(matrix),
            "quaternion_wxyz": quaternion_wxyz(matrix),
        },
        "inputs": {"source": vars(source), "target": vars(target)},
        "fused": None if fused is None else fused_counts(fused),
        "versions": {
            "tmchho": registration.version,
            "numpy": np.__version__,
            "python": platform.python_version(),
        },
        "command": command,
    }
    return document


def fused_counts(fused: FusedCloud) -> dict[str, Any]:
    """Return how many points of the fused cloud come from where, as in ``result.json``."""
    n_source = int(np.count_nonzero(fused.origin))
    return {
        "n_points": len(fused.points),
        "n_from_target": len(fused.points) - n_source,
        "n_from_source": n_source,
        "n_filled_by_source": int(fused.n_filled_by_source),
        "n_filled_by_target": int(fused.n_filled_by_target),
        "hole_radius": float(fused.hole_radius),
    }


def json_text(document: Mapping[str, Any]) -> str:
    """Return a document as JSON for people: a line for each key, matrices and lists within their line.

    Examples
    --------
    >>> print(json_text({"verdict": "accepted", "fit": {"rmse": 0.1, "of": [1, 2]}}), end="")
    {
      "verdict": "accepted",
      "fit": {
        "rmse": 0.1,
        "of": [1, 2]
      }
    }
    """
    return _json(document, "") + "\n"


def _json(value: Any, indent: str) -> str:
    deeper = indent + "  "
    if isinstance(value, Mapping) and value:
        lines = [
            f"{deeper}{json.dumps(key, ensure_ascii=False)}: {_json(item, deeper)}"
            for key, item in value.items()
        ]
        return "{\n" + ",\n".join(lines) + f"\n{indent}}}"
    if isinstance(value, (list, tuple)) and any(
        isinstance(item, (Mapping, list, tuple, str)) for item in value
    ):
        return "[\n" + ",\n".join(deeper + _json(item, deeper) for item in value) + f"\n{indent}]"
    return json.dumps(value, ensure_ascii=False, allow_nan=False)


def _as_matrix(matrix: ArrayLike) -> NDArray[np.float64]:
    return np.asarray(matrix, dtype=np.float64).reshape(4, 4)


def _digits(value: float) -> str:
    return format(float(value) + 0.0, ".17g")  # the sum turns -0 into 0
