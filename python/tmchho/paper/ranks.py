"""Ranks of the six optimisers over Table 3, and whether the differences are more than chance."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from tmchho.paper import table3
from tmchho.paper.methods import PAPER_METHODS, title
from tmchho.paper.plan import Content, Run, Section
from tmchho.paper.searches import ITERATIONS
from tmchho.paper.statistics import holm, rank_sum_p, ranking
from tmchho.paper.tables import Column, Table
from tmchho.paper.words import how_searched, listing, p_text

SIGNIFICANT = 0.05
_RIVALS = tuple(method for method in PAPER_METHODS if method != "tmchho")


def rank_rows(runs: list[Run]) -> list[dict[str, Any]]:
    """Return the mean rank of each method by printed averages, by ours, and by our medians, and the tests."""
    medians, averages = table3.medians(runs), table3.medians(runs, "ave")
    printed = {cell: table3.printed_average(cell) for cell in medians}
    by: dict[str, Mapping[table3.Cell, float | None]] = {
        "printed_rank": printed,
        "rank_by_averages": averages,
        "rank": medians,
    }
    rankings = {name: ranking(_by_problem(scores)) for name, scores in by.items()}
    rows: list[dict[str, Any]] = [
        {"algorithm": title(m), **{name: found.mean_ranks[m] for name, found in rankings.items()}}
        for m in PAPER_METHODS
    ]
    friedman = {name: found.statistic for name, found in rankings.items()}
    p_values = {name: found.p for name, found in rankings.items()}
    return [*rows, {"algorithm": "Friedman's χ²", **friedman}, {"algorithm": "p", **p_values}]


def _by_problem(scores: Mapping[table3.Cell, float | None]) -> dict[tuple[str, int], dict[str, float]]:
    problems: dict[tuple[str, int], dict[str, float]] = {}
    for (function, dimension, method), score in scores.items():
        if score is not None:
            problems.setdefault((function, dimension), {})[method] = score
    return problems


def pairwise_tests(runs: list[Run]) -> list[dict[str, Any]]:
    """Return Wilcoxon's rank-sum test of TMCHHO against each rival on each function and dimension."""
    cells = {cell: [run.result["fun"] for run in of_cell] for cell, of_cell in table3.by_cell(runs).items()}
    medians = table3.medians(runs)
    rows: list[dict[str, Any]] = []
    for rival in _RIVALS:
        of_rival: list[dict[str, Any]] = []
        for function, dimension, _ in (cell for cell in cells if cell[2] == "tmchho"):
            here, there = (function, dimension, "tmchho"), (function, dimension, rival)
            of_rival.append(
                {
                    "rival": title(rival),
                    "function": function,
                    "dimension": dimension,
                    "median_tmchho": medians[here],
                    "median_rival": medians[there],
                    "p": rank_sum_p(cells[here], cells[there]),
                }
            )
        for row, corrected in zip(of_rival, holm([row["p"] for row in of_rival]), strict=True):
            row["p_holm"] = corrected
        rows += of_rival
    return rows


def show(runs: list[Run]) -> Content:
    """Make the section of ranks and tests."""
    tests = pairwise_tests(runs)
    ranks = rank_rows(runs)
    columns = [
        Column("rival", "TMCHHO against"),
        Column("function", "function"),
        Column("dimension", "D"),
        Column("median_tmchho", "median TMCHHO", ".2e"),
        Column("median_rival", "median rival", ".2e"),
        Column("p", "p", ".2g"),
        Column("p_holm", "p, Holm", ".2g"),
    ]
    return Content(
        how=(
            how_searched(runs, ITERATIONS),
            "Ranks: 1 is best, ties share theirs. Tests: "
            "Wilcoxon's rank-sum test, two-sided, corrected after Holm for the functions of each rival; "
            f"below {SIGNIFICANT:g} a difference counts.",
        ),
        tables=(
            Table(
                "ranks",
                "Mean rank over functions and dimensions, and Friedman's test of whether the six differ.",
                [
                    Column("algorithm", "algorithm"),
                    Column("printed_rank", "printed averages", "#.3g", is_printed=True),
                    Column("rank_by_averages", "our averages", "#.3g"),
                    Column("rank", "our medians", "#.3g"),
                ],
                ranks,
            ),
            Table("ranks_tests", "TMCHHO against each rival.", columns, tests),
        ),
        findings=tuple(_findings(ranks, tests)),
        differences=(
            "The paper prints no tests, and shows averages in bold without asking what chance does.",
        ),
    )


def _findings(ranks: list[dict[str, Any]], tests: list[dict[str, Any]]) -> list[str]:
    order = sorted(ranks[: len(PAPER_METHODS)], key=lambda row: float(row["rank"]))
    ordered = listing([f"{row['algorithm']} ({row['rank']:.2f})" for row in order])
    found = [f"By mean rank of our medians: {ordered}; Friedman's test has {p_text(ranks[-1]['rank'])}."]
    for rival in map(title, _RIVALS):
        real = [row for row in tests if row["rival"] == rival and row["p_holm"] < SIGNIFICANT]
        n_all = sum(row["rival"] == rival for row in tests)
        better = sum(row["median_tmchho"] < row["median_rival"] for row in real)
        found.append(
            f"Against {rival}: TMCHHO is better on {better}, worse on {len(real) - better}, not to be "
            f"told apart on {n_all - len(real)} of {n_all}."
        )
    return found


SECTION = Section("ranks", "Ranks and tests for Table 3", table3.SERIES, show)
