"""How often a pose of clouds that do not belong together is accepted.

    python benches/false_acceptance.py [--runs 8] [--kinds piers stairs] [--dof 6] [--json runs.jsonl]

Generated pairs (benches/strangers.py), and, where `TMCHHO_DATA` names the folder of real clouds, scans of
different objects, mirrored scans, parts of one cloud that share nothing, and two forest plots. Run i turns
and shifts the source by a random pose and searches, both with seed i; with --dof 4 it is turned about the
vertical only. Piers, stairs and facades have a true
pose: an acceptance there is right, one anywhere else is false. Clouds that `tmchho.register` refuses to take
are counted as rejected. The table goes to standard output as Markdown; every false acceptance is printed in
full below it. With --json every run is kept as a line of JSON, and a second call goes on where the first
ended.
"""

from __future__ import annotations

import argparse
import sys
from collections import defaultdict
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations, product
from pathlib import Path
from typing import Any

import numpy as np
from common import (
    TOLERANCE_BY_DIAGONAL,
    TOLERANCE_DEG,
    Array,
    data_dir,
    diagonal_of,
    finite_points,
    moved,
    pose_away,
    pose_errors,
    run_all,
)
from strangers import MAKERS

import tmchho

OBJECTS = {
    "bunny": ("stanford/bun000.ply", "stanford/bun045.ply"),
    "armadillo": ("stanford/ArmadilloBack_0.ply", "stanford/ArmadilloBack_330.ply"),
    "dragon": ("stanford/dragonStandRight_0.ply", "stanford/dragonStandRight_24.ply"),
    "happy": ("stanford/happyStandRight_0.ply", "stanford/happyStandRight_24.ply"),
    "hippo": ("survey/hippo/hippo1.obj", "survey/hippo/hippo2.obj"),
}
# Clouds wide enough to be cut in two parts.
SCENES = (
    "survey/forest/UAS_Clip.laz",
    "survey/strips/bcts1_strip67.laz",
    "survey/strips/amsterdam_2386_strip56029.laz",
    "survey/facade/s1.pcd",
    "survey/room/room_scan1.pcd",
    "stanford/bun000.ply",
    "stanford/dragonStandRight_0.ply",
)
GAP = 0.04  # between the two parts, of the cloud's longer side


@dataclass(frozen=True)
class Case:
    """One run; `variant` is a number for generated pairs, the files' names for real ones."""

    kind: str
    variant: str
    seed: int
    dof: int


def real_pairs() -> list[tuple[str, str]]:
    """Return kind and variant of the pairs of real clouds; none where there is no folder of them."""
    if data_dir() is None:
        return []
    others = [
        ("other objects", f"{source}|{target}")
        for one, two in combinations(OBJECTS, 2)
        for source, target in product(OBJECTS[one], OBJECTS[two])
    ]
    mirrored = [("mirrored scans", f"{source}|{target}") for target, source in OBJECTS.values()]
    mirrored += [("mirrored scans", f"{cloud}|{cloud}") for cloud in SCENES]
    parts = [("parts without overlap", f"{cloud}|{cloud}") for cloud in SCENES]
    forest = "survey/forest/TLS_Clip.laz|survey/forest/{}_Clip.laz"
    return [*others, *mirrored, *parts, *(("other forest", forest.format(it)) for it in ("UAS", "ALS"))]


def clouds_of(kind: str, variant: str) -> tuple[Array, Array, bool]:
    """Return source, target, and whether they lie in a true place."""
    for number, maker in enumerate(MAKERS):
        if maker.__name__ == kind:
            return maker(np.random.default_rng([number, int(variant)]))
    folder = data_dir()
    assert folder is not None
    source, target = (finite_points(folder / name) for name in variant.split("|"))
    source, target = source - source.mean(axis=0).round(), target - target.mean(axis=0).round()
    if kind == "mirrored scans":
        # By its longest axis: a mirrored level plane would be as level as before.
        source = source * np.where(np.arange(3) == np.argmax(np.ptp(source, axis=0)), -1.0, 1.0)
    if kind == "parts without overlap":
        axis = int(np.argmax(np.ptp(target, axis=0)))
        place = target[:, axis]
        half_gap = GAP / 2 * np.ptp(place)
        source, target = (
            target[place < np.median(place) - half_gap],
            target[place > np.median(place) + half_gap],
        )
    return source, target, False


@lru_cache(maxsize=1)
def cached_clouds(kind: str, variant: str) -> tuple[Array, Array, bool]:
    return clouds_of(kind, variant)


def run_once(case: Case) -> dict[str, Any]:
    source, target, has_truth = cached_clouds(case.kind, case.variant)
    away = pose_away(case.seed, diagonal_of(target), case.dof)
    start = moved(away, source)
    config: dict[str, Any] = {"n_threads": 1}
    if case.dof != 6:
        config["dof"] = case.dof
    try:
        found = tmchho.register(start, target, seed=case.seed, config=config)
    except (tmchho.InvalidCloudError, tmchho.NoSolutionError) as error:
        return {"verdict": "rejected", "share": 0.0, "ratio": 0.0, "seconds": 0.0, "reasons": [str(error)]}
    wanted = np.linalg.inv(away)
    rotation_deg, translation = pose_errors(found.transformation, wanted, start)
    is_right = (
        has_truth
        and rotation_deg <= TOLERANCE_DEG
        and translation <= TOLERANCE_BY_DIAGONAL * diagonal_of(target)
    )
    is_false = found.verdict == "accepted" and not is_right
    return {
        "verdict": found.verdict,
        "is_right": is_right,
        "is_false": is_false,
        "share": found.inlier_share,
        "ratio": found.ambiguity_ratio,
        "strength": found.strength,
        "conflict": found.conflict_share,
        "offset": found.surface_offset / found.extent,
        "overlap": [found.overlap_of_source, found.overlap_of_target],
        "rotation_deg": rotation_deg,
        "translation": translation,
        "seconds": found.seconds,
        "reasons": list(found.reasons),
        "config": found.to_dict()["config"] if is_false else None,
    }


def row(name: str, records: list[dict[str, Any]]) -> str:
    n_false = sum(record.get("is_false", False) for record in records)
    counts = [sum(record["verdict"] == verdict for record in records) for verdict in ("review", "rejected")]
    n_right = sum(record["verdict"] == "accepted" for record in records) - n_false
    largest_share = max(record["share"] for record in records)
    # Without a rival the ratio is infinite, and says nothing; without a result it is 0.
    largest_ratio = max(record["ratio"] for record in records)
    seconds = np.median([record["seconds"] for record in records])
    n_pairs = len({tuple(record["key"][:2]) for record in records})
    return (
        f"| {name} | {n_pairs} | {len(records)} | {n_false} | {n_right} "
        f"| {counts[0]} | {counts[1]} | {largest_share:.2f} | {largest_ratio:.2f} | {seconds:.2f} |"
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--runs", type=int, default=8, help="random poses for each pair (default 8)")
    parser.add_argument("--dof", type=int, default=6, choices=[4, 6], help="degrees of freedom (default 6)")
    parser.add_argument("--kinds", nargs="+", help="only these kinds, as the table calls them")
    parser.add_argument(
        "--processes", type=int, default=2, help="runs at a time, one thread each (default 2)"
    )
    parser.add_argument("--json", type=Path, help="JSON lines to keep the runs in, and to resume from")
    options = parser.parse_args()
    pairs = [(maker.__name__, str(number)) for maker, count in MAKERS.items() for number in range(count)]
    pairs += real_pairs()
    if options.kinds:
        unknown = set(options.kinds) - {kind for kind, _ in pairs}
        if unknown:
            parser.error(f"no such kinds: {', '.join(sorted(unknown))} (real clouds need TMCHHO_DATA)")
        pairs = [pair for pair in pairs if pair[0] in options.kinds]
    if data_dir() is None:
        print("TMCHHO_DATA is not set: generated pairs only", file=sys.stderr)
    # Runs of one pair follow each other, so that its clouds are made once.
    cases = [
        Case(kind, variant, seed, options.dof) for kind, variant in pairs for seed in range(options.runs)
    ]
    by_kind: dict[str, list[dict[str, Any]]] = defaultdict(list)
    for record in run_all(
        run_once,
        cases,
        lambda case: (case.kind, case.variant, case.seed, case.dof),
        options.json,
        options.processes,
    ):
        by_kind[record["key"][0]].append(record)
        if record.get("is_false"):
            print(f"FALSE ACCEPTANCE {record}", file=sys.stderr, flush=True)
    print("| pairs of | pairs | runs | false accepted | right accepted | review | rejected ", end="")
    print("| largest share | largest ratio | median s |")
    print("|---|---|---|---|---|---|---|---|---|---|")
    for kind, records in by_kind.items():
        print(row(kind, records))
    everything = [record for records in by_kind.values() for record in records]
    print(row("**all**", everything))
    for record in everything:
        if record.get("is_false"):
            print(f"\nFalse acceptance: {record}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
