"""`tmchho report`, `tmchho view`, and the report that `tmchho register` leaves."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from click.testing import CliRunner, Result
from report_tools import Page, Registered

import tmchho
from tmchho.cli import main
from tmchho.outputs import OUTPUTS
from tmchho.report import template, words
from tmchho.report.browser import find_browser
from tmchho.simulate import make_pair


def run(*arguments: object) -> Result:
    result = CliRunner().invoke(main, [str(argument) for argument in arguments])
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return result


def test_register_leaves_a_report_and_names_it(registered: Registered) -> None:
    assert {path.name for path in registered.folder.iterdir()} == {*OUTPUTS, "report.html"}


def test_without_a_report_an_older_one_does_not_stay(registered: Registered, tmp_path: Path) -> None:
    for name in ("report.html", "report.pdf"):
        (tmp_path / name).write_text("of another registration")
    arguments = ("register", registered.source, registered.target, "-o", tmp_path, "--no-report")
    refused = run(*arguments)
    assert refused.exit_code == 5
    assert "report.html" in refused.stderr
    assert run(*arguments, "--overwrite").exit_code == 0
    assert {path.name for path in tmp_path.iterdir()} == set(OUTPUTS)


def test_without_the_libraries_register_says_so_and_works(
    registered: Registered, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(template, "NEEDED", ("no_such_library",))
    result = run("register", registered.source, registered.target, "-o", tmp_path / "out")
    assert result.exit_code == 0
    lines = [line for line in result.stderr.splitlines() if "no_such_library" in line]
    assert len(lines) == 1
    assert "tmchho[report]" in lines[0]
    assert {path.name for path in (tmp_path / "out").iterdir()} == set(OUTPUTS)
    refused = run("report", tmp_path / "out")
    assert refused.exit_code == 2
    assert "tmchho[report]" in refused.stderr


def test_report_needs_only_what_register_left(registered: Registered, tmp_path: Path) -> None:
    for name in ("result.json", "report_points.npz"):
        shutil.copy2(registered.folder / name, tmp_path / name)
    result = run("report", tmp_path, "--no-pdf", "--no-figures")
    assert result.exit_code == 0
    assert result.stdout.split() == ["written:", str(tmp_path / "report.html")]
    assert (tmp_path / "report.html").read_bytes() == (registered.folder / "report.html").read_bytes()


def test_report_of_a_missing_folder_is_an_input_error(tmp_path: Path) -> None:
    result = run("report", tmp_path / "nothing")
    assert result.exit_code == 3
    assert "tmchho register" in result.stderr


def test_a_pdf_without_a_browser_is_refused_before_anything_is_made(
    registered: Registered, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copy2(registered.folder / "result.json", tmp_path / "result.json")
    monkeypatch.setattr(shutil, "which", lambda name: None)
    monkeypatch.setattr("tmchho.report.browser._PLACES", {})
    assert find_browser() is None
    result = run("report", tmp_path, "--pdf")
    assert result.exit_code == 2
    assert "Chromium" in result.stderr
    assert not (tmp_path / "report.html").exists()
    assert run("report", tmp_path, "--no-figures").exit_code == 0  # only where there is one


def test_view_writes_one_page_of_several_clouds(registered: Registered, tmp_path: Path) -> None:
    page = tmp_path / "view.html"
    result = run("view", registered.source, registered.target, "-o", page, "--points", 4000)
    assert result.exit_code == 0
    assert result.stdout.strip() == str(page)
    html = page.read_text(encoding="utf-8")
    assert "uav.laz" in Page(html).text
    assert "4\u202f000 points" in html
    assert "http-equiv" in html
    refused = run("view", registered.source, "-o", page)
    assert refused.exit_code == 5
    assert "exists already" in refused.stderr


def test_view_opens_a_page_of_its_own(registered: Registered, monkeypatch: pytest.MonkeyPatch) -> None:
    opened: list[str] = []
    monkeypatch.setattr("webbrowser.open", lambda address: opened.append(address) or True)
    result = run("view", registered.target)
    path = Path(result.stdout.strip())
    assert opened == [path.as_uri()]
    assert "tls.laz" in path.read_text(encoding="utf-8")
    shutil.rmtree(path.parent)


def test_a_missing_cloud_is_named(tmp_path: Path) -> None:
    result = run("view", tmp_path / "no.laz", "-o", tmp_path / "view.html")
    assert result.exit_code == 3
    assert "no.laz" in result.stderr
    assert not (tmp_path / "view.html").exists()


def test_values_of_a_cloud_can_be_looked_at(tmp_path: Path) -> None:
    cloud = tmchho.PointCloud([[0, 0, 0], [1, 0, 0], [0, 1, 0]], {"M3C2_distance": [-0.1, 0.0, 0.2]})
    page = tmchho.write_view([cloud, [[0.0, 0.0, 5.0], [1.0, 1.0, 5.0]]], tmp_path / "view.html")
    html = page.read_text(encoding="utf-8")
    assert "M3C2 distance" in html
    assert '"ramp": "diverging"' in html
    with pytest.raises(tmchho.InvalidArgumentError, match="brackets"):
        tmchho.write_view(cloud, tmp_path / "b.html")  # type: ignore[arg-type]
    with pytest.raises(tmchho.InvalidCloudError, match="no finite point"):
        tmchho.write_view([[[float("nan")] * 3]], tmp_path / "c.html")


def test_change_that_was_measured_at_the_same_pose_is_shown(registered: Registered, tmp_path: Path) -> None:
    for name in ("result.json", "report_points.npz"):
        shutil.copy2(registered.folder / name, tmp_path / name)
    result = tmp_path / "result.json"
    clouds = registered.source, registered.target
    evaluated = run(
        "evaluate", *clouds, "--transform", result, "--method", "m3c2", "-o", tmp_path, "--form", "laz"
    )
    assert evaluated.exit_code == 0, evaluated.output
    cores = json.loads((tmp_path / "evaluation.json").read_text())["target_to_source"]
    page = Page(tmchho.write_report(tmp_path)[0].read_text(encoding="utf-8"))
    assert f"Measured at {words.count(cores['n_points'])} places" in page.text
    assert "Change (M3C2)" in page.text
    document = json.loads(result.read_text())
    document["transformation"][0][3] += 1.0  # registered once more, with another result
    result.write_text(json.dumps(document))
    page = Page(tmchho.write_report(tmp_path)[0].read_text(encoding="utf-8"))
    assert "Change (M3C2)" not in page.text


@pytest.mark.parametrize("is_rejected", [False, True])
def test_files_that_are_worked_on_in_parts_have_a_report(
    registered: Registered, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, is_rejected: bool
) -> None:
    monkeypatch.setattr("tmchho.streams.memory._BYTES_PER_POINT", 1_000_000)
    config = tmp_path / "settings.toml"
    strict = "[verdict]\naccept_inlier_share = 1.0\nreject_inlier_share = 1.0\n"
    config.write_text(strict if is_rejected else "")
    source = registered.source
    if is_rejected:  # a piece of another site
        stranger = make_pair(n_photogrammetry_points=6_000, n_scanner_points=1_000, area_ratio=1.2, seed=8)
        source = tmp_path / "stranger.laz"
        tmchho.write(stranger.source, source)
    result = run("register", source, registered.target, "-o", tmp_path / "out", "--config", config)
    document = json.loads((tmp_path / "out" / "result.json").read_text())
    assert (document["verdict"] == "rejected") == is_rejected, result.output
    assert is_rejected or "in_parts" in document
    page = Page((tmp_path / "out" / "report.html").read_text(encoding="utf-8"))
    assert [values for tag, values in page.tags if tag == "canvas"]
    assert document["inputs"]["target"]["crs"] in page.text
    assert ("Map of the distances." in page.text) != is_rejected
