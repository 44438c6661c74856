"""Other libraries' global registration, each called the way its documentation says, and one common ICP.

Every method takes source and target (n, 3) and the edge of a voxel, and gives its pose and its seconds,
from clouds in memory to the pose; turning numpy's arrays into a library's own cloud is not counted. Clouds
are brought about their own centroids first, which the peers need: KISS-Matcher works in single precision
and turns its normals towards the origin, Open3D's point-to-plane is ill-conditioned far away from it.
"""

from __future__ import annotations

import importlib.util
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from common import Array, diagonal_of

import tmchho

Method = Callable[[Array, Array, float, int], tuple[Array, float]]

KISS_MATCHER, RANSAC, FGR, PAPER = "KISS-Matcher", "Open3D RANSAC", "Open3D FGR", "tmchho, paper mode"
# KISS-Matcher refuses voxels below 5 mm: clouds are scaled so that the voxel has the size of its default.
KISS_VOXEL = 0.3


def missing_packages() -> list[str]:
    """Return the packages of the extra `peers` that cannot be imported."""
    return [name for name in ("kiss_matcher", "open3d") if importlib.util.find_spec(name) is None]


def centred(method: Method) -> Method:
    """Run a method on clouds about their centroids and give its pose for the clouds as they are."""

    def run(source: Array, target: Array, voxel: float, seed: int) -> tuple[Array, float]:
        source_middle, target_middle = source.mean(axis=0), target.mean(axis=0)
        pose, seconds = method(source - source_middle, target - target_middle, voxel, seed)
        pose = pose.copy()
        pose[:3, 3] += target_middle - pose[:3, :3] @ source_middle
        return pose, seconds

    return run


@centred
def kiss_matcher(source: Array, target: Array, voxel: float, seed: int) -> tuple[Array, float]:
    import kiss_matcher as library  # it takes no seed

    scale = KISS_VOXEL / voxel
    matcher = library.KISSMatcher(library.KISSMatcherConfig(voxel_size=KISS_VOXEL))
    clouds = [list((cloud * scale).astype(np.float32)) for cloud in (source, target)]
    found = matcher.estimate(*clouds)
    # Its own clock, which leaves out the copy from Python's lists.
    seconds = (
        matcher.get_processing_time()
        + matcher.get_extraction_time()
        + matcher.get_matching_time()
        + matcher.get_rejection_time()
        + matcher.get_solver_time()
    )
    pose = np.eye(4)
    pose[:3, :3] = found.rotation
    pose[:3, 3] = np.ravel(found.translation) / scale
    return pose, seconds


def open3d_cloud(points: Array) -> Any:
    import open3d

    return open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points))


def open3d_features(cloud: Any, voxel: float) -> tuple[Any, Any]:
    import open3d

    small = cloud.voxel_down_sample(voxel)
    search = open3d.geometry.KDTreeSearchParamHybrid
    small.estimate_normals(search(radius=2 * voxel, max_nn=30))
    features = open3d.pipelines.registration.compute_fpfh_feature(small, search(radius=5 * voxel, max_nn=100))
    return small, features


@centred
def open3d_ransac(source: Array, target: Array, voxel: float, seed: int) -> tuple[Array, float]:
    import open3d
    from open3d.pipelines import registration

    open3d.utility.random.seed(seed)
    clouds = open3d_cloud(source), open3d_cloud(target)
    began = time.perf_counter()
    (moving, moving_features), (fixed, fixed_features) = (open3d_features(it, voxel) for it in clouds)
    found = registration.registration_ransac_based_on_feature_matching(
        moving,
        fixed,
        moving_features,
        fixed_features,
        True,
        1.5 * voxel,
        registration.TransformationEstimationPointToPoint(False),
        3,
        [
            registration.CorrespondenceCheckerBasedOnEdgeLength(0.9),
            registration.CorrespondenceCheckerBasedOnDistance(1.5 * voxel),
        ],
        registration.RANSACConvergenceCriteria(100_000, 0.999),
    )
    return np.array(found.transformation), time.perf_counter() - began


@centred
def open3d_fgr(source: Array, target: Array, voxel: float, seed: int) -> tuple[Array, float]:
    import open3d
    from open3d.pipelines import registration

    open3d.utility.random.seed(seed)
    clouds = open3d_cloud(source), open3d_cloud(target)
    began = time.perf_counter()
    (moving, moving_features), (fixed, fixed_features) = (open3d_features(it, voxel) for it in clouds)
    found = registration.registration_fgr_based_on_feature_matching(
        moving,
        fixed,
        moving_features,
        fixed_features,
        registration.FastGlobalRegistrationOption(maximum_correspondence_distance=0.5 * voxel),
    )
    return np.array(found.transformation), time.perf_counter() - began


def paper_mode(source: Array, target: Array, voxel: float, seed: int) -> tuple[Array, float]:
    found = tmchho.register(source, target, mode="paper", seed=seed)
    return found.candidates[0].transformation, found.seconds


PEERS: dict[str, Method] = {KISS_MATCHER: kiss_matcher, RANSAC: open3d_ransac, FGR: open3d_fgr}


class CommonIcp:
    """Point-to-plane ICP of Open3D from any start, with the same clouds and limits for all methods."""

    # Shares of the target's diagonal: voxel of the clouds, reach of the normals, reach of partners.
    VOXEL, REACH, LIMITS = 0.005, 0.02, (0.03, 0.01)

    def __init__(self, source: Array, target: Array) -> None:
        import open3d

        self.middles = source.mean(axis=0), target.mean(axis=0)
        self.diagonal = diagonal_of(target)
        clouds = (
            open3d_cloud(it - middle) for it, middle in zip((source, target), self.middles, strict=True)
        )
        self.source, self.target = (cloud.voxel_down_sample(self.VOXEL * self.diagonal) for cloud in clouds)
        search = open3d.geometry.KDTreeSearchParamHybrid(radius=self.REACH * self.diagonal, max_nn=30)
        self.target.estimate_normals(search)

    def refine(self, start: Array) -> Array:
        """Return the pose at which ICP comes to rest."""
        from open3d.pipelines import registration

        source_middle, target_middle = self.middles
        pose = np.array(start)
        pose[:3, 3] += pose[:3, :3] @ source_middle - target_middle
        for limit in self.LIMITS:
            pose = registration.registration_icp(
                self.source,
                self.target,
                limit * self.diagonal,
                pose,
                registration.TransformationEstimationPointToPlane(),
                registration.ICPConvergenceCriteria(max_iteration=60),
            ).transformation
        pose = np.array(pose)
        pose[:3, 3] += target_middle - pose[:3, :3] @ source_middle
        return pose
