"""Figure 3: how evenly the chaotic map of Eq. (6) and the logistic map fill the range from 0 to 1."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tmchho.equations import chaotic_sequence
from tmchho.paper.pictures import draw
from tmchho.paper.plan import Content, Job, Result, Run, Section, Series, Settings, ShouldStop
from tmchho.paper.statistics import summary
from tmchho.paper.tables import Column, Table
from tmchho.paper.words import listing

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

N_VALUES = 100_000
N_BINS = 100
_MAPS = {"pwlcm": "PWLCM, Eq. (6)", "logistic": "logistic map", "uniform": "numpy's generator"}
_N_DOTS = 2000


def jobs(settings: Settings) -> list[Job]:
    """Return a sequence of each kind for every seed."""
    return [
        {"task": "sequence", "map": name, "seed": seed, "n_values": N_VALUES, "n_bins": N_BINS}
        for name in _MAPS
        for seed in settings.seeds(30)
    ]


def run(job: Job, _should_stop: ShouldStop) -> Result:
    """Count the values of one sequence in equal bins, and how far the counts are from equal."""
    values = sequence(job["map"], job["n_values"], job["seed"])
    counts, _ = np.histogram(values, bins=job["n_bins"], range=(0.0, 1.0))
    return {"counts": counts.tolist(), "chi_squared": chi_squared(counts)}


def sequence(name: str, n: int, seed: int) -> NDArray[np.float64]:
    """Return `n` values between 0 and 1 of the map with that name."""
    if name == "pwlcm":
        return chaotic_sequence(n, seed=seed)
    rng = np.random.default_rng(seed)
    if name == "uniform":
        return rng.random(n)
    values = np.empty(n)
    value = rng.uniform(0.01, 0.99)
    for index in range(n):
        values[index] = value
        value = 4.0 * value * (1.0 - value)
    return values


def chi_squared(counts: NDArray[np.int64]) -> float:
    """Return Σ (count − mean)² / mean: about the number of bins for independent, evenly spread values."""
    mean = counts.mean()
    return float(((counts - mean) ** 2 / mean).sum())


def show(runs: list[Run]) -> Content:
    """Make the section of Figure 3."""
    n_seeds = len({run.job["seed"] for run in runs})
    rows: list[dict[str, Any]] = []
    for name, title in _MAPS.items():
        values = [run.result["chi_squared"] for run in runs if run.job["map"] == name]
        rows.append({"map": title, "runs": n_seeds, **summary(values)})
    first = {name: next(run for run in runs if run.job["map"] == name) for name in _MAPS}

    def paint(_figure: Figure, panels: list[Axes]) -> None:
        for column, (name, title) in enumerate(_MAPS.items()):
            counts = first[name].result["counts"]
            panels[column].bar(
                np.arange(len(counts)) / len(counts), counts, width=1 / len(counts), align="edge"
            )
            panels[column].set_title(f"{title}: values in each bin", fontsize=9)
            dots = sequence(name, _N_DOTS, first[name].job["seed"])
            panels[len(_MAPS) + column].plot(dots, ".", markersize=1.5)
            panels[len(_MAPS) + column].set_title(f"{title}: the first {_N_DOTS:,} values", fontsize=9)

    columns = [
        Column("map", "sequence"),
        Column("median", "χ², median", ".1f"),
        Column("best", "lowest", ".1f"),
        Column("worst", "highest", ".1f"),
        Column("runs", "runs"),
    ]
    histogram = [
        {"map": name, "bin_from": index / N_BINS, "count": count}
        for name in _MAPS
        for index, count in enumerate(first[name].result["counts"])
    ]
    return Content(
        how=(
            f"{N_VALUES:,} values in {N_BINS} bins, {n_seeds} seeds; the pictures show the first. "
            f"Independent, evenly spread values have a χ² of about {N_BINS - 1} ± "
            f"{np.sqrt(2 * (N_BINS - 1)):.0f}.",
        ),
        pictures=(
            draw("figure3", "Histograms and values in their order, from 0 to 1.", (2, len(_MAPS)), paint),
        ),
        tables=(
            Table("figure3", "How far the histogram is from flat: χ² over the seeds.", columns, rows),
            Table(
                "figure3_histograms",
                "Values in each bin, first seed.",
                [Column("map", "map"), Column("bin_from", "from"), Column("count", "values")],
                histogram,
                on_page=False,
            ),
        ),
        findings=(_flattest(rows),),
        differences=(
            "A flat histogram is not independence: each value of a chaotic map is a function of the one "
            "before, so that the coordinates of a hawk lie on a broken line. What the start is worth in "
            "a search is on the page “ablation”.",
            "The paper does not print the parameter of its logistic map; 4 is taken, the fully chaotic one.",
        ),
    )


def _flattest(rows: list[dict[str, Any]]) -> str:
    ordered = sorted(rows, key=lambda row: float(row["median"]))
    return (
        "From the flattest to the least flat: "
        + listing([f"{row['map']} (median χ² {row['median']:,.1f})" for row in ordered])
        + "."
    )


SECTION = Section(
    "figure3",
    "Figure 3: histograms of the chaotic maps",
    Series("chaotic sequences", jobs, run),
    show,
)
