"""Points as a picture of square cells, because a hundred thousand dots of a vector graphic help nobody."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_MAX_CELLS, _MIN_CELLS = 460, 60  # along the longer side
_POINTS_PER_CELL = 2.5  # fewer leave gaps
_PLACES_PER_CELL = 2.0
_POINTS_PER_MEAN = 6.0  # fewer show more of the chance than of the clouds


@dataclass(frozen=True)
class View:
    """A direction from which points are looked at.

    Parameters
    ----------
    words : str
        From where.
    across, up : int
        The axes of the picture.
    """

    words: str
    across: int
    up: int

    @property
    def labels(self) -> tuple[str, str]:
        """Names of the two axes."""
        return "xyz"[self.across], "xyz"[self.up]


TOP = View("from above", 0, 1)
FRONT = View("from the front", 0, 2)
SIDE = View("from the side", 1, 2)


def widest_view(xyz: NDArray[np.float64]) -> View:
    """Return the view of the three that shows most of the points: of a wall, not the one from above."""
    low, high = np.percentile(xyz, [1, 99], axis=0)
    edge = max(float((high - low).max()) / 120, np.finfo(float).tiny)
    cells = np.floor((xyz - low) / edge).astype(np.int64)
    return max(
        (TOP, FRONT, SIDE),
        key=lambda view: len(np.unique(cells[:, view.across] * 1_000_003 + cells[:, view.up])),
    )


def limits_of(xyz: NDArray[np.float64], view: View) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the lower left and upper right corner of what is drawn; a few points far away stay outside."""
    seen = xyz[:, [view.across, view.up]]
    low, high = np.percentile(seen, [0.2, 99.8], axis=0)
    room = 0.03 * np.maximum(high - low, 1e-3 * float((high - low).max()) + np.finfo(float).tiny)
    return low - room, high + room


def paint_values(
    panel: Axes,
    xyz: NDArray[np.float64],
    values: NDArray[np.float64],
    view: View,
    low: NDArray[np.float64],
    high: NDArray[np.float64],
    ramp: str,
    ends: tuple[float, float],
    is_sparse: bool = False,
) -> None:
    """Draw the mean of the values in each cell by a ramp of colours; grey where all of them are NaN.

    Sparse values are of a few chosen places that are spread evenly: cells are as small as those are near.
    """
    from matplotlib.colors import Normalize

    from tmchho.report.colours import FAINT, colour_map, rgba

    known = np.isfinite(values)
    if is_sparse:
        edge = _edge(xyz, view, low, high, _PLACES_PER_CELL)
    else:
        edge = _edge(xyz[known], view, low, high, _POINTS_PER_MEAN)
    cells, shape = _cells(xyz, view, low, high, edge)
    n_cells = shape[0] * shape[1]
    counted, others = cells[known & (cells >= 0)], cells[~known & (cells >= 0)]
    counts = np.bincount(counted, minlength=n_cells)
    sums = np.bincount(counted, weights=values[known & (cells >= 0)], minlength=n_cells)
    shades = np.zeros((n_cells, 4))
    shades[others] = rgba(FAINT, 0.35)
    filled = counts > 0
    shades[filled] = colour_map(ramp)(Normalize(*ends)(sums[filled] / counts[filled]))
    _show(panel, shades.reshape(*shape, 4), edge, low, high)


def paint_colours(
    panel: Axes,
    xyz: NDArray[np.float64],
    which: NDArray[np.int64],
    palette: NDArray[np.float64],
    view: View,
    low: NDArray[np.float64],
    high: NDArray[np.float64],
) -> None:
    """Draw each cell in the colour of one of its points, the same chance for each colour that is there.

    `which` is the row of each point's colour in the `palette`.
    """
    edge = _edge(xyz, view, low, high, _POINTS_PER_CELL)
    cells, shape = _cells(xyz, view, low, high, edge)
    there = np.unique((cells * len(palette) + which)[cells >= 0])
    # The last one drawn is seen: shuffled, no colour has the better of another.
    there = np.random.default_rng(0).permutation(there)
    shades = np.zeros((shape[0] * shape[1], 4))
    shades[there // len(palette)] = palette[there % len(palette)]
    _show(panel, shades.reshape(*shape, 4), edge, low, high)


def _edge(
    xyz: NDArray[np.float64],
    view: View,
    low: NDArray[np.float64],
    high: NDArray[np.float64],
    per_cell: float,
) -> float:
    """Return the edge of cells small enough to show much, and large enough to hold so many points."""
    n_along = _MAX_CELLS
    while True:
        edge = float((high - low).max()) / n_along
        cells, _ = _cells(xyz, view, low, high, edge)
        inside = cells[cells >= 0]
        n_filled = np.count_nonzero(np.bincount(inside)) if len(inside) else 0
        if n_along <= _MIN_CELLS or n_filled * per_cell <= len(inside):
            return edge
        # So many cells would hold the points if they lay evenly; they never do quite.
        n_along = int(n_along * min(0.85, (len(inside) / (n_filled * per_cell)) ** 0.5))


def _cells(
    xyz: NDArray[np.float64],
    view: View,
    low: NDArray[np.float64],
    high: NDArray[np.float64],
    edge: float,
) -> tuple[NDArray[np.int64], tuple[int, int]]:
    """Return for each point the number of its cell, -1 outside, and rows and columns of cells."""
    seen = xyz[:, [view.across, view.up]]
    inside = ((seen >= low) & (seen < high)).all(axis=1)
    columns, rows = (max(1, int(np.ceil(side / edge - 1e-9))) for side in high - low)
    at = np.floor((seen - low) / edge).astype(np.int64)
    cells = np.clip(at[:, 1], 0, rows - 1) * columns + np.clip(at[:, 0], 0, columns - 1)
    return np.where(inside, cells, -1), (rows, columns)


def _show(
    panel: Axes,
    picture: NDArray[np.float64],
    edge: float,
    low: NDArray[np.float64],
    high: NDArray[np.float64],
) -> None:
    rows, columns = picture.shape[:2]
    panel.imshow(
        picture,
        origin="lower",
        extent=(low[0], low[0] + columns * edge, low[1], low[1] + rows * edge),
        aspect="equal",
    )
    panel.set_xlim(low[0], high[0])
    panel.set_ylim(low[1], high[1])
