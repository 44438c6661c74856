"""The sections of Section 5.3: Table 6, Figure 14 and Table 7 with Figures 16 and 17."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from tmchho.paper import site
from tmchho.paper.methods import PAPER_METHODS, title
from tmchho.paper.pictures import COLOURS, draw
from tmchho.paper.plan import Content, Run, Section
from tmchho.paper.printed import printed_number, printed_row
from tmchho.paper.registrations import ITERATIONS
from tmchho.paper.statistics import summary
from tmchho.paper.table4 import chosen, is_right
from tmchho.paper.tables import Column, Table
from tmchho.paper.words import evaluations_by_method, how_searched, listing

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_SURVEYS = {
    "scanner": ("3D laser scanning", "terrestrial_laser_scanning"),
    "photogrammetry": ("UAV tilt photography", "uav_tilt_photography"),
}
# The only value of Figure 14 that the text gives (Section 5.3).
_PRINTED_RMS = {"tmchho": 1.01}
_STATISTICS = ("avg", "best", "worst", "std")
_NOT_THE_DAM = (
    "The paper's surveys of the Lianghekou dam are not public. A SIMULATED dam site stands in for them "
    f"(tmchho.simulate), {site.SITE_M:g} m by {site.SITE_M:g} m, with {site.STATIONS} scanner stations: "
    "the printed values are of another place and stand beside ours for their size only."
)


def _how(runs: list[Run]) -> str:
    job = runs[0].job
    return (
        f"Simulated site of seed {job['site_seed']}, {job['n_points']:,} points of photogrammetry; voxel "
        f"{site.VOXEL_SIZE:g} m, keypoint radius {site.KEYPOINT_RADIUS:g} m, as printed."
    )


def _show_counts(runs: list[Run]) -> Content:
    rows: list[dict[str, Any]] = []
    for name, (survey, printed_name) in _SURVEYS.items():
        printed = printed_row(6, source=printed_name)
        of_survey = runs[0].result[name]
        rows.append(
            {
                "survey": survey,
                "printed_before": printed_number(printed, "points_before"),
                "printed_after": printed_number(printed, "points_after"),
                **{
                    f"{what}_{place}": of_survey[place][what]
                    for place in ("site", "piece")
                    for what in ("before", "after", "keypoints")
                },
            }
        )
    columns = [
        Column("survey", "survey"),
        Column("printed_before", "before, printed", ",.0f", is_printed=True),
        Column("before_site", "before, here", ","),
        Column("printed_after", "after, printed", ",.0f", is_printed=True),
        Column("after_site", "after, here", ","),
        Column("keypoints_site", "keypoints, here", ","),
        Column("before_piece", "piece: before", ","),
        Column("after_piece", "piece: after", ","),
        Column("keypoints_piece", "piece: keypoints", ","),
    ]
    kept = [f"{row['survey']} {100 * row['after_site'] / row['before_site']:.0f} %" for row in rows]
    printed_kept = [
        f"{row['survey']} {100 * row['printed_after'] / row['printed_before']:.0f} %" for row in rows
    ]
    return Content(
        how=(
            _how(runs),
            f"Piece: {site.PIECE_M:g} m by {site.PIECE_M:g} m in the middle, on which Figure 14 runs.",
        ),
        tables=(Table("table6", "Points before and after the preprocessing.", columns, rows),),
        findings=(f"Kept here: {listing(kept)}; in the paper: {listing(printed_kept)}.",),
        differences=(
            _NOT_THE_DAM,
            "The paper calls its clouds local without giving their extent, and so how dense they are; "
            "the share that is kept follows from the density alone.",
        ),
    )


def _show_searches(runs: list[Run]) -> Content:
    rows: list[dict[str, Any]] = []
    for method in PAPER_METHODS:
        of_method = chosen(runs, method=method)
        rows.append(
            {
                "algorithm": title(method),
                "printed": _PRINTED_RMS.get(method),
                **summary([run.result["rms"] for run in of_method]),
                "right": sum(is_right(run)[1] for run in of_method),
                "runs": len(of_method),
            }
        )
    curves = {
        method: np.mean([run.result["history"] for run in chosen(runs, method=method)], axis=0)
        for method in PAPER_METHODS
    }
    averages = {method: row["ave"] for method, row in zip(PAPER_METHODS, rows, strict=True)}
    true_rms = runs[0].result["true_rms"]

    def paint(_figure: Figure, panels: list[Axes]) -> None:
        panels[0].bar(
            [title(m) for m in PAPER_METHODS],
            [averages[m] for m in PAPER_METHODS],
            color=[COLOURS[m] for m in PAPER_METHODS],
        )
        for method in PAPER_METHODS:
            of_method = [run.result["rms"] for run in chosen(runs, method=method)]
            panels[0].plot([title(method)] * len(of_method), of_method, "k.", markersize=4)
        panels[0].set_title("(a) RMS in the end, m", fontsize=9)
        for method in PAPER_METHODS:
            panels[1].plot(curves[method], color=COLOURS[method], label=title(method), lw=1.4)
        panels[1].set_title("(b) RMS during the search, m", fontsize=9)
        panels[1].set_xlabel("iteration", fontsize=8)
        for panel in panels:
            panel.axhline(true_rms, color="black", lw=0.8, ls="--", label="true pose")
            panel.tick_params(labelsize=7)
        panels[1].legend(fontsize=7)

    columns = [
        Column("algorithm", "algorithm"),
        Column("printed", "printed", ".2f", is_printed=True),
        Column("ave", "Ave, here", ".3f"),
        Column("best", "Best, here", ".3f"),
        Column("worst", "Worst, here", ".3f"),
        Column("right", "right in the end"),
        Column("runs", "runs"),
    ]
    points = [
        {"algorithm": title(method), "iteration": number, "rms": float(value)}
        for method, curve in curves.items()
        for number, value in enumerate(curve, start=1)
    ]
    order = sorted(averages, key=averages.__getitem__)
    n_below = sum(run.result["rms"] < true_rms for run in runs if not is_right(run)[0])
    return Content(
        how=(
            _how(runs),
            how_searched(runs, ITERATIONS)
            + " Each run moves the piece of the photogrammetry anew, at random.",
            evaluations_by_method(runs),
        ),
        tables=(
            Table(
                "figure14", "RMS of Eq. (1) between the keypoints after the search, in metres.", columns, rows
            ),
            Table(
                "figure14_curves",
                "The curves.",
                [Column(name, name) for name in ("algorithm", "iteration", "rms")],
                points,
                on_page=False,
            ),
        ),
        pictures=(
            draw(
                "figure14",
                "(a) Mean over the runs, and each of them; (b) the mean, step by step.",
                (1, 2),
                paint,
            ),
        ),
        findings=(
            "From the lowest average RMS to the highest: "
            + listing([f"{title(m)} ({averages[m]:.3f} m)" for m in order])
            + ".",
            f"At the true pose the RMS is {true_rms:.3f} m; {n_below} of {len(runs)} searches ended at a "
            "wrong pose with a lower one.",
            f"Right in the end, after ICP: {sum(row['right'] for row in rows)} of {len(runs)} searches.",
        ),
        differences=(
            _NOT_THE_DAM,
            "The paper prints one value in the text and the rest as bars without numbers, of one run "
            "each as it seems.",
        ),
    )


def _show_distances(runs: list[Run]) -> Content:
    result = runs[0].result
    rows: list[dict[str, Any]] = []
    for number in site.AREAS:
        here = result["areas"][str(number)]
        printed = printed_row(7, area=number)
        rows.append(
            {
                "area": number,
                "n_points": here["n_points"],
                **{f"printed_{name}": printed_number(printed, name) for name in _STATISTICS},
                **here["found"],
                **{f"true_{name}": value for name, value in here["true"].items()},
            }
        )
    columns = [Column("area", "area")]
    for name in _STATISTICS:
        columns.append(Column(f"printed_{name}", f"{name.title()}, printed", ".4f", is_printed=True))
        columns.append(Column(name, f"{name.title()}, here", ".4f"))
    columns += [
        Column("median", "Median, here", ".4f"),
        Column("true_avg", "Avg at the true pose", ".4f"),
        Column("n_points", "points", ","),
    ]
    cells = np.array(result["map"], dtype=float)
    half = site.SITE_M / 2
    limit = float(np.nanpercentile(cells, 95)) if np.isfinite(cells).any() else 1.0

    def paint_map(figure: Figure, panels: list[Axes]) -> None:
        image = panels[0].imshow(
            cells, origin="lower", extent=(-half, half, -half, half), cmap="turbo", vmin=0.0, vmax=limit
        )
        for number, (east, north) in site.AREAS.items():
            low = site.AREA_M / 2
            panels[0].plot(
                [east - low, east + low, east + low, east - low, east - low],
                [north - low, north - low, north + low, north + low, north - low],
                color="black",
                lw=0.8,
            )
            panels[0].text(east, north, str(number), ha="center", va="center", fontsize=9)
        figure.colorbar(image, ax=panels[0]).set_label("m", fontsize=8)
        panels[0].tick_params(labelsize=7)

    def paint_histograms(_figure: Figure, panels: list[Axes]) -> None:
        edges = site.BIN_M * np.arange(site.N_BINS)
        for panel, number in zip(panels, site.AREAS, strict=False):
            counts = result["areas"][str(number)]["counts"]
            panel.bar(edges, counts, width=site.BIN_M, align="edge", color="#0072b2")
            panel.set_title(f"area {number}", fontsize=9)
            panel.tick_params(labelsize=7)
        panels[-1].axis("off")

    histogram = [
        {"area": number, "from_m": round(site.BIN_M * index, 4), "points": count}
        for number in site.AREAS
        for index, count in enumerate(result["areas"][str(number)]["counts"])
    ]
    averages = [float(row["avg"]) for row in rows]
    printed_averages = [float(row["printed_avg"]) for row in rows]
    excess = max(abs(row["avg"] - row["true_avg"]) for row in rows)
    density = runs[0].job["n_points"] / site.SITE_M**2
    return Content(
        how=(
            _how(runs),
            f"Both surveys whole, the photogrammetry moved away at random (seed {runs[0].job['seed']}) "
            "and brought back by robust mode; points that stand alone are removed before measuring.",
            "Distance: from each point of the scanner to the nearest of the photogrammetry, in metres. "
            f"Areas: squares of {site.AREA_M:g} m about the middle and towards the four corners.",
        ),
        tables=(
            Table("table7", "Distances between the two surveys by area, in metres.", columns, rows),
            Table(
                "figure17",
                "The histograms.",
                [Column(name, name) for name in ("area", "from_m", "points")],
                histogram,
                on_page=False,
            ),
        ),
        pictures=(
            draw(
                "figure16",
                "Figure 16: mean distance in each cell of the plan, in metres, and the five areas; east "
                "to the right, north up.",
                (1, 1),
                paint_map,
            ),
            draw("figure17", "Figure 17: number of points by distance, in metres.", (2, 3), paint_histograms),
        ),
        findings=(
            f"Verdict: {result['verdict']}. Off the true pose by {result['rotation_deg']:.4f}° and "
            f"{result['shift_m']:.4f} m in the middle.",
            f"Averages here: {min(averages):.4f} to {max(averages):.4f} m; printed: "
            f"{min(printed_averages):.4f} to {max(printed_averages):.4f} m.",
            f"At the true pose the averages differ from those by at most {excess:.2g} m; all else is in the "
            "surveys.",
            f"The photogrammetry has {density:.0f} points per square metre; among points strewn so densely "
            f"the nearest is on average {0.5 / density**0.5:.3f} m away, whatever the pose.",
        ),
        differences=(
            _NOT_THE_DAM,
            "The paper aligns by TMCHHO and ICP. Here robust mode does, so that the areas are measured at a "
            "checked pose; how often one search finds it is told by Figure 14 and the page of success rates.",
            "The paper does not say where its areas lie, in which direction distances were measured, or "
            "up to which distance. Here nothing is cut off, so that a hole of the photogrammetry makes a "
            "large worst value.",
        ),
    )


SECTIONS = (
    Section("table6", "Table 6: points of the dam site", site.COUNTS, _show_counts),
    Section("table7", "Table 7: distances in five survey areas", site.DISTANCES, _show_distances),
    Section("figure14", "Figure 14: six optimisers on the dam site", site.SEARCHES, _show_searches),
)
