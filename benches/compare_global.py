"""Global registration side by side on the same clouds: KISS-Matcher, Open3D and tmchho.

    python benches/compare_global.py [PAIRS.json …] [--starts 20] [--site 1] [--threads 1 2] [--paper]

Needs the extra `peers`. Without pairs files those of `TMCHHO_DATA` are taken, if it is set, and the
simulated site. Start i turns the source of a pair over all of SO(3) and shifts it by up to one diagonal of
the target with seed i; all methods get the same clouds, one after the other in one process. A pose is right
within the tolerance of its pair, by default 2° and 1 % of the target's diagonal: as each method gives it,
and after one point-to-plane ICP that is the same for all. The voxel of the peers is a share of the target's
diagonal. "tmchho, search" is the best pose before the fine stage, with the seconds until there; "tmchho" is
all of `tmchho.register`, fine stage, verdict and evaluation at full density included. Times are medians; in
brackets those of the processor, which a busy machine changes little. TEASER++ is left out: it has no package
that installs. The table goes to standard output as Markdown.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from common import Array, pair_by_name, pair_names, run_all
from peers import KISS_MATCHER, PAPER, PEERS, CommonIcp, missing_packages, paper_mode

import tmchho

SEARCH, WHOLE = "tmchho, search", "tmchho"
SEARCH_STAGES = ("outliers", "voxel", "keypoints", "coarse")


@dataclass(frozen=True)
class Case:
    """One start of one pair; the pair is a pairs file and a name in it, or a seed of the simulated site."""

    file: str
    name: str
    seed: int
    n_threads: int
    voxel_share: float
    with_paper: bool


@dataclass(frozen=True, eq=False)
class Answer:
    """A pose and what it took; the CPU seconds tell that of a busy machine, too."""

    pose: Array
    seconds: float
    cpu_seconds: float


def timed(method: Callable[[], tuple[Array, float]]) -> Answer:
    """Run a method; the processor's time for what it does not count itself is left out in proportion."""
    cpu, began = time.process_time(), time.perf_counter()
    pose, seconds = method()
    cpu, elapsed = time.process_time() - cpu, time.perf_counter() - began
    return Answer(pose, seconds, cpu * seconds / elapsed)


def run_once(case: Case) -> dict[str, Any]:
    pair = pair_by_name(case.file, case.name)
    source, wanted = pair.start(case.seed)
    voxel = case.voxel_share * pair.diagonal
    methods = {**PEERS, **({PAPER: paper_mode} if case.with_paper else {})}
    answers = {
        name: timed(partial(method, source, pair.target, voxel, case.seed))
        for name, method in methods.items()
    }
    found: list[tmchho.Registration] = []

    def register() -> tuple[Array, float]:
        found.append(
            tmchho.register(source, pair.target, seed=case.seed, config={"n_threads": case.n_threads})
        )
        return found[0].transformation, found[0].seconds

    whole = timed(register)
    coarse = sum(stage.seconds for stage in found[0].stages if stage.name in SEARCH_STAGES)
    coarse_cpu = whole.cpu_seconds * coarse / whole.seconds
    answers[SEARCH] = Answer(found[0].candidates[0].transformation, coarse, coarse_cpu)
    answers[WHOLE] = whole
    icp = CommonIcp(source, pair.target)
    return {
        "verdict": found[0].verdict,
        "methods": {
            name: {
                "before": pair.is_right(answer.pose, wanted, source),
                "after": pair.is_right(icp.refine(answer.pose), wanted, source),
                "seconds": answer.seconds,
                "cpu_seconds": answer.cpu_seconds,
            }
            for name, answer in answers.items()
        },
    }


def rows(pair: str, runs: dict[int, list[dict[str, Any]]]) -> list[str]:
    """Return a row for each method; the runs are those of each number of threads."""
    table = []
    for name in next(iter(runs.values()))[0]["methods"]:
        every = [run["methods"][name] for some in runs.values() for run in some]
        before, after = (sum(run[when] for run in every) for when in ("before", "after"))
        times, ratios = [], []
        for some in runs.values():
            wall, cpu, their_wall, their_cpu = (
                float(np.median([run["methods"][method][clock] for run in some]))
                for method in (name, KISS_MATCHER)
                for clock in ("seconds", "cpu_seconds")
            )
            times.append(f"{wall:.2f} ({cpu:.2f})")
            ratios.append(f"{wall / their_wall:.2f} ({cpu / their_cpu:.2f})")
        table.append(
            f"| {pair} | {name} | {before}/{len(every)} | {after}/{len(every)} "
            f"| {' | '.join(times)} | {' | '.join(ratios)} |"
        )
    return table


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("pairs", type=Path, nargs="*", help="pairs files; see benches/common.py")
    parser.add_argument("--starts", type=int, default=20, help="random poses of each pair (default 20)")
    parser.add_argument("--site", type=int, default=1, help="simulated sites, 0 for none (default 1)")
    parser.add_argument("--threads", type=int, nargs="+", default=[1, 2], help="default 1 2")
    parser.add_argument("--voxel", type=float, default=0.015, help="of the target's diagonal (default 0.015)")
    parser.add_argument("--paper", action="store_true", help="the plain paper mode, too; slow")
    parser.add_argument("--only", nargs="+", help="only pairs of these names")
    parser.add_argument("--json", type=Path, help="JSON lines to keep the runs in, and to resume from")
    options = parser.parse_args()
    if missing_packages():
        parser.error(
            f"{' and '.join(missing_packages())} cannot be imported; run: pip install 'tmchho[peers]'"
        )
    names = pair_names(options.pairs, options.site, options.only)
    first = Case("", "", 0, 1, options.voxel, options.paper)
    by_pair: dict[str, dict[int, list[dict[str, Any]]]] = defaultdict(lambda: defaultdict(list))
    processors = sorted(os.sched_getaffinity(0))
    for n_threads in options.threads:
        if n_threads > len(processors):
            parser.error(f"{n_threads} threads asked for, but only {len(processors)} processors to be had")
        # The libraries take their number of threads from the processors they may use, or from this.
        os.sched_setaffinity(0, processors[:n_threads])
        os.environ["OMP_NUM_THREADS"] = str(n_threads)
        cases = [
            replace(first, file=file, name=name, seed=seed, n_threads=n_threads)
            for file, name in names
            for seed in range(options.starts)
        ]
        for record in run_all(run_once, cases, key_of, options.json, 1):
            by_pair[record["key"][0]][n_threads].append(record)
    os.sched_setaffinity(0, processors)
    threads = " | ".join(
        f"s (CPU s), {n} threads" if n > 1 else "s (CPU s), 1 thread" for n in options.threads
    )
    ratios = " | ".join(f"by KISS-Matcher's, {n}" for n in options.threads)
    print(f"| pair | method | right before ICP | after ICP | {threads} | {ratios} |")
    print("|---|---|" + "---|" * (2 + 2 * len(options.threads)))
    everything: dict[int, list[dict[str, Any]]] = defaultdict(list)
    for pair, runs in by_pair.items():
        print("\n".join(rows(pair, runs)))
        for n_threads, some in runs.items():
            everything[n_threads] += some
    print("\n".join(rows("**all**", everything)))
    return 0


def key_of(case: Case) -> tuple[object, ...]:
    return case.name, case.n_threads, case.seed, case.voxel_share, case.with_paper


if __name__ == "__main__":
    sys.exit(main())
