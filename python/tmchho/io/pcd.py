"""PCD: the format of the Point Cloud Library, as text, binary or compressed.

Why the coordinates are always written as doubles: in float32 a northing of 4 000 000 m is known to 0.25 m.
Why not a library: the header must be checked here before anything is allocated, and after it the points are
one numpy array; only the LZF compression is left, which ``lzf`` does.

Source: "The PCD (Point Cloud Data) file format", version 0.7, documentation of the Point Cloud Library.
"""

from __future__ import annotations

import logging
import re
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import lzf  # type: ignore[import-not-found, unused-ignore]
import numpy as np
from numpy.typing import NDArray

from tmchho.cloud import PointCloud
from tmchho.errors import ReadError
from tmchho.io.fields import (
    AXES,
    COLOURS,
    attributes_to_write,
    canonical_names,
    cast_if_it_fits,
    cloud_from_columns,
    colours_as_8_bit,
    is_integral,
    record_array,
    split_columns,
)
from tmchho.io.format import Format
from tmchho.io.table import parse_table, write_table

logger = logging.getLogger(__name__)

_ENCODINGS = ("ascii", "binary", "binary_compressed")
_TYPE_LETTERS = {"F": "f", "I": "i", "U": "u"}
_FIRST_KEY = re.compile(rb"#\s*\.PCD|(?:#[^\n]*\n|\s)*(?:VERSION|FIELDS|COLUMNS)[ \t]")
_MAX_HEADER_BYTES = 1 << 16
_MAX_POINT_BYTES = 2**31 - 1  # more, numpy has no type for
_MAX_PACKED = 3 * 2**30  # bytes; the sizes are stored in 32 bits, and packing may add some
_MAX_LZF_RATIO = 100  # a run of 264 bytes takes 3
_PCL_NAMES = {"nx": "normal_x", "ny": "normal_y", "nz": "normal_z"}
_PACKED_COLOURS = {"rgb": COLOURS, "rgba": (*COLOURS, "alpha")}
_SHIFTS = {"red": 16, "green": 8, "blue": 0, "alpha": 24}


@dataclass(frozen=True)
class _Field:
    """One field of a point; `count` values of the numpy type `kind`."""

    name: str
    kind: str
    count: int


@dataclass(frozen=True)
class _Header:
    """What stands before the data."""

    fields: list[_Field]
    n_points: int
    width: int
    height: int
    viewpoint: tuple[float, ...]
    encoding: str
    n_bytes: int
    n_lines: int

    @property
    def row_type(self) -> np.dtype[np.void]:
        """One point as packed fields; numbered, because a file may use one name twice."""
        return np.dtype([(f"f{i}", "<" + field.kind, (field.count,)) for i, field in enumerate(self.fields)])


def _read(path: Path) -> PointCloud:
    header = _read_header(path)
    if header.n_points == 0:
        raise ReadError("contains no points (POINTS 0); choose a file with points")
    with path.open("rb") as stream:
        stream.seek(header.n_bytes)
        body = stream.read()
    if header.encoding == "ascii":
        columns = _text_columns(body, header)
    elif header.encoding == "binary":
        columns = _binary_columns(body, header)
    else:
        columns = _compressed_columns(body, header)
    metadata = {
        "format": "pcd",
        "viewpoint": header.viewpoint,
        "width": header.width,
        "height": header.height,
        "encoding": header.encoding,
    }
    return cloud_from_columns(_named_columns(columns, header), metadata, str(path))


def _read_header(path: Path) -> _Header:
    with path.open("rb") as stream:
        head = stream.read(_MAX_HEADER_BYTES)
    entries: dict[str, list[str]] = {}
    n_bytes = 0
    for number, line in enumerate(head.split(b"\n"), 1):
        n_bytes += len(line) + 1
        words = line.decode("latin-1").split()
        if words and not words[0].startswith("#"):
            entries[words[0].upper()] = words[1:]
        if "DATA" in entries:
            return _parse_header(entries, min(n_bytes, len(head)), number)
    raise ReadError("is not a PCD file or truncated: its header has no DATA line; export it again")


def _parse_header(entries: Mapping[str, list[str]], n_bytes: int, n_lines: int) -> _Header:
    names = entries.get("FIELDS", entries.get("COLUMNS", []))
    sizes = entries.get("SIZE", ["4"] * len(names))
    types = entries.get("TYPE", ["F"] * len(names))
    counts = entries.get("COUNT", ["1"] * len(names))
    if not names or not len(names) == len(sizes) == len(types) == len(counts):
        raise ReadError(
            f"has a broken header: {len(names)} FIELDS, {len(sizes)} SIZE, {len(types)} TYPE, "
            f"{len(counts)} COUNT; export it again"
        )
    fields = []
    for name, size, letter, count in zip(names, sizes, types, counts, strict=True):
        kind = _TYPE_LETTERS.get(letter.upper(), "?") + size
        if (
            kind not in ("f4", "f8", "i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8")
            or not count.isdigit()
            or int(count) == 0
        ):
            raise ReadError(
                f"has the unknown type {letter} {size} × {count} in field '{name}'; export it again"
            )
        fields.append(_Field(name, kind, int(count)))
    n_point_bytes = sum(int(field.kind[1:]) * field.count for field in fields)
    if n_point_bytes > _MAX_POINT_BYTES:
        raise ReadError(f"promises {n_point_bytes} bytes for each point, which cannot be; export it again")
    width = _integer(entries, "WIDTH", 0)
    height = _integer(entries, "HEIGHT", 1)
    n_points = _integer(entries, "POINTS", width * height)
    if "WIDTH" in entries and width * height != n_points:
        raise ReadError(
            f"contradicts itself: {width} × {height} points but POINTS {n_points}; export it again"
        )
    try:
        viewpoint = tuple(float(word) for word in entries.get("VIEWPOINT", []))
    except ValueError:
        viewpoint = ()
    encoding = " ".join(entries["DATA"]).lower()
    if encoding not in _ENCODINGS:
        raise ReadError(f"has the unknown encoding '{encoding}'; export it as ascii or binary")
    return _Header(fields, n_points, width, height, viewpoint, encoding, n_bytes, n_lines)


def _integer(entries: Mapping[str, list[str]], key: str, default: int) -> int:
    words = entries.get(key)
    if words is None:
        return default
    if len(words) != 1 or not words[0].isdigit():
        raise ReadError(f"has a broken header: {key} {' '.join(words)}; export it again")
    return int(words[0])


def _text_columns(body: bytes, header: _Header) -> list[NDArray[Any]]:
    # PDAL separates the values by commas on demand.
    first = body.lstrip().partition(b"\n")[0]
    n_columns = sum(field.count for field in header.fields)
    table = parse_table(
        body.replace(b"\r\n", b"\n").replace(b"\r", b"\n"),
        n_columns,
        separator="," if b"," in first else None,
        first_line=header.n_lines + 1,
        max_rows=header.n_points,
    )
    _check_count(len(table), header)
    columns: list[NDArray[Any]] = []
    start = 0
    for field in header.fields:
        values = table[:, start : start + field.count]
        start += field.count
        # Coordinates keep all their digits even where the header says SIZE 4.
        columns.append(values if field.name.lower() in AXES else cast_if_it_fits(values, field.kind))
    return columns


def _binary_columns(body: bytes, header: _Header) -> list[NDArray[Any]]:
    _check_count(len(body) // header.row_type.itemsize, header)
    rows = np.frombuffer(body, dtype=header.row_type, count=header.n_points)
    return [np.ascontiguousarray(rows[name]) for name in rows.dtype.names or ()]


def _compressed_columns(body: bytes, header: _Header) -> list[NDArray[Any]]:
    """Undo LZF; inside, all values of one field stand together."""
    n_bytes_wanted = header.n_points * header.row_type.itemsize
    if len(body) < 8:
        raise ReadError(f"is truncated: expected {header.n_points} points, file holds 0; copy it again")
    n_packed, n_bytes = struct.unpack_from("<II", body)
    if n_bytes != n_bytes_wanted:
        _check_count(n_bytes // header.row_type.itemsize, header)
        raise ReadError(f"contradicts itself: {n_bytes} bytes for {header.n_points} points; export it again")
    if len(body) - 8 < n_packed:
        raise ReadError(
            f"is truncated: expected {header.n_points} points in {n_packed} compressed bytes, file holds "
            f"{len(body) - 8} bytes; copy it again"
        )
    if n_bytes > n_packed * _MAX_LZF_RATIO:
        raise ReadError(
            f"promises {n_bytes} bytes in {n_packed} compressed ones, which cannot be; export it again"
        )
    data = lzf.decompress(body[8 : 8 + n_packed], n_bytes)
    if data is None or len(data) != n_bytes:
        raise ReadError("is damaged: its compressed points cannot be unpacked; copy or export it again")
    columns: list[NDArray[Any]] = []
    start = 0
    for field in header.fields:
        n_values = header.n_points * field.count
        values = np.frombuffer(data, dtype="<" + field.kind, count=n_values, offset=start)
        columns.append(values.reshape(header.n_points, field.count))
        start += values.nbytes
    return columns


def _check_count(n_held: int, header: _Header) -> None:
    if n_held < header.n_points:
        raise ReadError(
            f"is truncated: expected {header.n_points} points, file holds {n_held}; copy it again"
        )


def _named_columns(columns: list[NDArray[Any]], header: _Header) -> dict[str, NDArray[Any]]:
    """Leave out padding, unpack colours, and give single values one dimension."""
    named: dict[str, NDArray[Any]] = {}
    kept = [
        (field, values) for field, values in zip(header.fields, columns, strict=True) if field.name != "_"
    ]
    names = canonical_names([field.name for field, _ in kept])
    for name, (field, values) in zip(names, kept, strict=True):
        parts = _PACKED_COLOURS.get(name)
        if parts and field.count == 1 and values.dtype.itemsize == 4:
            bits = np.ascontiguousarray(values[:, 0]).view(np.uint32)
            named.update({part: ((bits >> _SHIFTS[part]) & 255).astype(np.uint8) for part in parts})
        else:
            named[name] = values[:, 0] if field.count == 1 else values
    return named


def _write(cloud: PointCloud, path: Path, kept: Mapping[str, Any]) -> None:
    columns: dict[str, NDArray[Any]] = {axis: cloud.xyz[:, index] for index, axis in enumerate(AXES)}
    attributes = _with_packed_colours(colours_as_8_bit(attributes_to_write(cloud)))
    for name, values in attributes.items():
        columns[_PCL_NAMES.get(name, name)] = values.reshape(len(values), -1) if values.ndim > 2 else values
    kinds = [values.dtype for values in columns.values()]
    layout = kept if kept.get("format") == "pcd" else {}
    width, height = layout.get("width", 0), layout.get("height", 0)
    if width * height != len(cloud):
        width, height = len(cloud), 1
    viewpoint = layout.get("viewpoint") or (0, 0, 0, 1, 0, 0, 0)
    lines = [
        "# .PCD v0.7 - Point Cloud Data file format",
        "VERSION 0.7",
        "FIELDS " + " ".join(columns),
        "SIZE " + " ".join(str(kind.itemsize) for kind in kinds),
        "TYPE " + " ".join(kind.kind.upper() for kind in kinds),
        "COUNT " + " ".join(str(values.shape[1] if values.ndim == 2 else 1) for values in columns.values()),
        f"WIDTH {width}",
        f"HEIGHT {height}",
        "VIEWPOINT " + " ".join(str(value) for value in viewpoint),
        f"POINTS {len(cloud)}",
    ]
    encoding = _encoding(layout.get("encoding", "binary"), columns)
    with path.open("wb") as stream:
        stream.write("\n".join([*lines, f"DATA {encoding}\n"]).encode())
        if encoding == "ascii":
            write_table(stream, list(split_columns(columns).values()), b" ")
        elif encoding == "binary":
            stream.write(record_array(columns, kinds, len(cloud)).data)
        else:
            stream.write(_packed(columns))


def _encoding(kept: str, columns: Mapping[str, NDArray[Any]]) -> str:
    """Return the encoding of the file read before, or plain binary where that cannot hold the values."""
    if kept == "binary_compressed" and sum(values.nbytes for values in columns.values()) > _MAX_PACKED:
        logger.warning("compressed PCD holds 4 GB; written without compression")
        return "binary"
    if kept == "ascii" and any(
        values.dtype.kind in "iu" and not is_integral(values, -(2**53), 2**53) for values in columns.values()
    ):
        logger.warning("whole numbers beyond 2^53 lose digits in text; written as binary PCD")
        return "binary"
    return kept


def _packed(columns: Mapping[str, NDArray[Any]]) -> bytes:
    """Return all values of one field after those of the other, compressed by LZF, behind both sizes."""
    plain = b"".join(
        np.ascontiguousarray(values, dtype=values.dtype.newbyteorder("<")).tobytes()
        for values in columns.values()
    )
    # What cannot be compressed grows by a byte for every 32.
    packed: bytes = lzf.compress(plain, len(plain) + len(plain) // 16 + 64)
    return struct.pack("<II", len(packed), len(plain)) + packed


def _with_packed_colours(attributes: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Put 8-bit colours into the one field rgb or rgba that PCL looks for."""
    if any(name not in attributes or attributes[name].dtype != np.uint8 for name in COLOURS):
        return attributes
    has_alpha = "alpha" in attributes and attributes["alpha"].dtype == np.uint8
    parts = _PACKED_COLOURS["rgba" if has_alpha else "rgb"]
    packed = np.zeros(len(attributes["red"]), dtype=np.uint32)
    for part in parts:
        packed |= attributes[part].astype(np.uint32) << np.uint32(_SHIFTS[part])
    rest = {name: values for name, values in attributes.items() if name not in parts}
    return {"rgba" if has_alpha else "rgb": packed, **rest}


FORMAT = Format(
    name="PCD",
    extensions=(".pcd",),
    recognises=lambda head: _FIRST_KEY.match(head) is not None,
    read=_read,
    write=_write,
)
