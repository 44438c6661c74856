"""Distances that come part by part and are summed up at the end, in memory or on disk."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tmchho.results import DistanceStatistics

Floats = NDArray[np.float64]
Parts = Callable[[], Iterable[Floats]]

_AT_ONCE = 2_000_000
_BINS = 1 << 16
_SORTED_AT_ONCE = 1_000_000


class Lengths:
    """Numbers in the order in which they came.

    Parameters
    ----------
    path : Path, optional
        A file for them, eight bytes each; in memory where not given.
    """

    def __init__(self, path: Path | None = None) -> None:
        self._path = path
        self._kept: list[Floats] = []
        self._n = 0

    def __len__(self) -> int:
        return self._n

    def add(self, values: Floats) -> None:
        """Add some."""
        self._n += len(values)
        if self._path is None:
            self._kept.append(values)
            return
        with self._path.open("ab") as stream:
            stream.write(np.ascontiguousarray(values, dtype=np.float64).tobytes())

    def statistics(self) -> DistanceStatistics | None:
        """Sum all up; None where there are none."""
        if self._path is None:
            return DistanceStatistics.of(np.concatenate(self._kept)) if self._n else None
        return statistics_of_parts(self._parts)

    def _parts(self) -> Iterator[Floats]:
        assert self._path is not None
        for start in range(0, self._n, _AT_ONCE):
            yield np.fromfile(self._path, count=min(_AT_ONCE, self._n - start), offset=8 * start)


def statistics_of_parts(parts: Parts) -> DistanceStatistics | None:
    """Sum up distances that are too many for memory.

    Parameters
    ----------
    parts : callable
        Gives all of them, finite ones, part by part, as often as asked.

    Returns
    -------
    DistanceStatistics or None
        What `DistanceStatistics.of` returns, sums to rounding.
    """
    n, total, squares = 0, 0.0, 0.0
    for part in parts():
        n, total, squares = n + len(part), total + float(part.sum()), squares + float((part * part).sum())
    if n == 0:
        return None
    mean = total / n
    deviations = sum(float(((part - mean) ** 2).sum()) for part in parts())

    def amounts() -> Iterator[Floats]:
        return (np.abs(part) for part in parts())

    best, worst = _limits(amounts)
    return DistanceStatistics(
        n_points=n,
        mean=mean,
        best=best,
        worst=worst,
        std=float(np.sqrt(deviations / n)),
        rms=float(np.sqrt(squares / n)),
        median=quantile_of_parts(parts, 0.5),
        percentile_95=quantile_of_parts(amounts, 0.95),
    )


def quantile_of_parts(parts: Parts, share: float) -> float:
    """Return the value below which a share lies, linear between ranks as numpy does; NaN of nothing."""
    n = sum(len(part) for part in parts())
    if n == 0:
        return float("nan")
    rank = share * (n - 1)
    below, above = _neighbours(parts, int(rank))
    return below + (above - below) * (rank - int(rank))


def _limits(parts: Parts) -> tuple[float, float]:
    low, high = np.inf, -np.inf
    for part in parts():
        if len(part):
            low, high = min(low, float(part.min())), max(high, float(part.max()))
    return low, high


def _neighbours(parts: Parts, rank: int) -> tuple[float, float]:
    """Return the value of a rank and the next one, found by counting in ever narrower bins."""
    low, high = _limits(parts)
    last, n_below, beyond = high, 0, high
    while low < high:
        counts = np.zeros(_BINS, dtype=np.int64)
        for _, bins in _binned(parts, low, high):
            counts += np.bincount(bins, minlength=_BINS)
        reached = n_below + np.cumsum(counts)
        chosen = int(np.searchsorted(reached, rank, side="right"))
        n_below = int(reached[chosen] - counts[chosen])
        inside: list[Floats] = []
        narrow_low, narrow_high = np.inf, -np.inf
        for values, bins in _binned(parts, low, high):
            higher = values[bins > chosen]
            if len(higher):
                beyond = min(beyond, float(higher.min()))
            held = values[bins == chosen]
            if len(held):
                narrow_low, narrow_high = min(narrow_low, held.min()), max(narrow_high, held.max())
            if counts[chosen] <= _SORTED_AT_ONCE:
                inside.append(held)
        if inside:
            ordered = np.sort(np.concatenate(inside))
            at = rank - n_below
            return float(ordered[at]), float(ordered[at + 1] if at + 1 < len(ordered) else beyond)
        low, high = float(narrow_low), float(narrow_high)
    n_equal = sum(int(np.count_nonzero(part == low)) for part in parts())
    is_last = rank + 1 >= n_below + n_equal
    return low, min(beyond, last) if is_last else low


def _binned(parts: Parts, low: float, high: float) -> Iterator[tuple[Floats, NDArray[np.intp]]]:
    for part in parts():
        values = part[(part >= low) & (part <= high)]
        shares = (values - low) / (high - low)
        yield values, np.minimum((shares * _BINS).astype(np.intp), _BINS - 1)
