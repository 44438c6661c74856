"""What `tmchho register` refuses: one sentence, an exit code, and nothing written."""

from __future__ import annotations

import json
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli_tools import assert_refused, names_in, run, write_points
from click.testing import Result

import tmchho
from tmchho.cloud import PointCloud
from tmchho.outputs import OUTPUTS


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--voxel-size", "0"], ["--voxel-size", "above 0"]),
        (["--voxel-size", "-1"], ["--voxel-size"]),
        (["--voxel-size", "nan"], ["--voxel-size"]),
        (["--threads", "0"], ["--threads"]),
        (["--mode", "best"], ["--mode", "robust"]),
        (["--sed", "1"], ["--sed"]),
    ],
)
def test_wrong_options_are_wrong_usage(
    files: tuple[Path, Path], tmp_path: Path, arguments: list[str], words: list[str]
) -> None:
    assert_refused(run("register", *files, "-o", tmp_path / "out", *arguments), 2, *words)
    assert names_in(tmp_path) == []


def test_a_voxel_too_small_names_the_smallest(files: tuple[Path, Path], tmp_path: Path) -> None:
    result = run("register", *files, "-o", tmp_path / "out", "--voxel-size", "1e-7")
    assert_refused(result, 2, "1e-7", "smallest")
    assert names_in(tmp_path) == []


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("voxle = 1\n", "voxle"),
        ("[voxel]\nvoxel_sise_m = 1.0\n", "voxel_sise_m"),
        ("[voxel\n", "settings.toml"),
    ],
)
def test_wrong_configurations_are_wrong_usage(
    files: tuple[Path, Path], tmp_path: Path, text: str, word: str
) -> None:
    (tmp_path / "settings.toml").write_text(text)
    result = run("register", *files, "-o", tmp_path / "out", "--config", tmp_path / "settings.toml")
    assert_refused(result, 2, word)
    assert names_in(tmp_path) == ["settings.toml"]


def _missing(folder: Path, good: Path) -> Path:
    return folder / "missing.laz"


def _unknown(folder: Path, good: Path) -> Path:
    (folder / "cloud.docx").write_bytes(b"\0\1\2\3")
    return folder / "cloud.docx"


def _truncated(folder: Path, good: Path) -> Path:
    (folder / "cut.laz").write_bytes(good.read_bytes()[:5000])
    return folder / "cut.laz"


def _empty(folder: Path, good: Path) -> Path:
    (folder / "empty.las").write_bytes(b"")
    return folder / "empty.las"


def _three_points(folder: Path, good: Path) -> Path:
    return write_points(folder / "three.xyz", np.eye(3))


def _identical(folder: Path, good: Path) -> Path:
    return write_points(folder / "identical.xyz", np.ones((50, 3)))


def _collinear(folder: Path, good: Path) -> Path:
    return write_points(folder / "line.xyz", np.arange(50)[:, None] * [1.0, 2.0, 3.0])


def _coplanar(folder: Path, good: Path) -> Path:
    return write_points(folder / "plane.xyz", np.random.default_rng(0).uniform(0, 9, (80, 3)) * [1, 1, 0])


def _nothing_finite(folder: Path, good: Path) -> Path:
    return write_points(folder / "nan.xyz", np.full((9, 3), np.nan))


@pytest.mark.parametrize("place", [0, 1], ids=["source", "target"])
@pytest.mark.parametrize(
    ("make", "words"),
    [
        (_missing, ["missing.laz", "does not exist"]),
        (_unknown, ["cloud.docx", "extension"]),
        (_truncated, ["cut.laz"]),
        (_empty, ["empty.las", "empty"]),
        (_three_points, ["3 usable points"]),
        (_identical, ["identical"]),
        (_collinear, ["line"]),
        (_coplanar, ["plane"]),
        (_nothing_finite, ["0 usable points"]),
    ],
)
def test_bad_inputs_are_refused_before_anything_is_written(
    files: tuple[Path, Path],
    tmp_path: Path,
    make: Callable[[Path, Path], Path],
    words: list[str],
    place: int,
) -> None:
    clouds = list(files)
    clouds[place] = make(tmp_path, files[0])
    before = names_in(tmp_path)
    assert_refused(run("register", *clouds, "-o", tmp_path / "out"), 3, *words)
    assert names_in(tmp_path) == before


def test_points_that_are_not_finite_are_left_out_with_their_number(
    files: tuple[Path, Path], tmp_path: Path
) -> None:
    cloud = tmchho.read(files[0])
    xyz = cloud.xyz.copy()
    xyz[[5, 500, 5000], 1] = np.nan
    tmchho.write(PointCloud(xyz, {"serial": np.arange(len(xyz))}), tmp_path / "holey.ply")
    result = run("register", tmp_path / "holey.ply", files[1], "-o", tmp_path / "out", "--quiet")
    assert result.exit_code in (0, 4)  # at this density chance decides whether a person has to look
    assert "3 points left out" in result.stderr
    assert json.loads((tmp_path / "out" / "result.json").read_text())["n_non_finite"] == [3, 0]
    moved = tmchho.read(tmp_path / "out" / "source_registered.laz")
    assert np.array_equal(moved.attributes["serial"], np.delete(np.arange(len(xyz)), [5, 500, 5000]))


def test_degrees_are_refused(files: tuple[Path, Path], tmp_path: Path) -> None:
    crs = 'GEOGCS["WGS 84",DATUM["WGS_1984",SPHEROID["WGS 84",6378137,298.257223563]],PRIMEM["Greenwich",0]]'
    xyz = np.random.default_rng(0).uniform(0, 1, (100, 3)) * [0.01, 0.01, 30] + [99, 36, 0]
    tmchho.write(PointCloud(xyz, crs=crs), tmp_path / "degrees.laz")
    result = run("register", tmp_path / "degrees.laz", files[1], "-o", tmp_path / "out")
    assert_refused(result, 3, "degrees", "WGS 84", "metres")


def test_outputs_of_an_earlier_run_are_kept(
    registered: tuple[Path, Result], files: tuple[Path, Path]
) -> None:
    folder, _ = registered
    before = {name: (folder / name).read_bytes() for name in OUTPUTS}
    assert_refused(run("register", *files, "-o", folder), 5, "exists already", "--overwrite")
    assert {name: (folder / name).read_bytes() for name in OUTPUTS} == before


def test_an_input_is_never_an_output(
    registered: tuple[Path, Result], files: tuple[Path, Path], tmp_path: Path
) -> None:
    target = tmp_path / "fused.laz"
    target.write_bytes((registered[0] / "fused.laz").read_bytes())
    result = run("register", files[0], target, "-o", tmp_path, "--overwrite")
    assert_refused(result, 5, "fused.laz", "is an input")
    assert names_in(tmp_path) == ["fused.laz"]


def test_a_folder_that_cannot_be_made_is_refused_before_reading(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    result = run("register", "missing.laz", "missing.laz", "-o", tmp_path / "file" / "out")
    assert_refused(result, 5, "is a file")


def test_memory_and_bugs_have_their_exit_codes(
    files: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(error: BaseException) -> Callable[..., Any]:
        def raise_it(*_arguments: Any, **_keywords: Any) -> Any:
            raise error

        return raise_it

    arguments = ("register", *files, "-o", tmp_path / "out")
    monkeypatch.setattr(tmchho, "register", fail(MemoryError()))
    assert_refused(run(*arguments), 6, "memory")
    monkeypatch.setattr(tmchho, "register", fail(ZeroDivisionError("a bug")))
    assert_refused(run(*arguments), 1, "ZeroDivisionError", "a bug", "--debug")
    told = run(*arguments, "--debug").stderr
    assert "Traceback" in told
    assert "raise_it" in told
    monkeypatch.setattr(tmchho, "register", fail(tmchho.NoSolutionError("no pose was found")))
    assert_refused(run(*arguments), 4, "no pose was found")
    monkeypatch.setattr(tmchho, "register", fail(KeyboardInterrupt()))
    result = run(*arguments)
    assert result.exit_code == 130
    assert "interrupted" in result.stderr
    assert names_in(tmp_path) == []


def test_an_interrupt_that_a_library_swallowed_is_still_one(
    files: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def compress(*_arguments: Any, **_keywords: Any) -> None:
        try:
            signal.raise_signal(signal.SIGINT)
        except KeyboardInterrupt:
            raise tmchho.WriteError("failed to call write") from None

    monkeypatch.setattr(tmchho, "write", compress)
    result = run("register", *files, "-o", tmp_path / "out", "--quiet")
    assert result.exit_code == 130
    assert result.stderr == "tmchho: interrupted; no unfinished file is left\n"
    assert names_in(tmp_path) == []
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
