"""Where the real clouds are: `TMCHHO_DATA`, by default `../shared/data` beside the repository."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

_REPOSITORY = Path(__file__).resolve().parents[2]
_NO_DATA = "the folder of real clouds is missing; set TMCHHO_DATA to it"


def find_data_dir() -> Path | None:
    """Return the folder of real clouds, or None where there is none."""
    folder = Path(os.environ.get("TMCHHO_DATA", _REPOSITORY / ".." / "shared" / "data")).resolve()
    return folder if folder.is_dir() else None


@pytest.fixture(scope="session")
def data_dir() -> Path:
    folder = find_data_dir()
    if folder is None:
        pytest.skip(_NO_DATA)
    return folder


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Give a test with the argument `real_file` every file of the folder of real clouds."""
    if "real_file" not in metafunc.fixturenames:
        return
    folder = find_data_dir()
    if folder is None:
        metafunc.parametrize("real_file", [pytest.param(None, marks=pytest.mark.skip(reason=_NO_DATA))])
        return
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    metafunc.parametrize("real_file", files, ids=[str(path.relative_to(folder)) for path in files])
