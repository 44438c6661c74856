"""The jobs of Section 5.3, on the simulated dam site: its two surveys stand in for those of the paper.

The surveys have as many points as the paper prints, from as many stations. The searches run on a piece of the
site, as in the paper, where a piece of the slope was the source of the pose.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tmchho.paper.methods import PAPER_METHODS
from tmchho.paper.plan import Job, Result, Series, Settings, ShouldStop
from tmchho.paper.registrations import ITERATIONS, POPULATION, bring_back, pose_error
from tmchho.paper.scans import Pair, Scan, moved, prepare
from tmchho.pipeline import register
from tmchho.simulate import SimulatedPair, make_pair, random_pose
from tmchho.simulate.pair import invert
from tmchho.stages import nearest_distances, remove_outliers

Array = NDArray[np.float64]

VOXEL_SIZE, KEYPOINT_RADIUS = 0.1, 0.3
SITE_M, STATIONS = 80.0, 22
# Points of the scanner for each of the photogrammetry, in Table 6.
_SCANNER_SHARE = 303_919 / 503_555
# The piece on which the searches run: a square about the middle of the site.
PIECE_M = 16.0
DEFAULT_RUNS = 3
# Middles of the five areas, east and north, and the side of each.
AREAS = {1: (0.0, 0.0), 2: (-24.0, -24.0), 3: (24.0, -24.0), 4: (-24.0, 24.0), 5: (24.0, 24.0)}
AREA_M = 20.0
BIN_M, N_BINS = 0.01, 60
_CELL_M = 0.5


def _site_job(settings: Settings, task: str, **entries: Any) -> Job:
    return {"task": task, "site_seed": settings.seed, "n_points": settings.n_site_points, **entries}


@lru_cache(maxsize=1)
def survey(seed: int, n_points: int) -> SimulatedPair:
    """Return the two surveys of the site, both in the site's own frame."""
    return make_pair(
        size_m=SITE_M,
        area_ratio=1.0,
        n_photogrammetry_points=n_points,
        n_scanner_points=round(_SCANNER_SHARE * n_points),
        stations=STATIONS,
        national_grid=False,
        pose="identity",
        seed=seed,
    )


@lru_cache(maxsize=1)
def piece(seed: int, n_points: int) -> Pair:
    """Return the piece of both surveys on which the searches run."""
    both = survey(seed, n_points)
    return Pair(_piece_of(both.source.xyz), _piece_of(both.target.xyz), np.eye(4))


def _piece_of(points: Array) -> Scan:
    return prepare(points[_within((0.0, 0.0), PIECE_M, points)], VOXEL_SIZE, KEYPOINT_RADIUS)


def _within(middle: tuple[float, float], side_m: float, points: Array) -> NDArray[np.bool_]:
    return np.asarray((np.abs(points[:, :2] - middle) <= side_m / 2).all(axis=1))


def _count_jobs(settings: Settings) -> list[Job]:
    return [_site_job(settings, "count")]


def _count(job: Job, _should_stop: ShouldStop) -> Result:
    """Count what the preprocessing leaves, on the whole site and on the piece."""
    both = survey(job["site_seed"], job["n_points"])
    on_piece = piece(job["site_seed"], job["n_points"])
    result: Result = {}
    for name, cloud, part in (
        ("scanner", both.target.xyz, on_piece.target),
        ("photogrammetry", both.source.xyz, on_piece.source),
    ):
        whole = prepare(cloud, VOXEL_SIZE, KEYPOINT_RADIUS)
        result[name] = {
            place: {"before": len(scan.points), "after": len(scan.voxels), "keypoints": len(scan.keypoints)}
            for place, scan in (("site", whole), ("piece", part))
        }
    return result


def _search_jobs(settings: Settings) -> list[Job]:
    return [
        _site_job(
            settings,
            "search",
            method=method,
            seed=seed,
            n_population=POPULATION,
            n_iterations=settings.n_iterations or ITERATIONS,
        )
        for method in PAPER_METHODS
        for seed in settings.seeds(DEFAULT_RUNS)
    ]


def _search(job: Job, should_stop: ShouldStop) -> Result:
    """Bring the piece of the photogrammetry back from a random pose."""
    pair = piece(job["site_seed"], job["n_points"])
    away = random_pose(np.random.default_rng(job["seed"]), pair.diagonal)
    return bring_back(pair, away, job, should_stop)


def _distance_jobs(settings: Settings) -> list[Job]:
    return [_site_job(settings, "distances", seed=settings.seed)]


def _distances(job: Job, should_stop: ShouldStop) -> Result:
    """Register the whole surveys in robust mode, and measure the areas at that pose and at the true one."""
    both = survey(job["site_seed"], job["n_points"])
    scanned, flown = (cloud.xyz[remove_outliers(cloud.xyz).indices] for cloud in (both.target, both.source))
    diagonal = float(np.linalg.norm(np.ptp(scanned, axis=0)))
    away = random_pose(np.random.default_rng(job["seed"]), diagonal)
    found = register(
        moved(away, both.source.xyz),
        both.target.xyz,
        seed=job["seed"],
        progress=lambda _event: should_stop(),
    )
    rotation_deg, shift_m = pose_error(found.transformation, invert(away), moved(away, flown))
    distances = nearest_distances(scanned, moved(found.transformation @ away, flown))
    at_truth = nearest_distances(scanned, flown)
    areas = {}
    for number, middle in AREAS.items():
        inside = _within(middle, AREA_M, scanned)
        counts, _ = np.histogram(distances[inside], bins=N_BINS, range=(0.0, BIN_M * N_BINS))
        areas[str(number)] = {
            "n_points": int(inside.sum()),
            "counts": counts.tolist(),
            "found": _statistics(distances[inside]),
            "true": _statistics(at_truth[inside]),
        }
    return {
        "verdict": found.verdict,
        "rotation_deg": rotation_deg,
        "shift_m": shift_m,
        "areas": areas,
        "map": _mean_by_cell(scanned, distances),
    }


def _statistics(distances: Array) -> dict[str, float]:
    return {
        "avg": float(distances.mean()),
        "best": float(distances.min()),
        "worst": float(distances.max()),
        "std": float(distances.std()),
        "median": float(np.median(distances)),
    }


def _mean_by_cell(points: Array, distances: Array) -> list[list[float | None]]:
    """Return the mean distance in each cell of the plan, rows from the south; None where no point is."""
    n = round(SITE_M / _CELL_M)
    place = np.clip(((points[:, :2] + SITE_M / 2) / _CELL_M).astype(int), 0, n - 1)
    cell = place[:, 1] * n + place[:, 0]
    counts = np.bincount(cell, minlength=n * n)
    sums = np.bincount(cell, weights=distances, minlength=n * n)
    means = [round(total / count, 4) if count else None for total, count in zip(sums, counts, strict=True)]
    return [means[row * n : (row + 1) * n] for row in range(n)]


COUNTS = Series("points of the dam site", _count_jobs, _count)
SEARCHES = Series("searches on the dam site", _search_jobs, _search)
DISTANCES = Series("distances on the dam site", _distance_jobs, _distances)
