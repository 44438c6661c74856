"""How much the pose changes with what must not matter: unit, place on Earth, number of threads.

    python benches/invariance.py [PAIRS.json …] [--starts 1] [--site 1]

Every pair is registered from a random pose as it is, and then in other coordinates: in millimetres, in feet,
both clouds at E 500000 N 4000000, the source alone there, and with 1, 2 and 4 threads. The table gives how
far any point of the source comes to lie from where the first registration put it, in millionths of the pair's
unit, and whether all the rest, bit by bit, is the same. Without pairs files those of `TMCHHO_DATA` are taken,
if it is set, and the simulated site. The table goes to standard output as Markdown; the exit code is 1 if a
place differs by more than 1e-6 or threads change a bit.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from common import Array, pair_by_name, pair_names

import tmchho

GRID = np.array([500_000.0, 4_000_000.0, 200.0])
FOOT = 0.3048
MAX_AWAY = 1e-6


def bits(value: Any) -> Any:
    """Return all that is said of a pose as a string of digits that tells bits apart, without the times."""
    if isinstance(value, dict):
        return [(key, bits(item)) for key, item in value.items() if key != "seconds"]
    return [bits(item) for item in value] if isinstance(value, list) else repr(value)


def comparisons(source: Array, target: Array, seed: int) -> Iterator[tuple[str, float, bool, bool]]:
    """Give what was changed, how far any point is away, and whether verdict and all bits are the same."""
    first = tmchho.register(source, target, seed=seed)
    placed, said = first.apply(source), bits(first.to_dict())
    changes = {
        "millimetres": (1000.0, 0 * GRID, 0 * GRID, None),
        "feet": (1 / FOOT, 0 * GRID, 0 * GRID, None),
        "grid": (1.0, GRID, GRID, None),
        "grid, source only": (1.0, GRID, 0 * GRID, None),
        "1 thread": (1.0, 0 * GRID, 0 * GRID, 1),
        "2 threads": (1.0, 0 * GRID, 0 * GRID, 2),
        "4 threads": (1.0, 0 * GRID, 0 * GRID, 4),
    }
    for name, (unit, source_at, target_at, n_threads) in changes.items():
        there = source * unit + source_at
        found = tmchho.register(there, target * unit + target_at, seed=seed, config={"n_threads": n_threads})
        away = float(np.abs((found.apply(there) - target_at) / unit - placed).max())
        yield name, away, found.verdict == first.verdict, bits(found.to_dict()) == said


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("pairs", type=Path, nargs="*", help="pairs files; see benches/common.py")
    parser.add_argument("--starts", type=int, default=1, help="random poses of each pair (default 1)")
    parser.add_argument("--site", type=int, default=1, help="simulated sites, 0 for none (default 1)")
    parser.add_argument("--only", nargs="+", help="only pairs of these names")
    options = parser.parse_args()
    print("| pair | seed | change | farthest point, 1e-6 | same verdict | same bits |")
    print("|---|---|---|---|---|---|")
    is_good = True
    for file, name in pair_names(options.pairs, options.site, options.only):
        pair = pair_by_name(file, name)
        for seed in range(options.starts):
            source, _ = pair.start(seed)
            for change, away, same_verdict, same_bits in comparisons(source, pair.target, seed):
                is_good &= away <= MAX_AWAY and same_verdict and (same_bits or "thread" not in change)
                words = ["yes" if it else "no" for it in (same_verdict, same_bits)]
                print(f"| {name} | {seed} | {change} | {away * 1e6:.3g} | {' | '.join(words)} |", flush=True)
    return 0 if is_good else 1


if __name__ == "__main__":
    sys.exit(main())
