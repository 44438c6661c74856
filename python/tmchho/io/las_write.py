"""LAS and LAZ: writing, in the layout of the file that was read where there is one.

Source: ASPRS, "LAS Specification 1.4 - R15" (2019).
"""

from __future__ import annotations

import io
import logging
from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from contextlib import contextmanager
from datetime import date, timedelta
from pathlib import Path
from typing import Any
from uuid import UUID

import laspy  # type: ignore[import-untyped, unused-ignore]
import numpy as np
from numpy.typing import NDArray

from tmchho.cloud import PointCloud
from tmchho.errors import WriteError
from tmchho.io.fields import COLOURS, attributes_to_write, is_integral, split_columns
from tmchho.io.las_extra import ExtraDimension
from tmchho.io.las_grid import Grid, kept_grid, new_grid
from tmchho.io.las_header import EXTRA_BYTES, LASZIP, WKT, LasHeader, Record

logger = logging.getLogger(__name__)

_DEGREES_PER_STEP = 0.006  # of `scan_angle`; `scan_angle_rank` is in whole degrees
_NAME_BYTES = 31
_WKT_BIT = 16  # of the global encoding
_MAX_RECORD_BYTES = 65535

# What the points of formats 0 to 10 carry beyond the basics, and the oldest version that has the format.
_FEATURES = (
    *(set[str](), {"time"}, {"colour"}, {"time", "colour"}, {"time", "wave"}, {"time", "colour", "wave"}),
    *({"time"}, {"time", "colour"}, {"time", "colour", "nir"}),
    *({"time", "wave"}, {"time", "colour", "nir", "wave"}),
)
_OLDEST_VERSIONS = ((1, 1), (1, 1), (1, 2), (1, 2), (1, 3), (1, 3), *[(1, 4)] * 5)
_EXTENDED = 6  # the first of the formats of LAS 1.4, with longer fields

# Largest values that only the extended formats hold, after the largest of the legacy ones.
_EXTENDED_LIMITS = {
    **{"classification": (31, 255), "return_number": (7, 15), "number_of_returns": (7, 15)},
    **{"overlap": (0, 1), "scanner_channel": (0, 3)},
}

# Rebuilt for every file, or true only of the file they stood in: LASzip's record, extra bytes,
# COPC's octree, LAStools' spatial index.
# The compressor does not hear Ctrl-C; a tenth of a second passes between these. Ten of its chunks, so that
# the bytes are those of one call.
_POINTS_AT_ONCE = 500_000
_NOT_KEPT = {LASZIP, EXTRA_BYTES, ("copc", 1), ("copc", 1000), ("LAStools", 30)}
_CRS_RECORDS = {("LASF_Projection", number) for number in (2111, 2112, 34735, 34736, 34737)}


def write_las(cloud: PointCloud, path: Path, kept: Mapping[str, Any]) -> None:
    """Write LAS, or LAZ if the path ends in .laz, like the file that `kept` describes."""
    n_wrong = int(np.count_nonzero(~np.isfinite(cloud.xyz).all(axis=1)))
    if n_wrong:
        raise WriteError(
            f"LAS cannot hold {n_wrong} points whose coordinates are not finite; drop them first"
        )
    old: LasHeader | None = kept.get("header") if kept.get("format") == "las" else None
    if old is None:
        grid = new_grid(cloud.xyz)
    else:
        grid = kept_grid(cloud.xyz, old.scales, old.offsets, is_own=cloud.metadata.get("header") == old)
    with writing_las_parts(path, cloud, kept, grid) as put:
        put(cloud)


@contextmanager
def writing_las_parts(
    path: Path, first: PointCloud, kept: Mapping[str, Any], grid: Grid
) -> Iterator[Callable[[PointCloud], None]]:
    """Open a file for clouds with the attributes of `first`; lends what writes one of them after another."""
    old: LasHeader | None = kept.get("header") if kept.get("format") == "las" else None
    attributes = _colours_as_16_bit(attributes_to_write(first, blanks=True))
    number, version = _choose_format(attributes, old)
    is_compressed = path.suffix.lower() == ".laz"
    if "wave" in _FEATURES[number]:
        if is_compressed:
            raise WriteError(f"LAZ cannot hold the waveforms of point format {number}; choose .las")
        logger.warning("the points keep their places in the waveform data, which itself is not copied")

    def sorted_out(attributes: dict[str, NDArray[Any]], n_points: int) -> tuple[Any, Any]:
        found = _sorted_out(attributes, laspy.PointFormat(number), kept.get("extra_dimensions", ()))
        if old is None:
            ones = np.ones(n_points, dtype=np.uint8)
            found[0].setdefault("return_number", ones)
            found[0].setdefault("number_of_returns", ones)
        return found

    dimensions = [dimension.parameters for dimension, _ in sorted_out(attributes, len(first))[1]]
    with open_las_writer(
        path, old, (number, version), grid, dimensions, crs=first.crs, kept_crs=kept.get("crs")
    ) as (writer, point_format):

        def put(part: PointCloud) -> None:
            attributes = _colours_as_16_bit(attributes_to_write(part, blanks=True))
            standard, extra = sorted_out(attributes, len(part))
            points = _points(part, grid, standard, extra, point_format)
            for start in range(0, len(points), _POINTS_AT_ONCE):
                writer.write_points(points[start : start + _POINTS_AT_ONCE])

        yield put


@contextmanager
def open_las_writer(
    path: Path,
    old: LasHeader | None,
    layout: tuple[int, tuple[int, int]],
    grid: Grid,
    dimensions: Sequence[laspy.ExtraBytesParams],
    *,
    crs: str | None,
    kept_crs: str | None,
) -> Iterator[tuple[Any, Any]]:
    """Open a file for points of one layout; lends laspy's writer and the point format.

    Parameters
    ----------
    path : Path
        LAZ if the name ends in .laz.
    old : LasHeader, optional
        The file whose records and identity are kept.
    layout : (int, (int, int))
        Point format and version.
    grid : Grid
        Scale and offset.
    dimensions : sequence of laspy.ExtraBytesParams
        The extra dimensions.
    crs, kept_crs : str, optional
        Coordinate reference system of the new file, and that of `old`, whose records stay where both agree.
    """
    number, version = layout
    header = _new_header(number, version, old, grid)
    header.add_extra_dims(list(dimensions))
    records, extended_records = _records(crs, kept_crs, old, version)
    header.vlrs = [_for_laspy(record) for record in records]
    if any(record.key == WKT for record in records) and number >= _EXTENDED:
        header.global_encoding.value |= _WKT_BIT
    is_compressed = path.suffix.lower() == ".laz"
    file = _Remembering(path, "w+")
    try:
        with (
            io.BufferedRandom(file) as stream,
            laspy.open(stream, "w", closefd=False, header=header, do_compress=is_compressed) as writer,
        ):
            yield writer, header.point_format
            if extended_records:
                writer.write_evlrs(laspy.vlrs.vlrlist.VLRList(map(_for_laspy, extended_records)))
    except (KeyboardInterrupt, SystemExit, GeneratorExit):
        raise
    except BaseException as error:
        if file.refusal is not None:
            raise file.refusal from error
        raise


class _Remembering(io.FileIO):
    """A file that remembers why it could not be written; the compressor only says that it could not."""

    refusal: OSError | None = None

    def write(self, data: Any, /) -> int:
        """Write what there is room for; returns the number of bytes."""
        try:
            return super().write(data)
        except OSError as error:
            self.refusal = error
            raise


def _colours_as_16_bit(attributes: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Spread 8-bit colours and shares of 1 over 16 bits; the LAS specification asks for a factor of 256."""
    colours = {name: attributes[name] for name in COLOURS if name in attributes}
    result = dict(attributes)
    if colours and all(values.dtype == np.uint8 for values in colours.values()):
        logger.info("8-bit colours are written with 16 bits, times 256")
        result.update({name: values.astype(np.uint16) * 256 for name, values in colours.items()})
    elif colours and all(_is_share(values) for values in colours.values()):
        logger.info("colours from 0 to 1 are written with 16 bits, times 65535")
        result.update({name: np.rint(values * 65535).astype(np.uint16) for name, values in colours.items()})
    return result


def _is_share(values: NDArray[Any]) -> bool:
    return values.dtype.kind == "f" and bool(((values >= 0) & (values <= 1)).all())


def _choose_format(attributes: dict[str, NDArray[Any]], old: LasHeader | None) -> tuple[int, tuple[int, int]]:
    """Return the point format and version: those of the old file, raised only where they hold too little."""
    needed = set(_FEATURES[old.point_format if old else _EXTENDED])
    needed |= {"time"} if "gps_time" in attributes else set()
    needed |= {"colour"} if any(name in attributes for name in COLOURS) else set()
    needed |= {"nir"} if "nir" in attributes else set()
    is_extended = (
        old is None or old.point_format >= _EXTENDED or "nir" in needed or _needs_extended(attributes)
    )
    candidates = range(_EXTENDED, 11) if is_extended else range(_EXTENDED)
    number = next(candidate for candidate in candidates if needed <= _FEATURES[candidate])
    if old is None:
        return number, _OLDEST_VERSIONS[number]
    version = max(_OLDEST_VERSIONS[number], old.version)
    if (number, version) != (old.point_format, old.version):
        logger.info(
            "LAS %d.%d point format %d holds too little; using LAS %d.%d point format %d",
            *(*old.version, old.point_format, *version, number),
        )
    return number, version


def format_for(old: LasHeader, other: LasHeader) -> tuple[int, tuple[int, int]]:
    """Return the point format and version of `old`, raised only where they cannot hold the points of `other`.

    Waveforms, which stand in a file of their own, are left out.
    """
    needed = (set(_FEATURES[old.point_format]) | set(_FEATURES[other.point_format])) - {"wave"}
    is_extended = max(old.point_format, other.point_format) >= _EXTENDED or "nir" in needed
    candidates = range(_EXTENDED, 11) if is_extended else range(_EXTENDED)
    number = next(candidate for candidate in candidates if needed <= _FEATURES[candidate])
    return number, max(_OLDEST_VERSIONS[number], old.version)


def _needs_extended(attributes: dict[str, NDArray[Any]]) -> bool:
    if np.any(attributes.get("scan_angle", 0)):
        return True
    return any(
        name in attributes
        and is_integral(attributes[name], 0, extended)
        and not is_integral(attributes[name], 0, legacy)
        for name, (legacy, extended) in _EXTENDED_LIMITS.items()
    )


def _sorted_out(
    attributes: dict[str, NDArray[Any]], point_format: Any, kept: tuple[ExtraDimension, ...]
) -> tuple[dict[str, NDArray[Any]], list[tuple[ExtraDimension, NDArray[Any]]]]:
    """Return the standard dimensions, and the rest as extra dimensions with what to store."""
    standard: dict[str, NDArray[Any]] = {}
    extra: dict[str, NDArray[Any]] = {}
    dimensions = {dimension.name: dimension for dimension in point_format.dimensions}
    attributes = with_scan_angle(attributes, dimensions)
    for name, values in attributes.items():
        dimension = dimensions.get(name)
        if dimension is None:
            if name not in (*_EXTENDED_LIMITS, "scan_angle", "scan_angle_rank") or values.any():
                extra[name] = values
        elif values.ndim == 1 and (
            dimension.kind.name == "FloatingPoint" or is_integral(values, dimension.min, dimension.max)
        ):
            standard[name] = values
        else:
            logger.warning(
                "'%s' does not fit its LAS field; written as extra dimension '%s_value'", name, name
            )
            extra[f"{name}_value"] = values
    return standard, _extra_dimensions(extra, {dimension.name: dimension for dimension in kept})


def with_scan_angle(
    attributes: dict[str, NDArray[Any]], dimensions: Container[str]
) -> dict[str, NDArray[Any]]:
    """Turn the whole degrees of the legacy formats into the finer steps of the extended ones."""
    if "scan_angle" not in dimensions or "scan_angle_rank" not in attributes or "scan_angle" in attributes:
        return attributes
    result = dict(attributes)
    result["scan_angle"] = np.rint(result.pop("scan_angle_rank") / _DEGREES_PER_STEP).astype(np.int16)
    return result


def _extra_dimensions(
    attributes: dict[str, NDArray[Any]], kept: Mapping[str, ExtraDimension]
) -> list[tuple[ExtraDimension, NDArray[Any]]]:
    result: list[tuple[ExtraDimension, NDArray[Any]]] = []
    for name, values in attributes.items():
        old = kept.get(name)
        stored = None if old is None else old.encode(values)
        if old is not None and stored is not None:
            result.append((old, stored))
            continue
        for column, column_values in split_columns({name: values}).items():
            short = column.encode()[:_NAME_BYTES].decode(errors="ignore")
            if short != column:
                logger.warning("attribute '%s' is written as '%s': LAS names have 31 bytes", column, short)
            kind = column_values.dtype.str[1:]
            result.append((ExtraDimension(short, kind), column_values))
    names = [dimension.name for dimension, _ in result]
    doubles = sorted({name for name in names if names.count(name) > 1})
    if doubles:
        raise WriteError(f"two attributes would both be called '{doubles[0]}' in LAS; rename one")
    return result


def _new_header(number: int, version: tuple[int, int], old: LasHeader | None, grid: Grid) -> Any:
    header = laspy.LasHeader(version=f"{version[0]}.{version[1]}", point_format=number)
    header.scales, header.offsets = grid.scales, grid.offsets
    header.generating_software = "tmchho"
    if old is not None:
        header.file_source_id = old.file_source_id
        header.global_encoding.value = old.global_encoding
        header.uuid = UUID(bytes_le=old.project_id)
        header.system_identifier = _ascii(old.system_identifier)
        if 1 <= old.creation_day <= 366 and 1 <= old.creation_year <= 9998:
            header.creation_date = date(old.creation_year, 1, 1) + timedelta(days=old.creation_day - 1)
    return header


def _records(
    crs: str | None, kept_crs: str | None, old: LasHeader | None, version: tuple[int, int]
) -> tuple[list[Record], list[Record]]:
    """Return the records for before and after the points; those of the old file byte for byte."""
    dropped = set(_NOT_KEPT)
    records: list[Record] = []
    if crs is not None and (old is None or crs != kept_crs):
        dropped |= _CRS_RECORDS
        data = crs.encode() + b"\0"
        if len(data) > _MAX_RECORD_BYTES:
            raise WriteError(f"the coordinate reference system takes {len(data)} bytes, more than LAS holds")
        records.append(Record(*WKT, "OGC coordinate system WKT", data))
    if old is None:
        return records, []
    records = [record for record in old.records if record.key not in dropped] + records
    extended = [record for record in old.extended_records if record.key not in dropped]
    return records, extended if version >= (1, 4) else []


def _for_laspy(record: Record) -> Any:
    return laspy.VLR(_ascii(record.user_id), record.record_id, _ascii(record.description), record.data)


def _ascii(text: str) -> str:
    return text.encode("ascii", errors="replace").decode()


def _points(
    cloud: PointCloud,
    grid: Grid,
    standard: dict[str, NDArray[Any]],
    extra: list[tuple[ExtraDimension, NDArray[Any]]],
    point_format: Any,
) -> Any:
    records = np.zeros(len(cloud), dtype=point_format.dtype())
    steps = grid.steps(cloud.xyz)
    for index, axis in enumerate("XYZ"):
        records[axis] = steps[:, index]
    points = laspy.PackedPointRecord(records, point_format)
    for name, values in standard.items():
        if name in records.dtype.names:
            records[name] = values
        else:  # a few bits of a field
            points[name][:] = values.astype(np.uint8)
    for dimension, stored in extra:
        records[dimension.name] = stored
    return points
