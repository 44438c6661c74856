"""The report as one page: made from what a registration left in its folder, and from nothing else."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from tmchho.report import charts, maps, words
from tmchho.report.change import StoredChange
from tmchho.report.chart import Chart
from tmchho.report.points import ReportPoints
from tmchho.report.rounding import nice_ceiling
from tmchho.report.scene import Field, angle_and_axis, report_scene
from tmchho.report.template import render
from tmchho.report.words import BLANK

_CONTENTS = {
    "verdict": "Verdict",
    "checks": "Checks",
    "pictures": "Before and after",
    "view": "3D view",
    "distances": "Distances",
    "areas": "Areas",
    "fusion": "Fused cloud",
    "transform": "Transform",
    "inputs": "Inputs",
    "search": "Search",
    "again": "Settings",
    "terms": "Terms",
}
_NO_POINTS = "Not available: the points that a report shows were not stored with these results."


def make_page(
    document: Mapping[str, Any],
    points: ReportPoints | None,
    date: str | None,
    change: StoredChange | None = None,
) -> tuple[str, list[Chart]]:
    """Return the page, and the charts in it.

    Parameters
    ----------
    document : mapping
        The content of ``result.json``.
    points : ReportPoints, optional
        What the pictures and the 3D view show; without it there are none.
    date : str, optional
        Day of the results.
    change : StoredChange, optional
        M3C2 distances at this pose.

    Returns
    -------
    str
        HTML.
    list of Chart
        In the order of the page.
    """
    unit, unit_note = _unit(document)
    radius = hole_radius(document)
    fields = {} if points is None else _fields(points, unit)
    made = _charts(document, points, fields, unit, radius)
    if change is not None:
        made["significant_map"] = _change_map(change, document, unit)
    shown = {name: chart and {**vars(chart), "svg": _markup(chart.svg())} for name, chart in made.items()}
    table_unit, table_factor = _table_unit(document, unit)
    distances = document.get("distances") or {}
    matrix = np.array(document["transformation"])
    turn_rad, _ = angle_and_axis(np.array(matrix[:3, :3]) / document["scale"])
    page = render(
        "report.html.jinja",
        has_viewer=points is not None,
        document={"truth": None, "fused": None, **document},
        date=date,
        unit=unit,
        unit_note=unit_note,
        inputs=document["inputs"],
        contents=[
            (name, title) for name, title in _CONTENTS.items() if name != "pictures" or points is not None
        ],
        verdict=words.VERDICTS[document["verdict"]],
        warnings=[words.sentence(text) for text in distances.get("warnings", [])],
        reasons=[words.sentence(text) for text in document["reasons"]],
        figures=words.key_figures(document, unit),
        charts=shown,
        evidence=words.evidence(document, unit),
        scene=None if points is None else report_scene(points, document, unit, fields, change),
        change=change,
        n_shown=0 if points is None else len(points.steps),
        no_points=_NO_POINTS,
        legend_note=_legend_note(points, radius, unit),
        statistics=_statistics(document, unit),
        table_unit=table_unit,
        table_factor=table_factor,
        tolerance=distances.get("tolerance"),
        spacing=distances.get("spacing"),
        areas=document.get("areas") or [],
        areas_are_automatic=distances.get("areas") != "given",
        matrix=_rows(matrix),
        pivot_form=_pivot_form(document),
        turn_deg=math.degrees(turn_rad),
        input_rows=_input_rows(document, unit),
        stages=words.stage_rows(document),
        dropped=sum(document["n_non_finite"]),
        settings=list(settings_lines(document["config"])),
    )
    return page, [chart for chart in made.values() if chart is not None]


def hole_radius(document: Mapping[str, Any]) -> float | None:
    """Return the distance beyond which a point has no counterpart, None where the clouds were not fused."""
    fused = document.get("fused")
    return None if fused is None else float(fused["hole_radius"])


def settings_lines(config: Mapping[str, Any], above: str = "") -> list[str]:
    """Return settings as lines, each with the full name of its key.

    Examples
    --------
    >>> settings_lines({"seed": 0, "voxel": {"voxel_size_m": 0.5}})
    ['seed = 0', 'voxel.voxel_size_m = 0.5']
    """
    lines = []
    for key, value in config.items():
        if isinstance(value, Mapping):
            lines += settings_lines(value, f"{above}{key}.")
        else:
            lines.append(f"{above}{key} = {value}")
    return lines


def _fields(points: ReportPoints, unit: str) -> dict[str, Field]:
    """Return the values that points are coloured by, under the names of their buttons."""
    has_counterpart = np.isfinite(points.distance) & ~points.fills_hole
    if not has_counterpart.any():
        return {}
    values = np.where(has_counterpart, points.distance, np.nan)
    high = nice_ceiling(float(np.percentile(points.distance[has_counterpart], 95)))
    label = "distance to the nearest point of the other cloud"
    return {"Distance": Field(label, unit, values, 0.0, high)}


def _charts(
    document: Mapping[str, Any],
    points: ReportPoints | None,
    fields: Mapping[str, Field],
    unit: str,
    radius: float | None,
) -> dict[str, Chart | None]:
    made: dict[str, Chart | None] = dict.fromkeys(
        (
            "before_after",
            "cut",
            "distance_map",
            "distance_histogram",
            "significant_map",
            "area_histograms",
            "holes",
        )
    )
    if points is not None:
        made["before_after"] = maps.before_after(points, document, unit)
        made["cut"] = maps.cut_chart(points, unit)
        distance = fields.get("Distance")
        if distance is not None:
            areas = document.get("areas") or []
            caption = (
                "Each place in the colour of the mean distance there to the nearest point of the other "
                "cloud, both clouds together. Grey: no counterpart."
            )
            if areas:
                caption += " Outlined: the areas."
            made["distance_map"] = maps.value_map(
                points.xyz, "distance_map", "Map of the distances", distance, areas, caption
            )
            made["distance_histogram"] = charts.distance_histogram(points, distance.high, unit)
            of_source = np.where(points.is_source, distance.values, np.nan)
            made["area_histograms"] = charts.area_histograms(
                points, of_source, "distance, source to target,", areas, unit
            )
        if radius is not None:
            made["holes"] = maps.holes_map(points, radius, unit)
    made["convergence"] = charts.convergence(document)
    made["candidates"] = charts.candidates(document)
    return made


def _change_map(change: StoredChange, document: Mapping[str, Any], unit: str) -> Chart | None:
    caption = (
        "Change from the target to the source along the normal of the surface, averaged in cylinders (M3C2). "
        "In colour: where it is more than the level of detection, which is what noise and the errors of the "
        "position explain at 95 %. Grey: no significant change."
    )
    areas = document.get("areas") or []
    field = change.field(unit)
    return maps.value_map(change.xyz, "change_map", "Significant change", field, areas, caption, True)


def _table_unit(document: Mapping[str, Any], unit: str) -> tuple[str, float]:
    """Return in what the tables of distances are, and by what lengths are multiplied for it."""
    typical = document[words.better_direction(document)]["median"]
    return ("mm", 1000.0) if unit == f"{BLANK}m" and typical < 0.1 else (unit.strip(), 1.0)


def _statistics(document: Mapping[str, Any], unit: str) -> list[dict[str, Any]]:
    """Return the rows of the table of distances: with a counterpart, where that was measured, and all."""
    distances = document.get("distances") or {}
    rows = []
    for direction in ("source_to_target", "target_to_source"):
        name = direction.replace("_", " ").capitalize()
        if direction in distances:
            radius = words.length(distances["max_distance"], unit)
            rows.append({"words": f"{name}, counterpart within {radius}", **distances[direction]})
        rows.append({"words": f"{name}, all points", **document[direction]})
    return rows


def _legend_note(points: ReportPoints | None, radius: float | None, unit: str) -> str | None:
    if points is None or radius is None:
        return None
    return (
        f"A point has no counterpart where the other cloud has no point within {words.length(radius, unit)}: "
        "there it cannot be compared, which says nothing about the position."
    )


def _unit(document: Mapping[str, Any]) -> tuple[str, str]:
    """Return the sign of the unit of lengths with its blank, and where it comes from."""
    stated = document["inputs"]["target"].get("unit")
    if stated is not None:
        return (
            f"{BLANK}{stated}",
            f"Lengths are in {stated}, the unit of the target's coordinate reference system.",
        )
    return f"{BLANK}m", (
        "The target does not state its unit. Lengths are shown as metres, which is what scanners and most "
        "programs write; where the clouds are in another unit, read that instead."
    )


def _input_rows(document: Mapping[str, Any], unit: str) -> list[dict[str, Any]]:
    sides = [document["inputs"][side] for side in ("source", "target")]

    def row(title: str, *cells: str) -> dict[str, Any]:
        return {"words": title, "cells": cells}

    unknown = "not stated"
    return [
        row("File", *(side["name"] for side in sides)),
        row("Sensor or program", *(side.get("sensor") or unknown for side in sides)),
        row("Points", *(words.count(side["n_points"]) for side in sides)),
        row("Spacing of the points", *(words.length(side.get("spacing"), unit) for side in sides)),
        row("Size", *(_size(side, unit) for side in sides)),
        row("Lowest corner", *(_place(side.get("lowest")) for side in sides)),
        row("Coordinate reference system", *(side.get("crs") or unknown for side in sides)),
        row("Format", *((side.get("format") or unknown).upper() for side in sides)),
        row("Attributes", *(", ".join(side.get("attributes", [])) or "none" for side in sides)),
        row("SHA-256", *(side["sha256"] for side in sides)),
    ]


def _size(side: Mapping[str, Any], unit: str) -> str:
    if side.get("lowest") is None:
        return words.NOT_MEASURED
    lengths = (high - low for low, high in zip(side["lowest"], side["highest"], strict=True))
    return " × ".join(words.number(length, 4) for length in lengths) + unit


def _place(corner: list[float] | None) -> str:
    return (
        words.NOT_MEASURED
        if corner is None
        else ", ".join(f"{x:,.3f}".replace(",", "\u202f") for x in corner)
    )


def _rows(matrix: Any) -> str:
    return "\n".join(" ".join(format(float(value) + 0.0, ".17g") for value in row) for row in matrix)


def _pivot_form(document: Mapping[str, Any]) -> str:
    return "\n".join(
        [
            "subtract  " + _rows([document["source_pivot"]]),
            "multiply  " + _rows(document["pivot_transformation"]).replace("\n", "\n          "),
            "add       " + _rows([document["target_pivot"]]),
        ]
    )


def _markup(text: str) -> Any:
    from markupsafe import Markup

    return Markup(text)
