"""Names and columns that the formats share.

Why: one attribute has one name in this package, the one LAS gives it where it has one, whatever a PLY, PCD or
text file calls it; and table-like formats need attributes as plain columns.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from tmchho.cloud import PointCloud
from tmchho.errors import ReadError, WriteError

logger = logging.getLogger(__name__)

NORMALS = ("nx", "ny", "nz")
COLOURS = ("red", "green", "blue")
AXES = ("x", "y", "z")
_COARSEST_STEP = 1e-5  # of float32 coordinates, by the diagonal of the cloud; coarser ones are warned of

# Looked up in lower case without blanks, underscores and CloudCompare's prefix "scalar_".
_CANONICAL_NAMES = {
    **{axis: axis for axis in AXES},
    **{"diffusered": "red", "diffusegreen": "green", "diffuseblue": "blue"},
    **{"normalx": "nx", "normaly": "ny", "normalz": "nz"},
    **{"returnnum": "return_number", "numreturns": "number_of_returns", "infrared": "nir"},
    **{
        name.replace("_", ""): name
        for name in (
            *(*COLOURS, "alpha", "nx", "ny", "nz", "nir", "intensity", "return_number", "number_of_returns"),
            *("scan_direction_flag", "edge_of_flight_line", "classification", "synthetic", "key_point"),
            *("withheld", "overlap", "scanner_channel", "scan_angle_rank", "scan_angle", "user_data"),
            *("point_source_id", "gps_time"),
        )
    },
}


_COLOUR_LETTERS = {"r": "red", "g": "green", "b": "blue", "a": "alpha"}


def canonical_name(name: str) -> str:
    """Return the name this package uses for a file's field; unknown names stay as they are.

    Examples
    --------
    >>> canonical_name("GpsTime"), canonical_name("scalar_Intensity"), canonical_name("Roughness (0.5)")
    ('gps_time', 'intensity', 'Roughness (0.5)')
    """
    key = re.sub(r"[\s_]", "", name.lower()).removeprefix("scalar")
    return _CANONICAL_NAMES.get(key, name)


def canonical_names(names: Sequence[str]) -> list[str]:
    """Return canonical names without repetition: a later double keeps its own spelling or gets a number.

    The letters r, g, b and a mean colours only where the first three stand together.
    """
    letters = _COLOUR_LETTERS if {"r", "g", "b"} <= {name.lower() for name in names} else {}
    taken: list[str] = []
    for name in names:
        options = [
            letters.get(name.lower(), canonical_name(name)),
            name,
            *(f"{name}_{number}" for number in range(2, len(names) + 2)),
        ]
        taken.append(next(option for option in options if option not in taken))
    return taken


def cloud_from_columns(
    columns: Mapping[str, NDArray[Any]], metadata: Mapping[str, Any], name: str
) -> PointCloud:
    """Return a cloud from columns under canonical names.

    Raises
    ------
    ReadError
        If x, y or z is missing.
    """
    missing = [axis for axis in AXES if axis not in columns]
    if missing:
        raise ReadError(
            f"has no {' '.join(missing)} field, only {' '.join(columns) or 'none'}; "
            "name the coordinates x, y and z"
        )
    xyz = np.empty((len(columns["x"]), 3))
    with np.errstate(invalid="ignore"):  # a damaged float may be a NaN that "signals"
        for index, axis in enumerate(AXES):
            xyz[:, index] = columns[axis]
    if any(columns[axis].dtype == np.float32 for axis in AXES):
        _warn_of_coarse_floats(xyz, name)
    attributes = {key: values for key, values in columns.items() if key not in AXES}
    return PointCloud(xyz, attributes, metadata=metadata, name=name)


def _warn_of_coarse_floats(xyz: NDArray[np.float64], name: str) -> None:
    """Say where float32 was too short for the coordinates: at 4 000 000 it has steps of 0.25."""
    finite = xyz[np.isfinite(xyz).all(axis=1)]
    if len(finite) == 0:
        return
    lowest, highest = finite.min(axis=0), finite.max(axis=0)
    steps = np.spacing(np.maximum(np.abs(lowest), np.abs(highest)).astype(np.float32))
    axis = int(np.argmax(steps))
    if steps[axis] > _COARSEST_STEP * np.linalg.norm(highest - lowest):
        logger.warning(
            "%s: was saved as float32, which rounds %s to steps of %.3g here; export it with doubles",
            *(name, AXES[axis], steps[axis]),
        )


def attributes_to_write(cloud: PointCloud, *, blanks: bool = False) -> dict[str, NDArray[Any]]:
    """Return the attributes with plain numeric types, under names without blanks and separators.

    With `blanks`, for formats that allow them, the names stay as they are. Booleans become uint8 and half
    floats float32, because few formats have them; longer floats than float64 become float64.

    Raises
    ------
    WriteError
        If an attribute is not numeric, is called like a coordinate or clashes with another.
    """
    result: dict[str, NDArray[Any]] = {}
    for key, values in cloud.attributes.items():
        name = key if blanks else re.sub(r"[\s,;\"']+", "_", key.strip()) or "unnamed"
        if name.lower() in AXES or name in result:
            raise WriteError(f"attribute '{key}' would be written as a second '{name}'; rename it")
        result[name] = _plain(np.asarray(values), key)
    return result


def split_columns(attributes: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Return one-dimensional columns: ``normal`` of shape (n, 3) becomes ``normal_0`` to ``normal_2``."""
    result: dict[str, NDArray[Any]] = {}
    for name, values in attributes.items():
        if values.ndim == 1:
            result[name] = values
            continue
        flat = values.reshape(len(values), -1)
        result.update({f"{name}_{index}": flat[:, index] for index in range(flat.shape[1])})
    return result


def colours_as_8_bit(attributes: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Return the attributes with uint16 colours turned into uint8.

    Values that never exceed 255 are taken for 8-bit colours in a wide field, as many programs write them;
    others lose their lower byte.
    """
    result = dict(attributes)
    wide = [name for name in COLOURS if name in result and result[name].dtype == np.uint16]
    if wide:
        shift = 8 if max(int(result[name].max(initial=0)) for name in wide) > 255 else 0
        logger.info("16-bit colours are written with 8 bits (the lower %d bits are dropped)", shift)
        result.update({name: (result[name] >> shift).astype(np.uint8) for name in wide})
    return result


def is_integral(values: NDArray[Any], lowest: float, highest: float) -> bool:
    """Return whether all values are whole numbers from `lowest` to `highest` (no NaN)."""
    if len(values) == 0:
        return True
    if values.dtype.kind == "f" and not (np.isfinite(values).all() and (values == np.rint(values)).all()):
        return False
    return bool(values.min() >= lowest and values.max() <= highest)


def cast_if_it_fits(values: NDArray[np.float64], kind: str) -> NDArray[Any]:
    """Return the values in the numpy type `kind`, or unchanged where they are not of that type."""
    wanted = np.dtype(kind)
    if wanted.kind in "iu" and not is_integral(values, np.iinfo(wanted).min, np.iinfo(wanted).max):
        return values
    return values.astype(wanted)


def record_array(
    columns: Mapping[str, NDArray[Any]],
    types: Iterable[np.dtype[Any]],
    n_points: int,
    byte_order: Literal["<", ">"] = "<",
) -> NDArray[np.void]:
    """Return the columns side by side as one packed structured array, cast to `types` in a byte order."""
    fields = [
        (name, kind.newbyteorder(byte_order), values.shape[1:])
        for (name, values), kind in zip(columns.items(), types, strict=True)
    ]
    records = np.empty(n_points, dtype=np.dtype(fields))
    for name, values in columns.items():
        records[name] = values
    return records


def _plain(values: NDArray[Any], key: str) -> NDArray[Any]:
    if values.dtype.kind not in "biuf":
        raise WriteError(f"attribute '{key}' has dtype {values.dtype}, not numbers; convert or drop it")
    if values.dtype.kind == "b":
        return values.astype(np.uint8)
    if values.dtype.kind == "f" and values.dtype.itemsize not in (4, 8):
        return values.astype(np.float32 if values.dtype.itemsize == 2 else np.float64)
    return values
