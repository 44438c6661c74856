"""The report of real surveys: complete, whatever the sensor and the format."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner
from report_tools import Page

from tmchho.cli import main
from tmchho.report.words import VERDICTS

_TITLES = (
    "Before and after.",
    "Cut through both clouds.",
    "Map of the distances.",
    "Spread of the distances.",
    "Spread within the areas.",
    "Holes filled.",
    "How the search went.",
)


@pytest.mark.parametrize("name", ["facade_2_to_1", "hippo_1_to_2"])
def test_the_report_of_a_real_pair_is_complete(data_dir: Path, tmp_path: Path, name: str) -> None:
    survey = data_dir / "survey"
    pair = next(pair for pair in json.loads((survey / "pairs.json").read_text()) if pair["name"] == name)
    paths = [str(survey / pair[role]) for role in ("source", "target")]
    result = CliRunner().invoke(main, ["register", *paths, "-o", str(tmp_path / "out"), "--quiet"])
    assert result.exit_code in (0, 4), result.output
    html = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert len(html) < 25e6
    page = Page(html)
    verdict = json.loads((tmp_path / "out" / "result.json").read_text())["verdict"]
    assert VERDICTS[verdict][0] in page.text[:900]
    for title in _TITLES:
        assert title in page.text, title
    assert [values for tag, values in page.tags if tag == "canvas"]
    assert "None" not in page.text.split("All settings")[0]
    assert "nan" not in page.text.split()
