"""What a registration records about distances and areas, for ``result.json`` and the report."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np

from tmchho.cloud import PointCloud
from tmchho.evaluation.areas import Area, automatic_areas, measure_areas
from tmchho.evaluation.distances import density_warnings, evaluate
from tmchho.evaluation.tally import AreaStatistics
from tmchho.fused import FusedCloud
from tmchho.results import DistanceStatistics, Registration, plain
from tmchho.stages import median_spacing

Summary: TypeAlias = tuple[DistanceStatistics | None, float | None, int]


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
    directions = []
    for distances in (forth, back):
        measured = distances[distances <= fused.hole_radius]
        share = None if tolerance is None or not len(measured) else float((measured <= tolerance).mean())
        n_beyond = int(np.count_nonzero(np.isfinite(distances))) - len(measured)
        directions.append((DistanceStatistics.of(measured), share, n_beyond))
    return entries_of(
        rows,
        (directions[0], directions[1]),
        spacing,
        (registration.source_to_target, registration.target_to_source),
        tolerance=tolerance,
        max_distance=fused.hole_radius,
        is_automatic=is_automatic,
    )


def entries_of(
    rows: Sequence[AreaStatistics],
    directions: tuple[Summary, Summary],
    spacing: tuple[float, float],
    every: tuple[DistanceStatistics | None, DistanceStatistics | None],
    *,
    tolerance: float | None,
    max_distance: float,
    is_automatic: bool,
) -> dict[str, Any]:
    """Return what `distance_entries` does from what was summed up; of pairs, the first is of the source.

    Parameters
    ----------
    rows : sequence of AreaStatistics
        By area.
    directions : tuple
        Statistics of the points with a counterpart, the share within the tolerance, and how many have none.
    spacing : tuple of float
        Median spacings, in the target's unit.
    every : tuple of DistanceStatistics
        Of all points.
    tolerance, max_distance, is_automatic
        As they were used, and whether the areas are ours.
    """
    names = ("source_to_target", "target_to_source")
    entries: dict[str, Any] = plain(
        {
            "areas": tuple(rows),
            "distances": {
                "method": "nearest",
                "tolerance": tolerance,
                "max_distance": max_distance,
                "areas": "automatic" if is_automatic else "given",
                "spacing": {"source": spacing[0], "target": spacing[1]},
                **dict(zip(names, map(_direction, directions), strict=True)),
                "warnings": density_warnings(every, spacing),
            },
        }
    )
    return entries


def _direction(found: Summary) -> dict[str, Any]:
    statistics, share, n_beyond = found
    summed_up = {"n_points": 0} if statistics is None else vars(statistics)
    return {**summed_up, "share_within": share, "n_beyond": n_beyond}
