"""The header of a LAS or LAZ file, checked against the file before anything is allocated.

Why not leave it to laspy: its reader trusts the header, and a few wrong bytes make it reserve gigabytes, loop
over billions of records or stop the decoder by a panic. Reading the records here also keeps their bytes.

Source: ASPRS, "LAS Specification 1.4 - R15" (2019), tables 3 to 7; M. Isenburg, "LASzip" (2013).
"""

from __future__ import annotations

import logging
import math
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from tmchho.errors import ReadError

logger = logging.getLogger(__name__)

SIGNATURE = b"LASF"
POINT_BYTES = (20, 28, 26, 34, 57, 63, 30, 36, 38, 59, 67)  # of point formats 0 to 10, without extra bytes
EXTRA_BYTES = ("LASF_Spec", 4)
WAVEFORMS = ("LASF_Spec", 65535)
LASZIP = ("laszip encoded", 22204)
WKT = ("LASF_Projection", 2112)
GEO_KEYS = ("LASF_Projection", 34735)

_SMALLEST_HEADER = 227
_HEADER_1_4 = 375
_VLR_HEAD = struct.Struct("<2x16sHH32s")
_EVLR_HEAD = struct.Struct("<2x16sHQ32s")


@dataclass(frozen=True)
class Record:
    """A variable length record (VLR): who defined it, its number, and its bytes."""

    user_id: str
    record_id: int
    description: str
    data: bytes

    @property
    def key(self) -> tuple[str, int]:
        """Owner and number, which say what the record is."""
        return (self.user_id, self.record_id)


@dataclass(frozen=True)
class LasHeader:
    """What a LAS file says about itself, and what a writer needs to make one like it.

    Parameters
    ----------
    version : (int, int)
        Major and minor version.
    point_format, point_bytes : int
        Number of the point format and size of one point, extra bytes included.
    is_compressed : bool
        Whether the points are LAZ.
    n_points, points_at : int
        How many points there are, and where in the file they begin.
    scales, offsets, minima, maxima : (3,) tuples of float
        Coordinates are ``integer * scale + offset``; their bounds as the file states them.
    file_source_id, global_encoding : int
        As in the file.
    project_id : bytes
        The 16 bytes of the GUID.
    system_identifier, generating_software : str
        As in the file, without the trailing zeros.
    creation_day, creation_year : int
        Day of the year from 1, and year; 0 where unknown.
    records, extended_records : tuple of Record
        The VLRs before the points and the extended ones after them.
    """

    version: tuple[int, int]
    point_format: int
    point_bytes: int
    is_compressed: bool
    n_points: int
    points_at: int
    scales: tuple[float, ...]
    offsets: tuple[float, ...]
    minima: tuple[float, ...]
    maxima: tuple[float, ...]
    file_source_id: int
    global_encoding: int
    project_id: bytes
    system_identifier: str
    generating_software: str
    creation_day: int
    creation_year: int
    records: tuple[Record, ...]
    extended_records: tuple[Record, ...]

    def find(self, key: tuple[str, int]) -> bytes | None:
        """Return the bytes of the first record with that owner and number, None if there is none."""
        for record in (*self.records, *self.extended_records):
            if record.key == key:
                return record.data
        return None

    def find_all(self, key: tuple[str, int]) -> bytes:
        """Return the bytes of all records with that owner and number, one after the other."""
        return b"".join(
            record.data for record in (*self.records, *self.extended_records) if record.key == key
        )


def read_header(path: Path) -> LasHeader:
    """Read the header with its records, and check that the file can hold what it promises.

    Raises
    ------
    ReadError
        If the header is cut off, contradicts itself or promises more than the file holds.
    """
    n_bytes = path.stat().st_size
    with path.open("rb") as stream:
        head = stream.read(_HEADER_1_4)
        if len(head) < _SMALLEST_HEADER:
            raise ReadError(f"is truncated: {len(head)} bytes are too few for a LAS header; copy it again")
        header_bytes, points_at, n_records = struct.unpack_from("<HII", head, 94)
        _check_layout(head, n_bytes)
        stream.seek(header_bytes)
        records = _read_records(stream, n_records, points_at)
        extended: list[Record] = []
        if head[25] >= 4 and len(head) == _HEADER_1_4:
            extended_at, n_extended = struct.unpack_from("<QI", head, 235)
            extended = _read_extended_records(stream, extended_at, n_extended, n_bytes)
    header = _unpack(head, tuple(records), tuple(extended))
    _check_numbers(header)
    if not header.is_compressed:
        n_held = max(0, n_bytes - points_at) // header.point_bytes
        if n_held < header.n_points:
            raise ReadError(
                f"is truncated: expected {header.n_points} points, file holds {n_held}; copy it again"
            )
    return header


def _check_layout(head: bytes, n_bytes: int) -> None:
    header_bytes, points_at, n_records, point_format, point_bytes = struct.unpack_from("<HIIBH", head, 94)
    if head[24] != 1 or head[25] > 5:
        raise ReadError(f"has the unknown LAS version {head[24]}.{head[25]}; export it as LAS 1.2 or 1.4")
    if point_format & 63 >= len(POINT_BYTES):
        raise ReadError(f"has the unknown point format {point_format & 63}; export it as format 0 to 10")
    if point_bytes < POINT_BYTES[point_format & 63]:
        raise ReadError(
            f"contradicts itself: {point_bytes} bytes a point are too few for point format "
            f"{point_format & 63}; export it again"
        )
    if not _SMALLEST_HEADER <= header_bytes <= points_at:
        raise ReadError(
            f"has a damaged header (header of {header_bytes} bytes, points from byte {points_at}); "
            "export it again"
        )
    if points_at > n_bytes:
        raise ReadError(
            f"is truncated: its points begin at byte {points_at} but it ends at byte {n_bytes}; copy it again"
        )
    if n_records * _VLR_HEAD.size > points_at - header_bytes:
        raise ReadError(
            f"has a damaged header: {n_records} variable length records do not fit in front of the points; "
            "export it again"
        )


def _unpack(head: bytes, records: tuple[Record, ...], extended: tuple[Record, ...]) -> LasHeader:
    has_long_counts = head[25] >= 4 and struct.unpack_from("<H", head, 94)[0] >= _HEADER_1_4
    n_long = struct.unpack_from("<Q", head, 247)[0] if has_long_counts else 0
    bounds = struct.unpack_from("<6d", head, 179)  # maximum before minimum, axis by axis
    return LasHeader(
        version=(head[24], head[25]),
        point_format=head[104] & 63,
        point_bytes=struct.unpack_from("<H", head, 105)[0],
        is_compressed=bool(head[104] & 192),
        n_points=n_long or struct.unpack_from("<I", head, 107)[0],
        points_at=struct.unpack_from("<I", head, 96)[0],
        scales=struct.unpack_from("<3d", head, 131),
        offsets=struct.unpack_from("<3d", head, 155),
        minima=bounds[1::2],
        maxima=bounds[0::2],
        file_source_id=struct.unpack_from("<H", head, 4)[0],
        global_encoding=struct.unpack_from("<H", head, 6)[0],
        project_id=head[8:24],
        system_identifier=_text(head[26:58]),
        generating_software=_text(head[58:90]),
        creation_day=struct.unpack_from("<H", head, 90)[0],
        creation_year=struct.unpack_from("<H", head, 92)[0],
        records=records,
        extended_records=extended,
    )


def _check_numbers(header: LasHeader) -> None:
    reach = [
        abs(scale) * 2**31 + abs(offset) for scale, offset in zip(header.scales, header.offsets, strict=True)
    ]
    if not all(map(math.isfinite, reach)) or 0.0 in header.scales:
        raise ReadError(
            f"has a damaged header (scale {header.scales}, offset {header.offsets}); export it again"
        )


def _read_records(stream: IO[bytes], n_records: int, points_at: int) -> list[Record]:
    records: list[Record] = []
    for _ in range(n_records):
        user_id, record_id, n_bytes, description = _VLR_HEAD.unpack(stream.read(_VLR_HEAD.size))
        if stream.tell() + n_bytes > points_at:
            logger.warning("%s: a variable length record runs into the points; it is left out", stream.name)
            break
        records.append(Record(_text(user_id), record_id, _text(description), stream.read(n_bytes)))
        if points_at - stream.tell() < _VLR_HEAD.size and len(records) < n_records:
            logger.warning("%s: has fewer variable length records than it says", stream.name)
            break
    return records


def _read_extended_records(stream: IO[bytes], start: int, n_records: int, n_bytes: int) -> list[Record]:
    records: list[Record] = []
    stream.seek(min(start, n_bytes))
    for _ in range(n_records):
        head = stream.read(_EVLR_HEAD.size)
        if len(head) < _EVLR_HEAD.size:
            logger.warning("%s: an extended record is cut off; it is left out", stream.name)
            break
        user_id, record_id, length, description = _EVLR_HEAD.unpack(head)
        if stream.tell() + length > n_bytes:
            logger.warning("%s: an extended record is cut off; it is left out", stream.name)
            break
        if (_text(user_id), record_id) == WAVEFORMS:
            stream.seek(length, 1)  # may be larger than all points together, and is not ours to keep
        else:
            records.append(Record(_text(user_id), record_id, _text(description), stream.read(length)))
    return records


def _text(data: bytes) -> str:
    return data.partition(b"\0")[0].decode("latin-1")
