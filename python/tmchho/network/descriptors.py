"""What the surface round a place looks like, in numbers that turning and moving the cloud leaves alone.

Source: Rusu, Blodow & Beetz (2009), fast point feature histograms. Deviations: normals have no outside, so
that each is turned to the concave side and those of its neighbours to it; the histograms are normalised and
rooted, so that their Euclidean distance is Hellinger's (Arandjelović & Zisserman 2012).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tmchho.stages import estimate_normals, voxel_downsample

Array = NDArray[np.float64]

# Lengths by the unit, the extent of a usual station.
VOXEL_BY_UNIT = 0.01
RADIUS_BY_UNIT = 0.06
N_BINS = 11
# More places than this are thinned further, because matching is quadratic.
MAX_PLACES = 5000
_GROWTH = 1.15


def describe(points: Array, unit: float) -> tuple[Array, Array, NDArray[np.float32]]:
    """Describe a cloud at evenly spread places.

    Parameters
    ----------
    points : (n, 3) float64 array
        Denser than `VOXEL_BY_UNIT` times the unit.
    unit : float
        Length that all others are shares of, above 0.

    Returns
    -------
    places, normals : (k, 3) float64 arrays
        Centroids of voxels and their normals.
    descriptors : (k, 33) float32 array
        Of length 1, or 0 where a place has no neighbours.
    """
    from scipy.sparse import csr_array
    from scipy.spatial import cKDTree

    voxel = VOXEL_BY_UNIT * unit
    places = voxel_downsample(points, voxel).points
    while len(places) > MAX_PLACES:
        voxel *= _GROWTH
        places = voxel_downsample(points, voxel).points
    normals, _ = estimate_normals(places, n_neighbors=min(12, len(places)))
    pairs = cKDTree(places).query_pairs(RADIUS_BY_UNIT * unit, output_type="ndarray")
    pairs = pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]
    first, second = np.concatenate([pairs, pairs[:, ::-1]]).T
    order = np.lexsort((second, first))
    first, second = first[order], second[order]
    way = places[second] - places[first]
    length = np.linalg.norm(way, axis=1)
    kept = length > 0
    first, second, way, length = first[kept], second[kept], way[kept], length[kept]
    n = len(places)

    lean = np.zeros(n)
    np.add.at(lean, first, np.einsum("ij,ij->i", way, normals[first]))
    normals = np.where(lean[:, None] < 0, -normals, normals)
    own, other = normals[first], normals[second]
    other = np.where(np.einsum("ij,ij->i", own, other)[:, None] < 0, -other, other)

    towards = way / length[:, None]
    across = np.cross(towards, own)
    size = np.linalg.norm(across, axis=1)
    usable = size > 1e-9
    across = across / np.where(usable, size, 1.0)[:, None]
    third = np.cross(own, across)
    values = (
        np.einsum("ij,ij->i", across, other),
        np.einsum("ij,ij->i", own, towards),
        np.arctan2(np.einsum("ij,ij->i", third, other), np.einsum("ij,ij->i", own, other)) / (np.pi / 2),
    )
    simple = np.zeros(n * 3 * N_BINS)
    for part, value in enumerate(values):
        place = np.clip(np.floor((value + 1.0) * 0.5 * N_BINS), 0, N_BINS - 1).astype(np.intp)
        np.add.at(simple, (first[usable] * 3 + part) * N_BINS + place[usable], 1.0)
    count = np.bincount(first, minlength=n)
    histograms = simple.reshape(n, -1) / np.maximum(count, 1)[:, None]
    near = csr_array((voxel / length / np.maximum(count, 1)[first], (first, second)), shape=(n, n))
    smooth = histograms + near @ histograms
    smooth /= np.maximum(smooth.sum(axis=1, keepdims=True), 1e-300)
    return places, normals, np.sqrt(smooth).astype(np.float32)
