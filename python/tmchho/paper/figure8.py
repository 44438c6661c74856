"""Figure 8, curves of the RMS, and Figure 9, box plots of what they end at."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from tmchho.paper.methods import PAPER_METHODS, title
from tmchho.paper.pictures import COLOURS, draw
from tmchho.paper.plan import Content, Run, Section
from tmchho.paper.registrations import SERIES
from tmchho.paper.scans import KINDS, MODELS
from tmchho.paper.statistics import summary
from tmchho.paper.table4 import KIND_NAMES, chosen, how, model_name, why_both_kinds
from tmchho.paper.tables import Column, Table
from tmchho.paper.words import listing

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_PANELS = [(kind, model) for kind in KINDS for model in MODELS]
_SHORT = {"copy": "copy", "pair": "two scans"}


def _show_curves(runs: list[Run]) -> Content:
    curves = {
        (kind, model, method): np.mean(
            [run.result["history"] for run in chosen(runs, kind=kind, model=model, method=method)], axis=0
        )
        for kind, model in _PANELS
        for method in PAPER_METHODS
    }

    def paint(_figure: Figure, panels: list[Axes]) -> None:
        for panel, (kind, model) in zip(panels, _PANELS, strict=True):
            for method in PAPER_METHODS:
                panel.plot(curves[kind, model, method], color=COLOURS[method], label=title(method), lw=1.4)
            panel.set_title(f"{model_name(chosen(runs, model=model)[0])}, {_SHORT[kind]}", fontsize=9)
            panel.set_xlabel("iteration", fontsize=8)
            panel.set_ylim(bottom=0)
            panel.tick_params(labelsize=7)
            panel.locator_params(nbins=6)
        panels[0].legend(fontsize=7)

    rows: list[dict[str, Any]] = [
        {"kind": kind, "model": model, "algorithm": title(method), "iteration": number, "rms": float(value)}
        for (kind, model, method), curve in curves.items()
        for number, value in enumerate(curve, start=1)
    ]
    names = ("kind", "model", "algorithm", "iteration", "rms")
    late = []
    for kind, model in _PANELS:
        ends = {method: float(curves[kind, model, method][-1]) for method in PAPER_METHODS}
        lowest = min(ends, key=ends.__getitem__)
        late.append(f"{title(lowest)} on {model_name(chosen(runs, model=model)[0])} ({_SHORT[kind]})")
    return Content(
        how=how(runs),
        pictures=(
            draw(
                "figure8", "RMS of Eq. (1), in metres, mean over the runs.", (len(KINDS), len(MODELS)), paint
            ),
        ),
        tables=(Table("figure8", "The curves.", [Column(n, n) for n in names], rows, on_page=False),),
        findings=(f"Lowest at the end: {listing(late)}.",),
        differences=why_both_kinds(),
    )


def _show_boxes(runs: list[Run]) -> Content:
    def values(kind: str, model: str) -> list[list[float]]:
        of_cell = [chosen(runs, kind=kind, model=model, method=method) for method in PAPER_METHODS]
        return [[run.result["rms"] for run in runs_of_method] for runs_of_method in of_cell]

    def paint(_figure: Figure, panels: list[Axes]) -> None:
        for panel, (kind, model) in zip(panels, _PANELS, strict=True):
            of_methods = values(kind, model)
            panel.boxplot(of_methods, showfliers=False)
            for place, (method, of_method) in enumerate(zip(PAPER_METHODS, of_methods, strict=True), start=1):
                panel.plot([place] * len(of_method), of_method, ".", color=COLOURS[method], markersize=4)
            panel.set_xticks(range(1, len(PAPER_METHODS) + 1), [title(m) for m in PAPER_METHODS])
            panel.set_title(f"{model_name(chosen(runs, model=model)[0])}, {_SHORT[kind]}", fontsize=9)
            panel.tick_params(labelsize=6)

    spreads = []
    for kind in KINDS:
        mean_std = {
            title(m): float(
                np.mean(
                    [
                        summary([r.result["rms"] for r in chosen(runs, kind=kind, model=o, method=m)])["std"]
                        for o in MODELS
                    ]
                )
            )
            for m in PAPER_METHODS
        }
        if np.isfinite(list(mean_std.values())).all():
            narrowest = sorted(mean_std, key=mean_std.__getitem__)
            spreads.append(
                f"With {KIND_NAMES[kind]}, from the least to the most spread (Std, mean over the objects): "
                + listing([f"{name} ({mean_std[name]:.1e})" for name in narrowest])
                + "."
            )
    return Content(
        how=how(runs),
        pictures=(
            draw(
                "figure9",
                "RMS of Eq. (1) after the search, in metres: every run, quartiles, and the last value within "
                "1.5 of their distance.",
                (len(KINDS), len(MODELS)),
                paint,
            ),
        ),
        findings=tuple(spreads) or ("One run has no spread: ask for more by --runs.",),
        differences=why_both_kinds(),
    )


FIGURE8 = Section("figure8", "Figure 8: RMS during the search", SERIES, _show_curves)
FIGURE9 = Section("figure9", "Figure 9: spread of the RMS", SERIES, _show_boxes)
