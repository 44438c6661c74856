"""One small simulated pair, registered by the command line with its report, for all tests here."""

from __future__ import annotations

import pytest
from click.testing import CliRunner
from report_tools import Registered

import tmchho
from tmchho.cli import main
from tmchho.simulate import make_pair


@pytest.fixture(scope="session")
def registered(tmp_path_factory: pytest.TempPathFactory) -> Registered:
    folder = tmp_path_factory.mktemp("report")
    pair = make_pair(n_photogrammetry_points=12_000, n_scanner_points=9_000, area_ratio=1.2, seed=0)
    source, target = folder / "uav.laz", folder / "tls.laz"
    tmchho.write(pair.source, source)
    tmchho.write(pair.target, target)
    out = folder / "out"
    result = CliRunner().invoke(main, ["register", str(source), str(target), "-o", str(out), "--seed", "3"])
    assert result.exit_code == 0, result.output
    return Registered(out, source, target, pair)
