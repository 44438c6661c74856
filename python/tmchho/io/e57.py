"""E57: scans of terrestrial scanners, each with a pose. `e57_header` checks, `e57_write` writes.

Why every field is read: intensity, colour, time and the place in the scanner's grid were paid for, too. Why
the points are joined: a registration needs them in one frame; `tmchho.io.scans` keeps the stations.

The library, pye57, is an extra: it brings a compiled libE57Format.
"""

from __future__ import annotations

import importlib
import re
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tmchho.cloud import PointCloud
from tmchho.errors import ReadError
from tmchho.io.e57_header import (
    SIGNATURE,
    Field,
    ScanHeader,
    buffer_type,
    check_file,
    first_words,
    read_scans,
)
from tmchho.io.e57_write import MISSING_LIBRARY, write_e57
from tmchho.io.fields import canonical_names
from tmchho.io.format import Format, starts_with
from tmchho.io.scans import COLUMN, ROW, Scan, joined, valid_points

_CARTESIAN = ("cartesianX", "cartesianY", "cartesianZ")
_SPHERICAL = ("sphericalRange", "sphericalAzimuth", "sphericalElevation")
_INVALID = {_CARTESIAN: "cartesianInvalidState", _SPHERICAL: "sphericalInvalidState"}
_POINTS_AT_ONCE = 1_000_000

# Names of this package for those of the standard; returns are counted from 0 there and from 1 here.
_NAMES = {
    **{"colorRed": "red", "colorGreen": "green", "colorBlue": "blue"},
    **{"rowIndex": ROW, "columnIndex": COLUMN, "timeStamp": "time_stamp"},
    **{"returnIndex": "return_number", "returnCount": "number_of_returns"},
}


def _library() -> ModuleType:
    try:
        return importlib.import_module("pye57.libe57")
    except ImportError as error:
        raise ReadError(MISSING_LIBRARY) from error


def _read(path: Path) -> PointCloud:
    library = _library()
    check_file(path)
    try:
        # Not `pye57.E57`, which may delete a file that it cannot open.
        image_file = library.ImageFile(str(path), "r")
        try:
            return _read_all(library, image_file, path)
        finally:
            image_file.close()
    except library.E57Exception as error:
        words = first_words(error)
        if "checksum" in words:
            raise ReadError("is damaged: the checksum of one of its pages is wrong; copy it again") from error
        raise ReadError(f"is damaged or not valid E57 ({words}); export it again") from error


def _read_all(library: ModuleType, image_file: Any, path: Path) -> PointCloud:
    headers = read_scans(library, image_file, path.stat().st_size)
    parts: list[PointCloud] = []
    scans: list[Scan] = []
    for number, header in enumerate(headers):
        if header.n_points == 0:
            continue
        scan = Scan(header.name, header.world_from_scan)
        part = _read_scan(library, image_file, header, scan, number, path)
        if len(part):
            parts.append(part)
            scans.append(scan)
    if not parts:
        promised = sum(header.n_points for header in headers)
        which = f"its {promised} points are all invalid" if promised else f"it has {len(headers)} scans"
        raise ReadError(f"contains no points ({which}); choose a file with points")
    return replace(joined(parts, scans, {"format": "e57"}), crs=_crs(library, image_file))


def _crs(library: ModuleType, image_file: Any) -> str | None:
    """Return the coordinate reference system of the file where it is stated as WKT, as the standard asks."""
    root = image_file.root()
    if not root.isDefined("coordinateMetadata"):
        return None
    text = str(library.StringNode(root.get("coordinateMetadata")).value()).strip()
    return text if re.match(r"[A-Z]+_?(CS|CRS)\s*\[", text) else None


def _read_scan(
    library: ModuleType, image_file: Any, header: ScanHeader, scan: Scan, number: int, path: Path
) -> PointCloud:
    names = [field.name for field in header.fields]
    system = next((system for system in (_CARTESIAN, _SPHERICAL) if set(system) <= set(names)), None)
    if system is None:
        raise ReadError(
            f"has no coordinates in scan {number + 1}, only {' '.join(names) or 'no fields'}; export it again"
        )
    columns = _read_fields(library, image_file, header, number)
    local = np.empty((header.n_points, 3))
    for axis, name in enumerate(system):
        local[:, axis] = columns.pop(name)
    if system is _SPHERICAL:
        local = _cartesian(local)
    state = columns.pop(_INVALID[system], None)
    is_valid = np.ones(header.n_points, dtype=bool) if state is None else state == 0
    # Spherical coordinates beside Cartesian ones say the same, and would be wrong once the points move.
    columns = {key: values for key, values in columns.items() if key not in (*_SPHERICAL, *_INVALID.values())}
    return valid_points(scan.to_world(local), _attributes(columns), is_valid, str(path), number)


def _read_fields(
    library: ModuleType, image_file: Any, header: ScanHeader, number: int
) -> dict[str, NDArray[Any]]:
    n_at_once = min(header.n_points, _POINTS_AT_ONCE)
    buffers, wanted = library.VectorSourceDestBuffer(), []
    for field in header.fields:
        values = np.empty(n_at_once, dtype=buffer_type(np.dtype(_kind(field))))
        wanted.append((field, values))
        buffers.append(library.SourceDestBuffer(image_file, field.name, values, n_at_once, True, True))
    columns = {field.name: np.empty(header.n_points, dtype=_kind(field)) for field in header.fields}
    reader = header.points.reader(buffers)
    n_done = 0
    try:
        while n_done < header.n_points:
            n_read = reader.read()
            if n_read == 0:
                raise ReadError(
                    f"is truncated: expected {header.n_points} points in scan {number + 1}, "
                    f"file holds {n_done}; copy it again"
                )
            for field, values in wanted:
                columns[field.name][n_done : n_done + n_read] = values[:n_read]
            n_done += n_read
        reader.close()
    finally:
        del reader  # before the file is closed, whatever happened
    return columns


def _kind(field: Field) -> str:
    # Coordinates may be asked for with more digits than they have, so that all that follows is float64.
    return "f8" if field.name in (*_CARTESIAN, *_SPHERICAL) else field.kind


def _cartesian(spherical: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return x, y, z of range, azimuth and elevation (radians; the elevation is 0 at the horizon)."""
    distance, azimuth, elevation = spherical.T
    level = distance * np.cos(elevation)
    return np.column_stack([level * np.cos(azimuth), level * np.sin(azimuth), distance * np.sin(elevation)])


def _attributes(columns: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Give the fields the names of this package, without the prefixes of extensions."""
    attributes: dict[str, NDArray[Any]] = {}
    first, counts = columns.get("returnIndex"), columns.get("returnCount")
    # Some programs count from 1 against the standard: then the last return is beyond the count.
    is_off = first is not None and counts is not None and bool((first >= counts).any())
    local_names = [_NAMES.get(name, name.rpartition(":")[2]) for name in columns]
    for name, values in zip(canonical_names(local_names), columns.values(), strict=True):
        attributes[name] = values + 1 if name == "return_number" and not is_off else values
    return attributes


FORMAT = Format(
    name="E57",
    extensions=(".e57",),
    recognises=starts_with(SIGNATURE),
    read=_read,
    write=write_e57,
)
