"""Statistics over runs: what the paper's tables give, ranks, and tests of whether a difference is one."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

STATISTICS = ("ave", "best", "worst", "std")


def summary(values: Sequence[float]) -> dict[str, float]:
    """Return Ave, Best, Worst and Std as the tables of the paper, and the median.

    The standard deviation is that of a sample (n − 1), NaN for a single run. The paper's is, too: in Table 3
    PSO on f1 with D = 10 has 0.927 as worst value, 30 times the average; so one run of 30 made both, and the
    printed 0.169 is 0.927/√30, where that of a population would be 0.166.

    Examples
    --------
    >>> summary([1.0, 3.0])["std"]
    1.4142135623730951
    """
    numbers = np.asarray(values, dtype=float)
    return {
        "ave": float(numbers.mean()),
        "best": float(numbers.min()),
        "worst": float(numbers.max()),
        "std": float(numbers.std(ddof=1)) if len(numbers) > 1 else math.nan,
        "median": float(np.median(numbers)),
    }


def log10(value: float) -> float:
    """Return the power of ten of a value, −∞ for 0."""
    return math.log10(value) if value > 0 else -math.inf


def rank_sum_p(one: Sequence[float], other: Sequence[float]) -> float:
    """Return the two-sided p of Wilcoxon's rank-sum test (Mann & Whitney's U, with ties).

    1 where all values are the same and there is nothing to rank.
    """
    from scipy.stats import mannwhitneyu

    if len({*one, *other}) == 1:
        return 1.0
    return float(mannwhitneyu(one, other, alternative="two-sided").pvalue)


def signed_rank_p(one: Sequence[float], other: Sequence[float]) -> float:
    """Return the two-sided p of Wilcoxon's signed-rank test of values that belong together in pairs.

    1 where all pairs are equal and there is nothing to rank.
    """
    from scipy.stats import wilcoxon

    if list(one) == list(other):
        return 1.0
    return float(wilcoxon(one, other).pvalue)


def holm(p_values: Sequence[float]) -> list[float]:
    """Return p values corrected for being many, after Holm (1979).

    Examples
    --------
    >>> holm([0.01, 0.04, 0.03])
    [0.03, 0.06, 0.06]
    """
    corrected, running = [0.0] * len(p_values), 0.0
    for place, index in enumerate(sorted(range(len(p_values)), key=p_values.__getitem__)):
        running = max(running, (len(p_values) - place) * p_values[index])
        corrected[index] = min(1.0, running)
    return corrected


class Ranking(NamedTuple):
    """How methods rank over problems.

    Parameters
    ----------
    mean_ranks : dict
        Of each method; 1 is best, ties share their ranks.
    statistic, p : float
        Friedman's test of whether the methods differ at all; NaN with fewer than three methods or where all
        values are equal.
    """

    mean_ranks: dict[str, float]
    statistic: float
    p: float


def ranking(scores: Mapping[Any, Mapping[str, float]]) -> Ranking:
    """Rank methods by their score on each problem, lowest first.

    Parameters
    ----------
    scores : mapping of mapping
        From problem to method to score; the same methods for each problem.

    Returns
    -------
    Ranking
    """
    from scipy.stats import friedmanchisquare, rankdata

    methods = list(next(iter(scores.values())))
    values = np.array([[of_problem[method] for method in methods] for of_problem in scores.values()])
    ranks = np.array([rankdata(row) for row in values])
    means = dict(zip(methods, ranks.mean(axis=0).tolist(), strict=True))
    if len(methods) < 3 or len(values) < 2 or (ranks == ranks.mean()).all():
        return Ranking(means, math.nan, math.nan)
    test = friedmanchisquare(*values.T)
    return Ranking(means, float(test.statistic), float(test.pvalue))
