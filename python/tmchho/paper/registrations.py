"""The job "register": one object from one random pose, by one method."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tmchho.equations import matrix_to_euler, rms_fitness
from tmchho.paper.methods import PAPER_METHODS
from tmchho.paper.plan import Job, Result, Series, Settings, ShouldStop
from tmchho.paper.scans import KINDS, MODELS, Pair, Scan, load_pair, moved, provenance
from tmchho.pipeline import register
from tmchho.results import Registration
from tmchho.simulate import random_pose
from tmchho.simulate.pair import invert
from tmchho.stages import icp

Array = NDArray[np.float64]

POPULATION, ITERATIONS = 30, 500
DEFAULT_RUNS = 3
# The six, then what they are measured by.
METHODS = (*PAPER_METHODS, "icp", "robust")
# Nothing is removed, thinned out or selected: the keypoints are there already.
_ALL_ARE_KEYPOINTS = {
    "min_neighbors": 0,
    "max_ratio_second_to_first": 2.0,
    "max_ratio_third_to_second": 2.0,
}


def jobs(settings: Settings) -> list[Job]:
    """Return every method on every object, as copy and as pair, from every pose."""
    return [
        {
            "task": "register",
            "clouds": provenance(),
            "model": model,
            "kind": kind,
            "method": method,
            "seed": seed,
            "n_population": POPULATION,
            "n_iterations": settings.n_iterations or ITERATIONS,
        }
        for kind, model, method, seed in product(KINDS, MODELS, METHODS, settings.seeds(DEFAULT_RUNS))
    ]


def run(job: Job, should_stop: ShouldStop) -> Result:
    """Move the source away at random and bring it back.

    Returns
    -------
    dict
        See `bring_back`.
    """
    pair = load_pair(job["clouds"], job["model"], job["kind"])
    away = random_pose(np.random.default_rng(job["seed"]), pair.diagonal)
    return bring_back(pair, away, job, should_stop)


def bring_back(pair: Pair, away: Array, job: Job, should_stop: ShouldStop) -> Result:
    """Register a source that was moved, by the method of a job.

    Parameters
    ----------
    pair : Pair
        Both scans in place.
    away : (4, 4) float64 array
        Where the source is moved to first.
    job : dict
        ``method``, ``seed``, ``n_population`` and ``n_iterations``.
    should_stop : callable

    Returns
    -------
    dict
        ``rms``: of Eq. (1), between the keypoints, after the search; ``true_rms``: the same at the true
        pose; ``fine_rms``: between the voxel centroids, in the end; ``rotation_deg`` and ``shift`` (of the
        middle of the source, as a share of the target's diagonal): errors after the search,
        ``fine_rotation_deg`` and ``fine_shift``: in the end; ``n_evaluations`` and ``history`` of the
        search; ``pose``: in the end, for the source as it was before it was moved away.
    """
    source = pair.source.moved(away)
    wanted = pair.target_from_source @ invert(away)
    result: Result = {"history": [], "n_evaluations": 0}
    if job["method"] == "robust":
        found = register(
            source.points,
            pair.target.points,
            seed=job["seed"],
            config={"n_threads": 1},
            progress=lambda _event: should_stop(),
        )
        coarse = fine = found.transformation
        result["n_evaluations"] = found.n_evaluations
    else:
        coarse = np.eye(4)
        if job["method"] != "icp":
            searched = search(source.keypoints, pair.target.keypoints, job, should_stop)
            coarse = searched.candidates[0].transformation
            result |= {"history": searched.history.tolist(), "n_evaluations": searched.n_evaluations}
        fine = icp(
            source.voxels,
            pair.target.voxels,
            init=coarse,
            method="point_to_point",
            coarse_to_fine=False,  # the paper's runs with all points from the first step
        ).transformation
    result["rms"] = rms_between(source, pair.target, coarse, lambda scan: scan.keypoints)
    result["true_rms"] = rms_between(source, pair.target, wanted, lambda scan: scan.keypoints)
    result["fine_rms"] = rms_between(source, pair.target, fine, lambda scan: scan.voxels)
    for prefix, pose in (("", coarse), ("fine_", fine)):
        rotation_deg, shift = pose_error(pose, wanted, source.points)
        result |= {f"{prefix}rotation_deg": rotation_deg, f"{prefix}shift": shift / pair.diagonal}
    result["pose"] = (fine @ away).tolist()
    return result


def search(
    source: Array, target: Array, job: Job, should_stop: ShouldStop, *, n_threads: int = 1
) -> Registration:
    """Minimise Eq. (1) between keypoints that are at hand already.

    Parameters
    ----------
    source, target : (n, 3) float64 array
        Keypoints.
    job : dict
        ``method``, ``seed``, ``n_population`` and ``n_iterations``.
    should_stop : callable
    n_threads : int
        By how many threads: one, because the command does several jobs at a time.

    Returns
    -------
    Registration
        By the whole route, whose first stages are told to leave the keypoints as they are.
    """
    # A voxel so small that each keypoint is alone in its own.
    extent = float(max(np.ptp(source, axis=0).max(), np.ptp(target, axis=0).max()))
    config: dict[str, Any] = {
        "outliers": {"min_neighbors": 0},
        "keypoints": {"radius_m": 0.2 * extent, **_ALL_ARE_KEYPOINTS},
        "voxel": {"voxel_size_m": 2e-6 * extent},
        "paper": {
            "method": job["method"],
            "hawks": {"n_hawks": job["n_population"], "n_iterations": job["n_iterations"]},
        },
        "n_threads": n_threads,
    }
    return register(
        source,
        target,
        mode="paper",
        seed=job["seed"],
        config=config,
        progress=lambda _event: should_stop(),
    )


def rms_between(source: Scan, target: Scan, pose: Array, part: Callable[[Scan], Array]) -> float:
    """Return Eq. (1) between the same part of two scans."""
    return rms_fitness(part(source), part(target), matrix_to_euler(pose))


def pose_error(found: Array, wanted: Array, source: Array) -> tuple[float, float]:
    """Return the angle between two poses in degrees, and how far apart they put the middle of the source."""
    turn = found[:3, :3] @ wanted[:3, :3].T
    axis = turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]
    angle_deg = float(np.degrees(np.arctan2(np.linalg.norm(axis), np.trace(turn) - 1.0)))
    middle = (source.min(axis=0) + source.max(axis=0))[None] / 2
    return angle_deg, float(np.linalg.norm(moved(found, middle) - moved(wanted, middle)))


SERIES = Series("registrations of Section 5.2", jobs, run)
