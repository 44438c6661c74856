"""How often each method finds the known pose: what the paper does not tell."""

from __future__ import annotations

from typing import Any

import numpy as np

from tmchho.paper.methods import title
from tmchho.paper.plan import Content, Run, Section
from tmchho.paper.registrations import SERIES
from tmchho.paper.scans import KINDS, MODELS
from tmchho.paper.statistics import summary
from tmchho.paper.table4 import (
    COARSE_DEG,
    COARSE_SHARE,
    FINE_DEG,
    FINE_SHARE,
    KIND_NAMES,
    chosen,
    how,
    is_right,
    model_name,
)
from tmchho.paper.tables import Column, Table
from tmchho.paper.words import listing


def rows(runs: list[Run]) -> list[dict[str, Any]]:
    """Return how often each method was right, with all objects together and apart."""
    table: list[dict[str, Any]] = []
    for kind in KINDS:
        for method in dict.fromkeys(run.job["method"] for run in runs):
            of_method = chosen(runs, kind=kind, method=method)
            row: dict[str, Any] = {"kind": KIND_NAMES[kind], "method": title(method), "runs": len(of_method)}
            row["right_coarse"] = (
                None if method in ("icp", "robust") else sum(is_right(r)[0] for r in of_method)
            )
            row["right"] = sum(is_right(run)[1] for run in of_method)
            row["low"], row["high"] = wilson(row["right"], row["runs"])
            for model in MODELS:
                row[model] = sum(is_right(run)[1] for run in chosen(of_method, model=model))
            row["evaluations"] = summary([run.result["n_evaluations"] for run in of_method])["ave"]
            table.append(row)
    return table


def wilson(n_right: int, n: int) -> tuple[float, float]:
    """Return the ends of the 95 % interval of a share, after Wilson (1927).

    Examples
    --------
    >>> low, high = wilson(0, 10)
    >>> low, round(high, 3)
    (0.0, 0.278)
    """
    z_sq = 1.959963984540054**2
    middle = (n_right + z_sq / 2) / (n + z_sq)
    half = np.sqrt(z_sq * (n_right * (n - n_right) / n + z_sq / 4)) / (n + z_sq)
    return max(0.0, float(middle - half)), min(1.0, float(middle + half))


def show(runs: list[Run]) -> Content:
    """Make the section of success rates."""
    table = rows(runs)
    names = {model: model_name(chosen(runs, model=model)[0]) for model in MODELS}
    columns = [
        Column("kind", "clouds"),
        Column("method", "method"),
        Column("right_coarse", "right after the search"),
        Column("right", "right in the end"),
        Column("runs", "of"),
        Column("low", "95 % interval from", ".0%"),
        Column("high", "to", ".0%"),
        *(Column(model, name) for model, name in names.items()),
        Column("evaluations", "evaluations a run", ",.0f"),
    ]
    findings = []
    for kind in KINDS:
        of_kind = [row for row in table if row["kind"] == KIND_NAMES[kind]]
        order = sorted(of_kind, key=lambda row: -row["right"])
        findings.append(
            f"With {KIND_NAMES[kind]}: "
            + listing([f"{row['method']} {100 * row['right'] / row['runs']:.0f} %" for row in order])
            + "."
        )
        by_name = {row["method"]: row for row in of_kind}
        one, other = by_name[title("tmchho")], by_name[title("hho")]
        apart = one["low"] > other["high"] or other["low"] > one["high"]
        findings.append(
            f"The intervals of TMCHHO and HHO {'do not overlap' if apart else 'overlap'} "
            f"({one['right']} and {other['right']} of {one['runs']})."
        )
    return Content(
        how=(
            *how(runs),
            f"Right after the search: within {COARSE_DEG:g}° and {100 * COARSE_SHARE:g} % of the diagonal "
            f"of the known pose; in the end: within {FINE_DEG:g}° and {100 * FINE_SHARE:g} %. The "
            "searches are followed by the paper's ICP, which drifts where clouds overlap in part only; "
            "robust mode has its own. The interval is Wilson's.",
        ),
        tables=(Table("success", "How often the pose was right.", columns, table),),
        findings=tuple(findings),
        differences=("The paper prints residuals and never says how often a pose was right.",),
    )


SECTION = Section("success", "Success rate against the known pose", SERIES, show)
