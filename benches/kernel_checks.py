"""Whether answers agree: each is held against numpy and scipy where they can tell, else against the others'.

A check says in words how far an answer agrees, and whether it is the same answer, so that its time counts.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from common import diagonal_of, moved
from kernel_clouds import voxel_keys
from kernel_peers import US, Answer, Array, Clouds, Settings
from numpy.typing import NDArray
from scipy.spatial import cKDTree

SAME_M = 1e-9
SAME_SHARE = 0.999
SAME_NORMAL_DEG = 0.1
N_CHECKED = 20_000


@dataclass(frozen=True)
class Agreement:
    """How far an answer agrees."""

    same: bool
    words: str


class Judge:
    """Knows the clouds of one row and works out once what their answer is."""

    def __init__(self, kernel: str, clouds: Clouds, settings: Settings, truth: Array | None) -> None:
        self._clouds, self._settings, self._truth = clouds, settings, truth
        self._wanted: Answer = {}
        checks: dict[str, Callable[[str, Answer], Agreement]] = {
            "voxel": self._voxel,
            "outliers": self._outliers,
            "keypoints": self._keypoints,
            "normals": self._normals,
            "nearest": self._distances,
            "both_ways": self._distances,
            "route": self._route,
        }
        self.check = checks.get(kernel, self._pose)

    def _distances(self, library: str, answer: Answer) -> Agreement:
        source, target = self._clouds["source"], self._clouds["target"]
        if not self._wanted:
            self._wanted["forth"] = cKDTree(target).query(source, workers=-1)[0]
            self._wanted["back"] = cKDTree(source).query(target, workers=-1)[0]
        off = max(float(np.abs(answer[way] - self._wanted[way]).max()) for way in answer)
        same = off <= SAME_M
        return Agreement(same, "same distances" if same else f"off by up to {off:.1g} m")

    def _outliers(self, library: str, answer: Answer) -> Agreement:
        if not self._wanted:
            cloud, k = self._clouds["cloud"], self._settings["min_neighbors"] + 1
            far = cKDTree(cloud).query(cloud, k=[k], workers=-1)[0][:, 0]
            self._wanted["kept"] = np.flatnonzero(far <= self._settings["radius"])
        wanted, kept = self._wanted["kept"], answer["kept"]
        n = len(self._clouds["cloud"])
        differ = len(np.setxor1d(wanted, kept))
        words = f"{n - len(kept)} outliers" + (f", {differ} points differ" if differ else "")
        return Agreement(differ <= 1e-6 * n, words)

    def _voxel(self, library: str, answer: Answer) -> Agreement:
        cloud, edge = self._clouds["cloud"], self._settings["edge"]
        if not self._wanted:
            low = cloud.min(axis=0)
            self._wanted = {"": centroids(cloud, edge, low), "half": centroids(cloud, edge, low - edge / 2)}
        off = {
            grid: cKDTree(wanted).query(answer["points"], workers=-1)[0]
            for grid, wanted in self._wanted.items()
        }
        grid = min(off, key=lambda grid: float(np.median(off[grid])))
        n, n_wanted = len(answer["points"]), len(self._wanted[grid])
        share = float((off[grid] <= SAME_M).mean())
        words = f"{n} centroids"
        if grid == "half":
            words += ", grid half a voxel lower"
        if n != n_wanted:
            words += f" for {n_wanted}"
        if share < 1.0:
            words += f", {1 - share:.1%} of them off, the middle one by {np.median(off[grid]):.0e} m"
        return Agreement(share >= SAME_SHARE and abs(n - n_wanted) <= 1e-3 * n_wanted, words)

    def _keypoints(self, library: str, answer: Answer) -> Agreement:
        """Definitions differ: tmchho weighs neighbours by 1/distance, after Eq. (2) of its paper."""
        if library == US:
            self._wanted["points"] = answer["points"]
            return Agreement(True, f"{len(answer['points'])} keypoints, neighbours weighed by 1/distance")
        ours, theirs = self._wanted["points"], answer["points"]
        reach = self._settings["non_max_radius"]
        near = float((cKDTree(theirs).query(ours)[0] <= reach).mean())
        words = f"{len(theirs)} keypoints, not weighed; one near {near:.0%} of tmchho's"
        return Agreement(0.5 <= len(theirs) / max(len(ours), 1) <= 2.0, words)

    def _normals(self, library: str, answer: Answer) -> Agreement:
        if not self._wanted:
            cloud, k = self._clouds["cloud"], self._settings["k"]
            chosen = np.random.default_rng(0).permutation(len(cloud))[:N_CHECKED]
            near = cloud[cKDTree(cloud).query(cloud[chosen], k=k, workers=-1)[1]]
            near = near - near.mean(axis=1, keepdims=True)
            _, vectors = np.linalg.eigh(near.transpose(0, 2, 1) @ near)
            self._wanted = {"chosen": chosen, "normals": vectors[:, :, 0]}
        found = answer["normals"][self._wanted["chosen"]]
        share = float((angles_deg(found, self._wanted["normals"]) <= SAME_NORMAL_DEG).mean())
        return Agreement(share >= SAME_SHARE, f"{share:.2%} within {SAME_NORMAL_DEG}° of numpy's")

    def _pose(self, library: str, answer: Answer) -> Agreement:
        error = self.pose_error(answer)
        words = f"error {1e3 * error:.2f} mm"
        if "iterations" in answer:
            words += f", {int(answer['iterations'])} iterations"
        return Agreement(error <= self._settings["largest_error"], words)

    def pose_error(self, answer: Answer) -> float:
        """Return the root mean squared displacement of the source against its true place."""
        assert self._truth is not None
        source = self._clouds["source"]
        off = moved(answer["pose"], source) - moved(self._truth, source)
        return float(np.sqrt((off**2).sum(axis=1).mean()))

    def _route(self, library: str, answer: Answer) -> Agreement:
        error, diagonal = self.pose_error(answer), diagonal_of(self._clouds["target"])
        verdict = "accepted" if answer["accepted"] else "not accepted"
        words = f"{verdict}, error {1e3 * error:.1f} mm, {int(answer['n_fused'])} points fused"
        return Agreement(bool(answer["accepted"]) and error <= 1e-3 * diagonal, words)


def centroids(cloud: Array, edge: float, low: Array) -> Array:
    """Return the centroids of the voxels of a grid that stands on `low`."""
    _, voxel, counts = np.unique(voxel_keys(cloud, edge, low), return_inverse=True, return_counts=True)
    sums = [np.bincount(voxel, weights=column) for column in cloud.T]
    return np.stack(sums, axis=1) / counts[:, None]


def angles_deg(some: Array, others: Array) -> NDArray[np.float64]:
    """Return the angles between normals, whatever their signs."""
    sines, cosines = np.linalg.norm(np.cross(some, others), axis=1), np.abs((some * others).sum(axis=1))
    return np.where(sines + cosines > 0.0, np.degrees(np.arctan2(sines, cosines)), 90.0)  # zero is no normal
