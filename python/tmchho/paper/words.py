"""Sentences that several pages need."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from tmchho.paper.methods import title
from tmchho.paper.plan import Run


def listing(items: Sequence[str]) -> str:
    """Return items as a sentence has them.

    Examples
    --------
    >>> listing(["f1", "f2", "f5"]), listing([])
    ('f1, f2 and f5', '')
    """
    return " and ".join(filter(None, [", ".join(items[:-1]), *items[-1:]]))


def span(values: Iterable[float], form: str = ",.0f") -> str:
    """Return the lowest and the highest of some numbers, or the one that there is.

    Examples
    --------
    >>> span([3, 1, 2]), span([7.0, 7.0])
    ('1 to 3', '7')
    """
    numbers = sorted(values)
    ends = format(numbers[0], form), format(numbers[-1], form)
    return ends[0] if ends[0] == ends[1] else f"{ends[0]} to {ends[1]}"


def values_of(runs: list[Run], key: str) -> list[object]:
    """Return the different values of an entry of the jobs, in their order."""
    return list(dict.fromkeys(run.job[key] for run in runs))


def how_searched(runs: list[Run], usual_iterations: int) -> str:
    """Return how many runs there are, from which seeds, how large and how long.

    Searches that do not have the usual iterations are not to be compared with the paper, which is said.
    """
    seeds = sorted({run.job["seed"] for run in runs})
    population, iterations = (values_of(runs, key)[0] for key in ("n_population", "n_iterations"))
    text = f"{runs_and_seeds(seeds)}, population {population}, {iterations} iterations."
    if iterations != usual_iterations:
        text += f" NOT COMPARABLE with the printed values, which stand for {usual_iterations} iterations."
    return text


def runs_and_seeds(seeds: Sequence[int]) -> str:
    """Return how many runs there are of each search, and from which seeds.

    Examples
    --------
    >>> runs_and_seeds([0, 1, 2]), runs_and_seeds([7])
    ('3 runs each (seeds 0 to 2)', '1 run each (seed 7)')
    """
    plural = "s" if len(seeds) > 1 else ""
    return f"{len(seeds)} run{plural} each (seed{plural} {span(seeds, 'd')})"


def evaluations_by_method(runs: list[Run]) -> str:
    """Return how often each method called its function in a run."""
    counts: dict[str, list[float]] = {}
    for run in runs:
        counts.setdefault(run.job["method"], []).append(run.result["n_evaluations"])
    return "Evaluations in a run: " + "; ".join(f"{title(m)} {span(c)}" for m, c in counts.items()) + "."


def p_text(p: float) -> str:
    """Return a p value as a sentence has it.

    Examples
    --------
    >>> p_text(0.034), p_text(1e-9)
    ('p = 0.034', 'p < 0.001')
    """
    return "p < 0.001" if p < 0.001 else f"p = {p:.2g}"
