"""Which pairs are worth a registration: of n·(n-1)/2 pairs only some for each station, by three means.

1. What is known of the positions, if only roughly (`near_pairs`), or since links have placed some of the
   stations (`overlapping_pairs`).
2. Votes: descriptors of all stations in one index; who has many of a station's nearest neighbours, is a
   candidate (`voted_pairs`). This grows with the stations, not with their pairs.
3. A brief look at a candidate (`screen_pair`, a unit): how many matches of descriptors one pose explains.

Sources: vote counting after Sivic & Zisserman (2003) in spirit; the consistency of matches after Leordeanu &
Hebert (2005): two true matches keep their distance.
Absent on purpose: verdicts. What is proposed wrongly is refused by the registration, or by the loops.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tmchho.network.descriptors import VOXEL_BY_UNIT
from tmchho.network.engine import Item
from tmchho.network.poses import applied, scale_of
from tmchho.network.prepare import load, voxel_cloud

Array = NDArray[np.float64]
Pair = tuple[int, int]

# Places of a station that vote, the most unusual first, and how many answers each of them gets.
N_VOTERS = 300
N_ANSWERS = 20
N_PRINCIPAL = 10
# Of the matches of a pair, the closest ones are looked at.
MAX_MATCHES = 800
N_SEEDS = 60
N_MATES = 20
MATCH_TOLERANCE_VOXELS = 1.5


def near_pairs(centres: Array, reaches: Array, known: NDArray[np.bool_]) -> list[Pair]:
    """Return the pairs whose clouds can touch, of those stations of which a position is known.

    Parameters
    ----------
    centres : (n, 3) float64 array
        Middles of the clouds in the world; what is not known is not looked at.
    reaches : (n,) float64 array
        How far a cloud, and the doubt about its place, reach from there.
    known : (n,) bool array
        Whose position is known.

    Returns
    -------
    list of (int, int)
        Rising.
    """
    from scipy.spatial import cKDTree

    rows = np.flatnonzero(known)
    if len(rows) < 2:
        return []
    tree = cKDTree(centres[rows])
    found = set()
    for row in rows.tolist():
        # Twice its own reach meets all that reach no farther; the longer arms find it from their side.
        for k in sorted(tree.query_ball_point(centres[row], 2.0 * float(reaches[row]))):
            other = int(rows[k])
            apart = float(np.linalg.norm(centres[row] - centres[other]))
            if other != row and apart < float(reaches[row] + reaches[other]):
                found.add((min(row, other), max(row, other)))
    return sorted(found)


def overlapping_pairs(
    poses: dict[int, Array],
    clouds: Sequence[dict[str, str]],
    middles: Array,
    reaches: Array,
    spacing: float,
    min_overlap: float,
) -> list[Pair]:
    """Return the pairs of placed stations that share a part, as their keypoints show.

    Parameters
    ----------
    poses : dict of int to (4, 4) array
        Of the stations that are placed, in one frame.
    clouds : sequence of dict
        References as `describe_cloud` returns them, of all stations.
    middles, reaches : arrays
        Of all clouds, local.
    spacing : float
        Of the keypoints in that frame.
    min_overlap : float
        Share of the smaller cloud's keypoints that have one of the other nearby.

    Returns
    -------
    list of (int, int)
        Rising.
    """
    from scipy.spatial import cKDTree

    n = len(clouds)
    known = np.isin(np.arange(n), list(poses))
    centres = np.zeros((n, 3))
    for station, pose in poses.items():
        centres[station] = applied(pose, middles[station])
    scales = np.array([scale_of(poses[k]) if k in poses else 1.0 for k in range(n)])
    pairs = near_pairs(centres, reaches * scales, known)
    wanted = {station for pair in pairs for station in pair}
    points = {k: applied(poses[k], voxel_cloud(clouds[k]).keypoints) for k in sorted(wanted)}
    trees = {k: cKDTree(placed) for k, placed in points.items()}
    found = []
    for a, b in pairs:
        small, large = (a, b) if len(points[a]) <= len(points[b]) else (b, a)
        distances, _ = trees[large].query(points[small], distance_upper_bound=1.5 * spacing)
        if np.isfinite(distances).mean() >= min_overlap:
            found.append((a, b))
    return found


def voted_pairs(clouds: Sequence[dict[str, str]]) -> list[list[int]]:
    """Rank for each station those that look alike in places, the most alike first.

    Parameters
    ----------
    clouds : sequence of dict
        References as `describe_cloud` returns them.

    Returns
    -------
    list of lists of int
        Only stations with a vote.
    """
    from scipy.spatial import cKDTree

    voters, owners = [], []
    for number, reference in enumerate(clouds):
        descriptors = load(reference)["descriptors"].astype(np.float64)
        unusual = np.linalg.norm(descriptors - descriptors.mean(axis=0), axis=1)
        chosen = np.sort(np.argsort(-unusual, kind="stable")[:N_VOTERS])
        voters.append(descriptors[chosen])
        owners.append(np.full(len(chosen), number))
    everything, owner = np.concatenate(voters), np.concatenate(owners)
    middle = everything.mean(axis=0)
    _, _, axes = np.linalg.svd((everything - middle).T @ (everything - middle))
    reduced = (everything - middle) @ axes[:N_PRINCIPAL].T
    n = len(clouds)
    _, answers = cKDTree(reduced).query(reduced, k=min(N_ANSWERS + 1, len(reduced)))
    votes = np.zeros((n, n))
    weight = np.ones_like(answers, dtype=np.float64)
    np.add.at(votes, (np.repeat(owner, answers.shape[1]), owner[answers].ravel()), weight.ravel())
    np.fill_diagonal(votes, 0.0)
    votes = votes + votes.T
    return [[int(k) for k in np.argsort(-row, kind="stable") if row[k] > 0] for row in votes]


def screen_pair(item: Item) -> Item:
    """Count the matches of descriptors that one pose explains at best.

    Parameters
    ----------
    item : dict
        ``first`` and ``second``, references as `describe_cloud` returns them; ``unit``, as given there.

    Returns
    -------
    dict
        ``n_agreeing``, and ``pose``, which takes the first to the second, None where no three matches agree.
    """
    first, second = voxel_cloud(item["first"]), voxel_cloud(item["second"])
    tolerance = MATCH_TOLERANCE_VOXELS * VOXEL_BY_UNIT * item["unit"]
    alike = first.descriptors @ second.descriptors.T
    there, back = alike.argmax(axis=1), alike.argmax(axis=0)
    rows = np.flatnonzero(back[there] == np.arange(len(there)))
    rows = rows[np.argsort(-alike[rows, there[rows]], kind="stable")[:MAX_MATCHES]]
    if len(rows) < 3:
        return {"n_agreeing": 0, "pose": None}
    p, q = first.keypoints[rows], second.keypoints[there[rows]]
    np_, nq = first.key_normals[rows], second.key_normals[there[rows]]
    agree = np.abs(_distances(p) - _distances(q)) < tolerance
    agree &= np.abs(np.abs(np_ @ np_.T) - np.abs(nq @ nq.T)) < 0.25
    agree &= _distances(p) > 2.0 * tolerance
    links = agree.astype(np.float32)
    triangles = (links @ links) * links
    strength = triangles.sum(axis=1)
    best, best_pose = 0, None
    for seed in np.argsort(-strength, kind="stable")[:N_SEEDS]:
        mates = np.argsort(-triangles[seed], kind="stable")[:N_MATES]
        mates = np.append(mates[triangles[seed, mates] > 0], seed)
        if len(mates) < 3:
            break  # the seeds that follow have no more
        for _ in range(3):
            if len(mates) < 3:
                break
            pose = fitted_pose(p[mates], q[mates])
            moved = p @ pose[:3, :3].T + pose[:3, 3]
            near = np.linalg.norm(moved - q, axis=1) < tolerance
            turned = np.abs(np.einsum("ij,ij->i", np_ @ pose[:3, :3].T, nq)) > 0.8
            mates = np.flatnonzero(near & turned)
        if len(mates) > best:
            best, best_pose = len(mates), pose
    return {"n_agreeing": best, "pose": None if best_pose is None else best_pose.tolist()}


def fitted_pose(source: Array, target: Array) -> Array:
    """Return the rigid pose that takes points nearest to others (Kabsch 1976)."""
    a, b = source.mean(axis=0), target.mean(axis=0)
    u, _, vt = np.linalg.svd((source - a).T @ (target - b))
    turn = vt.T @ np.diag([1.0, 1.0, np.sign(np.linalg.det(vt.T @ u.T))]) @ u.T
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turn, b - turn @ a
    return pose


def _distances(points: Array) -> Array:
    square = np.einsum("ij,ij->i", points, points)
    return np.asarray(np.sqrt(np.maximum(square[:, None] + square - 2.0 * points @ points.T, 0.0)))
