"""Table 3: six optimisers on the seven functions of Table 1, ours beside the printed values."""

from __future__ import annotations

from collections import defaultdict

from tmchho.paper.methods import PAPER_METHODS, title
from tmchho.paper.plan import Content, Run, Section, Series
from tmchho.paper.printed import printed_number, printed_row
from tmchho.paper.problems import FUNCTIONS
from tmchho.paper.searches import ITERATIONS, function_jobs, run_function_job
from tmchho.paper.statistics import STATISTICS, log10, summary
from tmchho.paper.tables import Column, Table
from tmchho.paper.words import evaluations_by_method, how_searched, listing

Cell = tuple[str, int, str]
"""Function, dimension and method."""

_NEAR_DECADES = 2.0
# More cells of one method than these are counted, not named.
_FEW = 6

SERIES = Series(
    "functions of Table 1",
    lambda settings: function_jobs(settings, default_runs=30, functions=FUNCTIONS, methods=PAPER_METHODS),
    run_function_job,
)


def by_cell(runs: list[Run]) -> dict[Cell, list[Run]]:
    """Group runs by function, dimension and method."""
    cells: dict[Cell, list[Run]] = defaultdict(list)
    for run in runs:
        cells[run.job["function"], run.job["dimension"], run.job["method"]].append(run)
    return dict(cells)


def medians(runs: list[Run], statistic: str = "median") -> dict[Cell, float]:
    """Return the median, or another statistic, of the values found in each cell."""
    return {
        cell: summary([run.result["fun"] for run in of_cell])[statistic]
        for cell, of_cell in by_cell(runs).items()
    }


def printed_average(cell: Cell) -> float | None:
    """Return what the paper prints as the average of a cell."""
    function, dimension, method = cell
    row = printed_row(3, function=function, algorithm=method.upper(), dimension=dimension)
    return printed_number(row, "ave")


def table(runs: list[Run]) -> Table:
    """Return Table 3 with both values in each place."""
    rows = []
    for (function, dimension, method), of_cell in by_cell(runs).items():
        printed = printed_row(3, function=function, algorithm=method.upper(), dimension=dimension)
        ours = summary([run.result["fun"] for run in of_cell])
        row = {"function": function, "dimension": dimension, "algorithm": title(method), **ours}
        row |= {f"printed_{name}": printed_number(printed, name) for name in STATISTICS}
        row["decades"] = _decades((function, dimension, method), ours["median"])
        row["evaluations"] = summary([run.result["n_evaluations"] for run in of_cell])["ave"]
        row["runs"] = len(of_cell)
        rows.append(row)
    columns = [Column("function", "function"), Column("dimension", "D"), Column("algorithm", "algorithm")]
    for name in STATISTICS:
        columns.append(Column(f"printed_{name}", f"{name.title()}, printed", ".2e", is_printed=True))
        columns.append(Column(name, f"{name.title()}, here", ".2e"))
    columns.append(Column("median", "Median, here", ".2e"))
    columns.append(Column("decades", "log₁₀ of it by Ave, printed", "+.1f"))
    columns.append(Column("evaluations", "evaluations a run", ",.0f"))
    columns.append(Column("runs", "runs"))
    caption = "Lowest value found, over the runs of each row."
    return Table("table3", caption, columns, rows, n_group_columns=2)


def show(runs: list[Run]) -> Content:
    """Make the section of Table 3."""
    return Content(
        how=(how_searched(runs, ITERATIONS), evaluations_by_method(runs)),
        tables=(table(runs),),
        findings=tuple(_findings(runs)),
        differences=(
            "Population, iterations and runs of this table are not printed. Runs: for PSO on f1 with D = 10 "
            "the printed worst value is 30 times the printed average, so one run of 30 made the average, and "
            "the printed Std is that of a sample. Population: 30, as in Section 5.2. Iterations: 100, which "
            "came closest to the printed values; the 500 of Section 5.2 go tens of powers of ten below them "
            "(docs/paper_map.md, reading 4; try it by --iterations).",
            "Values spread over many powers of ten, so that a single run decides an average, and the median "
            "lies far below it. The median is shown beside it, and is what the comparisons rest on.",
            "DOA draws three numbers once for all of a run; by these its runs spread over a hundred powers "
            "of ten, and none of its medians comes near an average.",
            (
                "Equal iterations are not equal cost: see the column of evaluations, and the page “equal "
                "budgets”."
            ),
            "All seven functions have their minimum at the origin, towards which two rules of HHO pull: see "
            "the page “shifted and rotated”.",
            "Inertia and velocity limit of PSO are not printed, so its rows cannot be expected to agree.",
            "The printed BOA is outside the box on f2 with D = 50: within ±10 that function is 1e50 + 500 at "
            "most, and the printed best value is 1.36e69. Here all positions are clipped to the box.",
        ),
    )


def _findings(runs: list[Run]) -> list[str]:
    cells = medians(runs)
    averages = medians(runs, "ave")
    found = [_nearness("median", cells), _nearness("average", averages)]
    neither = [cell for cell in cells if not (_is_near(cell, cells[cell]) or _is_near(cell, averages[cell]))]
    found.append(
        "Neither the one nor the other, of HHO, TMCHHO, WOA and BOA: "
        f"{_places([cell for cell in neither if cell[2] not in ('pso', 'doa')]) or 'none'}."
    )
    problems = sorted({cell[:2] for cell in cells})
    zero = [
        f"{function}, D = {dimension}"
        for function, dimension in problems
        if all(
            run.result["fun"] == 0
            for run in runs
            if run.job["method"] in ("hho", "tmchho")
            and (run.job["function"], run.job["dimension"]) == (function, dimension)
        )
    ]
    found.append(f"HHO and TMCHHO reach exactly 0 in every run on: {listing(zero) or 'none'}.")
    better = [p for p in problems if cells[(*p, "tmchho")] < cells[(*p, "hho")]]
    worse = [p for p in problems if cells[(*p, "tmchho")] > cells[(*p, "hho")]]
    found.append(
        f"In the median TMCHHO is lower than HHO on {len(better)} of {len(problems)} functions and "
        f"dimensions, higher on {len(worse)}, equal on {len(problems) - len(better) - len(worse)}."
    )
    printed = {cell: value for cell in cells if (value := printed_average(cell)) is not None}
    found.append(
        f"Of {len(problems)} functions and dimensions TMCHHO is the lowest of the six, alone or with others, "
        f"on {_n_led(cells)} by our medians, on {_n_led(averages)} by our averages, and on {_n_led(printed)} "
        "by the printed averages."
    )
    return found


def _nearness(statistic: str, cells: dict[Cell, float]) -> str:
    far = [cell for cell, value in cells.items() if not _is_near(cell, value)]
    text = (
        f"Our {statistic} lies within {_NEAR_DECADES:g} powers of ten of the printed average in "
        f"{len(cells) - len(far)} of {len(cells)} cells"
    )
    return f"{text}; not so: {_places(far)}." if far else f"{text}."


def _places(cells: list[Cell]) -> str:
    """Return cells by method, counted where there are many of one."""
    of_methods: dict[str, list[str]] = {}
    for function, dimension, method in cells:
        of_methods.setdefault(title(method), []).append(f"{function} ({dimension})")
    return "; ".join(
        f"{method} on {listing(places) if len(places) <= _FEW else f'{len(places)} cells'}"
        for method, places in of_methods.items()
    )


def _decades(cell: Cell, value: float) -> float | None:
    """Return by how many powers of ten a value is above the printed average; None where either is 0."""
    printed = printed_average(cell)
    return log10(value) - log10(printed) if printed and value else None


def _is_near(cell: Cell, value: float) -> bool:
    decades = _decades(cell, value)
    return value == printed_average(cell) if decades is None else abs(decades) <= _NEAR_DECADES


def _n_led(cells: dict[Cell, float]) -> int:
    return sum(
        value <= min(cells[(*cell[:2], method)] for method in PAPER_METHODS)
        for cell, value in cells.items()
        if cell[2] == "tmchho"
    )


SECTION = Section("table3", "Table 3: six optimisers on seven functions", SERIES, show)
