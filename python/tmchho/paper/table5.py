"""Table 5, ICP alone and after TMCHHO, and Figure 10, what that looks like."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from tmchho.paper.pictures import draw
from tmchho.paper.plan import Content, Run, Section
from tmchho.paper.printed import printed_number, printed_row
from tmchho.paper.registrations import SERIES
from tmchho.paper.scans import KINDS, MODELS, load_pair, moved
from tmchho.paper.statistics import summary
from tmchho.paper.table4 import (
    FINE_DEG,
    FINE_SHARE,
    KIND_NAMES,
    chosen,
    how,
    is_right,
    model_name,
    why_both_kinds,
)
from tmchho.paper.tables import Column, Table
from tmchho.paper.words import listing

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# The method, and its column in the printed table.
_PRINTED = {"icp": "icp", "tmchho": "tmchho_icp", "hho": None, "robust": None}
_NAMES = {"icp": "ICP alone", "tmchho": "TMCHHO + ICP", "hho": "HHO + ICP", "robust": "robust mode"}
_MOST_DOTS = 4000


def rows(runs: list[Run]) -> list[dict[str, Any]]:
    """Return the rows of Table 5 for both kinds of clouds."""
    table: list[dict[str, Any]] = []
    for kind in KINDS:
        for model in MODELS:
            for method, column in _PRINTED.items():
                here = chosen(runs, kind=kind, model=model, method=method)
                is_real = here[0].job["clouds"] == "stanford"
                printed = printed_row(5, model=model) if is_real and column else {}
                ours = summary([run.result["fine_rms"] for run in here])
                table.append(
                    {
                        "kind": KIND_NAMES[kind],
                        "model": model_name(here[0]),
                        "method": _NAMES[method],
                        "printed": printed_number(printed, column) if column else None,
                        **ours,
                        "right": sum(is_right(run)[1] for run in here),
                        "runs": len(here),
                    }
                )
    return table


def _show_table(runs: list[Run]) -> Content:
    columns = [
        Column("kind", "clouds"),
        Column("model", "object"),
        Column("method", "method"),
        Column("printed", "printed", ".2e", is_printed=True),
        Column("ave", "Ave, here", ".2e"),
        Column("best", "Best, here", ".2e"),
        Column("worst", "Worst, here", ".2e"),
        Column("right", "right"),
        Column("runs", "runs"),
    ]
    table = rows(runs)
    right = []
    for kind in KINDS:
        counts = []
        for name in _NAMES.values():
            of_method = [row for row in table if row["kind"] == KIND_NAMES[kind] and row["method"] == name]
            counts.append(
                f"{name} {sum(row['right'] for row in of_method)} of {sum(row['runs'] for row in of_method)}"
            )
        right.append(f"With {KIND_NAMES[kind]}, right in the end: {listing(counts)}.")
    lower = [
        f"{row['model']} ({row['kind']})"
        for row, alone in _beside_icp(table)
        if row["method"] == _NAMES["tmchho"] and row["ave"] < alone["ave"]
    ]
    return Content(
        how=(
            *how(runs),
            "ICP as in Eq. (8): all pairs of voxel centroids, until the mean squared distance changes by "
            "less than 1e-6 of itself, or 50 iterations. ICP alone starts from the same random pose as "
            f"the searches. Right: within {FINE_DEG:g}° and {100 * FINE_SHARE:g} % of the diagonal of the "
            "known pose.",
        ),
        tables=(
            Table(
                "table5",
                "RMS from the source's voxel centroids to the target's in the end, in metres.",
                columns,
                table,
                n_group_columns=2,
            ),
        ),
        findings=(
            *right,
            f"TMCHHO + ICP has a lower average RMS than ICP alone on {len(lower)} of {2 * len(MODELS)}"
            f"{': ' + listing(lower) if lower else ''}.",
        ),
        differences=(
            *why_both_kinds(),
            "The paper prints one value each without saying over which runs, and not from where ICP "
            "alone starts. It does not say whether a pose is right.",
        ),
    )


def _beside_icp(table: list[dict[str, Any]]) -> list[tuple[dict[str, Any], dict[str, Any]]]:
    alone = {(row["kind"], row["model"]): row for row in table if row["method"] == _NAMES["icp"]}
    return [(row, alone[row["kind"], row["model"]]) for row in table]


def _show_figure(runs: list[Run]) -> Content:
    methods = ("icp", "tmchho", "robust")
    panels_of = [(model, method) for model in MODELS for method in methods]
    first = {
        (model, method): chosen(runs, kind="pair", model=model, method=method)[0]
        for model, method in panels_of
    }

    def paint(_figure: Figure, panels: list[Axes]) -> None:
        for panel, place in zip(panels, panels_of, strict=True):
            run = first[place]
            pair = load_pair(run.job["clouds"], run.job["model"], run.job["kind"])
            source = moved(np.array(run.result["pose"]), pair.source.voxels)
            for cloud, colour in ((pair.target.voxels, "#0072b2"), (source, "#d55e00")):
                dots = cloud[:: max(1, len(cloud) // _MOST_DOTS)]
                panel.plot(dots[:, 0], dots[:, 1], ".", color=colour, markersize=1, alpha=0.5)
            word = "right" if is_right(run)[1] else "wrong"
            panel.set_title(f"{model_name(run)}, {_NAMES[place[1]]}: {word}", fontsize=9)
            panel.set_aspect("equal")
            panel.locator_params(axis="x", nbins=3)
            panel.locator_params(axis="y", nbins=5)
            panel.tick_params(labelsize=6)

    right = [f"{_NAMES[m]} {sum(is_right(first[o, m])[1] for o in MODELS)} of {len(MODELS)}" for m in methods]
    seed = next(iter(first.values())).job["seed"]
    return Content(
        how=(*how(runs), f"Shown is the run with seed {seed}, on two scans."),
        pictures=(
            draw(
                "figure10",
                "Target (blue) and source (orange) in the end, seen along z; axes in metres.",
                (len(MODELS), len(methods)),
                paint,
            ),
        ),
        findings=(f"Right in the pictures: {listing(right)}.",),
        differences=(
            (
                "The paper shows ICP alone; beside it stand the search with ICP and robust mode, from the "
                "same start."
            ),
        ),
    )


TABLE5 = Section("table5", "Table 5: ICP alone and after TMCHHO", SERIES, _show_table)
FIGURE10 = Section("figure10", "Figure 10: what ICP makes of it", SERIES, _show_figure)
