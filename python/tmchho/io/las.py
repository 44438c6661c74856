"""LAS and LAZ: reading. The header is checked in `las_header`, writing is in `las_write`.

Why every dimension is kept: surveyors lose time, class and intensity in most programs; here they come out as
they went in, extra bytes and flags included.
"""

from __future__ import annotations

import logging
import struct
from pathlib import Path
from typing import BinaryIO

import laspy  # type: ignore[import-untyped, unused-ignore]
import lazrs  # type: ignore[import-untyped, unused-ignore]
import numpy as np
from laspy.vlrs.known import vlr_factory  # type: ignore[import-untyped, unused-ignore]
from numpy.typing import NDArray

from tmchho.cloud import PointCloud
from tmchho.errors import ReadError
from tmchho.io.format import Format
from tmchho.io.las_extra import read_dimensions
from tmchho.io.las_header import (
    EXTRA_BYTES,
    GEO_KEYS,
    LASZIP,
    POINT_BYTES,
    SIGNATURE,
    WKT,
    LasHeader,
    read_header,
)
from tmchho.io.las_write import write_las

logger = logging.getLogger(__name__)
# laspy logs what it also raises; without a handler Python would print that to the terminal.
logging.getLogger("laspy").addHandler(logging.NullHandler())

_POINTWISE = 1  # LASzip's first compressor: one stream without chunks
_VARIABLE_CHUNKS = 0xFFFFFFFF
# Identical points, the best case, come to less than 150 a byte.
_MAX_POINTS_PER_BYTE = 500


def _read(path: Path) -> PointCloud:
    header = read_header(path)
    if header.n_points == 0:
        raise ReadError("contains no points; choose a file with points")
    point_format = laspy.PointFormat(header.point_format)
    standard = [dimension.name for dimension in point_format.dimensions]
    extra = read_dimensions(
        header.find(EXTRA_BYTES),
        header.point_bytes - POINT_BYTES[header.point_format],
        {*standard, *point_format.dtype().names},
    )
    for dimension in extra:
        point_format.add_extra_dimension(dimension.parameters)
    records = _read_points(path, header, point_format.dtype())

    xyz = np.empty((header.n_points, 3))
    for index, axis in enumerate("XYZ"):
        xyz[:, index] = records[axis] * header.scales[index] + header.offsets[index]
    if header.is_compressed:
        _check_bounds(xyz, header)
    unpacked = laspy.PackedPointRecord(records, point_format)
    attributes = {name: np.array(unpacked[name]) for name in standard if name not in ("X", "Y", "Z")}
    attributes.update({dimension.name: dimension.decode(records[dimension.name]) for dimension in extra})
    crs = _crs(header)
    metadata = {"format": "las", "header": header, "extra_dimensions": tuple(extra), "crs": crs}
    return PointCloud(xyz, attributes, crs, metadata, str(path))


def _read_points(path: Path, header: LasHeader, dtype: np.dtype[np.void]) -> NDArray[np.void]:
    if not header.is_compressed:
        return np.fromfile(path, dtype=dtype, count=header.n_points, offset=header.points_at)
    laszip = header.find(LASZIP)
    if laszip is None or len(laszip) < 34:
        raise ReadError("is damaged: the record that tells how it is compressed is missing; copy it again")
    n_packed = path.stat().st_size - header.points_at
    if header.n_points > n_packed * _MAX_POINTS_PER_BYTE:
        raise ReadError(
            f"promises {header.n_points} points in {n_packed} compressed bytes, which cannot be; "
            "export it again"
        )
    is_pointwise = struct.unpack_from("<H", laszip)[0] == _POINTWISE
    if is_pointwise:
        # These old files know no chunks; any length will do, but the decoder stumbles over none.
        laszip = laszip[:12] + struct.pack("<I", _VARIABLE_CHUNKS - 1) + laszip[16:]
    if lazrs.LazVlr(laszip).item_size() != header.point_bytes:
        raise ReadError("contradicts itself: its compressed points have another size; export it again")
    with path.open("rb") as stream:
        stream.seek(header.points_at)
        if is_pointwise:
            decoder = lazrs.LasZipDecompressor(stream, laszip)
        else:
            _check_chunks(stream, header, laszip, n_packed)
            stream.seek(header.points_at)
            decoder = lazrs.ParLasZipDecompressor(stream, laszip)
        data = np.empty(header.n_points * header.point_bytes, dtype=np.uint8)
        try:
            decoder.decompress_many(data)
        except lazrs.LazrsError as error:
            raise ReadError(
                f"is damaged: its {header.n_points} points cannot be decompressed ({error}); copy it again"
            ) from error
    return data.view(dtype)


def _check_chunks(stream: BinaryIO, header: LasHeader, laszip: bytes, n_packed: int) -> None:
    """Raise if the table of chunks, at the end of the file, is missing or does not add up."""
    n_bytes = header.points_at + n_packed
    expected = f"expected {header.n_points} points"
    (table_at,) = struct.unpack("<q", stream.read(8).ljust(8, b"\0"))
    if table_at == -1:  # written to a stream: the place is in the last bytes of the file
        stream.seek(-8, 2)
        (table_at,) = struct.unpack("<q", stream.read(8))
    n_chunk_bytes = table_at - header.points_at - 8
    if n_chunk_bytes < 0 or table_at + 8 > n_bytes:
        raise ReadError(
            f"is truncated: {expected}, but its table of compressed chunks should be at byte {table_at} of "
            f"{n_bytes}; copy it again"
        )
    stream.seek(table_at)
    _, n_chunks = struct.unpack("<II", stream.read(8))
    if n_chunks * header.point_bytes > n_chunk_bytes:  # each chunk begins with one plain point
        raise ReadError(f"is damaged: {n_chunks} compressed chunks do not fit into it; copy it again")
    stream.seek(header.points_at)
    chunks = lazrs.read_chunk_table(stream, lazrs.LazVlr(laszip))
    n_held = sum(n_points for n_points, _ in chunks)
    if n_held < header.n_points:
        raise ReadError(f"is truncated or damaged: {expected}, file holds {n_held}; copy it again")
    if sum(length for _, length in chunks) != n_chunk_bytes:
        raise ReadError(f"is damaged: {expected}, but the lengths of its chunks do not add up; copy it again")


def _check_bounds(xyz: NDArray[np.float64], header: LasHeader) -> None:
    """Raise if decoded points lie far outside the header's bounds: LAZ has no checksum of its own."""
    lowest, highest = np.array(header.minima), np.array(header.maxima)
    diagonal = float(np.linalg.norm(highest - lowest))
    if not (np.isfinite(diagonal) and (lowest <= highest).all() and diagonal > 0):
        return
    # Axis by axis, because numpy is slow across short rows.
    below = lowest - [xyz[:, axis].min() for axis in range(3)]
    above = np.array([xyz[:, axis].max() for axis in range(3)]) - highest
    excess = float(max(below.max(), above.max()))
    if excess > diagonal:
        raise ReadError(
            f"is damaged: points lie up to {excess:.6g} outside the bounds in its header; copy it again"
        )
    if excess > max(header.scales):
        logger.warning("points lie up to %.6g outside the bounds in the header", excess)


def _crs(header: LasHeader) -> str | None:
    """Return the coordinate reference system as WKT: from its own record, or by pyproj from GeoTIFF keys."""
    wkt = header.find(WKT)
    if wkt is not None and wkt.strip(b"\0 "):
        return wkt.partition(b"\0")[0].decode("utf-8", errors="replace")
    if header.find(GEO_KEYS) is None:
        return None
    try:
        import pyproj  # noqa: F401
    except ImportError:
        logger.info("the coordinate reference system is kept but not interpreted; install pyproj for that")
        return None
    records = laspy.LasHeader()
    records.vlrs = [
        vlr_factory(laspy.VLR(record.user_id, record.record_id, record.description, record.data))
        for record in (*header.records, *header.extended_records)
        if record.user_id == WKT[0]
    ]
    try:
        crs = records.parse_crs()
        return None if crs is None else str(crs.to_wkt("WKT1_GDAL"))
    except Exception as error:  # any of pyproj's many; a cloud is useful without its system
        logger.warning("the coordinate reference system is kept but not understood (%s)", error)
        return None


FORMAT = Format(
    name="LAS/LAZ",
    extensions=(".las", ".laz"),
    first_bytes=(SIGNATURE,),
    mark_is_needed=True,
    read=_read,
    write=write_las,
)
