"""Clouds in parts: the same centroids, distances, flags and attributes as from clouds in memory."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pytest
from click.testing import CliRunner
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

import tmchho
from tmchho import _core
from tmchho.cli import main
from tmchho.errors import InvalidArgumentError, InvalidCloudError, ReadError
from tmchho.io import las_parts, open_las
from tmchho.selection import Polygon, Selection
from tmchho.streams import fuse_files, memory, parse_bytes, register_files, route
from tmchho.streams.distances import DistanceFile
from tmchho.streams.thin import ThinnedFile, thin_file
from tmchho.streams.tiles import cut_space, sort_into_tiles
from tmchho.transform import Transform

Floats = NDArray[np.float64]
TRUE = np.eye(4)
TRUE[:3, :3] = Rotation.from_rotvec([0.1, -0.2, 1.9]).as_matrix()
TRUE[:3, 3] = [500_030.0, 4_000_040.0, 210.0]


def hills(n_points: int, low: float, high: float, seed: int) -> Floats:
    """Return points of hilly ground, 60 m wide, in a local frame."""
    rng = np.random.default_rng(seed)
    xy = rng.uniform([low, 0], [high, 60], (n_points, 2))
    z = 3 * np.sin(0.31 * xy[:, 0]) * np.cos(0.23 * xy[:, 1]) + 2 * np.sin(0.11 * xy[:, 0] + 0.07 * xy[:, 1])
    bumps = np.random.default_rng(0).uniform([0, 0], [80, 60], (60, 2))
    squared = 4 - ((xy[:, None] - bumps) ** 2).sum(axis=2)
    z += np.sqrt(np.maximum(squared, 0)).max(axis=1)
    return np.column_stack([xy, z]) + rng.normal(0, 0.01, (n_points, 3))


def write_las(
    path: Path, xyz: Floats, point_format: int, extra: dict[str, NDArray[Any]], seed: int, brightest: int
) -> None:
    rng = np.random.default_rng(seed)
    n = len(xyz)
    header = laspy.LasHeader(version="1.4" if point_format > 5 else "1.2", point_format=point_format)
    header.scales, header.offsets = [0.001] * 3, np.floor(xyz.min(axis=0))
    for name, values in extra.items():
        header.add_extra_dim(laspy.ExtraBytesParams(name, values.dtype))
    las = laspy.LasData(header)
    las.xyz = xyz
    las.intensity = rng.integers(1, 60_000, n)
    las.classification = rng.integers(1, 8, n)
    las.return_number = rng.integers(1, 4, n)
    las.synthetic = rng.integers(0, 2, n)
    las.gps_time = rng.uniform(1, 2, n)
    if "scan_angle_rank" in las.point_format.dimension_names:
        las.scan_angle_rank = rng.integers(-30, 30, n)
    if "red" in las.point_format.dimension_names:
        for name in ("red", "green", "blue"):
            las[name] = rng.integers(1, brightest, n)
    for name, values in extra.items():
        las[name] = values
    las.write(path)


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Two files of different layouts, the target in the national grid, with an overlap of two thirds."""
    folder = tmp_path_factory.mktemp("streams")
    source, target = hills(30_000, 0, 60, 1), hills(20_000, 20, 80, 2)
    rng = np.random.default_rng(5)
    write_las(
        folder / "source.laz",
        source + np.array([30.0, 40.0, 10.0]),
        3,
        {"quality": rng.integers(1, 9, 30_000).astype(np.uint8), "shared": rng.normal(size=30_000)},
        3,
        255,
    )
    write_las(
        folder / "target.laz",
        target @ TRUE[:3, :3].T + TRUE[:3, 3],
        7,
        {"shared": rng.normal(size=20_000), "height": rng.normal(size=20_000).astype(np.float32)},
        4,
        60_000,
    )
    return folder / "source.laz", folder / "target.laz"


@pytest.fixture(scope="module")
def true_transform() -> Transform:
    """Return the pose that takes the source to the national grid."""
    local = np.eye(4)
    local[:3, :3] = TRUE[:3, :3]
    return Transform.about(local, [30.0, 40.0, 10.0], TRUE[:3, 3])


@pytest.fixture
def in_small_tiles(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(route, "n_tile_points", lambda _: 4000)


# ---- reading and thinning


def test_parts_are_the_whole(files: tuple[Path, Path], tmp_path: Path) -> None:
    plain = tmp_path / "plain.las"
    laspy.read(files[1]).write(plain)
    many = tmp_path / "many.laz"  # more than one of the chunks in which LAZ is packed
    write_las(many, np.random.default_rng(0).uniform(0, 50, (120_000, 3)), 6, {}, 0, 2)
    for path, n_parts in ((plain, 26), (many, 3), (files[0], 1)):
        points, cloud = open_las(path), tmchho.read(path)
        parts = list(las_parts(points, 777))
        assert len(parts) == n_parts
        records = np.concatenate(parts)
        assert np.array_equal(points.xyz(points.steps(records)), cloud.xyz)
        found = points.attributes(records)
        assert sorted(found) == sorted(cloud.attributes)
        for name, values in cloud.attributes.items():
            assert np.array_equal(found[name], values), name


def test_copc_is_read_in_parts(data_dir: Path) -> None:
    path = data_dir / "survey" / "single" / "lion_takanawa.copc.laz"
    points = open_las(path)
    records = np.concatenate(list(las_parts(points, 50_000)))
    assert np.array_equal(points.xyz(points.steps(records)), tmchho.read(path).xyz)


def test_a_cut_off_file_is_refused_by_name(files: tuple[Path, Path], tmp_path: Path) -> None:
    path = tmp_path / "cut.laz"
    path.write_bytes(files[0].read_bytes()[:-5000])
    with pytest.raises(ReadError, match=r"cut\.laz"):
        thin_file(open_las(path), voxel_size=1.0)


@pytest.mark.parametrize("voxel_size", [0.3, 2.0])
def test_centroids_have_the_bits_of_the_cloud_as_a_whole(
    files: tuple[Path, Path], voxel_size: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tmchho.streams.thin.las_parts", lambda file: las_parts(file, 1234))
    for packed in files:
        path = tmp_path / f"{packed.stem}.las"
        laspy.read(packed).write(path)
        wanted = tmchho.voxel_downsample(tmchho.read(path), voxel_size)
        found = thin_file(open_las(path), voxel_size=voxel_size)
        assert found.voxel_size == voxel_size
        assert np.array_equal(found.points, wanted.points)
        assert np.array_equal(found.counts, wanted.counts)


def test_a_limit_makes_the_grid_coarser(files: tuple[Path, Path]) -> None:
    found = thin_file(open_las(files[0]), max_voxels=500)
    assert 100 < len(found.points) <= 500
    assert found.counts.sum() == found.n_kept == found.n_points == 30_000
    cloud = tmchho.read(files[0])
    assert np.array_equal(found.lowest, cloud.xyz.min(axis=0))
    assert found.brightest == 254


def test_only_chosen_points_are_thinned(files: tuple[Path, Path]) -> None:
    points, cloud = open_las(files[0]), tmchho.read(files[0])
    chosen = Selection(classes=(2, 6))

    def keep(xyz: Floats, records: NDArray[np.void]) -> NDArray[np.bool_]:
        return chosen.keep(xyz, points.attributes(records), "source")

    found = thin_file(points, voxel_size=1.0, keep=keep)
    assert found.n_kept == np.isin(cloud.attributes["classification"], (2, 6)).sum()
    wanted = tmchho.voxel_downsample(chosen.of(cloud), 1.0)
    assert abs(len(found.points) - len(wanted.points)) < 30  # the grid stands on another corner
    with pytest.raises(InvalidCloudError, match="no point is left"):
        thin_file(points, voxel_size=1.0, keep=lambda xyz, _: np.zeros(len(xyz), dtype=bool))


# ---- tiles


def test_tiles_hold_every_point_once_and_their_margins_all_that_is_near(
    files: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tmchho.streams.tiles.las_parts", lambda file: las_parts(file, 3333))
    laspy.read(files[0]).write(tmp_path / "plain.las")
    points, cloud = open_las(tmp_path / "plain.las"), tmchho.read(files[0])
    cuts = cut_space(cloud.xyz[::7], np.full(len(cloud.xyz[::7]), 7.0), 4000)
    assert cuts.n_tiles == 8
    tiled = sort_into_tiles(points, None, cuts, tmp_path / "tiles")
    seen = np.zeros(len(cloud), dtype=int)
    for tile in range(cuts.n_tiles):
        places, index = tiled.read(tile)
        assert np.array_equal(places, cloud.xyz[index])
        assert 2500 < len(index) < 5000
        seen[index] += 1
        low, high = tiled.box(tile)
        near = tiled.near(tile, low - 3, high + 3)
        inside = ((cloud.xyz >= low - 3) & (cloud.xyz <= high + 3)).all(axis=1)
        inside[index] = False
        assert np.array_equal(np.unique(near, axis=0), np.unique(cloud.xyz[inside], axis=0))
    assert (seen == 1).all()
    assert np.array_equal(tiled.lowest, cloud.xyz.min(axis=0))


def test_statistics_are_those_of_numpy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tmchho.streams.distances._AT_ONCE", 1000)
    values = np.random.default_rng(0).gamma(2.0, 3.0, 12_345).astype(np.float32)
    signed = values.copy()
    signed[::5] *= -1  # repetitions
    signed.tofile(tmp_path / "d")
    file = DistanceFile(tmp_path / "d", len(values))
    found, exact = file.statistics(), values.astype(np.float64)
    assert found.n_points == len(values)
    assert found.mean == pytest.approx(exact.mean(), rel=1e-12)
    assert found.std == pytest.approx(exact.std(), rel=1e-12)
    assert found.rms == pytest.approx(np.sqrt((exact**2).mean()), rel=1e-12)
    assert (found.best, found.worst) == (exact.min(), exact.max())
    for share, value in ((0.5, found.median), (0.95, found.percentile_95)):
        below, above = np.sort(exact)[[int(share * 12_344), int(share * 12_344) + 1]]
        assert below - 1e-4 <= value <= above + 1e-4
    assert file.share_within(4.0) == (exact <= 4.0).mean()


# ---- measuring and fusing


def fused_in_parts(
    files: tuple[Path, Path], transform: Transform, folder: Path, mode: route.FuseMode
) -> tuple[route.StreamedFusion, tmchho.PointCloud, tmchho.PointCloud]:
    source, target = map(open_las, files)
    thinned: list[ThinnedFile] = [thin_file(file, voxel_size=0.5) for file in (source, target)]
    found = fuse_files(
        source,
        target,
        thinned[0],
        thinned[1],
        transform,
        folder / "fused.laz",
        folder / "moved.laz",
        folder=folder,
        mode=mode,
        max_distance=1.0,
    )
    assert sorted(path.name for path in folder.iterdir()) == ["fused.laz", "moved.laz"]
    return found, tmchho.read(folder / "fused.laz"), tmchho.read(folder / "moved.laz")


@pytest.mark.usefixtures("in_small_tiles")
@pytest.mark.parametrize("mode", ["merge", "dedup", "fill_holes"])
def test_fused_in_parts_as_in_memory(
    files: tuple[Path, Path], true_transform: Transform, tmp_path: Path, mode: route.FuseMode
) -> None:
    found, fused, moved = fused_in_parts(files, true_transform, tmp_path, mode)
    source, target = map(tmchho.read, files)
    radius = found.report["hole_radius"]
    wanted = tmchho.fuse(source, target, true_transform.matrix, mode=mode, hole_radius=radius)
    assert np.array_equal(fused.attributes["origin"], wanted.origin)
    assert np.array_equal(fused.attributes["fills_hole"], wanted.fills_hole)
    assert np.abs(fused.xyz - wanted.points).max() < 0.00051
    distances = fused.attributes["C2C_absolute_distances"]
    exact = wanted.distance <= found.exact_up_to
    assert 0.3 < exact.mean() < 1
    assert np.abs(distances - wanted.distance)[exact].max() < 1e-5
    assert np.abs(distances - wanted.distance)[~exact].max() < found.far_error
    for key in ("n_filled_by_source", "n_filled_by_target", "n_repeated"):
        assert found.report[key] == getattr(wanted, key)
    assert found.report["area_filled_by_source"] == pytest.approx(wanted.area_filled_by_source, rel=0.03)
    assert len(moved) == len(source)
    assert np.abs(moved.xyz - true_transform.apply(source.xyz)).max() < 0.00051
    # The hole radius is that of the clouds as wholes, but for the sample.
    derived = tmchho.fuse(source, target, true_transform.matrix).hole_radius
    assert radius == pytest.approx(derived, rel=0.1)


@pytest.mark.usefixtures("in_small_tiles")
def test_every_attribute_of_both_is_found(
    files: tuple[Path, Path], true_transform: Transform, tmp_path: Path
) -> None:
    found, fused, moved = fused_in_parts(files, true_transform, tmp_path, "merge")
    source, target = map(tmchho.read, files)
    n_target = len(target)
    for name, values in target.attributes.items():
        assert np.array_equal(fused.attributes[name][:n_target], values), name
    for name, values in source.attributes.items():
        assert np.array_equal(moved.attributes[name], values), name
        if name == "scan_angle_rank":
            steps = np.rint(values / 0.006)  # finer in the point formats of LAS 1.4
            assert np.array_equal(fused.attributes["scan_angle"][n_target:], steps)
        elif name in ("red", "green", "blue"):  # 8 bits beside 16
            assert np.array_equal(fused.attributes[name][n_target:], values * 256), name
        else:
            assert np.array_equal(fused.attributes[name][n_target:], values), name
    assert (fused.attributes["quality"][:n_target] == 0).all()
    assert np.isnan(fused.attributes["height"][n_target:]).all()
    assert found.report["no_data"]["target"] == {"quality": 0}
    assert found.report["no_data"]["source"] == {"height": None}  # NaN, which JSON has not


def test_distances_far_away_are_right_to_what_is_said(
    files: tuple[Path, Path], true_transform: Transform, tmp_path: Path
) -> None:
    found, fused, _ = fused_in_parts(files, true_transform, tmp_path, "merge")
    source, target = map(tmchho.read, files)
    exact, _ = cKDTree(target.xyz).query(true_transform.apply(source.xyz))
    written = fused.attributes["C2C_absolute_distances"][len(target) :]
    assert np.abs(written - exact).max() < found.far_error
    assert found.source_to_target.mean == pytest.approx(exact.mean(), rel=0.02)
    assert found.overlap_of_source == pytest.approx((exact <= 1.0).mean(), abs=1e-4)


def test_the_pose_of_files_is_that_of_clouds(files: tuple[Path, Path], true_transform: Transform) -> None:
    found = register_files(*files, max_memory=200_000_000)
    assert found.registration.verdict == "accepted"
    first = found.registration.stages[0]
    assert (first.name, first.n_source_in, first.n_target_in) == ("thin", 30_000, 20_000)
    cloud = tmchho.read(files[0])
    apart = found.registration.apply(cloud.xyz) - true_transform.apply(cloud.xyz)
    assert np.linalg.norm(apart, axis=1).max() < 0.1


# ---- the command


def command(files: tuple[Path, Path], folder: Path, *options: str) -> Any:
    arguments = ["register", *map(str, files), "-o", str(folder), "--json", "-q", *options]
    return CliRunner().invoke(main, arguments)


def test_the_command_works_in_parts_by_itself(
    files: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = command(files, tmp_path / "whole")
    monkeypatch.setattr(memory, "_BYTES_PER_POINT", 1_000_000)
    parts = command(files, tmp_path / "parts", "--max-memory", "300MB", "--keep-class", "1,2,3,4,5,6,7")
    assert whole.exit_code == parts.exit_code == 0, parts.stderr
    documents = [json.loads(result.stdout) for result in (whole, parts)]
    assert "in_parts" not in documents[0]
    assert documents[1]["in_parts"]["max_memory"] == 300_000_000
    assert set(documents[0]) < set(documents[1])
    assert_same_areas(*documents)
    assert "area 1" in (tmp_path / "parts" / "report.html").read_text(encoding="utf-8")
    assert set(documents[0]["fused"]) == set(documents[1]["fused"])
    for name in ("fused.laz", "source_registered.laz"):
        of_whole, of_parts = (tmchho.read(tmp_path / which / name) for which in ("whole", "parts"))
        assert len(of_whole) == len(of_parts)
        assert np.abs(of_whole.xyz - of_parts.xyz).max() < 0.1  # two poses
        # The moved source keeps its own point format, which is shorter than that of the target.
        missing = set(of_whole.attributes) - set(of_parts.attributes)
        shorter = {"scan_angle", "overlap", "scanner_channel"}
        assert missing == (set() if name == "fused.laz" else shorter)
    names = [sorted(path.name for path in (tmp_path / which).iterdir()) for which in ("whole", "parts")]
    assert names[0] == names[1]
    assert "--keep-class 1,2,3,4,5,6,7" in documents[1]["command"]


def assert_same_areas(whole: dict[str, Any], parts: dict[str, Any]) -> None:
    """The poses differ by millimetres, so that the figures do."""
    assert [row["name"] for row in parts["areas"]] == [row["name"] for row in whole["areas"]]
    for row, wanted in zip(parts["areas"], whole["areas"], strict=True):
        assert row["n_points"] == pytest.approx(wanted["n_points"], rel=0.03)
        assert row["mean"] == pytest.approx(wanted["mean"], rel=0.03)
        assert row["completeness_after"] == pytest.approx(wanted["completeness_after"], abs=0.02)
    for direction in ("source_to_target", "target_to_source"):
        found, wanted = (document["distances"][direction] for document in (parts, whole))
        assert set(found) == set(wanted)
        assert found["n_points"] + found["n_beyond"] == wanted["n_points"] + wanted["n_beyond"]
        assert found["median"] == pytest.approx(wanted["median"], rel=0.02)
    for side in ("source", "target"):
        spacing = parts["distances"]["spacing"][side]
        assert spacing == pytest.approx(whole["distances"]["spacing"][side], rel=1e-6)


def test_other_formats_cannot_be_read_in_parts(
    files: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(memory, "_BYTES_PER_POINT", 1_000_000)
    tmchho.write(tmchho.read(files[0]), tmp_path / "source.ply")
    result = command((tmp_path / "source.ply", files[1]), tmp_path / "out")
    assert result.exit_code == 6
    assert "--max-memory" in result.stderr


def test_a_full_disk_leaves_nothing_of_a_route_in_parts(files: tuple[Path, Path], tmp_path: Path) -> None:
    code = (
        "import resource, sys\n"
        "from tmchho.streams import memory\n"
        "from tmchho.cli import main\n"
        "memory._BYTES_PER_POINT = 10**6\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (300_000, resource.RLIM_INFINITY))\n"
        "main(sys.argv[1:])\n"
    )
    arguments = ["register", *map(str, files), "-o", str(tmp_path / "new" / "out"), "-q"]
    ran = subprocess.run(
        [sys.executable, "-c", code, *arguments], capture_output=True, text=True, check=False, timeout=300
    )
    assert ran.returncode == 5, ran.stderr
    assert "Traceback" not in ran.stderr
    assert str(tmp_path / "new" / "out") in ran.stderr
    assert list(tmp_path.iterdir()) == []


# ---- memory and areas


@pytest.mark.parametrize("text", ["", "2", "100MB", "two GB", "-3GB", "1.5.2GB"])
def test_what_is_no_amount_of_memory_is_refused(text: str) -> None:
    with pytest.raises(InvalidArgumentError, match="memory"):
        parse_bytes(text)


def test_an_amount_of_memory_in_many_spellings() -> None:
    assert {parse_bytes(text) for text in ("2GB", "2 gb", "2G", "2000MB", "2000000000")} == {2 * 10**9}
    assert parse_bytes("2GiB") == 2 * 1024**3


def test_the_area_of_a_sphere() -> None:
    rng = np.random.default_rng(0)
    vectors = rng.normal(size=(200_000, 3))
    area = _core.SurfaceArea(0.5)
    for part in np.array_split(5 * vectors / np.linalg.norm(vectors, axis=1, keepdims=True), 7):
        area.add(part + np.array([500_000.0, 4_000_000, 0]))
    assert area.total() == pytest.approx(4 * np.pi * 25, rel=0.05)


def test_a_polygon_is_the_one_of_matplotlib() -> None:
    path = pytest.importorskip("matplotlib.path")
    rng = np.random.default_rng(0)
    angles = np.sort(rng.uniform(0, 2 * np.pi, 12))
    corners = np.column_stack([np.cos(angles), np.sin(angles)]) * rng.uniform(0.3, 1, (12, 1))
    points = rng.uniform(-1, 1, (5000, 3))
    wanted = path.Path(corners).contains_points(points[:, :2])
    assert np.array_equal(Polygon(corners).contains(points), wanted)
