"""One station sought in a block, where a pair alone leaves doubts: every place it could have is compared.

Why: a block sees the whole site, so it knows every place that looks like the station's. On bare slopes the
search finds several that fit within a voxel; drawn onto the surface and measured by what the best of them
scatters, the right one stands out. Where it does not, as with two equal piers, the station is not placed by
what happens to be found first: both places are the same to everybody who looks from there.

A unit, `seat_station`. Absent on purpose: the scans of other stations as witnesses. They have been at one
place and not at the other, and would always speak for the place where somebody stood.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tmchho.errors import InvalidCloudError, NoSolutionError
from tmchho.network.engine import Item, unit_progress, unit_threads
from tmchho.network.links import register_link
from tmchho.network.poses import applied, moved_by
from tmchho.network.prepare import VoxelCloud, load, voxel_cloud
from tmchho.pipeline import register

Array = NDArray[np.float64]

# Points of a block so near to what a placed station has seen are not where a lost station stands alone.
SEEN_VOXELS = 5.0
# A part of a block with fewer points is not searched for itself.
MIN_UNSEEN_POINTS = 1000
# The other place must leave so many times as much of the station unexplained.
MIN_SEAT_RATIO = 1.3
# Poses nearer to each other than this are one place: how firmly the surface holds it there is not asked here.
SAME_PLACE_VOXELS = 5.0
# The pose that is then registered at the best place lies as near to it as this.
HELD_VOXELS = 2.0
# Partners are looked for within so many voxels, for up to so many rounds, until a round moves by less.
REACHES_VOXELS = ((4.0, 10), (2.0, 10), (1.0, 20))
REST_VOXELS = 2e-3
MAX_POINTS = 4000
# Candidates that are drawn to within this of another one on their way have the same end.
SAME_WAY_VOXELS = 0.05
# Tukey's biweight of residuals, by their robust standard deviation.
TUKEY = 4.685
# What a place explains lies within so many standard deviations of the best place's residuals.
EXPLAINED_SIGMAS = 2.5
MIN_AGREEING_NORMALS = 0.9


def seat_station(item: Item) -> Item:
    """Find the place of a station in a block, and how clearly it is the only one.

    Parameters
    ----------
    item : dict
        ``source`` and ``target``, references to the station and the block as `prepare_cloud` returns them;
        ``station`` and ``block``, the same as `describe_cloud` does; ``config`` of a search, and
        ``near_config`` of one with a prior whose pose is still to be set; ``places``, poses from station to
        block that are known already; ``seen``, each with a described ``cloud`` and its ``pose`` in the block;
        ``voxel_size``.

    Returns
    -------
    dict
        As `register_link` returns it, for the best place, accepted where it is the only one;
        ``ambiguity_ratio`` is what the next best place leaves unexplained by what the best one does. Also
        ``rival``, the pose of that place, None without.
    """
    source, target = (load(item[role])["points"] for role in ("source", "target"))
    poses = [np.array(pose) for pose in item["places"]]
    unseen = target[_is_unseen(target, item["seen"], item["voxel_size"])]
    for part in (target, unseen):
        if part is target or len(unseen) >= MIN_UNSEEN_POINTS:
            poses += _candidates(source, part, item["config"])
    places = compare_places(
        voxel_cloud(item["station"]), voxel_cloud(item["block"]), poses, item["voxel_size"]
    )
    if not places:
        return {"pose": None, "verdict": "rejected", "reasons": ["no place was found"], "rival": None}
    best, explained = places[0]
    ratio, rival = math.inf, None
    if len(places) > 1:
        rival = places[1][0]
        ratio = (1.0 - places[1][1]) / max(1.0 - explained, 1e-9)
    near = item["near_config"]
    known = {**near["known"], "prior": {**near["known"]["prior"], "target_from_source": best.tolist()}}
    found = register_link(
        {"source": item["source"], "target": item["target"], "config": {**near, "known": known}}
    )
    if found["pose"] is None:
        return {**found, "rival": None}
    away = _apart(np.array(found["pose"]), best, source[:: max(1, len(source) // MAX_POINTS)])
    found["ambiguity_ratio"] = ratio if math.isfinite(ratio) else None
    if away > HELD_VOXELS * item["voxel_size"]:
        found["verdict"], found["reasons"] = "rejected", ["the surface does not hold it where it fits best"]
    elif ratio >= MIN_SEAT_RATIO:
        found["verdict"] = "accepted"
        found["reasons"] = [f"any other place in the block leaves {ratio:.2g} times as much unexplained"]
    else:
        found["verdict"] = "review"
        found["reasons"] = [f"another place in the block leaves only {ratio:.2g} times as much unexplained"]
    return {**found, "rival": None if rival is None else rival.tolist()}


def compare_places(
    station: VoxelCloud, block: VoxelCloud, poses: list[Array], voxel_size: float
) -> list[tuple[Array, float]]:
    """Draw a station onto a block at several places, and say what each of them explains of it.

    Parameters
    ----------
    station, block : VoxelCloud
        In their local frames.
    poses : list of (4, 4) array
        From station to block, good to some voxels.
    voxel_size : float
        Of both.

    Returns
    -------
    list of (pose, share)
        Of places that differ, the best first: the share of those points of the station that have a surface
        of the block no farther away than the scatter of the best place lets expect.
    """
    from scipy.spatial import cKDTree

    tree = cKDTree(block.points)
    sample = station.points[:: max(1, len(station.points) // MAX_POINTS)]
    drawn = poses
    for reach, n_rounds in REACHES_VOXELS:
        ended: list[Array] = []
        for pose in drawn:
            end = _drawn(sample, block, tree, pose, voxel_size, reach, n_rounds)
            if all(_apart(end, other, sample) > SAME_WAY_VOXELS * voxel_size for other in ended):
                ended.append(end)
        drawn = ended
    measured = [(pose, _residuals(station, block, tree, pose, voxel_size)) for pose in drawn]
    measured = [one for one in measured if np.isfinite(one[1]).mean() > 0.5]
    if not measured:
        return []
    # The smallest scatter of all is what the clouds can do; no place is measured by its own.
    sigma = min(1.4826 * float(np.median(residuals)) for _, residuals in measured)
    limit = EXPLAINED_SIGMAS * max(sigma, 0.01 * voxel_size)
    shares = [(pose, float((residuals <= limit).mean())) for pose, residuals in measured]
    places: list[tuple[Array, float]] = []
    for pose, share in sorted(shares, key=lambda one: -one[1]):
        if all(_apart(pose, other, sample) > SAME_PLACE_VOXELS * voxel_size for other, _ in places):
            places.append((pose, share))
    return places


def _is_unseen(points: Array, seen: list[dict[str, Any]], voxel_size: float) -> NDArray[np.bool_]:
    """Tell which points no placed station has come near to."""
    from scipy.spatial import cKDTree

    if not seen:
        return np.zeros(len(points), dtype=bool)
    covered = np.concatenate(
        [applied(np.array(one["pose"]), voxel_cloud(one["cloud"]).points[::4]) for one in seen]
    )
    distances, _ = cKDTree(covered).query(points, distance_upper_bound=SEEN_VOXELS * voxel_size)
    return np.asarray(~np.isfinite(distances))


def _candidates(source: Array, target: Array, config: dict[str, Any]) -> list[Array]:
    settings = {**config, "n_threads": unit_threads()}
    settings = {key: value for key, value in settings.items() if value is not None}
    try:
        found = register(source, target, config=settings, progress=unit_progress)
    except (NoSolutionError, InvalidCloudError):
        return []
    return [found.transformation, *(candidate.transformation for candidate in found.candidates)]


def _drawn(
    points: Array, block: VoxelCloud, tree: Any, pose: Array, voxel_size: float, reach: float, n_rounds: int
) -> Array:
    """Draw points onto the planes of a block (Chen & Medioni 1992), robustly, until they come to rest."""
    for _ in range(n_rounds):
        moved = applied(pose, points)
        distance, partner = tree.query(moved, distance_upper_bound=reach * voxel_size)
        near = np.isfinite(distance)
        if near.sum() < 50:
            break
        moved, normals = moved[near], block.normals[partner[near]]
        residual = np.einsum("ij,ij->i", normals, moved - block.points[partner[near]])
        sigma = 1.4826 * float(np.median(np.abs(residual))) + 1e-6 * voxel_size
        ratio = residual / (TUKEY * sigma)
        weight = np.where(np.abs(ratio) < 1.0, (1.0 - ratio**2) ** 2, 0.0)
        middle = moved.mean(axis=0)
        jacobian = np.hstack([np.cross(moved - middle, normals), normals])
        normal = jacobian.T @ (jacobian * weight[:, None]) + 1e-9 * np.eye(6)
        step = -np.linalg.solve(normal, jacobian.T @ (weight * residual))
        before, pose = pose, moved_by(np.append(step, 0.0), pose, middle)
        if _apart(pose, before, points) < REST_VOXELS * voxel_size:
            break
    return pose


def _residuals(station: VoxelCloud, block: VoxelCloud, tree: Any, pose: Array, voxel_size: float) -> Array:
    """Return how far a station's points lie from the surface of a block, infinite where there is none."""
    moved = applied(pose, station.points)
    distance, partner = tree.query(moved, distance_upper_bound=1.5 * voxel_size)
    near = np.flatnonzero(np.isfinite(distance))
    normals = block.normals[partner[near]]
    turned = station.normals[near] @ pose[:3, :3].T
    agree = np.abs(np.einsum("ij,ij->i", normals, turned)) > MIN_AGREEING_NORMALS
    residuals = np.full(len(moved), np.inf)
    residuals[near[agree]] = np.abs(
        np.einsum("ij,ij->i", normals, moved[near] - block.points[partner[near]])
    )[agree]
    return residuals


def _apart(pose: Array, other: Array, points: Array) -> float:
    """Return how far two poses take the same points apart, root mean square."""
    return float(np.sqrt(((applied(pose, points) - applied(other, points)) ** 2).sum(axis=1).mean()))
