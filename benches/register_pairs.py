"""Success rate and time of the registration on every pair of a pairs file, from random poses.

    python benches/register_pairs.py PAIRS.json [--runs 20] [--mode robust] [--level easy]

A pairs file is a JSON list of objects with `name`, `source`, `target` (paths beside the file),
`target_from_source` (the known pose) and, optionally, `tolerance_deg` and `tolerance_m` (default 2°
and 1 % of the target's diagonal) and `level`. Each run turns the source by a random rotation over all
of SO(3) and shifts it by up to one diagonal of the target; run i uses seed i for that and for the
search. The translation error is taken at the middle of the source. Times are those of
`tmchho.register` on arrays in memory. The table goes to standard output as Markdown.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import tmchho
from tmchho.simulate import random_pose

Array = NDArray[np.float64]


@dataclass
class Run:
    """One registration from one random pose."""

    rotation_error_deg: float
    translation_error: float
    verdict: str
    seconds: float
    is_right: bool


def moved(pose: Array, points: Array) -> Array:
    return points @ pose[:3, :3].T + pose[:3, 3]


def angle_deg(rotation: Array) -> float:
    axis = np.array(
        [rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]]
    )
    return float(np.degrees(np.arctan2(np.linalg.norm(axis), np.trace(rotation) - 1.0)))


def run_once(source: Array, target: Array, truth: Array, pair: dict[str, Any], mode: str, seed: int) -> Run:
    diagonal = float(np.linalg.norm(np.ptp(target, axis=0)))
    away = random_pose(np.random.default_rng(seed), diagonal)
    start = moved(away, source)
    wanted = truth @ np.linalg.inv(away)
    began = time.perf_counter()
    found = tmchho.register(start, target, mode=mode, seed=seed)
    seconds = time.perf_counter() - began
    difference = found.transformation @ np.linalg.inv(wanted)
    middle = (start.min(axis=0) + start.max(axis=0))[None] / 2
    translation = float(np.linalg.norm(moved(found.transformation, middle) - moved(wanted, middle)))
    rotation = angle_deg(difference[:3, :3])
    is_right = rotation <= pair.get("tolerance_deg", 2.0) and translation <= pair.get(
        "tolerance_m", 0.01 * diagonal
    )
    return Run(rotation, translation, found.verdict, seconds, is_right)


def row(pair: dict[str, Any], runs: list[Run]) -> str:
    right = [run for run in runs if run.is_right]
    wrong = [run for run in runs if not run.is_right]

    def counts(some: list[Run]) -> str:
        return " / ".join(
            str(sum(run.verdict == v for run in some)) for v in ("accepted", "review", "rejected")
        )

    worst_deg = max((run.rotation_error_deg for run in right), default=float("nan"))
    worst = max((run.translation_error for run in right), default=float("nan"))
    seconds = sorted(run.seconds for run in runs)
    return (
        f"| {pair['name']} | {len(right)}/{len(runs)} | {counts(right)} | {counts(wrong)} "
        f"| {worst_deg:.2f} | {worst:.3g} | {np.median(seconds):.2f} | {seconds[-1]:.2f} |"
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("pairs", type=Path, help="the pairs file")
    parser.add_argument("--runs", type=int, default=20, help="random poses for each pair (default 20)")
    parser.add_argument("--mode", choices=["robust", "paper"], default="robust")
    parser.add_argument("--level", help="only pairs of this level")
    options = parser.parse_args()
    pairs = json.loads(options.pairs.read_text())
    if options.level:
        pairs = [pair for pair in pairs if pair.get("level") == options.level]
    print(
        "| pair | right | right: accepted / review / rejected | wrong: accepted / review / rejected ", end=""
    )
    print("| worst right, ° | worst right, unit of the files | median s | max s |")
    print("|---|---|---|---|---|---|---|---|")
    all_runs: list[Run] = []
    for pair in pairs:
        source, target = (tmchho.read(options.pairs.parent / pair[role]).xyz for role in ("source", "target"))
        source, target = (points[np.isfinite(points).all(axis=1)] for points in (source, target))
        # A grid's origin is taken off first, or the random turn about 0 would throw the source away.
        middle = np.round(target.mean(axis=0))
        truth = np.array(pair["target_from_source"])
        truth[:3, 3] += truth[:3, :3] @ middle - middle
        runs = [
            run_once(source - middle, target - middle, truth, pair, options.mode, seed)
            for seed in range(options.runs)
        ]
        all_runs += runs
        print(row(pair, runs), flush=True)
    n_right = sum(run.is_right for run in all_runs)
    n_false = sum(run.verdict == "accepted" and not run.is_right for run in all_runs)
    print(f"\nright {n_right} of {len(all_runs)}; wrong but accepted {n_false}", file=sys.stderr)
    return 0


if __name__ == "__main__":
    sys.exit(main())
