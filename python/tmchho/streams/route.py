"""The route for files larger than memory: thin, register, sort into tiles, measure, fuse."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from tmchho import _core
from tmchho.cloud import PointCloud
from tmchho.config import ConfigLike
from tmchho.evaluation.areas import Area
from tmchho.evaluation.record import entries_of
from tmchho.io import open_las, writing_las
from tmchho.io.las_stream import LasPoints
from tmchho.outputs import staging
from tmchho.pipeline import register
from tmchho.progress import ProgressCallback
from tmchho.results import DistanceStatistics, Registration, StageRecord
from tmchho.streams.distances import DistanceFile, FarCloud, measure_tiles, spacing_quantile
from tmchho.streams.evaluate import middle_spacing, rows_of_areas, summed_up
from tmchho.streams.layout import colour_factors
from tmchho.streams.memory import default_max_memory, n_centroids, n_tile_points
from tmchho.streams.pair import TiledPair
from tmchho.streams.thin import Keep, ThinnedFile, thin_file
from tmchho.streams.tiles import cut_space, sort_into_tiles
from tmchho.streams.writing import Fusion, write_fusion
from tmchho.transform import Transform

FuseMode = Literal["merge", "dedup", "fill_holes"]

# Within so many hole radii, and so many edges of the thinned clouds, distances are exact.
_REACH_IN_HOLES = 2.0
_REACH_IN_VOXELS = 4.0


@dataclass(frozen=True, eq=False)
class StreamedFusion:
    """What came of measuring and fusing two files part by part.

    Parameters
    ----------
    source_to_target, target_to_source : DistanceStatistics
        Distances of all points.
    overlap_of_source, overlap_of_target : float
        Share of the points within `max_distance` of the other cloud.
    exact_up_to : float
        Distances up to this are exact, by full density; larger ones are those to centroids.
    far_error : float
        By how much these larger ones can be wrong.
    report : dict
        What ``result.json`` tells of the fusion.
    entries : dict
        What it tells of distances and areas, as `tmchho.evaluation.distance_entries`.
    seconds : dict
        Of each part, ``wall`` and ``process``: what the clock says and what the processors worked.
    """

    source_to_target: DistanceStatistics
    target_to_source: DistanceStatistics
    overlap_of_source: float
    overlap_of_target: float
    exact_up_to: float
    far_error: float
    report: dict[str, Any]
    entries: dict[str, Any]
    seconds: dict[str, dict[str, float]]


@dataclass(frozen=True, eq=False)
class StreamedRegistration:
    """What came of registering two files part by part.

    Parameters
    ----------
    registration : Registration
        Of the thinned clouds; its first stage is called ``thin``.
    source, target : ThinnedFile
        These.
    seconds : dict
        See `StreamedFusion`.
    """

    registration: Registration
    source: ThinnedFile
    target: ThinnedFile
    seconds: dict[str, dict[str, float]]


def register_files(
    source: str | Path,
    target: str | Path,
    *,
    config: ConfigLike | None = None,
    max_memory: int | None = None,
    keep_source: Keep | None = None,
    keep_target: Keep | None = None,
    progress: ProgressCallback | None = None,
) -> StreamedRegistration:
    """Register two LAS, LAZ or COPC files of any size.

    Parameters
    ----------
    source, target : str or path
        The file that moves and the one that stays.
    config : Config, mapping or path of a TOML file, optional
        See `tmchho.register`.
    max_memory : int, optional
        Bytes to keep to, about; half of the machine's where not given.
    keep_source, keep_target : callable, optional
        Which points take part in finding the pose; see `tmchho.streams.thin.thin_file`.
    progress : callable, optional
        See `tmchho.register`.

    Returns
    -------
    StreamedRegistration
    """
    allowed = default_max_memory() if max_memory is None else max_memory
    seconds: dict[str, dict[str, float]] = {}
    with _timed(seconds, "thin"):
        thinned = [
            thin_file(open_las(path), max_voxels=n_centroids(allowed), keep=keep)
            for path, keep in ((source, keep_source), (target, keep_target))
        ]
    clouds = [
        PointCloud(file.points, name=str(path)) for path, file in zip((source, target), thinned, strict=True)
    ]
    with _timed(seconds, "register"):
        found = register(*clouds, config=config, progress=progress)
    record = StageRecord(
        name="thin",
        n_source_in=thinned[0].n_points,
        n_source_out=len(thinned[0].points),
        n_target_in=thinned[1].n_points,
        n_target_out=len(thinned[1].points),
        seconds=seconds["thin"]["wall"],
    )
    return StreamedRegistration(
        replace(found, stages=(record, *found.stages)), thinned[0], thinned[1], seconds
    )


def fuse_files(
    source: LasPoints,
    target: LasPoints,
    thinned_source: ThinnedFile,
    thinned_target: ThinnedFile,
    transform: Transform,
    fused_path: Path,
    moved_path: Path | None,
    *,
    folder: Path,
    mode: FuseMode = "merge",
    hole_radius: float | None = None,
    max_distance: float = 0.0,
    max_memory: int | None = None,
    areas: Sequence[Area] | None = None,
    tolerance: float | None = None,
) -> StreamedFusion:
    """Measure and fuse two files at a known pose, tile by tile.

    Parameters
    ----------
    source, target : LasPoints
        The files.
    thinned_source, thinned_target : ThinnedFile
        The same, thinned.
    transform : Transform
        Takes source to target coordinates.
    fused_path : Path
        The fused cloud, LAS or LAZ.
    moved_path : Path, optional
        The source in target coordinates.
    folder : Path
        Where a folder for intermediate files is made: 20 bytes for each point of both files.
    mode, hole_radius
        See `tmchho.fuse`.
    max_distance : float, default 0
        Points within this of the other cloud belong to the overlap.
    max_memory : int, optional
        Bytes to keep to, about; half of the machine's where not given.
    areas : sequence of Area, optional
        By which distances are summed up; five strips along the overlap where not given.
    tolerance : float, optional
        For the share of points within it.

    Returns
    -------
    StreamedFusion
    """
    allowed = default_max_memory() if max_memory is None else max_memory
    seconds: dict[str, dict[str, float]] = {}
    with staging(folder) as scratch:
        with _timed(seconds, "sort"):
            moved = transform.apply(thinned_source.points)
            places = np.concatenate([moved, thinned_target.points])
            counts = np.concatenate([thinned_source.counts, thinned_target.counts]).astype(np.float64)
            cuts = cut_space(places, counts, n_tile_points(allowed))
            tiled_source = sort_into_tiles(source, transform, cuts, scratch / "source")
            tiled_target = sort_into_tiles(target, None, cuts, scratch / "target")
        with _timed(seconds, "measure"):
            if hole_radius is None:
                factor, quantile = _core.hole_radius_rule()
                spacings = [spacing_quantile(tiled, quantile) for tiled in (tiled_source, tiled_target)]
                hole_radius = factor * max(*spacings, 1e-12)
            far_source = FarCloud.of(thinned_source, moved, transform.scale)
            far_target = FarCloud.of(thinned_target, thinned_target.points)
            edge = max(thinned_source.voxel_size * transform.scale, thinned_target.voxel_size)
            reach = max(_REACH_IN_HOLES * hole_radius, _REACH_IN_VOXELS * edge, max_distance)
            of_source, of_target = measure_tiles(
                tiled_source,
                tiled_target,
                far_source,
                far_target,
                cuts.n_tiles,
                reach,
                scratch,
                repeated_within=hole_radius if mode == "dedup" else None,
            )
            statistics = of_source.statistics(), of_target.statistics()
            overlaps = of_source.share_within(max_distance), of_target.share_within(max_distance)
        with _timed(seconds, "areas"):
            entries = _entries(
                TiledPair(tiled_source, tiled_target, cuts, edge),
                (of_source, of_target),
                statistics,
                scratch,
                areas,
                tolerance,
                hole_radius,
            )
        with _timed(seconds, "fuse"), writing_las(fused_path):
            fusion = Fusion(
                source=source,
                target=target,
                transform=transform,
                of_source=of_source,
                of_target=of_target,
                hole_radius=hole_radius,
                mode=mode,
                lowest=np.minimum(tiled_source.lowest, tiled_target.lowest),
                highest=np.maximum(tiled_source.highest, tiled_target.highest),
                colour_factors=colour_factors(thinned_source.brightest, thinned_target.brightest),
            )
            report = write_fusion(fusion, fused_path, moved_path)
    return StreamedFusion(
        source_to_target=statistics[0],
        target_to_source=statistics[1],
        overlap_of_source=overlaps[0],
        overlap_of_target=overlaps[1],
        exact_up_to=reach,
        far_error=max(far_source.error, far_target.error),
        report=report,
        entries=entries,
        seconds=seconds,
    )


def _entries(
    pair: TiledPair,
    distances: tuple[DistanceFile, DistanceFile],
    every: tuple[DistanceStatistics, DistanceStatistics],
    folder: Path,
    areas: Sequence[Area] | None,
    tolerance: float | None,
    hole_radius: float,
) -> dict[str, Any]:
    rows = rows_of_areas(
        pair,
        *distances,
        folder,
        areas,
        cell=hole_radius,
        reach=hole_radius,
        tolerance=tolerance,
        max_distance=hole_radius,
    )
    sums = [summed_up(file, tolerance, hole_radius) for file in distances]
    return entries_of(
        rows,
        (sums[0], sums[1]),
        (middle_spacing(pair.source), middle_spacing(pair.target)),
        every,
        tolerance=tolerance,
        max_distance=hole_radius,
        is_automatic=areas is None,
    )


@contextmanager
def _timed(seconds: dict[str, dict[str, float]], key: str) -> Iterator[None]:
    wall, process = time.perf_counter(), time.process_time()
    yield
    seconds[key] = {"wall": time.perf_counter() - wall, "process": time.process_time() - process}
