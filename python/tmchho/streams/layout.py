"""One point layout that holds the points of two LAS files, and how records of each are put into it.

What a file lacks gets the documented value for "no data": 0 in fields that every LAS file has and in whole
numbers, NaN in decimals, or what the extra dimension itself says.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import laspy  # type: ignore[import-untyped, unused-ignore]
import numpy as np
from numpy.typing import NDArray

from tmchho.io.las_extra import ExtraDimension
from tmchho.io.las_stream import LasPoints, Records
from tmchho.io.las_write import format_for, with_scan_angle

_COLOURS = ("red", "green", "blue", "nir")
_NAME_BYTES = 31
_COORDINATES = ("X", "Y", "Z")

ORIGIN = ExtraDimension("origin", "u1", description="0 target, 1 source")
FILLS_HOLE = ExtraDimension("fills_hole", "u1", description="1: other cloud has a hole here")
DISTANCE = ExtraDimension("C2C_absolute_distances", "f4", description="to the other cloud")
ADDED = (ORIGIN, FILLS_HOLE, DISTANCE)


@dataclass(frozen=True)
class FusedLayout:
    """The layout of a fused file.

    Parameters
    ----------
    point_format : int
        Of the LAS points: that of the target, raised only where the source has more.
    version : (int, int)
        Of the file.
    extra : tuple of ExtraDimension
        Those of the target, those of the source, and what the fusion adds.
    source_names : mapping of str to str
        How the source's extra dimensions are called in here.
    target_names : mapping of str to str
        The same of the target's.
    """

    point_format: int
    version: tuple[int, int]
    extra: tuple[ExtraDimension, ...]
    source_names: Mapping[str, str]
    target_names: Mapping[str, str]

    @classmethod
    def of(cls, source: LasPoints, target: LasPoints) -> FusedLayout:
        """Return the layout that holds the points of both files."""
        number, version = format_for(target.header, source.header)
        taken = {*(d.name for d in laspy.PointFormat(number).dimensions), *(d.name for d in ADDED)}
        taken |= set(field_names(laspy.PointFormat(number).dtype()))
        target_names, source_names = {}, {}
        extra: list[ExtraDimension] = []
        for dimension in target.extra:
            name = _free(dimension.name, "target", taken)
            target_names[dimension.name] = name
            taken.add(name)
            extra.append(replace(dimension, name=name))
        for dimension in source.extra:
            twin = next((d for d in target.extra if d.name == dimension.name), None)
            if twin is not None and _is_alike(twin, dimension):
                source_names[dimension.name] = target_names[dimension.name]
                continue
            name = _free(dimension.name, "source", taken)
            source_names[dimension.name] = name
            taken.add(name)
            extra.append(replace(dimension, name=name))
        return cls(number, version, (*extra, *ADDED), source_names, target_names)

    @property
    def parameters(self) -> list[laspy.ExtraBytesParams]:
        """The extra dimensions for laspy."""
        return [dimension.parameters for dimension in self.extra]

    def blank(self, n_points: int, dtype: np.dtype[np.void]) -> Records:
        """Return records in which every attribute says that there are no data."""
        records = np.zeros(n_points, dtype=dtype)
        for dimension in self.extra:
            value = no_data_of(dimension)
            if value is not None:
                records[dimension.name] = value
        return records

    def put(
        self, records: Records, into: Records, file: LasPoints, names: Mapping[str, str], colour_factor: int
    ) -> None:
        """Copy all attributes of records of `file`; coordinates are left to the caller."""
        is_extended = (file.header.point_format >= 6, self.point_format >= 6)
        if is_extended[0] == is_extended[1]:
            for name in field_names(laspy.PointFormat(file.header.point_format).dtype()):
                if name not in _COORDINATES and name in field_names(into.dtype):
                    into[name] = records[name]
        else:
            _unpack(records, into, file, self.point_format)
        if colour_factor != 1:
            for name in _COLOURS:
                if name in field_names(into.dtype):
                    into[name] *= np.uint16(colour_factor)
        for dimension in file.extra:
            into[names[dimension.name]] = records[dimension.name]

    def lacking(self, file: LasPoints, names: Mapping[str, str]) -> dict[str, Any]:
        """Return the attributes that a file lacks, and what its points have instead; NaN is None."""
        own = {d.name for d in laspy.PointFormat(file.header.point_format).dimensions}
        own |= {"scan_angle"} if "scan_angle_rank" in own else set()
        lacked: dict[str, Any] = {
            d.name: 0 for d in laspy.PointFormat(self.point_format).dimensions if d.name not in own
        }
        # Bits that only the longer records have and that are 0 in all others tell nothing.
        for bits in ("overlap", "scanner_channel"):
            lacked.pop(bits, None)
        for dimension in self.extra[: -len(ADDED)]:
            if dimension.name not in names.values():
                value = no_data_of(dimension)
                lacked[dimension.name] = 0 if value is None else None if np.isnan(value).any() else value
        return lacked


def field_names(dtype: np.dtype[Any]) -> tuple[str, ...]:
    """Return the names of the fields of a record."""
    return dtype.names or ()


def no_data_of(dimension: ExtraDimension) -> Any:
    """Return what is stored where an extra dimension has no value; None stands for zeros."""
    if dimension.no_data is not None:
        return dimension.no_data[0] if dimension.length == 1 else dimension.no_data
    return np.nan if dimension.kind[0] == "f" and dimension.scales is None else None


def colour_factors(brightest_source: int, brightest_target: int) -> tuple[int, int]:
    """Return by what the colours of source and target are multiplied, so that both use 16 bits.

    Colours of which none exceeds 255 are 8-bit ones in a wide field; beside true 16-bit ones they would be
    black. The LAS specification asks for a factor of 256.
    """
    is_wide = max(brightest_source, brightest_target) > 255
    source, target = (
        256 if is_wide and value <= 255 else 1 for value in (brightest_source, brightest_target)
    )
    return source, target


def _unpack(records: Records, into: Records, file: LasPoints, point_format: int) -> None:
    """Copy the standard dimensions of a short record into a longer one, whose bits lie elsewhere."""
    unpacked = laspy.PackedPointRecord(records, file.point_format)
    dimensions = {d.name: d for d in laspy.PointFormat(point_format).dimensions}
    names = [d.name for d in laspy.PointFormat(file.header.point_format).dimensions]
    values: dict[str, NDArray[Any]] = {
        name: np.array(unpacked[name]) for name in names if name not in _COORDINATES
    }
    target = laspy.PackedPointRecord(into, laspy.PointFormat(point_format))
    for name, given in with_scan_angle(values, dimensions).items():
        if name in field_names(into.dtype):
            into[name] = given
        elif name in dimensions:
            target[name][:] = given.astype(np.uint8)


def _is_alike(a: ExtraDimension, b: ExtraDimension) -> bool:
    return (a.kind, a.length, a.scales, a.offsets) == (b.kind, b.length, b.scales, b.offsets)


def _free(name: str, role: str, taken: set[str]) -> str:
    """Return the name, or one with the role in front of it that nothing else has."""
    options = (name, f"{role}_{name}", *(f"{role}{number}_{name}" for number in range(2, len(taken) + 3)))
    short = (option.encode()[:_NAME_BYTES].decode(errors="ignore") for option in options)
    return next(option for option in short if option not in taken)
