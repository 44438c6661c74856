"""The simulated dam site, registered and fused from random poses: error, time and memory by seed.

    python benches/register_site.py [--runs 10] [--area-ratio 4] [--overlap 1]

Each seed makes another site, survey and pose. The error is the root mean squared displacement of all
source points against the known pose, in metres and as a share of the voxel edge. Times are those of
`tmchho.register` and `tmchho.fuse` on arrays in memory. The table goes to standard output as Markdown.
"""

from __future__ import annotations

import argparse
import resource
import sys
import time

import numpy as np

import tmchho
from tmchho.simulate import make_pair


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--runs", type=int, default=10, help="seeds 0 … runs − 1 (default 10)")
    parser.add_argument("--area-ratio", type=float, default=4.0, help="photogrammetry area by scanner area")
    parser.add_argument("--overlap", type=float, default=1.0, help="share of the scanner's area covered")
    options = parser.parse_args()
    print("| seed | verdict | ambiguity ratio | error m | error / voxel | register s | fuse s |")
    print("|---|---|---|---|---|---|---|")
    n_right = 0
    for seed in range(options.runs):
        pair = make_pair(area_ratio=options.area_ratio, overlap=options.overlap, seed=seed)
        began = time.perf_counter()
        found = tmchho.register(pair.source, pair.target, seed=seed)
        registered = time.perf_counter()
        tmchho.fuse(pair.source, pair.target, found)
        fused = time.perf_counter()
        truth = pair.target_from_source
        wanted = pair.source.xyz @ truth[:3, :3].T + truth[:3, 3]
        error = float(np.sqrt(np.mean(np.sum((found.apply(pair.source.xyz) - wanted) ** 2, axis=1))))
        n_right += error < found.voxel_size / 3
        print(
            f"| {seed} | {found.verdict} | {found.ambiguity_ratio:.2f} | {error:.4f} "
            f"| {error / found.voxel_size:.3f} | {registered - began:.1f} | {fused - registered:.1f} |",
            flush=True,
        )
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    print(
        f"\nwithin a third of the voxel edge: {n_right} of {options.runs}; peak memory {peak:.2f} GiB",
        file=sys.stderr,
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
