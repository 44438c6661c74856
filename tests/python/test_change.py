"""M3C2 against py4dgeo, and on a site whose changes are known."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import tmchho
from tmchho import errors
from tmchho.cloud import PointCloud
from tmchho.simulate import Area, Site, lower_ground, make_site, move_machine, survey_scanner
from tmchho.simulate.materials import Material

BENCH = Area(25.5, 22.5, 35.5, 32.5)
TRUCK = Area(18.5, -20.0, 30.0, -13.0)
SHIFT = (-12.0, 0.0)


def wavy(n: int, lift: float, seed: int) -> NDArray[np.float64]:
    rng = np.random.default_rng(seed)
    xy = rng.uniform(0, 15, (n, 2))
    z = 1.5 * np.sin(xy[:, 0] / 4) * np.cos(xy[:, 1] / 5) + lift + rng.normal(0, 0.02, n)
    return np.column_stack([xy, z])


@pytest.fixture(scope="module")
def py4dgeo(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """The judge, imported where the log that it then writes disturbs nobody."""
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path_factory.mktemp("log"))
        return pytest.importorskip("py4dgeo")


@pytest.mark.parametrize(("radius", "depth"), [(0.5, 2.5), (0.4, 0.3), (0.7, 2.1)])
def test_every_core_has_the_numbers_of_py4dgeo(py4dgeo: Any, radius: float, depth: float) -> None:
    before, after = wavy(12_000, 0.0, 1), wavy(9_000, -0.06, 2)
    # Not on points: py4dgeo counts one exactly between two segments of its cylinder never or twice.
    cores = before[:700] + 0.003
    judge = py4dgeo.M3C2(
        epochs=(py4dgeo.Epoch(before), py4dgeo.Epoch(after)),
        corepoints=cores,
        normal_radii=[0.8],
        cyl_radius=radius,
        max_distance=depth if depth > radius else radius,
        registration_error=0.007,
    )
    distances, doubts = judge.run()
    found = tmchho.m3c2(
        after,
        before,
        cores=cores,
        normal_radii=[0.8],
        cylinder_radius=radius,
        max_depth=depth if depth > radius else radius,
        registration_error=0.007,
    )
    assert np.abs(found.normals - judge.directions()).max() < 1e-9
    assert np.array_equal(found.n_target, doubts["num_samples1"])
    assert np.array_equal(found.n_source, doubts["num_samples2"])
    assert np.isfinite(distances).mean() > 0.95
    for ours, theirs in (
        (found.distance, distances),
        (found.level_of_detection, doubts["lodetection"]),
        (found.target_spread, doubts["spread1"]),
        (found.source_spread, doubts["spread2"]),
    ):
        assert np.array_equal(np.isnan(ours), np.isnan(theirs))
        assert np.nanmax(np.abs(ours - theirs)) < 1e-6


def test_the_flattest_of_several_scales_is_taken_and_measured_as_py4dgeo_does(py4dgeo: Any) -> None:
    before, after = wavy(9_000, 0.0, 3), wavy(9_000, 0.02, 4)
    cores = before[:300] + 0.003
    given: dict[str, Any] = {"cylinder_radius": 0.5, "max_depth": 1.5, "registration_error": 0.0}
    found = tmchho.m3c2(after, before, cores=cores, normal_radii=[0.4, 0.9], **given)
    flatness = {}
    for radius in (0.4, 0.9):
        near = [before[np.linalg.norm(before - core, axis=1) <= radius] for core in cores]
        spread = np.array([np.linalg.eigvalsh(np.cov(points.T)) for points in near])
        flatness[radius] = (spread[:, 1] - spread[:, 0]) / spread[:, 2]
    assert np.array_equal(found.normal_radius, np.where(flatness[0.9] > flatness[0.4], 0.9, 0.4))
    assert 20 < (found.normal_radius == 0.4).sum() < 280
    judge = py4dgeo.M3C2(
        epochs=(py4dgeo.Epoch(before), py4dgeo.Epoch(after)),
        corepoints=cores,
        corepoint_normals=found.normals,
        cyl_radius=0.5,
        max_distance=1.5,
    )
    assert np.nanmax(np.abs(judge.run()[0] - found.distance)) < 1e-6


@pytest.fixture(scope="module")
def site() -> Site:
    return make_site(size_m=90.0, area_ratio=1.0, seed=3)


@pytest.fixture(scope="module")
def epochs(site: Site) -> tuple[PointCloud, PointCloud]:
    """Two surveys from other stations; between them a bench sank by 5 cm and a truck drove off."""
    later = move_machine(lower_ground(site, BENCH, 0.05), TRUCK, SHIFT)
    surveys = (
        survey_scanner(scene, n_points=120_000, stations=6, seed=seed)
        for scene, seed in ((site, 1), (later, 2))
    )
    before, after = (
        tmchho.PointCloud(cloud.xyz[tmchho.remove_outliers(cloud.xyz).indices]) for cloud in surveys
    )
    return before, after


def within(area: Area, points: NDArray[np.float64], margin: float = 0.0) -> NDArray[np.bool_]:
    return (
        (points[:, 0] > area.west - margin)
        & (points[:, 0] < area.east + margin)
        & (points[:, 1] > area.south - margin)
        & (points[:, 1] < area.north + margin)
    )


def parked(area: Area) -> Area:
    return Area(area.west + SHIFT[0], area.south + SHIFT[1], area.east + SHIFT[0], area.north + SHIFT[1])


def test_known_changes_are_significant_and_the_rest_is_not(epochs: tuple[PointCloud, PointCloud]) -> None:
    before, after = epochs
    change = tmchho.m3c2(after, before, registration_error=0.0)
    rim = 2 * change.cylinder_radius
    known = np.isfinite(change.significant_from)
    quiet = known & ~within(BENCH, change.cores, rim)
    quiet &= ~within(TRUCK, change.cores, rim) & ~within(parked(TRUCK), change.cores, rim)
    assert quiet.sum() > 3000
    assert change.is_significant[quiet].mean() < 0.05

    bench = known & within(BENCH, change.cores, -change.cylinder_radius)
    assert bench.sum() > 50
    assert change.is_significant[bench].mean() > 0.85
    assert np.median(change.distance[bench]) == pytest.approx(-0.05, abs=0.005)

    # The truck was 2 m high and more: where it stood the site sank, where it stands now it rose.
    gone = change.is_significant & within(TRUCK, change.cores) & (change.distance < -0.5)
    come = change.is_significant & within(parked(TRUCK), change.cores) & (change.distance > 0.5)
    assert gone.sum() > 10
    assert come.sum() > 10


def test_the_map_of_distances_shows_the_changes(epochs: tuple[PointCloud, PointCloud]) -> None:
    before, after = epochs
    result = tmchho.evaluate(after, before, method="vertical")
    points, distances = after.xyz, result.source_to_target
    assert np.nanmedian(distances[within(BENCH, points, -0.5)]) == pytest.approx(-0.05, abs=0.01)
    elsewhere = ~within(BENCH, points, 1) & ~within(TRUCK, points, 2) & ~within(parked(TRUCK), points, 2)
    assert np.nanmedian(np.abs(distances[elsewhere])) < 0.03
    assert np.nanpercentile(distances[within(parked(TRUCK), points)], 95) > 1.5


def test_the_site_changes_only_where_it_is_told_to(site: Site) -> None:
    lowered = lower_ground(site, BENCH, 0.05)
    sunk = site.ground.heights - lowered.ground.heights
    assert set(np.unique(sunk.round(12))) == {0.0, 0.05}
    assert (sunk > 0).sum() == pytest.approx(100 / site.ground.cell_m**2, rel=0.1)
    moved = move_machine(site, TRUCK, SHIFT)
    steps = np.array([b.centre - a.centre for a, b in zip(site.solids, moved.solids, strict=True)])
    moves = np.abs(steps).max(axis=1) > 0
    assert moves.sum() == 14  # six wheels, and what they carry
    assert all(solid.material != Material.BOULDER for solid, at in zip(site.solids, moves, strict=True) if at)
    assert np.allclose(steps[moves][:, :2], SHIFT)
    assert np.ptp(steps[moves], axis=0).max() < 1e-12
    nowhere = Area(1000.0, 1000.0, 1010.0, 1010.0)
    for change in (lambda: lower_ground(site, nowhere, 1.0), lambda: move_machine(site, nowhere, SHIFT)):
        with pytest.raises(errors.InvalidArgumentError, match="area"):
            change()


def test_the_error_of_the_registration_goes_into_the_level() -> None:
    before, after = wavy(6_000, 0.0, 5), wavy(6_000, 0.01, 6)
    registration = tmchho.register(after, before, config={"coarse": {"rotations_per_round": [8]}}, dof=4)
    change = tmchho.m3c2(after, before, registration)
    error = registration.registration_error
    assert error is not None
    assert change.registration_error == error > 0
    without = tmchho.m3c2(after, before, registration, registration_error=0.0)
    assert np.allclose(
        (change.level_of_detection - without.level_of_detection)[np.isfinite(change.level_of_detection)],
        1.96 * error,
    )
    assert change.warnings == without.warnings == ()
    assert "counts as 0" in tmchho.m3c2(after, before).warnings[0]


def test_scales_follow_from_the_clouds() -> None:
    before, after = wavy(20_000, 0.0, 7), wavy(5_000, 0.0, 8)
    change = tmchho.m3c2(after, before, registration_error=0.0)
    # 20 of 5000 points on 15 m by 15 m lie in a circle of 0.54 m; nine in ten need a little more.
    assert 0.5 < change.cylinder_radius < 0.8
    assert change.max_depth == 10 * change.cylinder_radius
    assert np.median(change.n_source) > 20
    assert len(change.cores) < 20_000 / 10
    sparse = tmchho.m3c2(after, before, registration_error=0.0, cylinder_radius=0.1)
    assert any("larger cylinder radius" in warning for warning in sparse.warnings)


def test_cores_and_areas_and_numbers_that_are_missing() -> None:
    before, after = wavy(6_000, 0.0, 9), wavy(6_000, -0.3, 10)
    cores = np.array([[7.0, 7.0, 0.1], [200.0, 0, 0], [np.nan, 0, 0]])
    change = tmchho.m3c2(after, before, cores=cores, registration_error=0.01)
    assert np.array_equal(change.cores[:2], cores[:2])
    assert np.isfinite(change.distance).tolist() == [True, False, False]
    assert change.is_significant.tolist() == [True, False, False]
    cloud = change.to_point_cloud()
    assert len(cloud) == 2
    assert all(len(name) <= 31 for name in cloud.attributes)
    half = tmchho.Area.box("west", 0, 0, 7.5, 15)
    rows = tmchho.m3c2(after, before, registration_error=0.01, areas=[half], tolerance=0.2).areas
    assert rows[0].share_significant > 0.95
    assert rows[0].share_within < 0.05
    assert rows[0].median == pytest.approx(-0.29, abs=0.02)
    assert len(tmchho.m3c2(after, before, areas="automatic").areas) == 5


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        ({"normal_radii": []}, "normal_radii"),
        ({"normal_radii": [0.0]}, "normal_radii"),
        ({"cylinder_radius": -1.0}, "cylinder_radius"),
        ({"max_depth": 0}, "max_depth"),
        ({"registration_error": -0.1}, "registration_error"),
        ({"min_points": 1}, "min_points"),
        ({"orientation": (0, 0, 0)}, "orientation"),
        ({"orientation": (0, 1)}, "orientation"),
        ({"tolerance": -1}, "tolerance"),
    ],
)
def test_wrong_arguments_are_named(arguments: dict[str, Any], word: str) -> None:
    points = wavy(50, 0.0, 0)
    with pytest.raises(errors.InvalidArgumentError, match=word):
        tmchho.m3c2(points, points, **arguments)
