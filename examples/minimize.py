"""Minimise functions by hawks: where TMCHHO shines, and where it does not.

Run it with `python examples/minimize.py`.
"""

import numpy as np

import tmchho

bounds = [(-5.12, 5.12)] * 10


def rastrigin(x):
    return float(np.sum(x**2 - 10 * np.cos(2 * np.pi * x) + 10))


# The lowest point away from the origin, by another amount along each axis.
shift = np.linspace(-3.1, 2.7, 10)

for method in ("hho", "tmchho"):
    at_origin = tmchho.minimize(rastrigin, bounds, method=method, n_iterations=100, seed=1)
    elsewhere = tmchho.minimize(
        lambda x: rastrigin(x - shift), bounds, method=method, n_iterations=100, seed=1
    )
    print(
        f"{method:7} {at_origin.nfev} calls; at the origin: {at_origin.fun:.1e}, shifted: {elsewhere.fun:.1f}"
    )
