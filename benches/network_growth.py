"""How the work grows with the number of stations: with the links, not with the pairs.

    python benches/network_growth.py [--stations 25 50 100 200] [--points 3000] [--seed 0] [--unknown]

Square windows of one rough ground, each seen by a levelled station in a frame of its own, neighbours sharing
a third; positions are known to some metres, or, with --unknown, nothing is. Right is a station within a third
of a voxel of the truth. The table goes to standard output as Markdown; seconds are of processor time, so that
they do not depend on the number of workers, and memory is the most that the process has had so far.
"""

from __future__ import annotations

import argparse
import resource
import time

import numpy as np
from common import moved

from tmchho.network import register_network
from tmchho.network.engine import InProcess
from tmchho.network.poses import inverse
from tmchho.network.results import NetworkRegistration
from tmchho.network.stations import Station

ROUGHLY_M = 3.0
WINDOW_M, STEP_M = 14.0, 9.0
BUMPS_BY_AREA = 0.12
NOISE_M = 0.005


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--stations", type=int, nargs="+", default=[25, 50, 100, 200])
    parser.add_argument("--points", type=int, default=3_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--unknown", action="store_true")
    arguments = parser.parse_args()
    print(
        "| stations | right | verdict | pairs possible | screened | registered | kept | registered by station"
        " | processor seconds | of them by station | GB |"
    )
    print("|" + "---|" * 11, flush=True)
    for n in arguments.stations:
        rng = np.random.default_rng(arguments.seed)
        clouds, truth = windows(n, arguments.points, rng)
        stations = [
            Station(
                f"S{number:03d}",
                cloud,
                position=None if arguments.unknown else pose[:3, 3] + ROUGHLY_M * rng.standard_normal(3),
            )
            for number, (cloud, pose) in enumerate(zip(clouds, truth, strict=True))
        ]
        began = time.process_time()
        engine = InProcess(arguments.workers)
        found = register_network(stations, levelled=True, seed=arguments.seed, engine=engine)
        seconds = time.process_time() - began
        kept = sum(link.kept for link in found.links)
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
        print(
            f"| {n} | {n_right(found, clouds, truth)} | {found.verdict} | {found.n_pairs_possible}"
            f" | {found.n_pairs_screened} | {found.n_pairs_registered} | {kept}"
            f" | {found.n_pairs_registered / n:.1f} | {seconds:.0f} | {seconds / n:.2f} | {memory:.1f} |",
            flush=True,
        )


def windows(n: int, n_points: int, rng: np.random.Generator) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Return clouds of a grid of windows, in frames of their own, and their poses in the world."""
    columns = int(np.ceil(np.sqrt(n)))
    size = STEP_M * columns + WINDOW_M
    middles = rng.uniform(-5.0, size + 5.0, (int(BUMPS_BY_AREA * size**2), 2))
    widths, heights = rng.uniform(0.8, 2.5, len(middles)), rng.uniform(-2.0, 3.0, len(middles))
    clouds, poses = [], []
    for number in range(n):
        low = STEP_M * np.array([number % columns, number // columns])
        xy = rng.uniform(low, low + WINDOW_M, (n_points, 2))
        near = (np.abs(middles - (low + WINDOW_M / 2)) < WINDOW_M / 2 + 8.0).all(axis=1)
        away_sq = ((xy[:, None] - middles[near]) ** 2).sum(axis=2)
        z = (heights[near] * np.exp(-away_sq / (2 * widths[near] ** 2))).sum(axis=1)
        world = np.column_stack([xy, z]) + NOISE_M * rng.standard_normal((n_points, 3))
        pose = np.eye(4)
        pose[:2, :2] = rotation_2d(rng.uniform(-np.pi, np.pi))
        pose[:3, 3] = [*(low + WINDOW_M / 2), 2.0]
        clouds.append(moved(inverse(pose), world))
        poses.append(pose)
    return clouds, poses


def rotation_2d(angle: float) -> np.ndarray:
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def n_right(found: NetworkRegistration, clouds: list[np.ndarray], truth: list[np.ndarray]) -> int:
    """Return how many stations are right, brought onto the truth by the one that suits most of them."""
    counts = [0]
    for first, station in enumerate(found.stations):
        if station.world_from_station is not None:
            whole = truth[first] @ inverse(station.world_from_station)
            counts.append(
                sum(
                    other.world_from_station is not None
                    and displacement(whole @ other.world_from_station, pose, cloud) <= found.voxel_size / 3
                    for other, cloud, pose in zip(found.stations, clouds, truth, strict=True)
                )
            )
    return max(counts)


def displacement(found: np.ndarray, wanted: np.ndarray, points: np.ndarray) -> float:
    return float(np.sqrt(((moved(found, points) - moved(wanted, points)) ** 2).sum(axis=1).mean()))


if __name__ == "__main__":
    main()
