"""`tmchho.evaluate` for files larger than memory: the same figures, tile by tile."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tmchho.evaluation.areas import Area, areas_of_parts
from tmchho.evaluation.distances import (
    HOLE_IN_SPACINGS,
    DistanceMethod,
    compare_options,
    density_warnings,
    evaluation_entries,
)
from tmchho.evaluation.lengths import Lengths, statistics_of_parts
from tmchho.evaluation.tally import AreaStatistics, AreaTally
from tmchho.io.las_stream import LasPoints
from tmchho.results import DistanceStatistics
from tmchho.streams.distances import DistanceFile
from tmchho.streams.memory import default_max_memory
from tmchho.streams.neighbours import Blocks, spacing_at
from tmchho.streams.pair import TiledPair, tile_pair, tiles_of
from tmchho.streams.surfaces import SurfaceDistances, measure_surfaces
from tmchho.streams.tiles import TiledFile

Floats = NDArray[np.float64]

# Within so many edges of the thinned clouds most distances are settled without a search.
_REACH_IN_VOXELS = 4.0
# At so many points the core looks at spacings.
_SPACING_PLACES, _WIDE_PLACES, _MOST = 2000, 10_000, 0.9


@dataclass(frozen=True, eq=False)
class StreamedEvaluation:
    """How far two files lie apart.

    Parameters
    ----------
    method : {'nearest', 'plane', 'normal', 'vertical'}
        What was measured.
    source_to_target, target_to_source : SurfaceDistances
        Of every point, on disk.
    source_box : tuple of (3,) float64 array
        Lower and upper corner of the source in target coordinates.
    tolerance : float or None
        As asked for.
    warnings : tuple of str
        What the figures do not tell.
    entries : dict
        What `tmchho.Evaluation.to_dict` returns.
    """

    method: DistanceMethod
    source_to_target: SurfaceDistances
    target_to_source: SurfaceDistances
    source_box: tuple[Floats, Floats]
    tolerance: float | None
    warnings: tuple[str, ...]
    entries: dict[str, Any]

    def to_dict(self) -> dict[str, Any]:
        """Return everything but the distances of single points as what JSON knows."""
        return self.entries


def evaluate_files(
    source: LasPoints,
    target: LasPoints,
    matrix: Floats,
    *,
    folder: Path,
    method: DistanceMethod = "nearest",
    tolerance: float | None = None,
    max_distance: float | None = None,
    areas: Sequence[Area] | None = None,
    max_memory: int | None = None,
) -> StreamedEvaluation:
    """Measure two LAS, LAZ or COPC files of any size against each other.

    Parameters
    ----------
    source, target : LasPoints
        The files; see `tmchho.io.open_las`.
    matrix : (4, 4) float64 array
        Takes source to target coordinates.
    folder : Path
        For 24 bytes a point while this runs; the distances stay there, as long as they are needed.
    method, tolerance, max_distance
        See `tmchho.evaluate`.
    areas : sequence of Area, optional
        Five strips along the overlap where not given.
    max_memory : int, optional
        Bytes to keep to, about; half of the machine's where not given.

    Returns
    -------
    StreamedEvaluation
    """
    options = compare_options(method, None, tolerance, max_distance)
    allowed = default_max_memory() if max_memory is None else max_memory
    pair = tile_pair(source, target, matrix, folder, allowed)
    reach = max(_REACH_IN_VOXELS * pair.voxel_size, max_distance or 0.0)
    forth, back = (
        measure_surfaces(pair, start, end, method, options, reach, folder / f"{name}.distances")
        for name, start, end in (("source", pair.source, pair.target), ("target", pair.target, pair.source))
    )
    spacing = spacings_at(pair.target, pair.source), spacings_at(pair.source, pair.target)
    sums = [summed_up(distances, tolerance, max_distance) for distances in (forth, back)]
    wide = max(wide_spacing(tiled) for tiled in (pair.source, pair.target))
    cell = HOLE_IN_SPACINGS * wide or 1.0  # one point has no spacing
    rows = rows_of_areas(
        pair,
        forth,
        back,
        folder,
        areas,
        cell=cell,
        reach=cell if max_distance is None else max_distance,
        tolerance=tolerance,
        max_distance=max_distance,
    )
    pairs = (sums[0][0], sums[1][0])
    warnings = density_warnings(pairs, spacing) if method == "nearest" else ()
    entries = evaluation_entries(
        method,
        tolerance,
        max_distance,
        pairs,
        (sums[0][1], sums[1][1]),
        (sums[0][2], sums[1][2]),
        spacing,
        rows,
        warnings,
    )
    box = pair.source.lowest, pair.source.highest
    return StreamedEvaluation(method, forth, back, box, tolerance, warnings, entries)


def summed_up(
    distances: SurfaceDistances | DistanceFile, tolerance: float | None, max_distance: float | None
) -> tuple[DistanceStatistics | None, float | None, int]:
    """Return the statistics, the share within the tolerance, and how many points were not measured."""
    statistics = statistics_of_parts(lambda: distances.measured(max_distance))
    if statistics is None:
        return None, None, distances.n_points
    n_beyond = distances.n_points - statistics.n_points
    if tolerance is None:
        return statistics, None, n_beyond
    within = (np.count_nonzero(np.abs(part) <= tolerance) for part in distances.measured(max_distance))
    return statistics, int(sum(within)) / statistics.n_points, n_beyond


def spacings_at(start: TiledFile, end: TiledFile) -> float:
    """Return the median spacing of `end` at its points nearest to points of `start`."""
    feet = Blocks(end).nearest(start.sample(_SPACING_PLACES), 1)[1][:, 0]
    return spacing_at(end, feet, lambda n: (n - 1) // 2)


def middle_spacing(tiled: TiledFile) -> float:
    """Return the median distance from a point of a file to the nearest one elsewhere."""
    return spacing_at(tiled, tiled.sample(_WIDE_PLACES), lambda n: int(0.5 * (n - 1) + 0.5))


def wide_spacing(tiled: TiledFile) -> float:
    """Return the spacing that nine points in ten of a file keep to."""
    return spacing_at(tiled, tiled.sample(_WIDE_PLACES), lambda n: int(_MOST * (n - 1) + 0.5))


def rows_of_areas(
    pair: TiledPair,
    forth: SurfaceDistances | DistanceFile,
    back: SurfaceDistances | DistanceFile,
    folder: Path,
    areas: Sequence[Area] | None,
    *,
    cell: float,
    reach: float,
    tolerance: float | None,
    max_distance: float | None,
) -> tuple[AreaStatistics, ...]:
    """Sum up the distances of the source by area; see `tmchho.evaluation.measure_areas`.

    Without areas, the overlap is cut into strips: what of the target lies within `reach` of the source.
    """
    n_tiles = pair.cuts.n_tiles

    def overlap() -> Iterator[Floats]:
        for points, index in tiles_of(pair.target, n_tiles):
            yield points[np.abs(back.of(index)) <= reach]

    chosen = areas_of_parts(overlap, cell) if areas is None else areas
    tallies = tallies_of(chosen, cell, folder, tolerance=tolerance, max_distance=max_distance)
    for points, index in tiles_of(pair.source, n_tiles):
        distances = forth.of(index)
        for tally in tallies:
            tally.add(points, distances)
    for points, _ in tiles_of(pair.target, n_tiles):
        for tally in tallies:
            tally.cover_by_target(points)
    return tuple(tally.row() for tally in tallies)


def tallies_of(
    areas: Iterable[Area],
    cell: float,
    folder: Path,
    *,
    tolerance: float | None,
    max_distance: float | None = None,
) -> list[AreaTally]:
    """Return what sums up each area, with its distances on disk."""
    return [
        AreaTally(
            area,
            cell,
            Lengths(folder / f"area{number}.distances"),
            tolerance=tolerance,
            max_distance=max_distance,
        )
        for number, area in enumerate(areas)
    ]
