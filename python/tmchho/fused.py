"""One cloud out of two, with the attributes of both."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tmchho.cloud import PointCloud
from tmchho.errors import InvalidArgumentError
from tmchho.io.fields import LAS_NAMES, canonical_name
from tmchho.io.las_write import with_scan_angle
from tmchho.results import ReadOnlyArrays

_TARGET, _SOURCE = 0, 1
_COLOURS = ("red", "green", "blue", "nir")


@dataclass(frozen=True, eq=False)
class FusedCloud(ReadOnlyArrays):
    """The points of the target in their order, then those of the source; none more than once.

    Points with a coordinate that is not finite are left out.

    Parameters
    ----------
    points : (n, 3) float64 array
        In target coordinates.
    origin : (n,) uint8 array
        0 for points of the target, 1 for points of the source.
    index : (n,) uint32 array
        Row of the point in its own cloud.
    fills_hole : (n,) bool array
        Whether the other cloud has no point within `hole_radius` of it.
    distance : (n,) float64 array
        Distance to the nearest point of the other cloud.
    hole_radius : float
        As given or derived.
    n_filled_by_source, n_filled_by_target : int
        How many points of the one cloud fill a hole of the other.
    area_filled_by_source, area_filled_by_target : float
        Area of the surface that these points show, NaN where it was not measured; ``docs/files.md`` says how
        it is measured.
    n_repeated : int
        Points of the source that were left out because they repeat the target.
    """

    points: NDArray[np.float64]
    origin: NDArray[np.uint8]
    index: NDArray[np.uint32]
    fills_hole: NDArray[np.bool_]
    distance: NDArray[np.float64]
    hole_radius: float
    n_filled_by_source: int
    n_filled_by_target: int
    area_filled_by_source: float = math.nan
    area_filled_by_target: float = math.nan
    n_repeated: int = 0

    def to_point_cloud(self, source: PointCloud, target: PointCloud) -> PointCloud:
        """Return the points with the attributes of the clouds they come from.

        Parameters
        ----------
        source, target : PointCloud
            The clouds that were fused.

        Returns
        -------
        PointCloud
            In the target's coordinate reference system, with the attributes of both clouds, and ``origin``,
            ``fills_hole`` and ``C2C_absolute_distances`` (the name CloudCompare uses). Where a cloud lacks an
            attribute of the other, its points get `no_data_value`: 0, or NaN in decimals. Where colours are
            8-bit in one cloud and 16-bit in the other, the former are multiplied by 256. To keep the layout
            of a LAS file, write it with ``like=target``.

        Raises
        ------
        InvalidArgumentError
            If these are not the clouds that were fused, or an attribute has values of different shapes.
        """
        from_target = self.index[self.origin == _TARGET]
        from_source = self.index[self.origin == _SOURCE]
        for name, cloud, rows in (("target", target, from_target), ("source", source, from_source)):
            if len(rows) and int(rows.max()) >= len(cloud):
                raise InvalidArgumentError(
                    f"{name} has {len(cloud)} points, but row {rows.max()} was fused: "
                    "give the clouds that were given to fuse"
                )
        source, target = _with_one_scan_angle(source, target)
        attributes: dict[str, NDArray[Any]] = {}
        factors = colour_factors(source, target)
        for name in (*target.attributes, *(key for key in source.attributes if key not in target.attributes)):
            of_source, of_target = (
                _Part(cloud.attributes.get(name), rows, factor if name in _COLOURS else 1)
                for cloud, rows, factor in zip(
                    (source, target), (from_source, from_target), factors, strict=True
                )
            )
            no_data = no_data_value(name, source, target)
            attributes[name] = _joined(name, of_source, of_target, no_data)
        attributes["origin"] = self.origin
        attributes["fills_hole"] = self.fills_hole.astype(np.uint8)
        attributes["C2C_absolute_distances"] = self.distance.astype(np.float32)
        return PointCloud(self.points, attributes, crs=target.crs, name="fused cloud")


def lacking(cloud: PointCloud, other: PointCloud) -> dict[str, float | None]:
    """Return the attributes that only `other` has, and what points of `cloud` get instead; NaN is None."""
    values = {
        name: float(no_data_value(name, cloud, other))
        for name in sorted(set(other.attributes) - set(cloud.attributes))
    }
    return {name: None if np.isnan(value) else value for name, value in values.items()}


def no_data_value(name: str, *clouds: PointCloud) -> Any:
    """Return what a point gets for an attribute that its cloud lacks.

    What the extra dimension of a LAS file says of itself; else 0 for the fields that LAS has and for whole
    numbers, NaN for decimals.
    """
    for cloud in clouds:
        if name not in cloud.attributes:
            continue
        for dimension in cloud.metadata.get("extra_dimensions", ()):
            if dimension.name == name and dimension.length == 1:
                if dimension.no_data is not None:
                    return dimension.decode(np.array(dimension.no_data))[0]
                if dimension.scales is not None:  # stored as whole numbers
                    return dimension.decode(np.zeros(1))[0]
        if np.asarray(cloud.attributes[name]).dtype.kind == "f" and canonical_name(name) not in LAS_NAMES:
            return np.nan
    return 0


def colour_factors(*clouds: PointCloud) -> tuple[int, ...]:
    """Return by what the colours of each cloud are multiplied, so that all use 16 bits if one does.

    8-bit colours, also those in a 16-bit field, are told by no value above 255. Beside true 16-bit ones they
    would be black. The LAS specification asks for a factor of 256.
    """
    brightest = []
    for cloud in clouds:
        colours = [np.asarray(cloud.attributes[name]) for name in _COLOURS if name in cloud.attributes]
        whole = [values for values in colours if values.dtype.kind in "iu" and values.size]
        brightest.append(max((int(values.max()) for values in whole), default=0))
    is_wide = max(brightest) > 255
    return tuple(256 if is_wide and 0 < value <= 255 else 1 for value in brightest)


def _with_one_scan_angle(source: PointCloud, target: PointCloud) -> tuple[PointCloud, PointCloud]:
    """Bring whole degrees into the finer steps of LAS 1.4 where only one of the clouds has these."""
    clouds = (source, target)
    if not any("scan_angle" in cloud.attributes for cloud in clouds):
        return clouds
    renewed = [
        replace(cloud, attributes=with_scan_angle(dict(cloud.attributes), {"scan_angle"})) for cloud in clouds
    ]
    return renewed[0], renewed[1]


@dataclass(frozen=True)
class _Part:
    """The values of one cloud, which of its rows are taken, and by what they are multiplied."""

    values: NDArray[Any] | None
    rows: NDArray[np.uint32]
    factor: int


def _joined(name: str, source: _Part, target: _Part, no_data: Any) -> NDArray[Any]:
    """Return the values of the target's rows, then those of the source's."""
    given = [np.asarray(part.values) for part in (target, source) if part.values is not None]
    if len({values.shape[1:] for values in given}) > 1:
        raise InvalidArgumentError(
            f"attribute '{name}' has values of shape {given[0].shape[1:]} in the target and "
            f"{given[1].shape[1:]} in the source; rename or drop one"
        )
    dtype = np.result_type(*given)
    if max(source.factor, target.factor) > 1:
        dtype = np.result_type(dtype, np.uint16)

    def part(of: _Part) -> NDArray[Any]:
        if of.values is None:
            return np.full((len(of.rows), *given[0].shape[1:]), no_data, dtype=dtype)
        taken = np.asarray(of.values)[of.rows].astype(dtype)
        return taken if of.factor == 1 else np.asarray(taken * dtype.type(of.factor))

    return np.concatenate([part(target), part(source)])
