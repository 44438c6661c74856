"""What many workers gain, and what it costs to lose them.

    python benches/network_cluster.py [--stations 10] [--points 30000] [--pairs 24] [--kills 5] [--part PART]

PART is one of
    pairs     the same pairs on one thread and on a local cluster of two workers with one thread each
    worker    a network on two workers, one of which is killed (kill -9) in the middle
    resume    a small network that is killed as a whole at random moments, and resumed each time
    overhead  what a unit of work costs that does nothing: in this process, on a cluster, with the store
    costs     what each step of a network costs a unit, in seconds of a processor
and all where it is not given. The results must be the same to the byte; the script ends with 1 where they are
not. The tables go to standard output as Markdown. Times mean something only on a machine that does nothing
else, and the load is printed with them; the time of the processors tells what the workers cost on any.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from network_growth import windows

import tmchho
from tmchho.config import config_json
from tmchho.network import register_network
from tmchho.network.cluster import Cluster, local_cluster
from tmchho.network.engine import Engine, InProcess, Item, Unit
from tmchho.network.links import register_link
from tmchho.network.prepare import prepare_cloud
from tmchho.network.store import Resumed, Store, input_reference
from tmchho.progress import ProgressEvent
from tmchho.simulate import make_network

PARTS = ("pairs", "worker", "resume", "overhead", "costs")
N_NOTHINGS = 2000


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--stations", type=int, default=10)
    parser.add_argument("--points", type=int, default=30_000)
    parser.add_argument("--pairs", type=int, default=24)
    parser.add_argument("--kills", type=int, default=5)
    parser.add_argument("--part", choices=PARTS)
    arguments = parser.parse_args()
    wanted = (arguments.part,) if arguments.part else PARTS
    with tempfile.TemporaryDirectory(prefix="network-") as temporary:
        folder = Path(temporary)
        paths = simulated(arguments.stations, arguments.points, folder)
        same = True
        if "pairs" in wanted:
            same &= measure_pairs(paths, arguments.pairs, folder)
        if "worker" in wanted:
            same &= lose_a_worker(windowed(folder), folder)
        if "resume" in wanted:
            same &= kill_and_resume(windowed(folder), arguments.kills, folder)
        if "overhead" in wanted:
            measure_overhead(folder)
        if "costs" in wanted:
            measure_costs(paths, folder)
    if not same:
        sys.exit("the results differ")


def simulated(n_stations: int, n_points: int, folder: Path) -> list[Path]:
    """Lay down the scans of a simulated site."""
    site = make_network(n_stations=n_stations, n_points=n_points, n_block_points=0, seed=1)
    paths = [folder / f"{name}.laz" for name in site.names]
    for cloud, path in zip(site.clouds, paths, strict=True):
        tmchho.write(cloud, path)
    return paths


def windowed(folder: Path) -> list[Path]:
    """Lay down four small windows of one ground, which are one network within seconds."""
    clouds, _ = windows(4, 3000, np.random.default_rng(1))
    paths = [folder / f"window-{number}.laz" for number in range(len(clouds))]
    for cloud, path in zip(clouds, paths, strict=True):
        tmchho.write(tmchho.PointCloud(cloud), path, overwrite=True)
    return paths


def measure_pairs(paths: list[Path], n_pairs: int, folder: Path) -> bool:
    """Register the same pairs on one thread and on two workers of one thread each."""
    clouds = folder / "clouds"
    clouds.mkdir()
    prepared = InProcess().run(
        "prepare",
        prepare_cloud,
        [
            {"cloud": input_reference(path), "name": path.stem, "folder": str(clouds), "number": number}
            for number, path in enumerate(paths)
        ],
    )
    config = json.loads(config_json(None))
    config.pop("n_threads")  # the engine's business
    pairs = [(a, a + step) for step in range(1, len(paths)) for a in range(len(paths) - step)][:n_pairs]
    items = [
        {"source": prepared[a]["points"], "target": prepared[b]["points"], "config": config} for a, b in pairs
    ]

    print(f"\n{len(items)} pairs, load {os.getloadavg()[0]:.1f} on {os.cpu_count()} processors\n")
    print(
        "| where | seconds | speed-up | processor seconds, all | speed-up if shared evenly | same results |"
    )
    print("|---|---|---|---|---|---|")
    engine = InProcess(1, threads_of_unit=1)
    alone, expected, busy = timed(engine, items, lambda: [time.process_time()])
    print(f"| one process, one thread | {alone:.1f} | 1 | {busy:.1f} | 1 | – |", flush=True)
    with local_cluster(2, threads_of_unit=1) as cluster:
        cluster.run("warming", nothing, [{"number": number} for number in range(8)])

        def clocks() -> list[float]:
            return list(cluster.client.run(time.process_time).values())

        both, found, work = timed(cluster, items, clocks)
    print(
        f"| two workers, one thread each | {both:.1f} | {alone / both:.2f} | {work:.1f} "
        f"| {2 * busy / work:.2f} | {found == expected} |",
        flush=True,
    )
    return found == expected


def timed(
    engine: Engine, items: list[Item], clocks: Callable[[], list[float]]
) -> tuple[float, list[Item], float]:
    """Return the time, the results, and the processor time of all processes together."""
    began, before = time.perf_counter(), clocks()
    found = engine.run("links", register_link, items)
    seconds = time.perf_counter() - began
    return seconds, found, sum(clocks()) - sum(before)


def lose_a_worker(paths: list[Path], folder: Path) -> bool:
    """Kill one of two workers in the middle of the pairs."""
    expected = document_of(paths, InProcess(2), folder / "whole")
    killed: list[int] = []
    with local_cluster(2) as cluster:
        cluster.progress = killer(cluster, killed)
        found = document_of(paths, cluster, folder / "lost")
    print(f"\na worker killed (kill -9) among the pairs: {bool(killed)}; same result: {found == expected}")
    return bool(killed) and found == expected


def killer(cluster: Cluster, killed: list[int]) -> Callable[[ProgressEvent], object]:
    """Return a listener that kills a worker as soon as three pairs are done."""
    pids = list(cluster.client.run(os.getpid).values())

    def listen(event: ProgressEvent) -> None:
        if event.stage == "links" and event.done == 3 and not killed:
            os.kill(pids[0], signal.SIGKILL)
            killed.append(pids[0])

    return listen


def document_of(paths: list[Path], engine: Engine, folder: Path) -> str:
    return json.dumps(register_network(paths, engine=engine, work_folder=folder).to_dict())


def kill_and_resume(paths: list[Path], n_kills: int, folder: Path) -> bool:
    """Kill the command itself at random moments, resume it each time, and compare all files in the end."""
    whole, killed = folder / "out-whole", folder / "out-killed"
    began = time.perf_counter()
    run(paths, whole).wait()
    seconds = time.perf_counter() - began
    generator = random.Random(1)
    moments = []
    for _ in range(n_kills):
        process = run(paths, killed)
        wait = generator.uniform(0.1, 0.9) * seconds / 2
        try:
            process.wait(timeout=wait)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
            n_finished = len(list((killed / "work").rglob("*.json")))
            moments.append(f"{wait:.1f} s ({n_finished} units done)")
    run(paths, killed).wait()
    same = files_of(whole) == files_of(killed) and len(files_of(whole)) > 3
    print(
        f"\nkilled (kill -9) after {', '.join(moments)}; a whole run takes {seconds:.1f} s; "
        f"same bytes: {same}"
    )
    return same and bool(moments)


def run(paths: list[Path], out: Path) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "tmchho", "network", *map(str, paths), "-o", str(out)]
    command += ["--levelled", "--resume", "-q"]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL)


def files_of(folder: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file() and "work" not in path.relative_to(folder).parts
    }


def measure_overhead(folder: Path) -> None:
    """Run units that do nothing."""
    print(f"\n{N_NOTHINGS} units that do nothing, load {os.getloadavg()[0]:.1f}\n")
    print("| where | milliseconds a unit |")
    print("|---|---|")
    items = [{"number": number, "config": json.loads(config_json(None))} for number in range(N_NOTHINGS)]
    with local_cluster(2) as cluster:
        engines: dict[str, Any] = {
            "this process": InProcess(2),
            "two workers": cluster,
            "two workers, results stored": Resumed(cluster, Store(folder / "store")),
            "all taken from the store": Resumed(cluster, Store(folder / "store")),
        }
        cluster.run("warming", nothing, items[:8])
        for name, engine in engines.items():
            began = time.perf_counter()
            engine.run("nothing", nothing, items)
            print(f"| {name} | {1000 * (time.perf_counter() - began) / N_NOTHINGS:.2f} |", flush=True)


def measure_costs(paths: list[Path], folder: Path) -> None:
    """Register a network and add up what its steps took; a processor's time hardly depends on the load."""
    engine = Counting()
    began = time.process_time()
    found = register_network(paths, engine=engine, work_folder=folder / "costs")
    whole = time.process_time() - began
    print(
        f"\n{len(paths)} stations, {found.n_pairs_registered} pairs registered, "
        f"{sum(link.kept for link in found.links)} links kept\n"
    )
    print("| step | units | seconds of a processor, each | bytes of a result |")
    print("|---|---|---|---|")
    for stage, (n_units, seconds, n_bytes) in engine.stages.items():
        n_units = max(n_units, 1)
        print(f"| {stage} | {n_units} | {seconds / n_units:.3f} | {n_bytes / n_units:.0f} |")
        whole -= seconds
    print(f"| what lies between | 1 | {whole:.2f} | – |", flush=True)


class Counting(InProcess):
    """Adds up units, processor time and bytes by stage."""

    def __init__(self) -> None:
        super().__init__(1, threads_of_unit=1)
        self.stages: dict[str, tuple[int, float, int]] = {}

    def run(self, stage: str, unit: Unit, items: Sequence[Item], **further: Any) -> list[Item]:
        """Do as any engine, and note what it took."""
        began = time.process_time()
        found = super().run(stage, unit, items, **further)
        seconds = time.process_time() - began
        n_units, before, n_bytes = self.stages.get(stage, (0, 0.0, 0))
        self.stages[stage] = (n_units + len(items), before + seconds, n_bytes + len(json.dumps(found)))
        return found


def nothing(item: dict[str, Any]) -> dict[str, Any]:
    return {"number": item["number"]}


if __name__ == "__main__":
    main()
