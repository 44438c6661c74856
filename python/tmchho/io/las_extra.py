"""Extra bytes: the named dimensions that a LAS point may carry beyond those of its point format.

Source: ASPRS, "LAS Specification 1.4 - R15" (2019), tables 24 and 25.
"""

from __future__ import annotations

import struct
from collections.abc import Collection
from dataclasses import dataclass
from typing import Any

import laspy  # type: ignore[import-untyped, unused-ignore]
import numpy as np
from numpy.typing import NDArray

# Type numbers 1 to 10; 11 to 20 and 21 to 30 are the same with two and three values a point.
_KINDS = ("u1", "i1", "u2", "i2", "u4", "i4", "u8", "i8", "f4", "f8")
_WIDE_KINDS = {"u": "<u8", "i": "<i8", "f": "<f8"}  # in which the "no data" value is stored
_DESCRIPTOR = struct.Struct("<2xBB32s4x24s24x24x3d3d32s")
_HAS_NO_DATA, _HAS_SCALE, _HAS_OFFSET = 1, 8, 16


@dataclass(frozen=True)
class ExtraDimension:
    """One dimension: `length` values of numpy type `kind` a point, perhaps scaled integers."""

    name: str
    kind: str
    length: int = 1
    description: str = ""
    scales: tuple[float, ...] | None = None
    offsets: tuple[float, ...] | None = None
    no_data: tuple[float, ...] | None = None

    @property
    def n_bytes(self) -> int:
        """Size in one point."""
        return int(np.dtype(self.kind).itemsize) * self.length

    @property
    def parameters(self) -> laspy.ExtraBytesParams:
        """The same for laspy."""
        return laspy.ExtraBytesParams(
            self.name,
            np.dtype(self.kind) if self.length == 1 else np.dtype((self.kind, (self.length,))),
            self.description,
            self.offsets,
            self.scales,
            self.no_data,
        )

    def decode(self, stored: NDArray[Any]) -> NDArray[Any]:
        """Return the values a user means: float64 where the dimension is scaled, else as stored."""
        if self.scales is None or self.offsets is None:
            return np.ascontiguousarray(stored)
        return np.asarray(stored * _broadcast(self.scales) + _broadcast(self.offsets))

    def encode(self, values: NDArray[Any]) -> NDArray[Any] | None:
        """Return what to store, or None if the values do not fit this dimension."""
        shape = (len(values),) if self.length == 1 else (len(values), self.length)
        if values.shape != shape:
            return None
        if self.scales is None or self.offsets is None:
            return values if values.dtype == np.dtype(self.kind) else None
        steps = np.rint((values - _broadcast(self.offsets)) / _broadcast(self.scales))
        limits = np.iinfo(self.kind) if self.kind[0] in "iu" else np.finfo(self.kind)
        if not np.isfinite(steps).all() or steps.min() < limits.min or steps.max() > limits.max:
            return None
        return np.asarray(steps.astype(self.kind))


def read_dimensions(descriptors: bytes, n_bytes: int, taken: Collection[str]) -> list[ExtraDimension]:
    """Return the dimensions that share the extra bytes of a point.

    Parameters
    ----------
    descriptors : bytes
        Content of the extra bytes records, empty if the file has none.
    n_bytes : int
        Extra bytes in each point.
    taken : collection of str
        Names that the extra dimensions must not have.

    Returns
    -------
    list of ExtraDimension
        They fill the bytes exactly; what no descriptor tells about is one dimension of plain bytes.
    """
    dimensions: list[ExtraDimension] = []
    n_left = n_bytes
    names = set(taken)
    for start in range(0, len(descriptors) // _DESCRIPTOR.size * _DESCRIPTOR.size, _DESCRIPTOR.size):
        dimension = _parse(_DESCRIPTOR.unpack_from(descriptors, start), names)
        if dimension is None or dimension.n_bytes > n_left:
            break
        dimensions.append(dimension)
        names.add(dimension.name)
        n_left -= dimension.n_bytes
    if n_left:
        dimensions.append(ExtraDimension(_free_name("extra_bytes", names), "u1", n_left))
    return dimensions


def _parse(entry: tuple[int | bytes | float, ...], taken: Collection[str]) -> ExtraDimension | None:
    number, options, raw_name, raw_no_data, *numbers, raw_description = entry
    assert isinstance(number, int)
    assert isinstance(options, int)
    assert isinstance(raw_no_data, bytes)
    name = _free_name(_text(raw_name) or "unnamed", taken)
    if number == 0:  # plain bytes, their count in place of the options
        return ExtraDimension(name, "u1", options, _text(raw_description)) if options else None
    if number > 3 * len(_KINDS):
        return None
    kind, length = _KINDS[(number - 1) % len(_KINDS)], (number - 1) // len(_KINDS) + 1
    scales, offsets = (tuple(float(x) for x in numbers[at : at + length]) for at in (0, 3))
    is_scaled = bool(options & (_HAS_SCALE | _HAS_OFFSET))
    no_data = np.frombuffer(raw_no_data, dtype=_WIDE_KINDS[kind[0]])[:length]
    return ExtraDimension(
        name,
        kind,
        length,
        _text(raw_description),
        (scales if options & _HAS_SCALE else (1.0,) * length) if is_scaled else None,
        (offsets if options & _HAS_OFFSET else (0.0,) * length) if is_scaled else None,
        tuple(no_data.tolist()) if options & _HAS_NO_DATA else None,
    )


def _free_name(name: str, taken: Collection[str]) -> str:
    """Return the name, or one made of it that nothing else has."""
    options = (name, f"extra_{name}", *(f"{name}_{number}" for number in range(2, len(taken) + 3)))
    return next(option for option in options if option not in taken and option.lower() not in ("x", "y", "z"))


def _broadcast(values: tuple[float, ...]) -> NDArray[np.float64] | float:
    return values[0] if len(values) == 1 else np.asarray(values)


def _text(data: object) -> str:
    assert isinstance(data, bytes)
    return data.partition(b"\0")[0].decode("utf-8", errors="replace").strip()
