"""The header of an E57 file and the layout of its scans, checked before the library sees them.

Why not leave it to the library: it believes the number of points, and its parser of XML expands whatever a
file defines.

Source: ASTM E2807-11, "Standard Specification for 3D Imaging Data Exchange"; libE57Format's documentation.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tmchho.errors import ReadError
from tmchho.io.scans import check_pose

SIGNATURE = b"ASTM-E57"
_HEADER = struct.Struct("<8sIIQQQQ")
_CHECKSUM_BYTES = 4  # at the end of every page
_MOST_IN_MEMORY = 100  # times the size of the file; packed coordinates come to about 7
_SMALL_KINDS = ("u1", "i1", "u2", "i2")


@dataclass(frozen=True)
class Field:
    """One value of each point.

    Parameters
    ----------
    name : str
        As in the file, prefix included.
    kind : str
        Numpy type of the values.
    n_bits : int
        Size of one value in the file, 0 where all are the same.
    """

    name: str
    kind: str
    n_bits: int


@dataclass(frozen=True, eq=False)
class ScanHeader:
    """One scan: its name, pose and points, the latter still in the file."""

    name: str
    world_from_scan: NDArray[np.float64]
    fields: tuple[Field, ...]
    n_points: int
    points: Any


def check_file(path: Path) -> None:
    """Raise if the file is cut off or its XML defines entities, which could expand without end.

    Raises
    ------
    ReadError
        With the reason.
    """
    n_bytes = path.stat().st_size
    with path.open("rb") as stream:
        head = stream.read(_HEADER.size)
        if len(head) < _HEADER.size:
            raise ReadError(f"is truncated: {len(head)} bytes are too few for an E57 header; copy it again")
        _, major, minor, n_physical, xml_at, n_xml, page = _HEADER.unpack(head)
        if major != 1:
            raise ReadError(f"has the unknown E57 version {major}.{minor}; export it as E57 1.0")
        if n_physical > n_bytes:
            raise ReadError(f"is truncated: expected {n_physical} bytes, file holds {n_bytes}; copy it again")
        if page != 1024 or not 0 < n_xml <= n_bytes or xml_at > n_bytes:
            raise ReadError(
                f"has a damaged header (XML of {n_xml} bytes at byte {xml_at}, pages of {page} bytes); "
                "copy it again"
            )
        stream.seek(xml_at)
        # The text with the checksums of its pages in it; a definition torn by one is still begun by "<!".
        xml = stream.read(n_xml + (n_xml // (page - _CHECKSUM_BYTES) + 2) * _CHECKSUM_BYTES)
    if xml.count(b"<!") != xml.count(b"<![CDATA[") + xml.count(b"<!--"):
        logical = _without_checksums(xml, xml_at, page)
        if logical.count(b"<!") != logical.count(b"<![CDATA[") + logical.count(b"<!--"):
            raise ReadError("defines entities in its XML, which no scanner does; export it again")


def _without_checksums(data: bytes, start: int, page: int) -> bytes:
    """Return bytes that begin at `start` of the file without the last four of every page."""
    first = page - start % page
    pages = [data[:first], *(data[at : at + page] for at in range(first, len(data), page))]
    return b"".join(part[:-_CHECKSUM_BYTES] for part in pages)


def read_scans(library: ModuleType, image_file: Any, n_bytes: int) -> list[ScanHeader]:
    """Return the scans of an open file.

    Parameters
    ----------
    library : module
        ``pye57.libe57``.
    image_file : libe57.ImageFile
        Open for reading; it has to stay open while the points are read.
    n_bytes : int
        Size of the file.

    Raises
    ------
    ReadError
        If a scan promises more points than the file can hold.
    """
    root = image_file.root()
    if not root.isDefined("data3D"):
        return []
    scans = library.VectorNode(root.get("data3D"))
    headers: list[ScanHeader] = []
    n_left = 8 * n_bytes
    for number in range(scans.childCount()):
        header = _read_scan(library, library.StructureNode(scans.get(number)), number)
        n_bits = max(1, sum(field.n_bits for field in header.fields))
        n_left -= header.n_points * n_bits
        if n_left < 0:
            raise ReadError(
                f"is truncated or damaged: expected {header.n_points} points of {n_bits} bits in scan "
                f"{number + 1}, file holds {n_bytes} bytes; copy it again"
            )
        headers.append(header)
    # Values that are the same for all points take no room in the file, but do in memory.
    n_needed = sum(
        header.n_points * sum(np.dtype(field.kind).itemsize for field in header.fields) for header in headers
    )
    if n_needed > _MOST_IN_MEMORY * n_bytes:
        raise ReadError(f"would grow from {n_bytes} to {n_needed} bytes, which cannot be; export it again")
    return headers


def _read_scan(library: ModuleType, node: Any, number: int) -> ScanHeader:
    name = library.StringNode(node.get("name")).value() if node.isDefined("name") else ""
    if not node.isDefined("points"):
        return ScanHeader(name, np.eye(4), (), 0, None)
    points = library.CompressedVectorNode(node.get("points"))
    prototype = library.StructureNode(points.prototype())
    fields = tuple(_field(library, prototype.get(index)) for index in range(prototype.childCount()))
    return ScanHeader(name, _pose(library, node, number), fields, points.childCount(), points)


def _field(library: ModuleType, node: Any) -> Field:
    name, kind = node.elementName(), node.type()
    if kind == library.NodeType.E57_FLOAT:
        is_single = library.FloatNode(node).precision() == library.FloatPrecision.E57_SINGLE
        return Field(name, "f4", 32) if is_single else Field(name, "f8", 64)
    if kind == library.NodeType.E57_INTEGER:
        whole = library.IntegerNode(node)
        return Field(name, _smallest_kind(whole.minimum(), whole.maximum()), _n_bits(whole))
    if kind == library.NodeType.E57_SCALED_INTEGER:
        return Field(name, "f8", _n_bits(library.ScaledIntegerNode(node)))
    raise ReadError(f"has points with a '{name}' that is not a number; export it again")


def _n_bits(node: Any) -> int:
    return max(0, int(node.maximum()) - int(node.minimum())).bit_length()


def _smallest_kind(lowest: int, highest: int) -> str:
    for kind in _SMALL_KINDS:
        if np.iinfo(kind).min <= lowest and highest <= np.iinfo(kind).max:
            return kind
    return "i8"


def buffer_type(values: np.dtype[Any]) -> np.dtype[Any]:
    """Return the type through which the library takes and gives values.

    Long integers go as "long long": it takes numpy's int64 for an int32 where that is a C "long".
    """
    return values if values.kind == "f" or values.itemsize <= 2 else np.dtype(np.longlong)


def first_words(error: BaseException) -> str:
    """Return what an error of the library says before it goes into its own source code."""
    return " ".join(str(error).partition("****")[0].split())[:150]


def _pose(library: ModuleType, node: Any, number: int) -> NDArray[np.float64]:
    """Return the pose of a scan, the identity where it has none."""
    matrix = np.eye(4)
    if not node.isDefined("pose"):
        return matrix
    pose = library.StructureNode(node.get("pose"))
    if pose.isDefined("translation"):
        matrix[:3, 3] = _numbers(library, pose.get("translation"), "xyz")
    if pose.isDefined("rotation"):
        matrix[:3, :3] = _rotation(_numbers(library, pose.get("rotation"), "wxyz"))
    check_pose(matrix, number)
    return matrix


def _numbers(library: ModuleType, node: Any, names: str) -> list[float]:
    structure = library.StructureNode(node)
    return [_value(library, structure.get(name)) for name in names]


def _value(library: ModuleType, node: Any) -> float:
    kind = node.type()
    if kind == library.NodeType.E57_INTEGER:
        return float(library.IntegerNode(node).value())
    if kind == library.NodeType.E57_SCALED_INTEGER:
        return float(library.ScaledIntegerNode(node).scaledValue())
    return float(library.FloatNode(node).value())


def _rotation(quaternion: list[float]) -> NDArray[np.float64]:
    """Return the matrix of a quaternion (w, x, y, z) of any length; NaN for one without length."""
    with np.errstate(invalid="ignore", divide="ignore"):
        w, x, y, z = np.array(quaternion) / np.linalg.norm(quaternion)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
