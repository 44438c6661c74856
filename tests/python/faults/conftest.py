"""The disturbances of `benches/faults.py`, of which a few are run here."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

BENCHES = Path(__file__).resolve().parents[3] / "benches"
sys.path.insert(0, str(BENCHES))

from faults import Faults  # noqa: E402 (its folder is known only now)


@pytest.fixture(scope="session")
def faults(tmp_path_factory: pytest.TempPathFactory) -> Faults:
    if os.name != "posix":
        pytest.skip("signals and limits of POSIX")
    return Faults(tmp_path_factory.mktemp("faults"))
