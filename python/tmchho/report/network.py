"""The report of a network as one page: made from what it left in its folder, and from nothing else."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tmchho.io import check_output
from tmchho.outputs import REPORT, write_together
from tmchho.report import words
from tmchho.report.network_map import network_map, place_of, sigma_chart
from tmchho.report.page import settings_lines
from tmchho.report.stored import day_of, read_document
from tmchho.report.template import render, require_extras
from tmchho.report.words import BLANK

NETWORK = "network.json"

_UNIT = f"{BLANK}m"
_DASH = f"{BLANK}–{BLANK}"
_MOST_ROWS = 200  # of a table on the page; the files have all
_VERDICTS = {
    "accepted": (
        "The network can be used.",
        "Every station is placed, and held by links that confirm each other.",
    ),
    "review": (
        "A person must look at the stations named here before they are used.",
        "All others are placed, and held by links that confirm each other.",
    ),
    "rejected": (
        "Fewer than half of the stations could be placed.",
        "Most clouds share too little with each other to be one network.",
    ),
}
_PAIR_VERDICTS = {"accepted": "accepted", "review": "to be looked at", "rejected": "rejected"}


def write_network_report(folder: str | os.PathLike[str], *, overwrite: bool = True) -> Path:
    """Make ``report.html`` of a network from its ``network.json``; nothing is computed again.

    Parameters
    ----------
    folder : str or path
        As ``tmchho network`` leaves it.
    overwrite : bool, default True
        Replace an earlier report.

    Returns
    -------
    Path
        The page, which loads nothing from anywhere.

    Raises
    ------
    InvalidArgumentError
        If jinja2 or matplotlib is missing: they come with ``pip install 'tmchho[report]'``.
    ReadError
        If ``network.json`` is missing, or is not that of a network.
    WriteError
        If the page cannot be written.
    """
    require_extras()
    folder = Path(folder)
    document = read_network(folder)
    check_output(folder / REPORT, overwrite)
    page = network_page(document, day_of(folder / NETWORK))
    files: dict[str, Callable[[Path], object]] = {
        REPORT: lambda path: path.write_text(page, encoding="utf-8", newline="\n")
    }
    write_together(folder, files, overwrite=overwrite)
    return folder / REPORT


def read_network(folder: Path) -> Mapping[str, Any]:
    """Return the content of the ``network.json`` of a network.

    Raises
    ------
    ReadError
        If it is missing, damaged or of something else.
    """
    return read_document(
        folder / NETWORK,
        needed=("verdict", "stations", "links", "loops"),
        what="network",
        command="tmchho network",
    )


def network_page(document: Mapping[str, Any], date: str | None) -> str:
    """Return the page.

    Parameters
    ----------
    document : mapping
        The content of ``network.json``.
    date : str, optional
        Day of the results.
    """
    from markupsafe import Markup

    charts = {"map": network_map(document), "sigma": sigma_chart(document)}
    shown = {name: chart and {**vars(chart), "svg": Markup(chart.svg())} for name, chart in charts.items()}
    kept = [link for link in document["links"] if link["kept"]]
    left_out = [link for link in document["links"] if not link["kept"]]
    return render(
        "network.html.jinja",
        has_viewer=False,
        document={"name": "Network", "fused": None, "command": None, "versions": {}, **document},
        date=date,
        unit=_UNIT,
        verdict=_VERDICTS[document["verdict"]],
        reasons=_reasons(document, left_out),
        figures=_key_figures(document, kept),
        charts=shown,
        links=_table([_link_row(link) for link in sorted(kept, key=_badness_of_link)]),
        left_out=_table([_left_out_row(link) for link in sorted(left_out, key=_danger_of_left_out)]),
        stations=_table(
            [_station_row(station) for station in sorted(document["stations"], key=_badness_of_station)]
        ),
        loops=_table([_loop_row(loop) for loop in sorted(document["loops"], key=_badness_of_loop)]),
        fused_stations=_table(sorted((document.get("fused") or {}).get("stations", []), key=_badness_by_rms)),
        overlaps=_table(
            [
                {"name": _DASH.join((overlap["first"], overlap["second"])), **overlap}
                for overlap in sorted(document.get("overlaps", []), key=_badness_by_rms)
            ]
        ),
        settings=settings_lines(document.get("settings", {})),
    )


def _table(rows: list[Any]) -> dict[str, Any]:
    """Return the rows of a table that are shown, and how many there are."""
    return {"rows": rows[:_MOST_ROWS], "n_shown": min(len(rows), _MOST_ROWS), "n_all": len(rows)}


def _reasons(document: Mapping[str, Any], left_out: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return what a person must know first, the weightiest first."""
    found = [
        f"{station['name']}: {station['note'] or 'not placed'}"
        for station in document["stations"]
        if station["note"] or station["world_from_station"] is None
    ]
    found += [
        f"Link {name_of(link)} fitted for itself, but was left out: {link['left_out_because']}"
        for link in left_out
        if link["verdict"] == "accepted"
    ]
    return [words.sentence(text) for text in found[:12]] + (
        [f"And {len(found) - 12} more, in the tables below."] if len(found) > 12 else []
    )


def _key_figures(document: Mapping[str, Any], kept: Sequence[Mapping[str, Any]]) -> list[dict[str, str]]:
    stations, links, loops = document["stations"], document["links"], document["loops"]
    placed = [station for station in stations if station["world_from_station"] is not None]
    sigmas = sorted(
        (s["sigma_point_m"], s["name"]) for s in placed if s["sigma_point_m"] is not None and not s["fixed"]
    )
    rms = [link["rms"] for link in kept if link["rms"] is not None]
    n_closed = sum(loop["closed"] for loop in loops)
    error = document.get("unit_weight_error")
    accuracy = {
        "name": "Accuracy of the stations",
        "value": words.length(sigmas[len(sigmas) // 2][0], _UNIT, 2) if sigmas else words.NOT_MEASURED,
        "words": "No station has a standard error.",
    }
    if sigmas:
        accuracy["words"] = (
            "By so much a point of the middle one of the stations may typically be displaced (1σ); of the "
            f"worst, {sigmas[-1][1]}, by {words.length(sigmas[-1][0], _UNIT, 2)}. Errors that all share, "
            "such as a wrong control point, do not show in it."
        )
    return [
        {
            "name": "Stations placed",
            "value": f"{len(placed)} of {len(stations)}",
            "words": f"The frame comes from {document['gauge']}.",
        },
        accuracy,
        {
            "name": "Links kept",
            "value": f"{len(kept)} of {len(links)}",
            "words": (
                f"that were registered, {words.number(2 * len(kept) / max(len(placed), 1), 2)} at each "
                "station on average. "
                + (
                    f"Surfaces fit to {words.length(float(np.median(rms)), _UNIT, 2)} (median RMS)."
                    if rms
                    else ""
                )
            ),
        },
        {
            "name": "Loops that close",
            "value": f"{n_closed} of {len(loops)}" if loops else "none",
            "words": "Round trips over links that end where they began. "
            + (
                ""
                if error is None
                else f"The links scatter {words.number(error, 2)} times as much as expected."
            ),
        },
    ]


def name_of(link: Mapping[str, Any]) -> str:
    """Return how a link is called."""
    return _DASH.join((link["source"], link["target"]))


def _link_row(link: Mapping[str, Any]) -> dict[str, Any]:
    weight = link["normalised_residual"]
    return {
        "name": name_of(link),
        "overlap": _larger(link["overlap_of_source"], link["overlap_of_target"]),
        "rms": link["rms"],
        "strength": None if link["strength"] is None else 6 * link["strength"],
        "residual": link["residual_m"],
        "times": "not measured" if weight is None else f"{words.number(weight, 2)} times",
        "is_large": weight is not None and weight > 3,
        "loops": _loops_of(link),
        "has_open": link["n_open_loops"] > 0,
        "verdict": _PAIR_VERDICTS[link["verdict"]],
    }


def _left_out_row(link: Mapping[str, Any]) -> dict[str, Any]:
    return {
        "name": name_of(link),
        "because": words.sentence(link["left_out_because"] or "no reason was kept"),
        "overlap": _larger(link["overlap_of_source"], link["overlap_of_target"]),
        "loops": _loops_of(link),
        "verdict": _PAIR_VERDICTS[link["verdict"]],
    }


def _station_row(station: Mapping[str, Any]) -> dict[str, Any]:
    place = place_of(station)
    position, turn = station["sigma_position_m"], station["sigma_rotation_rad"]
    return {
        "name": station["name"],
        "kind": "block" if station["kind"] == "block" else "station",
        "is_fixed": station["fixed"],
        "place": None if place is None else [f"{value:,.3f}".replace(",", "\u202f") for value in place],
        "sigma_point": station["sigma_point_m"],
        "sigma": None if position is None else [words.length(value, _UNIT, 2) for value in position],
        "turn": None if turn is None else f"{words.number(math.degrees(max(turn)), 2)}°",
        "scale": None if station["scale"] == 1.0 else f"{station['scale']:.6f}",
        "n_links": station["n_links"],
        "note": words.sentence(station["note"]) if station["note"] else "",
    }


def _loop_row(loop: Mapping[str, Any]) -> dict[str, Any]:
    names = [*loop["stations"], loop["stations"][0]]
    return {
        "name": _DASH.join(names),
        "misclosure": loop["misclosure_m"],
        "turn": f"{words.number(math.degrees(loop['misclosure_rad']), 2)}°",
        "tolerance": loop["tolerance_m"],
        "closed": loop["closed"],
    }


def _loops_of(link: Mapping[str, Any]) -> str:
    if not link["n_loops"]:
        return "in none"
    n_closed = link["n_loops"] - link["n_open_loops"]
    return f"{n_closed} of {link['n_loops']}"


def _larger(one: float | None, other: float | None) -> float | None:
    found = [value for value in (one, other) if value is not None]
    return max(found, default=None)


def _badness_of_link(link: Mapping[str, Any]) -> tuple[float, ...]:
    return (-link["n_open_loops"], -(link["normalised_residual"] or 0.0), link["n_loops"])


def _danger_of_left_out(link: Mapping[str, Any]) -> tuple[int, float]:
    # One that fitted for itself is the one that would have done harm.
    order = ("accepted", "review", "rejected")
    return (
        order.index(link["verdict"]),
        -(_larger(link["overlap_of_source"], link["overlap_of_target"]) or 0.0),
    )


def _badness_of_station(station: Mapping[str, Any]) -> tuple[bool, bool, float]:
    return (
        station["world_from_station"] is not None,
        not station["note"],
        -(station["sigma_point_m"] or 0.0),
    )


def _badness_of_loop(loop: Mapping[str, Any]) -> float:
    return -float(loop["misclosure_m"] / (loop["tolerance_m"] or 1e-300))


def _badness_by_rms(row: Mapping[str, Any]) -> float:
    return -float(row["rms"] or 0.0)
