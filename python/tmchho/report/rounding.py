"""Round numbers for the ends of legends and the thickness of cuts."""

from __future__ import annotations

import math


def nice_ceiling(value: float) -> float:
    """Return a round number that is not below a value, 1 for what is not above 0.

    Examples
    --------
    >>> nice_ceiling(0.349), nice_ceiling(1.9), nice_ceiling(0.0)
    (0.35, 2.0, 1.0)
    """
    if not value > 0:
        return 1.0
    power = 10.0 ** math.floor(math.log10(value))
    steps = (1, 1.2, 1.5, 2, 2.5, 3, 3.5, 4, 5, 6, 8, 10)
    return float(f"{next(step for step in steps if step * power >= value * (1 - 1e-9)) * power:.12g}")
