"""M3C2 of this package and of py4dgeo on the same clouds, cores and lengths, in one run.

Usage: python benches/compare_m3c2.py [--points N] [--cores N] [--repeats N] [--json]

The two take turns, so that a busy machine disturbs both alike; medians of wall and processor seconds count.
Each measures everything: indices, normals, distances, levels of detection. Both use all processors. Exits
with 1 where a distance or a level of detection differs by more than 1e-6.
"""

from __future__ import annotations

import argparse
import json
import logging
import os
import sys
import tempfile
import time
from collections.abc import Callable
from importlib.metadata import version
from typing import Any

import numpy as np
from numpy.typing import NDArray

import tmchho

SIDE_M = 100.0
LENGTHS = {"normal_radius": 1.0, "cylinder_radius": 0.5, "max_depth": 2.5, "registration_error": 0.01}

Result = tuple[NDArray[np.float64], NDArray[np.float64]]


def ground(n_points: int, lift_m: float, seed: int) -> NDArray[np.float64]:
    rng = np.random.default_rng(seed)
    xy = rng.uniform(0, SIDE_M, (n_points, 2))
    z = 2 * np.sin(xy[:, 0] / 7) * np.cos(xy[:, 1] / 9) + lift_m + rng.normal(0, 0.02, n_points)
    return np.column_stack([xy, z])


def ours(before: Any, after: Any, cores: Any) -> Result:
    change = tmchho.m3c2(
        after,
        before,
        cores=cores,
        normal_radii=[LENGTHS["normal_radius"]],
        cylinder_radius=LENGTHS["cylinder_radius"],
        max_depth=LENGTHS["max_depth"],
        registration_error=LENGTHS["registration_error"],
    )
    return change.distance, change.level_of_detection


def theirs(before: Any, after: Any, cores: Any) -> Result:
    import py4dgeo

    judge = py4dgeo.M3C2(
        epochs=(py4dgeo.Epoch(before), py4dgeo.Epoch(after)),
        corepoints=cores,
        normal_radii=[LENGTHS["normal_radius"]],
        cyl_radius=LENGTHS["cylinder_radius"],
        max_distance=LENGTHS["max_depth"],
        registration_error=LENGTHS["registration_error"],
    )
    distances, doubts = judge.run()
    return distances, doubts["lodetection"]


def main() -> int:
    parser = argparse.ArgumentParser(description="Compare M3C2 with py4dgeo's.")
    parser.add_argument("--points", type=int, default=1_000_000)
    parser.add_argument("--cores", type=int, default=100_000)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    os.chdir(tempfile.mkdtemp())  # py4dgeo writes a log where it is imported
    logging.disable(logging.INFO)
    before, after = ground(given.points, 0.0, 1), ground(given.points, -0.03, 2)
    # Not on points: py4dgeo counts one exactly between two segments of its cylinder never or twice.
    cores = before[: given.cores] + 0.001
    methods: dict[str, Callable[[Any, Any, Any], Result]] = {"tmchho": ours, "py4dgeo": theirs}
    seconds: dict[str, list[tuple[float, float]]] = {name: [] for name in methods}
    results: dict[str, Result] = {}
    for repeat in range(given.repeats + 1):
        for name, method in methods.items():
            wall, processor = time.perf_counter(), time.process_time()
            results[name] = method(before, after, cores)
            if repeat:  # the first round warms up
                seconds[name].append((time.perf_counter() - wall, time.process_time() - processor))
    medians = {name: np.median(taken, axis=0) for name, taken in seconds.items()}
    apart = max(
        float(np.nanmax(np.abs(a - b))) for a, b in zip(results["tmchho"], results["py4dgeo"], strict=True)
    )
    ratio = medians["py4dgeo"] / medians["tmchho"]
    document = {
        "n_points": given.points,
        "n_cores": given.cores,
        **LENGTHS,
        "seconds": {name: {"wall": wall, "processor": cpu} for name, (wall, cpu) in medians.items()},
        "ratio": {"wall": ratio[0], "processor": ratio[1]},
        "largest_difference_m": apart,
        "versions": {"tmchho": tmchho.__version__, "py4dgeo": version("py4dgeo")},
    }
    if given.json:
        print(json.dumps(document, indent=2))
    else:
        for name, (wall, cpu) in medians.items():
            print(f"{name:8}  {wall:7.3f} s wall  {cpu:7.3f} s processor")
        print(f"ratio     {ratio[0]:7.2f}         {ratio[1]:7.2f}")
        print(f"largest difference {apart:.1e} m")
    return int(apart > 1e-6)


if __name__ == "__main__":
    sys.exit(main())
