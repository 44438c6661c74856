"""Pictures of the points: before and after, a cut through both clouds, distances, filled holes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tmchho.report.chart import INK, PAPER, Chart, new_figure, styled
from tmchho.report.colours import FAINT, SOURCE, TARGET, colour_map, rgba
from tmchho.report.points import ReportPoints
from tmchho.report.raster import FRONT, SIDE, TOP, View, limits_of, paint_colours, paint_values, widest_view

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from tmchho.report.scene import Field

_WIDTH = 7.6  # inches: what a page on paper has between its margins


def before_after(points: ReportPoints, document: Mapping[str, Any], unit: str) -> Chart:
    """Draw both clouds as given and as registered, from above and from the side."""
    after = points.xyz
    before, is_beside = _as_given(points, document)
    sides = max((FRONT, SIDE), key=lambda view: float(np.ptp(limits_of(after, view), axis=0)[0]))
    columns = [("as given", before), ("registered", after)]
    views = (TOP, sides)
    limits = [[limits_of(xyz, view) for _, xyz in columns] for view in views]
    heights = [max(_share_of_width(*pair) for pair in row) for row in limits]
    half = _WIDTH / 2 - 0.5
    with styled():
        figure = new_figure(_WIDTH, sum(half * height for height in heights) + 1.35)
        panels = figure.subplots(2, 2, squeeze=False, gridspec_kw={"height_ratios": heights})
        palette = np.array([rgba(TARGET), rgba(SOURCE)])
        for row, view in enumerate(views):
            for column, (words, xyz) in enumerate(columns):
                panel = panels[row][column]
                low, high = limits[row][column]
                paint_colours(panel, xyz, points.is_source.astype(int), palette, view, low, high)
                _axes(panel, view, low, high, unit)
                panel.set_title(f"{words}, {view.words}")
        _legend(figure, [("source", SOURCE), ("target", TARGET)])
    caption = "Left: the clouds as given. Right: the source moved to the position found. "
    if is_beside:
        caption += (
            "As given the clouds lie far apart; the source is drawn beside the target, in its own attitude. "
        )
    caption += "Where both clouds have points, the two colours mix."
    return Chart("before_after", "Before and after", caption, figure)


def cut_chart(points: ReportPoints, unit: str) -> Chart | None:
    """Draw the cut through both clouds, whole and enlarged.

    Returns
    -------
    Chart or None
        None where the clouds share too little for a cut.
    """
    from matplotlib.patches import Rectangle

    cut, is_source = points.cut.astype(np.float64), points.cut_is_source
    if len(cut) == 0:
        return None
    cloud = np.column_stack([cut[:, 0], cut[:, 0], cut[:, 1]])
    low, high = limits_of(cloud, FRONT)
    near_low, near_high = _fullest_window(cut, is_source, low, high)
    heights = [min(0.7, _share_of_width(low, high)), min(0.7, _share_of_width(near_low, near_high))]
    with styled():
        figure = new_figure(_WIDTH, sum((_WIDTH - 0.6) * height for height in heights) + 1.5)
        panels = figure.subplots(2, 1, gridspec_kw={"height_ratios": heights})
        titles = ("the whole cut", "the grey part, enlarged")
        for panel, (a, b), title in zip(panels, ((low, high), (near_low, near_high)), titles, strict=True):
            shown = np.flatnonzero(((cut >= a) & (cut <= b)).all(axis=1))
            # Shuffled, so that neither cloud hides the other.
            shown = np.random.default_rng(0).permutation(shown)
            colours = np.where(is_source[shown, None], rgba(SOURCE), rgba(TARGET))
            size = float(np.clip(9000 / max(len(shown), 1), 0.6, 9.0))
            panel.scatter(*cut[shown].T, s=size, c=colours, linewidths=0, rasterized=True)
            panel.set_xlim(a[0], b[0])
            panel.set_ylim(a[1], b[1])
            panel.set_aspect("equal", adjustable="box")
            panel.set_title(title)
            panel.set_ylabel(f"height ({unit.strip()})")
            panel.grid(True)
        panels[0].add_patch(
            Rectangle(tuple(near_low), *(near_high - near_low), facecolor=INK, alpha=0.1, linewidth=0)
        )
        panels[1].set_xlabel(f"along the cut ({unit.strip()})")
        _legend(figure, [("source", SOURCE), ("target", TARGET)])
    caption = (
        f"All points of both clouds in an upright cut {points.cut_thickness:g}{unit} thick, seen from the "
        "side, with equal scales. Where the position is right, the two colours lie on one line."
    )
    return Chart("cut", "Cut through both clouds", caption, figure)


def _fullest_window(
    cut: NDArray[np.float64],
    is_source: NDArray[np.bool_],
    low: NDArray[np.float64],
    high: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the corners of the window, twice as wide as high, where both clouds have most points together.

    Together are points of both in the same cell, an eighth of the window: a hedge in which each has many is
    not the place that tells most.
    """
    window = (high[0] - low[0]) / 10 * np.array([1.0, 0.5])
    n = 8
    cell = window / n
    at = np.floor((cut - low) / cell).astype(int)
    shape = np.maximum(np.ceil((high - low) / cell).astype(int), n)
    inside = ((at >= 0) & (at < shape)).all(axis=1)
    counts = np.zeros((2, *shape))
    np.add.at(counts, (is_source[inside].astype(int), *at[inside].T), 1)
    sums = np.pad(counts.min(axis=0), ((1, 0), (1, 0))).cumsum(axis=0).cumsum(axis=1)
    together = sums[n:, n:] - sums[:-n, n:] - sums[n:, :-n] + sums[:-n, :-n]
    corner = low + np.array(np.unravel_index(int(np.argmax(together)), together.shape)) * cell
    middle = np.median(cut[((cut >= corner) & (cut <= corner + window)).all(axis=1)], axis=0)
    return middle - window / 2, middle + window / 2


def value_map(
    xyz: NDArray[np.float64],
    name: str,
    title: str,
    field: Field,
    areas: Sequence[Mapping[str, Any]],
    caption: str,
    is_sparse: bool = False,
) -> Chart | None:
    """Draw a value of points by a ramp of colours with its legend, and the outlines of the areas.

    Returns
    -------
    Chart or None
        None where no point has the value.
    """
    known = np.isfinite(field.values)
    if not known.any():
        return None
    from matplotlib.patheffects import withStroke

    # The areas of a report are seen from above, whatever else would show more.
    outlines = [outline for area in areas for outline in rings(area.get("outline"))]
    view = TOP if outlines else widest_view(xyz[known])
    low, high = limits_of(xyz if is_sparse else xyz[known], view)
    with styled():
        figure, panel = _one_panel(low, high, room=0.7)
        values = field.values.astype(np.float64)
        paint_values(panel, xyz, values, view, low, high, field.ramp, (field.low, field.high), is_sparse)
        for area in areas:
            for number, ring in enumerate(rings(area.get("outline"))):
                panel.plot(ring[:, 0], ring[:, 1], color=INK, linewidth=1.0)
                if number == 0:
                    where = ring[:-1].mean(axis=0)
                    label = panel.annotate(str(area["name"]), where, ha="center", va="center", weight="bold")
                    label.set_path_effects([withStroke(linewidth=3, foreground=PAPER)])
        _axes(panel, view, low, high, field.unit)
        panel.set_title(view.words)
        _colour_bar(figure, panel, field)
    return Chart(name, title, caption, figure)


def holes_map(points: ReportPoints, hole_radius: float, unit: str) -> Chart | None:
    """Draw the points that fill holes; None where there are none."""
    if not points.fills_hole.any():
        return None
    fused = points.is_fused
    xyz, fills = points.xyz[fused], points.fills_hole[fused]
    by_source = points.is_source[fused]
    view = widest_view(xyz)
    low, high = limits_of(xyz, view)
    palette = np.array([rgba(FAINT, 0.55), rgba(TARGET), rgba(SOURCE)])
    with styled():
        figure, panel = _one_panel(low, high, room=0.4)
        paint_colours(panel, xyz, fills * (1 + by_source), palette, view, low, high)
        _axes(panel, view, low, high, unit)
        panel.set_title(f"the fused cloud, {view.words}")
        rows = [("from the source only", SOURCE), ("from the target only", TARGET), ("from both", FAINT)]
        _legend(figure, rows)
    caption = (
        "The fused cloud. In colour: points that fill a hole of the other cloud, which has nothing within "
        f"{hole_radius:.3g}{unit} of them. Grey: what both clouds show."
    )
    return Chart("holes", "Holes filled", caption, figure)


def rings(outline: Any) -> list[NDArray[np.float64]]:
    """Return the closed lines of an area's outline, however it is stated.

    Parameters
    ----------
    outline : mapping, sequence or None
        A GeoJSON polygon or multipolygon, a ring of points, or several.

    Examples
    --------
    >>> square = [[0, 0], [2, 0], [2, 1], [0, 1]]
    >>> len(rings(square)[0]), len(rings({"type": "Polygon", "coordinates": [square]})), rings(None)
    (5, 1, [])
    """
    if outline is None:
        return []
    if isinstance(outline, Mapping):
        return rings(outline.get("coordinates"))
    if len(outline) and np.isscalar(outline[0][0]):
        ring = np.array(outline, dtype=np.float64)[:, :2]
        return [ring if np.array_equal(ring[0], ring[-1]) else np.vstack([ring, ring[:1]])]
    return [ring for part in outline for ring in rings(part)]


def _as_given(points: ReportPoints, document: Mapping[str, Any]) -> tuple[NDArray[np.float64], bool]:
    """Return where the points lay before, and whether the source had to be drawn beside the target."""
    matrix = np.array(document["pivot_transformation"])
    source_pivot, target_pivot = (np.array(document[f"{side}_pivot"]) for side in ("source", "target"))
    xyz = points.xyz
    is_source = points.is_source
    back = matrix[:3, :3].T / document["scale"] ** 2
    given = (xyz[is_source] - target_pivot - matrix[:3, 3]) @ back.T + source_pivot
    stays = xyz[~is_source]
    reach = np.ptp(xyz, axis=0).max() + np.ptp(given, axis=0).max()
    is_beside = bool(np.abs(given.mean(axis=0) - stays.mean(axis=0)).max() > reach)
    if is_beside:
        gap = 0.1 * np.ptp(stays[:, 0])
        place = np.array([stays[:, 0].max() + gap - given[:, 0].min(), 0, 0])
        place[1:] = np.median(stays, axis=0)[1:] - np.median(given, axis=0)[1:]
        given = given + place
    before = xyz.copy()
    before[is_source] = given
    return before, is_beside


def _share_of_width(low: NDArray[np.float64], high: NDArray[np.float64]) -> float:
    """Return height by width of a panel, within what a page bears."""
    return float(np.clip((high[1] - low[1]) / (high[0] - low[0]), 0.12, 1.0))


def _one_panel(low: NDArray[np.float64], high: NDArray[np.float64], room: float) -> tuple[Figure, Axes]:
    figure = new_figure(_WIDTH, min(_WIDTH, (_WIDTH - 1.2) * _share_of_width(low, high)) + 0.75 + room)
    return figure, figure.subplots()


def _axes(panel: Axes, view: View, low: NDArray[np.float64], high: NDArray[np.float64], unit: str) -> None:
    """Count along the axes from round places near the corner: seven-digit labels hide the picture."""
    from matplotlib.ticker import FuncFormatter, MaxNLocator

    for axis, name, start, end in zip((panel.xaxis, panel.yaxis), view.labels, low, high, strict=True):
        is_far = abs(start) > 20 * (end - start)
        unit_length = 10.0 ** math.ceil(math.log10(max(end - start, 1e-300)))
        base = math.floor(start / unit_length) * unit_length if is_far else 0.0
        axis.set_major_locator(MaxNLocator(5, steps=[1, 2, 2.5, 5, 10], min_n_ticks=2))
        axis.set_major_formatter(FuncFormatter(lambda value, _at, base=base: f"{value - base:g}"))
        axis.set_label_text(f"{name}{f' − {base:,.0f}' if base else ''} ({unit.strip()})".replace(",", " "))


def _legend(figure: Figure, rows: Sequence[tuple[str, str]]) -> None:
    from matplotlib.lines import Line2D

    marks = [Line2D([], [], marker="s", linestyle="", color=colour, markersize=6) for _, colour in rows]
    figure.legend(marks, [words for words, _ in rows], loc="outside upper right", ncols=len(rows))


def _colour_bar(figure: Figure, panel: Axes, field: Field) -> None:
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    mappable = ScalarMappable(Normalize(field.low, field.high), colour_map(field.ramp))
    extend = "both" if field.ramp == "diverging" else "max"
    bar = figure.colorbar(
        mappable, ax=panel, orientation="horizontal", extend=extend, aspect=45, shrink=0.8, pad=0.02
    )
    bar.set_label(f"{field.label} ({field.unit.strip()})")
    bar.outline.set_linewidth(0.0)
