"""The documents that `mutations.py` damages beside the clouds: settings, projects, poses, areas, results.

Each is a valid text with the function that reads it.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np

import tmchho
from tmchho.network.project import read_project
from tmchho.report.folder import read_result
from tmchho.report.points import ReportPoints

SETTINGS = """
seed = 5
mode = "robust"
dof = 7
scale_bounds = [0.5, 2.0]
[voxel]
voxel_size_m = 0.25
[coarse]
rotations_per_round = [60, 60]
[paper.hawks]
n_hawks = 30
"""
PROJECT = """
name = "Dam"
[network]
voxel_size_m = 0.1
[[station]]
file = "S01.e57"
pose = [[1, 0, 0, 500000.0], [0, 1, 0, 5400000.0], [0, 0, 1, 200.0], [0, 0, 0, 1]]
[[station]]
name = "pier"
file = "left.laz"
position = [500020.0, 5400010.0, 201.0]
position_sigma_m = [0.02, 0.02, 0.05]
[[block]]
name = "UAV"
file = "block.laz"
free_scale = true
[[control_point]]
station = "UAV"
place = [1.0, 2.0, 3.0]
position = [500001.0, 5400002.0, 203.0]
sigma_m = 0.01
"""
MATRIX = "0 -1 0 10.5\n1 0 0 20\n0 0 1 30\n0 0 0 1\n"
CONTROL_POINTS = (
    "source_x,source_y,source_z,target_x,target_y,target_z,sigma\n1,2,3,4,5,6,0.01\n7,8,9,10,11,12.5,0.01\n"
)
AREAS = {
    "type": "FeatureCollection",
    "features": [
        {
            "type": "Feature",
            "properties": {"name": name},
            "geometry": {
                "type": "Polygon",
                "coordinates": [[[x, 0], [x + 9, 0], [x + 9, 7], [x, 7], [x, 0]]],
            },
        }
        for name, x in (("dam", 0), ("spillway", 20))
    ],
}
WKT = "dam; POLYGON ((0 0, 9 0, 9 7, 0 7, 0 0), (1 1, 2 1, 2 2, 1 1))\nPOLYGON ((20 0, 29 0, 29 7, 20 0))\n"


def result() -> str:
    """Return a `result.json` of two small clouds."""
    points = np.random.default_rng(0).uniform(0, 9, (60, 3))
    config = {"coarse": {"rotations_per_round": [4], "n_verified": 1}}
    found = tmchho.register(points, points, config=config).to_dict()
    return json.dumps({**found, "inputs": {"source": {"path": "a.laz"}, "target": {"path": "b.laz"}}})


def report_points(path: Path) -> None:
    from tmchho.report.points import points_of

    cloud = tmchho.PointCloud(np.random.default_rng(0).uniform(0, 9, (60, 3)))
    config = {"coarse": {"rotations_per_round": [4], "n_verified": 1}}
    points_of(tmchho.register(cloud, cloud, config=config), cloud, cloud, None).save(path / "a.npz")


def of_text(name: str, text: str | Callable[[], str]) -> Callable[[Path], None]:
    """Return what writes the text under a name into a folder."""

    def write(folder: Path) -> None:
        (folder / name).write_text(text if isinstance(text, str) else text(), encoding="utf-8")

    return write


# What makes the only file of a folder, and what reads it.
DOCUMENTS: dict[str, tuple[Callable[[Path], None], Callable[[Path], object]]] = {
    "settings": (of_text("a.toml", SETTINGS), tmchho.Config.from_toml),
    "project": (of_text("a.toml", PROJECT), read_project),
    "matrix": (of_text("a.txt", MATRIX), tmchho.read_transform),
    "control_points": (of_text("a.csv", CONTROL_POINTS), tmchho.read_control_points),
    "areas_json": (of_text("a.geojson", json.dumps(AREAS)), tmchho.read_areas),
    "areas_wkt": (of_text("a.wkt", WKT), tmchho.read_areas),
    "pose_of_result": (of_text("a.json", result), tmchho.read_transform),
    "result": (of_text("result.json", result), lambda path: read_result(path.parent)),
    "report_points": (report_points, ReportPoints.load),
}
