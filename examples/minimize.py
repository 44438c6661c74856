"""Minimise functions by hawks and their rivals: where TMCHHO shines, and where it does not.

Run it with `python examples/minimize.py`.
"""

import numpy as np
from numpy.typing import NDArray

import tmchho

# Rastrigin's function, and the same with its lowest point elsewhere, by another amount along each axis.
shift = np.linspace(-3.1, 2.7, 10)
at_origin = tmchho.BenchmarkProblem("f5", 10)
elsewhere = tmchho.BenchmarkProblem("f5", 10, shift=shift)

for method in ("hho", "tmchho", "tmchho_free", "pso"):
    values = [
        tmchho.minimize(problem, method=method, max_evaluations=4000, seed=1).fun
        for problem in (at_origin, elsewhere)
    ]
    print(f"{method:12} at the origin: {values[0]:8.1e}, shifted: {values[1]:5.1f}")


# A function of one's own, which takes many points at once.
def valley(points: NDArray[np.float64]) -> NDArray[np.float64]:
    x, y = points.T
    values: NDArray[np.float64] = (1 - x) ** 2 + 100 * (y - x**2) ** 2
    return values


found = tmchho.minimize(valley, [(-2, 2), (-1, 3)], method="tmchho_free", vectorized=True, seed=1)
print(f"valley: {found.fun:.1e} at {found.x.round(2)} after {found.nfev} calls")

# The same, evaluated elsewhere: a search asks for values and is told them.
search = tmchho.Optimizer([(-2, 2), (-1, 3)], method="tmchho_free", seed=1)
while not search.done:
    search.tell(valley(search.ask()))
assert search.result.fun == found.fun
