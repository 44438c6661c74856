"""The rows of the comparison: which kernel, on which clouds, with which settings, and what is asked of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from kernel_clouds import (
    SIDE_M,
    away,
    edge_for_share,
    flat,
    in_the_corner,
    route_pair,
    start_pose,
    surveyed,
    with_duplicates,
)
from kernel_peers import Array

import tmchho

THOUSAND, MILLION = 1_000, 1_000_000
VOXEL_SHARE = 0.1
MIN_NEIGHBORS = 3
NORMAL_NEIGHBORS = 20
ICP_MAX_DISTANCE_M = 5.0
ROUTE_SECONDS, ROUTE_MIB = 20.0, 2e9 / 2**20
ICP_KERNELS = ("point_to_point", "point_to_plane", "plane_to_plane")


@dataclass(frozen=True)
class Row:
    """One line of the table; `at_least` is the wanted ratio, None where no peer does it."""

    group: str
    kernel: str
    title: str
    n: int
    at_least: float | None
    shape: str = ""

    @property
    def size(self) -> str:
        """Number of points, short."""
        return f"{self.n // MILLION} M" if self.n >= MILLION else f"{self.n / THOUSAND:g} k"


@dataclass(frozen=True, eq=False)
class Scene:
    """Clouds by name, the settings for all libraries, and the pose to be found, if any."""

    clouds: dict[str, Array]
    settings: dict[str, Any]
    truth: Array | None = None


ROWS = (
    Row("voxel", "voxel", "voxel centroids, 10 % left", MILLION, 1.5),
    Row("voxel", "voxel", "voxel centroids, 10 % left", 5 * MILLION, 1.5),
    Row("outliers", "outliers", "radius outlier removal", MILLION, 3.0),
    Row("keypoints", "keypoints", "ISS keypoints", 100 * THOUSAND, 3.0),
    Row("keypoints", "keypoints", "ISS keypoints", 300 * THOUSAND, 3.0),
    Row("normals", "normals", "normals, k = 20", 300 * THOUSAND, 1.3),
    Row("nearest", "nearest", "nearest neighbour, build + query", MILLION, 1.5),
    Row("nearest_flat", "nearest", "the same, flat in one axis", MILLION, 1.5, "flat"),
    Row("nearest_duplicates", "nearest", "the same, 30 % duplicates", MILLION, 1.5, "duplicates"),
    Row("both_ways", "both_ways", "cloud-to-cloud distance, both ways", MILLION, 2.0),
    Row("point_to_point", "point_to_point", "ICP point-to-point", 100 * THOUSAND, 4.0),
    Row("point_to_point", "point_to_point", "ICP point-to-point", 300 * THOUSAND, 4.0),
    Row("point_to_plane", "point_to_plane", "ICP point-to-plane", 100 * THOUSAND, 1.3),
    Row("point_to_plane", "point_to_plane", "ICP point-to-plane", 300 * THOUSAND, 1.3),
    Row("plane_to_plane", "plane_to_plane", "ICP plane-to-plane", 100 * THOUSAND, 1.3),
    Row("plane_to_plane", "plane_to_plane", "ICP plane-to-plane", 300 * THOUSAND, 1.3),
    Row("route", "route", "whole route, arrays to the fused cloud, 2 ×", 5 * MILLION, None),
)
GROWTH_KERNELS = ("voxel", "outliers", "keypoints", "normals", "nearest", "both_ways", "point_to_plane")
GROWTH_SIZES = (100 * THOUSAND, MILLION, 10 * MILLION)
GROUPS = (*dict.fromkeys(row.group for row in ROWS), "growth")


def rows_of(only: Sequence[str], sizes: Sequence[int] | None) -> list[Row]:
    """Return the rows of some groups; with `sizes` each kind of row once at each of them."""
    chosen = [row for row in ROWS if row.group in only]
    if sizes is None:
        return chosen
    return list(dict.fromkeys(replace(row, n=n) for row in chosen for n in sizes))


def scene_of(row: Row) -> Scene:
    """Make the clouds of a row, and the settings that all libraries get."""
    n = row.n
    spacing = SIDE_M / float(np.sqrt(n))
    if row.kernel == "route":
        source, target, truth = route_pair(n)
        return Scene({"source": source, "target": target}, {}, truth)
    flown = surveyed(n, "photogrammetry")
    if row.kernel in ICP_KERNELS:
        settings = {"max_distance": ICP_MAX_DISTANCE_M, "radius": SIDE_M / 2}
        return Scene(
            {"source": away(flown), "target": surveyed(n, "photogrammetry", 1)}, settings, start_pose(flown)
        )
    if row.kernel in ("nearest", "both_ways"):
        clouds = {"source": flown, "target": surveyed(n, "scanner")}
        if row.shape:
            change = {"flat": flat, "duplicates": with_duplicates}[row.shape]
            clouds = {role: change(cloud) for role, cloud in clouds.items()}
        return Scene(clouds, {})
    if row.kernel == "voxel":
        cloud = in_the_corner(flown)
        return Scene({"cloud": cloud}, {"edge": edge_for_share(cloud, VOXEL_SHARE)})
    if row.kernel == "outliers":
        scanned = surveyed(n, "scanner")
        radius = tmchho.remove_outliers(scanned).radius
        return Scene({"cloud": scanned}, {"radius": radius, "min_neighbors": MIN_NEIGHBORS})
    if row.kernel == "keypoints":
        settings = {
            "radius": 3 * spacing,
            "non_max_radius": 2 * spacing,
            "min_neighbors": 5,
            "second_to_first": 0.65,
            "third_to_second": 0.6,
        }
        return Scene({"cloud": flown}, settings)
    return Scene({"cloud": flown}, {"k": NORMAL_NEIGHBORS})
