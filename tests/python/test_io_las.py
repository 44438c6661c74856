"""LAS and LAZ: what goes in comes out, and what cannot is said."""

from __future__ import annotations

import dataclasses
import logging
import struct
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pytest
from numpy.typing import NDArray

import tmchho.io
from tmchho.cloud import PointCloud
from tmchho.errors import WriteError

GEO_KEYS = struct.pack("<12H", 1, 1, 0, 2, 1024, 0, 1, 1, 3072, 0, 1, 32631) + b"junk"
WKT = b'PROJCS["a grid",GEOGCS["a datum"]]\0'


def sample(path: Path, point_format: int = 3, version: str = "1.2", n_points: int = 500) -> Path:
    """Write a file by laspy with every dimension filled with random values."""
    rng = np.random.default_rng(point_format)
    header = laspy.LasHeader(version=version, point_format=point_format)
    header.scales = [0.001, 0.001, 0.01]
    header.offsets = [500_000, 4_000_000, 0]
    header.file_source_id = 77
    header.system_identifier = "a scanner"
    header.vlrs = [
        laspy.VLR("LASF_Projection", 34735, "keys", GEO_KEYS),
        laspy.VLR("Mine", 5, "x", b"\0\1\2"),
    ]
    header.add_extra_dim(laspy.ExtraBytesParams("Reflectance", "i2", "dB", offsets=[-5.0], scales=[0.01]))
    header.add_extra_dim(laspy.ExtraBytesParams("C2C absolute distances", "f4"))
    header.add_extra_dim(laspy.ExtraBytesParams("normal", "3f4"))
    las = laspy.LasData(header)
    las.X, las.Y, las.Z = rng.integers(-100_000, 100_000, (3, n_points))
    for dimension in las.point_format.standard_dimensions:
        if dimension.name not in ("X", "Y", "Z"):
            if dimension.kind.name == "FloatingPoint":
                las[dimension.name] = rng.normal(0, 1e3, n_points)
            else:
                las[dimension.name] = rng.integers(dimension.min, min(dimension.max, 2**40) + 1, n_points)
    las["Reflectance"] = rng.integers(-500, 500, n_points) * 0.01
    las["C2C absolute distances"] = rng.normal(size=n_points)
    las["normal"] = rng.normal(size=(n_points, 3))
    las.write(path)
    return path


def assert_same(a: PointCloud, b: PointCloud) -> None:
    np.testing.assert_array_equal(a.xyz, b.xyz)
    assert sorted(a.attributes) == sorted(b.attributes)
    for key, values in a.attributes.items():
        np.testing.assert_array_equal(values, b.attributes[key], err_msg=key)
        assert values.dtype == b.attributes[key].dtype, key


FORMATS = [(0, "1.2"), (1, "1.2"), (2, "1.2"), (3, "1.2"), (4, "1.3"), (5, "1.3")]
FORMATS += [(number, "1.4") for number in range(11)]


@pytest.mark.parametrize(
    ("point_format", "version", "suffix"),
    [(*numbers, ".las") for numbers in FORMATS]
    + [(*numbers, ".laz") for numbers in FORMATS if numbers[0] not in (4, 5, 9, 10)],  # LAZ has no waveforms
)
def test_a_file_written_back_is_the_file_that_was_read(
    tmp_path: Path, point_format: int, version: str, suffix: str
) -> None:
    old_path, new_path = sample(tmp_path / f"old{suffix}", point_format, version), tmp_path / f"new{suffix}"
    cloud = tmchho.io.read(old_path)
    tmchho.io.write(cloud, new_path)
    assert_same(tmchho.io.read(new_path), cloud)

    # laspy, not our reader, is the judge of the file.
    old, new = laspy.read(old_path), laspy.read(new_path)
    assert new.header.version == old.header.version
    assert new.header.point_format == old.header.point_format
    assert new.header.are_points_compressed == (suffix == ".laz")
    assert new.points.array.tobytes() == old.points.array.tobytes()
    assert list(new.header.scales) == [0.001, 0.001, 0.01]
    assert list(new.header.offsets) == [500_000, 4_000_000, 0]
    assert new.header.file_source_id == 77
    assert new.header.system_identifier == "a scanner"
    assert new.header.global_encoding.value == old.header.global_encoding.value
    assert new.header.creation_date == old.header.creation_date
    np.testing.assert_array_equal(
        new.header.number_of_points_by_return, old.header.number_of_points_by_return
    )
    # Byte for byte, the key directory's odd tail included.
    assert GEO_KEYS in new_path.read_bytes()
    assert [vlr.record_data_bytes() for vlr in new.header.vlrs if vlr.user_id == "Mine"] == [b"\0\1\2"]


def test_no_data_of_an_extra_dimension_survives(tmp_path: Path) -> None:
    header = laspy.LasHeader(version="1.4", point_format=6)
    header.add_extra_dim(laspy.ExtraBytesParams("depth", "i4", "m", no_data=[-9999]))
    las = laspy.LasData(header)
    las.x = las.y = las.z = np.arange(5.0)
    las["depth"] = np.arange(5)
    las.write(tmp_path / "a.las")
    tmchho.io.write(tmchho.io.read(tmp_path / "a.las"), tmp_path / "b.las")
    (vlr,) = laspy.read(tmp_path / "b.las").header.vlrs.get("ExtraBytesVlr")
    assert list(vlr.extra_bytes_structs[0].no_data) == [-9999]


def test_undocumented_extra_bytes_survive(tmp_path: Path) -> None:
    cloud = tmchho.io.read(sample(tmp_path / "a.las", 0, n_points=20))
    data = bytearray((tmp_path / "a.las").read_bytes())
    at = data.index(b"LASF_Spec\0")
    data[at : at + 9] = b"something"  # the record is no longer the one that names the extra bytes
    (tmp_path / "b.las").write_bytes(data)
    opaque = tmchho.io.read(tmp_path / "b.las")
    assert opaque.attributes["extra_bytes"].shape == (20, 2 + 4 + 12)
    tmchho.io.write(opaque, tmp_path / "c.las")
    np.testing.assert_array_equal(
        tmchho.io.read(tmp_path / "c.las").attributes["extra_bytes"], opaque.attributes["extra_bytes"]
    )
    np.testing.assert_array_equal(opaque.xyz, cloud.xyz)


def test_extra_dimensions_of_a_fused_cloud(tmp_path: Path) -> None:
    """Two flags and a distance, on top of what the target's file had."""
    target = tmchho.io.read(sample(tmp_path / "target.laz", 7, "1.4"))
    n_points = len(target)
    rng = np.random.default_rng(1)
    added: dict[str, NDArray[Any]] = {
        "origin": rng.integers(0, 2, n_points).astype(np.uint8),
        "fills_hole": rng.integers(0, 2, n_points).astype(bool),
        "C2C_absolute_distances": rng.uniform(0, 1, n_points),
        "M3C2_distance": rng.uniform(0, 1, n_points).astype(np.float32),
    }
    fused = dataclasses.replace(target, attributes={**target.attributes, **added})
    tmchho.io.write(fused, tmp_path / "fused.laz", like=target)
    back = laspy.read(tmp_path / "fused.laz")
    for key, values in added.items():
        np.testing.assert_array_equal(np.array(back[key]), values)
    assert back["origin"].dtype == np.uint8
    assert back["fills_hole"].dtype == np.uint8
    assert back["C2C_absolute_distances"].dtype == np.float64
    assert back["M3C2_distance"].dtype == np.float32
    np.testing.assert_array_equal(np.array(back["Reflectance"]), target.attributes["Reflectance"])
    assert back.header.point_format.id == 7


def test_points_may_be_dropped_and_reordered(tmp_path: Path) -> None:
    cloud = tmchho.io.read(sample(tmp_path / "a.las"))
    kept = np.array([400, 3, 77])
    part = PointCloud(
        cloud.xyz[kept], {k: v[kept] for k, v in cloud.attributes.items()}, cloud.crs, cloud.metadata
    )
    tmchho.io.write(part, tmp_path / "b.las")
    assert_same(tmchho.io.read(tmp_path / "b.las"), part)


# --- the integer grid ---


def grid_of(path: Path) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    with laspy.open(path) as reader:
        return np.array(reader.header.scales), np.array(reader.header.offsets)


@pytest.mark.parametrize(
    ("centre", "size", "coarsest"),
    [
        ((500_000.0, 4_000_000.0, 120.0), 800.0, 1e-3),  # a survey
        ((0.0, 0.1, 0.0), 0.2, 2e-8),  # Stanford's bunny, in metres
        ((-123.07, 44.05, 0.0), 0.01, 1e-9),  # degrees
        ((500_000.0, 4_000_000.0, 120.0), 0.2, 1e-8),  # a cup in a national grid
        ((0.0, 0.0, 0.0), 3e6, 1e-2),  # a country: 32 bits are not enough for millimetres
    ],
)
def test_a_new_grid_is_fine_enough_and_reaches_all_points(
    tmp_path: Path, centre: tuple[float, float, float], size: float, coarsest: float
) -> None:
    rng = np.random.default_rng(0)
    cloud = PointCloud(np.array(centre) + rng.uniform(-0.5, 0.5, (2000, 3)) * size)
    tmchho.io.write(cloud, tmp_path / "a.las")
    scales, offsets = grid_of(tmp_path / "a.las")
    assert (scales <= coarsest).all()
    back = tmchho.io.read(tmp_path / "a.las").xyz
    # Half a step, and the last bit of the coordinate itself.
    allowed = scales / 2 * (1 + 1e-6) + np.spacing(np.abs(cloud.xyz))
    assert (np.abs(back - cloud.xyz) <= allowed).all()
    assert (offsets <= cloud.xyz.min(axis=0)).all()


def test_a_flat_axis_and_a_single_point_keep_their_coordinates(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    flat = np.column_stack([rng.uniform(0, 0.1, (50, 2)), np.full(50, 0.0123456)])
    tmchho.io.write(PointCloud(flat), tmp_path / "flat.las")
    np.testing.assert_allclose(tmchho.io.read(tmp_path / "flat.las").xyz, flat, atol=1e-8)
    one = np.array([[500_000.123, 4_000_000.456, -7.891]])
    tmchho.io.write(PointCloud(one), tmp_path / "one.las")
    np.testing.assert_allclose(tmchho.io.read(tmp_path / "one.las").xyz, one, atol=1e-9)


def test_the_scale_stays_and_only_the_offset_moves_when_the_points_do(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    cloud = tmchho.io.read(sample(tmp_path / "a.las"))
    near = dataclasses.replace(cloud, xyz=cloud.xyz + np.array([1234.5678, 0, 0]))
    tmchho.io.write(near, tmp_path / "near.las")
    scales, offsets = grid_of(tmp_path / "near.las")
    assert list(scales) == [0.001, 0.001, 0.01]
    assert list(offsets) == [500_000, 4_000_000, 0]
    far = dataclasses.replace(cloud, xyz=cloud.xyz + np.array([3e7, 0, 0]))  # more than 2^31 millimetres
    with caplog.at_level(logging.INFO, logger="tmchho.io"):
        tmchho.io.write(far, tmp_path / "far.las")
    assert "offset" in caplog.text
    scales, offsets = grid_of(tmp_path / "far.las")
    assert list(scales) == [0.001, 0.001, 0.01]
    assert (np.abs(tmchho.io.read(tmp_path / "far.las").xyz - far.xyz) <= scales * 0.500001 + 1e-8).all()


def test_a_borrowed_grid_too_coarse_for_the_cloud_is_not_taken(tmp_path: Path) -> None:
    target = tmchho.io.read(sample(tmp_path / "target.las"))
    cup = PointCloud(np.random.default_rng(0).uniform(0, 0.1, (100, 3)))
    tmchho.io.write(cup, tmp_path / "cup.las", like=target)
    np.testing.assert_allclose(tmchho.io.read(tmp_path / "cup.las").xyz, cup.xyz, atol=1e-8)
    hall = PointCloud(np.random.default_rng(0).uniform(0, 100, (100, 3)))
    tmchho.io.write(hall, tmp_path / "hall.las", like=target)
    assert list(grid_of(tmp_path / "hall.las")[0]) == [0.001, 0.001, 0.01]


def test_coordinates_that_are_not_finite_are_refused(tmp_path: Path) -> None:
    with pytest.raises(WriteError, match=r"a\.las: LAS cannot hold 2 points"):
        tmchho.io.write(PointCloud(np.array([[0, 0, 0], [np.nan, 0, 0], [0, np.inf, 0]])), tmp_path / "a.las")
    assert list(tmp_path.iterdir()) == []


# --- clouds that never were LAS ---


def foreign(**attributes: Any) -> PointCloud:
    n_points = len(next(iter(attributes.values())))
    return PointCloud(np.random.default_rng(0).uniform(0, 100, (n_points, 3)), attributes)


def test_a_cloud_from_another_format_becomes_las_1_4(tmp_path: Path) -> None:
    tmchho.io.write(foreign(intensity=np.arange(4)), tmp_path / "a.las")
    las = laspy.read(tmp_path / "a.las")
    assert (str(las.header.version), las.header.point_format.id) == ("1.4", 6)
    assert list(las.intensity) == [0, 1, 2, 3]
    assert list(las.return_number) == [1, 1, 1, 1]
    assert list(las.number_of_returns) == [1, 1, 1, 1]


@pytest.mark.parametrize(
    ("colour", "stored"),
    [
        (
            np.array([0, 1, 255], dtype=np.uint8),
            [0, 256, 65280],
        ),  # the factor that the specification asks for
        (np.array([0, 1, 65535], dtype=np.uint16), [0, 1, 65535]),
        (np.array([0.0, 0.5, 1.0]), [0, 32768, 65535]),
    ],
)
def test_colours_get_16_bits(tmp_path: Path, colour: NDArray[Any], stored: list[int]) -> None:
    tmchho.io.write(foreign(red=colour, green=colour, blue=colour), tmp_path / "a.las")
    las = laspy.read(tmp_path / "a.las")
    assert las.header.point_format.id == 7
    assert list(las.red) == list(las.green) == list(las.blue) == stored


@pytest.mark.parametrize(
    "values",
    [
        np.array([0.25, 0.5, 1.0], dtype=np.float32),  # a share instead of a 16-bit number
        np.array([-512, 0, 70_000]),  # Leica's range
        np.array([1.0, np.nan, 3.0]),
    ],
)
def test_what_does_not_fit_its_field_goes_into_an_extra_dimension(
    tmp_path: Path, values: NDArray[Any]
) -> None:
    tmchho.io.write(foreign(intensity=values), tmp_path / "a.laz")
    las = laspy.read(tmp_path / "a.laz")
    np.testing.assert_array_equal(np.array(las["intensity_value"]), values)
    assert las["intensity_value"].dtype == values.dtype
    assert not las.intensity.any()


def test_every_number_type_survives_as_extra_dimension(tmp_path: Path) -> None:
    attributes = {
        name: np.array([0, 1, 100], dtype=name)
        for name in ("u1", "i1", "u2", "i2", "u4", "i4", "u8", "i8", "f4", "f8")
    }
    attributes["u8"][2] = 2**64 - 1
    attributes["i8"][0] = -(2**63)
    tmchho.io.write(foreign(**attributes), tmp_path / "a.laz")
    back = tmchho.io.read(tmp_path / "a.laz")
    for name, values in attributes.items():
        np.testing.assert_array_equal(back.attributes[name], values)
        assert back.attributes[name].dtype == values.dtype


def test_vectors_are_split_and_long_names_cut(tmp_path: Path) -> None:
    long_name = "a_name_of_more_than_thirty_one_bytes"
    cloud = foreign(normal=np.arange(12.0).reshape(4, 3), **{long_name: np.arange(4.0)})
    tmchho.io.write(cloud, tmp_path / "a.las")
    back = tmchho.io.read(tmp_path / "a.las")
    np.testing.assert_array_equal(back.attributes["normal_1"], [1, 4, 7, 10])
    np.testing.assert_array_equal(back.attributes[long_name[:31]], np.arange(4.0))


def test_names_that_become_equal_when_cut_are_refused(tmp_path: Path) -> None:
    name = "n" * 31
    with pytest.raises(WriteError, match="would both be called"):
        tmchho.io.write(foreign(**{name + "1": np.arange(3), name + "2": np.arange(3)}), tmp_path / "a.las")


def test_attributes_without_numbers_are_refused(tmp_path: Path) -> None:
    with pytest.raises(WriteError, match="attribute 'label' has dtype <U1"):
        tmchho.io.write(foreign(label=np.array(["a", "b"])), tmp_path / "a.las")


# --- a layout that holds too little ---


@pytest.mark.parametrize(
    ("old", "attribute", "expected"),
    [
        ((0, "1.2"), {"gps_time": np.arange(3.0)}, (1, "1.2")),
        ((1, "1.2"), {"red": np.array([1, 2, 3], dtype=np.uint16)}, (3, "1.2")),
        ((1, "1.2"), {"classification": np.array([1, 64, 2])}, (6, "1.4")),
        ((3, "1.2"), {"return_number": np.array([1, 9, 2])}, (7, "1.4")),
        ((3, "1.2"), {"nir": np.array([1, 9, 2])}, (8, "1.4")),
        ((4, "1.3"), {"scanner_channel": np.array([1, 3, 2])}, (9, "1.4")),
        ((5, "1.3"), {"overlap": np.array([1, 0, 1])}, (10, "1.4")),
        ((3, "1.2"), {"overlap": np.array([0, 0, 0])}, (3, "1.2")),
        ((6, "1.4"), {"nir": np.array([1, 9, 2])}, (8, "1.4")),
    ],
)
def test_the_point_format_rises_only_as_far_as_needed(
    tmp_path: Path, old: tuple[int, str], attribute: dict[str, NDArray[Any]], expected: tuple[int, str]
) -> None:
    target = tmchho.io.read(sample(tmp_path / "target.las", *old, n_points=3))
    tmchho.io.write(PointCloud(target.xyz, attribute), tmp_path / "a.las", like=target)
    las = laspy.read(tmp_path / "a.las")
    assert (las.header.point_format.id, str(las.header.version)) == expected
    for name, values in attribute.items():
        if name in las.point_format.dimension_names:
            np.testing.assert_array_equal(np.array(las[name]), values)


def test_whole_degrees_become_fine_steps_in_an_extended_format(tmp_path: Path) -> None:
    target = tmchho.io.read(sample(tmp_path / "target.las", 6, "1.4", n_points=3))
    cloud = PointCloud(target.xyz, {"scan_angle_rank": np.array([-90, 0, 15], dtype=np.int8)})
    tmchho.io.write(cloud, tmp_path / "a.las", like=target)
    np.testing.assert_allclose(np.array(laspy.read(tmp_path / "a.las").scan_angle) * 0.006, [-90, 0, 15])


def test_waveforms_do_not_go_into_laz(tmp_path: Path) -> None:
    cloud = tmchho.io.read(sample(tmp_path / "a.las", 9, "1.4"))
    with pytest.raises(WriteError, match=r"point format 9; choose \.las"):
        tmchho.io.write(cloud, tmp_path / "a.laz")


def test_las_1_0_is_raised_to_the_oldest_version_that_can_be_written(data_dir: Path, tmp_path: Path) -> None:
    cloud = tmchho.io.read(data_dir / "formats" / "las_liblas" / "1.0_1.las")
    tmchho.io.write(cloud, tmp_path / "a.las")
    assert_same(tmchho.io.read(tmp_path / "a.las"), cloud)


# --- coordinate reference systems ---


def with_wkt(path: Path) -> Path:
    header = laspy.LasHeader(version="1.4", point_format=6)
    header.vlrs = [laspy.VLR("LASF_Projection", 2112, "", WKT)]
    header.global_encoding.wkt = True
    las = laspy.LasData(header)
    las.x = las.y = las.z = np.arange(5.0)
    las.write(path)
    return path


def test_wkt_is_read_and_kept(tmp_path: Path) -> None:
    cloud = tmchho.io.read(with_wkt(tmp_path / "a.las"))
    assert cloud.crs == WKT[:-1].decode()
    tmchho.io.write(cloud, tmp_path / "b.laz")
    back = laspy.read(tmp_path / "b.laz")
    assert [vlr.record_data_bytes() for vlr in back.header.vlrs.get_by_id("LASF_Projection")] == [WKT]
    assert back.header.global_encoding.wkt


def test_a_new_system_replaces_the_old_records(tmp_path: Path) -> None:
    cloud = tmchho.io.read(sample(tmp_path / "a.las", 6, "1.4"))
    moved = dataclasses.replace(cloud, crs='LOCAL_CS["site"]')
    tmchho.io.write(moved, tmp_path / "b.las")
    records = laspy.read(tmp_path / "b.las").header.vlrs.get_by_id("LASF_Projection")
    assert [(record.record_id, record.record_data_bytes()) for record in records] == [
        (2112, b'LOCAL_CS["site"]\0')
    ]
    assert tmchho.io.read(tmp_path / "b.las").crs == 'LOCAL_CS["site"]'


def test_geotiff_keys_are_understood_where_pyproj_is(tmp_path: Path, data_dir: Path) -> None:
    pyproj = pytest.importorskip("pyproj")
    cloud = tmchho.io.read(data_dir / "formats" / "las_pdal" / "test_utm17.las")
    assert cloud.crs is not None
    assert pyproj.CRS(cloud.crs).to_epsg() == 32617


def test_an_octree_is_not_claimed_for_new_points(data_dir: Path, tmp_path: Path) -> None:
    cloud = tmchho.io.read(data_dir / "formats" / "copc" / "simple.copc.laz")
    tmchho.io.write(cloud, tmp_path / "a.laz")
    assert_same(tmchho.io.read(tmp_path / "a.laz"), cloud)
    back = laspy.read(tmp_path / "a.laz")
    assert not any(vlr.user_id == "copc" for vlr in [*back.header.vlrs, *back.evlrs])
    assert back.header.vlrs.get_by_id("LASF_Projection")
