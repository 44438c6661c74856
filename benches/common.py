"""What the benches share: pairs with a known pose, random starts, errors, and runs that can be resumed.

A pairs file is a JSON list of objects with `name`, `source`, `target` (paths beside the file),
`target_from_source` (the known pose) and, optionally, `tolerance_deg` and `tolerance_m` (default 2° and
1 % of the target's diagonal), `level` and `dof`.
"""

from __future__ import annotations

import json
import multiprocessing
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import tmchho
from tmchho.simulate import make_pair, random_pose

Array = NDArray[np.float64]

TOLERANCE_DEG = 2.0
TOLERANCE_BY_DIAGONAL = 0.01
SCALE_TOLERANCE = 0.005
MAX_SCALE = 2.0
SITE = "simulated site"
VERDICTS = ("accepted", "review", "rejected")


@dataclass(frozen=True, eq=False)
class KnownPair:
    """Two clouds near the origin and the pose that joins them."""

    name: str
    source: Array
    target: Array
    target_from_source: Array
    tolerance_deg: float
    tolerance_m: float
    level: str = ""

    @property
    def diagonal(self) -> float:
        """Diagonal of the target's box."""
        return diagonal_of(self.target)

    def start(self, seed: int, dof: int = 6) -> tuple[Array, Array]:
        """Return the source moved at random, and the true pose from there.

        Turned over all of SO(3) and shifted by up to one diagonal; with 4 degrees of freedom turned about the
        vertical only, with 7 also shrunk or grown.
        """
        away = pose_away(seed, self.diagonal, dof)
        return moved(away, self.source), self.target_from_source @ np.linalg.inv(away)

    def is_right(self, found: Array, wanted: Array, source: Array) -> bool:
        """Tell whether a pose of the moved source keeps to the tolerance."""
        rotation_deg, translation = pose_errors(found, wanted, source)
        return (
            rotation_deg <= self.tolerance_deg
            and translation <= self.tolerance_m
            and abs(scale_of(found) / scale_of(wanted) - 1) <= SCALE_TOLERANCE
        )


def pose_away(seed: int, max_shift: float, dof: int = 6) -> Array:
    """Draw a rigid pose; turned about the vertical only with 4 degrees of freedom, scaled as well with 7."""
    rng = np.random.default_rng(seed)
    away = random_pose(rng, max_shift)
    if dof == 4:
        yaw = rng.uniform(0, 2 * np.pi)
        cos, sin = np.cos(yaw), np.sin(yaw)
        away[:3, :3] = [[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]]
    if dof == 7:
        away[:3, :3] *= MAX_SCALE ** rng.uniform(-1, 1)
    return away


def diagonal_of(points: Array) -> float:
    return float(np.linalg.norm(np.ptp(points, axis=0)))


def moved(pose: Array, points: Array) -> Array:
    # Not a product by BLAS: its threads spin on for a tenth of a second, in the way of whoever is timed next.
    return np.asarray(np.einsum("ij,nj->ni", pose[:3, :3], points) + pose[:3, 3])


def angle_deg(rotation: Array) -> float:
    """Return the angle of a rotation; accurate near 0 and 180°."""
    axis = np.array(
        [rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]]
    )
    return float(np.degrees(np.arctan2(np.linalg.norm(axis), np.trace(rotation) - 1.0)))


def pose_errors(found: Array, wanted: Array, source: Array) -> tuple[float, float]:
    """Return how wrong a pose is: in degrees, and as the way by which it misses the source's middle."""
    middle = (source.min(axis=0) + source.max(axis=0))[None] / 2
    translation = float(np.linalg.norm(moved(found, middle) - moved(wanted, middle)))
    return angle_deg(found[:3, :3] @ wanted[:3, :3].T / scale_of(found) / scale_of(wanted)), translation


def scale_of(pose: Array) -> float:
    return float(np.cbrt(np.linalg.det(pose[:3, :3])))


def read_pairs(path: Path) -> list[KnownPair]:
    """Read a pairs file, with a grid's origin taken off both clouds and the pose."""
    return [read_pair(path.parent, entry) for entry in json.loads(path.read_text())]


def read_pair(folder: Path, entry: dict[str, Any]) -> KnownPair:
    source, target = (finite_points(folder / entry[role]) for role in ("source", "target"))
    # A grid's origin is taken off first, or the random turn about 0 would throw the source away.
    middle = np.round(target.mean(axis=0))
    pose = np.array(entry["target_from_source"])
    pose[:3, 3] += pose[:3, :3] @ middle - middle
    source, target = source - middle, target - middle
    tolerance_m = entry.get("tolerance_m", TOLERANCE_BY_DIAGONAL * diagonal_of(target))
    tolerance_deg = entry.get("tolerance_deg", TOLERANCE_DEG)
    return KnownPair(entry["name"], source, target, pose, tolerance_deg, tolerance_m, entry.get("level", ""))


def finite_points(path: Path) -> Array:
    points = tmchho.read(path).xyz
    return points[np.isfinite(points).all(axis=1)]


def data_dir() -> Path | None:
    """Return the folder of real clouds that `TMCHHO_DATA` names, or None."""
    folder = os.environ.get("TMCHHO_DATA")
    if folder is None:
        return None
    if not Path(folder).is_dir():
        raise SystemExit(f"TMCHHO_DATA names {folder}, which is no folder; correct or unset it")
    return Path(folder)


def pair_names(files: Sequence[Path], n_sites: int, only: Sequence[str] | None) -> list[tuple[str, str]]:
    """Return file and name of every pair: of the files, or else of `TMCHHO_DATA`, and of simulated sites."""
    folder = data_dir()
    if not files and folder is not None:
        files = [folder / name / "pairs.json" for name in ("stanford", "survey")]
    names = [(str(file), entry["name"]) for file in files for entry in json.loads(file.read_text())]
    names += [("", f"{SITE} {seed}") for seed in range(n_sites)]
    names = [(file, name) for file, name in names if not only or name in only]
    if not names:
        raise SystemExit("no pairs: name a pairs file, set TMCHHO_DATA, or ask for a simulated site")
    return names


@lru_cache(maxsize=1)
def pair_by_name(file: str, name: str) -> KnownPair:
    """Read one pair of a pairs file, or make the simulated site where there is no file."""
    if file:
        entries = json.loads(Path(file).read_text())
        return read_pair(Path(file).parent, next(entry for entry in entries if entry["name"] == name))
    made = make_pair(national_grid=False, pose="identity", seed=int(name.removeprefix(SITE)))
    tolerance_m = TOLERANCE_BY_DIAGONAL * diagonal_of(made.target.xyz)
    return KnownPair(name, made.source.xyz, made.target.xyz, np.eye(4), TOLERANCE_DEG, tolerance_m)


def run_all(
    job: Callable[[Any], dict[str, Any]],
    cases: Sequence[Any],
    key: Callable[[Any], Sequence[object]],
    log: Path | None,
    n_processes: int,
) -> Iterator[dict[str, Any]]:
    """Run the job on every case, in several processes, and give the records as they come.

    With a log (JSON lines) every record is kept there at once, and cases whose key is in it already are not
    run again: a long bench can be stopped and resumed. A record repeats the key under ``"key"``.
    """
    done: dict[str, dict[str, Any]] = {}
    if log is not None and log.exists():
        lines = (json.loads(line) for line in log.read_text().splitlines())
        done = {json.dumps(record["key"]): record for record in lines}
    keys = [json.dumps(list(key(case))) for case in cases]
    yield from (done[name] for name in keys if name in done)
    left = [(job, case, name) for case, name in zip(cases, keys, strict=True) if name not in done]
    if not left:
        return
    with multiprocessing.get_context("spawn").Pool(n_processes) as pool:
        for record in pool.imap_unordered(_run_one, left):
            if log is not None:
                with log.open("a") as file:
                    file.write(json.dumps(record) + "\n")
            yield record


def _run_one(task: tuple[Callable[[Any], dict[str, Any]], Any, str]) -> dict[str, Any]:
    job, case, name = task
    return {"key": json.loads(name), **job(case)}


def verdict_counts(records: Sequence[dict[str, Any]]) -> str:
    return " / ".join(str(sum(record["verdict"] == verdict for record in records)) for verdict in VERDICTS)
