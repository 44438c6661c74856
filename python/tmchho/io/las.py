"""LAS and LAZ: reading. `las_header` checks the header, `laz` unpacks, `las_write` writes.

Why every dimension is kept: surveyors lose time, class and intensity in most programs; here they come out as
they went in, extra bytes and flags included.
"""

from __future__ import annotations

import logging
import math
from pathlib import Path

import laspy  # type: ignore[import-untyped, unused-ignore]
import numpy as np
from laspy.vlrs.known import vlr_factory  # type: ignore[import-untyped, unused-ignore]
from numpy.typing import NDArray

from tmchho.cloud import PointCloud
from tmchho.errors import ReadError
from tmchho.io.copc import INFO, decompress_part
from tmchho.io.format import Format, starts_with
from tmchho.io.las_extra import read_dimensions
from tmchho.io.las_header import (
    EXTRA_BYTES,
    GEO_KEYS,
    POINT_BYTES,
    SIGNATURE,
    WKT,
    LasHeader,
    read_header,
)
from tmchho.io.las_write import write_las
from tmchho.io.laz import decompress
from tmchho.io.window import Window

logger = logging.getLogger(__name__)
# laspy logs what it also raises; without a handler Python would print that to the terminal.
logging.getLogger("laspy").addHandler(logging.NullHandler())


def _read(path: Path, window: Window | None = None) -> PointCloud:
    header = read_header(path)
    if window and window.resolution is not None and header.find(INFO) is None:
        raise ReadError("is no COPC file, so that it cannot be read at a resolution; leave it out")
    if header.n_points == 0:
        raise ReadError("contains no points; choose a file with points")
    point_format = laspy.PointFormat(header.point_format)
    standard = [dimension.name for dimension in point_format.dimensions]
    extra = read_dimensions(
        header.find_all(EXTRA_BYTES),  # some programs add a record of their own
        header.point_bytes - POINT_BYTES[header.point_format],
        {*standard, *point_format.dtype().names},
    )
    for dimension in extra:
        point_format.add_extra_dimension(dimension.parameters)
    records = _read_points(path, header, point_format.dtype(), window)
    xyz = np.empty((len(records), 3))
    for index, axis in enumerate("XYZ"):
        xyz[:, index] = records[axis] * header.scales[index] + header.offsets[index]
    if len(xyz):
        _check_bounds(xyz, header, path)
    if window is not None:
        inside = window.holds(xyz)
        xyz, records = xyz[inside], records[inside]
    unpacked = laspy.PackedPointRecord(records, point_format)
    attributes = {name: np.array(unpacked[name]) for name in standard if name not in ("X", "Y", "Z")}
    attributes.update({dimension.name: dimension.decode(records[dimension.name]) for dimension in extra})
    crs = _crs(header)
    metadata = {"format": "las", "header": header, "extra_dimensions": tuple(extra), "crs": crs}
    return PointCloud(xyz, attributes, crs, metadata, str(path))


def _read_points(
    path: Path, header: LasHeader, dtype: np.dtype[np.void], window: Window | None
) -> NDArray[np.void]:
    if window is not None and header.is_compressed and header.find(INFO) is not None:
        return decompress_part(path, header, window).view(dtype)
    if header.is_compressed:
        return decompress(path, header).view(dtype)
    return np.fromfile(path, dtype=dtype, count=header.n_points, offset=header.points_at)


def _check_bounds(xyz: NDArray[np.float64], header: LasHeader, path: Path) -> None:
    """Warn of points outside the header's bounds; raise for LAZ, which has no checksum, if they are far."""
    lowest, highest = np.array(header.minima), np.array(header.maxima)
    diagonal = math.dist(header.minima, header.maxima)
    if not (0 < diagonal < math.inf and (lowest <= highest).all()):
        return
    # Axis by axis, because numpy is slow across short rows.
    below = lowest - [xyz[:, axis].min() for axis in range(3)]
    above = np.array([xyz[:, axis].max() for axis in range(3)]) - highest
    excess = float(max(below.max(), above.max()))
    if excess > diagonal and header.is_compressed:
        raise ReadError(
            f"is damaged: points lie up to {excess:.6g} outside the bounds in its header; copy it again"
        )
    if excess > max(header.scales):
        logger.warning("%s: points lie up to %.6g outside the bounds in the header", path, excess)


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
    recognises=starts_with(SIGNATURE),
    read=_read,
    write=write_las,
    read_part=_read,
)
