"""The point cloud as Python code holds it: coordinates, attributes and where they came from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tmchho.errors import InvalidCloudError


@dataclass(frozen=True, eq=False)
class PointCloud:
    """Points with their attributes.

    Parameters
    ----------
    xyz : (n, 3) float64 array
        Coordinates in the file's own frame and unit (national grid coordinates are welcome).
        Other dtypes and layouts are converted; the input is never modified.
    attributes : mapping of str to (n, …) array
        One array for each attribute, under LAS names where LAS has one: ``intensity``, ``red``,
        ``green``, ``blue``, ``classification``, ``gps_time``, …
    crs : str, optional
        Coordinate reference system as WKT, if known.
    metadata : mapping
        What a writer of the same format needs to write the file back as it was (LAS header, scale,
        offset, point format, VLRs, …). Not interpreted elsewhere.
    name : str
        How messages call this cloud, usually the file's path.

    Raises
    ------
    InvalidCloudError
        If ``xyz`` is not (n, 3) or an attribute's length is not n.
    """

    xyz: NDArray[np.float64]
    attributes: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    crs: str | None = None
    metadata: Mapping[str, Any] = field(default_factory=dict)
    name: str = "cloud"

    def __post_init__(self) -> None:
        object.__setattr__(self, "xyz", as_points(self.xyz, self.name))
        n_points = len(self.xyz)
        for key, values in self.attributes.items():
            if len(values) != n_points:
                raise InvalidCloudError(
                    f"{self.name}: attribute '{key}' has {len(values)} values for {n_points} points"
                )
        object.__setattr__(self, "attributes", MappingProxyType(dict(self.attributes)))
        object.__setattr__(self, "metadata", MappingProxyType(dict(self.metadata)))

    def __len__(self) -> int:
        return len(self.xyz)

    def __repr__(self) -> str:
        return f"PointCloud({self.name!r}, {len(self)} points, attributes={sorted(self.attributes)})"


def as_points(values: Any, name: str = "points") -> NDArray[np.float64]:
    """Return `values` as an (n, 3) float64 C-contiguous array; `name` is used in messages.

    Accepts anything numpy can turn into real numbers: float32, integers, Fortran order, lists,
    data frames. No copy is made where none is needed.

    Raises
    ------
    InvalidCloudError
        If the shape is not (n, 3) or the values are not real numbers.
    """
    try:
        array = np.asarray(values)
        if array.dtype.kind not in "iuf":
            array = array.astype(np.float64) if array.dtype.kind in "bO" else array
        if array.dtype.kind not in "iuf":
            raise TypeError(f"dtype {array.dtype}")
        array = np.ascontiguousarray(array, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InvalidCloudError(f"{name}: coordinates must be real numbers ({error})") from error
    if array.ndim != 2 or array.shape[1] != 3:
        raise InvalidCloudError(f"{name}: coordinates must have shape (n, 3), got {np.shape(values)}")
    return array
