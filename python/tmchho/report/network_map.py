"""Pictures of a network: where its stations stand, what links them, and how far each can be trusted."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tmchho.report.chart import INK, PAPER, Chart, new_figure, styled
from tmchho.report.colours import FAINT, MARKED, colour_map
from tmchho.report.rounding import nice_ceiling

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Floats = NDArray[np.float64]

_WIDTH = 7.6  # inches: what a page on paper has between its margins
_MOST_NAMES = 60  # of more, only those that a person must look at are written
_NAMES_OF_MANY = 12
_DARKEST = 6.0  # twice the normalised residual beyond which links are rare where all is well


def network_map(document: Mapping[str, Any]) -> Chart | None:
    """Draw the stations from above, with the links between them in the colour of their residuals.

    Parameters
    ----------
    document : mapping
        The content of ``network.json``.

    Returns
    -------
    Chart or None
        None where no station was placed.
    """
    places = {
        station["name"]: place for station in document["stations"] if (place := place_of(station)) is not None
    }
    if not places:
        return None
    xyz = np.array(list(places.values()))
    low, high = xyz[:, :2].min(axis=0), xyz[:, :2].max(axis=0)
    margin = 0.08 * float(max(*(high - low), 1e-9)) or 1.0
    low, high = low - margin, high + margin
    share = float(np.clip((high[1] - low[1]) / (high[0] - low[0]), 0.3, 1.0))
    with styled():
        figure = new_figure(_WIDTH, (_WIDTH - 1.0) * share + 1.7)
        panel = figure.subplots()
        _draw_links(figure, panel, document, places)
        _draw_stations(panel, document["stations"], places)
        base = _axes(panel, low, high)
        panel.set_title("seen from above")
        figure.legend(*_legend(document), loc="outside upper right", ncols=3)
    caption = (
        "The stations and the links that the network rests on. A link has the colour of its residual after "
        "the adjustment, by what its own accuracy lets expect: about 1 where all is well, rarely above 3. "
        "Thin: links of a block. Dashed: links that fitted for themselves, but were left out."
    )
    if base:
        caption += " The axes count from the place that is named beside them."
    return Chart("network_map", "Map of the network", caption, figure)


def sigma_chart(document: Mapping[str, Any]) -> Chart | None:
    """Draw the standard errors of all stations, largest first; None where there are none."""
    found = [
        (station["name"], station["sigma_point_m"])
        for station in document["stations"]
        if station["sigma_point_m"] is not None
    ]
    values = np.array(sorted((sigma for _, sigma in found), reverse=True))
    if len(values) < 3 or not values.max() > 0:
        return None
    factor, unit = (1000.0, "mm") if values.max() < 0.1 else (1.0, "m")
    with styled():
        figure = new_figure(_WIDTH, 2.3)
        panel = figure.subplots()
        panel.plot(
            np.arange(1, len(values) + 1), factor * values, color=INK, linewidth=1.2, marker="o", markersize=3
        )
        panel.set_xlim(0.5, len(values) + 0.5)
        panel.set_ylim(0, nice_ceiling(factor * float(values.max())))
        panel.set_xlabel("stations, the least certain first")
        panel.set_ylabel(f"1σ of a point ({unit})")
        panel.grid(True)
    caption = (
        "By so much a point of each station may typically be displaced because of the errors of its pose. A "
        "step marks stations that hang on the network by few or weak links."
    )
    return Chart("network_sigma", "Accuracy of the stations", caption, figure)


def place_of(station: Mapping[str, Any]) -> Floats | None:
    """Return where a station is drawn: the middle of its cloud where that is told, else its origin."""
    if station["world_from_station"] is None:
        return None
    if station.get("middle_m") is not None:
        return np.array(station["middle_m"], dtype=np.float64)
    return np.array(station["world_from_station"], dtype=np.float64)[:3, 3]


def _draw_links(figure: Any, panel: Axes, document: Mapping[str, Any], places: Mapping[str, Floats]) -> None:
    from matplotlib.cm import ScalarMappable
    from matplotlib.collections import LineCollection
    from matplotlib.colors import Normalize

    links, stations = document["links"], document["stations"]
    drawn = [link for link in links if link["source"] in places and link["target"] in places]
    kept = [link for link in drawn if link["kept"]]
    # The worst on top, where links cross.
    kept.sort(key=lambda link: link["normalised_residual"] or 0.0)
    left_out = [link for link in drawn if not link["kept"] and link["verdict"] == "accepted"]
    # The same colours in every report: one bad link must not make all others look good.
    worst = max((link["normalised_residual"] or 0.0 for link in kept), default=0.0)
    norm = Normalize(0.0, _DARKEST, clip=True)
    ramp = colour_map("sequential")
    width = float(np.clip(120 / max(len(kept), 1), 0.8, 2.4))

    def ends(of: Sequence[Mapping[str, Any]]) -> list[Floats]:
        return [np.array([places[link["source"]][:2], places[link["target"]][:2]]) for link in of]

    colours = [
        FAINT if link["normalised_residual"] is None else ramp(norm(link["normalised_residual"]))
        for link in kept
    ]
    # A block is linked with nearly all stations: its star must not hide what they have between them.
    blocks = {station["name"] for station in stations if _is_block(station)}
    widths = [width * (0.4 if {link["source"], link["target"]} & blocks else 1.0) for link in kept]
    panel.add_collection(LineCollection(ends(kept), colors=colours, linewidths=widths, zorder=2))
    panel.add_collection(
        LineCollection(ends(left_out), colors=MARKED, linewidths=width, linestyles="dashed", zorder=3)
    )
    if any(link["normalised_residual"] is not None for link in kept):
        bar = figure.colorbar(
            ScalarMappable(norm, ramp),
            ax=panel,
            orientation="horizontal",
            aspect=45,
            shrink=0.8,
            pad=0.02,
            extend="max" if worst > _DARKEST else "neither",
        )
        bar.set_label("residual of a link after the adjustment, by the expected one")
        bar.outline.set_linewidth(0.0)


def _draw_stations(panel: Axes, stations: Sequence[Mapping[str, Any]], places: Mapping[str, Floats]) -> None:
    from matplotlib.patheffects import withStroke

    size = float(np.clip(2400 / max(len(stations), 1), 12, 46))
    for marker, is_member in (("o", _is_plain), ("^", _is_fixed), ("s", _is_block)):
        members = [station for station in stations if station["name"] in places and is_member(station)]
        if not members:
            continue
        xy = np.array([places[station["name"]][:2] for station in members])
        edges = [MARKED if station["note"] else INK for station in members]
        panel.scatter(
            xy[:, 0],
            xy[:, 1],
            s=size,
            marker=marker,
            facecolors=PAPER,
            edgecolors=edges,
            linewidths=1.4,
            zorder=4,
        )
    named = [station for station in stations if station["name"] in places]
    if len(named) > _MOST_NAMES:
        named = sorted(named, key=lambda s: (not s["note"], -(s["sigma_point_m"] or 0.0)))[:_NAMES_OF_MANY]
    for station in named:
        label = panel.annotate(
            station["name"],
            tuple(places[station["name"]][:2].tolist()),
            xytext=(5, 4),
            textcoords="offset points",
            fontsize=7.5,
            parse_math=False,  # a name is no formula, whatever stands in it
            zorder=5,
        )
        label.set_path_effects([withStroke(linewidth=2.5, foreground=PAPER)])


def _is_plain(station: Mapping[str, Any]) -> bool:
    return not _is_block(station) and not _is_fixed(station)


def _is_fixed(station: Mapping[str, Any]) -> bool:
    return bool(station["fixed"]) and not _is_block(station)


def _is_block(station: Mapping[str, Any]) -> bool:
    return bool(station["kind"] == "block")


def _legend(document: Mapping[str, Any]) -> tuple[list[Any], list[str]]:
    from matplotlib.lines import Line2D

    rows: list[tuple[Any, str]] = []
    for marker, words, is_member in (
        ("o", "station", _is_plain),
        ("^", "station held as given", _is_fixed),
        ("s", "block", _is_block),
    ):
        if any(is_member(station) for station in document["stations"]):
            mark = Line2D(
                [], [], marker=marker, linestyle="", markerfacecolor=PAPER, markeredgecolor=INK, markersize=6
            )
            rows.append((mark, words))
    if any(station["note"] for station in document["stations"]):
        mark = Line2D(
            [], [], marker="o", linestyle="", markerfacecolor=PAPER, markeredgecolor=MARKED, markersize=6
        )
        rows.append((mark, "to be looked at"))
    if any(not link["kept"] and link["verdict"] == "accepted" for link in document["links"]):
        rows.append((Line2D([], [], color=MARKED, linestyle="dashed"), "link left out"))
    return [mark for mark, _ in rows], [words for _, words in rows]


def _axes(panel: Axes, low: Floats, high: Floats) -> bool:
    """Count along the axes from round places near the corner: seven-digit labels hide the picture."""
    from matplotlib.ticker import FuncFormatter, MaxNLocator

    panel.set_xlim(low[0], high[0])
    panel.set_ylim(low[1], high[1])
    panel.set_aspect("equal", adjustable="box")
    has_base = False
    for axis, name, start, end in zip((panel.xaxis, panel.yaxis), "xy", low, high, strict=True):
        is_far = abs(start) > 20 * (end - start)
        step = 10.0 ** math.ceil(math.log10(max(end - start, 1e-300)))
        base = math.floor(start / step) * step if is_far else 0.0
        has_base |= bool(base)
        axis.set_major_locator(MaxNLocator(5, steps=[1, 2, 2.5, 5, 10], min_n_ticks=2))
        axis.set_major_formatter(FuncFormatter(lambda value, _at, base=base: f"{value - base:g}"))
        axis.set_label_text(f"{name}{f' − {base:,.0f}' if base else ''} (m)".replace(",", " "))
    return has_base
