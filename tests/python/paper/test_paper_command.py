"""`tmchho paper` as a user meets it: files, page, interruption, what is missing."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from paper_tools import files_of, rows_of, run_paper, runs_of

import tmchho
from tmchho.paper import SECTIONS, extras, library

PRINTED = Path(tmchho.__file__).parent / "paper" / "printed"
QUICK = ("--runs", 2, "--iterations", 5)
TABLES_ON_FUNCTIONS = ("table3", "figure6", "ranks")


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("paper")
    assert run_paper(*TABLES_ON_FUNCTIONS, *QUICK, "-o", folder).exit_code == 0
    return folder


def test_every_table_has_a_file_and_every_picture_too(done: Path) -> None:
    assert sorted(files_of(done)) == [
        "figure6.csv",
        "figure6.png",
        "paper.html",
        "ranks.csv",
        "ranks_tests.csv",
        "table3.csv",
    ]
    assert (done / "figure6.png").read_bytes().startswith(b"\x89PNG")


def test_the_printed_values_stand_beside_ours(done: Path) -> None:
    rows = rows_of(done / "table3.csv")
    printed = {
        (row["function"], row["algorithm"], row["dimension"]): row for row in rows_of(PRINTED / "table3.csv")
    }
    assert len(rows) == len(printed) == 7 * 6 * 2
    for row in rows:
        theirs = printed[row["function"], row["algorithm"], row["dimension"]]
        for name in ("ave", "best", "worst", "std"):
            assert float(row[f"printed_{name}"]) == float(theirs[name])
        ours = [
            tmchho.minimize(
                row["function"],
                dimension=int(row["dimension"]),
                method=row["algorithm"].lower(),
                n_iterations=5,
                seed=seed,
            )
            for seed in (0, 1)
        ]
        values = [found.fun for found in ours]
        assert float(row["ave"]) == pytest.approx(np.mean(values), rel=1e-12)
        assert float(row["std"]) == pytest.approx(np.std(values, ddof=1), rel=1e-9)
        assert (float(row["best"]), float(row["worst"])) == (min(values), max(values))
        assert float(row["evaluations"]) == np.mean([found.nfev for found in ours])
        assert row["runs"] == "2"


def test_the_page_needs_nothing_else(done: Path) -> None:
    page = (done / "paper.html").read_text(encoding="utf-8")
    assert re.findall(r"(?:src|href)\s*=\s*[\"'](?!data:image/png;base64,|#)", page) == []
    assert re.search(r"<(?:script|link|iframe|object)\b|url\(|@import", page) is None
    assert page.count("data:image/png;base64,") == 1
    # Seeds, length and calls are told, and the printed and our value of one cell are both there.
    assert "2 runs each (seeds 0 to 1), population 30, 5 iterations. NOT COMPARABLE with the printed" in page
    assert "Evaluations in a run: " in page
    row = next(row for row in rows_of(done / "table3.csv") if row["algorithm"] == "WOA")
    assert f"{float(row['printed_ave']):.2e}" in page
    assert f"{float(row['ave']):.2e}" in page


def test_what_was_run_is_not_run_again(done: Path, tmp_path: Path) -> None:
    before = files_of(done), (done / "runs.jsonl").read_bytes()
    assert run_paper(*TABLES_ON_FUNCTIONS, *QUICK, "-o", done).exit_code == 0
    assert (files_of(done), (done / "runs.jsonl").read_bytes()) == before


def test_half_a_line_is_dropped_and_the_rest_gives_the_same_bytes(done: Path, tmp_path: Path) -> None:
    lines = (done / "runs.jsonl").read_bytes().splitlines(keepends=True)
    (tmp_path / "runs.jsonl").write_bytes(b"".join(lines[: len(lines) // 2]) + lines[-1][:40])
    assert run_paper(*TABLES_ON_FUNCTIONS, *QUICK, "-o", tmp_path).exit_code == 0
    ours, theirs = files_of(tmp_path), files_of(done)
    for files, folder in ((ours, tmp_path), (theirs, done)):
        files["paper.html"] = files["paper.html"].replace(str(folder).encode(), b"")
    assert ours == theirs
    assert len(runs_of(tmp_path)) == len(lines)


@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
@pytest.mark.parametrize(("number", "code"), [(signal.SIGKILL, -9), (signal.SIGINT, 130)])
def test_a_run_that_was_stopped_goes_on(tmp_path: Path, number: signal.Signals, code: int) -> None:
    n_runs = 7 * 6 * 2 * 12
    command = [sys.executable, "-m", "tmchho", "paper", "table3", "--runs", "12", "-o"]
    process = subprocess.Popen(
        [*command, str(tmp_path)], stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL
    )
    runs = tmp_path / "runs.jsonl"
    while process.poll() is None and not (runs.exists() and runs.stat().st_size > 20_000):
        time.sleep(0.01)
    process.send_signal(number)
    assert process.wait() == code
    assert not (tmp_path / "paper.html").exists()
    n_before = runs.read_bytes().count(b"\n")
    assert 0 < n_before < n_runs
    assert run_paper("table3", "--runs", 12, "-o", tmp_path).exit_code == 0
    assert len(runs_of(tmp_path)) == n_runs
    whole = tmp_path / "whole"
    assert run_paper("table3", "--runs", 12, "-o", whole).exit_code == 0
    assert (tmp_path / "table3.csv").read_bytes() == (whole / "table3.csv").read_bytes()


def test_a_damaged_store_is_refused(tmp_path: Path) -> None:
    (tmp_path / "runs.jsonl").write_text('{"version": "x", "job": {}, "result": {}}\nnonsense\n')
    result = run_paper("figure3", "--runs", 1, "-o", tmp_path)
    assert result.exit_code == 3
    assert "runs.jsonl: line 2 is not a finished run" in result.stderr


def test_runs_of_another_version_do_not_count(done: Path, tmp_path: Path) -> None:
    other = [json.dumps({**run, "version": "0.0.1", "result": {"fun": 1.0}}) for run in runs_of(done)]
    (tmp_path / "runs.jsonl").write_text("\n".join(other) + "\n")
    assert run_paper("table3", *QUICK, "-o", tmp_path).exit_code == 0
    assert (tmp_path / "table3.csv").read_bytes() == (done / "table3.csv").read_bytes()


@pytest.mark.parametrize("name", extras.NEEDED)
def test_a_missing_library_is_told_before_anything_is_run(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(extras, "is_there", lambda other: other != name)
    result = run_paper("table3", "-o", tmp_path / "out")
    assert result.exit_code == 2
    assert f"needs {name}" in result.stderr
    assert "pip install 'tmchho[paper]'" in result.stderr
    assert not (tmp_path / "out").exists()


def test_without_cma_the_page_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(library, "is_there", lambda name: name != "cma")
    monkeypatch.setattr("tmchho.paper.budgets.FUNCTIONS", ("f1", "f5"))
    monkeypatch.setattr("tmchho.paper.budgets.MAX_EVALUATIONS", 200)
    assert run_paper("modern", *QUICK, "-o", tmp_path).exit_code == 0
    page = (tmp_path / "paper.html").read_text()
    assert "CMA-ES was not run: the library cma is missing" in page
    assert "cma_es" not in rows_of(tmp_path / "modern.csv")[0]
    assert "de" in rows_of(tmp_path / "modern.csv")[0]


def test_the_help_names_every_section() -> None:
    text = run_paper("--help").stdout
    assert [name for name in SECTIONS if not re.search(rf"\b{name}\b", text)] == []


@pytest.mark.parametrize("arguments", [("table9",), (), ("table3", "--runs", "0")])
def test_wrong_usage_is_refused(arguments: tuple[str, ...]) -> None:
    assert run_paper(*arguments).exit_code == 2
