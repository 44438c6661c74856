"""One pair of stations: registered by the robust search, and what of it the network needs.

A unit, `register_link`, and the plain record that the rest of the network reads, `Link`.
Absent on purpose: what other pairs say, which `tmchho.network.loops` knows.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tmchho.errors import InvalidCloudError, NoSolutionError
from tmchho.network.engine import Item, unit_progress, unit_threads
from tmchho.network.prepare import load
from tmchho.pipeline import register
from tmchho.results import Verdict

Array = NDArray[np.float64]

# No two scans agree better than this share of a voxel, whatever the residuals say.
FLOOR_VOXELS = 0.01


@dataclass(frozen=True, eq=False)
class Link:
    """A registered pair, in the local frames of its stations.

    Parameters
    ----------
    source, target : int
        Numbers of the stations.
    pose : (4, 4) float64 array
        Takes local coordinates of the source to those of the target.
    information : (7, 7) float64 array
        Inverse of the covariance of a small motion of the source in the target's frame about `middle`; zeros
        where nothing is known of a motion.
    middle : (3,) float64 array
        A place in the target.
    verdict : str
        Of the pair alone.
    ambiguity_ratio, overlap : float
        How firmly; the larger of both overlaps.
    record : dict
        The rest of what `register_link` returned.
    is_only_place : bool
        Whether every place that the source could have in the target was compared, as `seat_station` does.
    """

    source: int
    target: int
    pose: Array
    information: Array
    middle: Array
    verdict: Verdict
    ambiguity_ratio: float
    overlap: float
    record: dict[str, Any]
    is_only_place: bool = False


def register_link(item: Item) -> Item:
    """Register two prepared clouds.

    Parameters
    ----------
    item : dict
        ``source`` and ``target``, references as `prepare_cloud` returns them; ``config``, settings of
        `tmchho.register`.

    Returns
    -------
    dict
        ``pose`` (None where the search ended without any), ``verdict``, ``reasons``, ``overlap_of_source``,
        ``overlap_of_target``, ``rms``, ``strength``, ``ambiguity_ratio``, ``inlier_share``, ``covariance``
        and ``middle``; numbers that are not finite are None.
    """
    source, target = (load(item[role])["points"] for role in ("source", "target"))
    settings = {**item["config"], "n_threads": unit_threads()}
    settings = {key: value for key, value in settings.items() if value is not None}
    try:
        found = register(source, target, config=settings, progress=unit_progress)
    except (NoSolutionError, InvalidCloudError) as error:
        return {"pose": None, "verdict": "rejected", "reasons": [str(error)]}
    return {
        "pose": found.transformation.tolist(),
        "verdict": found.verdict,
        "reasons": list(found.reasons),
        "overlap_of_source": found.overlap_of_source,
        "overlap_of_target": found.overlap_of_target,
        "rms": _finite(found.inlier_rmse),
        "strength": _finite(found.strength),
        "ambiguity_ratio": _finite(found.ambiguity_ratio),
        "inlier_share": found.inlier_share,
        "covariance": None if found.covariance is None else found.covariance.tolist(),
        "middle": None if found.covariance_middle is None else found.covariance_middle.tolist(),
    }


def link_of(source: int, target: int, result: Item, voxel_size: float, target_middle: Array) -> Link | None:
    """Read what `register_link` returned; None where there is no pose.

    Parameters
    ----------
    source, target : int
        Numbers of the stations.
    result : dict
        As returned.
    voxel_size : float
        Of the network.
    target_middle : (3,) float64 array
        Of the target's cloud, for a link without a covariance.
    """
    if result["pose"] is None:
        return None
    if result["covariance"] is None:
        # Nothing is known but that it is about right: a voxel, at the distance of a few hundred.
        sigma = np.array([0.01] * 3 + [voxel_size] * 3 + [0.0])
        covariance, middle = np.diag(sigma**2), target_middle
    else:
        covariance, middle = np.array(result["covariance"]), np.array(result["middle"])
    floor = FLOOR_VOXELS * voxel_size
    covariance = covariance + np.diag([(floor / (100 * voxel_size)) ** 2] * 3 + [floor**2] * 3 + [0.0])
    information = np.zeros((7, 7))
    free = np.arange(7 if covariance[6, 6] > 0 else 6)
    information[np.ix_(free, free)] = np.linalg.inv(covariance[np.ix_(free, free)])
    ratio = result["ambiguity_ratio"]
    return Link(
        source,
        target,
        np.array(result["pose"]),
        0.5 * (information + information.T),
        middle,
        result["verdict"],
        math.inf if ratio is None else float(ratio),
        max(result["overlap_of_source"], result["overlap_of_target"]),
        result,
        bool(result.get("is_only_place")),
    )


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
