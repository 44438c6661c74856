"""What holds for every format: names, kinds, messages, and files that appear whole or not at all."""

from __future__ import annotations

import dataclasses
import errno
import logging
import os
import stat
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import tmchho.io
from tmchho.cloud import PointCloud
from tmchho.errors import BudgetError, InvalidArgumentError, InvalidCloudError, ReadError, WriteError
from tmchho.io import atomic_path, check_writable_folder, known_extensions, ply, read, registry, write
from tmchho.io import las as las_module

# Numbers as a national grid has them, with digits that float32 would lose.
XYZ = np.array(
    [[500_000.123, 4_000_000.456, 101.789], [500_000.124, 4_000_000.457, 101.788], [500_001, 4e6, 99]]
)
WRITABLE = known_extensions(writable=True)


@pytest.fixture(autouse=True)
def _with_what_the_format_needs(request: pytest.FixtureRequest) -> None:
    """Skip what needs pye57 where it is not installed."""
    parameters = getattr(request.node, "callspec", None)
    if parameters is not None and ".e57" in parameters.params.values():
        pytest.importorskip("pye57")


def cloud(**attributes: object) -> PointCloud:
    return PointCloud(XYZ, attributes)  # type: ignore[arg-type]


def message_of(path: Path, **options: str) -> str:
    with pytest.raises(ReadError) as caught:
        read(path, **options)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize("extension", WRITABLE)
def test_national_grid_coordinates_survive_in_every_format(tmp_path: Path, extension: str) -> None:
    write(cloud(), tmp_path / f"a{extension}")
    back = read(tmp_path / f"a{extension}")
    assert back.xyz.dtype == np.float64
    if extension in (".las", ".laz"):  # a grid of at most a millimetre
        np.testing.assert_allclose(back.xyz, XYZ, atol=0.000501, rtol=0)
    else:
        np.testing.assert_array_equal(back.xyz, XYZ)


@pytest.mark.parametrize(
    "extension", [extension for extension in WRITABLE if extension not in (".las", ".laz")]
)
def test_points_that_are_not_finite_stay_as_they_are(tmp_path: Path, extension: str) -> None:
    xyz = np.array([[1, 2, 3], [np.nan, np.inf, -np.inf], [4, np.nan, 6]])
    write(PointCloud(xyz), tmp_path / f"a{extension}")
    np.testing.assert_array_equal(read(tmp_path / f"a{extension}").xyz, xyz)


@pytest.mark.parametrize("extension", WRITABLE)
def test_attributes_survive_in_every_format(tmp_path: Path, extension: str) -> None:
    if extension == ".ptx":  # has room for intensity and colours only
        return
    attributes = {
        "intensity": np.array([7, 0, 65535], dtype=np.uint16),
        "classification": np.array([2, 6, 18], dtype=np.uint8),
        "gps_time": np.array([1.5, 2.25, 3e8 + 1 / 3]),
        "origin": np.array([0, 1, 1], dtype=np.uint8),
        "C2C_absolute_distances": np.array([0.1, 1 / 3, np.nan]),
    }
    write(cloud(**attributes), tmp_path / f"a{extension}")
    back = read(tmp_path / f"a{extension}")
    for key, values in attributes.items():
        np.testing.assert_array_equal(back.attributes[key], values, err_msg=key)


def test_extensions() -> None:
    binary = {".las", ".laz", ".e57", ".ply", ".pcd", ".npy", ".npz"}
    assert {*binary, ".xyz", ".txt", ".csv", ".asc", ".pts", ".ptx"} == set(WRITABLE)
    assert ".obj" in known_extensions()
    assert ".obj" not in WRITABLE
    assert list(known_extensions()) == sorted(known_extensions())


def test_upper_case_extension_and_explicit_format(tmp_path: Path) -> None:
    write(cloud(), tmp_path / "A.PLY")
    np.testing.assert_array_equal(read(tmp_path / "A.PLY").xyz, XYZ)
    (tmp_path / "A.PLY").rename(tmp_path / "no_extension")
    np.testing.assert_array_equal(read(tmp_path / "no_extension", format="ply").xyz, XYZ)
    np.testing.assert_array_equal(read(tmp_path / "no_extension").xyz, XYZ)
    assert "is a PLY file although it was to be read as LAS/LAZ" in message_of(
        tmp_path / "no_extension", format="laz"
    )
    assert "is a PLY file, not text" in message_of(tmp_path / "no_extension", format="xyz")
    with pytest.raises(InvalidArgumentError, match="format 'docx' is not one of"):
        read(tmp_path / "no_extension", format="docx")


def test_missing_folder_and_empty_file(tmp_path: Path) -> None:
    assert "does not exist" in message_of(tmp_path / "missing.las")
    assert "does not exist" in message_of(tmp_path / "missing.docx")
    assert "is a folder" in message_of(tmp_path)
    (tmp_path / "folder.las").mkdir()
    assert "is a folder" in message_of(tmp_path / "folder.las")
    for extension in known_extensions():
        (tmp_path / f"empty{extension}").touch()
        assert "is empty (0 bytes)" in message_of(tmp_path / f"empty{extension}")


def test_extensions_that_cannot_be_written(tmp_path: Path) -> None:
    with pytest.raises(InvalidArgumentError, match=r"unknown extension '\.docx'; choose one of .*\.las"):
        write(cloud(), tmp_path / "b.docx")
    with pytest.raises(InvalidArgumentError, match="OBJ can only be read"):
        write(cloud(), tmp_path / "b.obj")
    with pytest.raises(InvalidArgumentError, match="COPC files can only be read"):
        write(cloud(), tmp_path / "b.copc.laz")


@pytest.mark.parametrize("actual", WRITABLE)
@pytest.mark.parametrize(
    "claimed", [".las", ".e57", ".ply", ".pcd", ".xyz", ".npy", ".npz", ".obj", "", ".dat"]
)
def test_the_content_decides_and_a_wrong_name_is_warned_of(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, actual: str, claimed: str
) -> None:
    write(cloud(), tmp_path / f"a{actual}")
    expected = read(tmp_path / f"a{actual}").xyz
    (tmp_path / f"a{actual}").rename(tmp_path / f"b{claimed}")
    with caplog.at_level(logging.WARNING, logger="tmchho.io"):
        np.testing.assert_array_equal(read(tmp_path / f"b{claimed}").xyz, expected)
    texts = (".xyz", ".txt", ".csv", ".asc", ".pts")
    kinds = [
        (".las", ".laz"),
        texts,
        *((suffix,) for suffix in (".e57", ".ply", ".pcd", ".npy", ".npz", ".ptx")),
    ]
    is_right = claimed in ("", ".dat") or any(actual in kind and claimed in kind for kind in kinds)
    assert (f"although its name ends in {claimed}; read as what it is" in caplog.text) != is_right


@pytest.mark.parametrize(
    ("head", "words"),
    [
        (b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR", "is a picture, which is not read"),
        (b"\xff\xd8\xff\xe0\0\x10JFIF", "is a picture"),
        (b"%PDF-1.7\n1 0 obj", "is a PDF document"),
        (b"PK\x03\x04" + bytes(22) + b"\x05\0\0\0a.txt1 2 3", "is a ZIP archive of other files"),
        (b"\x1f\x8b\x08\0abc", "is a packed file, which is not read; unpack it first"),
        (b"II*\0\x08\0\0\0", "is a TIFF raster"),
        (b"<?xml version='1.0'?><LandXML>", "is XML or HTML"),
        (b"\n<html><body>404", "is XML or HTML"),
        (b'{ "type": "FeatureCollection", "features": [] }', "is JSON"),
        (b"[[1, 2, 3]]", "is JSON"),
        (b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n", "is an OFF mesh"),
        (b"solid a\n  facet normal 0 0 1\n", "is an STL mesh"),
        (b"# vtk DataFile Version 3.0\na\nASCII\nPOINTS 1 float\n0 0 0\n", "is VTK"),
        (b"ncols 2\nnrows 2\nxllcorner 0\nyllcorner 0\ncellsize 1\n1 2\n3 4\n", "is an ESRI grid of heights"),
        (b"\0\1\2\3" * 9, "is of an unknown kind"),
        (b"Dear Sir,\nplease find 12 points\n", "is of an unknown kind"),
    ],
)
def test_other_kinds_are_called_by_their_name(tmp_path: Path, head: bytes, words: str) -> None:
    for name in ("a", "a.dat"):
        (tmp_path / name).write_bytes(head)
        assert words in message_of(tmp_path / name)
    for name in ("a.las", "a.e57"):
        (tmp_path / name).write_bytes(head)
        message = message_of(tmp_path / name)
        assert words in message or "the mark at its start is missing" in message


def test_other_binary_files_are_not_text(tmp_path: Path) -> None:
    (tmp_path / "a.xyz").write_bytes(b"\0\1\2\3 1 2 3")
    assert "holds binary data" in message_of(tmp_path / "a.xyz")


@pytest.mark.skipif(os.name != "posix" or os.geteuid() == 0, reason="root may read everything")
def test_a_file_without_the_right_to_read(tmp_path: Path) -> None:
    write(cloud(), tmp_path / "a.las")
    (tmp_path / "a.las").chmod(0)
    assert "cannot be read" in message_of(tmp_path / "a.las")


def test_a_decoder_that_panics_is_damage_and_an_interrupt_stays_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class PanicException(BaseException):
        pass

    write(cloud(), tmp_path / "a.laz")
    for raised, expected in (
        (PanicException("boom\nbang"), ReadError),
        (KeyboardInterrupt(), KeyboardInterrupt),
    ):

        def fail(*_: object, error: BaseException = raised) -> None:
            raise error

        monkeypatch.setattr(las_module, "decompress", fail)
        with pytest.raises(expected) as caught:
            read(tmp_path / "a.laz")
        assert "bang" not in str(caught.value)


# --- writing: whole or not at all ---


def test_an_existing_file_is_only_replaced_on_demand(tmp_path: Path) -> None:
    path = tmp_path / "a.ply"
    path.write_text("old")
    with pytest.raises(WriteError, match="exists already"):
        write(cloud(), path)
    assert path.read_text() == "old"
    write(cloud(), path, overwrite=True)
    np.testing.assert_array_equal(read(path).xyz, XYZ)
    assert [file.name for file in tmp_path.iterdir()] == ["a.ply"]


def test_an_input_is_never_replaced(tmp_path: Path) -> None:
    path = tmp_path / "a.ply"
    write(cloud(), path)
    before = path.read_bytes()
    (tmp_path / "link.ply").symlink_to(path)
    os.link(path, tmp_path / "hard.ply")
    for name in ("a.ply", "link.ply", "hard.ply", "../" + tmp_path.name + "/a.ply"):
        with pytest.raises(WriteError, match="is an input and is never overwritten"):
            write(cloud(), tmp_path / name, overwrite=True, inputs=[path])
    assert path.read_bytes() == before


@pytest.mark.parametrize(
    ("raised", "expected", "words"),
    [
        (KeyboardInterrupt(), KeyboardInterrupt, ""),
        (
            OSError(errno.ENOSPC, "No space left on device"),
            WriteError,
            "(No space left on device); check",
        ),
        (MemoryError(), BudgetError, "more memory than there is"),
        (RuntimeError("boom"), WriteError, "cannot be written as PLY (boom)"),
        (WriteError("the reason"), WriteError, "the reason"),
    ],
)
def test_nothing_is_left_behind_by_a_failure(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    raised: BaseException,
    expected: type[BaseException],
    words: str,
) -> None:
    path = tmp_path / "a.ply"
    write(cloud(), path)
    before = path.read_bytes()

    def fail(_: PointCloud, temporary: Path, __: object) -> None:
        temporary.write_text("half a file")
        raise raised

    monkeypatch.setitem(registry._BY_EXTENSION, ".ply", dataclasses.replace(ply.FORMAT, write=fail))
    with pytest.raises(expected) as caught:
        write(cloud(), path, overwrite=True)
    assert words in str(caught.value)
    assert isinstance(raised, KeyboardInterrupt) or str(caught.value).startswith(f"{path}: ")
    assert [file.name for file in tmp_path.iterdir()] == ["a.ply"]
    assert path.read_bytes() == before


def test_a_symbolic_link_stays_and_its_target_is_replaced(tmp_path: Path) -> None:
    (tmp_path / "store").mkdir()
    (tmp_path / "store" / "real.ply").write_text("old")
    (tmp_path / "a.ply").symlink_to(tmp_path / "store" / "real.ply")
    write(cloud(), tmp_path / "a.ply", overwrite=True)
    assert (tmp_path / "a.ply").is_symlink()
    np.testing.assert_array_equal(read(tmp_path / "store" / "real.ply").xyz, XYZ)


def test_missing_folder_and_folder_as_target(tmp_path: Path) -> None:
    with pytest.raises(WriteError, match="does not exist; create it"):
        write(cloud(), tmp_path / "missing" / "a.ply")
    (tmp_path / "b.ply").mkdir()
    with pytest.raises(WriteError, match="is not a file that could be replaced"):
        write(cloud(), tmp_path / "b.ply", overwrite=True)


def test_a_cloud_without_points_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidCloudError, match="has no points to write"):
        write(PointCloud(np.empty((0, 3))), tmp_path / "a.las")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("extension", WRITABLE)
def test_attributes_that_no_file_can_hold(tmp_path: Path, extension: str) -> None:
    for bad, words in (
        ({"label": np.array(["a", "b", "c"])}, "attribute 'label' has dtype <U1"),
        ({"X": np.arange(3)}, "would be written as a second 'X'"),
    ):
        with pytest.raises(WriteError, match=words) as caught:
            write(cloud(**bad), tmp_path / f"a{extension}")
        assert str(caught.value).startswith(str(tmp_path / f"a{extension}"))
    assert list(tmp_path.iterdir()) == []


def test_very_long_names(tmp_path: Path) -> None:
    path = tmp_path / ("n" * 250 + ".ply")
    write(cloud(), path)
    assert len(read(path)) == 3


def _write_two(path: Path, between: Callable[[], object], overwrite: bool = True) -> None:
    with atomic_path(path, overwrite) as temporary:
        temporary.write_text("half")
        between()
        temporary.write_text("whole")


def test_atomic_path_for_other_files(tmp_path: Path) -> None:
    with atomic_path(tmp_path / "pose.json") as temporary:
        assert temporary.parent == tmp_path.resolve()
        assert temporary.suffix == ".json"
        temporary.write_text("{}")
        assert not (tmp_path / "pose.json").exists()
    assert (tmp_path / "pose.json").read_text() == "{}"
    with pytest.raises(WriteError, match="exists already"), atomic_path(tmp_path / "pose.json"):
        pytest.fail("the block must not run")
    with pytest.raises(ZeroDivisionError):
        _write_two(tmp_path / "pose.json", lambda: 1 / 0)
    assert (tmp_path / "pose.json").read_text() == "{}"
    assert [file.name for file in tmp_path.iterdir()] == ["pose.json"]


def test_a_file_that_appeared_meanwhile_is_not_replaced(tmp_path: Path) -> None:
    def somebody_else() -> None:
        (tmp_path / "a.txt").write_text("theirs")

    with pytest.raises(WriteError, match="exists already"):
        _write_two(tmp_path / "a.txt", somebody_else, overwrite=False)
    assert (tmp_path / "a.txt").read_text() == "theirs"
    assert [file.name for file in tmp_path.iterdir()] == ["a.txt"]


def test_a_block_that_makes_no_file_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(WriteError, match="cannot be written"), atomic_path(tmp_path / "a.txt"):
        pass


def test_check_writable_folder(tmp_path: Path) -> None:
    folder = tmp_path / "new" / "deep"
    assert check_writable_folder(folder) == folder
    assert folder.is_dir()
    assert list(folder.iterdir()) == []
    (tmp_path / "file").touch()
    for bad in (tmp_path / "file", tmp_path / "file" / "below"):
        with pytest.raises(WriteError, match="no file can be written into this folder"):
            check_writable_folder(bad)


@pytest.mark.skipif(os.name != "posix" or os.geteuid() == 0, reason="root may write everywhere")
def test_a_folder_without_the_right_to_write(tmp_path: Path) -> None:
    tmp_path.chmod(stat.S_IRUSR | stat.S_IXUSR)
    with pytest.raises(WriteError, match="no file can be written"):
        check_writable_folder(tmp_path)
    with pytest.raises(WriteError, match="cannot be written"):
        write(cloud(), tmp_path / "a.ply")


def test_the_package_exports_what_it_promises() -> None:
    for name in tmchho.io.__all__:
        assert callable(getattr(tmchho.io, name))
