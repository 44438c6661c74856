"""What each of the two improvements is worth on its own, at the origin and away from it."""

from __future__ import annotations

from typing import Any

from tmchho.paper.plan import Content, Job, Run, Section, Series, Settings
from tmchho.paper.problems import FUNCTIONS
from tmchho.paper.searches import ITERATIONS, function_jobs, run_function_job
from tmchho.paper.statistics import log10, rank_sum_p, summary
from tmchho.paper.tables import Column, Table
from tmchho.paper.words import how_searched, listing, span

PLACES = ("origin", "shifted")
# Of the search with all switches on. Where both are off it is HHO.
VARIANTS = {
    "HHO": {"chaotic_start": False, "trigonometric_mutation": False},
    "chaotic start": {"chaotic_start": True, "trigonometric_mutation": False},
    "mutation": {"chaotic_start": False, "trigonometric_mutation": True},
    "both (TMCHHO)": {"chaotic_start": True, "trigonometric_mutation": True},
}
_SIGNIFICANT = 0.05


def jobs(settings: Settings) -> list[Job]:
    """Return the jobs of all four variants."""
    return [
        job
        for switches in VARIANTS.values()
        for job in function_jobs(
            settings,
            default_runs=30,
            functions=FUNCTIONS,
            methods=("tmchho",),
            places=PLACES,
            switches=switches,
        )
    ]


def variant_of(run: Run) -> str:
    """Return the name of the variant of a run."""
    return next(name for name, switches in VARIANTS.items() if run.job["switches"] == switches)


def rows(runs: list[Run]) -> list[dict[str, Any]]:
    """Return a row for each function, dimension and place: medians, and tests against HHO."""
    cells: dict[tuple[str, int, str], dict[str, list[float]]] = {}
    for run in runs:
        problem = run.job["place"], run.job["dimension"], run.job["function"]
        cells.setdefault(problem, {}).setdefault(variant_of(run), []).append(run.result["fun"])
    table: list[dict[str, Any]] = []
    for (place, dimension, function), values in cells.items():
        row: dict[str, Any] = {"place": place, "function": function, "dimension": dimension}
        for name, of_variant in values.items():
            row[name] = summary(of_variant)["median"]
            if name != "HHO":
                row[f"p {name}"] = rank_sum_p(values["HHO"], of_variant)
        row["runs"] = len(values["HHO"])
        table.append(row)
    return sorted(table, key=lambda row: (PLACES.index(row["place"]), row["dimension"], row["function"]))


def show(runs: list[Run]) -> Content:
    """Make the section of the ablation."""
    table = rows(runs)
    columns = [Column("place", "minimum"), Column("function", "function"), Column("dimension", "D")]
    columns += [Column(name, f"{name}, median", ".2e") for name in VARIANTS]
    columns += [Column(f"p {name}", f"{name} against HHO, p", ".2g") for name in list(VARIANTS)[1:]]
    columns += [Column("runs", "runs")]
    return Content(
        how=(
            how_searched(runs, ITERATIONS),
            "Shifted: the minimum lies anywhere within 0.8 of the range, elsewhere in each run. "
            "Wilcoxon's rank-sum test, two-sided, not corrected.",
        ),
        tables=(Table("ablation", "Median of the lowest value found.", columns, table),),
        findings=tuple(
            _finding(name, place, [row for row in table if row["place"] == place])
            for place in PLACES
            for name in list(VARIANTS)[1:]
        ),
        differences=("The paper has no ablation: it shows HHO and the search with both improvements only.",),
    )


def _finding(name: str, place: str, table: list[dict[str, Any]]) -> str:
    better = [row for row in table if row[f"p {name}"] < _SIGNIFICANT and row[name] < row["HHO"]]
    worse = [row for row in table if row[f"p {name}"] < _SIGNIFICANT and row[name] > row["HHO"]]
    # Where either has reached 0 there are no powers of ten between them.
    gains = [log10(row["HHO"]) - log10(row[name]) for row in table if row["HHO"] > 0 and row[name] > 0]
    text = (
        f"{name}, {place}: better than HHO (p < {_SIGNIFICANT:g}) on {len(better)}, worse on {len(worse)} of "
        f"{len(table)}"
    )
    if worse:
        places = [f"{row['function']}, D = {row['dimension']}" for row in worse]
        text += f" ({listing(places)})"
    return text + (f"; powers of ten gained: {span(gains, '.1f')}." if gains else ".")


SECTION = Section(
    "ablation",
    "Ablation: each improvement alone",
    Series("ablation of the two improvements", jobs, run_function_job),
    show,
)
