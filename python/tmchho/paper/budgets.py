"""Equal numbers of calls for all, at the origin and away from it, and beside optimisers of today.

Three sections look at the same runs: the paper's six at the origin; the same away from the origin; all of
them with CMA-ES and differential evolution.
"""

from __future__ import annotations

from typing import Any

from tmchho.paper.library import missing_libraries
from tmchho.paper.methods import LIBRARY_METHODS, OURS, PAPER_METHODS, title
from tmchho.paper.plan import Content, Job, Run, Section, Series, Settings
from tmchho.paper.problems import FUNCTIONS, PLACES
from tmchho.paper.searches import function_jobs, run_function_job
from tmchho.paper.statistics import log10, rank_sum_p, ranking, summary
from tmchho.paper.tables import Column, Table
from tmchho.paper.words import evaluations_by_method, listing, p_text, runs_and_seeds, span

MAX_EVALUATIONS = 3000
SWARMS = (*PAPER_METHODS, OURS)
_DEFAULT_RUNS = 15
_NAMES = {"origin": "at the origin", "shifted": "shifted", "rotated": "shifted and rotated"}


def _jobs(settings: Settings, methods: tuple[str, ...], places: tuple[str, ...]) -> list[Job]:
    there = tuple(method for method in methods if method not in missing_libraries())
    return function_jobs(
        settings,
        default_runs=_DEFAULT_RUNS,
        functions=FUNCTIONS,
        methods=there,
        places=places,
        max_evaluations=MAX_EVALUATIONS,
    )


def medians(runs: list[Run]) -> dict[tuple[str, int, str], dict[str, float]]:
    """Return the median of each method, by place, dimension and function."""
    return {
        problem: {method: summary(values)["median"] for method, values in of_problem.items()}
        for problem, of_problem in _values(runs).items()
    }


def _values(runs: list[Run]) -> dict[tuple[str, int, str], dict[str, list[float]]]:
    values: dict[tuple[str, int, str], dict[str, list[float]]] = {}
    for run in runs:
        problem = run.job["place"], run.job["dimension"], run.job["function"]
        values.setdefault(problem, {}).setdefault(run.job["method"], []).append(run.result["fun"])
    order = sorted(values, key=lambda p: (PLACES.index(p[0]), p[1], p[2]))
    return {problem: values[problem] for problem in order}


def _table(name: str, runs: list[Run]) -> Table:
    n_runs = len({run.job["seed"] for run in runs})
    rows: list[dict[str, Any]] = [
        {"place": _NAMES[place], "function": function, "dimension": dimension, "runs": n_runs, **of_problem}
        for (place, dimension, function), of_problem in medians(runs).items()
    ]
    methods = list(dict.fromkeys(run.job["method"] for run in runs))
    columns = [Column("place", "minimum"), Column("function", "function"), Column("dimension", "D")]
    columns += [Column(method, title(method), ".2e") for method in methods]
    return Table(
        name, "Median of the lowest value found, by optimiser.", [*columns, Column("runs", "runs")], rows
    )


def _how(runs: list[Run]) -> tuple[str, ...]:
    seeds = sorted({run.job["seed"] for run in runs})
    return (
        f"{runs_and_seeds(seeds)}, at most {MAX_EVALUATIONS:,} calls of the "
        "function in each. Every swarm has as many iterations as fit into that, found by trial; none is cut "
        "off, because hawks plan ahead for all their iterations.",
        evaluations_by_method(runs),
    )


def _order(place: str, runs: list[Run]) -> str:
    """Return the order of the methods at one place as a sentence."""
    here = [run for run in runs if run.job["place"] == place]
    ranks = ranking(medians(here))
    ordered = sorted(ranks.mean_ranks, key=ranks.mean_ranks.__getitem__)
    text = listing([f"{title(method)} ({ranks.mean_ranks[method]:.1f})" for method in ordered])
    return f"Mean ranks, {_NAMES[place]}: {text}; Friedman's test has {p_text(ranks.p)}."


def _show_budgets(runs: list[Run]) -> Content:
    return Content(
        how=_how(runs),
        tables=(_table("budgets", runs),),
        findings=(_order("origin", runs), _against(runs, "tmchho", "hho")),
        differences=(
            "The paper gives all methods the same iterations. Iterations are not calls: how many of these "
            "each method makes then is in the last column but one of Table 3.",
        ),
    )


def _show_shifted(runs: list[Run]) -> Content:
    at_home = {problem[1:]: values for problem, values in medians(runs).items() if problem[0] == "origin"}
    lost = {
        method: [
            log10(values[method]) - log10(at_home[problem[1:]][method])
            for problem, values in medians(runs).items()
            if problem[0] == "shifted" and values[method] > 0 and at_home[problem[1:]][method] > 0
        ]
        for method in SWARMS
    }
    losses = [
        f"{title(method)} {span(values, '+.1f')} (median {summary(values)['median']:+.1f})"
        for method, values in lost.items()
        if values
    ]
    return Content(
        how=(
            *_how(runs),
            "Shifted: the minimum lies anywhere within 0.8 of the range, elsewhere in each run and at "
            "the same place for all methods. Rotated: turned about that place as well, evenly over all "
            "rotations. The box stays.",
        ),
        tables=(_table("shifted", runs),),
        findings=(
            "Powers of ten by which the median rises when the minimum moves away from the origin "
            "(functions on which 0 was reached not counted): " + "; ".join(losses) + ".",
            *(_order(place, runs) for place in PLACES),
            _against([run for run in runs if run.job["place"] != "origin"], OURS, "tmchho"),
        ),
        differences=(
            "All functions of Table 1 have their minimum at the origin, and two rules of HHO use "
            "positions as if they were vectors from there: O_prey − O in the soft besiege, O_prey − "
            "O_avg in the exploration. What that is worth on these functions is the first finding above. "
            f"{title(OURS)} is a variant of this package without that pull.",
        ),
    )


def _show_modern(runs: list[Run]) -> Content:
    missing = missing_libraries()
    away = [run for run in runs if run.job["place"] != "origin"]
    absent = tuple(
        f"{title(method)} was not run: the library {library} is missing; get it by: pip install "
        "'tmchho[paper]'."
        for method, library in missing.items()
    )
    leaders = []
    for place in PLACES:
        of_place = {p: values for p, values in medians(runs).items() if p[0] == place}
        wins = {
            method: sum(values[method] <= min(values.values()) for values in of_place.values())
            for method in next(iter(of_place.values()))
        }
        counts = listing([f"{title(method)} on {n}" for method, n in wins.items() if n])
        leaders.append(f"Lowest median, {_NAMES[place]}, of {len(of_place)} (ties count for each): {counts}.")
    return Content(
        how=(
            *_how(runs),
            *absent,
            "The libraries run with their own settings; only the population of DE is set to 30.",
        ),
        tables=(_table("modern", runs),),
        findings=(
            *leaders,
            *(_order(place, runs) for place in PLACES),
            *(_against(away, method, "tmchho") for method in LIBRARY_METHODS if method not in missing),
        ),
        differences=("The paper compares swarms with swarms of 2015 to 2021 only.",),
    )


def _against(runs: list[Run], one: str, other: str) -> str:
    better = worse = 0
    values = _values(runs)
    for of_problem in values.values():
        if rank_sum_p(of_problem[one], of_problem[other]) < 0.05:
            if summary(of_problem[one])["median"] < summary(of_problem[other])["median"]:
                better += 1
            else:
                worse += 1
    where = "at the origin" if all(problem[0] == "origin" for problem in values) else "away from the origin"
    return (
        f"{title(one)} against {title(other)}, {where}: better on {better}, worse on {worse}, not to be "
        f"told apart on {len(values) - better - worse} of {len(values)} (Wilcoxon's rank-sum test, p < "
        "0.05, not corrected)."
    )


def _section(name: str, title: str, methods: tuple[str, ...], places: tuple[str, ...], show: Any) -> Section:
    series = Series(f"{name}: equal budgets", lambda s: _jobs(s, methods, places), run_function_job)
    return Section(name, title, series, show)


SECTIONS = (
    _section("budgets", "Equal budgets of evaluations", SWARMS, ("origin",), _show_budgets),
    _section("shifted", "Functions shifted and rotated", SWARMS, PLACES, _show_shifted),
    _section("modern", "Optimisers of today", (*SWARMS, *LIBRARY_METHODS), PLACES, _show_modern),
)
