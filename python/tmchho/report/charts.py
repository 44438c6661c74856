"""Charts of numbers: how distances are spread, how the search went, what the candidates scored."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tmchho.report.chart import INK, Chart, new_figure, styled
from tmchho.report.colours import SOURCE, TARGET
from tmchho.report.maps import rings
from tmchho.report.points import ReportPoints

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_WIDTH = 7.6
_N_BINS = 60


def distance_histogram(points: ReportPoints, high: float, unit: str) -> Chart | None:
    """Draw how the distances of the points with a counterpart are spread, in both directions."""
    both = np.isfinite(points.distance) & ~points.fills_hole
    if not both.any():
        return None
    with styled():
        figure = new_figure(_WIDTH, 2.7)
        panel = figure.subplots()
        directions = (
            ("source to target", points.is_source, SOURCE),
            ("target to source", ~points.is_source, TARGET),
        )
        for words, side, colour in directions:
            values = points.distance[both & side]
            if len(values):
                draw_steps(panel, values, (0.0, 1.5 * high), colour, f"{words}, {len(values):,} points")
        panel.set_xlim(0, 1.5 * high)
        panel.set_xlabel(f"distance to the nearest point of the other cloud ({unit.strip()})")
        panel.set_ylabel("share of the points (%)")
        panel.grid(True, axis="y")
        panel.legend()
    caption = (
        "How the distances are spread, of the points shown in this report that have a counterpart in the "
        "other cloud. The distance to the nearest point is never below a part of the spacing of the points, "
        "however well the clouds fit."
    )
    return Chart("distance_histogram", "Spread of the distances", caption, figure)


def area_histograms(
    points: ReportPoints, values: NDArray[Any], label: str, areas: Sequence[Mapping[str, Any]], unit: str
) -> Chart | None:
    """Draw how the values are spread in each area that has an outline and points."""
    from matplotlib.path import Path

    xyz, known = points.xyz, np.isfinite(values)
    parts = []
    for area in areas:
        inside = np.zeros(len(xyz), dtype=bool)
        for ring in rings(area.get("outline")):
            inside ^= Path(ring).contains_points(xyz[:, :2])  # a ring within a ring is a hole
        if np.count_nonzero(inside & known) >= 30:
            parts.append((str(area["name"]), values[inside & known].astype(np.float64)))
    if not parts:
        return None
    together = np.concatenate([part for _, part in parts])
    low, high = np.percentile(together, [0.5, 99])
    low = min(0.0, float(low))
    columns = min(3, len(parts))
    rows = -(-len(parts) // columns)
    with styled():
        figure = new_figure(_WIDTH, 0.5 + 1.65 * rows)
        panels = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True).ravel()
        tops = []
        for panel, (name, part) in zip(panels, parts, strict=False):
            draw_steps(panel, part, (low, float(high)), TARGET, None)
            median = float(np.median(part))
            panel.axvline(median, color=INK, linewidth=0.8, linestyle="--")
            panel.set_title(f"{name}: median {median:.3g}{unit}", fontsize=8.5)
            panel.grid(True, axis="y")
            tops.append(panel.get_ylim()[1])
        panels[0].set_ylim(0, max(tops))
        for panel in panels[len(parts) :]:
            panel.set_axis_off()
        figure.supxlabel(f"{label} ({unit.strip()})", fontsize=9)
        figure.supylabel("share (%)", fontsize=9)
    caption = (
        f"How the {label} is spread within each area, of the points shown in this report; dashed: the median."
    )
    return Chart("area_histograms", "Spread within the areas", caption, figure)


def convergence(document: Mapping[str, Any]) -> Chart | None:
    """Draw the best score of the search step by step, and the residual of the fine registration."""
    history = _numbers(document["history"])
    fine = np.sqrt(_numbers(document["icp_history"]))
    if len(history) == 0 and len(fine) == 0:
        return None
    is_paper = document["mode"] == "paper"
    with styled():
        figure = new_figure(_WIDTH, 2.6)
        left, right = figure.subplots(1, 2)
        marks = {"marker": "o", "markersize": 3} if len(history) <= 60 else {}
        left.plot(np.arange(1, len(history) + 1), history, color=TARGET, drawstyle="steps-post", **marks)
        left.set_title("search")
        left.set_xlabel("iteration" if is_paper else "step of the search")
        left.set_ylabel("lowest RMS so far" if is_paper else "best score so far")
        right.plot(np.arange(1, len(fine) + 1), fine, color=SOURCE, marker="o", markersize=3)
        right.set_title("fine registration")
        right.set_xlabel("iteration")
        right.set_ylabel("RMS residual of the pairs")
        if len(fine):
            right.set_ylim(0, 1.15 * float(fine.max()))
        for panel in (left, right):
            _whole_ticks(panel)
            panel.grid(True)
    caption = (
        "Left: the best score of the search so far; it ends where further steps found nothing better. Right: "
        "the root mean squared residual of the pairs, iteration by iteration; flat at the end means that the "
        "pose has come to rest."
    )
    return Chart("convergence", "How the search went", caption, figure)


def candidates(document: Mapping[str, Any]) -> Chart | None:
    """Draw what the best poses of the search scored; None where there is none to compare with."""
    scores = _numbers([candidate["score"] for candidate in document["candidates"]])
    if len(scores) < 2:
        return None
    with styled():
        figure = new_figure(_WIDTH, 0.75 + 0.2 * len(scores))
        panel = figure.subplots()
        colours = [SOURCE, *["#8a929a"] * (len(scores) - 1)]
        panel.barh(np.arange(1, len(scores) + 1), scores, color=colours, height=0.62)
        panel.invert_yaxis()
        panel.set_yticks(np.arange(1, len(scores) + 1))
        panel.set_ylabel("pose")
        panel.set_xlabel("score")
        panel.grid(True, axis="x")
    caption = (
        "Scores of the best poses that the search found, before the fine registration. A pose is only sure "
        "where the first stands clearly above all others."
    )
    return Chart("candidates", "Poses that competed", caption, figure)


def draw_steps(
    panel: Axes, values: NDArray[Any], ends: tuple[float, float], colour: str, words: str | None
) -> None:
    """Draw how values are spread between two ends, as shares of all of them."""
    counts, edges = np.histogram(values, bins=_N_BINS, range=ends)
    shares = 100 * counts / len(values)
    panel.stairs(shares, edges, color=colour, fill=True, alpha=0.22)
    panel.stairs(shares, edges, color=colour, linewidth=1.2, label=words)
    highest = max(panel.get_ylim()[1] if len(panel.patches) > 2 else 0.0, 1.08 * float(shares.max()))
    panel.set_ylim(0, highest or 1.0)


def _whole_ticks(panel: Axes) -> None:
    from matplotlib.ticker import MaxNLocator

    panel.xaxis.set_major_locator(MaxNLocator(6, integer=True, min_n_ticks=1))


def _numbers(values: Sequence[float | None]) -> NDArray[np.float64]:
    """Return the numbers of a list of JSON, NaN where it has none."""
    return np.array([np.nan if value is None else value for value in values], dtype=np.float64)
