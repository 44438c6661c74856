"""The files that a registration leaves in its folder, and how they get there: all of them or none.

Why one module: the command line, the demo and a script that wants the same files must not differ in a digit.
Numbers are written with as many digits as a float64 has, because a matrix cut to twelve decimals loses
millimetres at national-grid coordinates.
"""

from __future__ import annotations

import hashlib
import json
import os
import platform
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tmchho.cloud import PointCloud
from tmchho.errors import ReadError, WriteError
from tmchho.fused import lacking
from tmchho.io import check_output, check_writable_folder
from tmchho.io.folder import staging, write_together
from tmchho.moving import moved
from tmchho.transform import (
    Transform,
    euler_deg,
    matrix_text,
    pdal_pipeline,
    pdal_text,
    quaternion_wxyz,
    read_matrix,
    transform_document,
)

if TYPE_CHECKING:
    from tmchho.fused import FusedCloud
    from tmchho.results import Registration

__all__ = [
    "FIGURES",
    "FUSED",
    "OUTPUTS",
    "PDAL",
    "REPORT",
    "REPORT_PDF",
    "REPORT_POINTS",
    "RESULT",
    "SOURCE_REGISTERED",
    "TRANSFORM",
    "TRANSFORM_JSON",
    "InputFile",
    "check_folder",
    "euler_deg",
    "fused_counts",
    "json_text",
    "matrix_text",
    "moved_source",
    "pdal_text",
    "pose_files",
    "quaternion_wxyz",
    "read_matrix",
    "result_document",
    "staging",
    "write_together",
]

FUSED = "fused.laz"
SOURCE_REGISTERED = "source_registered.laz"
TRANSFORM = "transform.txt"
TRANSFORM_JSON = "transform.json"
PDAL = "pdal.json"
RESULT = "result.json"
REPORT_POINTS = "report_points.npz"
OUTPUTS = (FUSED, SOURCE_REGISTERED, TRANSFORM, TRANSFORM_JSON, PDAL, RESULT, REPORT_POINTS)
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


def moved_source(registration: Registration, source: PointCloud, target: PointCloud) -> PointCloud:
    """Return the source in the target's frame, with every attribute it had; normals are turned along.

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
    if not finite.all():
        attributes = {name: np.asarray(values)[finite] for name, values in source.attributes.items()}
        source = replace(source, xyz=source.xyz[finite], attributes=attributes)
    return moved(source, registration, crs=target.crs)


def pose_files(
    found: Registration | Transform,
    source: str,
    source_crs: str | None = None,
    target_crs: str | None = None,
    scales: Sequence[float] | None = None,
) -> dict[str, Callable[[Path], object]]:
    """Return what writes ``transform.txt``, ``transform.json`` and ``pdal.json``, for `write_together`.

    Parameters
    ----------
    found : Registration or Transform
        The pose.
    source : str
        The file that the PDAL pipeline reads.
    source_crs, target_crs : str, optional
        Coordinate reference systems as WKT.
    scales : sequence of float, optional
        Steps of the target's coordinates, which the PDAL pipeline keeps to.
    """
    known = Transform.of(found)
    documents = {
        TRANSFORM_JSON: transform_document(known, source_crs=source_crs, target_crs=target_crs),
        PDAL: pdal_pipeline(known, source, SOURCE_REGISTERED, scales=scales, crs=target_crs),
    }
    texts = {TRANSFORM: matrix_text(known.matrix)}
    texts |= {name: json_text(document) for name, document in documents.items()}

    def writer(text: str) -> Callable[[Path], object]:
        return lambda path: path.write_text(text, encoding="utf-8", newline="\n")

    return {name: writer(text) for name, text in texts.items()}


def result_document(
    registration: Registration,
    source: InputFile,
    target: InputFile,
    fused: Mapping[str, Any] | None,
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
    fused : mapping, optional
        What it was fused to, as `fused_counts` tells; None where the pose was rejected.
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
        "fused": None if fused is None else dict(fused),
        "versions": {
            "tmchho": registration.version,
            "numpy": np.__version__,
            "python": platform.python_version(),
        },
        "command": command,
    }
    return document


def fused_counts(fused: FusedCloud, source: PointCloud, target: PointCloud, mode: str) -> dict[str, Any]:
    """Return how many points of the fused cloud come from where, and what they fill, as in ``result.json``.

    Parameters
    ----------
    fused : FusedCloud
        The fused cloud.
    source, target : PointCloud
        What it was fused from.
    mode : {'merge', 'dedup', 'fill_holes'}
        How.
    """
    n_source = int(np.count_nonzero(fused.origin))
    return {
        "n_points": len(fused.points),
        "n_from_target": len(fused.points) - n_source,
        "n_from_source": n_source,
        "n_filled_by_source": int(fused.n_filled_by_source),
        "n_filled_by_target": int(fused.n_filled_by_target),
        "n_repeated": int(fused.n_repeated),
        "area_filled_by_source": float(fused.area_filled_by_source),
        "area_filled_by_target": float(fused.area_filled_by_target),
        "hole_radius": float(fused.hole_radius),
        "mode": mode,
        "no_data": {"source": lacking(source, target), "target": lacking(target, source)},
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
