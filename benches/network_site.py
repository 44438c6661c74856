"""A simulated dam site surveyed from many stations and from the air, all frames unknown.

    python benches/network_site.py [--seeds 5] [--first-seed 0] [--stations 22] [--points 60000]
        [--block-points 400000] [--no-block] [--no-piers] [--pier-reach 27] [--scale 1.0] [--wrong-links 0]
        [--workers 2] [--report FOLDER]

Each seed makes a site, its surveys and their frames. A station is right if the root mean squared displacement
of its points, by its pose and after the whole network was brought onto the truth by one of its stations, is
within a third of the voxel. Two more stations stand before equal piers: for itself their pair fits, which the
loops have to find out. With --pier-reach 17 they see nothing but the pier and its pad, so that nobody can
tell them apart. With --wrong-links as many pairs that the search has refused are given out as accepted, with
a pose that is wrong by tens of metres. The table goes to standard output as Markdown, followed by the links
that were accepted for themselves and are wrong, each with what became of it, and by the stations that are
named. Memory is that of the process, the simulation included.
"""

from __future__ import annotations

import argparse
import resource
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from common import moved

from tmchho.network import register_network
from tmchho.network.engine import InProcess, Item, Unit
from tmchho.network.files import network_document, write_network
from tmchho.network.poses import inverse
from tmchho.network.results import NetworkLink, NetworkRegistration
from tmchho.network.stations import Station
from tmchho.report.network import write_network_report
from tmchho.simulate import SimulatedNetwork, make_network, random_pose

WRONG_BY_M = 40.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--stations", type=int, default=22)
    parser.add_argument("--points", type=int, default=60_000)
    parser.add_argument("--block-points", type=int, default=400_000)
    parser.add_argument("--scale", type=float, default=1.0, help="true scale of the block, free where not 1")
    parser.add_argument("--pier-reach", type=float, default=27.0)
    parser.add_argument("--wrong-links", type=int, default=0)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--report", type=Path, help="also write what `tmchho network` writes, but the fusion")
    parser.add_argument("--no-block", action="store_true")
    parser.add_argument("--no-piers", action="store_true")
    arguments = parser.parse_args()
    print(
        "| seed | clouds | right | worst by voxel | not placed | pairs possible | screened | registered"
        " | kept | wrong links accepted alone | of them kept | right links left out | seconds | of processors"
        " | GB |"
    )
    print("|" + "---|" * 15, flush=True)
    for seed in range(arguments.first_seed, arguments.first_seed + arguments.seeds):
        site = make_network(
            n_stations=arguments.stations,
            n_points=arguments.points,
            n_block_points=0 if arguments.no_block else arguments.block_points,
            block_scale=arguments.scale,
            equal_piers=not arguments.no_piers,
            pier_reach_m=arguments.pier_reach,
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
        engine = Misled(arguments.workers, arguments.wrong_links, seed)
        began, busy = time.perf_counter(), time.process_time()
        found = register_network(stations, seed=seed, engine=engine)
        seconds, busy = time.perf_counter() - began, time.process_time() - busy
        print(row(seed, site, found, seconds, busy), flush=True)
        print("\n" + "\n".join(remarks(site, found)) + "\n", flush=True)
        if arguments.report:
            inputs = [{"file": f"{name}.laz", "n_bytes": 0, "sha256": ""} for name in site.names]
            document = network_document(found, f"Simulated site {seed}", inputs, "")
            write_network(arguments.report, document, overwrite=True)
            write_network_report(arguments.report)


class Misled(InProcess):
    """Gives out some pairs that the search refused as accepted, with a pose that is far from the truth."""

    def __init__(self, n_workers: int, n_wrong: int, seed: int) -> None:
        super().__init__(n_workers)
        self.n_left, self._rng = n_wrong, np.random.default_rng(seed)

    def run(self, stage: str, unit: Unit, items: Sequence[Item], **further: Any) -> list[Item]:
        """Do as any engine, but for the lies."""
        results = super().run(stage, unit, items, **further)
        for result in results if stage == "links" else ():
            if self.n_left and result["verdict"] == "rejected" and result["pose"] is not None:
                away = random_pose(self._rng, WRONG_BY_M)
                result["pose"] = (np.array(result["pose"]) @ away).tolist()
                result |= {"verdict": "accepted", "ambiguity_ratio": None, "reasons": ["a lie"]}
                self.n_left -= 1
        return results


def row(seed: int, site: SimulatedNetwork, found: NetworkRegistration, seconds: float, busy: float) -> str:
    """Say how one network went."""
    errors = errors_by_voxel(site, found)
    right = sum(error <= 1 / 3 for error in errors.values())
    wrong = wrong_links(site, found)
    alone = [link for link in found.links if link.verdict == "accepted"]
    right_left_out = sum(not link.kept for link in alone) - sum(not link.kept for link in wrong)
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    return (
        f"| {seed} | {len(site.names)} | {right} | {max(errors.values()):.3f}"
        f" | {len(site.names) - len(errors)} | {found.n_pairs_possible} | {found.n_pairs_screened}"
        f" | {found.n_pairs_registered} | {sum(link.kept for link in found.links)} | {len(wrong)}"
        f" | {sum(link.kept for link in wrong)} | {right_left_out} | {seconds:.0f} | {busy:.0f}"
        f" | {memory:.1f} |"
    )


def remarks(site: SimulatedNetwork, found: NetworkRegistration) -> list[str]:
    """Name the wrong links and what became of them, the stations that are wrong, and those that are named."""
    lines = [f"verdict: {found.verdict}"]
    for link in wrong_links(site, found):
        fate = "KEPT" if link.kept else f"left out: {link.left_out_because}"
        lines.append(f"wrong link {link.source} – {link.target}: {fate}")
    lines += [
        f"wrong station {name}: by {error:.1f} voxels"
        for name, error in errors_by_voxel(site, found).items()
        if error > 1 / 3
    ]
    return lines + [f"named: {station.name}: {station.note}" for station in found.stations if station.note]


def errors_by_voxel(site: SimulatedNetwork, found: NetworkRegistration) -> dict[str, float]:
    """Return how far each station that was placed lies from the truth.

    The frame is that of a station: the one that brings most of the others to their place.
    """
    truth = dict(zip(site.names, site.world_from_station, strict=True))
    points = sampled(site)
    poses = {s.name: s.world_from_station for s in found.stations if s.world_from_station is not None}
    ways = []
    for first in poses:
        whole = truth[first] @ inverse(poses[first])
        ways.append(
            {
                name: displacement(whole @ pose, truth[name], points[name]) / found.voxel_size
                for name, pose in poses.items()
            }
        )
    return min(ways, key=lambda errors: float(np.median(list(errors.values()))))


def wrong_links(site: SimulatedNetwork, found: NetworkRegistration) -> list[NetworkLink]:
    """Return the links that were accepted for themselves and are not where the truth is."""
    truth = dict(zip(site.names, site.world_from_station, strict=True))
    points = sampled(site)
    wrong = []
    for link in found.links:
        if link.target_from_source is not None and link.verdict == "accepted":
            wanted = inverse(truth[link.target]) @ truth[link.source]
            away = displacement(link.target_from_source, wanted, points[link.source])
            if away > 2 * found.voxel_size:
                wrong.append(link)
    return wrong


def sampled(site: SimulatedNetwork) -> dict[str, np.ndarray]:
    return {name: cloud.xyz[::100] for name, cloud in zip(site.names, site.clouds, strict=True)}


def displacement(found: np.ndarray, wanted: np.ndarray, points: np.ndarray) -> float:
    return float(np.sqrt(((moved(found, points) - moved(wanted, points)) ** 2).sum(axis=1).mean()))


if __name__ == "__main__":
    main()
