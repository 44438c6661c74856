"""The integer grid on which LAS stores coordinates: ``integer * scale + offset``, 32 bits an axis.

Why it matters: a scale of 1 mm flattens a scan of a cup, an offset of zero overflows at national-grid
coordinates, and a new scale for an old file makes every later comparison differ in the last digit.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

logger = logging.getLogger(__name__)

_LIMIT = 2**31 - 1
_USUAL_SCALE = 1e-3  # a millimetre, what survey software writes
_DENSE_SCALE = 1e-4
_DENSE_SPACING = 0.05  # points closer than this deserve the finer of the two
_SMALL_EXTENT = 10.0  # below, an object or degrees: the scale follows the extent
_STEPS_OF_SMALL_EXTENT = 1e7
_FEWEST_STEPS = 1000  # a borrowed grid coarser than this part of the extent would show


@dataclass(frozen=True)
class Grid:
    """Scale and offset, both (3,) arrays."""

    scales: NDArray[np.float64]
    offsets: NDArray[np.float64]

    def steps(self, xyz: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the (n, 3) whole numbers that stand for the coordinates."""
        return np.asarray(np.rint((xyz - self.offsets) / self.scales))

    def holds(self, lowest: NDArray[np.float64], highest: NDArray[np.float64]) -> bool:
        """Return whether everything between two corners fits into 32 bits."""
        return self.holds_steps(self.steps(np.stack([lowest, highest])))

    def holds_steps(self, steps: NDArray[np.float64]) -> bool:
        """Return whether whole numbers fit into 32 bits."""
        return bool(np.isfinite(steps).all() and (np.abs(steps) <= _LIMIT).all())


def new_grid(xyz: NDArray[np.float64]) -> Grid:
    """Return a grid for coordinates that never had one.

    Parameters
    ----------
    xyz : (n, 3) float64 array
        Finite coordinates, at least one point.

    Returns
    -------
    Grid
        A millimetre, or a tenth of it for dense clouds; axes shorter than 10 units get the power of ten
        below a ten-millionth of their extent. The offset is the minimum, rounded down.
    """
    lowest, highest = xyz.min(axis=0), xyz.max(axis=0)
    extents = highest - lowest
    spacing = float(np.linalg.norm(extents[:2])) / np.sqrt(len(xyz))
    usual = _DENSE_SCALE if 0 < spacing < _DENSE_SPACING else _USUAL_SCALE
    scales = np.full(3, usual)
    is_small = (extents > 0) & (extents < _SMALL_EXTENT)
    fine = 10.0 ** np.floor(np.log10(extents[is_small] / _STEPS_OF_SMALL_EXTENT))
    # Finer than this the coordinates themselves have no more digits.
    resolution = np.spacing(np.abs(np.stack([lowest, highest])).max(axis=0))
    scales[is_small] = np.clip(fine, _power_of_ten_above(resolution[is_small]), usual)
    scales[extents == 0] = scales.min()  # a flat axis is as fine as the others
    return fitted_grid(lowest, highest, scales)


def kept_grid(xyz: NDArray[np.float64], scales: Any, offsets: Any, is_own: bool) -> Grid:
    """Return the grid of a file, changed only where it cannot hold the coordinates.

    Parameters
    ----------
    xyz : (n, 3) float64 array
        Finite coordinates, at least one point.
    scales, offsets : (3,) array_like
        As in the file's header.
    is_own : bool
        Whether the coordinates came from that very file, so that its scale cannot be too coarse for them.
    """
    lowest, highest = xyz.min(axis=0), xyz.max(axis=0)
    grid = Grid(np.array(scales, dtype=np.float64), np.array(offsets, dtype=np.float64))
    longest = (highest - lowest).max()
    if not is_own and 0 < longest < _FEWEST_STEPS * np.abs(grid.scales).min():
        fresh = new_grid(xyz)
        logger.info("scale %s is too coarse for an extent of %.6g; using %s", scales, longest, fresh.scales)
        return fresh
    if grid.holds(lowest, highest):
        return grid
    fitted = fitted_grid(lowest, highest, np.abs(grid.scales))
    logger.warning(
        "offset %s cannot reach the coordinates; written with %s", list(offsets), fitted.offsets.tolist()
    )
    return fitted


def fitted_grid(
    lowest: NDArray[np.float64], highest: NDArray[np.float64], scales: NDArray[np.float64]
) -> Grid:
    """Return a grid with round offsets, and coarser scales only if 32 bits are too few for the extent."""
    scales = scales.copy()
    while True:
        grid = Grid(scales, _round_below(lowest, scales))
        fits = np.abs(grid.steps(np.stack([lowest, highest]))).max(axis=0) <= _LIMIT
        if fits.all():
            return grid
        logger.warning("32 bits are too few for an extent of %s at scale %s", highest - lowest, scales)
        scales = np.where(fits, scales, scales * 10)


def _round_below(values: NDArray[np.float64], scales: NDArray[np.float64]) -> NDArray[np.float64]:
    """Round down to whole units, or to a million steps where the unit is too long for 32 bits."""
    step = np.minimum(1.0, scales * 1e6)
    return np.asarray(np.floor(values / step) * step)


def _power_of_ten_above(values: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(10.0 ** np.ceil(np.log10(values)))
