"""The report of a network: what a person must know stands first, and the worst before the rest."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest
from made_networks import made_network

from tmchho.errors import ReadError
from tmchho.outputs import json_text
from tmchho.report.network import network_page, write_network_report

BLANK = "\u00a0"


def page_of(**changes: Any) -> str:
    is_wrong = changes.pop("is_wrong", False)
    document = json.loads(json_text(made_network(12, is_wrong=is_wrong).to_dict()))
    return network_page({**document, "name": "Dam", **changes}, "1 May 2026")


def rows_of(page: str, caption: str) -> list[list[str]]:
    """Return the cells of a table as text."""
    table = re.search(rf"<caption>{caption}.*?</table>", page, re.DOTALL)
    assert table is not None
    found = []
    for row in re.findall(r"<tr>(.*?)</tr>", table[0].split("<tbody>")[1], re.DOTALL):
        cells = re.findall(r"<t[hd][^>]*>(.*?)</t[hd]>", row, re.DOTALL)
        found.append([re.sub(r"<[^>]+>", " ", cell).strip() for cell in cells])
    return found


def test_a_lost_station_and_a_wrong_link_stand_first() -> None:
    page = page_of(is_wrong=True)
    assert '<section class="verdict review"' in page
    reasons = re.findall(r"<li>([^<]*)</li>", page.split('aria-label="Reasons"')[1].split("</ul>")[0])
    assert reasons[0] == "S04: no link to it was kept."
    assert "S01 – S07" in reasons[1].replace(BLANK, " ")
    assert "4.1 m where 30 mm are allowed" in reasons[1]
    assert rows_of(page, "Stations, the least certain first")[0][0].startswith("S04")
    assert rows_of(page, "Links left out")[0][0].replace(BLANK, " ") == "S01 – S07"
    assert rows_of(page, "Round trips")[0][-1] == "✗ no"
    assert "link left out" in page  # in the legend of the map


def test_a_sound_network_is_accepted_without_reasons() -> None:
    page = page_of()
    assert '<section class="verdict accepted"' in page
    assert 'aria-label="Reasons"' not in page
    assert "None: every pair that was registered is part of the network." in page
    assert "link left out" not in page


def test_tables_have_every_row_worst_first() -> None:
    network = made_network(12)
    page = page_of()
    links = rows_of(page, "Links kept, worst first")
    assert len(links) == len(network.links)
    times = [float(row[5].split()[0]) for row in links]
    assert times == sorted(times, reverse=True)
    stations = rows_of(page, "Stations, the least certain first")
    assert [row[0] for row in stations][-1].startswith("S01")  # which is held
    assert {row[0].split()[0] for row in stations} == {station.name for station in network.stations}
    # In the words and units of a surveyor, national-grid coordinates in full.
    uav = next(row for row in stations if row[0].startswith("UAV"))
    assert uav[1] == f"10{BLANK}mm"
    assert [text.replace("\u202f", " ") for text in uav[7:10]] == [
        "4 512 000.000",
        "5 402 500.000",
        "720.000",
    ]
    assert uav[10] == "1.004000"


def test_long_tables_are_cut_and_say_so() -> None:
    document = made_network(12).to_dict()
    document["links"] = document["links"] * 20
    page = network_page(document, None)
    assert len(rows_of(page, "Links kept, worst first")) == 200
    assert f"The 200 worst of {len(document['links'])} are shown; all are in links.csv." in page


def test_distances_of_the_fused_cloud_are_shown_where_there_are_any() -> None:
    figures = {"n_points": 9, "share_with_counterpart": 0.5, "median": 0.001, "percentile_95": 0.02}
    stations = [
        {"number": 1, "name": "S01", "rms": 0.004, **figures},
        {"number": 2, "name": "alone", **figures, "rms": None},
        {"number": 3, "name": "S03", "rms": 0.009, **figures},
    ]
    fused = {"n_points": 27, "n_tiles": 2, "n_repeated": 0, "reach": 0.3, "stations": stations}
    assert [row[0] for row in rows_of(page_of(fused=fused), "Distances of all points")] == [
        "S03",
        "S01",
        "alone",
    ]
    assert "The fused cloud" not in page_of()


def test_names_are_text_and_never_markup() -> None:
    document = json.loads(json_text(made_network(12).to_dict()).replace("S02", "<b>S&2 $^"))
    page = network_page({**document, "name": "<script>alert(1)</script>"}, None)
    assert "<script>alert(1)" not in page
    assert "<b>S&2" not in page
    assert "&lt;b&gt;S&amp;2 $^" in page


def test_the_page_loads_nothing_and_is_written_from_the_folder_alone(tmp_path: Path) -> None:
    document = {**made_network(12).to_dict(), "name": "Dam"}
    (tmp_path / "network.json").write_text(json_text(document), encoding="utf-8")
    written = write_network_report(tmp_path)
    assert written == tmp_path / "report.html"
    page = written.read_text(encoding="utf-8")
    assert "<title>Accepted: Dam</title>" in page
    assert not re.findall(r"""(?:src|href)=["'](?!#|data:)""", page)


@pytest.mark.parametrize("content", [None, "", "{", "[]", '{"verdict": "accepted"}'])
def test_what_is_no_network_is_refused(tmp_path: Path, content: str | None) -> None:
    if content is not None:
        (tmp_path / "network.json").write_text(content)
    with pytest.raises(ReadError, match=r"network\.json"):
        write_network_report(tmp_path)
