"""Objects made by code, scanned from two sides: for Section 5.2 where the real scans are not at hand."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

# Smaller than the real ones, in metres, so that a search takes seconds, and as densely scanned.
_RADIUS = 0.02
_SPACING = 0.001
_NOISE = 0.0001
_N_BUMPS = 40
# Each scan sees what is within this angle of its direction; the two are as far apart as those of a real pair.
_VIEW_RAD = np.radians(75.0)
_APART_RAD = np.radians(30.0)


def scan_object(seed: int, side: str) -> NDArray[np.float64]:
    """Return a scan of a lumpy ball; both sides are in one frame.

    Parameters
    ----------
    seed : int
        Which object.
    side : {'left', 'right'}
        From where: 30° apart. What hides what is not considered; the scan ends 75° from its direction.

    Returns
    -------
    (n, 3) float64 array
        In metres, with 0.1 mm of noise.
    """
    shape = np.random.default_rng([seed, 1])
    middles = _directions(shape, _N_BUMPS)
    heights = shape.uniform(-0.25, 0.35, _N_BUMPS)
    widths = shape.uniform(0.15, 0.6, _N_BUMPS)

    drawn = np.random.default_rng([seed, 2, ("left", "right").index(side)])
    # About four points to a voxel of the experiments.
    on_ball = _directions(drawn, round(16 * np.pi * (_RADIUS / _SPACING) ** 2))
    turn = (0.5 if side == "right" else -0.5) * _APART_RAD
    seen = on_ball[on_ball @ [np.cos(turn), np.sin(turn), 0.0] > np.cos(_VIEW_RAD)]
    distances_sq = 2.0 - 2.0 * seen @ middles.T
    radii = _RADIUS * (1.0 + np.exp(-distances_sq / (2.0 * widths**2)) @ heights)
    return np.asarray(seen * radii[:, None] + drawn.normal(0.0, _NOISE, seen.shape))


def _directions(rng: np.random.Generator, n: int) -> NDArray[np.float64]:
    """Draw unit vectors, even over all directions."""
    vectors = rng.standard_normal((n, 3))
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))
