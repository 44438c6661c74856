"""Harris hawks of three libraries in one run: ours, mealpy's and niapy's.

    python benches/compare_optimizers.py
    python benches/compare_optimizers.py --repeats 9 --json

f1 and f5 with 50 coordinates, 30 hawks, 500 iterations; each library in its own words, on the same numpy
function, which takes one point or many, and ours on its built-in one as well. The libraries call the function
a different number of times in as many iterations, so time is given per run and per call. Runs alternate, the
median counts. Then the gain from a second thread where a call is dear: a turned f5 of many coordinates.

Needs `pip install tmchho[peers]`. Prints Markdown tables, or JSON with `--json`.
"""

from __future__ import annotations

import argparse
import importlib.metadata
import json
import platform
import statistics
import sys
import time
from collections.abc import Callable
from typing import Any, get_args

import numpy as np

import tmchho
from tmchho.config import Method

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
DEAR_DIMENSION = 800

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


def measured(runs: dict[str, Run], repeats: int) -> dict[str, dict[str, float]]:
    """Return the median time of a run in milliseconds and the calls of the function."""
    times: dict[str, list[float]] = {name: [] for name in runs}
    calls: dict[str, list[int]] = {name: [] for name in runs}
    for seed in range(repeats):
        for name, run in runs.items():
            begun = time.perf_counter()
            calls[name].append(run(seed))
            times[name].append(time.perf_counter() - begun)
    return {
        name: {
            "run_ms": 1e3 * statistics.median(times[name]),
            "calls": statistics.median(calls[name]),
            "call_us": 1e6 * statistics.median(t / n for t, n in zip(times[name], calls[name], strict=True)),
        }
        for name in runs
    }


def two_threads(repeats: int) -> dict[str, dict[str, float]]:
    """Return the time of a search of a dear function by one and by two threads, and their ratio."""
    problem = tmchho.BenchmarkProblem("f5", DEAR_DIMENSION, rotation_seed=1)
    gains = {}
    for method in get_args(Method):
        times: dict[int, list[float]] = {1: [], 2: []}
        for seed in range(repeats):
            found = []
            for n_threads, of_threads in times.items():
                begun = time.perf_counter()
                found.append(
                    tmchho.minimize(problem, method=method, n_iterations=10, seed=seed, n_threads=n_threads)
                )
                of_threads.append(time.perf_counter() - begun)
            assert found[0].x.tobytes() == found[1].x.tobytes(), "the same bits by one thread and by two"
        one, two = (1e3 * statistics.median(times[n]) for n in (1, 2))
        gains[method] = {"one_ms": one, "two_ms": two, "gain": one / two}
    return gains


def main() -> None:
    parser = argparse.ArgumentParser(description="Harris hawks of three libraries, in one run.")
    parser.add_argument("--repeats", type=int, default=5, help="runs of each; the median counts")
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
        print("| | ms per run | calls | µs per call | mealpy / it, run | call | niapy / it, run | call |")
        print("|---|---|---|---|---|---|---|---|")
        for library, it in results.items():
            ratios = [
                f"{results[peer][unit] / it[unit]:.1f}"
                for peer in ("mealpy", "niapy")
                for unit in ("run_ms", "call_us")
            ]
            print(
                f"| {library} | {it['run_ms']:.1f} | {it['calls']:.0f} | {it['call_us']:.2f} | "
                f"{' | '.join(ratios)} |"
            )
    print(f"\nturned f5, D = {DEAR_DIMENSION}, 30 members, 10 iterations\n")
    print("| | 1 thread, ms | 2 threads, ms | gain |")
    print("|---|---|---|---|")
    for method, it in gains.items():
        print(f"| {method} | {it['one_ms']:.1f} | {it['two_ms']:.1f} | {it['gain']:.2f} |")


if __name__ == "__main__":
    main()
