"""Distances as colours, in classes that a legend can name.

Why classes: a person reads "0.04 to 0.06" off a legend of ten colours, and nothing off a smooth ramp.
Source: the colours of viridis (van der Walt & Smith 2015) and of ColorBrewer's RdBu (Brewer 2003), both safe
for colour-blind eyes; classes and borders are this project's.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tmchho.results import ReadOnlyArrays

N_CLASSES = 10
# From near to far.
_SEQUENTIAL = (
    *((68, 1, 84), (72, 40, 120), (62, 74, 137), (49, 104, 142), (38, 130, 142)),
    *((31, 158, 137), (53, 183, 121), (109, 205, 89), (180, 222, 44), (253, 231, 37)),
)
# From below (blue) to above (red).
_DIVERGING = (
    *((5, 48, 97), (33, 102, 172), (67, 147, 195), (146, 197, 222), (209, 229, 240)),
    *((253, 219, 199), (244, 165, 130), (214, 96, 77), (178, 24, 43), (103, 0, 31)),
)
_FARTHER, _NO_DATA, _NOT_SIGNIFICANT = (214, 40, 160), (128, 128, 128), (205, 205, 205)


@dataclass(frozen=True, eq=False)
class ColourScale(ReadOnlyArrays):
    """Borders of classes and what colour each has.

    Parameters
    ----------
    borders : (k + 1,) float64 array
        Rising; class i holds what is at least ``borders[i]`` and below ``borders[i + 1]``, the last one also
        what equals its upper border.
    colours : (k, 3) uint8 array
        Of the classes. What lies beyond the borders is magenta; beyond those of signed distances it has the
        colour of the outermost class. Where there is no distance, it is grey.
    is_signed : bool
        Whether the borders lie evenly about 0.
    """

    borders: NDArray[np.float64]
    colours: NDArray[np.uint8]
    is_signed: bool

    @classmethod
    def of(
        cls, distances: NDArray[np.float64], *, is_signed: bool = False, tolerance: float | None = None
    ) -> ColourScale:
        """Return the scale that suits distances.

        Parameters
        ----------
        distances : (n,) float64 array
            NaN where there is none.
        is_signed : bool, default False
            Whether below and above are told apart.
        tolerance : float, optional
            The scale then reaches to twice the tolerance, so that this is a border; else to a round number
            that 95 % of the distances keep to.

        Examples
        --------
        >>> float(ColourScale.of(np.array([0.0, 0.013, 0.038])).borders[-1])
        0.05
        """
        amounts = np.abs(distances[np.isfinite(distances)])
        usual = float(np.percentile(amounts, 95)) if len(amounts) else 0.0
        return cls.reaching(usual, is_signed=is_signed, tolerance=tolerance)

    @classmethod
    def reaching(cls, usual: float, *, is_signed: bool, tolerance: float | None) -> ColourScale:
        """Return the scale for distances of which 95 % keep to `usual`."""
        limit = 2 * tolerance if tolerance else _round_up(usual)
        low = -limit if is_signed else 0.0
        colours = np.array(_DIVERGING if is_signed else _SEQUENTIAL, dtype=np.uint8)
        return cls(np.linspace(low, limit, N_CLASSES + 1), colours, is_signed)

    def classes(self, distances: NDArray[np.float64]) -> NDArray[np.intp]:
        """Return the class of each distance; -1 for below, the number of classes for above and NaN."""
        found = np.searchsorted(self.borders, distances, side="right") - 1
        found[distances == self.borders[-1]] = len(self.colours) - 1
        return np.asarray(found)

    def apply(
        self, distances: NDArray[np.float64], significant: NDArray[np.bool_] | None = None
    ) -> dict[str, NDArray[np.uint8]]:
        """Return the attributes ``red``, ``green`` and ``blue``.

        Parameters
        ----------
        distances : (n,) float64 array
            NaN where there is none.
        significant : (n,) bool array, optional
            What is not significant becomes light grey.
        """
        n_classes = len(self.colours)
        table = np.vstack([self.colours, [_FARTHER]]).astype(np.uint8)
        found = self.classes(distances)
        if self.is_signed:
            found = np.clip(found, 0, n_classes - 1)
        rgb = table[found]
        if significant is not None:
            rgb[~significant] = _NOT_SIGNIFICANT
        rgb[np.isnan(distances)] = _NO_DATA
        return {name: np.ascontiguousarray(rgb[:, at]) for at, name in enumerate(("red", "green", "blue"))}

    def legend(
        self, distances: NDArray[np.float64], significant: NDArray[np.bool_] | None = None
    ) -> list[dict[str, Any]]:
        """Return a row for each class: what it is, its borders, its colour, its points and their share.

        Parameters
        ----------
        distances, significant
            As for `apply`.
        """
        return self.legend_of(self.counts(distances, significant), has_significance=significant is not None)

    def counts(
        self, distances: NDArray[np.float64], significant: NDArray[np.bool_] | None = None
    ) -> NDArray[np.int64]:
        """Return how many points are in each class, farther, not significant, and without a distance."""
        found, n_classes = self.classes(distances), len(self.colours)
        missing = np.isnan(distances)
        quiet = np.zeros(len(distances), dtype=bool) if significant is None else ~significant & ~missing
        if self.is_signed:
            found = np.clip(found, 0, n_classes - 1)
        counts = np.bincount(found[~missing & ~quiet], minlength=n_classes + 1)
        return np.concatenate([counts, [np.count_nonzero(quiet), np.count_nonzero(missing)]])

    def legend_of(self, counts: NDArray[np.int64], *, has_significance: bool) -> list[dict[str, Any]]:
        """Return what `legend` does, from the sum of all `counts`."""
        *in_classes, n_farther, n_quiet, n_missing = counts
        rows = [
            _row("distance", self.borders[i], self.borders[i + 1], self.colours[i], count)
            for i, count in enumerate(in_classes)
        ]
        if self.is_signed:
            rows[0]["from"], rows[-1]["to"] = None, None
        else:
            rows.append(_row("farther", self.borders[-1], None, _FARTHER, n_farther))
        if has_significance:
            rows.append(_row("not significant", None, None, _NOT_SIGNIFICANT, n_quiet))
        rows.append(_row("no data", None, None, _NO_DATA, n_missing))
        for row in rows:
            row["share"] = row["n_points"] / max(int(counts.sum()), 1)
        return rows


def _row(what: str, low: Any, high: Any, colour: Any, n_points: Any) -> dict[str, Any]:
    red, green, blue = (int(value) for value in colour)
    return {
        "class": what,
        "from": None if low is None else float(low),
        "to": None if high is None else float(high),
        "red": red,
        "green": green,
        "blue": blue,
        "n_points": int(n_points),
    }


def _round_up(value: float) -> float:
    """Return the next of 1, 2, 5, 10, … times a power of ten; 1 for nothing."""
    if not value > 0:
        return 1.0
    power = 10.0 ** math.floor(math.log10(value))
    return next(step * power for step in (1.0, 2.0, 5.0, 10.0) if value <= step * power * (1 + 1e-12))
