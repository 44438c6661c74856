"""Kernels side by side on the same arrays in one run: tmchho and the libraries of the extra `peers`.

    python benches/compare_peers.py [--only GROUP …] [--peers NAME …] [--sizes N …] [--repeat 5]
        [--threads 1 2] [--json FILE] [-o benches/RESULTS.md]

Clouds are surveys of the simulated dam site. Every library runs in a process of its own, kept to as many
processors as it may use threads; the processes take turns, round by round, so that a load hits all alike.
Times are medians over the rounds, from numpy arrays to numpy arrays, so trees, normals and conversions are in
them; beside them stand the processor's seconds of all threads. Memory is the peak above what the process
held before the first call, clouds not counted.

The ratio is the median of the fastest library with the same answer by ours; where a faster one has another
answer, its ratio stands beside it. ICP: every library is run from coarse to fine until its error, the root
mean squared displacement against the known pose, stays within a tenth of what the worst of them ends with;
that setting is timed. PCL and CloudCompare come without a package for Python and are left out.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import kernel_nearest  # noqa: F401 - makes its kernels known
import numpy as np
from kernel_checks import Agreement, Judge
from kernel_peers import ICP_STEPS, KERNELS, MODULES, US, is_installed
from kernel_rows import GROUPS, GROWTH_KERNELS, GROWTH_SIZES, ICP_KERNELS, ROWS, Row, Scene, rows_of, scene_of
from kernel_run import Runs, coarsest_that_arrive, run_side_by_side
from kernel_tables import Report, machine

# The error at which ICP has arrived, by what the worst library ends with.
ICP_ARRIVED = 1.1


@dataclass(frozen=True, eq=False)
class Measured:
    """One row: what each library took at each number of threads, and whether it said the same."""

    row: Row
    runs: dict[int, list[Runs]]
    agreements: dict[tuple[str, int], Agreement]
    missing: tuple[str, ...]


def kept(scene: Scene, folder: Path) -> Path:
    """Write the clouds where the workers find them."""
    clouds = folder / "clouds"
    clouds.mkdir()
    for name, cloud in scene.clouds.items():
        np.save(clouds / f"{name}.npy", cloud)
    return clouds


def icp_settings(
    row: Row, libraries: Sequence[str], scene: Scene, clouds: Path, patience: float
) -> dict[str, dict[str, Any]]:
    """Return for each library the coarsest settings with which it arrives where all of them do."""
    judge = Judge(row.kernel, scene.clouds, scene.settings, scene.truth)
    steps = {name: ICP_STEPS[name] for name in libraries}
    largest, chosen = coarsest_that_arrive(
        row.kernel, steps, scene.settings, clouds, patience, judge.pose_error, ICP_ARRIVED
    )
    return {name: {**scene.settings, "largest_error": largest, "step": chosen[name]} for name in libraries}


def measure(row: Row, peers: Sequence[str], threads: Sequence[int], rounds: int, patience: float) -> Measured:
    scene = scene_of(row)
    libraries = [name for name in KERNELS[row.kernel] if name == US or name in peers]
    missing = tuple(dict.fromkeys(MODULES[name] for name in libraries if not is_installed(name)))
    with tempfile.TemporaryDirectory() as folder:
        clouds = kept(scene, Path(folder))
        settings = {name: dict(scene.settings) for name in libraries if is_installed(name)}
        if row.kernel in ICP_KERNELS and not peers:
            settings[US].update(step=ICP_STEPS[US][0], largest_error=np.inf)
        elif row.kernel in ICP_KERNELS:
            settings = icp_settings(row, list(settings), scene, clouds, patience)
        runs = {n: run_side_by_side(row.kernel, settings, n, clouds, rounds, patience) for n in threads}
    judge = Judge(row.kernel, scene.clouds, settings[US], scene.truth)
    agreements = {
        (run.library, n): judge.check(run.library, run.answer)
        for n, some in runs.items()
        for run in some
        if run.answer
    }
    return Measured(row, runs, agreements, missing)


def growth_rows(sizes: Sequence[int] | None) -> Iterator[Row]:
    titles = {row.kernel: row.title for row in reversed(ROWS)}
    for kernel in GROWTH_KERNELS:
        for n in sizes or GROWTH_SIZES:
            yield Row("growth", kernel, titles[kernel], n, None)


def without_files(arguments: Sequence[str]) -> list[str]:
    """Leave out where the results go, which says nothing of what was measured."""
    files = ("--json", "-o", "--output")
    before = ["", *arguments][: len(arguments)]
    return [
        now for last, now in zip(before, arguments, strict=True) if now not in files and last not in files
    ]


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", nargs="+", choices=GROUPS, default=list(GROUPS), help="groups of rows")
    peers = [name for name in MODULES if name != US]
    parser.add_argument("--peers", nargs="*", choices=peers, default=peers, help="libraries beside ours")
    parser.add_argument("--sizes", type=int, nargs="+", help="points, in place of those of the rows")
    parser.add_argument("--repeat", type=int, default=5, help="rounds (default 5)")
    parser.add_argument("--threads", type=int, nargs="+", default=[1, 2], help="default 1 2")
    parser.add_argument("--patience", type=float, default=120.0, help="seconds for one call (default 120)")
    parser.add_argument("--json", type=Path, help="file for every single time")
    parser.add_argument("-o", "--output", type=Path, help="Markdown file; standard output where not given")
    options = parser.parse_args()
    n_processors = len(os.sched_getaffinity(0))
    if max(options.threads) > n_processors:
        parser.error(
            f"{max(options.threads)} threads asked for, but only {n_processors} processors to be had"
        )
    rows = [(row, options.peers) for row in rows_of(options.only, options.sizes)]
    if "growth" in options.only:
        rows += [(row, []) for row in growth_rows(options.sizes)]
    report = Report(machine(without_files(sys.argv[1:])), options.threads, options.repeat)
    for row, beside in rows:
        print(f"{row.title}, {row.size} …", file=sys.stderr, flush=True)
        threads = [max(options.threads)] if row.group == "growth" else options.threads
        report.add(measure(row, beside, threads, options.repeat, options.patience))
        if options.json is not None:
            options.json.write_text(json.dumps(report.as_json(), indent=1) + "\n")
        if options.output is not None:
            options.output.write_text(report.markdown())
    if options.output is None:
        print(report.markdown())
    return 0


if __name__ == "__main__":
    sys.exit(main())
