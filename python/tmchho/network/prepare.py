"""Each cloud once: read, cleaned, thinned, described, and laid down for the workers.

Why: a station takes part in many pairs. What a pair needs of it is small, and is made here, once. Two units:
`prepare_cloud` reads a file of any size and leaves a cloud near its own origin, thinned as far as the search
allows; `describe_cloud` makes of it the voxel cloud of the whole network, with normals and descriptors.
Absent on purpose: anything that concerns two stations.
"""

from __future__ import annotations

import hashlib
import os
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tmchho.errors import InvalidCloudError
from tmchho.inputs import open_points
from tmchho.io.atomic import atomic_path
from tmchho.network.descriptors import describe
from tmchho.network.engine import Item
from tmchho.network.store import input_reference, made_reference
from tmchho.stages import estimate_normals, remove_outliers, voxel_downsample

Array = NDArray[np.float64]

# The search takes voxels of 1/250 of the extent; its input may be thinned to half of that.
VOXELS_IN_EXTENT = 250.0
FINE_VOXELS_IN_EXTENT = 500.0
# Fewer points than this hold no pose.
MIN_POINTS = 30
_MAX_SAMPLED = 200_000


class VoxelCloud(NamedTuple):
    """A station as the pairs need it, in its local frame; see `describe_cloud`."""

    points: Array
    normals: Array
    curvatures: Array
    keypoints: Array
    key_normals: Array
    descriptors: NDArray[np.float32]


def cloud_reference(cloud: Any, role: str, folder: Path) -> dict[str, Any]:
    """Refer to a station's cloud by a file: its own, or one that is made of what lies in memory.

    Parameters
    ----------
    cloud : CloudLike
        A path, or points, which are written into `folder` under their checksum.
    role : str
        How messages call it.
    folder : Path
        Where the workers look; it exists.
    """
    if isinstance(cloud, (str, os.PathLike)):
        return input_reference(cloud)
    points = open_points(cloud, role)
    path = folder / f"given-{hashlib.sha256(points.tobytes()).hexdigest()[:32]}.npy"
    if not path.exists():
        with atomic_path(path, overwrite=True) as temporary, temporary.open("wb") as stream:
            np.save(stream, points)
    return made_reference(path)


def prepare_cloud(item: Item) -> Item:
    """Read a cloud, drop what stands alone, thin it, and lay it down near its own origin.

    Parameters
    ----------
    item : dict
        ``cloud``, a reference; ``name``; ``folder`` and ``number`` for the file made.

    Returns
    -------
    dict
        ``points``, a reference to (n, 3) local coordinates; ``origin``, which given coordinates have more;
        ``n_points`` as read and ``n_kept``; ``extent``; ``middle`` and ``radius`` of gyration, local.

    Raises
    ------
    ReadError, InvalidCloudError
        If the file cannot be read, or too few points remain.
    """
    given = open_points(item["cloud"]["path"], item["name"])
    n_given = len(given)
    given = given[np.isfinite(given).all(axis=1)]
    if len(given) < MIN_POINTS:
        raise InvalidCloudError(
            f"{item['name']}: has {len(given)} finite points; at least {MIN_POINTS} needed"
        )
    origin = np.round(np.median(given[:: max(1, len(given) // _MAX_SAMPLED)], axis=0))
    local = given - origin
    extent = extent_of(local)
    if not extent > 0:
        raise InvalidCloudError(f"{item['name']}: all points lie in one place")
    local = local[remove_outliers(local).indices]
    if len(local) < MIN_POINTS:
        raise InvalidCloudError(f"{item['name']}: hardly any point has neighbours; is it a point cloud?")
    thinned = voxel_downsample(local, extent / FINE_VOXELS_IN_EXTENT).points
    middle = thinned.mean(axis=0)
    return {
        "points": _laid_down(item, "prepared", points=thinned),
        "origin": origin.tolist(),
        "n_points": n_given,
        "n_kept": len(local),
        "extent": extent,
        "middle": middle.tolist(),
        "radius": float(np.sqrt(((thinned - middle) ** 2).sum(axis=1).mean())),
    }


def describe_cloud(item: Item) -> Item:
    """Make the voxel cloud of a station, with normals and descriptors.

    Parameters
    ----------
    item : dict
        ``points``, a reference as `prepare_cloud` returns it; ``voxel_size`` and ``unit``, the extent of a
        usual station, the same for the whole network; ``folder`` and ``number``.

    Returns
    -------
    dict
        ``cloud``, a reference to what `voxel_cloud` reads; ``n_voxels``; ``low`` and ``high``, its box.
    """
    thinned = load(item["points"])["points"]
    voxels = voxel_downsample(thinned, item["voxel_size"]).points
    normals, curvatures = estimate_normals(voxels)
    places, place_normals, descriptors = describe(thinned, item["unit"])
    made = _laid_down(
        item,
        "described",
        points=voxels,
        normals=normals,
        curvatures=curvatures,
        keypoints=places,
        key_normals=place_normals,
        descriptors=descriptors,
    )
    return {
        "cloud": made,
        "n_voxels": len(voxels),
        "low": voxels.min(axis=0).tolist(),
        "high": voxels.max(axis=0).tolist(),
    }


def extent_of(points: Array) -> float:
    """Return the size of a cloud, however it is turned, as the glossary of the architecture has it."""
    sample = points[:: max(1, len(points) // _MAX_SAMPLED)]
    distances = np.linalg.norm(sample - np.median(sample, axis=0), axis=1)
    held = sample[distances <= np.quantile(distances, 0.995)]
    return float(2.4 * np.quantile(np.linalg.norm(sample - held.mean(axis=0), axis=1), 0.995))


def load(reference: dict[str, str]) -> dict[str, Any]:
    """Return the arrays of a file that a unit made."""
    with np.load(reference["path"]) as stored:
        return {name: stored[name] for name in stored.files}


def voxel_cloud(reference: dict[str, str]) -> VoxelCloud:
    """Return a described station; the last ones are kept in memory, because pairs come in runs."""
    return _voxel_cloud(reference["path"], reference["sha256"])


@lru_cache(maxsize=16)
def _voxel_cloud(path: str, checksum: str) -> VoxelCloud:
    cloud = VoxelCloud(**load({"path": path, "sha256": checksum}))
    for array in cloud:
        array.setflags(write=False)
    return cloud


def _laid_down(item: Item, stage: str, **arrays: Any) -> dict[str, str]:
    path = Path(item["folder"]) / f"{item['number']:05d}-{stage}.npz"
    with atomic_path(path, overwrite=True) as temporary, temporary.open("wb") as stream:
        np.savez(stream, **arrays)
    return made_reference(path)
