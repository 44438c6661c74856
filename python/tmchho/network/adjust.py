"""All stations at once: the poses that contradict links and observations least.

Unknowns are a small motion of each station about the middle of its cloud: six numbers, seven where its
scale is free. Links count by the inverse of their covariance, positions, poses and control points by their
standard deviations. `scipy.optimize.least_squares` solves it with a sparse Jacobian and Cauchy's loss, from
the poses that the links lead to.

Sources: Grisetti, Kümmerle, Stachniss & Burgard (2010), "A tutorial on graph-based SLAM"; standard
errors from the inverse of the normal matrix, as in any adjustment.
Absent on purpose: the search for wrong links, which is that of `tmchho.network.loops`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tmchho.network.links import Link
from tmchho.network.poses import (
    applied,
    cross_matrix,
    inverse,
    motion_between,
    moved_by,
    rotation_vector,
    scale_of,
)

Array = NDArray[np.float64]

# Residuals beyond so many standard deviations (or so many times what is usual) lose weight.
LOSS_SCALE = 3.0
MAX_ROUNDS = 12


@dataclass(frozen=True, eq=False)
class PlaceObservation:
    """A place of a station, in its local frame, whose position in the world was measured."""

    station: int
    place: Array
    position: Array
    sigma_m: Array


@dataclass(frozen=True, eq=False)
class PoseObservation:
    """The pose of a station, as known before."""

    station: int
    pose: Array
    origin: Array
    sigma_rad: float
    sigma_m: float


@dataclass(frozen=True, eq=False)
class Adjusted:
    """What an adjustment found.

    Parameters
    ----------
    poses : dict of int to (4, 4) array
        ``world_from_local`` of each station.
    normal : sparse array
        The normal matrix, in the order of `Unknowns`.
    unit_weight_error : float
        Root of the weighted squares by the redundancy; NaN without any.
    """

    poses: dict[int, Array]
    normal: Any
    unit_weight_error: float


class Unknowns:
    """Which column of the system belongs to which motion of which station.

    Parameters
    ----------
    stations : sequence of int
        All that take part.
    held : set of int
        Those that stay where they are.
    free_scale : set of int
        Those whose scale is unknown.
    """

    def __init__(self, stations: Sequence[int], held: set[int], free_scale: set[int]) -> None:
        self.first: dict[int, int] = {}
        self.size: dict[int, int] = {}
        at = 0
        for station in stations:
            if station not in held:
                self.first[station], self.size[station] = at, 7 if station in free_scale else 6
                at += self.size[station]
        self.n = at

    def columns(self, station: int) -> NDArray[np.intp]:
        """Return the columns of a station, none where it is held."""
        if station not in self.first:
            return np.empty(0, dtype=np.intp)
        return np.arange(self.first[station], self.first[station] + self.size[station])

    def motion(self, x: Array, station: int) -> Array:
        """Return the seven numbers of a station's motion in a vector of unknowns."""
        motion = np.zeros(7)
        columns = self.columns(station)
        motion[: len(columns)] = x[columns]
        return motion


def adjust(
    poses: dict[int, Array],
    links: Sequence[Link],
    middles: Array,
    unknowns: Unknowns,
    places: Sequence[PlaceObservation] = (),
    known_poses: Sequence[PoseObservation] = (),
) -> Adjusted:
    """Find the poses that contradict links and observations least.

    Parameters
    ----------
    poses : dict of int to (4, 4) array
        To begin with: ``world_from_local``.
    links : sequence of Link
        Between stations of `poses`.
    middles : (n, 3) float64 array
        Of all clouds, in their local frames.
    unknowns : Unknowns
        Who moves; something has to give the frame.
    places, known_poses : sequences
        Observations.

    Returns
    -------
    Adjusted
    """
    from scipy.optimize import least_squares

    problem = _Problem(links, middles, unknowns, places, known_poses)
    poses = dict(poses)
    f_scale = LOSS_SCALE * max(1.0, _usual(problem.residuals(poses)))
    for _ in range(MAX_ROUNDS):
        if unknowns.n == 0:
            break

        def moved(x: Array, base: dict[int, Array] = poses) -> dict[int, Array]:
            return {
                station: moved_by(unknowns.motion(x, station), pose, applied(pose, middles[station]))
                for station, pose in base.items()
            }

        found = least_squares(
            lambda x, moved=moved: problem.residuals(moved(x)),
            np.zeros(unknowns.n),
            jac=lambda x, moved=moved: problem.jacobian(moved(x)),
            loss="cauchy",
            f_scale=f_scale,
            x_scale="jac",
            tr_solver="lsmr",
            tr_options={"atol": 1e-12, "btol": 1e-12},
            xtol=1e-13,
            ftol=1e-13,
            gtol=1e-13,
            max_nfev=30,
        )
        poses = moved(found.x)
        usual = LOSS_SCALE * max(1.0, _usual(problem.residuals(poses)))
        step = problem.steps(found.x)
        settled = step < 1e-9 and abs(usual - f_scale) < 1e-6 * f_scale
        f_scale = usual
        if settled:
            break
    residuals, jacobian = problem.residuals(poses), problem.jacobian(poses)
    redundancy = problem.n_observations - unknowns.n
    square = float(residuals @ residuals)
    error = float(np.sqrt(square / redundancy)) if redundancy > 0 else float("nan")
    return Adjusted(poses, (jacobian.T @ jacobian).tocsc(), error)


def standard_errors(normal: Any, unknowns: Unknowns) -> dict[int, Array]:
    """Return the covariance of each station's motion, (6, 6) or (7, 7), from the normal matrix.

    Parameters
    ----------
    normal : sparse array
        Of the system; regular.
    unknowns : Unknowns
        What its columns mean.
    """
    from scipy.sparse.linalg import splu

    if unknowns.n == 0:
        return {}
    # Angles and lengths differ by the size of the site; the inverse of a scaled matrix loses less.
    scale = 1.0 / np.sqrt(np.maximum(normal.diagonal(), 1e-300))
    from scipy.sparse import diags_array

    factor = splu((diags_array(scale) @ normal @ diags_array(scale)).tocsc())
    found = {}
    for station in unknowns.first:
        columns = unknowns.columns(station)
        unit = np.zeros((unknowns.n, len(columns)))
        unit[columns, np.arange(len(columns))] = scale[columns]
        block = (scale[:, None] * factor.solve(unit))[columns]
        found[station] = 0.5 * (block + block.T)
    return found


def place_jacobian(pose: Array, place: Array, middle: Array) -> Array:
    """Return the (3, 7) derivative of a place's position by the motion of its station.

    Parameters
    ----------
    pose : (4, 4) array
        ``world_from_local``.
    place, middle : (3,) arrays
        Local.
    """
    away = applied(pose, place) - applied(pose, middle)
    return np.column_stack([-cross_matrix(away), np.eye(3), away])


class _Problem:
    """Residuals and their derivatives."""

    def __init__(
        self,
        links: Sequence[Link],
        middles: Array,
        unknowns: Unknowns,
        places: Sequence[PlaceObservation],
        known_poses: Sequence[PoseObservation],
    ) -> None:
        self.links, self.middles, self.unknowns = links, middles, unknowns
        self.places, self.known_poses = places, known_poses
        self.roots = [_root(link.information) for link in links]
        # What a link does not know of a motion is no observation.
        self.n_observations = 3 * len(places) + 6 * len(known_poses)
        self.n_observations += sum(int(np.count_nonzero(np.diag(link.information))) for link in links)

    def residuals(self, poses: dict[int, Array]) -> Array:
        parts = [
            root @ link_motion(link, poses[link.source], poses[link.target])
            for link, root in zip(self.links, self.roots, strict=True)
        ]
        parts += [(applied(poses[o.station], o.place) - o.position) / o.sigma_m for o in self.places]
        for o in self.known_poses:
            pose = poses[o.station]
            turn = pose[:3, :3] / scale_of(pose) @ o.pose[:3, :3].T
            shift = applied(pose, o.origin) - applied(o.pose, o.origin)
            parts.append(np.concatenate([rotation_vector(turn) / o.sigma_rad, shift / o.sigma_m]))
        return np.concatenate([*parts, np.zeros(0)])

    def jacobian(self, poses: dict[int, Array]) -> Any:
        from scipy.sparse import csr_array

        rows: list[Array] = []
        columns: list[Array] = []
        values: list[Array] = []
        at = 0

        def put(block: Array, station: int) -> None:
            of_station = self.unknowns.columns(station)
            block = block[:, : len(of_station)]
            rows.append(np.repeat(np.arange(at, at + len(block)), len(of_station)))
            columns.append(np.tile(of_station, len(block)))
            values.append(block.ravel())

        for link, root in zip(self.links, self.roots, strict=True):
            by_source, by_target = self._link_derivatives(link, poses)
            put(root @ by_source, link.source)
            put(root @ by_target, link.target)
            at += 7
        for o in self.places:
            block = place_jacobian(poses[o.station], o.place, self.middles[o.station])
            put(block / np.asarray(o.sigma_m)[:, None], o.station)
            at += 3
        for known in self.known_poses:
            pose = poses[known.station]
            turn = rotation_vector(pose[:3, :3] / scale_of(pose) @ known.pose[:3, :3].T)
            block = np.zeros((6, 7))
            block[:3, :3] = _inverse_left_jacobian(turn) / known.sigma_rad
            block[3:] = place_jacobian(pose, known.origin, self.middles[known.station]) / known.sigma_m
            put(block, known.station)
            at += 6
        shape = (at, self.unknowns.n)
        if not values:
            return csr_array(shape)
        return csr_array(
            (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), shape=shape
        )

    def _link_derivatives(self, link: Link, poses: dict[int, Array]) -> tuple[Array, Array]:
        source, target = poses[link.source], poses[link.target]
        change = inverse(target) @ source @ inverse(link.pose)
        scale = scale_of(change)
        # What moves is the place to which the network takes the middle of the link.
        place = applied(change, link.middle)
        back = target[:3, :3].T / scale_of(target) ** 2
        turn = target[:3, :3].T / scale_of(target)
        left = _inverse_left_jacobian(rotation_vector(change[:3, :3] / scale))
        blocks = []
        for station, sign in ((link.source, 1.0), (link.target, -1.0)):
            middle = applied(poses[station], self.middles[station])
            away = applied(target, place) - middle
            block = np.zeros((7, 7))
            block[:3, :3] = left @ turn
            block[3:6] = back @ np.column_stack([-cross_matrix(away), np.eye(3), away])
            block[6, 6] = 1.0
            blocks.append(sign * block)
        return blocks[0], blocks[1]

    def steps(self, x: Array) -> float:
        """Return the largest number of a vector of unknowns, lengths counted by how large the site is."""
        if not len(x):
            return 0.0
        size = max(1.0, float(np.abs(self.middles).max()))
        weights = np.ones(len(x))
        for station in self.unknowns.first:
            weights[self.unknowns.columns(station)[3:6]] = 1.0 / size
        return float(np.abs(x * weights).max())


def link_motion(link: Link, source_pose: Array, target_pose: Array) -> Array:
    """Return the motion, about the link's middle, from what the pair alone says to what the network says."""
    return motion_between(inverse(target_pose) @ source_pose, link.pose, link.middle)


def normalised_residual(link: Link, source_pose: Array, target_pose: Array) -> float:
    """Return what a link's residual is by what its covariance lets expect: about 1 where all is well."""
    motion = link_motion(link, source_pose, target_pose)
    n_known = int(np.count_nonzero(np.diag(link.information)))
    square = float(motion @ link.information @ motion)
    return float(np.sqrt(max(square, 0.0) / max(n_known, 1)))


def _usual(residuals: Array) -> float:
    known = np.abs(residuals[residuals != 0])
    return 1.4826 * float(np.median(known)) if len(known) else 0.0


def _root(information: Array) -> Array:
    """Return a matrix L with Lᵀ·L the information."""
    scale = np.sqrt(np.maximum(np.diag(information), 0.0))
    safe = np.where(scale > 0, scale, 1.0)
    values, vectors = np.linalg.eigh(information / safe[:, None] / safe)
    return np.asarray((np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T) * scale)


def _inverse_left_jacobian(turn: Array) -> Array:
    angle = float(np.linalg.norm(turn))
    k = cross_matrix(turn)
    if angle < 1e-6:
        return np.asarray(np.eye(3) - 0.5 * k + k @ k / 12.0)
    factor = (1.0 - 0.5 * angle / np.tan(0.5 * angle)) / angle**2
    return np.asarray(np.eye(3) - 0.5 * k + factor * k @ k)
