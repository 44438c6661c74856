"""E57: writing, one scan for each station, coordinates as doubles in the scanner's frame.

Source: ASTM E2807-11, "Standard Specification for 3D Imaging Data Exchange"; libE57Format's documentation.
"""

from __future__ import annotations

import importlib
import logging
import re
from collections.abc import Mapping
from pathlib import Path
from types import ModuleType
from typing import Any
from uuid import uuid4

import numpy as np
from numpy.typing import NDArray

from tmchho.cloud import PointCloud
from tmchho.errors import WriteError
from tmchho.io.e57_header import buffer_type, first_words
from tmchho.io.fields import COLOURS, attributes_to_write, is_integral, split_columns
from tmchho.io.scans import COLUMN, ROW, SCAN_INDEX, Scan, split

logger = logging.getLogger(__name__)

MISSING_LIBRARY = "is E57, for which the package pye57 is needed; install it with pip install 'tmchho[e57]'"
_POINTS_AT_ONCE = 1_000_000
_AXES = ("cartesianX", "cartesianY", "cartesianZ")
_NORMALS = {"nx": "nor:normalX", "ny": "nor:normalY", "nz": "nor:normalZ"}
_NAMES = {
    **{"intensity": "intensity", "red": "colorRed", "green": "colorGreen", "blue": "colorBlue"},
    **{ROW: "rowIndex", COLUMN: "columnIndex", "time_stamp": "timeStamp"},
    **{"return_number": "returnIndex", "number_of_returns": "returnCount"},
    **_NORMALS,
}
_PREFIXES = {
    "": "http://www.astm.org/COMMIT/E57/2010-e57-v1.0",
    "nor": "http://www.libe57.org/E57_NOR_surface_normals.txt",
    "tmchho": "urn:tmchho:attributes",  # of all that the standard has no name for
}
_FORMAT_NAME = "ASTM E57 3D Imaging Data File"


def write_e57(cloud: PointCloud, path: Path, kept: Mapping[str, Any]) -> None:
    """Write the scans that ``scan_index`` tells apart, at the stations that `kept` knows of."""
    try:
        library = importlib.import_module("pye57.libe57")
    except ImportError as error:
        raise WriteError(MISSING_LIBRARY) from error
    columns = _named(split_columns(attributes_to_write(cloud)))
    image_file = library.ImageFile(str(path), "w")
    try:
        root = image_file.root()
        for prefix, uri in _PREFIXES.items():
            image_file.extensionsAdd(prefix, uri)
        nodes = _Nodes(library, image_file)
        root.set("formatName", nodes.text(_FORMAT_NAME))
        root.set("guid", nodes.text(f"{{{uuid4()}}}"))
        root.set("versionMajor", nodes.whole(1))
        root.set("versionMinor", nodes.whole(0))
        root.set("coordinateMetadata", nodes.text(cloud.crs or ""))
        scans = library.VectorNode(image_file, True)
        root.set("data3D", scans)
        root.set("images2D", library.VectorNode(image_file, True))
        for scan, rows in split(cloud, kept):
            own = {name: values[rows] for name, values in columns.items()}
            _write_scan(nodes, scans, scan, scan.from_world(cloud.xyz[rows]), own)
    except BaseException as error:
        image_file.cancel()  # removes the half-written file
        if isinstance(error, library.E57Exception):
            raise WriteError(
                f"the cloud cannot be written as E57 ({first_words(error)}); check the disk or try .laz"
            ) from error
        raise
    image_file.close()


class _Nodes:
    """Makes the nodes of one file."""

    def __init__(self, library: ModuleType, image_file: Any) -> None:
        self.library = library
        self.image_file = image_file

    def text(self, value: str) -> Any:
        return self.library.StringNode(self.image_file, value)

    def whole(self, value: int) -> Any:
        return self.library.IntegerNode(self.image_file, value)

    def number(self, value: float) -> Any:
        return self.library.FloatNode(self.image_file, value)

    def structure(self, values: Mapping[str, Any]) -> Any:
        node = self.library.StructureNode(self.image_file)
        for name, value in values.items():
            node.set(name, value)
        return node

    def field(self, values: NDArray[Any]) -> Any:
        """Return the node that describes one field of the points."""
        if values.dtype.kind == "f":
            kinds = self.library.FloatPrecision
            precision = kinds.E57_SINGLE if values.dtype.itemsize == 4 else kinds.E57_DOUBLE
            limit = float(np.finfo(values.dtype).max)
            return self.library.FloatNode(self.image_file, 0.0, precision, -limit, limit)
        lowest, highest = int(values.min()), int(values.max())
        return self.library.IntegerNode(self.image_file, lowest, lowest, highest)


def _named(attributes: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Return the attributes under the names of the standard, or of our own extension to it."""
    columns: dict[str, NDArray[Any]] = {}
    for key, values in attributes.items():
        if key == SCAN_INDEX:
            continue
        name = _NAMES.get(key) or "tmchho:" + re.sub(r"[^\w.-]", "_", key, flags=re.ASCII)
        if name in columns:
            raise WriteError(f"two attributes would both be called '{name}' in E57; rename '{key}'")
        if values.dtype == np.uint64 and not is_integral(values, 0, 2**63 - 1):
            raise WriteError(f"E57 cannot hold the large integers of attribute '{key}'; choose .laz or .npy")
        columns[name] = values.astype(np.int64) - 1 if name == "returnIndex" else values
    return columns


def _write_scan(
    nodes: _Nodes, scans: Any, scan: Scan, local: NDArray[np.float64], columns: dict[str, NDArray[Any]]
) -> None:
    fields = {**{name: local[:, axis] for axis, name in enumerate(_AXES)}, **columns}
    node = nodes.structure(
        {
            "guid": nodes.text(f"{{{uuid4()}}}"),
            "name": nodes.text(scan.name),
            "pose": _pose(nodes, scan.world_from_scan),
            "cartesianBounds": _limits(nodes, {f"{axis}": local[:, i] for i, axis in enumerate("xyz")}),
        }
    )
    if "intensity" in fields:
        node.set("intensityLimits", _limits(nodes, {"intensity": fields["intensity"]}))
    colours = [_NAMES[name] for name in COLOURS]
    if all(name in fields for name in colours):
        node.set("colorLimits", _colour_limits(nodes, {name: fields[name] for name in colours}))
    prototype = nodes.structure({name: nodes.field(values) for name, values in fields.items()})
    codecs = nodes.library.VectorNode(nodes.image_file, True)
    points = nodes.library.CompressedVectorNode(nodes.image_file, prototype, codecs)
    node.set("points", points)
    scans.append(node)

    n_at_once = min(len(local), _POINTS_AT_ONCE)
    buffers, parts = nodes.library.VectorSourceDestBuffer(), {}
    for name, values in fields.items():
        parts[name] = np.empty(n_at_once, dtype=buffer_type(values.dtype))
        buffers.append(
            nodes.library.SourceDestBuffer(nodes.image_file, name, parts[name], n_at_once, True, True)
        )
    writer = points.writer(buffers)
    try:
        for start in range(0, len(local), n_at_once):
            n_points = min(n_at_once, len(local) - start)
            for name, values in fields.items():
                parts[name][:n_points] = values[start : start + n_points]
            writer.write(n_points)
        writer.close()
    finally:
        del writer  # after an error it must be gone before the file is, or the library ends the program


def _limits(nodes: _Nodes, columns: Mapping[str, NDArray[Any]]) -> Any:
    limits = {}
    for name, values in columns.items():
        finite = values[np.isfinite(values)]
        limits[f"{name}Minimum"] = nodes.number(float(finite.min()) if len(finite) else 0.0)
        limits[f"{name}Maximum"] = nodes.number(float(finite.max()) if len(finite) else 0.0)
    return nodes.structure(limits)


def _colour_limits(nodes: _Nodes, columns: Mapping[str, NDArray[Any]]) -> Any:
    """Return what colours run to, which tells readers their depth: not the values that occur."""
    limits = {}
    for name, values in columns.items():
        highest = int(np.iinfo(values.dtype).max) if values.dtype in (np.uint8, np.uint16) else None
        limits[f"{name}Minimum"] = nodes.whole(0) if highest else nodes.number(0.0)
        top = float(values.max(initial=1)) if highest is None else 0.0
        limits[f"{name}Maximum"] = nodes.whole(highest) if highest else nodes.number(top)
    return nodes.structure(limits)


def _pose(nodes: _Nodes, matrix: NDArray[np.float64]) -> Any:
    rotation = dict(zip("wxyz", map(nodes.number, _quaternion(matrix[:3, :3])), strict=True))
    translation = dict(zip("xyz", map(nodes.number, matrix[:3, 3].tolist()), strict=True))
    return nodes.structure(
        {"rotation": nodes.structure(rotation), "translation": nodes.structure(translation)}
    )


def _quaternion(rotation: NDArray[np.float64]) -> list[float]:
    """Return (w, x, y, z) of a rotation: the eigenvector of its symmetric matrix, exact for all angles."""
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = rotation
    symmetric = np.array(
        [
            [xx + yy + zz, zy - yz, xz - zx, yx - xy],
            [zy - yz, xx - yy - zz, xy + yx, xz + zx],
            [xz - zx, xy + yx, yy - xx - zz, yz + zy],
            [yx - xy, xz + zx, yz + zy, zz - xx - yy],
        ]
    )
    quaternion = np.linalg.eigh(symmetric)[1][:, -1]
    return [float(value) for value in (quaternion if quaternion[0] >= 0 else -quaternion)]
