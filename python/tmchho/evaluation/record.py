"""What a registration records about distances and areas, for ``result.json`` and the report."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tmchho.cloud import PointCloud
from tmchho.evaluation.areas import Area, automatic_areas, measure_areas
from tmchho.evaluation.distances import density_warnings, evaluate
from tmchho.fused import FusedCloud
from tmchho.results import DistanceStatistics, Registration, plain
from tmchho.stages import median_spacing


def distance_entries(
    registration: Registration,
    source: PointCloud,
    target: PointCloud,
    fused: FusedCloud,
    areas: Sequence[Area] | None = None,
    tolerance: float | None = None,
) -> dict[str, Any]:
    """Return the entries ``areas`` and ``distances`` of ``result.json``.

    A point that fills a hole of the other cloud has no counterpart there: it counts towards completeness
    and not towards the distances.

    Parameters
    ----------
    registration : Registration
        What was found.
    source, target : PointCloud
        The clouds that were registered.
    fused : FusedCloud
        What they were fused to; its distances are used, and its hole radius.
    areas : sequence of Area, optional
        In target coordinates; five strips along the overlap where not given.
    tolerance : float, optional
        For the share of points within it.

    Returns
    -------
    dict
        Only what JSON knows.
    """
    of_source = fused.origin == 1
    points, forth = fused.points[of_source], fused.distance[of_source]
    standing, back = fused.points[~of_source], fused.distance[~of_source]
    if len(points) < np.count_nonzero(np.isfinite(source.xyz).all(axis=1)):
        # Only the points that fill holes were kept: measure all of them.
        points = registration.apply(source)
        forth = evaluate(source, target, registration).source_to_target
    is_automatic = areas is None
    if areas is None:
        areas = automatic_areas(standing[back <= fused.hole_radius], fused.hole_radius)
    rows = measure_areas(
        areas,
        points,
        forth,
        standing,
        cell=fused.hole_radius,
        tolerance=tolerance,
        max_distance=fused.hole_radius,
    )
    of_source_and_target = [
        median_spacing(cloud.xyz[np.isfinite(cloud.xyz).all(axis=1)]) for cloud in (source, target)
    ]
    spacing = (registration.scale * of_source_and_target[0], of_source_and_target[1])
    directions = {}
    for name, distances in (("source_to_target", forth), ("target_to_source", back)):
        measured = distances[distances <= fused.hole_radius]
        directions[name] = _summed_up(measured, tolerance)
        directions[name]["n_beyond"] = int(np.count_nonzero(np.isfinite(distances))) - len(measured)
    every = (registration.source_to_target, registration.target_to_source)
    entries: dict[str, Any] = plain(
        {
            "areas": rows,
            "distances": {
                "method": "nearest",
                "tolerance": tolerance,
                "max_distance": fused.hole_radius,
                "areas": "automatic" if is_automatic else "given",
                "spacing": {"source": spacing[0], "target": spacing[1]},
                **directions,
                "warnings": density_warnings(every, spacing),
            },
        }
    )
    return entries


def _summed_up(measured: NDArray[np.float64], tolerance: float | None) -> dict[str, Any]:
    statistics = DistanceStatistics.of(measured)
    if statistics is None:
        return {"n_points": 0, "share_within": None}
    share = None if tolerance is None else float((measured <= tolerance).mean())
    return {**vars(statistics), "share_within": share}
