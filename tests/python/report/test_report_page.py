"""The page: complete, self-contained, made from results alone, and to be read by everybody."""

from __future__ import annotations

import json
import re
import shutil
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from report_tools import Page, Registered

import tmchho
from tmchho.errors import InvalidArgumentError, ReadError
from tmchho.report import template
from tmchho.report.words import VERDICTS


@pytest.fixture(scope="module")
def html(registered: Registered) -> str:
    return (registered.folder / "report.html").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def page(html: str) -> Page:
    return Page(html)


def result_of(registered: Registered) -> dict[str, Any]:
    document: dict[str, Any] = json.loads((registered.folder / "result.json").read_text(encoding="utf-8"))
    return document


def remade(registered: Registered, folder: Path, **changes: Any) -> Page:
    """Return the page of a result with some entries changed; None takes one out."""
    document = result_of(registered) | changes
    folder.mkdir(exist_ok=True)
    kept = {key: value for key, value in document.items() if value is not None}
    (folder / "result.json").write_text(json.dumps(kept), encoding="utf-8")
    return Page(tmchho.write_report(folder)[0].read_text(encoding="utf-8"))


def test_the_verdict_and_its_reasons_come_first(registered: Registered, page: Page) -> None:
    document = result_of(registered)
    first = page.text[:1500]
    assert VERDICTS[document["verdict"]][0] in first
    for reason in document["reasons"]:
        assert reason[1:] in first
    assert "Accuracy of the position" in first


def test_everything_that_was_promised_is_there(registered: Registered, page: Page) -> None:
    document = result_of(registered)
    for side in ("source", "target"):
        assert document["inputs"][side]["sha256"] in page.text
        assert document["inputs"][side]["name"] in page.text
    assert document["inputs"]["target"]["crs"] in page.text
    assert document["command"] in page.text
    assert f"seed ({document['seed']})" in page.text
    assert f"tmchho {tmchho.__version__}" in page.text
    assert f"voxel.voxel_size_m = {document['config']['voxel']['voxel_size_m']}" in page.text
    for stage in document["stages"]:  # Table 6
        for key in ("n_source_in", "n_source_out", "n_target_in", "n_target_out"):
            assert f"{stage[key]:,}".replace(",", "\u202f") in page.text
    for row in document["areas"]:
        assert row["name"] in page.text
    for title in ("Before and after.", "Cut through both clouds.", "Map of the distances.", "Holes filled."):
        assert title in page.text
    for title in ("Spread of the distances.", "Spread within the areas.", "How the search went."):
        assert title in page.text
    matrix = np.array(document["transformation"])
    assert " ".join(format(value, ".17g") for value in matrix[0]) in page.text


def test_it_is_one_file_that_names_no_other(html: str, page: Page) -> None:
    assert len(html) < 25e6
    for attribute in ("src", "srcset", "action", "data", "poster"):
        assert page.having(attribute) == []
    for attribute in ("href", "xlink:href"):
        assert all(value.startswith(("#", "data:")) for value in page.having(attribute))
    addresses = set(re.findall(r"https?://[^\s\"'<>)]+", html))
    assert all("www.w3.org" in address for address in addresses), addresses  # names of the parts of SVG
    assert "@import" not in html
    assert not re.search(r"url\((?!#)", html)
    assert "default-src 'none'" in html  # and the browser refuses what was overlooked


def test_it_can_be_read_aloud_and_used_by_keys(page: Page) -> None:
    ids = page.having("id")
    assert len(ids) == len(set(ids))
    for attribute in ("aria-labelledby", "aria-describedby"):
        assert set(page.having(attribute)) <= set(ids)
    for values in (values for tag, values in page.tags if tag == "a"):
        assert str(values["href"])[1:] in ids
    tags = [tag for tag, _ in page.tags]
    assert tags.count("table") == tags.count("caption") >= 4
    assert all("scope" in values for tag, values in page.tags if tag == "th")
    for tag, values in page.tags:
        if tag == "svg":
            assert values.get("aria-hidden") == "true" or "aria-labelledby" in values
        if tag == "canvas":
            assert "aria-label" in values
            assert values["tabindex"] == "0"
        assert int(values.get("tabindex") or 0) <= 0  # the order of the page is the order of the keys
    levels = [int(tag[1]) for tag in tags if re.fullmatch("h[1-6]", tag)]
    assert levels[0] == 1
    assert levels.count(1) == 1
    assert all(after <= before + 1 for before, after in pairwise(levels))
    assert ("html", {"lang": "en", "data-theme": "auto"}) in page.tags
    n_inputs = tags.count("input") + tags.count("select")
    assert tags.count("label") >= n_inputs


def test_it_is_made_from_results_alone_and_always_the_same(registered: Registered, tmp_path: Path) -> None:
    for name in ("result.json", "report_points.npz"):
        shutil.copy2(registered.folder / name, tmp_path / name)
    files = tmchho.write_report(tmp_path, figures=True)
    assert files[0].read_bytes() == (registered.folder / "report.html").read_bytes()
    pictures = sorted(path.name for path in (tmp_path / "figures").iterdir())
    assert {"before_after.png", "cut.png", "distance_map.png", "convergence.png"} <= set(pictures)
    assert all((tmp_path / "figures" / name).read_bytes()[:4] == b"\x89PNG" for name in pictures)
    assert set(files[1:]) == {tmp_path / "figures" / name for name in pictures}


@pytest.mark.parametrize("verdict", ["review", "rejected"])
def test_a_pose_that_is_not_accepted_is_told_so_first(
    registered: Registered, tmp_path: Path, verdict: str
) -> None:
    reasons = ["another pose fits almost as well", "the common surface hardly holds the pose"]
    changes: dict[str, Any] = {"verdict": verdict, "reasons": reasons}
    if verdict == "rejected":
        changes |= {"fused": None, "areas": None, "distances": None}
    page = remade(registered, tmp_path, **changes)
    assert VERDICTS[verdict][0] in page.text[:900]
    assert "Another pose fits almost as well." in page.text[:1200]
    assert VERDICTS["accepted"][0] not in page.text
    assert ("not fused, because the position is rejected" in page.text) == (verdict == "rejected")


def test_what_was_not_measured_is_called_so(registered: Registered, tmp_path: Path) -> None:
    page = remade(
        registered,
        tmp_path,
        areas=None,
        distances=None,
        history=[],
        icp_history=[],
        candidates=[],
    )
    assert "Not measured: the results hold no areas." in page.text
    assert "points that a report shows were not stored" in page.text
    assert "Candidates: not measured." in page.text
    assert not [values for tag, values in page.tags if tag == "canvas"]


def test_without_its_points_the_fused_cloud_is_shown(registered: Registered, tmp_path: Path) -> None:
    for name in ("result.json", "fused.laz"):
        shutil.copy2(registered.folder / name, tmp_path / name)
    page = Page(tmchho.write_report(tmp_path)[0].read_text(encoding="utf-8"))
    assert [values for tag, values in page.tags if tag == "canvas"]
    assert "Map of the distances." in page.text


def test_numbers_that_nobody_has_are_no_crash(registered: Registered, tmp_path: Path) -> None:
    document = result_of(registered)
    unknown = ("registration_error", "ambiguity_ratio", "lead_over_chance", "held_out_ratio", "misfit")
    for key in unknown:
        document[key] = None
    for side in ("source", "target"):
        for key in ("spacing", "lowest", "highest", "sensor", "crs", "unit", "format"):
            document["inputs"][side][key] = None
    (tmp_path / "result.json").write_text(json.dumps(document), encoding="utf-8")
    page = Page(tmchho.write_report(tmp_path)[0].read_text(encoding="utf-8"))
    assert page.text.count("not measured") >= 6
    assert "The target does not state its unit" in page.text


def test_an_area_without_data_is_a_row(registered: Registered, tmp_path: Path) -> None:
    areas = result_of(registered)["areas"]
    empty = {key: None for key in areas[0]} | {"name": "spillway", "n_points": 0, "remark": "no data"}
    page = remade(registered, tmp_path, areas=[*areas, empty | {"outline": []}])
    assert "spillway" in page.text
    assert "no data" in page.text


def test_names_of_files_are_text_and_nothing_else(registered: Registered, tmp_path: Path) -> None:
    evil = "</script><script>alert(1)</script>.laz"
    inputs = result_of(registered)["inputs"]
    inputs["source"]["name"] = evil
    page = remade(registered, tmp_path, inputs=inputs, command=f"tmchho register '{evil}'")
    assert evil in page.text
    assert sum(tag == "script" for tag, _ in page.tags) == 1  # without points there is no view


def test_a_folder_of_something_else_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ReadError, match="tmchho register"):
        tmchho.write_report(tmp_path)
    (tmp_path / "result.json").write_text("{}")
    with pytest.raises(ReadError, match="not the result of a registration"):
        tmchho.write_report(tmp_path)
    (tmp_path / "result.json").write_text("{")
    with pytest.raises(ReadError, match="not JSON"):
        tmchho.write_report(tmp_path)


def test_missing_libraries_are_named_with_the_remedy(
    registered: Registered, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(template, "NEEDED", ("jinja2", "no_such_library"))
    with pytest.raises(InvalidArgumentError, match=r"no_such_library.*tmchho\[report\]"):
        tmchho.write_report(registered.folder)


def test_a_registration_shows_itself_in_a_notebook(registered: Registered) -> None:
    pair = registered.pair
    found = tmchho.register(pair.source, pair.target)
    shown = Page(found._repr_html_())
    assert found.verdict.upper() in shown.text
    assert found.reasons[0][1:] in shown.text
    for figure in (found.plot(), found.plot(pair.source, pair.target)):
        assert figure._repr_png_()[:4] == b"\x89PNG"  # type: ignore[attr-defined]
    figure = tmchho.evaluate(pair.source, pair.target, found).plot()
    assert len(figure.axes) == 1
    assert figure.axes[0].get_xlim()[0] == 0
