"""Which points take part in finding a pose: those in a polygon, in a box, of some classes."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tmchho.cloud import PointCloud
from tmchho.errors import InvalidArgumentError, InvalidCloudError, ReadError
from tmchho.results import ReadOnlyArrays

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Polygon(ReadOnlyArrays):
    """An area in plan, of any height.

    Parameters
    ----------
    corners : (n, 2) float64 array
        In the coordinates of the cloud, in order; the last is joined to the first. At least three.
    name : str, default "polygon"
        How messages and command lines call it, usually a path.
    """

    corners: Floats
    name: str = "polygon"

    def __post_init__(self) -> None:
        corners = np.array(self.corners, dtype=np.float64)
        if corners.ndim != 2 or corners.shape[1] != 2 or len(corners) < 3 or not np.isfinite(corners).all():
            raise InvalidArgumentError(f"{self.name}: a polygon needs at least three corners x y, all finite")
        object.__setattr__(self, "corners", corners)
        super().__post_init__()

    def __str__(self) -> str:
        return self.name

    def contains(self, xyz: Floats) -> NDArray[np.bool_]:
        """Return which points, (n, 2) or (n, 3), lie inside: from those a ray crosses an odd number of sides.

        Examples
        --------
        >>> Polygon([[0, 0], [4, 0], [0, 4]]).contains(np.array([[1.0, 1.0], [3.0, 3.0]]))
        array([ True, False])
        """
        inside = np.zeros(len(xyz), dtype=bool)
        low, high = self.corners.min(axis=0), self.corners.max(axis=0)
        near = np.flatnonzero(((xyz[:, :2] >= low) & (xyz[:, :2] <= high)).all(axis=1))
        x, y = xyz[near, 0], xyz[near, 1]
        crossed = np.zeros(len(near), dtype=bool)
        for (x0, y0), (x1, y1) in zip(self.corners, np.roll(self.corners, -1, axis=0), strict=True):
            if y0 == y1:
                continue
            spans = (y < y0) != (y < y1)
            crossed ^= spans & (x < x0 + (y - y0) * (x1 - x0) / (y1 - y0))
        inside[near] = crossed
        return inside


@dataclass(frozen=True, eq=False)
class Selection:
    """What part of a cloud is looked at.

    Parameters
    ----------
    polygon : Polygon, optional
        Only points in it.
    classes : tuple of int
        Only points with one of these classifications; any where there are none.
    """

    polygon: Polygon | None = None
    classes: tuple[int, ...] = ()

    def __bool__(self) -> bool:
        return self.polygon is not None or bool(self.classes)

    def keep(self, xyz: Floats, attributes: Mapping[str, Any], name: str) -> NDArray[np.bool_]:
        """Return which points are selected.

        Raises
        ------
        InvalidCloudError
            If classes are asked for and the cloud has none.
        """
        kept = np.ones(len(xyz), dtype=bool)
        if self.classes:
            if "classification" not in attributes:
                raise InvalidCloudError(
                    f"{name}: has no classification, by which classes could be kept; leave --keep-class out"
                )
            kept &= np.isin(attributes["classification"], self.classes)
        if self.polygon is not None:
            kept &= self.polygon.contains(xyz)
        return kept

    def of(self, cloud: PointCloud) -> PointCloud:
        """Return the selected points, without attributes."""
        kept = self.keep(cloud.xyz, cloud.attributes, cloud.name)
        if not kept.any():
            raise InvalidCloudError(
                f"{cloud.name}: no point is left in the crop and the classes that were asked for; "
                "`tmchho info` tells its box and classes"
            )
        return PointCloud(cloud.xyz[kept], name=cloud.name)


def read_polygon(path: str | os.PathLike[str]) -> Polygon:
    """Read a polygon: a GeoJSON file, or a text with one corner ``x y`` a line.

    Raises
    ------
    ReadError
        If the file is missing or holds no polygon. Holes and further polygons are refused, not left out.
    """
    try:
        text = Path(path).read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise ReadError(
            f"{path}: cannot be read as a text with a polygon ({error}); give lines with x y"
        ) from error
    try:
        if text.lstrip().startswith("{"):
            corners = _geojson(json.loads(text))
        else:
            lines = [line.partition("#")[0].strip() for line in text.splitlines()]
            corners = [[float(word) for word in re.split(r"[\s,;]+", line)[:2]] for line in lines if line]
        if len(corners) > 3 and corners[0] == corners[-1]:
            corners = corners[:-1]
        return Polygon(np.array(corners, dtype=np.float64), str(path))
    except (KeyError, TypeError, ValueError, InvalidArgumentError) as error:
        raise ReadError(
            f"{path}: holds no polygon ({error}); give lines with x y, or GeoJSON with one polygon"
        ) from error


def _geojson(document: Any) -> list[list[float]]:
    if document["type"] == "FeatureCollection":
        return _geojson(_only("polygon", document["features"]))
    if document["type"] == "Feature":
        return _geojson(document["geometry"])
    if document["type"] != "Polygon":
        raise ValueError(f"a {document['type']} is no polygon")
    return [list(map(float, corner[:2])) for corner in _only("outline", document["coordinates"])]


def _only(what: str, items: list[Any]) -> Any:
    if len(items) != 1:
        raise ValueError(f"one {what} is expected, it has {len(items)}")
    return items[0]
