"""Kernels of tmchho and of other libraries, each called as its documentation says: numpy in, numpy out.

A kernel gets the clouds by name, its settings, and a number of threads, and gives arrays by name. Whatever
turns numpy's arrays into a library's own cloud and back is part of it. Libraries are imported when a kernel
is first made, in the process that runs it.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Clouds = Mapping[str, Array]
Settings = Mapping[str, Any]
Answer = dict[str, NDArray[Any]]
Kernel = Callable[[Clouds, Settings, int], Answer]

US = "tmchho"
MODULES = {
    "Open3D": "open3d",
    "Open3D tensor": "open3d",
    "numpy": "numpy",
    "point-cloud-utils": "point_cloud_utils",
    "py4dgeo": "py4dgeo",
    "pykdtree": "pykdtree",
    "pykdtree f32": "pykdtree",
    "pynanoflann": "pynanoflann",
    "scipy": "scipy",
    "small_gicp": "small_gicp",
    US: "tmchho",
}
PACKAGES = {
    "open3d": "open3d",
    "point-cloud-utils": "point_cloud_utils",
    "py4dgeo": "py4dgeo",
    "pykdtree": "pykdtree",
    "pynanoflann": "pynanoflann",
    "scipy": "scipy",
    "small_gicp": "small_gicp",
}
# Points whose plane serves a point; that of tmchho.icp.
ICP_NEIGHBORS = 16
ICP_ITERATIONS = 300
# How finely each comes to rest, from coarse to fine: the coarsest that suffices is timed.
ICP_STEPS: dict[str, list[float]] = {
    US: [1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8],
    "Open3D": [1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8],
    "small_gicp": [1e-2, 3e-3, 1e-3, 3e-4, 1e-4, 1e-5],
}

KERNELS: dict[str, dict[str, Kernel]] = {}


def kernel(name: str, library: str) -> Callable[[Kernel], Kernel]:
    def keep(function: Kernel) -> Kernel:
        KERNELS.setdefault(name, {})[library] = function
        return function

    return keep


def is_installed(library: str) -> bool:
    return importlib.util.find_spec(MODULES[library]) is not None


def open3d_cloud(points: Array) -> Any:
    import open3d

    return open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points))


def open3d_tensor_cloud(points: Array) -> Any:
    import open3d

    return open3d.t.geometry.PointCloud(open3d.core.Tensor.from_numpy(points))


def three(points: Any) -> Array:
    """Leave out the fourth coordinate that some put beside every point."""
    return np.ascontiguousarray(np.asarray(points)[:, :3])


# Voxel centroids


@kernel("voxel", US)
def voxel_ours(clouds: Clouds, settings: Settings, n_threads: int) -> Answer:
    import tmchho

    return {"points": tmchho.voxel_downsample(clouds["cloud"], settings["edge"]).points}


@kernel("voxel", "Open3D")
def voxel_open3d(clouds: Clouds, settings: Settings, n_threads: int) -> Answer:
    return {"points": np.asarray(open3d_cloud(clouds["cloud"]).voxel_down_sample(settings["edge"]).points)}


@kernel("voxel", "Open3D tensor")
def voxel_open3d_tensor(clouds: Clouds, settings: Settings, n_threads: int) -> Answer:
    thinned = open3d_tensor_cloud(clouds["cloud"]).voxel_down_sample(settings["edge"])
    return {"points": thinned.point.positions.numpy()}


@kernel("voxel", "small_gicp")
def voxel_small_gicp(clouds: Clouds, settings: Settings, n_threads: int) -> Answer:
    import small_gicp

    thinned = small_gicp.voxelgrid_sampling(clouds["cloud"], settings["edge"], n_threads)
    return {"points": three(thinned.points())}


@kernel("voxel", "point-cloud-utils")
def voxel_point_cloud_utils(clouds: Clouds, settings: Settings, n_threads: int) -> Answer:
    import point_cloud_utils

    return {
        "points": point_cloud_utils.downsample_point_cloud_on_voxel_grid(settings["edge"], clouds["cloud"])
    }


@kernel("voxel", "numpy")
def voxel_numpy(clouds: Clouds, settings: Settings, n_threads: int) -> Answer:
    cloud, edge = clouds["cloud"], settings["edge"]
    places = ((cloud - cloud.min(axis=0)) / edge).astype(np.int64)
    sizes = places.max(axis=0) + 1
    keys = (places[:, 2] * sizes[1] + places[:, 1]) * sizes[0] + places[:, 0]
    _, voxel, counts = np.unique(keys, return_inverse=True, return_counts=True)
    sums = [np.bincount(voxel, weights=column) for column in cloud.T]
    return {"points": np.stack(sums, axis=1) / counts[:, None]}


# Radius outliers: at least `min_neighbors` others within `radius`


@kernel("outliers", US)
def outliers_ours(clouds: Clouds, settings: Settings, n_threads: int) -> Answer:
    import tmchho

    found = tmchho.remove_outliers(
        clouds["cloud"], radius=settings["radius"], min_neighbors=settings["min_neighbors"]
    )
    return {"kept": found.indices}


@kernel("outliers", "Open3D")
def outliers_open3d(clouds: Clouds, settings: Settings, n_threads: int) -> Answer:
    # It counts the point itself, and asks for more than the number given.
    _, kept = open3d_cloud(clouds["cloud"]).remove_radius_outlier(
        settings["min_neighbors"], settings["radius"]
    )
    return {"kept": np.asarray(kept)}


@kernel("outliers", "Open3D tensor")
def outliers_open3d_tensor(clouds: Clouds, settings: Settings, n_threads: int) -> Answer:
    _, keep = open3d_tensor_cloud(clouds["cloud"]).remove_radius_outliers(
        settings["min_neighbors"] + 1, settings["radius"]
    )
    return {"kept": np.flatnonzero(keep.numpy())}


@kernel("outliers", "scipy")
def outliers_scipy(clouds: Clouds, settings: Settings, n_threads: int) -> Answer:
    from scipy.spatial import cKDTree

    # The farthest neighbour that is needed: much quicker than counting all within the radius.
    k, radius = settings["min_neighbors"] + 1, settings["radius"]
    cloud = clouds["cloud"]
    bound = np.nextafter(radius, np.inf)
    far = cKDTree(cloud).query(cloud, k=[k], distance_upper_bound=bound, workers=n_threads)[0][:, 0]
    return {"kept": np.flatnonzero(far <= radius)}


@kernel("outliers", "pykdtree")
def outliers_pykdtree(clouds: Clouds, settings: Settings, n_threads: int) -> Answer:
    from pykdtree.kdtree import KDTree

    k, radius = settings["min_neighbors"] + 1, settings["radius"]
    far = KDTree(clouds["cloud"]).query(clouds["cloud"], k=k, distance_upper_bound=1.001 * radius)[0][:, -1]
    return {"kept": np.flatnonzero(far <= radius)}


# ISS keypoints


@kernel("keypoints", US)
def keypoints_ours(clouds: Clouds, settings: Settings, n_threads: int) -> Answer:
    import tmchho

    found = tmchho.iss_keypoints(
        clouds["cloud"],
        radius=settings["radius"],
        min_neighbors=settings["min_neighbors"],
        max_ratio_second_to_first=settings["second_to_first"],
        max_ratio_third_to_second=settings["third_to_second"],
        non_max_radius=settings["non_max_radius"],
    )
    return {"points": clouds["cloud"][found]}


@kernel("keypoints", "Open3D")
def keypoints_open3d(clouds: Clouds, settings: Settings, n_threads: int) -> Answer:
    import open3d

    found = open3d.geometry.keypoint.compute_iss_keypoints(
        open3d_cloud(clouds["cloud"]),
        settings["radius"],
        settings["non_max_radius"],
        settings["second_to_first"],
        settings["third_to_second"],
        settings["min_neighbors"] + 1,  # it counts the point itself
    )
    return {"points": np.asarray(found.points)}


# Normals from the k nearest points, itself included


@kernel("normals", US)
def normals_ours(clouds: Clouds, settings: Settings, n_threads: int) -> Answer:
    import tmchho

    return {"normals": tmchho.estimate_normals(clouds["cloud"], n_neighbors=settings["k"])[0]}


@kernel("normals", "Open3D")
def normals_open3d(clouds: Clouds, settings: Settings, n_threads: int) -> Answer:
    import open3d

    cloud = open3d_cloud(clouds["cloud"])
    cloud.estimate_normals(open3d.geometry.KDTreeSearchParamKNN(settings["k"]))
    return {"normals": np.asarray(cloud.normals)}


@kernel("normals", "Open3D tensor")
def normals_open3d_tensor(clouds: Clouds, settings: Settings, n_threads: int) -> Answer:
    cloud = open3d_tensor_cloud(clouds["cloud"])
    cloud.estimate_normals(settings["k"])
    return {"normals": cloud.point.normals.numpy()}


@kernel("normals", "small_gicp")
def normals_small_gicp(clouds: Clouds, settings: Settings, n_threads: int) -> Answer:
    import small_gicp

    cloud = small_gicp.PointCloud(clouds["cloud"])
    tree = small_gicp.KdTree(cloud, num_threads=n_threads)
    small_gicp.estimate_normals(cloud, tree, num_neighbors=settings["k"], num_threads=n_threads)
    return {"normals": three(cloud.normals())}


@kernel("normals", "point-cloud-utils")
def normals_point_cloud_utils(clouds: Clouds, settings: Settings, n_threads: int) -> Answer:
    import point_cloud_utils

    _, normals = point_cloud_utils.estimate_point_cloud_normals_knn(
        clouds["cloud"], settings["k"], num_threads=n_threads
    )
    return {"normals": normals}


# ICP


def icp_ours(method: str) -> Kernel:
    def run(clouds: Clouds, settings: Settings, n_threads: int) -> Answer:
        import tmchho

        found = tmchho.icp(
            clouds["source"],
            clouds["target"],
            method=method,  # type: ignore[arg-type]
            kernel="least_squares",
            kept_share=1.0,
            max_distance=settings["max_distance"],
            max_iterations=ICP_ITERATIONS,
            relative_tolerance=settings["step"],
        )
        return {"pose": found.transformation, "iterations": np.array(found.n_iterations)}

    return run


def icp_open3d(method: str) -> Kernel:
    def run(clouds: Clouds, settings: Settings, n_threads: int) -> Answer:
        import open3d
        from open3d.pipelines import registration

        source, target = open3d_cloud(clouds["source"]), open3d_cloud(clouds["target"])
        search = open3d.geometry.KDTreeSearchParamKNN(ICP_NEIGHBORS)
        until = registration.ICPConvergenceCriteria(settings["step"], settings["step"], ICP_ITERATIONS)
        if method == "plane_to_plane":
            for cloud in (source, target):
                cloud.estimate_covariances(search)
            found = registration.registration_generalized_icp(
                source,
                target,
                settings["max_distance"],
                np.eye(4),
                registration.TransformationEstimationForGeneralizedICP(),
                until,
            )
        else:
            estimation = registration.TransformationEstimationPointToPoint()
            if method == "point_to_plane":
                target.estimate_normals(search)
                estimation = registration.TransformationEstimationPointToPlane()
            found = registration.registration_icp(
                source, target, settings["max_distance"], np.eye(4), estimation, until
            )
        return {"pose": np.array(found.transformation)}

    return run


def icp_small_gicp(method: str) -> Kernel:
    name = {"point_to_point": "ICP", "point_to_plane": "PLANE_ICP", "plane_to_plane": "GICP"}[method]

    def run(clouds: Clouds, settings: Settings, n_threads: int) -> Answer:
        import small_gicp

        source, target = small_gicp.PointCloud(clouds["source"]), small_gicp.PointCloud(clouds["target"])
        tree = small_gicp.KdTree(target, num_threads=n_threads)
        if method == "point_to_plane":
            small_gicp.estimate_normals(target, tree, ICP_NEIGHBORS, n_threads)
        if method == "plane_to_plane":
            small_gicp.estimate_covariances(target, tree, ICP_NEIGHBORS, n_threads)
            own = small_gicp.KdTree(source, num_threads=n_threads)
            small_gicp.estimate_covariances(source, own, ICP_NEIGHBORS, n_threads)
        found = small_gicp.align(
            target,
            source,
            tree,
            registration_type=name,
            max_correspondence_distance=settings["max_distance"],
            num_threads=n_threads,
            max_iterations=ICP_ITERATIONS,
            rotation_epsilon=settings["step"] / settings["radius"],
            translation_epsilon=settings["step"],
        )
        return {"pose": np.array(found.T_target_source), "iterations": np.array(found.iterations)}

    return run


for icp_method in ("point_to_point", "point_to_plane", "plane_to_plane"):
    kernel(icp_method, US)(icp_ours(icp_method))
    kernel(icp_method, "Open3D")(icp_open3d(icp_method))
    kernel(icp_method, "small_gicp")(icp_small_gicp(icp_method))


# The whole route


@kernel("route", US)
def route_ours(clouds: Clouds, settings: Settings, n_threads: int) -> Answer:
    import tmchho

    found = tmchho.register(clouds["source"], clouds["target"], config={"n_threads": n_threads})
    fused = tmchho.fuse(clouds["source"], clouds["target"], found)
    return {
        "pose": found.transformation,
        "accepted": np.array(found.verdict == "accepted"),
        "n_fused": np.array(len(fused.points)),
    }
