"""NumPy's own files: an array of coordinates (npy) or an archive of named arrays (npz).

Pickled objects are never loaded: they could run anything.
"""

from __future__ import annotations

import logging
import zipfile
from collections.abc import Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from tmchho.cloud import PointCloud
from tmchho.errors import ReadError
from tmchho.io.fields import (
    AXES,
    attributes_to_write,
    canonical_names,
    cloud_from_columns,
    record_array,
)
from tmchho.io.format import Format, starts_with

logger = logging.getLogger(__name__)

_VERSIONS = ((1, 0), (2, 0), (3, 0))
_MAX_DEFLATE_RATIO = 1032
_POINT_ARRAYS = ("xyz", "points", "pos", "arr_0")


def _is_archive_of_arrays(head: bytes) -> bool:
    """Return whether a ZIP archive begins with an array."""
    n_name = int.from_bytes(head[26:28], "little")
    return head.startswith(b"PK\x03\x04") and head[30 : 30 + n_name].endswith(b".npy")


def _read(path: Path) -> PointCloud:
    with path.open("rb") as stream:
        array = _read_array(stream, path.stat().st_size)
    return cloud_from_columns(_columns_of(array), {"format": "npy"}, str(path))


def _read_archive(path: Path) -> PointCloud:
    arrays: dict[str, NDArray[Any]] = {}
    with zipfile.ZipFile(path) as archive:
        n_promised, n_bytes = sum(entry.file_size for entry in archive.infolist()), path.stat().st_size
        if n_promised > n_bytes * _MAX_DEFLATE_RATIO:
            raise ReadError(
                f"promises {n_promised} bytes in {n_bytes} compressed ones, which cannot be; save it again"
            )
        for entry in archive.infolist():
            if entry.filename.endswith(".npy"):
                with archive.open(entry) as stream:
                    arrays[entry.filename.removesuffix(".npy")] = _read_array(stream, entry.file_size)
    key = next((key for key in _POINT_ARRAYS if key in arrays), None)
    if key is not None:
        columns = _columns_of(arrays.pop(key))
        columns.update(arrays)
    else:
        columns = dict(zip(canonical_names(list(arrays)), arrays.values(), strict=True))
    n_points = len(columns["x"]) if "x" in columns and columns["x"].ndim == 1 else -1
    fitting = {name: values for name, values in columns.items() if values.ndim and len(values) == n_points}
    if len(fitting) < len(columns):
        ignored = ", ".join(name for name in columns if name not in fitting)
        logger.warning("%s: arrays without one row for each point are left out: %s", path, ignored)
    return cloud_from_columns(fitting, {"format": "npz"}, str(path))


def _read_array(stream: IO[bytes], n_bytes: int) -> NDArray[Any]:
    """Read one array after a look at its header, so that a false shape allocates nothing."""
    version = np.lib.format.read_magic(stream)
    n_length = 2 if version == (1, 0) else 4
    n_header = int.from_bytes(stream.read(n_length), "little")
    if version not in _VERSIONS or n_header > n_bytes:
        raise ReadError(
            f"has a damaged header (version {version}, {n_header} bytes of {n_bytes}); save it again"
        )
    stream.seek(-n_length, 1)
    read_header = (
        np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    )
    shape, _, dtype = read_header(stream)
    if dtype.hasobject:
        raise ReadError("holds Python objects, which are never loaded; save plain numbers")
    if any(length < 0 for length in shape):
        raise ReadError(f"has the impossible shape {shape}; save it again")
    n_rows = shape[0] if shape else 1
    row_bytes = dtype.itemsize
    for length in shape[1:]:
        row_bytes *= length
    n_held = (n_bytes - stream.tell()) // row_bytes if row_bytes else n_rows
    if n_held < n_rows:
        raise ReadError(f"is truncated: expected {n_rows} points, file holds {n_held}; copy it again")
    stream.seek(0)
    array: NDArray[Any] = np.lib.format.read_array(stream, allow_pickle=False)
    return array


def _columns_of(array: NDArray[Any]) -> dict[str, NDArray[Any]]:
    """Name the columns of an (n, k) array, or take the fields of a structured one."""
    if array.dtype.names:
        fields = array.dtype.names
        return {name: array[key] for name, key in zip(canonical_names(fields), fields, strict=True)}
    if array.dtype.kind not in "iuf":
        raise ReadError(f"holds values of type {array.dtype}, not numbers; save coordinates")
    if array.ndim != 2 or array.shape[1] < 3:
        hint = (
            "transpose it" if array.ndim == 2 and array.shape[0] == 3 else "save one row x y z for each point"
        )
        raise ReadError(f"has the shape {array.shape} instead of (n, 3); {hint}")
    names = (*AXES, *(f"column_{number}" for number in range(4, array.shape[1] + 1)))
    return {name: array[:, index] for index, name in enumerate(names)}


def _write(cloud: PointCloud, path: Path, kept: Mapping[str, Any]) -> None:
    """Write an (n, 3) array, or a structured one if there are attributes."""
    attributes = attributes_to_write(cloud)
    array: NDArray[Any] = cloud.xyz
    if attributes:
        columns = {axis: cloud.xyz[:, index] for index, axis in enumerate(AXES)} | attributes
        array = record_array(columns, [values.dtype for values in columns.values()], len(cloud))
    with path.open("wb") as stream:
        # Through its method: of a file numpy only tells how many values it did not write, not why.
        writer: Any = SimpleNamespace(write=stream.write)
        np.lib.format.write_array(writer, array, allow_pickle=False)


def _write_archive(cloud: PointCloud, path: Path, kept: Mapping[str, Any]) -> None:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, array in {"xyz": cloud.xyz, **attributes_to_write(cloud)}.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as stream:
                np.lib.format.write_array(stream, np.asarray(array), allow_pickle=False)


FORMAT = Format(
    name="NumPy array",
    extensions=(".npy",),
    recognises=starts_with(b"\x93NUMPY"),
    read=_read,
    write=_write,
)
ARCHIVE_FORMAT = Format(
    name="NumPy archive",
    extensions=(".npz",),
    recognises=_is_archive_of_arrays,
    read=_read_archive,
    write=_write_archive,
)
