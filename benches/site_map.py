"""Where the registration of the simulated dam site succeeds: a map over area, overlap, density and noise.

    python benches/site_map.py [--starts 2] [--areas 1 4 16] [--overlaps 0.8 0.6 0.4 0.3]
        [--densities 1 10 50] [--noises 0.04 1] [--outliers 0.01 0.3] [--dof 6] [--levelled]
        [--json runs.jsonl]

A cell of the map is a product of an area (photogrammetry by scanner, the scanner off centre), an overlap
(of the scanner's area, the smaller one), a density ratio (scanner by photogrammetry), noise of the
photogrammetry (as a share of the voxel edge, on level ground; steep faces have up to two and a half times as
much) and a share of outliers (in both clouds). Start i of a cell makes site, surveys and pose from seed i;
with --levelled, and always with --dof 4, both clouds are levelled and the source is turned about the vertical
only.
The error is the root mean squared displacement of the scanner's points, which every pose has to bring to
their place. "Near" is within 2° and 1 % of the scanner's diagonal, "close" within a third of the voxel edge.
The table goes to standard output as Markdown. With --json every run is kept as a line of JSON, and a second
call goes on where the first ended.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import astuple, dataclass
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from common import (
    TOLERANCE_BY_DIAGONAL,
    TOLERANCE_DEG,
    angle_deg,
    diagonal_of,
    moved,
    pose_away,
    run_all,
    verdict_counts,
)

import tmchho
from tmchho.simulate import SimulatedPair, make_pair

SIZE_M = 120.0
# The voxel edge that the registration chooses for a scanner's area of that size, about.
VOXEL_M = 0.75
N_SCANNER_POINTS = 100_000


@dataclass(frozen=True)
class Case:
    """One run of one cell."""

    area: float
    overlap: float
    density: float
    noise: float
    outliers: float
    dof: int
    levelled: bool
    seed: int


def survey(case: Case) -> SimulatedPair:
    """Make the two surveys of a run, around the site's own origin."""
    return make_pair(
        size_m=SIZE_M,
        area_ratio=case.area,
        overlap=case.overlap,
        density_ratio=case.density,
        n_scanner_points=N_SCANNER_POINTS,
        photogrammetry_noise_m=case.noise * VOXEL_M,
        photogrammetry_outlier_share=case.outliers,
        scanner_outlier_share=case.outliers,
        national_grid=False,
        seed=case.seed,
    )


def run_once(case: Case, n_threads: int | None) -> dict[str, Any]:
    pair = survey(case)
    source, target, truth = pair.source.xyz, pair.target.xyz, pair.target_from_source
    if case.levelled:
        upright = np.eye(4)
        upright[:3, :3] = truth[:3, :3]
        away = pose_away(case.seed, diagonal_of(target), dof=4) @ upright
        source, truth = moved(away, source), truth @ np.linalg.inv(away)
    config = {"n_threads": n_threads, "dof": case.dof}
    found = tmchho.register(source, target, seed=case.seed, config=config)
    # Where the scanner's points come to lie, seen from where they belong.
    difference = found.transformation @ np.linalg.inv(truth)
    error_m = float(np.sqrt(np.mean(np.sum((moved(difference, target) - target) ** 2, axis=1))))
    is_near = angle_deg(
        difference[:3, :3]
    ) <= TOLERANCE_DEG and error_m <= TOLERANCE_BY_DIAGONAL * diagonal_of(target)
    area = pair.site.photogrammetry_area
    return {
        "n_points": [len(pair.source), len(pair.target)],
        "overlap_of_points": float(np.mean(area.contains(target[:, 0], target[:, 1]))),
        "verdict": found.verdict,
        "is_near": is_near,
        "is_close": error_m <= found.voxel_size / 3,
        "error_m": error_m,
        "voxel_m": found.voxel_size,
        "share": found.inlier_share,
        "ratio": found.ambiguity_ratio,
        "strength": found.strength,
        "conflict": found.conflict_share,
        "offset": found.surface_offset / found.extent,
        "seconds": found.seconds,
        "reasons": list(found.reasons),
    }


def row(cell: tuple[float, ...], records: list[dict[str, Any]]) -> str:
    near = [record for record in records if record["is_near"]]
    far = [record for record in records if not record["is_near"]]
    n_close = sum(record["is_close"] for record in records)
    seconds = [record["seconds"] for record in records]
    error = np.median([record["error_m"] / record["voxel_m"] for record in near]) if near else float("nan")
    area, overlap, density, noise, outliers, *_ = cell
    shared = np.mean([record["overlap_of_points"] for record in records])
    return (
        f"| {area:g} | {overlap:.0%} ({shared:.0%}) | 1:{density:g} | {noise:g} | {outliers:.0%} "
        f"| {len(near)}/{len(records)} | {n_close}/{len(records)} | {verdict_counts(near)} "
        f"| {verdict_counts(far)} | {error:.3f} | {np.median(seconds):.2f} | {max(seconds):.2f} |"
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--starts", type=int, default=2, help="sites and poses for each cell (default 2)")
    parser.add_argument("--areas", type=float, nargs="+", default=[1.0, 4.0, 16.0], help="1 to 16")
    parser.add_argument("--overlaps", type=float, nargs="+", default=[0.8, 0.6, 0.4, 0.3], help="0.3 to 1")
    parser.add_argument(
        "--densities", type=float, nargs="+", default=[1.0, 10.0, 50.0], help="scanner by other"
    )
    parser.add_argument("--noises", type=float, nargs="+", default=[0.04, 1.0], help="of the voxel edge")
    parser.add_argument("--outliers", type=float, nargs="+", default=[0.01, 0.3], help="share, 0 to 0.5")
    parser.add_argument("--dof", type=int, choices=[4, 6], default=6, help="degrees of freedom")
    parser.add_argument(
        "--levelled", action="store_true", help="as surveys are, with 6 degrees of freedom too"
    )
    parser.add_argument("--processes", type=int, default=1, help="runs at a time (default 1)")
    parser.add_argument("--threads", type=int, help="threads of each run (default: all)")
    parser.add_argument("--json", type=Path, help="JSON lines to keep the runs in, and to resume from")
    options = parser.parse_args()
    axes = (options.areas, options.overlaps, options.densities, options.noises, options.outliers)
    frames = (options.dof, options.levelled or options.dof == 4)
    cases = [Case(*cell, *frames, seed) for cell in product(*axes) for seed in range(options.starts)]
    by_cell: dict[tuple[float, ...], list[dict[str, Any]]] = {astuple(case)[:-1]: [] for case in cases}
    job = partial(run_once, n_threads=options.threads)
    for record in run_all(job, cases, astuple, options.json, options.processes):
        by_cell[tuple(record["key"][:-1])].append(record)
        if not record["is_near"]:
            print(f"missed: {record}", file=sys.stderr, flush=True)
    print("| area | overlap (of points) | density | noise | outliers | near | close ", end="")
    print("| near: accepted / review / rejected | missed: accepted / review / rejected ", end="")
    print("| median error / voxel | median s | max s |")
    print("|---|---|---|---|---|---|---|---|---|---|---|---|")
    for cell, records in by_cell.items():
        print(row(cell, records))
    everything = [record for records in by_cell.values() for record in records]
    shared = [record for record in everything if record["overlap_of_points"] >= 0.4]
    for name, some in (("all", everything), ("where 40 % or more of the scanner's points overlap", shared)):
        print(f"\n{name}: near in {sum(record['is_near'] for record in some)} of {len(some)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
