"""The fine adjustment: all stations at once onto the surfaces of all that they overlap with.

Why: the pose of a pair knows only the pair. Here the points of every station are drawn onto the planes of
every other one near them, all together: partners are found anew in each round, and each round is one sparse
system. A unit, `fine_equations`, makes the share of one pair of stations; what is held, observed or free is
the same as in `tmchho.network.adjust`.

Sources: point-to-plane after Chen & Medioni (1992), many clouds at once after Pulli (1999) and Bergevin et
al. (1996). Neighbouring residuals have errors in common: what a pair says counts once for each cell of space.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tmchho.network.adjust import PlaceObservation, PoseObservation, Unknowns, _Problem
from tmchho.network.engine import Engine, Item
from tmchho.network.poses import applied, displacement, inverse, moved_by, scale_of
from tmchho.network.prepare import voxel_cloud

Array = NDArray[np.float64]
Pair = tuple[int, int]

# Partners are looked for within so many voxels, at first and when the poses have come to rest.
FIRST_REACH_VOXELS, LAST_REACH_VOXELS = 2.0, 1.0
# Points of a station that take part in a pair.
MAX_POINTS = 6000
MIN_AGREEING_NORMALS = 0.8
# Tukey's biweight of residuals, by their robust standard deviation.
TUKEY = 4.685
# Residuals within a cell of so many voxels count as one observation.
CELL_VOXELS = 5.0
# Fewer partners than this say nothing.
MIN_PARTNERS = 50
MAX_ROUNDS = 25
# Added to the diagonal of the normal matrix: nothing beside what any overlap adds.
STAYING = 1e-6
# It has come to rest when no station moves by more than this share of a voxel.
REST_VOXELS = 2e-3


@dataclass(frozen=True, eq=False)
class Refined:
    """What the fine adjustment found.

    Parameters
    ----------
    poses : dict of int to (4, 4) array
        ``world_from_local``.
    normal : sparse array
        Normal matrix of the last round, in the order of the unknowns.
    shares : dict of pair to dict
        What `fine_equations` last returned for each pair that took part.
    n_iterations : int
        Rounds made.
    converged : bool
        Whether it came to rest.
    """

    poses: dict[int, Array]
    normal: Any
    shares: dict[Pair, Item]
    n_iterations: int
    converged: bool


def fine_equations(item: Item) -> Item:
    """Make the normal equations of two overlapping stations.

    Parameters
    ----------
    item : dict
        ``first`` and ``second``, references as `describe_cloud` returns them; ``first_pose`` and
        ``second_pose``, their ``world_from_local``; ``first_middle`` and ``second_middle``, local, about
        which they turn; ``reach`` and ``voxel_size`` in the unit of the world.

    Returns
    -------
    dict
        ``matrix`` (14 × 14) and ``vector`` (14) of the motions of the first, then of the second station,
        weighted by the variance of the residuals and the number of cells; ``n_pairs``; ``overlap``, the share
        of the smaller cloud's voxels with a partner; ``rms`` of the residuals.
    """
    numbers = ("first", "second")
    clouds = [voxel_cloud(item[role]) for role in numbers]
    poses = [np.array(item[f"{role}_pose"]) for role in numbers]
    middles = [
        applied(pose, np.array(item[f"{role}_middle"])) for role, pose in zip(numbers, poses, strict=True)
    ]
    rows, residuals, places, overlaps = [], [], [], []
    for here, there in ((0, 1), (1, 0)):
        own, other = clouds[here], clouds[there]
        to_other = inverse(poses[there]) @ poses[here]
        scale = scale_of(poses[there])
        moved = applied(to_other, own.points)
        reach = item["reach"] / scale
        near = _in_box(moved, other.points, reach)
        n_near = len(near)
        near = near[:: max(1, -(-n_near // MAX_POINTS))]
        if len(near) == 0:
            overlaps.append(0.0)
            continue
        distance, partner = _tree(**item[numbers[there]]).query(moved[near], distance_upper_bound=reach)
        found = np.isfinite(distance)
        overlaps.append(float(found.mean()) * n_near / len(own.points))
        near, partner = near[found], partner[found]
        normals = other.normals[partner] @ (poses[there][:3, :3] / scale).T
        turned = own.normals[near] @ (poses[here][:3, :3] / scale_of(poses[here])).T
        agree = np.abs(np.einsum("ij,ij->i", normals, turned)) > MIN_AGREEING_NORMALS
        near, partner, normals = near[agree], partner[agree], normals[agree]
        place = applied(poses[here], own.points[near])
        aim = applied(poses[there], other.points[partner])
        block = np.zeros((len(near), 14))
        for at, sign, middle, point in (
            (here, 1.0, middles[here], place),
            (there, -1.0, middles[there], aim),
        ):
            away = point - middle
            block[:, 7 * at : 7 * at + 3] = sign * np.cross(away, normals)
            block[:, 7 * at + 3 : 7 * at + 6] = sign * normals
            block[:, 7 * at + 6] = sign * np.einsum("ij,ij->i", normals, away)
        rows.append(block)
        residuals.append(np.einsum("ij,ij->i", normals, place - aim))
        places.append(place)
    n = sum(len(part) for part in residuals)
    overlap = max(overlaps)
    if n < MIN_PARTNERS:
        return {"matrix": None, "vector": None, "n_pairs": n, "overlap": overlap, "rms": None}
    jacobian, residual, place = np.concatenate(rows), np.concatenate(residuals), np.concatenate(places)
    sigma = 1.4826 * float(np.median(np.abs(residual))) + 1e-6 * item["voxel_size"]
    ratio = residual / (TUKEY * sigma)
    weight = np.where(np.abs(ratio) < 1.0, (1.0 - ratio**2) ** 2, 0.0)
    cells = np.unique(np.floor(place[weight > 0] / (CELL_VOXELS * item["voxel_size"])), axis=0)
    variance = float(weight @ residual**2 / weight.sum())
    weight *= len(cells) / weight.sum() / max(variance, 1e-300)
    weighted = jacobian * weight[:, None]
    return {
        "matrix": (jacobian.T @ weighted).tolist(),
        "vector": (weighted.T @ residual).tolist(),
        "n_pairs": n,
        "overlap": overlap,
        "rms": float(np.sqrt(variance)),
    }


def refine(
    poses: dict[int, Array],
    pairs: Sequence[Pair],
    clouds: Sequence[dict[str, str]],
    middles: Array,
    radii: Array,
    voxel_size: float,
    min_overlap: float,
    unknowns: Unknowns,
    engine: Engine,
    places: Sequence[PlaceObservation] = (),
    known_poses: Sequence[PoseObservation] = (),
    believed: Callable[[Pair], bool] = lambda pair: True,
) -> Refined:
    """Adjust all stations onto each other's surfaces.

    Parameters
    ----------
    poses : dict of int to (4, 4) array
        To begin with, good to about two voxels: ``world_from_local``.
    pairs : sequence of (int, int)
        Stations that may overlap.
    clouds : sequence of dict
        References as `describe_cloud` returns them, of all stations.
    middles, radii : arrays
        Of all clouds, local.
    voxel_size, min_overlap : float
        Edge of the voxels; pairs that share less than this of the smaller cloud do not count.
    unknowns : Unknowns
        Who moves.
    engine : Engine
        Does the work.
    places, known_poses : sequences
        Observations.
    believed : callable, optional
        Whether a pair counts even though it shares less, because it was registered.

    Returns
    -------
    Refined
    """
    from scipy.sparse.linalg import splu

    poses, pairs = dict(poses), list(pairs)
    observations = _Problem((), middles, unknowns, places, known_poses)
    reach, converged, n_iterations = FIRST_REACH_VOXELS, unknowns.n == 0, 0
    shares: dict[Pair, Item] = {}
    normal, vector = _system(observations, poses, shares, unknowns)
    for n_iterations in range(1, MAX_ROUNDS + 1):
        items = [
            {
                "first": clouds[a],
                "second": clouds[b],
                "first_pose": poses[a].tolist(),
                "second_pose": poses[b].tolist(),
                "first_middle": middles[a].tolist(),
                "second_middle": middles[b].tolist(),
                "reach": reach * voxel_size,
                "voxel_size": voxel_size,
            }
            for a, b in pairs
        ]
        found = dict(zip(pairs, engine.run("fine", fine_equations, items), strict=True))
        shares = {pair: share for pair, share in found.items() if share["matrix"] is not None}
        shares = {
            pair: share for pair, share in shares.items() if share["overlap"] >= min_overlap or believed(pair)
        }
        if n_iterations == 1:
            pairs = list(shares)
        normal, vector = _system(observations, poses, shares, unknowns)
        if unknowns.n == 0:
            break
        step = -splu(normal).solve(vector)
        largest = 0.0
        for station in unknowns.first:
            motion = unknowns.motion(step, station)
            radius = float(radii[station]) * scale_of(poses[station])
            largest = max(largest, displacement(motion, np.zeros(3), radius))
            poses[station] = moved_by(motion, poses[station], applied(poses[station], middles[station]))
        if largest < REST_VOXELS * voxel_size and reach == LAST_REACH_VOXELS:
            converged = True
            break
        # The reach shrinks as the poses come to rest, never the other way.
        if largest < 0.1 * voxel_size:
            reach = LAST_REACH_VOXELS
    return Refined(poses, normal, shares, n_iterations, converged)


def _system(
    observations: _Problem, poses: dict[int, Array], shares: dict[Pair, Item], unknowns: Unknowns
) -> tuple[Any, Array]:
    from scipy.sparse import csc_array

    jacobian = observations.jacobian(poses)
    residual = observations.residuals(poses)
    rows: list[Any] = [np.empty(0, dtype=np.intp)]
    columns: list[Any] = [np.empty(0, dtype=np.intp)]
    values: list[Array] = [np.empty(0)]
    vector = np.asarray(jacobian.T @ residual)
    for (a, b), share in shares.items():
        own = [(unknowns.columns(a), 0), (unknowns.columns(b), 7)]
        there = np.concatenate([at for at, _ in own])
        here = np.concatenate([np.arange(start, start + len(at)) for at, start in own])
        block = np.array(share["matrix"])[np.ix_(here, here)]
        rows.append(np.repeat(there, len(there)))
        columns.append(np.tile(there, len(there)))
        values.append(block.ravel())
        np.add.at(vector, there, np.array(share["vector"])[here])
    # What nothing holds stays where it is instead of making the system singular.
    everything = np.arange(unknowns.n)
    rows.append(everything)
    columns.append(everything)
    values.append(np.full(unknowns.n, STAYING))
    shape = (unknowns.n, unknowns.n)
    places = (np.concatenate(rows), np.concatenate(columns))
    normal = csc_array((np.concatenate(values), places), shape=shape) + csc_array(jacobian.T @ jacobian)
    return normal.tocsc(), vector


def _in_box(points: Array, others: Array, reach: float) -> NDArray[np.intp]:
    low, high = others.min(axis=0) - reach, others.max(axis=0) + reach
    return np.flatnonzero(((points >= low) & (points <= high)).all(axis=1))


@lru_cache(maxsize=16)
def _tree(path: str, sha256: str) -> Any:
    from scipy.spatial import cKDTree

    return cKDTree(voxel_cloud({"path": path, "sha256": sha256}).points)
