"""Success rate and time of the registration on every pair of a pairs file, from random poses.

    python benches/register_pairs.py PAIRS.json [--runs 20] [--mode robust] [--dof 6] [--level easy]

A pairs file is described in benches/common.py. Each run turns the source by a random rotation over all
of SO(3) and shifts it by up to one diagonal of the target; run i uses seed i for that and for the
search. With --dof 4 the source is turned about the vertical only, and only pairs that name 4 under `dof`
are run; with --dof 7 it also shrinks or grows by a random factor of 0.5 to 2, which has to be found to
0.5 %. The translation error is taken at the middle of the source. Times are those of `tmchho.register` on
arrays in memory. The table goes to standard output as Markdown. With --json every run is kept as a line of
JSON, and a second call goes on where the first ended.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from common import pair_by_name, pose_errors, run_all, scale_of, verdict_counts

import tmchho


@dataclass(frozen=True)
class Case:
    """One registration of one pair from one random pose."""

    file: str
    name: str
    mode: Literal["robust", "paper"]
    dof: int
    seed: int
    n_threads: int | None


def run_once(case: Case) -> dict[str, Any]:
    pair = pair_by_name(case.file, case.name)
    source, wanted = pair.start(case.seed, case.dof)
    config: dict[str, Any] = {"n_threads": case.n_threads}
    if case.dof != 6:
        config["dof"] = case.dof
    found = tmchho.register(source, pair.target, mode=case.mode, seed=case.seed, config=config)
    rotation_deg, translation = pose_errors(found.transformation, wanted, source)
    return {
        "is_right": pair.is_right(found.transformation, wanted, source),
        "verdict": found.verdict,
        "rotation_deg": rotation_deg,
        "translation": translation,
        "scale_error": scale_of(found.transformation) / scale_of(wanted) - 1.0,
        "share": found.inlier_share,
        "ratio": found.ambiguity_ratio,
        "seconds": found.seconds,
    }


def row(name: str, runs: list[dict[str, Any]]) -> str:
    right = [run for run in runs if run["is_right"]]
    wrong = [run for run in runs if not run["is_right"]]
    worst_deg = max((run["rotation_deg"] for run in right), default=float("nan"))
    worst = max((run["translation"] for run in right), default=float("nan"))
    seconds = [run["seconds"] for run in runs]
    return (
        f"| {name} | {len(right)}/{len(runs)} | {verdict_counts(right)} | {verdict_counts(wrong)} "
        f"| {worst_deg:.2f} | {worst:.3g} | {np.median(seconds):.2f} | {max(seconds):.2f} |"
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("pairs", type=Path, help="the pairs file")
    parser.add_argument("--runs", type=int, default=20, help="random poses for each pair (default 20)")
    parser.add_argument("--mode", choices=["robust", "paper"], default="robust")
    parser.add_argument("--dof", type=int, choices=[4, 6, 7], default=6, help="degrees of freedom")
    parser.add_argument("--level", help="only pairs of this level")
    parser.add_argument("--only", nargs="+", help="only pairs of these names")
    parser.add_argument("--threads", type=int, help="default: all")
    parser.add_argument("--json", type=Path, help="JSON lines to keep the runs in, and to resume from")
    options = parser.parse_args()
    pairs = json.loads(options.pairs.read_text())
    if options.level:
        pairs = [pair for pair in pairs if pair.get("level") == options.level]
    if options.dof == 4:
        pairs = [pair for pair in pairs if 4 in pair.get("dof", [])]
    names = [pair["name"] for pair in pairs if not options.only or pair["name"] in options.only]
    cases = [
        Case(str(options.pairs), name, options.mode, options.dof, seed, options.threads)
        for name in names
        for seed in range(options.runs)
    ]
    print("| pair | right | right: accepted / review / rejected ", end="")
    print("| wrong: accepted / review / rejected | worst right, ° | worst right, unit of the files ", end="")
    print("| median s | max s |")
    print("|---|---|---|---|---|---|---|---|")
    by_name: dict[str, list[dict[str, Any]]] = defaultdict(list)
    for record in run_all(
        run_once, cases, lambda case: (case.name, case.mode, case.dof, case.seed), options.json, 1
    ):
        runs = by_name[record["key"][0]]
        runs.append(record)
        if len(runs) == options.runs:
            print(row(record["key"][0], runs), flush=True)
    every = [run for runs in by_name.values() for run in runs]
    n_right = sum(run["is_right"] for run in every)
    n_false = sum(run["verdict"] == "accepted" and not run["is_right"] for run in every)
    print(f"\nright {n_right} of {len(every)}; wrong but accepted {n_false}", file=sys.stderr)
    if options.dof == 7:
        errors = [abs(run["scale_error"]) for run in every if run["is_right"]]
        print(f"worst scale error of those right {max(errors, default=float('nan')):.3%}", file=sys.stderr)
    return 0


if __name__ == "__main__":
    sys.exit(main())
