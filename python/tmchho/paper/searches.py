"""The job "minimize": one search on one function, by one of our methods or one of a library."""

from __future__ import annotations

from itertools import product

from tmchho.benchmarks import BenchmarkProblem
from tmchho.errors import StoppedError
from tmchho.optimize import minimize
from tmchho.optimizer import MinimizeResult
from tmchho.paper.library import search_by_library
from tmchho.paper.methods import LIBRARY_METHODS
from tmchho.paper.plan import Job, Result, Settings, ShouldStop
from tmchho.paper.problems import problem

POPULATION = 30
# Not stated in the paper; the iterations follow from its averages (docs/paper_map.md, reading 4).
ITERATIONS = 100
DIMENSIONS = (10, 50)
# A search whose calls fill this share of its budget has used it up; after so many trials the fullest counts.
_USED_UP = 0.97
_MOST_TRIALS = 8


def function_jobs(
    settings: Settings,
    *,
    default_runs: int,
    functions: tuple[str, ...],
    methods: tuple[str, ...],
    dimensions: tuple[int, ...] = DIMENSIONS,
    places: tuple[str, ...] = ("origin",),
    max_evaluations: int | None = None,
    switches: dict[str, bool] | None = None,
) -> list[Job]:
    """Return one job for every method on every function, dimension, place and seed.

    Parameters
    ----------
    settings : Settings
    default_runs : int
        Where the user says nothing.
    functions, methods, dimensions, places
        What is combined.
    max_evaluations : int, optional
        Every method gets just as many calls of the function; where not given, as many iterations.
    switches : dict, optional
        ``chaotic_start`` and ``trigonometric_mutation``, for the ablation.
    """
    return [
        {
            "task": "minimize",
            "function": function,
            "dimension": dimension,
            "place": place,
            "method": method,
            "seed": seed,
            "n_population": POPULATION,
            "n_iterations": settings.n_iterations or ITERATIONS,
            "max_evaluations": max_evaluations,
            "switches": switches or {},
        }
        for function, dimension, place, method, seed in product(
            functions, dimensions, places, methods, settings.seeds(default_runs)
        )
    ]


def run_function_job(job: Job, should_stop: ShouldStop) -> Result:
    """Do one search.

    Returns
    -------
    dict
        ``fun`` and ``n_evaluations``; ``history`` too where the search is one of the paper's.
    """
    task = problem(job["function"], job["dimension"], job["place"], job["seed"])
    if job["method"] in LIBRARY_METHODS:
        value, n_evaluations = search_by_library(task, job["method"], job["max_evaluations"], job["seed"])
        return {"fun": value, "n_evaluations": n_evaluations}
    if job["max_evaluations"] is not None:
        found = _search_within_budget(task, job, should_stop)
        return {"fun": found.fun, "n_evaluations": found.nfev}
    found = _search(task, job, job["n_iterations"], None, should_stop)
    result: Result = {"fun": found.fun, "n_evaluations": found.nfev}
    if job["place"] == "origin":
        result["history"] = found.history.tolist()
    return result


def _search_within_budget(task: BenchmarkProblem, job: Job, should_stop: ShouldStop) -> MinimizeResult:
    """Search with as many iterations as fit into the budget.

    Methods call the function unequally often in an iteration, and hawks plan ahead for all iterations, so
    that a search cut off would lack its last phase. Which trial counts is decided by its calls alone.
    """
    limit, n_iterations = job["max_evaluations"], job["n_iterations"]
    fullest: MinimizeResult | None = None
    for _ in range(_MOST_TRIALS):
        found = _search(task, job, n_iterations, None, should_stop)
        if found.nfev <= limit and (fullest is None or found.nfev > fullest.nfev):
            fullest = found
        if _USED_UP * limit <= found.nfev <= limit:
            break
        # Aimed between the two, because the next search will not call exactly as often.
        n_iterations = max(1, round(n_iterations * (1 + _USED_UP) / 2 * limit / found.nfev))
    return fullest or _search(task, job, n_iterations, limit, should_stop)


def _search(
    task: BenchmarkProblem, job: Job, n_iterations: int, limit: int | None, should_stop: ShouldStop
) -> MinimizeResult:
    found = minimize(
        task,
        method=job["method"],
        population_size=job["n_population"],
        n_iterations=n_iterations,
        max_evaluations=limit,
        seed=job["seed"],
        callback=lambda _x, _value: should_stop(),
        n_threads=1,
        **job["switches"],
    )
    if should_stop():
        raise StoppedError("stopped by the user")
    return found
