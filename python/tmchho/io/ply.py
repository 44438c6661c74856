"""PLY: the Stanford polygon format, of which only the vertices are read.

Why not a library: the header must be read here anyway, because real files carry stray lines in it and hostile
ones promise more than they hold; after it, the vertices are one numpy array. Faces, range grids and other
elements after the vertices are never touched.

Source: G. Turk, "The PLY Polygon File Format" (1994).
"""

from __future__ import annotations

import logging
import struct
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tmchho.cloud import PointCloud
from tmchho.errors import ReadError, WriteError
from tmchho.io.fields import (
    AXES,
    attributes_to_write,
    canonical_names,
    cast_if_it_fits,
    cloud_from_columns,
    colours_as_8_bit,
    is_integral,
    record_array,
    split_columns,
)
from tmchho.io.format import Format, starts_with
from tmchho.io.table import parse_table, write_table

logger = logging.getLogger(__name__)

_TYPES = {
    **{"char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "bool": "u1"},
    **{"short": "i2", "int16": "i2", "ushort": "u2", "uint16": "u2"},
    **{"int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "int64": "i8", "uint64": "u8"},
    **{"float": "f4", "float32": "f4", "double": "f8", "float64": "f8"},
}
_TYPE_NAMES = {
    **{"i1": "char", "u1": "uchar", "i2": "short", "u2": "ushort", "i4": "int", "u4": "uint"},
    **{"f4": "float", "f8": "double"},
}
_BYTE_ORDERS = {"ascii": None, "binary_little_endian": "<", "binary_big_endian": ">"}
_MAX_HEADER_BYTES = 1 << 20


@dataclass
class _Element:
    """One ``element`` of the header with its properties."""

    name: str
    count: int
    properties: list[tuple[str, str]] = field(default_factory=list)  # name, numpy type; without lists
    layout: list[tuple[str | None, str]] = field(default_factory=list)  # type of a list's count, of values

    @property
    def has_list(self) -> bool:
        """Whether its rows differ in length."""
        return any(count is not None for count, _ in self.layout)


@dataclass
class _Header:
    """What stands before the data."""

    byte_order: str | None  # None: text
    elements: list[_Element]
    comments: list[str]
    n_bytes: int
    n_lines: int


def _read(path: Path) -> PointCloud:
    header = _read_header(path)
    index = next((i for i, element in enumerate(header.elements) if element.name == "vertex"), None)
    if index is None:
        others = ", ".join(element.name for element in header.elements) or "none"
        raise ReadError(f"has no vertices, only the elements: {others}; export the points as 'vertex'")
    before, vertex = header.elements[:index], header.elements[index]
    is_text = header.byte_order is None
    if vertex.has_list:
        raise ReadError("has lists of variable length among the vertices; export the vertices alone")
    if vertex.count == 0:
        raise ReadError("contains no points (element vertex 0); choose a file with points")
    if not vertex.properties:
        raise ReadError("names no properties of its vertices; export it again")
    if is_text:
        columns = _read_text(path, header, sum(element.count for element in before), vertex)
    else:
        columns = _read_binary(path, header, before, vertex)
    names = canonical_names([name for name, _ in vertex.properties])
    metadata = {"format": "ply", "comments": tuple(header.comments), "byte_order": header.byte_order}
    return cloud_from_columns(dict(zip(names, columns, strict=True)), metadata, str(path))


def _read_header(path: Path) -> _Header:
    with path.open("rb") as stream:
        head = stream.read(_MAX_HEADER_BYTES)
    # The end of the first line tells how all header lines end; old Macintosh files use a lone return.
    first = head.replace(b"\r", b"\n").partition(b"\n")[0]
    line_end = next((end for end in (b"\r\n", b"\n", b"\r") if head.startswith(first + end)), b"\n")
    if first.strip() != b"ply":
        raise ReadError("is not a PLY file: its first line is not 'ply'")
    lines: list[str] = []
    n_bytes = 0
    for line in head.split(line_end):
        n_bytes += len(line) + len(line_end)
        lines.append(line.decode("utf-8", errors="replace").strip())
        if lines[-1] == "end_header":
            return _parse_header(lines, min(n_bytes, len(head)))
    raise ReadError("is truncated: its header has no 'end_header' line; copy or export it again")


def _parse_header(lines: list[str], n_bytes: int) -> _Header:
    encoding = ""
    elements: list[_Element] = []
    comments: list[str] = []
    for number, line in enumerate(lines[1:-1], 2):
        words = line.split()
        match words:
            case ["format", encoding, *_]:
                pass
            case ["comment" | "obj_info", *_]:
                comments.append(line)
            case ["element", name, count] if count.isdigit():
                elements.append(_Element(name, int(count)))
            case ["property", "list", count, kind, _] if elements and {count, kind} <= set(_TYPES):
                elements[-1].layout.append((_TYPES[count], _TYPES[kind]))
            case ["property", kind, name] if elements and kind in _TYPES:
                elements[-1].properties.append((name, _TYPES[kind]))
                elements[-1].layout.append((None, _TYPES[kind]))
            case ["element" | "property", *_]:
                raise ReadError(
                    f"line {number} of the header is not understood: '{line[:60]}'; export it again"
                )
            case _:
                logger.debug("header line %d is ignored: %r", number, line)
    if encoding not in _BYTE_ORDERS:
        raise ReadError(f"has the unknown encoding '{encoding}'; export it as ascii or binary")
    return _Header(_BYTE_ORDERS[encoding], elements, comments, n_bytes, len(lines))


def _read_text(path: Path, header: _Header, n_skipped: int, vertex: _Element) -> list[NDArray[Any]]:
    body = path.read_bytes()[header.n_bytes :].replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    body = body.split(b"\n", n_skipped)[-1]
    first_line = header.n_lines + n_skipped + 1
    table = parse_table(body, len(vertex.properties), first_line=first_line, max_rows=vertex.count)
    if len(table) < vertex.count:
        raise ReadError(
            f"is truncated: expected {vertex.count} points, file holds {len(table)}; copy it again"
        )
    # Coordinates keep all their digits even where the header says float.
    return [
        table[:, index] if name.lower() in AXES else cast_if_it_fits(table[:, index], kind)
        for index, (name, kind) in enumerate(vertex.properties)
    ]


def _read_binary(path: Path, header: _Header, before: list[_Element], vertex: _Element) -> list[NDArray[Any]]:
    start = header.n_bytes
    for element in before:
        start = _end_of(path, start, element, str(header.byte_order))
    row_type = _row_type(vertex, str(header.byte_order))
    n_held = max(0, path.stat().st_size - start) // row_type.itemsize
    if n_held < vertex.count:
        raise ReadError(f"is truncated: expected {vertex.count} points, file holds {n_held}; copy it again")
    rows = np.fromfile(path, dtype=row_type, count=vertex.count, offset=start)
    return [
        np.ascontiguousarray(rows[f"f{index}"], dtype=kind)
        for index, (_, kind) in enumerate(vertex.properties)
    ]


def _end_of(path: Path, start: int, element: _Element, byte_order: str) -> int:
    """Return the byte behind an element that stands before the vertices."""
    if not element.has_list:
        return start + element.count * _row_type(element, byte_order).itemsize
    layout = [
        (None if count is None else struct.Struct(byte_order + np.dtype(count).char), np.dtype(kind).itemsize)
        for count, kind in element.layout
    ]
    n_file = path.stat().st_size
    # Read, not mapped: where another program cuts a mapped file short, the system ends the process.
    with path.open("rb") as stream:
        stream.seek(start)
        for _ in range(element.count):  # row by row, because each may have another length
            for count, n_bytes in layout:
                n_values = 1
                if count is not None:
                    head = stream.read(count.size)
                    if len(head) < count.size:
                        raise ReadError(f"is truncated in its element '{element.name}'; copy it again")
                    (n_values,) = count.unpack(head)
                if not 0 <= n_values <= n_file:
                    raise ReadError(
                        f"has a list of {n_values} values in its element '{element.name}'; export it again"
                    )
                stream.seek(int(n_values) * n_bytes, 1)
        return stream.tell()


def _row_type(element: _Element, byte_order: str) -> np.dtype[np.void]:
    # Numbered fields, because a file may use one name twice.
    return np.dtype([(f"f{i}", byte_order + kind) for i, (_, kind) in enumerate(element.properties)])


def _write(cloud: PointCloud, path: Path, kept: Mapping[str, Any]) -> None:
    with writing_ply_parts(path, cloud, len(cloud), kept) as put:
        put(cloud)


@contextmanager
def writing_ply_parts(
    path: Path, first: PointCloud, n_points: int, kept: Mapping[str, Any]
) -> Iterator[Callable[[PointCloud], None]]:
    """Open a file for clouds with the attributes of `first`; lends what writes one of them after another."""
    kinds = {name: values.dtype.str[1:] for name, values in _columns(first).items()}
    layout = kept if kept.get("format") == "ply" else {}
    comments, byte_order = layout.get("comments", ()), layout.get("byte_order", "<")
    encoding = next(name for name, order in _BYTE_ORDERS.items() if order == byte_order)
    lines = [
        "ply",
        f"format {encoding} 1.0",
        *comments,
        f"element vertex {n_points}",
        *(f"property {_TYPE_NAMES[kind]} {name}" for name, kind in kinds.items()),
        "end_header\n",
    ]
    with path.open("wb") as stream:
        stream.write("\n".join(lines).encode())

        def put(part: PointCloud) -> None:
            columns = _columns(part)
            if byte_order is None:
                write_table(stream, list(columns.values()), b" ")
            else:
                stream.write(record_array(columns, map(np.dtype, kinds.values()), len(part), byte_order).data)

        yield put


def _columns(cloud: PointCloud) -> dict[str, NDArray[Any]]:
    columns: dict[str, NDArray[Any]] = {axis: cloud.xyz[:, index] for index, axis in enumerate(AXES)}
    attributes = split_columns(colours_as_8_bit(attributes_to_write(cloud)))
    columns.update({name: _without_long_integers(name, values) for name, values in attributes.items()})
    return columns


def _without_long_integers(name: str, values: NDArray[Any]) -> NDArray[Any]:
    """Return 64-bit integers, which PLY lacks, as int32, uint32 or double, whichever holds them exactly."""
    if values.dtype.kind not in "iu" or values.dtype.itemsize < 8:
        return values
    for kind in (np.int32, np.uint32):
        if is_integral(values, np.iinfo(kind).min, np.iinfo(kind).max):
            return values.astype(kind)
    if not is_integral(values, -(2**53), 2**53):
        raise WriteError(f"PLY cannot hold the 64-bit integers of attribute '{name}'; choose .las or .npy")
    return values.astype(np.float64)


FORMAT = Format(
    name="PLY",
    extensions=(".ply",),
    recognises=starts_with(b"ply\n", b"ply\r", b"ply "),
    read=_read,
    write=_write,
)
