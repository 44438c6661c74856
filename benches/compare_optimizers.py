"""Harris hawks of three libraries in one run: ours, mealpy's and niapy's.

    python benches/compare_optimizers.py
    python benches/compare_optimizers.py --repeats 9 --json

f1 and f5 with 50 coordinates, 30 hawks, 500 iterations; each library in its own words, on the same numpy
function, which takes one point or many, and ours on its built-in one as well. The libraries call the function
a different number of times in as many iterations, so time is given per run and per call. Libraries take turns
of half a second. What counts is processor time, and the least of all runs, because other programs on the
machine can only add to it.

Then the gain from a second thread where a call is dear: a turned f5 of many coordinates, and Eq. (1) between
the keypoints of two clouds. Measured gains are those of the fastest runs, and only a machine with two free
processors shows them. The bound beside them is what is left of 2 after the calls that are made in vain,
because a thread looked ahead wrongly: it follows from processor times, whatever else runs.

Needs `pip install tmchho[peers]`. Prints Markdown tables, or JSON with `--json`.
"""

from __future__ import annotations

import argparse
import importlib.metadata
import json
import platform
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, get_args

import numpy as np

import tmchho
from tmchho.config import Method
from tmchho.paper.registrations import search as search_between
from tmchho.paper.scans import load_pair, provenance

try:
    import mealpy
    import niapy.algorithms.basic
    import niapy.problems
    import niapy.task
except ImportError as error:
    sys.exit(f"{error.name} is missing: install the peers with pip install tmchho[peers]")

DIMENSION, POPULATION, ITERATIONS = 50, 30, 500
FUNCTIONS: dict[str, Callable[[Any], Any]] = {
    "f1": lambda x: (x * x).sum(axis=-1),
    "f5": lambda x: (x * x - 10 * np.cos(2 * np.pi * x) + 10).sum(axis=-1),
}
# So many coordinates that a call takes a millisecond, and so many iterations that the first few count little:
# the threads have not learned yet which way the search tends to go.
DEAR_DIMENSION, DEAR_ITERATIONS = 1600, 50
# A turn lasts at least so long: what takes milliseconds would else be at the mercy of what the machine did
# in them.
TURN_S = 0.5

Run = Callable[[int], int]
"""Takes a seed, searches, and returns how often the function was called."""


def ours(name: str, method: Any, vectorized: bool) -> Run:
    box = tmchho.BenchmarkProblem(name, DIMENSION).bounds
    fun: Any = FUNCTIONS[name] if vectorized else name

    def run(seed: int) -> int:
        return tmchho.minimize(
            fun,
            box,
            method=method,
            population_size=POPULATION,
            n_iterations=ITERATIONS,
            seed=seed,
            vectorized=vectorized,
        ).nfev

    return run


def of_mealpy(name: str) -> Run:
    half = tmchho.BenchmarkProblem(name, 1).bounds[0, 1]

    def run(seed: int) -> int:
        n_calls = 0

        def counted(x: Any) -> Any:
            nonlocal n_calls
            n_calls += 1
            return FUNCTIONS[name](x)

        box = mealpy.FloatVar(lb=[-half] * DIMENSION, ub=[half] * DIMENSION)
        problem = {"bounds": box, "minmax": "min", "obj_func": counted, "log_to": None}
        mealpy.HHO.OriginalHHO(epoch=ITERATIONS, pop_size=POPULATION).solve(problem, seed=seed)
        return n_calls

    return run


def of_niapy(name: str) -> Run:
    half = tmchho.BenchmarkProblem(name, 1).bounds[0, 1]

    class Counted(niapy.problems.Problem):
        def __init__(self) -> None:
            super().__init__(DIMENSION, -half, half)
            self.n_calls = 0

        def _evaluate(self, x: Any) -> Any:
            self.n_calls += 1
            return FUNCTIONS[name](x)

    def run(seed: int) -> int:
        problem = Counted()
        hawks = niapy.algorithms.basic.HarrisHawksOptimization(population_size=POPULATION, seed=seed)
        hawks.run(niapy.task.Task(problem=problem, max_iters=ITERATIONS))
        return problem.n_calls

    return run


@dataclass(frozen=True)
class Spent:
    """What a run took."""

    elapsed_s: float
    processor_s: float
    calls: int


def timed(run: Run, seed: int) -> Spent:
    elapsed, processor = time.perf_counter(), time.process_time()
    calls = run(seed)
    return Spent(time.perf_counter() - elapsed, time.process_time() - processor, calls)


def measured(runs: dict[str, Run], repeats: int) -> dict[str, dict[str, float]]:
    """Return the least time of a run in milliseconds, that of a call in microseconds, and the calls."""
    spent: dict[str, list[Spent]] = {name: [] for name in runs}
    for _ in range(repeats):
        for name, run in runs.items():
            begun = time.perf_counter()
            while time.perf_counter() - begun < TURN_S:
                spent[name].append(timed(run, seed=len(spent[name])))
    return {
        name: {
            "elapsed_ms": 1e3 * min(it.elapsed_s for it in of_runs),
            "run_ms": 1e3 * min(it.processor_s for it in of_runs),
            "calls": sum(it.calls for it in of_runs) / len(of_runs),
            "call_us": 1e6 * min(it.processor_s / it.calls for it in of_runs),
        }
        for name, of_runs in spent.items()
    }


def turned(method: Any) -> Callable[[int, int], tuple[bytes, int]]:
    problem = tmchho.BenchmarkProblem("f5", DEAR_DIMENSION, rotation_seed=1)

    def search(seed: int, n_threads: int) -> tuple[bytes, int]:
        found = tmchho.minimize(
            problem, method=method, n_iterations=DEAR_ITERATIONS, seed=seed, n_threads=n_threads
        )
        return found.x.tobytes(), found.nfev

    return search


def between_clouds(method: Any) -> Callable[[int, int], tuple[bytes, int]]:
    pair = load_pair(provenance(), "bunny", "pair")

    def search(seed: int, n_threads: int) -> tuple[bytes, int]:
        job = {"method": method, "seed": seed, "n_population": POPULATION, "n_iterations": DEAR_ITERATIONS}
        clouds = pair.source.keypoints, pair.target.keypoints
        found = search_between(*clouds, job, lambda: False, n_threads=n_threads)
        return found.transformation.tobytes(), found.n_evaluations

    return search


def two_threads(repeats: int) -> dict[str, dict[str, dict[str, float]]]:
    """Return the times of searches of dear functions by one and by two threads, and what they gain."""
    gains: dict[str, dict[str, dict[str, float]]] = {}
    for name, make in (("turned f5", turned), ("Eq. (1)", between_clouds)):
        gains[name] = {}
        for method in get_args(Method):
            search = make(method)
            answers: dict[int, bytes] = {}

            def run(n_threads: int, seed: int, search: Any = search, answers: Any = answers) -> int:
                answers[n_threads], calls = search(seed, n_threads)
                return int(calls)

            spent: dict[int, list[Spent]] = {1: [], 2: []}
            for _ in range(repeats):
                for n_threads, of_runs in spent.items():
                    of_runs.append(timed(partial(run, n_threads), 0))
                assert answers[1] == answers[2], "the same bits by one thread and by two"
            one, two = (min(it.elapsed_s for it in spent[n]) for n in (1, 2))
            work_one, work_two = (min(it.processor_s for it in spent[n]) for n in (1, 2))
            gains[name][method] = {
                "call_us": 1e6 * work_one / spent[1][0].calls,
                "one_ms": 1e3 * one,
                "two_ms": 1e3 * two,
                "gain": one / two,
                "bound": 2 * work_one / work_two,
            }
    return gains


def main() -> None:
    parser = argparse.ArgumentParser(description="Harris hawks of three libraries, in one run.")
    parser.add_argument("--repeats", type=int, default=5, help="turns of each; the least run counts")
    parser.add_argument("--json", action="store_true", help="print JSON instead of tables")
    arguments = parser.parse_args()
    searches = {}
    for name in FUNCTIONS:
        searches[name] = measured(
            {
                "tmchho hho, built-in": ours(name, "hho", vectorized=False),
                "tmchho hho, numpy": ours(name, "hho", vectorized=True),
                "tmchho tmchho, built-in": ours(name, "tmchho", vectorized=False),
                "tmchho tmchho, numpy": ours(name, "tmchho", vectorized=True),
                "mealpy": of_mealpy(name),
                "niapy": of_niapy(name),
            },
            arguments.repeats,
        )
    gains = two_threads(arguments.repeats)
    versions = {name: importlib.metadata.version(name) for name in ("tmchho", "mealpy", "niapy", "numpy")}
    machine = f"{platform.machine()}, Python {platform.python_version()}"
    if arguments.json:
        print(json.dumps({"machine": machine, "versions": versions, "searches": searches, "threads": gains}))
        return
    print(f"{machine}; {', '.join(f'{name} {version}' for name, version in versions.items())}")
    for name, results in searches.items():
        print(f"\n{name}, D = {DIMENSION}, {POPULATION} hawks, {ITERATIONS} iterations\n")
        print(
            "| | ms per run | elapsed | calls | µs per call | mealpy / it, run | call | niapy / it | call |"
        )
        print("|---|---|---|---|---|---|---|---|---|")
        for library, it in results.items():
            ratios = [
                f"{results[peer][unit] / it[unit]:.1f}"
                for peer in ("mealpy", "niapy")
                for unit in ("run_ms", "call_us")
            ]
            print(
                f"| {library} | {it['run_ms']:.1f} | {it['elapsed_ms']:.1f} | {it['calls']:.0f} | "
                f"{it['call_us']:.2f} | "
                f"{' | '.join(ratios)} |"
            )
    for name, of_methods in gains.items():
        print(f"\n{name}, 30 members\n")
        print("| | µs per call | 1 thread, ms | 2 threads, ms | gain | bound |")
        print("|---|---|---|---|---|---|")
        for method, it in of_methods.items():
            print(
                f"| {method} | {it['call_us']:.0f} | {it['one_ms']:.1f} | {it['two_ms']:.1f} | "
                f"{it['gain']:.2f} | {it['bound']:.2f} |"
            )


if __name__ == "__main__":
    main()
