"""Figure 6: convergence on four of the functions."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from tmchho.paper import table3
from tmchho.paper.methods import PAPER_METHODS, title
from tmchho.paper.pictures import COLOURS, draw
from tmchho.paper.plan import Content, Run, Section
from tmchho.paper.searches import ITERATIONS
from tmchho.paper.tables import Column, Table
from tmchho.paper.words import how_searched, listing

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FUNCTIONS = ("f1", "f2", "f5", "f6")


def show(runs: list[Run]) -> Content:
    """Make the section of Figure 6."""
    curves = {
        cell: np.median([run.result["history"] for run in of_cell], axis=0)
        for cell, of_cell in table3.by_cell(runs).items()
        if cell[0] in FUNCTIONS
    }
    dimensions = sorted({dimension for _, dimension, _ in curves})

    def paint(_figure: Figure, panels: list[Axes]) -> None:
        places = [(dimension, function) for dimension in dimensions for function in FUNCTIONS]
        for panel, (dimension, function) in zip(panels, places, strict=True):
            for method in PAPER_METHODS:
                curve = curves[function, dimension, method]
                # A logarithm has no 0: the curve ends where the median is exactly 0.
                panel.semilogy(
                    np.where(curve > 0, curve, np.nan), color=COLOURS[method], label=title(method), lw=1.4
                )
            panel.set_title(f"{function}, D = {dimension}", fontsize=9)
            panel.tick_params(labelsize=7)
            panel.set_xlabel("iteration", fontsize=8)
        panels[0].legend(fontsize=7)

    rows: list[dict[str, Any]] = [
        {
            "function": function,
            "dimension": dimension,
            "algorithm": title(method),
            "iteration": n,
            "median": float(v),
        }
        for (function, dimension, method), curve in curves.items()
        for n, v in enumerate(curve, start=1)
    ]
    names = ("function", "dimension", "algorithm", "iteration", "median")
    return Content(
        how=(how_searched(runs, ITERATIONS),),
        pictures=(
            draw(
                "figure6",
                "Lowest value so far, median over the runs; a curve ends where it is exactly 0.",
                (len(dimensions), len(FUNCTIONS)),
                paint,
            ),
        ),
        tables=(
            Table("figure6", "The curves.", [Column(name, name) for name in names], rows, on_page=False),
        ),
        findings=(_first_to_arrive(curves),),
        differences=("The paper shows one dimension without saying which; both are shown.",),
    )


def _first_to_arrive(curves: dict[table3.Cell, Any]) -> str:
    won: dict[str, list[str]] = {}
    for function, dimension in dict.fromkeys((function, dimension) for function, dimension, _ in curves):
        ends = {method: float(curves[function, dimension, method][-1]) for method in PAPER_METHODS}
        lowest = [title(method) for method, value in ends.items() if value == min(ends.values())]
        won.setdefault(" with ".join(lowest), []).append(f"{function} (D = {dimension})")
    return "Lowest at the end: " + "; ".join(f"{who} on {listing(what)}" for who, what in won.items()) + "."


SECTION = Section("figure6", "Figure 6: convergence on four functions", table3.SERIES, show)
