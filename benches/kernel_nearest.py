"""Nearest neighbours, build and query, of tmchho and other libraries; both ways: cloud-to-cloud distance."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from kernel_peers import US, Answer, Array, Clouds, Settings, kernel, open3d_cloud

Distances = Callable[[Array, Array, int], Array]

LIBRARIES: dict[str, Distances] = {}


def library(name: str) -> Callable[[Distances], Distances]:
    def keep(function: Distances) -> Distances:
        LIBRARIES[name] = function
        return function

    return keep


@library(US)
def ours(source: Array, target: Array, n_threads: int) -> Array:
    import tmchho

    return tmchho.nearest_distances(source, target)


@library("scipy")
def scipy(source: Array, target: Array, n_threads: int) -> Array:
    from scipy.spatial import cKDTree

    return np.asarray(cKDTree(target).query(source, workers=n_threads)[0])


@library("pykdtree")
def pykdtree(source: Array, target: Array, n_threads: int) -> Array:
    from pykdtree.kdtree import KDTree

    return np.asarray(KDTree(target).query(source)[0])


@library("pykdtree f32")
def pykdtree_single(source: Array, target: Array, n_threads: int) -> Array:
    from pykdtree.kdtree import KDTree

    return np.asarray(KDTree(target.astype(np.float32)).query(source.astype(np.float32))[0])


@library("pynanoflann")
def pynanoflann(source: Array, target: Array, n_threads: int) -> Array:
    import pynanoflann

    tree = pynanoflann.KDTree(n_neighbors=1, leaf_size=10)
    tree.fit(target)
    return np.asarray(tree.kneighbors(source, n_jobs=n_threads)[0][:, 0])


@library("small_gicp")
def small_gicp(source: Array, target: Array, n_threads: int) -> Array:
    import small_gicp

    tree = small_gicp.KdTree(target, num_threads=n_threads)
    return np.asarray(np.sqrt(tree.batch_nearest_neighbor_search(source, num_threads=n_threads)[1]))


@library("Open3D")
def open3d(source: Array, target: Array, n_threads: int) -> Array:
    return np.asarray(open3d_cloud(source).compute_point_cloud_distance(open3d_cloud(target)))


@library("Open3D tensor")
def open3d_tensor(source: Array, target: Array, n_threads: int) -> Array:
    import open3d

    tree = open3d.core.nns.NearestNeighborSearch(open3d.core.Tensor.from_numpy(target))
    tree.knn_index()
    squares = tree.knn_search(open3d.core.Tensor.from_numpy(source), 1)[1].numpy()
    return np.asarray(np.sqrt(squares[:, 0]))


@library("point-cloud-utils")
def point_cloud_utils(source: Array, target: Array, n_threads: int) -> Array:
    import point_cloud_utils

    return np.ravel(point_cloud_utils.k_nearest_neighbors(source, target, 1, num_threads=n_threads)[0])


@library("py4dgeo")
def py4dgeo(source: Array, target: Array, n_threads: int) -> Array:
    import py4dgeo

    py4dgeo.set_num_threads(n_threads)
    return np.asarray(py4dgeo.C2C(epochs=(py4dgeo.Epoch(source), py4dgeo.Epoch(target))).run())


def one_way(distances: Distances) -> Callable[[Clouds, Settings, int], Answer]:
    def run(clouds: Clouds, settings: Settings, n_threads: int) -> Answer:
        return {"forth": distances(clouds["source"], clouds["target"], n_threads)}

    return run


def both_ways(distances: Distances) -> Callable[[Clouds, Settings, int], Answer]:
    def run(clouds: Clouds, settings: Settings, n_threads: int) -> Answer:
        source, target = clouds["source"], clouds["target"]
        return {"forth": distances(source, target, n_threads), "back": distances(target, source, n_threads)}

    return run


for name, function in LIBRARIES.items():
    kernel("nearest", name)(one_way(function))
    kernel("both_ways", name)(both_ways(function))


@kernel("both_ways", US)
def both_ways_ours(clouds: Clouds, settings: Settings, n_threads: int) -> Answer:
    import tmchho

    found = tmchho.evaluate(clouds["source"], clouds["target"])
    return {"forth": found.source_to_target, "back": found.target_to_source}
