"""Two simulated surveys of any size, as LAZ, registered, measured and fused by the command line.

    python benches/large_files.py --millions 5 --folder out/large --max-memory 2GB

The surveys are made once, a million points at a time, each time drawn anew from the same site; beyond five
millions, points drawn before come again, each displaced by some centimetres of noise. Printed are
the peak memory of the command, and for each part of its route the points (of both files) per second of the
clock, and per second of one processor: on a machine that others use too, the latter is the one to compare.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import laspy
import numpy as np

import tmchho
from tmchho.simulate import make_site, survey_photogrammetry, survey_scanner
from tmchho.simulate.pair import NATIONAL_CRS, NATIONAL_ORIGIN

# The peak of this very process; what the system tells of children begins with the memory of their parent.
MEASURED = (
    "import sys\n"
    "from tmchho.cli import main\n"
    "try:\n"
    "    main(sys.argv[1:])\n"
    "finally:\n"
    "    print(open('/proc/self/status').read().split('VmHWM:')[1].split()[0], file=sys.stderr)\n"
)
PART = 1_000_000
DRAWN = 5  # millions
NOISE_MM = 30
PARTS = ("thin", "register", "sort", "measure", "areas", "fuse")


def make_surveys(folder: Path, millions: int) -> tuple[Path, Path]:
    """Write ``uav.laz``, turned and shifted, and ``tls.laz`` in the national grid, unless they are there."""
    paths = folder / f"uav_{millions}M.laz", folder / f"tls_{millions}M.laz"
    if all(path.exists() for path in paths):
        return paths
    site = make_site(seed=0)
    turn = np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]])
    for path, is_flown in zip(paths, (True, False), strict=True):
        header = laspy.LasHeader(version="1.4", point_format=7)
        header.scales = [0.001] * 3
        header.offsets = [0.0, 0.0, 0.0] if is_flown else NATIONAL_ORIGIN
        if not is_flown:
            header.vlrs.append(laspy.VLR("LASF_Projection", 2112, "", NATIONAL_CRS.encode() + b"\0"))
            header.global_encoding.wkt = True
        temporary = path.with_name(f".{path.name}")
        with laspy.open(temporary, "w", header=header, do_compress=True) as writer:
            rng = np.random.default_rng(int(is_flown))
            drawn = []
            for number in range(millions):
                if number < DRAWN:
                    survey = survey_photogrammetry if is_flown else survey_scanner
                    cloud = survey(site, n_points=PART, seed=1000 * is_flown + number)
                    drawn.append(packed(cloud, header, turn if is_flown else None))
                points = drawn[number % DRAWN]
                if number >= DRAWN:
                    for axis in "XYZ":
                        points.array[axis] += rng.integers(-NOISE_MM, NOISE_MM + 1, PART, dtype=np.int32)
                writer.write_points(points)
        temporary.rename(path)
    return paths


def packed(cloud: tmchho.PointCloud, header: laspy.LasHeader, turn: np.ndarray | None) -> Any:
    """Return a survey as point records: the scanner's in the national grid, the other one turned away."""
    points = laspy.ScaleAwarePointRecord.zeros(len(cloud), header=header)
    xyz = cloud.xyz + NATIONAL_ORIGIN if turn is None else cloud.xyz @ turn.T + [40.0, -70.0, 12.0]
    points.x, points.y, points.z = xyz.T
    for name in ("intensity", "red", "green", "blue", "gps_time"):
        if name in cloud.attributes:
            values = cloud.attributes[name]
            wide = name in ("red", "green", "blue") and values.dtype == np.uint8
            points[name] = values.astype(np.uint16) * 256 if wide else values
    return points


def read_beside_laspy(path: Path) -> dict[str, tuple[float, ...]]:
    """Return the best of three wall and processor times of reading a file by laspy and by us."""

    def by_laspy() -> None:
        las = laspy.read(path)
        _ = [las.xyz, *(np.array(las[name]) for name in las.point_format.dimension_names)]

    found = {}
    for name, read in (("laspy", by_laspy), ("tmchho", lambda: tmchho.read(path))):
        times = []
        for _ in range(3):
            wall, process = time.perf_counter(), time.process_time()
            read()
            times.append((time.perf_counter() - wall, time.process_time() - process))
        found[name] = tuple(map(min, zip(*times, strict=True)))
    return found


def evaluate_beside(source: Path, target: Path, folder: Path, max_memory: str) -> None:
    """Print the time and the peak memory of `info` and of `evaluate` by some methods."""
    pose = ["--transform", str(folder / "out" / "result.json"), "-q", "--json"]
    for words in (
        ["info", str(source), str(target), "-q"],
        *(["evaluate", str(source), str(target), *pose, "--method", m] for m in ("nearest", "plane", "m3c2")),
    ):
        began = time.perf_counter()
        limited = [sys.executable, "-c", MEASURED, *words, "--max-memory", max_memory]
        ran = subprocess.run(limited, capture_output=True, text=True, check=False)
        peak = ran.stderr.split()[-1]
        name = " ".join([words[0], *words[-1:]]) if words[0] == "evaluate" else words[0]
        seconds = time.perf_counter() - began
        print(f"{name:<17} exit {ran.returncode}  peak memory {int(peak) / 1e6:.2f} GB  wall {seconds:.0f} s")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--millions", type=int, default=5, help="points of each survey, in millions")
    parser.add_argument("--folder", type=Path, required=True, help="for the surveys and the results")
    parser.add_argument("--max-memory", default="2GB")
    parser.add_argument("--fuse", default="merge")
    parser.add_argument("--read", action="store_true", help="also read one survey as a whole, beside laspy")
    parser.add_argument("--evaluate", action="store_true", help="measure them instead, at the pose found")
    arguments = parser.parse_args()
    arguments.folder.mkdir(parents=True, exist_ok=True)
    source, target = make_surveys(arguments.folder, arguments.millions)
    for path in (source, target):
        print(f"{path.name}: {path.stat().st_size / 1e6:.0f} MB")
    if arguments.read:
        for name, (wall, process) in read_beside_laspy(target).items():
            print(f"read by {name:<7} wall {wall:.2f} s  processors {process:.2f} s")
    if arguments.evaluate:
        evaluate_beside(source, target, arguments.folder, arguments.max_memory)
        return
    command = [sys.executable, "-m", "tmchho", "register", str(source), str(target), "--json", "--quiet"]
    command += ["-o", str(arguments.folder / "out"), "--overwrite"]
    command += ["--max-memory", arguments.max_memory, "--fuse", arguments.fuse]
    began = time.perf_counter()
    ran = subprocess.run(command, capture_output=True, text=True, check=False)
    wall = time.perf_counter() - began
    if ran.returncode not in (0, 4):
        raise SystemExit(ran.stderr)
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    document = json.loads(ran.stdout)
    n_points = sum(document["inputs"][role]["n_points"] for role in ("source", "target"))
    process = used.ru_utime + used.ru_stime
    print(f"verdict {document['verdict']}, {n_points:,} points, {document['fused']['n_points']:,} fused")
    print(
        f"peak memory {used.ru_maxrss / 1e6:.2f} GB; wall {wall:.0f} s, processors {process:.0f} s; ", end=""
    )
    print(f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} processors")
    for part in PARTS:
        seconds = document["in_parts"]["seconds"][part]
        print(
            f"{part:<9} wall {seconds['wall']:7.1f} s  processors {seconds['process']:7.1f} s  "
            f"{n_points / seconds['wall'] / 1e6:6.2f} M points/s  "
            f"{n_points / seconds['process'] / 1e6:6.2f} M points/s of one processor"
        )
    print(json.dumps({key: value for key, value in document["in_parts"].items() if key != "seconds"}))


if __name__ == "__main__":
    main()
