"""Rotations, small motions and similarity poses, as the adjustment of a network counts them.

A small motion has seven numbers: a turn about the world's axes (rad), a shift, and the logarithm of a scale;
turn and scale are about a given middle. Poses are 4 × 4 matrices whose 3 × 3 part may be scaled.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

N_MOTIONS = 7


def cross_matrix(v: Array) -> Array:
    """Return the matrix [v]× with ``[v]× @ w == np.cross(v, w)``."""
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def turned_by(rotation_vector: Array) -> Array:
    """Return the rotation matrix of a rotation vector in radians (Rodrigues)."""
    angle = float(np.linalg.norm(rotation_vector))
    k = cross_matrix(np.asarray(rotation_vector, dtype=np.float64))
    if angle < 1e-8:
        return np.asarray(np.eye(3) + k + 0.5 * k @ k)
    return np.asarray(np.eye(3) + np.sin(angle) / angle * k + (1 - np.cos(angle)) / angle**2 * k @ k)


def rotation_vector(rotation: Array) -> Array:
    """Return the rotation vector of a rotation matrix, of a length up to π."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_matrix(rotation).as_rotvec())


def scale_of(pose: Array) -> float:
    """Return the scale in the 3 × 3 part of a pose."""
    return float(np.cbrt(np.linalg.det(pose[:3, :3])))


def inverse(pose: Array) -> Array:
    """Return the inverse of a similarity pose."""
    scale_sq = scale_of(pose) ** 2
    back = np.eye(4)
    back[:3, :3] = pose[:3, :3].T / scale_sq
    back[:3, 3] = -back[:3, :3] @ pose[:3, 3]
    return back


def rigid(pose: Array) -> Array:
    """Return a similarity pose with scale 1: turned alike, and its origin in the same place."""
    found = pose.copy()
    found[:3, :3] /= scale_of(pose)
    return found


def applied(pose: Array, points: Array) -> Array:
    """Return (n, 3) points, or one, moved by a pose."""
    return np.asarray(points @ pose[:3, :3].T + pose[:3, 3])


def moved_by(motion: Array, pose: Array, middle: Array) -> Array:
    """Return a pose followed by a small motion about a middle of the world."""
    change = np.eye(4)
    change[:3, :3] = np.exp(motion[6]) * turned_by(motion[:3])
    change[:3, 3] = middle + motion[3:6] - change[:3, :3] @ middle
    return np.asarray(change @ pose)


def motion_between(found: Array, wanted: Array, middle: Array) -> Array:
    """Return the small motion about a middle that takes what `wanted` moves to where `found` moves it.

    Parameters
    ----------
    found, wanted : (4, 4) float64 array
        Poses of the same cloud.
    middle : (3,) float64 array
        A place in the frame they lead to.
    """
    change = found @ inverse(wanted)
    scale = scale_of(change)
    return np.concatenate(
        [
            rotation_vector(change[:3, :3] / scale),
            applied(change, middle) - middle,
            [np.log(scale)],
        ]
    )


def displacement(motion: Array, away: Array, radius: float) -> float:
    """Return how far a small motion moves the points of a cloud, root mean square.

    Parameters
    ----------
    motion : (7,) float64 array
        About some middle.
    away : (3,) float64 array
        From that middle to the middle of the cloud.
    radius : float
        Of gyration of the cloud, taken as round.
    """
    linear = np.exp(motion[6]) * turned_by(motion[:3]) - np.eye(3)
    shift = motion[3:6] + linear @ away
    # The mean of |linear @ x|² over points spread alike in all directions.
    return float(np.sqrt(shift @ shift + (linear**2).sum() * radius**2 / 3.0))
