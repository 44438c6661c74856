"""Files moved by a known transform: coordinates change, nothing else does."""

from __future__ import annotations

import resource
import subprocess
import sys
from pathlib import Path

import laspy
import numpy as np
import pytest
from click.testing import CliRunner
from scipy.spatial.transform import Rotation

import tmchho
from tmchho.cli import main
from tmchho.errors import WriteError
from tmchho.io.scans import Scan
from tmchho.moving import apply_transform, moved
from tmchho.transform import Transform

N_POINTS = 2000


def some_transform(target: tuple[float, float, float] = (500_000.0, 4_000_000.0, 300.0)) -> Transform:
    local = np.eye(4)
    local[:3, :3] = Rotation.from_rotvec([0.02, -0.4, 1.3]).as_matrix()
    return Transform.about(local, [500_010.0, 4_000_020.0, 310.0], target)


def las_file(path: Path, point_format: int = 7, version: str = "1.4") -> Path:
    """Write a file with random dimensions, extra bytes, a VLR and (in 1.4) an EVLR, by laspy alone."""
    rng = np.random.default_rng(point_format)
    header = laspy.LasHeader(version=version, point_format=point_format)
    header.scales, header.offsets = [0.001, 0.002, 0.0005], [500_000, 4_000_000, 300]
    header.add_extra_dims(
        [
            laspy.ExtraBytesParams("quality", np.uint16),
            laspy.ExtraBytesParams("reflectance", np.int16, scales=[0.01], offsets=[-20.0]),
            laspy.ExtraBytesParams("normal", "3f4"),
        ]
    )
    header.vlrs.append(laspy.VLR("surveyor", 7, "kept", b"\x01\x02\x00\x03"))
    las = laspy.LasData(header)
    dtype = header.point_format.dtype()
    records = np.frombuffer(rng.bytes(N_POINTS * dtype.itemsize), dtype=dtype).copy()
    for axis in "XYZ":
        records[axis] = rng.integers(-50_000, 50_000, N_POINTS)
    for name in dtype.names:
        if records[name].dtype.kind == "f":
            records[name] = rng.normal(size=records[name].shape)
    las.points = laspy.PackedPointRecord(records, header.point_format)
    if version == "1.4":
        las.evlrs = laspy.vlrs.vlrlist.VLRList([laspy.VLR("surveyor", 8, "after", b"points")])
    las.write(path)
    return path


@pytest.mark.parametrize("suffix", [".las", ".laz"])
@pytest.mark.parametrize(("point_format", "version"), [(1, "1.2"), (3, "1.3"), (6, "1.4"), (8, "1.4")])
def test_all_but_the_coordinates_is_kept_bit_by_bit(
    tmp_path: Path, suffix: str, point_format: int, version: str
) -> None:
    path, out = las_file(tmp_path / f"in{suffix}", point_format, version), tmp_path / f"out{suffix}"
    transform = some_transform()
    assert apply_transform(transform, path, out) == N_POINTS
    before, after = laspy.read(path), laspy.read(out)
    assert np.array_equal(after.header.scales, before.header.scales)
    assert np.array_equal(after.header.offsets, before.header.offsets)
    assert after.point_format.id == before.point_format.id
    for name in before.points.array.dtype.names:
        if name not in "XYZ":
            assert after.points.array[name].tobytes() == before.points.array[name].tobytes(), name
    wanted = transform.apply(before.xyz)
    assert (np.abs(after.xyz - wanted) <= 0.5001 * before.header.scales).all()
    assert [v.record_data for v in after.header.vlrs if v.user_id == "surveyor"] == [b"\x01\x02\x00\x03"]
    if version == "1.4":
        assert [v.record_data for v in after.evlrs] == [b"points"]
    assert np.allclose(after.header.mins, after.xyz.min(axis=0), atol=0.01)


def test_moved_out_of_reach_the_file_gets_a_new_offset(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path, out = las_file(tmp_path / "in.laz"), tmp_path / "out.laz"
    far = some_transform((90_000_000.0, -5.0, 0.0))
    with caplog.at_level("WARNING", logger="tmchho"):
        apply_transform(far, path, out)
    assert "offset" in caplog.text
    before, after = laspy.read(path), laspy.read(out)
    assert np.array_equal(after.header.scales, before.header.scales)
    assert (np.abs(after.xyz - far.apply(before.xyz)) <= 0.5001 * before.header.scales + 1e-8).all()


def test_a_wrong_box_in_the_header_costs_a_second_look_and_no_point(tmp_path: Path) -> None:
    path, out = las_file(tmp_path / "in.las"), tmp_path / "out.las"
    data = bytearray(path.read_bytes())
    middle = np.array([[-1e6] * 2, [-1e6] * 2, [0.0] * 2])  # what stays in reach of the offset
    data[179:227] = middle.astype("<f8").tobytes()
    path.write_bytes(data)
    far = some_transform((4_000_000.0, 4_000_000.0, 0.0))
    apply_transform(far, path, out)
    wanted = far.apply(tmchho.read(path).xyz)
    assert np.abs(tmchho.read(out).xyz - wanted).max() < 0.0011


def test_other_formats_are_moved_whole_and_normals_turn(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    vectors = rng.normal(size=(50, 3))
    attributes = dict(zip(("nx", "ny", "nz"), vectors.T.astype(np.float32), strict=True))
    cloud = tmchho.PointCloud(rng.normal(size=(50, 3)), {**attributes, "time": np.arange(50)})
    tmchho.write(cloud, tmp_path / "in.ply")
    transform = some_transform()
    apply_transform(transform, tmp_path / "in.ply", tmp_path / "out.ply")
    after = tmchho.read(tmp_path / "out.ply")
    assert np.abs(after.xyz - transform.apply(cloud.xyz)).max() < 1e-9
    assert np.array_equal(after.attributes["time"], np.arange(50))
    turned = np.column_stack([after.attributes[name] for name in ("nx", "ny", "nz")])
    assert np.abs(turned - vectors @ transform.local_matrix[:3, :3].T).max() < 1e-6
    assert np.array_equal(moved(cloud, transform).attributes["time"], cloud.attributes["time"])


def test_an_input_is_never_written_over(tmp_path: Path) -> None:
    path = las_file(tmp_path / "in.laz")
    before = path.read_bytes()
    with pytest.raises(WriteError, match="is an input"):
        apply_transform(np.eye(4), path, path, overwrite=True)
    assert path.read_bytes() == before


def test_the_command_moves_many_files_and_back(tmp_path: Path) -> None:
    files = [las_file(tmp_path / f"tile{number}.laz", number) for number in (6, 7)]
    (tmp_path / "t.txt").write_text(
        "\n".join(" ".join(f"{value:.17g}" for value in row) for row in some_transform().matrix)
    )
    arguments = [str(tmp_path / "t.txt"), *map(str, files), "-o", str(tmp_path / "there"), "-q"]
    result = CliRunner().invoke(main, ["apply", *arguments])
    assert result.exit_code == 0, result.output
    assert result.stdout.split() == [str(tmp_path / "there" / path.name) for path in files]
    moved_files = [tmp_path / "there" / path.name for path in files]
    back = [str(tmp_path / "t.txt"), *map(str, moved_files), "-o", str(tmp_path / "back"), "--inverse", "-q"]
    assert CliRunner().invoke(main, ["apply", *back]).exit_code == 0
    for path in files:
        apart = tmchho.read(path).xyz - tmchho.read(tmp_path / "back" / path.name).xyz
        assert np.abs(apart).max() < 0.004  # rounded to steps of up to 2 mm, twice
    again = CliRunner().invoke(main, ["apply", *arguments])
    assert again.exit_code == 5
    assert "--overwrite" in again.stderr


def test_two_files_of_one_name_are_refused(tmp_path: Path) -> None:
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        las_file(tmp_path / folder / "tile.laz")
    (tmp_path / "t.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1")
    arguments = [str(tmp_path / "t.txt"), *(str(tmp_path / name / "tile.laz") for name in "ab")]
    result = CliRunner().invoke(main, ["apply", *arguments, "-o", str(tmp_path / "out")])
    assert result.exit_code == 5
    assert "one by one" in result.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("suffix", [".las", ".laz", ".ply", ".pcd", ".npy", ".npz", ".xyz"])
def test_a_full_disk_leaves_nothing_behind(tmp_path: Path, suffix: str) -> None:
    """A limit on the size of files stands in for a full disk: writing fails in the middle of the points."""
    path, out = tmp_path / f"in{suffix}", tmp_path / "out" / f"tile{suffix}"
    rng = np.random.default_rng(0)
    tmchho.write(tmchho.PointCloud(rng.uniform(0, 100, (20_000, 3))), path)
    out.parent.mkdir()
    out.write_bytes(b"old")
    code = (
        "import resource, sys, numpy as np\n"
        "from tmchho.errors import WriteError\n"
        "from tmchho.moving import apply_transform\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (60_000, resource.RLIM_INFINITY))\n"
        "try:\n"
        "    apply_transform(np.eye(4), sys.argv[1], sys.argv[2], overwrite=True)\n"
        "except WriteError as error:\n"
        "    print(error)\n"
    )
    assert path.stat().st_size > 60_000
    ran = subprocess.run(
        [sys.executable, "-c", code, path, out], capture_output=True, text=True, check=False, timeout=120
    )
    assert (ran.returncode, ran.stderr) == (0, ""), ran.stderr
    assert str(out) in ran.stdout
    assert "File too large" in ran.stdout
    assert "Traceback" not in ran.stdout
    assert [file.name for file in out.parent.iterdir()] == [out.name]
    assert out.read_bytes() == b"old"


def test_parts_are_bounded_in_memory(tmp_path: Path) -> None:
    """A file of 2 M points is moved with less memory than its coordinates alone would take."""
    assert resource.RLIMIT_AS is not None
    path = tmp_path / "many.las"
    header = laspy.LasHeader(version="1.2", point_format=0)
    header.scales, header.offsets = [0.001] * 3, [0.0] * 3
    with laspy.open(path, "w", header=header) as writer:
        for _ in range(20):
            part = laspy.ScaleAwarePointRecord.zeros(100_000, header=header)
            writer.write_points(part)
    code = (
        "import resource, sys, numpy as np\n"
        "import tmchho.io.las_stream as las_stream, tmchho.io.registry as registry\n"
        "from tmchho.moving import apply_transform\n"
        "points = registry.open_las(sys.argv[1])\n"
        "list(zip(range(1), points.parts(100_000)))\n"
        "before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss\n"
        "registry.las_parts.__defaults__ = (100_000,)\n"
        "apply_transform(np.eye(4), sys.argv[1], sys.argv[2])\n"
        "print((resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) // 1024)\n"
    )
    ran = subprocess.run(
        [sys.executable, "-c", code, path, tmp_path / "out.las"],
        capture_output=True,
        text=True,
        check=True,
        timeout=120,
    )
    assert int(ran.stdout) < 2_000_000 * 24 // 2**20


def test_stations_move_with_their_points() -> None:
    transform = some_transform()
    station = np.eye(4)
    station[:3, 3] = [500_010.0, 4_000_020.0, 311.5]
    scans = (Scan("S1", station),)
    cloud = tmchho.PointCloud(station[None, :3, 3] + np.zeros((3, 3)), metadata={"scans": scans})
    there = moved(cloud, transform)
    found = there.metadata["scans"][0]
    assert found.name == "S1"
    np.testing.assert_allclose(found.world_from_scan[:3, 3], there.xyz[0], atol=1e-6)
    np.testing.assert_allclose(found.world_from_scan[:3, :3], transform.matrix[:3, :3], atol=1e-12)
