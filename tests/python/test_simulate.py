"""The simulated site and its surveys against closed forms, scipy and brute force."""

import itertools

import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from tmchho.errors import InvalidArgumentError
from tmchho.simulate import (
    Material,
    Solid,
    make_pair,
    make_site,
    place_stations,
    random_pose,
    survey_photogrammetry,
    survey_scanner,
)
from tmchho.simulate.pair import NATIONAL_ORIGIN
from tmchho.simulate.solids import turned

SMALL = {"size_m": 90.0, "area_ratio": 2.0}
FEW = {"n_photogrammetry_points": 9_000, "n_scanner_points": 7_000, "stations": 3}


@pytest.fixture(scope="module")
def site():
    return make_site(**SMALL, seed=3)


@pytest.fixture(scope="module")
def clean_scan(site):
    """Many points of one survey without noise or strays."""
    return survey_scanner(site, n_points=40_000, stations=4, range_noise_m=0.0, outlier_share=0.0, seed=3)


@pytest.fixture(scope="module")
def still_pair():
    """A pair in the national grid that was not moved."""
    return make_pair(**SMALL, **FEW, pose="identity", seed=3)


def ground_height(site, points):
    """Bilinear height of the bare ground by scipy."""
    ground = site.ground
    n_y, n_x = ground.heights.shape
    axes = (ground.south + ground.cell_m * np.arange(n_y), ground.west + ground.cell_m * np.arange(n_x))
    return RegularGridInterpolator(axes, ground.heights)(points[:, 1::-1])


def signed_distance(solid, points):
    """Distance to the surface of a solid, negative inside; exact but for ellipsoids, where it is a bound."""
    local = (points - solid.centre) @ solid.axes
    if solid.shape == "ellipsoid":
        # Newton step on |p/h| - 1: first order in the distance, exact on the surface.
        size = np.linalg.norm(local / solid.half_m, axis=1)
        return (size - 1.0) * size / np.linalg.norm(local / solid.half_m**2, axis=1)
    if solid.shape == "cylinder":
        away = np.column_stack(
            [np.hypot(local[:, 0], local[:, 1]) - solid.half_m[0], np.abs(local[:, 2]) - solid.half_m[2]]
        )
    else:
        away = np.abs(local) - solid.half_m
    return np.linalg.norm(np.maximum(away, 0.0), axis=1) + np.minimum(away.max(axis=1), 0.0)


def distance_to_site(site, points):
    """Distance of every point to the nearest surface; for the ground, the height over the steepness."""
    east, north = 0.05 * np.eye(3)[:2]
    climb_east = ground_height(site, points + east) - ground_height(site, points - east)
    climb_north = ground_height(site, points + north) - ground_height(site, points - north)
    steepness = np.sqrt(1.0 + (climb_east**2 + climb_north**2) / 0.1**2)
    nearest = np.abs(points[:, 2] - ground_height(site, points)) / steepness
    for solid in site.solids:
        close = np.flatnonzero(np.linalg.norm(points - solid.centre, axis=1) < solid.radius_m + 5.0)
        nearest[close] = np.minimum(nearest[close], np.abs(signed_distance(solid, points[close])))
    return nearest


def cells(points, cell_m):
    """The set of plan cells that hold points."""
    return {tuple(cell) for cell in np.floor(points[:, :2] / cell_m).astype(int)}


# --- the scene ---------------------------------------------------------------------------------------


def test_the_site_has_what_a_dam_site_has(site):
    materials = {solid.material for solid in site.solids} | set(np.unique(site.ground.materials))
    assert {Material.ROCKFILL, Material.FILL, Material.ROCK, Material.ROAD, Material.WATER} <= materials
    assert {Material.BOULDER, Material.YELLOW_STEEL, Material.WALL, Material.ROOF} <= materials
    assert sum(solid.shape == "ellipsoid" for solid in site.solids) > 50
    # The downstream face climbs in benches: going up across it, steep and flat stretches alternate.
    y = np.linspace(-20.0, 30.0, 400)
    climb = np.gradient(site.ground.height(np.full_like(y, 30.0), y), y)
    smooth = np.convolve(climb, np.ones(12) / 12.0, mode="valid")
    changes = np.count_nonzero(np.diff(smooth > 0.35))
    assert changes >= 6


def test_bilinear_ground_agrees_with_scipy(site):
    rng = np.random.default_rng(0)
    area = site.photogrammetry_area
    points = np.column_stack(
        [rng.uniform(area.west, area.east, 500), rng.uniform(area.south, area.north, 500), np.zeros(500)]
    )
    ours = site.ground.height(points[:, 0], points[:, 1])
    np.testing.assert_allclose(ours, ground_height(site, points), atol=1e-9)


def test_a_larger_site_shows_the_same_ground_and_boulders(site):
    larger = make_site(size_m=90.0, area_ratio=3.0, seed=3)
    shift_x = round((site.ground.west - larger.ground.west) / site.ground.cell_m)
    shift_y = round((site.ground.south - larger.ground.south) / site.ground.cell_m)
    n_y, n_x = site.ground.heights.shape
    part = larger.ground.heights[shift_y : shift_y + n_y, shift_x : shift_x + n_x]
    np.testing.assert_allclose(part, site.ground.heights, atol=1e-12)
    ours = np.array([solid.centre for solid in site.solids])
    distance, _ = cKDTree([solid.centre for solid in larger.solids]).query(ours)
    assert distance.max() < 1e-9


def test_no_part_of_the_site_repeats(site):
    """The ground under shifts and half turns of itself is nowhere near the same."""
    heights = site.ground.heights[::8, ::8]
    inner = heights[10:-10, 10:-10]
    for rows, columns in itertools.product((-10, 0, 10), (-10, 0, 10)):
        if rows or columns:
            moved = heights[
                10 + rows : len(heights) - 10 + rows, 10 + columns : heights.shape[1] - 10 + columns
            ]
            assert np.std(moved - inner) > 0.5
    assert np.std(inner - inner[::-1, ::-1]) > 5.0


SHAPES = ("box", "ellipsoid", "cylinder")


@pytest.mark.parametrize("shape", SHAPES)
def test_rays_hit_solids_where_a_fine_march_does(shape):
    half_m = np.array([1.5, 1.5, 0.7]) if shape == "cylinder" else np.array([2.0, 1.0, 0.7])
    solid = Solid(shape, np.array([3.0, -2.0, 1.0]), turned(0.7, 0.4, -0.3), half_m, Material.BOULDER)
    rng = np.random.default_rng(5)
    starts = rng.standard_normal((300, 3))
    starts = solid.centre + 6.0 * starts / np.linalg.norm(starts, axis=1, keepdims=True)
    directions = solid.centre + rng.uniform(-1.5, 1.5, (300, 3)) - starts
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    found = solid.first_hit(starts, directions)
    assert 100 < np.isfinite(found).sum() < 300
    for start, direction, hit in zip(starts, directions, found, strict=True):
        along = np.arange(0.0, 12.0, 0.004)
        inside = np.flatnonzero(signed_distance(solid, start + along[:, None] * direction) < 0.0)
        if len(inside):
            assert hit == pytest.approx(along[inside[0]], abs=0.005)
        elif np.isfinite(hit):
            # A grazing chord shorter than the march's step.
            assert abs(signed_distance(solid, (start + hit * direction)[None])[0]) < 1e-6
    points = (starts + found[:, None] * directions)[np.isfinite(found)]
    normals = solid.normals(points)
    assert (signed_distance(solid, points + 1e-3 * normals) > 5e-4).all()
    assert not solid.contains(points + 1e-6 * normals).any()
    assert solid.contains(points - 1e-6 * normals).all()


# --- the scanner -------------------------------------------------------------------------------------


def test_scanner_points_lie_on_the_surface_and_below_nothing(site, clean_scan):
    distance = distance_to_site(site, clean_scan.xyz)
    assert np.quantile(distance, 0.999) < 1e-3
    assert (clean_scan.xyz[:, 2] - ground_height(site, clean_scan.xyz)).min() > -0.01


def test_range_noise_is_along_the_ray_and_as_large_as_asked(site, clean_scan):
    noisy = survey_scanner(site, n_points=40_000, stations=4, range_noise_m=0.02, outlier_share=0.0, seed=3)
    eyes = place_stations(site, 4, seed=3)[clean_scan.attributes["point_source_id"] - 1]
    error, ray = noisy.xyz - clean_scan.xyz, clean_scan.xyz - eyes
    ray /= np.linalg.norm(ray, axis=1, keepdims=True)
    along = np.einsum("ij,ij->i", error, ray)
    assert np.std(along) == pytest.approx(0.02, rel=0.03)
    assert abs(along.mean()) < 5e-4
    np.testing.assert_allclose(np.linalg.norm(error, axis=1), np.abs(along), atol=1e-9)


def test_nothing_stands_between_a_station_and_its_points(site, clean_scan):
    rng = np.random.default_rng(1)
    rows = rng.choice(len(clean_scan), 150, replace=False)
    points = clean_scan.xyz[rows]
    eyes = place_stations(site, 4, seed=3)[clean_scan.attributes["point_source_id"][rows] - 1]
    share = np.linspace(0.0, 1.0, 1000)[None, :, None]
    path = (eyes[:, None] + share * (points - eyes)[:, None]).reshape(-1, 3)
    free = np.linalg.norm((path.reshape(150, -1, 3) - points[:, None]), axis=2).ravel() > 0.05
    assert (path[:, 2] > ground_height(site, path) - 0.02)[free].all()
    for solid in site.solids:
        close = np.flatnonzero(free & (np.linalg.norm(path - solid.centre, axis=1) < solid.radius_m))
        assert not (signed_distance(solid, path[close]) < -0.01).any()


def test_the_building_casts_a_shadow_for_one_station(site):
    walls = [solid for solid in site.solids if solid.material is Material.WALL]
    office = max(walls, key=lambda solid: np.prod(solid.half_m))
    # A station in front of the office; what lies on the other side is hidden.
    across = office.axes[:, 1]
    front = office.centre[:2] + 16.0 * across[:2]
    behind = office.centre[:2] - 6.5 * across[:2]
    options = {"n_points": 20_000, "outlier_share": 0.0, "seed": 3}

    def count_behind(stations):
        xyz = survey_scanner(site, stations=stations, **options).xyz
        near = np.linalg.norm(xyz[:, :2] - behind, axis=1) < 2.5
        return np.count_nonzero(near & (xyz[:, 2] < office.centre[2]))

    assert count_behind([front]) == 0
    assert count_behind([office.centre[:2] - 12.0 * across[:2]]) > 50


def test_density_falls_with_the_range(site):
    eye = place_stations(site, 1, seed=3)[0]
    cloud = survey_scanner(
        site, stations=[eye[:2]], n_points=40_000, thinning_range_m=0.0, outlier_share=0.0, seed=3
    )
    away = np.linalg.norm(cloud.xyz - eye, axis=1)
    # Points per occupied square metre, ring by ring.
    density = []
    for near, far in ((3.0, 6.0), (6.0, 12.0), (12.0, 24.0), (24.0, 48.0)):
        ring = cloud.xyz[(away >= near) & (away < far)]
        density.append(len(ring) / len(cells(ring, 1.0)))
    assert all(inner > 1.5 * outer for inner, outer in itertools.pairwise(density))
    # Thinning evens out the near field.
    thinned = survey_scanner(site, stations=[eye[:2]], n_points=40_000, thinning_range_m=18.0, seed=3)
    share = np.mean(np.linalg.norm(thinned.xyz - eye, axis=1) < 6.0)
    assert share < 0.3 * np.mean(away < 6.0)


def test_grazing_rays_and_still_water_are_lost(site, clean_scan):
    classes = clean_scan.attributes["classification"]
    share_of_water = np.mean(site.ground.materials == Material.WATER)
    assert np.mean(classes == 9) < 0.3 * share_of_water
    kept = survey_scanner(site, stations=4, n_points=40_000, max_range_m=30.0, seed=3)
    eyes = place_stations(site, 4, seed=3)[kept.attributes["point_source_id"] - 1]
    right = kept.attributes["classification"] != 18
    away = np.linalg.norm(kept.xyz - eyes, axis=1)[right]
    assert away.max() < 30.1
    # Returns fade towards the reach.
    assert np.mean(away > 28.5) < 0.02


def test_scanner_strays_are_counted_and_off_the_surface(site):
    cloud = survey_scanner(site, stations=3, n_points=10_000, outlier_share=0.05, seed=3)
    strays = cloud.attributes["classification"] == 18
    assert strays.sum() == 500
    distance = distance_to_site(site, cloud.xyz)
    assert np.median(distance[strays]) > 0.2
    assert np.quantile(distance[~strays], 0.99) < 0.02


# --- the photogrammetry ------------------------------------------------------------------------------


def test_photogrammetry_without_smoothing_lies_on_the_surface(site):
    cloud = survey_photogrammetry(
        site, n_points=20_000, noise_m=0.0, smoothing_spacings=0.0, outlier_share=0.0, seed=3
    )
    # The seen surface is a grid of 0.25 m, so the edges of solids are rounded to that.
    ground = cloud.attributes["classification"] == 2
    assert np.quantile(distance_to_site(site, cloud.xyz[ground]), 0.97) < 1e-6
    assert np.quantile(distance_to_site(site, cloud.xyz), 0.95) < 0.1


def test_photogrammetric_noise_is_as_large_as_asked_and_grows_on_steep_faces(site):
    options = {"n_points": 60_000, "outlier_share": 0.0, "seed": 3}
    still = survey_photogrammetry(site, noise_m=0.0, smoothing_spacings=0.0, **options)
    noisy = survey_photogrammetry(site, noise_m=0.05, smoothing_spacings=0.0, **options)
    error = np.linalg.norm(noisy.xyz - still.xyz, axis=1)
    ground = still.attributes["classification"] == 2
    slope = np.hypot(*site.ground.gradient(still.xyz[:, 0], still.xyz[:, 1]))
    level, steep = ground & (slope < 0.1), ground & (slope > 1.0)
    assert np.sqrt(np.mean(error[level] ** 2)) == pytest.approx(0.05, rel=0.05)
    assert np.sqrt(np.mean(error[steep] ** 2)) > 1.4 * np.sqrt(np.mean(error[level] ** 2))


def test_smoothing_rounds_the_edges(site):
    """Boulders lose height; the rest stays about where it is."""
    options = {"n_points": 60_000, "noise_m": 0.0, "outlier_share": 0.0, "seed": 3}
    sharp = survey_photogrammetry(site, smoothing_spacings=0.0, **options)
    smooth = survey_photogrammetry(site, smoothing_spacings=2.5, **options)

    boulders = [s for s in site.solids if s.shape == "ellipsoid" and 0.5 < s.half_m.min() < 1.2]
    tops = np.array([s.centre for s in boulders])

    def mean_height(cloud):
        distance, nearest = cKDTree(tops[:, :2]).query(cloud.xyz[:, :2])
        on_top = distance < 0.3
        return np.mean(cloud.xyz[on_top, 2] - tops[nearest[on_top], 2])

    assert mean_height(smooth) < mean_height(sharp) - 0.1
    assert np.median(distance_to_site(site, smooth.xyz)) < 0.05


def test_photogrammetry_is_even_and_sees_nothing_below_the_eaves(site):
    cloud = survey_photogrammetry(site, n_points=150_000, noise_m=0.005, outlier_share=0.0, seed=3)
    counts = np.unique(np.floor(cloud.xyz[:, :2] / 2.0), axis=0, return_counts=True)[1]
    # Chance alone would give a relative deviation of sqrt(mean) / mean; steep places add to it.
    assert np.median(np.abs(counts - np.median(counts))) < 0.6 * np.sqrt(np.median(counts))

    office = max(
        (solid for solid in site.solids if solid.material is Material.WALL and solid.shape == "box"),
        key=lambda solid: np.prod(solid.half_m),
    )
    local = (cloud.xyz - office.centre) @ office.axes
    # Beside the long walls: 0.1 to 0.8 m away is under the eaves, which end 1.4 m away.
    beside = (np.abs(local[:, 0]) < 5.0) & (np.abs(np.abs(local[:, 1]) - office.half_m[1] - 0.5) < 0.35)
    assert np.count_nonzero(beside & (np.abs(local[:, 2]) < 1.5)) == 0
    # Nor is there a curtain from the eaves down to the ground.
    curtain = (np.abs(local[:, 0]) < 5.0) & (np.abs(np.abs(local[:, 1]) - office.half_m[1] - 1.6) < 0.7)
    assert np.count_nonzero(curtain & (np.abs(local[:, 2]) < 0.6)) < 5
    # The walls are seen by the oblique cameras, but not right below the eaves.
    on_wall = (np.abs(local[:, 0]) < 5.0) & (np.abs(np.abs(local[:, 1]) - office.half_m[1]) < 0.3)
    assert np.count_nonzero(on_wall & (np.abs(local[:, 2] + 1.0) < 0.7)) > 30
    assert np.count_nonzero(on_wall & (np.abs(local[:, 2] - 1.4) < 0.4)) == 0


def test_colours_show_the_materials(site):
    cloud = survey_photogrammetry(site, n_points=60_000, outlier_share=0.0, seed=3)
    red, green, blue = (cloud.attributes[name].astype(float) for name in ("red", "green", "blue"))
    assert all(cloud.attributes[name].dtype == np.uint16 for name in ("red", "green", "blue"))
    yellow = (red > 1.8 * blue) & (green > 1.4 * blue) & (red > 20_000)
    machines = np.array([s.centre for s in site.solids if s.material is Material.YELLOW_STEEL])
    distance, _ = cKDTree(machines).query(cloud.xyz[yellow])
    assert yellow.sum() > 200
    assert np.quantile(distance, 0.9) < 4.0


# --- the pair ----------------------------------------------------------------------------------------


def test_one_seed_gives_one_pair_to_the_last_bit():
    first, again, other = (make_pair(**SMALL, **FEW, seed=seed) for seed in (3, 3, 4))
    for one, two in ((first.source, again.source), (first.target, again.target)):
        assert one.xyz.tobytes() == two.xyz.tobytes()
        assert sorted(one.attributes) == sorted(two.attributes)
        for key, values in one.attributes.items():
            assert values.tobytes() == two.attributes[key].tobytes()
    assert first.target_from_source.tobytes() == again.target_from_source.tobytes()
    assert not np.array_equal(first.target.xyz, other.target.xyz)
    assert not np.array_equal(first.target_from_source, other.target_from_source)


def test_an_argument_of_one_sensor_leaves_the_other_alone(still_pair):
    more = {"scanner_noise_m": 0.02, "scanner_outlier_share": 0.05}
    changed = make_pair(**SMALL, **FEW, **more, pose="identity", seed=3)
    assert np.array_equal(still_pair.source.xyz, changed.source.xyz)
    # The same rays come back, with other noise on them.
    shift = np.linalg.norm(still_pair.target.xyz - changed.target.xyz, axis=1)
    assert 0.005 < np.median(shift) < 0.03
    assert shift.max() > 1.0


def test_the_pose_is_exact_at_national_grid_size(still_pair):
    still = still_pair
    moved = make_pair(**SMALL, **FEW, pose="random", seed=3)
    assert np.array_equal(still.target_from_source, np.eye(4))
    assert np.array_equal(still.target.xyz, moved.target.xyz)
    assert still.source.crs is not None
    assert moved.source.crs is None

    pose = moved.target_from_source
    back = moved.source.xyz @ pose[:3, :3].T + pose[:3, 3]
    assert np.abs(back - still.source.xyz).max() < 2e-8
    assert np.linalg.det(pose[:3, :3]) == pytest.approx(1.0, abs=1e-12)
    turn = Rotation.from_matrix(pose[:3, :3]).magnitude()
    assert turn > 0.2
    # About the centroid, by at most one diagonal.
    shift = moved.source.xyz.mean(axis=0) - still.source.xyz.mean(axis=0)
    assert 1.0 < np.linalg.norm(shift) < np.linalg.norm(np.ptp(still.source.xyz, axis=0))
    # And moved back it lies on the site, in the same frame as the scanner's points.
    for xyz, limit in ((back, 0.4), (moved.target.xyz, 0.02)):
        assert np.median(distance_to_site(moved.site, xyz - NATIONAL_ORIGIN)) < limit / 4.0
        assert np.quantile(distance_to_site(moved.site, xyz - NATIONAL_ORIGIN), 0.9) < limit


def test_a_given_pose_is_the_true_pose(still_pair):
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_euler("xyz", [0.3, -0.2, 1.1]).as_matrix()
    pose[:3, 3] = [10.0, -20.0, 30.0]
    pair = make_pair(**SMALL, **FEW, pose=pose, national_grid=False, seed=3)
    assert np.array_equal(pair.target_from_source, pose)
    back = pair.source.xyz @ pose[:3, :3].T + pose[:3, 3]
    np.testing.assert_allclose(back, still_pair.source.xyz - NATIONAL_ORIGIN, atol=2e-9)
    assert pair.target.crs is None
    assert np.abs(pair.target.xyz).max() < 100.0


@pytest.mark.parametrize(("ratio", "overlap"), [(1.0, 1.0), (1.0, 0.4), (2.0, 0.7), (5.0, 1.0)])
def test_area_ratio_overlap_and_counts_are_as_asked(ratio, overlap):
    pair = make_pair(
        size_m=80.0, area_ratio=ratio, overlap=overlap, pose="identity", national_grid=False, seed=1, **FEW
    )
    assert (len(pair.source), len(pair.target)) == (9_000, 7_000)
    source, target = (
        cloud.xyz[cloud.attributes["classification"] != 18] for cloud in (pair.source, pair.target)
    )
    low, high = source[:, :2].min(axis=0), source[:, :2].max(axis=0)
    assert np.prod(high - low) / 80.0**2 == pytest.approx(ratio, rel=0.03)
    shared = np.minimum(high, target[:, :2].max(axis=0)) - np.maximum(low, target[:, :2].min(axis=0))
    assert np.prod(shared) / 80.0**2 == pytest.approx(overlap, rel=0.04)
    # Within the shared rectangle every scanned place has photogrammetry near it, beyond it none.
    inside = ((target[:, :2] > low) & (target[:, :2] < high)).all(axis=1)
    distance, _ = cKDTree(source[:, :2]).query(target[:, :2])
    spacing = np.sqrt(np.prod(high - low) / len(source))
    assert np.quantile(distance[inside], 0.95) < 2.0 * spacing
    assert (overlap == 1.0) == (np.mean(inside) > 0.97)
    if ratio > 1.0:
        offset = np.linalg.norm(source[:, :2].mean(axis=0) - target[:, :2].mean(axis=0))
        assert offset > 5.0


@pytest.mark.parametrize(("ratio", "density_ratio"), [(1.0, 4.0), (3.0, 0.5)])
def test_the_density_ratio_is_that_of_points_per_area(ratio, density_ratio):
    pair = make_pair(
        size_m=80.0, area_ratio=ratio, n_scanner_points=6_000, density_ratio=density_ratio, stations=3, seed=1
    )
    flown, scanned = pair.site.photogrammetry_area, pair.site.scanner_area
    per_area = (len(pair.target) / scanned.square_metres) / (len(pair.source) / flown.square_metres)
    assert per_area == pytest.approx(density_ratio, rel=1e-3)
    # A number of points beside it would be a second word on the same thing.
    with pytest.raises(InvalidArgumentError, match="leave out n_photogrammetry_points"):
        make_pair(**SMALL, n_photogrammetry_points=100, density_ratio=density_ratio)


def test_random_poses_are_rigid_even_and_within_the_shift():
    rng = np.random.default_rng(2)
    poses = np.array([random_pose(rng, 3.0) for _ in range(4000)])
    rotations, shifts = poses[:, :3, :3], poses[:, :3, 3]
    np.testing.assert_allclose(
        rotations @ rotations.transpose(0, 2, 1), np.eye(3)[None].repeat(4000, 0), atol=1e-12
    )
    assert (np.linalg.det(rotations) > 0.0).all()
    assert (np.linalg.norm(shifts, axis=1) <= 3.0).all()
    # Evenly over SO(3): the images of a vector average to nothing, and half of all angles exceed
    # the median of (angle - sin angle) / pi, which is 132.3 degrees.
    assert np.abs(rotations.mean(axis=0)).max() < 0.05
    angles = np.degrees(Rotation.from_matrix(rotations).magnitude())
    assert np.median(angles) == pytest.approx(132.3, abs=1.5)
    assert np.array_equal(random_pose(np.random.default_rng(0), 0.0)[:3, 3], np.zeros(3))


MIRROR = np.diag([1.0, 1.0, -1.0, 1.0])


@pytest.mark.parametrize(
    ("argument", "value"),
    [
        ("size_m", 10.0),
        ("size_m", np.nan),
        ("size_m", "large"),
        ("area_ratio", 0.5),
        ("area_ratio", 17),
        ("overlap", 0.1),
        ("overlap", 1.2),
        ("centre_offset", (2.0, 0.0)),
        ("centre_offset", "middle"),
        ("centre_offset", (0.0,)),
        ("n_photogrammetry_points", 0),
        ("n_photogrammetry_points", 10.5),
        ("density_ratio", 0.0),
        ("density_ratio", "half"),
        ("n_scanner_points", -5),
        ("n_scanner_points", True),
        ("stations", 0),
        ("stations", True),
        ("stations", [[1e6, 0.0]]),
        ("stations", [[0.0, 0.0, 0.0]]),
        ("stations", "three"),
        ("photogrammetry_noise_m", -0.1),
        ("scanner_noise_m", np.inf),
        ("photogrammetry_outlier_share", 0.9),
        ("scanner_outlier_share", -0.1),
        ("national_grid", "yes"),
        ("pose", "sideways"),
        ("pose", MIRROR),
        ("pose", 2.0 * np.eye(4)),
        ("pose", np.eye(3)),
        ("pose", np.full((4, 4), np.nan)),
        ("seed", -1),
        ("seed", 1.5),
    ],
)
def test_wrong_arguments_are_named(argument, value):
    few = {**FEW, "n_photogrammetry_points": None} if argument == "density_ratio" else FEW
    with pytest.raises(InvalidArgumentError, match=argument):
        make_pair(**{**SMALL, **few, argument: value})


def test_a_station_inside_a_solid_is_refused(site):
    office = next(solid for solid in site.solids if solid.material is Material.WALL)
    with pytest.raises(InvalidArgumentError, match="inside a solid"):
        survey_scanner(site, stations=[office.centre[:2]], n_points=10)


def test_too_fine_a_grid_is_refused():
    with pytest.raises(InvalidArgumentError, match="cell_m"):
        make_site(size_m=500.0, area_ratio=16.0, cell_m=0.05)
