"""Choosing points: polygons from files, classes, and what is none."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from tmchho.cloud import PointCloud
from tmchho.errors import InvalidArgumentError, InvalidCloudError, ReadError
from tmchho.selection import Polygon, Selection, read_polygon

SQUARE = [[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0]]


def winding(corners: np.ndarray, point: np.ndarray) -> bool:
    """Return whether a polygon goes round a point: the sum of the angles under which its sides are seen."""
    rays = corners - point
    following = np.roll(rays, -1, axis=0)
    cross = rays[:, 0] * following[:, 1] - rays[:, 1] * following[:, 0]
    angles = np.arctan2(cross, (rays * following).sum(axis=1))
    return bool(abs(angles.sum()) > np.pi)


def test_a_star_is_what_it_goes_round() -> None:
    rng = np.random.default_rng(0)
    angles = np.sort(rng.uniform(0, 2 * np.pi, 15))
    corners = np.column_stack([np.cos(angles), np.sin(angles)]) * rng.uniform(0.3, 1, (15, 1)) + [5e5, 4e6]
    points = rng.uniform(-1, 1, (2000, 3)) + np.array([5e5, 4e6, 0])
    found = Polygon(corners).contains(points)
    assert found.tolist() == [winding(corners, point[:2]) for point in points]
    assert 200 < found.sum() < 1800


@pytest.mark.parametrize(
    "text",
    [
        "0 0\n4 0\n4 4\n0 4\n",
        "# field\n0,0\n4,0\n4,4\n0,4\n0,0\n",
        "0;0;7\n4;0;7\n4;4;7\n0;4;7\n",
        json.dumps({"type": "Polygon", "coordinates": [[*SQUARE, SQUARE[0]]]}),
        json.dumps({"type": "Feature", "geometry": {"type": "Polygon", "coordinates": [SQUARE]}}),
        json.dumps(
            {
                "type": "FeatureCollection",
                "features": [
                    {
                        "type": "Feature",
                        "geometry": {"type": "Polygon", "coordinates": [[*SQUARE, SQUARE[0]]]},
                    }
                ],
            }
        ),
    ],
)
def test_polygons_from_files(tmp_path: Path, text: str) -> None:
    path = tmp_path / "field.txt"
    path.write_text(text)
    polygon = read_polygon(path)
    assert polygon.corners.tolist() == SQUARE
    assert str(polygon) == str(path)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "0 0\n1 1\n",
        "a b\nc d\ne f\n",
        "0 0\n1 nan\n2 2\n",
        '{"type": "Point", "coordinates": [1, 2]}',
        '{"type": "Polygon", "coordinates": [[[0, 0], [4, 0], [4, 4]], [[1, 1], [2, 1], [2, 2]]]}',
        '{"type": "Feature"}',
        "{",
    ],
)
def test_what_is_no_polygon_is_refused_by_name(tmp_path: Path, text: str) -> None:
    path = tmp_path / "field.txt"
    path.write_text(text)
    with pytest.raises(ReadError, match=r"field\.txt.*polygon"):
        read_polygon(path)
    with pytest.raises(ReadError, match=r"missing\.txt"):
        read_polygon(tmp_path / "missing.txt")
    with pytest.raises(InvalidArgumentError, match="three corners"):
        Polygon(np.zeros((2, 2)))


def test_polygon_and_classes_together() -> None:
    xyz = np.array([[1.0, 1, 9], [2, 2, 9], [5, 5, 9], [3, 1, 9]])
    cloud = PointCloud(xyz, {"classification": np.array([2, 1, 2, 6])}, name="c.laz")
    assert Selection(Polygon(np.array(SQUARE)), (2, 6)).of(cloud).xyz.tolist() == [[1, 1, 9], [3, 1, 9]]
    assert len(Selection(classes=(1,)).of(cloud)) == 1
    assert not Selection()
    with pytest.raises(InvalidCloudError, match=r"c\.laz: no point is left"):
        Selection(classes=(9,)).of(cloud)
    with pytest.raises(InvalidCloudError, match="no classification"):
        Selection(classes=(2,)).of(PointCloud(xyz, name="x.ply"))
