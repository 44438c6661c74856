"""Table 3 and what rests on the functions: values, ranks, tests, budgets, chaotic maps."""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
import scipy.stats
from paper_tools import rows_of, run_paper, runs_of

import tmchho
from tmchho.paper import Settings, ablation, budgets, figure3, table3
from tmchho.paper.library import search_by_library
from tmchho.paper.plan import Run
from tmchho.paper.problems import problem
from tmchho.paper.runner import complete
from tmchho.paper.statistics import log10
from tmchho.paper.store import RunStore

# Medians of a prototype of the same rules, 30 runs with other seeds. Half of the runs lie within about two
# powers of ten of the median, so that the median of 30 is sure to about half a power.
PROTOTYPE = {
    ("f1", 10, "tmchho"): 2.4e-30,
    ("f1", 50, "tmchho"): 6.7e-30,
    ("f1", 10, "hho"): 4e-26,
    ("f3", 50, "hho"): 1.4e-17,
}
# The printed average is not within two powers of ten of our median, but of our average: an average of such
# values is made by one or two runs of thirty, and lies far above the median.
HEAVY_TAILS = {
    ("f1", 50, "hho"),
    ("f2", 10, "hho"),
    ("f2", 50, "tmchho"),
    ("f3", 10, "hho"),
    ("f3", 10, "tmchho"),
    ("f3", 50, "tmchho"),
    ("f5", 50, "boa"),
    ("f5", 50, "woa"),
    ("f7", 10, "woa"),
    ("f7", 50, "woa"),
}
# The best printed value, 1.36e69, is more than the function has anywhere in the box: 10⁵⁰ + 500.
OUTSIDE_THE_BOX = {("f2", 50, "boa")}


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> list[Run]:
    """Table 3 in full: 30 runs, population 30, 100 iterations."""
    store = RunStore(tmp_path_factory.mktemp("table3"))
    return complete(table3.SERIES, Settings(), store, lambda *_: None)


def test_medians_of_table_3_lie_where_prototype_and_paper_put_them(runs: list[Run]) -> None:
    medians, averages = table3.medians(runs), table3.medians(runs, "ave")
    assert {run.job["n_population"] for run in runs} == {30}
    assert {run.job["n_iterations"] for run in runs} == {100}
    assert len(runs) == 84 * 30
    for cell, median in medians.items():
        if cell[2] in ("pso", "doa") or cell in OUTSIDE_THE_BOX:
            continue
        printed = table3.printed_average(cell)
        assert printed is not None
        if cell in PROTOTYPE:
            assert abs(log10(median) - log10(PROTOTYPE[cell])) < 1.5, cell
        elif cell in HEAVY_TAILS:
            assert median < printed, cell
            assert abs(log10(averages[cell]) - log10(printed)) < 2.0, cell
        elif printed == 0:
            assert median == 0, cell
        else:
            assert abs(log10(median) - log10(printed)) < 2.0, cell


def test_rastrigin_and_griewank_are_solved_exactly(runs: list[Run]) -> None:
    of_hawks = [r for r in runs if r.job["function"] in ("f5", "f7") and r.job["method"] in ("hho", "tmchho")]
    assert len(of_hawks) == 2 * 2 * 2 * 30
    assert {run.result["fun"] for run in of_hawks} == {0.0}


def test_the_mutation_lowers_the_median(runs: list[Run]) -> None:
    medians = table3.medians(runs)
    for function in ("f1", "f2", "f4", "f6"):
        for dimension in (10, 50):
            assert medians[function, dimension, "tmchho"] < medians[function, dimension, "hho"]


def test_the_printed_boa_left_the_box() -> None:
    corner = tmchho.benchmark_value("f2", [10.0] * 50)
    assert corner == pytest.approx(1e50)
    rows = [row for row in rows_of(Path(table3.__file__).parent / "printed" / "table3.csv")]
    printed = next(r for r in rows if (r["function"], r["algorithm"], r["dimension"]) == ("f2", "BOA", "50"))
    assert float(printed["best"]) > corner


def test_ranks_and_tests_are_those_of_scipy(tmp_path: Path) -> None:
    assert run_paper("ranks", "table3", "--runs", 5, "--iterations", 8, "-o", tmp_path).exit_code == 0
    values: dict[tuple[str, int, str], list[float]] = {}
    for run in runs_of(tmp_path):
        job = run["job"]
        values.setdefault((job["function"], job["dimension"], job["method"]), []).append(run["result"]["fun"])
    problems = sorted({cell[:2] for cell in values})
    methods = ("boa", "woa", "pso", "doa", "hho", "tmchho")

    medians = np.array([[np.median(values[(*p, m)]) for m in methods] for p in problems])
    ranks = scipy.stats.rankdata(medians, axis=1).mean(axis=0)
    rows = {row["algorithm"]: row for row in rows_of(tmp_path / "ranks.csv")}
    averages = np.array([[np.mean(values[(*p, m)]) for m in methods] for p in problems])
    ranks_by_averages = scipy.stats.rankdata(averages, axis=1).mean(axis=0)
    assert [float(rows[m.upper()]["rank_by_averages"]) for m in methods] == pytest.approx(ranks_by_averages)
    assert [float(rows[m.upper()]["rank"]) for m in methods] == pytest.approx(ranks)
    statistic, p = scipy.stats.friedmanchisquare(*medians.T)
    assert float(rows["Friedman's χ²"]["rank"]) == pytest.approx(statistic)
    assert float(rows["p"]["rank"]) == pytest.approx(p)

    for rival in methods[:-1]:
        tests = [row for row in rows_of(tmp_path / "ranks_tests.csv") if row["rival"] == rival.upper()]
        assert len(tests) == len(problems)
        p_values = []
        for row in tests:
            cell = row["function"], int(row["dimension"])
            one, other = values[(*cell, "tmchho")], values[(*cell, rival)]
            p = 1.0 if len({*one, *other}) == 1 else scipy.stats.mannwhitneyu(one, other).pvalue
            assert float(row["p"]) == pytest.approx(p)
            p_values.append(p)
        # Holm: the k-th smallest times the number of those not smaller, never falling.
        order = np.argsort(p_values, kind="stable")
        stepped = np.sort(p_values) * np.arange(len(p_values), 0, -1)
        wanted = np.empty(len(p_values))
        wanted[order] = np.minimum(1.0, np.maximum.accumulate(stepped))
        assert [float(row["p_holm"]) for row in tests] == pytest.approx(wanted)


def test_the_chaotic_map_fills_its_range_more_evenly_than_the_logistic_map(tmp_path: Path) -> None:
    assert run_paper("figure3", "--runs", 3, "-o", tmp_path).exit_code == 0
    found = {(run["job"]["map"], run["job"]["seed"]): run["result"] for run in runs_of(tmp_path)}
    assert len(found) == 9
    for result in found.values():
        assert sum(result["counts"]) == figure3.N_VALUES == 10**5
        assert result["chi_squared"] == pytest.approx(scipy.stats.chisquare(result["counts"]).statistic)
    for seed in range(3):
        assert found["pwlcm", seed]["chi_squared"] < 200 < found["logistic", seed]["chi_squared"]
    # The logistic map's own density, 1/(π √(x (1 − x))), puts this share into the first of a hundred bins.
    share = 2 / math.pi * math.asin(math.sqrt(0.01))
    assert found["logistic", 0]["counts"][0] / 10**5 == pytest.approx(share, rel=0.05)


@pytest.mark.parametrize("method", ["cma_es", "de"])
def test_a_library_gets_its_budget_and_no_more_and_repeats_itself(method: str) -> None:
    def search(seed: int) -> tuple[float, int]:
        return search_by_library(problem("f1", 10, "rotated", seed), method, 1500, seed)

    alone = [search(seed) for seed in range(4)]
    assert [n for _, n in alone] == [1500] * 4
    assert all(value < tmchho.benchmark_value("f1", [10.0] * 10) for value, _ in alone)
    with ThreadPoolExecutor(4) as pool:
        assert list(pool.map(search, range(4))) == alone


def test_no_method_exceeds_an_equal_budget() -> None:
    settings = Settings(runs=1)
    series = budgets.SECTIONS[1].series
    jobs = [
        job for job in series.jobs(settings) if job["dimension"] == 10 and job["function"] in ("f1", "f5")
    ]
    counts = {}
    for job in jobs:
        result = series.run(job, lambda: False)
        assert result["n_evaluations"] <= budgets.MAX_EVALUATIONS
        counts.setdefault(job["method"], []).append(result["n_evaluations"])
    # The iterations are made to fit: no method leaves a quarter of its calls unused.
    assert {method: min(n) > 0.75 * budgets.MAX_EVALUATIONS for method, n in counts.items()} == dict.fromkeys(
        budgets.SWARMS, True
    )


def test_places_move_the_minimum_and_nothing_else() -> None:
    origin, shifted, rotated = (problem("f5", 10, place, 3) for place in ("origin", "shifted", "rotated"))
    assert not origin.x_min.any()
    assert np.array_equal(shifted.x_min, rotated.x_min)
    assert 0 < np.abs(shifted.x_min).max() <= 0.8 * 5.12
    for moved in (origin, shifted, rotated):
        assert moved(moved.x_min) == pytest.approx(0.0, abs=1e-12)
        assert np.array_equal(moved.bounds, origin.bounds)
    step = np.full(10, 0.3)
    assert shifted(shifted.x_min + step) == pytest.approx(origin(step))
    assert rotated(rotated.x_min + step) != pytest.approx(origin(step), rel=1e-3)


def test_the_ablation_has_hho_and_tmchho_as_its_ends() -> None:
    jobs = ablation.jobs(Settings(runs=1))
    picked = {
        tuple(job["switches"].values()): ablation.SECTION.series.run(job, lambda: False)["fun"]
        for job in jobs
        if (job["function"], job["dimension"], job["place"]) == ("f1", 10, "origin")
    }
    assert len(picked) == 4
    by_name = {
        m: tmchho.minimize("f1", dimension=10, method=m, n_iterations=100).fun for m in ("hho", "tmchho")
    }
    assert (picked[False, False], picked[True, True]) == (by_name["hho"], by_name["tmchho"])
