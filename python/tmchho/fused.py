"""One cloud out of two, with the attributes of both."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tmchho.cloud import PointCloud
from tmchho.errors import InvalidArgumentError
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
        Area of the surface that these points show, to about one hole radius along its rim.
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
    area_filled_by_source: float
    area_filled_by_target: float
    n_repeated: int

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
            attribute of the other, its points get 0. Where colours are 8-bit in one cloud and 16-bit in the
            other, the former are multiplied by 256. To keep the layout of a LAS file, write it with
            ``like=target``.

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
        attributes: dict[str, NDArray[Any]] = {}
        for name in (*target.attributes, *(key for key in source.attributes if key not in target.attributes)):
            attributes[name] = _joined(
                name, target.attributes.get(name), source.attributes.get(name), from_target, from_source
            )
        attributes["origin"] = self.origin
        attributes["fills_hole"] = self.fills_hole.astype(np.uint8)
        attributes["C2C_absolute_distances"] = self.distance
        return PointCloud(self.points, attributes, crs=target.crs, name="fused cloud")


def _joined(
    name: str,
    of_target: NDArray[Any] | None,
    of_source: NDArray[Any] | None,
    from_target: NDArray[np.uint32],
    from_source: NDArray[np.uint32],
) -> NDArray[Any]:
    """Return the values of the one cloud's rows, then those of the other's; 0 where there are none."""
    given = [np.asarray(values) for values in (of_target, of_source) if values is not None]
    if len({values.shape[1:] for values in given}) > 1:
        raise InvalidArgumentError(
            f"attribute '{name}' has values of shape {given[0].shape[1:]} in the target and "
            f"{given[1].shape[1:]} in the source; rename or drop one"
        )
    dtype = np.result_type(*given)

    def part(values: NDArray[Any] | None, rows: NDArray[np.uint32]) -> NDArray[Any]:
        if values is None:
            return np.zeros((len(rows), *given[0].shape[1:]), dtype=dtype)
        taken = np.asarray(values)[rows].astype(dtype)
        is_deepened = name in _COLOURS and np.asarray(values).dtype == np.uint8 and dtype == np.uint16
        return taken * 256 if is_deepened else taken

    return np.concatenate([part(of_target, from_target), part(of_source, from_source)])
