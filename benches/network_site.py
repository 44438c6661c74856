"""A simulated dam site surveyed from many stations and from the air, all frames unknown.

    python benches/network_site.py [--seeds 5] [--stations 22] [--no-block] [--no-piers] [--scale 1.0]
        [--points 60000] [--workers 2] [--first-seed 0]

Each seed makes a site, its surveys and their frames. A station is right if the root mean squared displacement
of its points, by its pose and after the whole network was brought onto the truth, is within a third of the
voxel. Two stations see equal piers and little else, which the loops have to find out. The table goes to
standard output as Markdown.
"""

from __future__ import annotations

import argparse
import resource
import time

import numpy as np
from common import moved

import tmchho
from tmchho.network import register_network
from tmchho.network.engine import InProcess
from tmchho.network.results import NetworkRegistration
from tmchho.network.stations import Station
from tmchho.simulate import SimulatedNetwork, make_network


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--stations", type=int, default=22)
    parser.add_argument("--points", type=int, default=60_000)
    parser.add_argument("--scale", type=float, default=1.0, help="true scale of the block, free where not 1")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--no-block", action="store_true")
    parser.add_argument("--no-piers", action="store_true")
    arguments = parser.parse_args()
    print(
        "| seed | stations | right | worst of them by voxel | pairs possible | screened | registered | kept"
        " | wrong links accepted alone | of them kept | right links left out | seconds | GB |"
    )
    print("|" + "---|" * 13)
    for seed in range(arguments.first_seed, arguments.first_seed + arguments.seeds):
        site = make_network(
            n_stations=arguments.stations,
            n_points=arguments.points,
            n_block_points=0 if arguments.no_block else 400_000,
            block_scale=arguments.scale,
            equal_piers=not arguments.no_piers,
            seed=seed,
        )
        stations = [
            Station(
                name,
                cloud.xyz,
                kind="block" if name == "UAV" else "scan",
                free_scale=name == "UAV" and arguments.scale != 1.0,
            )
            for name, cloud in zip(site.names, site.clouds, strict=True)
        ]
        began = time.perf_counter()
        found = register_network(stations, seed=seed, engine=InProcess(arguments.workers))
        seconds = time.perf_counter() - began
        print(row(seed, site, found, seconds), flush=True)


def row(seed: int, site: SimulatedNetwork, found: NetworkRegistration, seconds: float) -> str:
    """Say how one network went."""
    truth = dict(zip(site.names, site.world_from_station, strict=True))
    points = {name: cloud.xyz[::100] for name, cloud in zip(site.names, site.clouds, strict=True)}
    poses = {s.name: s.world_from_station for s in found.stations if s.world_from_station is not None}
    here = np.concatenate([moved(poses[name], points[name]) for name in poses])
    there = np.concatenate([moved(truth[name], points[name]) for name in poses])
    whole = tmchho.kabsch(here, there)
    errors = {
        name: displacement(whole @ pose, truth[name], points[name]) / found.voxel_size
        for name, pose in poses.items()
    }
    right = sum(error <= 1 / 3 for error in errors.values())
    wrong_alone = wrong_kept = right_left_out = 0
    for link in found.links:
        if link.target_from_source is None or link.verdict != "accepted":
            continue
        wanted = np.linalg.inv(truth[link.target]) @ truth[link.source]
        away = displacement(link.target_from_source, wanted, points[link.source])
        if away > 2 * found.voxel_size:
            wrong_alone += 1
            wrong_kept += link.kept
        else:
            right_left_out += not link.kept
    kept = sum(link.kept for link in found.links)
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    return (
        f"| {seed} | {len(site.names)} | {right} | {max(errors.values()):.3f} | {found.n_pairs_possible}"
        f" | {found.n_pairs_screened} | {found.n_pairs_registered} | {kept} | {wrong_alone} | {wrong_kept}"
        f" | {right_left_out} | {seconds:.0f} | {memory:.1f} |"
    )


def displacement(found: np.ndarray, wanted: np.ndarray, points: np.ndarray) -> float:
    return float(np.sqrt(((moved(found, points) - moved(wanted, points)) ** 2).sum(axis=1).mean()))


if __name__ == "__main__":
    main()
