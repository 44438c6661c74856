"""The clouds of Section 5.2: four objects, each as two real scans and as a scan and its own moved copy.

The real ones are those of Stanford's repository, in the folder `stanford` of TMCHHO_DATA. Where that is not
set, objects made by code stand in for them; they are called so everywhere.
"""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tmchho.errors import ReadError
from tmchho.io import read
from tmchho.paper.objects import scan_object
from tmchho.stages import iss_keypoints, remove_outliers, voxel_downsample

Array = NDArray[np.float64]

MODELS = ("armadillo", "bunny", "dragon", "happy")
KINDS = ("copy", "pair")
VOXEL_SIZE = 0.001
# Not printed for these clouds; three voxels, as in Section 5.3.
KEYPOINT_RADIUS = 3 * VOXEL_SIZE


@dataclass(frozen=True, eq=False)
class Scan:
    """A cloud and what the preprocessing makes of it.

    Parameters
    ----------
    points, voxels, keypoints : (n, 3) float64 array
        All points, voxel centroids of those that do not stand alone, ISS keypoints among these.
    """

    points: Array
    voxels: Array
    keypoints: Array

    def moved(self, pose: Array) -> Scan:
        """Return the same scan in another place."""
        return Scan(*(moved(pose, cloud) for cloud in (self.points, self.voxels, self.keypoints)))


@dataclass(frozen=True, eq=False)
class Pair:
    """Two scans and the pose that takes the source to the target."""

    source: Scan
    target: Scan
    target_from_source: Array

    @property
    def diagonal(self) -> float:
        """Diagonal of the target's box."""
        return float(np.linalg.norm(np.ptp(self.target.points, axis=0)))


def moved(pose: Array, points: Array) -> Array:
    """Return points moved by a (4, 4) pose."""
    return np.asarray(points @ pose[:3, :3].T + pose[:3, 3])


def provenance() -> str:
    """Return whose clouds there are: ``'stanford'``, or ``'simulated'`` where TMCHHO_DATA is not set."""
    return "stanford" if os.environ.get("TMCHHO_DATA") else "simulated"


@lru_cache(maxsize=8)
def load_pair(provenance: str, model: str, kind: str) -> Pair:
    """Return the clouds of one experiment.

    Parameters
    ----------
    provenance : {'stanford', 'simulated'}
    model : str
        One of `MODELS`.
    kind : {'copy', 'pair'}
        The target and its copy, or two scans.

    Raises
    ------
    ReadError
        If TMCHHO_DATA does not hold the scans.
    """
    source, target, pose = (_stanford if provenance == "stanford" else _simulated)(model)
    still = prepare(target, VOXEL_SIZE, KEYPOINT_RADIUS)
    if kind == "copy":
        return Pair(still, still, np.eye(4))
    return Pair(prepare(source, VOXEL_SIZE, KEYPOINT_RADIUS), still, pose)


def prepare(points: Array, voxel_size: float, keypoint_radius: float) -> Scan:
    """Do the preprocessing of Section 4.2."""
    kept = points[remove_outliers(points).indices]
    voxels = voxel_downsample(kept, voxel_size).points
    return Scan(points, voxels, voxels[iss_keypoints(voxels, radius=keypoint_radius)])


def _simulated(model: str) -> tuple[Array, Array, Array]:
    seed = MODELS.index(model)
    return scan_object(seed, "left"), scan_object(seed, "right"), np.eye(4)


def _stanford(model: str) -> tuple[Array, Array, Array]:
    pair = listed_pair(model)
    source, target = (read(_stanford_folder() / pair[side]).xyz for side in ("source", "target"))
    pose = np.array(pair["target_from_source"], dtype=float)
    return source[np.isfinite(source).all(axis=1)], target[np.isfinite(target).all(axis=1)], pose


def listed_pair(model: str) -> dict[str, Any]:
    """Return the names of the two real scans of an object, their overlap and their pose.

    Of each object that pair is taken which overlaps most.

    Raises
    ------
    ReadError
        If TMCHHO_DATA does not tell them.
    """
    pairs = _stanford_folder() / "pairs.json"
    try:
        listed: list[dict[str, Any]] = json.loads(pairs.read_text(encoding="utf-8"))
        # Files are called as in Stanford's repository.
        found = max(
            (pair for pair in listed if pair["target"].lower().startswith(model[:3])),
            key=lambda pair: float(pair["overlap_of_source"]),
        )
        return {key: found[key] for key in ("source", "target", "overlap_of_source", "target_from_source")}
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ReadError(
            f"{pairs}: does not tell a pair of scans of '{model}' ({error}); let TMCHHO_DATA name the "
            "folder of the real clouds, or unset it to run on simulated objects"
        ) from error


def _stanford_folder() -> Path:
    return Path(os.environ["TMCHHO_DATA"]) / "stanford"
