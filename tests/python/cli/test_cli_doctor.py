"""`tmchho doctor` and `tmchho completion`."""

from __future__ import annotations

import importlib
import importlib.util
import json
import os
import shlex
import shutil
import subprocess
import sys
from importlib.metadata import metadata, requires, version
from pathlib import Path

import pytest
from cli_tools import run

import tmchho

# The package shows the command under this name, not its module.
doctor = importlib.import_module("tmchho.cli.doctor")
SHELLS = [shell for shell in ("bash", "zsh", "fish") if shutil.which(shell)]


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


@pytest.mark.parametrize("shell", SHELLS)
def test_a_shell_completes_commands_options_and_values(shell: str, tmp_path: Path) -> None:
    # The program under the name that the script asks for.
    program = tmp_path / "tmchho"
    program.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m tmchho "$@"\n')
    program.chmod(0o755)
    source = tmp_path / "completion"
    source.write_text(run("completion", shell).stdout)
    environment = {**os.environ, "PATH": f"{tmp_path}{os.pathsep}{os.environ['PATH']}"}

    def completed(line: str) -> set[str]:
        words = line.split(" ")
        place = f"COMP_CWORD={len(words) - 1}"
        code = {
            "bash": f"source {source}; COMP_WORDS=({shlex.join(words)}); {place}; _tmchho_completion tmchho; "
            'printf "%s\\n" "${COMPREPLY[@]}"',
            # zsh completes only at a prompt; the question that its function would ask is asked here.
            "zsh": f"autoload -U compinit; compinit -D; source {source}; "
            f"COMP_WORDS={shlex.quote(line)} {place} _TMCHHO_COMPLETE=zsh_complete tmchho",
            "fish": f"source {source}; complete --do-complete {shlex.quote(line)}",
        }[shell]
        done = subprocess.run(
            [shell, "-c", code], env=environment, capture_output=True, text=True, check=True
        )
        return {word.split("\t")[0] for word in done.stdout.splitlines()}

    found = completed("tmchho re")
    assert {"register", "report"} <= found
    assert "evaluate" not in found
    assert {"--prior", "--prior-sigma-deg"} <= completed("tmchho register --pri")
