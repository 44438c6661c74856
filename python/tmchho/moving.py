"""Move files by a known transform: coordinates change, everything else stays as it was."""

from __future__ import annotations

import logging
import os
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tmchho.cloud import PointCloud
from tmchho.errors import WriteError
from tmchho.io import atomic_path, is_las, known_extensions, las_parts, open_las, read, write, writing_las
from tmchho.io.las_grid import Grid, fitted_grid
from tmchho.io.las_stream import LasPoints, las_copy
from tmchho.io.scans import moved_scans
from tmchho.results import Registration
from tmchho.transform import Transform

logger = logging.getLogger(__name__)

StrPath = str | os.PathLike[str]
_NORMALS = ("nx", "ny", "nz")


def moved(
    cloud: PointCloud, transform: Registration | Transform | ArrayLike, *, crs: str | None = None
) -> PointCloud:
    """Return a cloud in target coordinates, with every attribute it had.

    Normals are turned along, and the stations of a laser scan move with their points.

    Parameters
    ----------
    cloud : PointCloud
        In source coordinates.
    transform : Registration, Transform or (4, 4) array_like
        Takes source to target coordinates.
    crs : str, optional
        Coordinate reference system of the target as WKT; where not given, none is told.

    Returns
    -------
    PointCloud
        Points whose coordinates are not finite keep NaN.
    """
    known = Transform.of(transform)
    metadata = moved_scans(cloud.metadata, known.matrix)
    return replace(turned(cloud, known), xyz=known.apply(cloud.xyz), crs=crs, metadata=metadata)


def turned(cloud: PointCloud, transform: Transform) -> PointCloud:
    """Return the cloud with its normals, ``nx ny nz``, turned; its points stay where they are."""
    if not all(name in cloud.attributes for name in _NORMALS):
        return cloud
    attributes = dict(cloud.attributes)
    kinds = [attributes[name].dtype for name in _NORMALS]
    vectors = transform.turn(np.stack([attributes[name] for name in _NORMALS], axis=1))
    for name, kind, values in zip(_NORMALS, kinds, vectors.T, strict=True):
        attributes[name] = values.astype(kind if kind.kind == "f" else np.float64)
    return replace(cloud, attributes=attributes)


def apply_transform(
    transform: Registration | Transform | ArrayLike,
    path: StrPath,
    output: StrPath,
    *,
    crs: str | None = None,
    overwrite: bool = False,
) -> int:
    """Move a file: LAS and LAZ in parts of a million points, so that any size will do, others whole.

    Parameters
    ----------
    transform : Registration, Transform or (4, 4) array_like
        Takes the coordinates of the file to those of the output.
    path : str or path
        File to read.
    output : str or path
        File to write. Where both are LAS or LAZ, all records but the coordinates are kept bit by bit, the
        scale, and the offset unless the moved points are out of its reach.
    crs : str, optional
        Coordinate reference system of the output as WKT; where not given, that of the file is kept.
    overwrite : bool, default False
        Replace an existing file. The file itself is never replaced.

    Returns
    -------
    int
        How many points were moved.

    Raises
    ------
    ReadError, WriteError
        If the one cannot be read or the other cannot be written; no half of a file is left.
    InvalidArgumentError
        If the transform is not rigid, apart from a scale, or an extension is not known.
    """
    known = Transform.of(transform)
    path, output = Path(path), Path(output)
    if not (is_las(path) and output.suffix.lower() in (".las", ".laz")):
        cloud = read(path)
        write(moved(cloud, known, crs=crs or cloud.crs), output, overwrite=overwrite, inputs=[path])
        return len(cloud)
    points = open_las(path)
    if output.suffix.lower() == ".laz" and points.header.has_waveforms:
        raise WriteError(f"{output}: LAZ cannot hold waveforms; choose a name that ends in .las")
    with atomic_path(output, overwrite, [path]) as temporary, writing_las(output):
        if not _copy_moved(points, known, temporary, crs, *_box_in_header(points, known)):
            logger.info("%s: the box in its header is wrong; its points are looked at first", path)
            _copy_moved(points, known, temporary, crs, *_box_of_points(points, known))
    return len(points)


def output_name(path: StrPath) -> str:
    """Return the name of a moved file: its own, as .laz where its format can only be read."""
    path = Path(path)
    if path.name.lower().endswith(".copc.laz"):
        return path.name[: -len(".copc.laz")] + ".laz"
    return path.name if path.suffix.lower() in known_extensions(writable=True) else f"{path.stem}.laz"


def check_names(paths: Iterable[StrPath]) -> None:
    """Raise `WriteError` if two files would get the same name in one folder."""
    seen: dict[str, StrPath] = {}
    for path in paths:
        other = seen.setdefault(output_name(path).lower(), path)
        if other is not path:
            raise WriteError(f"{path}: would be written over the moved {other}; move them one by one")


def _copy_moved(
    points: LasPoints,
    transform: Transform,
    path: Path,
    crs: str | None,
    lowest: NDArray[np.float64],
    highest: NDArray[np.float64],
) -> bool:
    """Write all points, moved; return False where one lies out of reach of the offset."""
    header = points.header
    kept = Grid(np.array(header.scales), np.array(header.offsets))
    grid = kept if kept.holds(lowest, highest) else fitted_grid(lowest, highest, np.abs(kept.scales))
    if grid is not kept:
        logger.warning("%s: a new offset is needed, %s", points.path, grid.offsets.tolist())
    with las_copy(path, points, grid, crs=crs or points.crs) as write_records:
        for records in las_parts(points):
            steps = grid.steps(transform.apply(points.xyz(points.steps(records))))
            if not grid.holds_steps(steps):
                return False
            for index, axis in enumerate("XYZ"):
                records[axis] = steps[:, index]
            write_records(records)
    return True


def _box_in_header(
    points: LasPoints, transform: Transform
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return a box round the moved box of the header, which may be larger than needed, or wrong."""
    low, high = points.header.minima, points.header.maxima
    corners = np.array(np.meshgrid(*zip(low, high, strict=True))).reshape(3, -1).T
    there = transform.apply(np.where(np.isfinite(corners), corners, 0.0))
    return there.min(axis=0), there.max(axis=0)


def _box_of_points(
    points: LasPoints, transform: Transform
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    lowest, highest = np.full(3, np.inf), np.full(3, -np.inf)
    for records in las_parts(points):
        there = transform.apply(points.xyz(points.steps(records)))
        lowest, highest = np.minimum(lowest, there.min(axis=0)), np.maximum(highest, there.max(axis=0))
    return lowest, highest
