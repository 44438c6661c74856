"""A network fused in tiles, held against all points at once."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from tmchho import PointCloud, Transform, read, write
from tmchho.errors import InvalidArgumentError
from tmchho.network.engine import InProcess
from tmchho.network.store import Resumed, Store
from tmchho.network.tiles import PlacedCloud, cut_cells, fuse_network

REACH, RADIUS = 0.3, 0.05
WORLD = np.array([500_000.0, 5_400_000.0, 200.0])


@pytest.fixture(scope="module")
def stations(tmp_path_factory: pytest.TempPathFactory) -> list[PlacedCloud]:
    """Three stations on a wavy floor; LAS with colours, LAS without, PLY with 8-bit colours."""
    folder = tmp_path_factory.mktemp("stations")
    generator = np.random.default_rng(7)
    placed = []
    for number, (name, n_points) in enumerate((("a.laz", 4000), ("b.las", 3000), ("c.ply", 2500))):
        turn, shift = 0.7 * number, np.array([6.0 * number, 1.0 * number, 0.3 * number])
        xy = generator.uniform(-8.0, 8.0, (n_points, 2))
        local = np.column_stack([xy, np.zeros(n_points)])
        matrix = np.eye(4)
        matrix[:2, :2] = [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
        matrix[:3, 3] = shift + WORLD
        world = local @ matrix[:3, :3].T + matrix[:3, 3]
        height = 0.5 * np.sin(world[:, 0] - WORLD[0]) - 0.3 * number + generator.normal(0.0, 0.02, n_points)
        local[:, 2] = height
        attributes: dict[str, NDArray[Any]] = {"intensity": np.arange(n_points, dtype=np.uint16)}
        if number != 1:
            kind, top = (np.uint16, 60_000) if number == 0 else (np.uint8, 255)
            attributes |= {c: np.full(n_points, top, dtype=kind) for c in ("red", "green", "blue")}
        if number == 2:
            local[5] = np.nan
        write(PointCloud(local, attributes=attributes), folder / name)
        placed.append(PlacedCloud(name[0], folder / name, matrix))
    return placed


def expected_of(stations: list[PlacedCloud]) -> list[tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """Return the places of all finite points and their distances to other stations, by scipy."""
    places = []
    for station in stations:
        xyz = read(station.path).xyz
        places.append(Transform.of(station.world_from_station).apply(xyz[np.isfinite(xyz).all(axis=1)]))
    found = []
    for k, own in enumerate(places):
        others = np.concatenate(places[:k] + places[k + 1 :])
        found.append((own, np.asarray(cKDTree(others - WORLD).query(own - WORLD)[0])))
    return found


@pytest.mark.parametrize(("points_per_tile", "n_workers"), [(10_000_000, 1), (900, 2), (40, 3)])
def test_distances_are_those_of_all_points_wherever_the_cuts_lie(
    stations: list[PlacedCloud], tmp_path: Path, points_per_tile: int, n_workers: int
) -> None:
    report = fuse_network(
        stations,
        tmp_path / "fused.laz",
        engine=InProcess(n_workers),
        folder=tmp_path / "work",
        reach=REACH,
        points_per_tile=points_per_tile,
    )
    fused = read(tmp_path / "fused.laz")
    expected = expected_of(stations)
    assert report["n_points"] == len(fused) == sum(len(own) for own, _ in expected)
    assert (report["n_tiles"] == 1) == (points_per_tile > 9500)
    for number, (own, distances) in enumerate(expected, start=1):
        mine = fused.attributes["point_source_id"] == number
        away, there = cKDTree(fused.xyz[mine] - WORLD).query(own - WORLD)
        assert away.max() < 1e-4  # the steps of the file
        assert len(set(there.tolist())) == len(own)
        told = fused.attributes["C2C_absolute_distances"][mine][there]
        within = distances <= REACH
        np.testing.assert_array_equal(np.isfinite(told), within)
        np.testing.assert_allclose(told[within], distances[within], atol=1e-6)
        figures = report["stations"][number - 1]
        inside = distances[distances <= REACH]
        assert figures["n_points"] == len(own)
        assert figures["share_with_counterpart"] == pytest.approx(len(inside) / len(own))
        assert figures["rms"] == pytest.approx(float(np.sqrt((inside**2).mean())), rel=1e-5)
        assert figures["median"] == pytest.approx(float(np.median(inside)), abs=REACH / 200)
        assert figures["percentile_95"] == pytest.approx(float(np.quantile(inside, 0.95)), abs=REACH / 200)


def test_what_repeats_an_earlier_station_is_left_out(stations: list[PlacedCloud], tmp_path: Path) -> None:
    report = fuse_network(
        stations,
        tmp_path / "fused.las",
        engine=InProcess(2),
        folder=tmp_path / "work",
        reach=REACH,
        mode="dedup",
        repeat_radius=RADIUS,
        points_per_tile=700,
    )
    places = [own for own, _ in expected_of(stations)]
    n_kept = [len(places[0])]
    for k in (1, 2):
        earlier = cKDTree(np.concatenate(places[:k]) - WORLD)
        n_kept.append(int((earlier.query(places[k] - WORLD)[0] > RADIUS).sum()))
    fused = read(tmp_path / "fused.las")
    assert np.bincount(fused.attributes["point_source_id"])[1:].tolist() == n_kept
    assert report["n_repeated"] == sum(map(len, places)) - sum(n_kept)
    assert report["n_repeated"] > 0
    # The figures are those of all points.
    assert [station["n_points"] for station in report["stations"]] == [len(own) for own in places]


def test_attributes_come_along_and_colours_use_16_bits(stations: list[PlacedCloud], tmp_path: Path) -> None:
    fuse_network(
        stations, tmp_path / "f.laz", engine=InProcess(2), folder=tmp_path, reach=REACH, points_per_tile=2000
    )
    fused = read(tmp_path / "f.laz")
    source = fused.attributes["point_source_id"]
    for number, red in ((1, 60_000), (2, 0), (3, 255 * 256)):
        assert set(fused.attributes["red"][source == number].tolist()) == {red}
    intensities = np.sort(fused.attributes["intensity"][source == 1])
    np.testing.assert_array_equal(intensities, np.arange(4000))


def test_a_second_run_takes_everything_from_the_store(stations: list[PlacedCloud], tmp_path: Path) -> None:
    def fuse_into(name: str) -> bytes:
        fuse_network(
            stations,
            tmp_path / name,
            engine=Resumed(InProcess(2), Store(tmp_path / "store")),
            folder=tmp_path / "work",
            reach=REACH,
            points_per_tile=900,
        )
        return (tmp_path / name).read_bytes()

    first = fuse_into("first.laz")
    times = {path: path.stat().st_mtime_ns for path in (tmp_path / "work").rglob("*.*")}
    assert fuse_into("second.laz") == first
    assert {path: path.stat().st_mtime_ns for path in times} == times


def test_tiles_share_no_cell_and_hold_no_more_than_asked_for() -> None:
    generator = np.random.default_rng(3)
    stations = []
    for _ in range(3):
        cells = np.unique(generator.normal(0, 9, (200, 2)).round().astype(int), axis=0)
        stations.append([*cells.T.tolist(), generator.integers(1, 60, len(cells)).tolist()])
    every = np.concatenate([np.array(station).T for station in stations])
    tiles = cut_cells(stations, 150)
    holders = sum(
        ((every[:, :2] >= first) & (every[:, :2] <= last)).all(axis=1).astype(int) for first, last in tiles
    )
    assert np.all(holders == 1)
    for first, last in tiles:
        inside = ((every[:, :2] >= first) & (every[:, :2] <= last)).all(axis=1)
        assert every[inside, 2].sum() <= 150 or (first == last).all()


@pytest.mark.parametrize(("reach", "radius"), [(0.0, 0.0), (np.nan, 0.0), (0.1, 0.2), (0.1, -1.0)])
def test_a_reach_that_means_nothing_is_refused(
    stations: list[PlacedCloud], tmp_path: Path, reach: float, radius: float
) -> None:
    with pytest.raises(InvalidArgumentError, match=r"reach|repeat_radius"):
        fuse_network(
            stations,
            tmp_path / "f.laz",
            engine=InProcess(1),
            folder=tmp_path,
            reach=reach,
            repeat_radius=radius,
        )
