"""Areas against numpy, matplotlib's polygons and pyproj; their files in every form."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
from matplotlib.path import Path as Polygon
from numpy.typing import NDArray
from scipy.spatial import cKDTree

import tmchho
from tmchho import Area, errors, read_areas
from tmchho.evaluation import automatic_areas, measure_areas
from tmchho.simulate.pair import NATIONAL_CRS

OUTER = [(10.0, 5.0), (48.0, 2.0), (55.0, 30.0), (30.0, 38.0), (12.0, 25.0)]
HOLES = [
    [(20.0, 10.0), (30.0, 10.0), (30.0, 18.0), (20.0, 18.0)],
    [(38.0, 20.0), (46.0, 22.0), (40.0, 30.0)],
]


@pytest.fixture(scope="module")
def clouds() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    rng = np.random.default_rng(5)
    source = rng.uniform([0, 0, 0], [60, 40, 0.2], (6000, 3))
    return source, rng.uniform([0, 0, 0], [60, 40, 0.2], (9000, 3))


def with_holes(points: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Tell which points lie in the polygon, by another library's rule of crossings."""
    inside = Polygon(OUTER).contains_points(points[:, :2])
    for hole in HOLES:
        inside &= ~Polygon(hole).contains_points(points[:, :2])
    return inside


def test_a_polygon_with_holes_has_the_statistics_of_numpy(clouds: Any) -> None:
    source, target = clouds
    area = Area("yard", shapely.Polygon(OUTER, HOLES))
    row = tmchho.evaluate(source, target, tolerance=0.4, areas=[area]).areas[0]
    inside = with_holes(source)
    wanted = cKDTree(target).query(source[inside])[0]
    assert 500 < row.n_points == inside.sum() < 5000
    for value, twin in (
        *((row.mean, wanted.mean()), (row.best, wanted.min()), (row.worst, wanted.max())),
        *((row.std, wanted.std()), (row.rms, np.sqrt((wanted**2).mean())), (row.median, np.median(wanted))),
        *((row.percentile_95, np.percentile(wanted, 95)), (row.share_within, (wanted <= 0.4).mean())),
    ):
        assert value == pytest.approx(twin, rel=1e-12)
    assert (row.name, row.n_beyond, row.remark) == ("yard", 0, "")
    assert [len(ring) for ring in row.outline[0]] == [6, 5, 4]


def test_points_without_a_counterpart_are_counted_apart(clouds: Any) -> None:
    source, target = clouds
    area = Area("yard", shapely.Polygon(OUTER, HOLES))
    result = tmchho.evaluate(source, target, max_distance=0.3, areas=[area])
    every = cKDTree(target).query(source)[0]
    inside = every[with_holes(source)]
    row = result.areas[0]
    assert row.n_beyond == (inside > 0.3).sum() > 0
    assert row.mean == pytest.approx(inside[inside <= 0.3].mean(), rel=1e-12)
    assert result.n_beyond[0] == (every > 0.3).sum()
    assert result.source_to_target_statistics.worst == every[every <= 0.3].max()


def test_an_area_without_data_is_a_row() -> None:
    points = np.random.default_rng(0).uniform(0, 10, (200, 3))
    areas = [Area.box("away", 50, 50, 60, 60), Area.box("corner", 0, 0, 2, 2)]
    away, corner = tmchho.evaluate(points, points, tolerance=1.0, areas=areas).areas
    assert (away.n_points, away.remark, away.mean, away.share_within) == (0, "no data", None, None)
    assert (away.completeness_before, away.completeness_after) == (0.0, 0.0)
    assert 0 < corner.n_points < 30
    assert corner.remark == "fewer than 30 points"


def test_completeness_counts_cells_by_hand() -> None:
    # Ten cells of 1 m; the target has points in four of them, the source in two others and one of the same.
    area = Area.box("strip", 0, 0, 10, 1)
    target = np.array(
        [[0.5, 0.5, 0], [1.2, 0.1, 9], [2.5, 0.5, 0], [2.6, 0.5, 0], [9.9, 0.5, 0], [10.5, 0.5, 0]]
    )
    source = np.array([[5.5, 0.5, 0], [6.5, 0.5, 0], [0.6, 0.6, 0]])
    row = measure_areas([area], source, np.zeros(3), target, cell=1.0)[0]
    assert (row.completeness_before, row.completeness_after) == (0.4, 0.6)
    tiny = measure_areas([Area.box("", 0.1, 0.1, 0.2, 0.2)], source, np.zeros(3), target, cell=1.0)[0]
    assert tiny.completeness_before is None


def test_a_huge_area_keeps_its_completeness_countable() -> None:
    area = Area.box("county", 0, 0, 1e6, 1e6)
    points = np.random.default_rng(0).uniform(0, 1e6, (2000, 3))
    row = measure_areas([area], points, np.zeros(2000), points, cell=0.01)[0]
    assert 0 < row.completeness_before == row.completeness_after < 1


def test_heights_cut_an_area(clouds: Any) -> None:
    source, _ = clouds
    low = Area.box("low", 0, 0, 60, 40, heights=(0.0, 0.05)).contains(source)
    assert np.array_equal(low, source[:, 2] <= 0.05)


def test_automatic_areas_share_the_overlap_evenly() -> None:
    rng = np.random.default_rng(1)
    turn = np.array([[np.cos(0.4), -np.sin(0.4)], [np.sin(0.4), np.cos(0.4)]])
    # Ten times as many points at one end: areas are about surface, not about points.
    even = rng.uniform([0, 0], [200, 30], (60_000, 2))
    overlap = np.vstack([even, rng.uniform([0, 0], [20, 30], (60_000, 2))]) @ turn.T + [5e5, 4e6]
    areas = automatic_areas(overlap, cell=1.0)
    assert [area.name for area in areas] == [f"area {n}" for n in range(1, 6)]
    sizes = np.array([area.geometry.area for area in areas])
    assert sizes.max() / sizes.min() < 1.1
    assert sizes.sum() == pytest.approx(6000, rel=0.1)
    middles = np.array([area.geometry.centroid.coords[0] for area in areas])
    axis = np.diff(middles, axis=0)
    assert np.allclose(np.arctan2(axis[:, 1], axis[:, 0]), 0.4, atol=0.03)
    inside = np.sum([area.contains(overlap) for area in areas], axis=0)
    assert (inside >= 1).mean() > 0.999
    assert (inside > 1).mean() < 0.01


def test_without_an_overlap_there_are_no_automatic_areas() -> None:
    points = np.random.default_rng(0).uniform(0, 5, (300, 3))
    assert tmchho.evaluate(points, points + 100, areas="automatic").areas == ()
    assert automatic_areas(np.empty((0, 3)), 1.0) == ()
    assert len(tmchho.evaluate(points, points, areas="automatic").areas) == 5


def test_outlines_that_cross_themselves_are_repaired() -> None:
    bow = Area("bow", shapely.Polygon([(0, 0), (2, 2), (2, 0), (0, 2)]))
    assert bow.contains([[0.3, 1.0], [1.7, 1.0], [1.0, 0.1], [1.0, 1.9]]).tolist() == [
        True,
        True,
        False,
        False,
    ]
    assert len(bow.outline) == 2
    for geometry in (shapely.Point(0, 0), shapely.LineString([(0, 0), (1, 1)]), shapely.Polygon()):
        with pytest.raises(errors.InvalidArgumentError, match=r"'flat'.*no surface"):
            Area("flat", geometry)


def geojson(path: Path, features: list[dict[str, Any]], **members: Any) -> Path:
    path.write_text(json.dumps({"type": "FeatureCollection", "features": features, **members}))
    return path


def feature(ring: Any, holes: Any = (), **properties: Any) -> dict[str, Any]:
    rings = [[*part, part[0]] for part in (ring, *holes)]
    return {
        "type": "Feature",
        "properties": properties,
        "geometry": {"type": "Polygon", "coordinates": rings},
    }


def test_geojson_gives_names_and_holes(tmp_path: Path) -> None:
    features = [feature(OUTER, HOLES, Name="yard"), feature(OUTER), feature(HOLES[0], name="yard")]
    areas = read_areas(geojson(tmp_path / "areas.geojson", features))
    assert [area.name for area in areas] == ["yard", "2", "yard (2)"]
    assert areas[0].geometry.equals(shapely.Polygon(OUTER, HOLES))


def test_geojson_in_another_system_is_converted(tmp_path: Path) -> None:
    pyproj = pytest.importorskip("pyproj")
    grid = np.array([(500_010.0, 3_999_990.0), (500_050.0, 3_999_990.0), (500_040.0, 4_000_030.0)])
    to_degrees = pyproj.Transformer.from_crs("EPSG:32647", "OGC:CRS84", always_xy=True)
    degrees = np.column_stack(to_degrees.transform(*grid.T)).tolist()
    plain = geojson(tmp_path / "degrees.geojson", [feature(degrees)])
    named = {"type": "name", "properties": {"name": "urn:ogc:def:crs:EPSG::32647"}}
    same = geojson(tmp_path / "same.geojson", [feature(grid.tolist())], crs=named)
    other = {"type": "name", "properties": {"name": "EPSG:32648"}}
    to_zone_48 = pyproj.Transformer.from_crs("EPSG:32647", "EPSG:32648", always_xy=True)
    moved = np.column_stack(to_zone_48.transform(*grid.T)).tolist()
    zone_48 = geojson(tmp_path / "zone48.geojson", [feature(moved)], crs=other)
    unnamed = geojson(tmp_path / "metres.geojson", [feature(grid.tolist())])
    for path in (plain, same, zone_48, unnamed):
        corners = np.array(read_areas(path, NATIONAL_CRS)[0].outline[0][0][:-1])
        distances = np.linalg.norm(corners[:, None] - grid, axis=2)
        assert distances.min(axis=1).max() < 1e-3, path.name


def test_wkt_lines_may_have_names_and_a_system(tmp_path: Path) -> None:
    path = tmp_path / "areas.wkt"
    path.write_text(
        "# drawn by hand\n\ncrest; POLYGON ((0 0, 4 0, 4 2, 0 2, 0 0), (1 1, 2 1, 2 1.5, 1 1))\n"
        "SRID=32647;MULTIPOLYGON (((0 0, 1 0, 1 1, 0 0)), ((5 5, 6 5, 6 6, 5 5)))\n"
        '"toe"\tPOLYGON Z ((0 0 7, 4 0 7, 4 2 7, 0 0 7))\n'
    )
    areas = read_areas(path, NATIONAL_CRS)
    assert [area.name for area in areas] == ["crest", "2", "toe"]
    assert areas[0].geometry.area == pytest.approx(8 - 0.25)
    assert [len(polygon) for polygon in areas[1].outline] == [1, 1]


def test_a_shapefile_is_read_through_pyogrio(tmp_path: Path) -> None:
    pyogrio = pytest.importorskip("pyogrio")
    geometry = shapely.Polygon(OUTER, HOLES)
    path = tmp_path / "areas.shp"
    pyogrio.raw.write(
        path,
        shapely.to_wkb(np.array([geometry, shapely.box(0, 0, 1, 1)])),
        [np.array(["yard", "corner"], dtype=object)],
        fields=["name"],
        geometry_type="Polygon",
        crs="EPSG:32647",
    )
    areas = read_areas(path, NATIONAL_CRS)
    assert [area.name for area in areas] == ["yard", "corner"]
    assert areas[0].geometry.equals(geometry)


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("missing.geojson", None, "does not exist"),
        ("a.geojson", "{", "cannot be read|does not hold"),
        ("a.geojson", '{"points": []}', "is not GeoJSON"),
        ("a.geojson", '{"type": "FeatureCollection", "features": []}', "no polygon"),
        ("a.geojson", '{"type": "FeatureCollection", "features": [{"geometry": null}]}', "no geometry"),
        ("a.geojson", '{"type": "Polygon", "coordinates": [[[0, 0], [1, 1]]]}', "does not hold"),
        ("a.wkt", "x;y\nPOLYGON ((0 0, 1 1", "does not hold"),
        ("a.wkt", "POLYGON ((0 0))\n", "does not hold .*; export"),
        ("a.wkt", "POLYGON ((0 0, 1 0, 1 1, 0 0))\nwhat\n", "line 2"),
        ("a.gpkg", "nothing", "cannot be read"),
    ],
)
def test_files_that_hold_no_areas_are_refused(
    tmp_path: Path, name: str, content: str | None, words: str
) -> None:
    path = tmp_path / name
    if content is not None:
        path.write_text(content)
    with pytest.raises(errors.ReadError, match=words) as refused:
        read_areas(path)
    assert str(refused.value).startswith(f"{path}: ")


def test_a_line_is_no_area(tmp_path: Path) -> None:
    path = tmp_path / "line.geojson"
    path.write_text('{"type": "LineString", "coordinates": [[0, 0], [1, 1]]}')
    with pytest.raises(errors.ReadError, match=r"line\.geojson: .*no surface"):
        read_areas(path)
    with pytest.raises(errors.InvalidArgumentError, match="areas must be"):
        tmchho.evaluate([[0.0, 0, 0]], [[0.0, 0, 0]], areas=[3])  # type: ignore[list-item]
