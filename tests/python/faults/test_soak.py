"""A short form of `benches/soak.py`, in a process that has not registered yet."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

SOAK = Path(__file__).resolve().parents[3] / "benches" / "soak.py"


@pytest.mark.skipif(os.name != "posix", reason="fork of POSIX")
def test_again_and_again_in_threads_and_after_a_fork() -> None:
    command = [sys.executable, str(SOAK), "--runs", "12", "--threads", "8"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("the same answer") == 2
