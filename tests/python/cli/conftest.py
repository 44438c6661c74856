"""A small simulated pair, and one registration of it that many tests look at."""

from __future__ import annotations

from pathlib import Path

import pytest
from cli_tools import run
from click.testing import Result

import tmchho
from tmchho.simulate import SimulatedPair, make_pair


@pytest.fixture(scope="session")
def pair() -> SimulatedPair:
    return make_pair(n_photogrammetry_points=12_000, n_scanner_points=9_000, area_ratio=1.2, seed=0)


@pytest.fixture(scope="session")
def files(pair: SimulatedPair, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("inputs")
    tmchho.write(pair.source, folder / "uav.laz")
    tmchho.write(pair.target, folder / "tls.laz")
    return folder / "uav.laz", folder / "tls.laz"


@pytest.fixture(scope="session")
def registered(files: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Result]:
    folder = tmp_path_factory.mktemp("runs") / "out"
    return folder, run("register", *files, "-o", folder, "--seed", 0)
