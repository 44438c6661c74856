"""Results as a notebook shows them: a figure, and a short page without pictures."""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING

import numpy as np

from tmchho.inputs import CloudLike, open_cloud
from tmchho.report import charts, maps, words
from tmchho.report.chart import new_figure, styled
from tmchho.report.colours import SOURCE, TARGET
from tmchho.report.points import points_of
from tmchho.report.template import require_extras

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from tmchho.evaluation import Evaluation
    from tmchho.results import Registration

_GROUNDS = {"accepted": "#17734a", "review": "#8a5a00", "rejected": "#b3261e"}


def plot_registration(
    registration: Registration, source: CloudLike | None = None, target: CloudLike | None = None
) -> Figure:
    """Return the figure of `tmchho.Registration.plot`."""
    require_extras()
    document = registration.to_dict()
    if source is None or target is None:
        chart = charts.convergence(document)
        figure = new_figure(7.6, 2.6) if chart is None else chart.figure
    else:
        clouds = open_cloud(source, "source"), open_cloud(target, "target")
        figure = maps.before_after(points_of(registration, *clouds, None), document, "").figure
    return _on_white(figure, f"{registration.verdict}: {registration.reasons[0]}")


def plot_evaluation(evaluation: Evaluation) -> Figure:
    """Return the figure of `tmchho.Evaluation.plot`."""
    require_extras()
    with styled():
        figure = new_figure(7.6, 2.8)
        panel = figure.subplots()
        directions = {"source to target": SOURCE, "target to source": TARGET}
        both = [evaluation.source_to_target, evaluation.target_to_source]
        known = [values[np.isfinite(values)] for values in both]
        high = 1.5 * max(float(np.percentile(np.abs(values), 95)) for values in known if len(values)) or 1.0
        low = -high if any((values < 0).any() for values in known) else 0.0
        for (name, colour), values in zip(directions.items(), known, strict=True):
            if len(values):
                charts.draw_steps(panel, values, (low, high), colour, f"{name}, {len(values):,} points")
        panel.set_xlim(low, high)
        panel.set_xlabel("distance")
        panel.set_ylabel("share of the points (%)")
        panel.legend()
    return _on_white(figure, "Distances between the clouds")


def registration_html(registration: Registration) -> str:
    """Return the verdict, the reasons and the key figures as HTML."""
    document = registration.to_dict()
    says, _ = words.VERDICTS[registration.verdict]
    reasons = "".join(f"<li>{escape(words.sentence(reason))}</li>" for reason in registration.reasons)
    figures = words.key_figures(document, "")
    return (
        f'<div style="border-left: 6px solid {_GROUNDS[registration.verdict]}; padding: .2em 1em">'
        f"<strong>{registration.verdict.upper()}.</strong> {says}<ul>{reasons}</ul>"
        f"{_table(figures)}</div>"
    )


def _table(rows: list[dict[str, str]]) -> str:
    lines = "".join(
        f'<tr><th style="text-align: left">{escape(row["name"])}</th><td>{escape(row["value"])}</td>'
        f'<td style="text-align: left">{escape(row["words"])}</td></tr>'
        for row in rows
    )
    return f"<table><tbody>{lines}</tbody></table>"


def _on_white(figure: Figure, title: str) -> Figure:
    figure.set_facecolor("white")
    figure.suptitle(title, fontsize=9.5, x=0.01, ha="left", wrap=True)
    return figure
