"""Every real file reads to the number of points that common readers find, or is refused in a sentence."""

from __future__ import annotations

import logging
import re
from functools import cache
from pathlib import Path

import laspy
import numpy as np
import pytest

import tmchho.io
from tmchho.errors import ReadError

# How many points the scanner itself marked as invalid, of those that other readers count.
INVALID = {"e57_cryinc/cartesian_invalid_state_single.e57": 2, "e57_cryinc/tiny_spherical.e57": 180}

# Of these the header, from which the other reader takes the box, says something else than the points.
WRONG_BOXES = ("las_liblas/certainty3d-color-utm-feet-navd88.las", "las_pdal/spurious.las")

# What must be refused, with the words that say why. Everything else must read.
REFUSED = {
    "INDEX.tsv": "of an unknown kind",
    "LICENSE_PDAL.txt": "not a line of numbers",
    "e57_cryinc/LICENSE": "of an unknown kind",
    "e57_cryinc/corrupt_crc.e57": "the checksum of one of its pages is wrong",
    "e57_cryinc/empty.e57": "contains no points",
    "e57_cryinc/empty_pc.e57": "contains no points",
    "e57_libe57/InvalidCVHeader.e57": "contains no points",
    "e57_libe57/LICENSE": "of an unknown kind",
    "e57_libe57/PinholeImageWithDistortionParameters.e57": "contains no points",
    "e57_libe57/ZeroPoints.e57": "contains no points",
    "e57_libe57/ZeroPointsInvalid.e57": "contains no points",
    "e57_libe57/bad-crc.e57": "the checksum of one of its pages is wrong",
    "e57_libe57/empty.e57": "contains no points",
    "las_pdal/1.2-with-color-clipped.las": "expected 1065 points, file holds 1064",
    "las_pdal/garbage_nVariableLength.las": "variable length records do not fit",
    "las_pdal/no-points.las": "contains no points",
    "las_pdal/permutations/1.2-no-points.las": "expected 1065 points, file holds 0",
    "laz_lazperf/no-points-1.3.las": "contains no points",
    "laz_lazperf/no-points-1.3.laz": "contains no points",
    "misc_pyntcloud/LICENSE.md": "of an unknown kind",
    "misc_pyntcloud/diamond.bin": "of an unknown kind",
    "misc_pyntcloud/diamond.dae": "is XML or HTML",
    "misc_pyntcloud/diamond.json": "is JSON",
    "misc_pyntcloud/diamond.off": "is an OFF mesh",
    "misc_pyntcloud/diamond.vtk": "is VTK",
    "misc_pyntcloud/diamond.x3d": "is XML or HTML",
    "misc_pyntcloud/diamond_ascii.stl": "is an STL mesh",
    "misc_pyntcloud/diamond_color.off": "is an OFF mesh",
    "pcd_pcl/LICENSE.txt": "not a line of numbers",
    "pcd_pcl/stereo_left.pcd": "has no x y z field",
    "pcd_pypcd4/LICENSE.txt": "not a line of numbers",
    "pcd_pypcd4/ascii_empty.pcd": "is empty",
    "pcd_pypcd4/ascii_invalid_header.pcd": "no DATA line",
    "pcd_pypcd4/ascii_with_empty_points.pcd": "contains no points",
    "ply_laserchicken/complex_test_data_little_endian.bin": "of an unknown kind",
    "ply_laserchicken/simple_test_data_little_endian.bin": "of an unknown kind",
    "ply_trimesh/LICENSE.md": "of an unknown kind",
    "ply_laserchicken/PLYascii.ply": "has no vertices, only the elements: pc1",
    "ply_laserchicken/PLYbinary.ply": "has no vertices, only the elements: pc1",
    "ply_pdal/no_vertex.ply": "has no vertices",
    "ply_pdal/sized_dims.ply": "has no z field",
    "ply_pdal/unsized_dims.ply": "has no z field",
    "ply_trimesh/empty.ply": "contains no points",
    "ply_trimesh/ply_empty_ascii.ply": "contains no points",
    "ply_trimesh/ply_empty_bin.ply": "contains no points",
    "ply_trimesh/ply_empty_header.ply": "has no vertices",
    "text_pdal/TextWriterTest-geojson.json": "is JSON",
    "text_pdal/utm17_1.geojson": "is JSON",
    "text_pdal/badheader.txt": "has no z field",
    "text_pdal/text.txt": "no line of numbers",
    "text_pdal/utm17_3.txt": "names 3 columns but the numbers have 4",
}


@cache
def what_other_readers_find(formats: Path) -> dict[str, tuple[int, list[float]]]:
    """Return file -> number of points and box from INDEX.tsv; 0 is left out, there the reader gave up."""
    result: dict[str, tuple[int, list[float]]] = {}
    for line in (formats / "INDEX.tsv").read_text().splitlines()[1:]:
        name, _, _, remark = line.split("\t")
        count = sum(map(int, re.findall(r"\bn=(\d+)", remark)))  # of all scans of the file
        box = re.search(r"bbox \[(.*)\]\.\.\[(.*?)\]", remark)
        if count:
            result[name] = (
                count,
                [float(word) for word in ", ".join(box.groups()).split(", ")] if box else [],
            )
    return result


@cache
def documented() -> dict[str, str]:
    """Return file -> what docs/formats.md says that it is read as."""
    document = Path(__file__).resolve().parents[2] / "docs" / "formats.md"
    rows = [line.split(" | ") for line in document.read_text().splitlines() if line.startswith("| ")]
    return {row[0].removeprefix("| "): row[2] for row in rows if len(row) > 2}


def test_every_real_file_reads_or_is_refused_in_one_sentence(real_file: Path, data_dir: Path) -> None:
    if real_file.suffix == ".e57":
        pytest.importorskip("pye57")
    formats = data_dir / "formats"
    if formats not in real_file.parents and real_file.suffix in (".json", ".md"):
        return  # what is told about the clouds
    name = str(real_file.relative_to(formats)) if formats in real_file.parents else None
    if name in REFUSED:
        with pytest.raises(ReadError) as caught:
            tmchho.io.read(real_file)
        message = str(caught.value)
        assert message.startswith(str(real_file))
        assert REFUSED[name] in message
        assert "\n" not in message
        if name != "INDEX.tsv":
            assert documented()[name] == f"ReadError: {message.removeprefix(f'{real_file}: ')}"
        return
    cloud = tmchho.io.read(real_file)
    assert cloud.name == str(real_file)
    assert all(len(values) == len(cloud) for values in cloud.attributes.values())
    if name is not None:
        assert documented()[name].startswith(f"{len(cloud)} points, ")
    if name is not None and name in what_other_readers_find(formats):
        n_points, box = what_other_readers_find(formats)[name]
        assert len(cloud) == n_points - INVALID.get(name, 0)
        if box and name not in WRONG_BOXES:
            found = [*cloud.xyz.min(axis=0), *cloud.xyz.max(axis=0)]
            # Two digits are written down, and headers are off by up to a step of their grid.
            step = max(cloud.metadata["header"].scales)
            np.testing.assert_allclose(found, box, atol=0.005001 + step, rtol=0)


def test_points_and_attributes_are_those_of_laspy(data_dir: Path) -> None:
    """Coordinates to the last bit, every standard dimension, every extra dimension of the same name."""
    formats = data_dir / "formats"
    n_compared = 0
    for name in what_other_readers_find(formats):
        is_las = name.endswith((".las", ".laz"))
        if not is_las or name in REFUSED or name == "laz_pdal/simple-laszip-compressor-version-1.2r0.laz":
            continue
        theirs = laspy.read(formats / name)
        ours = tmchho.io.read(formats / name)
        expected = np.column_stack([theirs.x, theirs.y, theirs.z])
        np.testing.assert_array_equal(ours.xyz, expected, err_msg=name)
        for key in theirs.point_format.dimension_names:
            if key in ours.attributes:
                np.testing.assert_array_equal(
                    ours.attributes[key], np.array(theirs[key]), err_msg=f"{name} {key}"
                )
        n_missing = sum(key not in ours.attributes for key in theirs.point_format.dimension_names)
        assert n_missing <= 3 + ("ExtraBytes" in theirs.point_format.extra_dimension_names)  # X, Y, Z
        n_compared += 1
    assert n_compared > 100


def test_stanford_scans_read_to_the_count_in_their_header(data_dir: Path) -> None:
    files = sorted((data_dir / "stanford").rglob("*.ply"))
    assert files
    for file in files:
        promised = int(re.search(rb"element vertex (\d+)", file.read_bytes()[:2000]).group(1))  # type: ignore[union-attr]
        assert len(tmchho.io.read(file)) == promised


@pytest.mark.parametrize(
    ("compressed", "plain"),
    [
        ("laz_lazrs/point-version-1-point-wise.laz", "laz_lazrs/point-version-1-point-wise.las"),
        ("laz_pdal/simple-laszip-compressor-version-1.2r0.laz", "laz_pdal/simple.las"),
        ("laz_lazrs/extra-bytes.laz", "laz_lazrs/extra-bytes.las"),
        ("laz_lazrs/point-time-color.laz", "laz_lazrs/point-time-color.las"),
    ],
)
def test_compressed_and_plain_file_hold_the_same(data_dir: Path, compressed: str, plain: str) -> None:
    a = tmchho.io.read(data_dir / "formats" / compressed)
    b = tmchho.io.read(data_dir / "formats" / plain)
    np.testing.assert_array_equal(a.xyz, b.xyz)
    assert list(a.attributes) == list(b.attributes)
    for key, values in a.attributes.items():
        np.testing.assert_array_equal(values, b.attributes[key], err_msg=key)


def test_the_same_cloud_in_seven_spellings_is_the_same_cloud(data_dir: Path) -> None:
    derived = data_dir / "formats" / "derived"
    exact = tmchho.io.read(derived / "utm_double_le.ply").xyz
    for name in ("utm_double_be.ply", "utm_double_le_crlf.ply", "utm_double_binary.pcd"):
        np.testing.assert_array_equal(tmchho.io.read(derived / name).xyz, exact, err_msg=name)
    for name, tolerance in (
        *(("utm_double_ascii.ply", 1e-4), ("utm_double_ascii.pcd", 1e-4), ("count_header.pts", 1e-4)),
        *(("comments_slash.asc", 1e-4), ("comma_header.csv", 1e-3), ("tabs_bom_crlf.xyz", 1e-3)),
        ("semicolon_decimal_comma.txt", 1e-3),
    ):
        np.testing.assert_allclose(tmchho.io.read(derived / name).xyz, exact, atol=tolerance, err_msg=name)


def test_what_was_assumed_about_a_text_file_is_logged(
    data_dir: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.INFO, logger="tmchho.io"):
        tmchho.io.read(data_dir / "formats" / "derived" / "semicolon_decimal_comma.txt")
    assert "semicolons between values, decimal ','" in caplog.text
