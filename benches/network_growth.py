"""How the work grows with the number of stations: with the links, not with the pairs.

    python benches/network_growth.py [--stations 25 50 100 200] [--points 4000] [--seed 0] [--unknown]

Small scans of one dam site, all in frames of their own, with positions known to some metres, or, with
--unknown, with nothing known. The table goes to standard output as Markdown; seconds are of processor time,
so that they do not depend on the number of workers.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

from tmchho.network import register_network
from tmchho.network.engine import InProcess
from tmchho.network.stations import Station
from tmchho.simulate import make_network

ROUGHLY_M = 3.0
REACH_M = 25.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--stations", type=int, nargs="+", default=[25, 50, 100, 200])
    parser.add_argument("--points", type=int, default=4_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--unknown", action="store_true")
    arguments = parser.parse_args()
    print(
        "| stations | pairs possible | screened | registered | kept | placed | registered by station"
        " | processor seconds | of them by registration |"
    )
    print("|" + "---|" * 9)
    for n in arguments.stations:
        site = make_network(
            n_stations=n, reach_m=REACH_M, n_points=arguments.points, n_block_points=0, seed=arguments.seed
        )
        rng = np.random.default_rng(arguments.seed)
        stations = [
            Station(
                name,
                cloud.xyz,
                position=None if arguments.unknown else pose[:3, 3] + ROUGHLY_M * rng.standard_normal(3),
            )
            for name, cloud, pose in zip(site.names, site.clouds, site.world_from_station, strict=True)
        ]
        began = time.process_time()
        found = register_network(stations, seed=arguments.seed, engine=InProcess(2))
        seconds = time.process_time() - began
        kept = sum(link.kept for link in found.links)
        placed = sum(station.world_from_station is not None for station in found.stations)
        print(
            f"| {n} | {found.n_pairs_possible} | {found.n_pairs_screened} | {found.n_pairs_registered}"
            f" | {kept} | {placed} | {found.n_pairs_registered / n:.1f} | {seconds:.0f}"
            f" | {seconds / max(found.n_pairs_registered, 1):.2f} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
