"""`tmchho doctor` and `tmchho completion`."""

from __future__ import annotations

import importlib
import importlib.util
import json
import os
import subprocess
import sys
from importlib.metadata import metadata, requires, version
from typing import Any

import pytest
from cli_tools import run

import tmchho

# The package shows the command under this name, not its module.
doctor = importlib.import_module("tmchho.cli.doctor")


def test_doctor_tells_what_there_is_and_finds_a_known_pose() -> None:
    told = json.loads(run("doctor", "--json").stdout)
    assert told["versions"]["tmchho"] == tmchho.__version__
    assert told["versions"]["numpy"] == version("numpy")
    assert told["self_test"]["passed"]
    assert told["self_test"]["error"] < 1e-6
    assert told["memory"]["max_memory"] <= told["memory"]["machine"]
    shown = run("doctor")
    assert shown.exit_code == 0
    assert "self test passed" in shown.stdout
    assert "Traceback" not in shown.output


def test_extras_and_what_they_need_are_those_of_the_package() -> None:
    assert set(doctor._EXTRAS) == set(metadata("tmchho").get_all("Provides-Extra") or ()) - {"peers"}
    given = [text.replace("'", '"') for text in requires("tmchho") or ()]
    for extra, (needs, _) in doctor._EXTRAS.items():
        listed = {text.split(";")[0] for text in given if f'extra == "{extra}"' in text}
        assert len(listed) == len(needs)
        assert all(any(text.lower().startswith(name) for text in listed) for name in needs)


def test_a_missing_extra_is_named_with_its_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    find = importlib.util.find_spec
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None if name == "pye57" else find(name))
    result = run("doctor")
    assert result.exit_code == 0
    assert "E57 files: missing: pip install 'tmchho[e57]'" in result.stdout


def test_a_wrong_answer_is_a_failure(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "_TOLERANCE", 0.0)
    result = run("doctor")
    assert result.exit_code == 1
    assert "self test FAILED" in result.stdout


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_the_completion_of_a_shell_is_printed(shell: str) -> None:
    result = run("completion", shell)
    assert result.exit_code == 0
    assert "_TMCHHO_COMPLETE" in result.stdout


@pytest.mark.parametrize(
    ("words", "wanted"), [("tmchho reg", "register"), ("tmchho evaluate --max-m", "--max-memory")]
)
def test_commands_and_options_are_completed(words: str, wanted: str) -> None:
    environment: dict[str, Any] = {
        **os.environ,
        "_TMCHHO_COMPLETE": "bash_complete",
        "COMP_WORDS": words,
        "COMP_CWORD": str(len(words.split()) - 1),
    }
    code = "from tmchho.cli import main; main(prog_name='tmchho')"
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False, timeout=60
    )
    assert wanted in done.stdout, done.stderr
