"""All ten scans of Stanford's bunny in one network, from random poses.

    TMCHHO_DATA=… python benches/network_ring.py [--seeds 5]

Each seed turns every scan over all of SO(3) and shifts it by up to 0.3 m. The poses found are brought onto
the published ones as a whole, by the rigid motion that fits the points best; a scan is right within 1° and
1 mm. The table goes to standard output as Markdown.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from pathlib import Path

import numpy as np
from common import angle_deg, moved

import tmchho
from tmchho.network import register_network
from tmchho.network.stations import Station
from tmchho.simulate import random_pose


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--seeds", type=int, default=5)
    arguments = parser.parse_args()
    folder = Path(os.environ.get("TMCHHO_DATA", "../shared/data")) / "stanford" / "bunny_ring"
    listed = json.loads((folder / "world_from_scan.json").read_text())
    published = {name: np.array(pose) for name, pose in listed.items()}
    clouds = {name: tmchho.read(folder / name).xyz for name in sorted(published)}
    print("| seed | within 1° and 1 mm | worst ° | worst mm | links kept | left out | seconds |")
    print("|---|---|---|---|---|---|---|")
    for seed in range(arguments.seeds):
        rng = np.random.default_rng(seed)
        away = {name: random_pose(rng, 0.3) for name in clouds}
        stations = [Station(name, moved(away[name], points)) for name, points in clouds.items()]
        began = time.perf_counter()
        found = register_network(stations, seed=seed)
        seconds = time.perf_counter() - began
        wanted = {name: published[name] @ np.linalg.inv(away[name]) for name in clouds}
        poses = {s.name: s.world_from_station for s in found.stations if s.world_from_station is not None}
        whole = fitted(poses, wanted, {name: moved(away[name], points) for name, points in clouds.items()})
        errors = [
            errors_of(whole @ pose, wanted[name], moved(away[name], clouds[name]))
            for name, pose in poses.items()
        ]
        right = sum(deg <= 1 and m <= 1e-3 for deg, m in errors)
        kept = sum(link.kept for link in found.links)
        worst_deg, worst_mm = max(e[0] for e in errors), 1000 * max(e[1] for e in errors)
        print(
            f"| {seed} | {right} of {len(clouds)} | {worst_deg:.2f} | {worst_mm:.2f}"
            f" | {kept} | {len(found.links) - kept} | {seconds:.0f} |",
            flush=True,
        )


def fitted(found: dict, wanted: dict, clouds: dict) -> np.ndarray:
    """Return the rigid motion that brings points of all stations nearest to where they are wanted."""
    source = np.concatenate([moved(found[name], clouds[name][::200]) for name in found])
    target = np.concatenate([moved(wanted[name], clouds[name][::200]) for name in found])
    return tmchho.kabsch(source, target)


def errors_of(found: np.ndarray, wanted: np.ndarray, points: np.ndarray) -> tuple[float, float]:
    """Return how wrong a pose is: in degrees, and as the shift of the cloud's middle."""
    middle = points.mean(axis=0)[None]
    shift = float(np.linalg.norm(moved(found, middle) - moved(wanted, middle)))
    return angle_deg(found[:3, :3] @ wanted[:3, :3].T), shift


if __name__ == "__main__":
    main()
