"""`tmchho.m3c2` for files larger than memory: the same cores and changes, tile by tile."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tmchho import _core
from tmchho.arguments import checked_number
from tmchho.evaluation.areas import Area, areas_of_parts
from tmchho.evaluation.change import UNKNOWN_ERROR, change_entries, few_points_warnings, m3c2_options
from tmchho.evaluation.lengths import quantile_of_parts, statistics_of_parts
from tmchho.io.las_stream import LasPoints
from tmchho.streams.evaluate import tallies_of
from tmchho.streams.memory import default_max_memory
from tmchho.streams.neighbours import first_reach, gathered
from tmchho.streams.pair import TiledPair, tile_pair, tiles_of

Floats = NDArray[np.float64]

_AT_ONCE = 200_000
_SCALE_PLACES = 2000  # at so many places the core looks at spacing and roughness
_FIRST_REACH = 4.0  # in reaches that suit single neighbours
_BALL_IN_RADII = 4.0  # the largest ball for a normal that is derived
_WIDER = 1 + 1e-9

_CORE = np.dtype(
    [
        *((name, "<f8", (3,)) for name in ("cores", "normals")),
        *(
            (name, "<f8")
            for name in (
                *("normal_radius", "distance", "level_of_detection", "significant_from"),
                *("target_spread", "source_spread"),
            )
        ),
        *((name, "<u4") for name in ("n_target", "n_source")),
        ("is_significant", "?"),
    ]
)


@dataclass(frozen=True, eq=False)
class StreamedChange:
    """What changed between two files.

    Parameters
    ----------
    path : Path
        The numbers of all cores, on disk, in the order of the tiles.
    n_cores : int
        How many.
    tolerance : float or None
        As asked for.
    warnings : tuple of str
        What the figures do not tell.
    entries : dict
        What `tmchho.Change.to_dict` returns.
    """

    path: Path
    n_cores: int
    tolerance: float | None
    warnings: tuple[str, ...]
    entries: dict[str, Any]

    def to_dict(self) -> dict[str, Any]:
        """Return everything but the numbers of single cores as what JSON knows."""
        return self.entries

    def parts(self) -> Iterator[NDArray[np.void]]:
        """Give the cores part by part, with the arrays of `tmchho.Change` as fields."""
        return parts_of(self.path)


def parts_of(path: Path) -> Iterator[NDArray[np.void]]:
    """Give the cores that a file holds, part by part."""
    n_cores = path.stat().st_size // _CORE.itemsize
    for start in range(0, n_cores, _AT_ONCE):
        yield np.fromfile(
            path, dtype=_CORE, count=min(_AT_ONCE, n_cores - start), offset=start * _CORE.itemsize
        )


def m3c2_files(
    source: LasPoints,
    target: LasPoints,
    matrix: Floats,
    *,
    folder: Path,
    normal_radii: Sequence[float] | None = None,
    cylinder_radius: float | None = None,
    max_depth: float | None = None,
    registration_error: float | None = None,
    tolerance: float | None = None,
    areas: Sequence[Area] | None = None,
    max_memory: int | None = None,
) -> StreamedChange:
    """Measure what changed between two LAS, LAZ or COPC files of any size; see `tmchho.m3c2`.

    Parameters
    ----------
    source, target : LasPoints
        The later and the earlier survey.
    matrix : (4, 4) float64 array
        Takes source to target coordinates.
    folder : Path
        For 16 bytes a point and 141 a core; the cores stay there, as long as they are needed.
    normal_radii, cylinder_radius, max_depth, registration_error, tolerance
        See `tmchho.m3c2`.
    areas : sequence of Area, optional
        Five strips along the cores where not given.
    max_memory : int, optional
        Bytes to keep to, about; half of the machine's where not given.

    Returns
    -------
    StreamedChange
    """
    given = m3c2_options(normal_radii, cylinder_radius, max_depth, registration_error)
    if tolerance is not None:
        checked_number("tolerance", tolerance, 0.0)
    allowed = default_max_memory() if max_memory is None else max_memory
    pair = tile_pair(source, target, matrix, folder, allowed)
    radii, radius, depth, min_points = _scales(pair, given)
    settled = json.loads(given) | {
        "normal_radii_m": radii,
        "cylinder_radius_m": radius,
        "max_depth_m": depth,
    }
    path = folder / "cores"
    reach = _WIDER * max(*radii, float(np.hypot(radius, depth)))
    with path.open("wb") as stream:
        for tile in range(pair.cuts.n_tiles):
            cores = _cores(pair, tile, radius)
            for start in range(0, len(cores), _AT_ONCE):
                some = cores[start : start + _AT_ONCE]
                stream.write(_changes(pair, some, reach, json.dumps(settled)).tobytes())
    told = {
        "tolerance": tolerance,
        "registration_error": registration_error or 0.0,
        "normal_radii": tuple(radii),
        "cylinder_radius": radius,
        "max_depth": depth,
        "min_points": min_points,
    }
    return _summed_up(pair, path, folder, told, areas, is_error_known=registration_error is not None)


def _scales(pair: TiledPair, options: str) -> tuple[list[float], float, float, int]:
    """Return the lengths that the core would derive from both files as wholes."""
    given = json.loads(options)
    tiled = (pair.target, pair.source)
    places = pair.target.sample(_SCALE_PLACES), pair.source.sample(_SCALE_PLACES)
    if given.get("normal_radii_m") and given.get("cylinder_radius_m"):
        return _core.m3c2_scales(places, *places, options)
    reach = _FIRST_REACH * max(map(first_reach, tiled))
    widest = max(float(np.linalg.norm(file.highest - file.lowest)) for file in tiled)
    while True:
        near = [gathered(file, at, reach) for file, at in zip(tiled, places, strict=True)]
        found = _core.m3c2_scales(places, near[0], near[1], options)
        # All that a ball of the largest radius can hold is there, or everything is.
        needed = found[1] if given.get("normal_radii_m") else _BALL_IN_RADII * found[1]
        if needed <= reach or reach > widest:
            return found
        reach = max(2 * reach, _WIDER * min(needed, 4 * reach))


def _cores(pair: TiledPair, tile: int, edge: float) -> Floats:
    """Return those centroids of the target's voxels that lie in a tile's part of space."""
    low, high = pair.cuts.cell_of(tile)
    lowest, highest = pair.target.lowest, pair.target.highest
    margin = 2 * edge  # more than the diagonal of a voxel
    points, index = pair.target.within(np.maximum(low, lowest) - margin, np.minimum(high, highest) + margin)
    voxels = _core.RunningVoxels(tuple(lowest), tuple(highest), edge, 2**32 - 2)
    # In the file's order, so that a voxel at the border has the same bits from either side.
    voxels.add(np.ascontiguousarray(points[np.argsort(index)]))
    centroids: Floats = voxels.finish()["points"]
    first, last = pair.cuts.blocks_of(tile)
    blocks = pair.cuts.block_of(centroids)
    return np.ascontiguousarray(centroids[(blocks >= first) & (blocks < last)])


def _changes(pair: TiledPair, cores: Floats, reach: float, options: str) -> NDArray[np.void]:
    low, high = cores.min(axis=0) - reach, cores.max(axis=0) + reach
    clouds = []
    for tiled in (pair.source, pair.target):
        points, index = tiled.within(low, high)
        points = points[np.argsort(index)]
        if not len(points):  # one that no cylinder reaches, as the core takes no empty cloud
            points = (high + (high - low))[None]
        clouds.append(np.ascontiguousarray(points))
    found = _core.m3c2(clouds[0], clouds[1], np.eye(4), cores, options)
    changes = np.empty(len(cores), dtype=_CORE)
    for name in _CORE.names or ():
        changes[name] = found[name]
    return changes


def _summed_up(
    pair: TiledPair,
    path: Path,
    folder: Path,
    told: dict[str, Any],
    areas: Sequence[Area] | None,
    *,
    is_error_known: bool,
) -> StreamedChange:
    def distances() -> Iterator[Floats]:
        return (part["distance"][np.isfinite(part["distance"])] for part in parts_of(path))

    def levels() -> Iterator[Floats]:
        known = "level_of_detection"
        return (part[known][np.isfinite(part[known])] for part in parts_of(path))

    def seen() -> Iterator[Floats]:
        return (part["cores"][np.isfinite(part["distance"])] for part in parts_of(path))

    n_cores = n_seen = n_few = n_significant = n_known = 0
    for part in parts_of(path):
        is_seen = np.isfinite(part["distance"])
        fewest = np.minimum(part["n_target"], part["n_source"])
        n_cores += len(part)
        n_seen += int(np.count_nonzero(is_seen))
        n_few += int(np.count_nonzero(is_seen & (fewest < told["min_points"])))
        n_significant += int(np.count_nonzero(part["is_significant"]))
        n_known += int(np.count_nonzero(np.isfinite(part["level_of_detection"])))
    cell = 2 * told["cylinder_radius"]
    chosen = areas_of_parts(seen, cell) if areas is None else areas
    tallies = tallies_of(chosen, cell, folder, tolerance=told["tolerance"])
    for tally in tallies:
        for part in parts_of(path):
            tally.add(part["cores"], part["distance"], part["is_significant"], covers=False)
    for points, _ in tiles_of(pair.target, pair.cuts.n_tiles):
        for tally in tallies:
            tally.cover_by_target(points)
    for points, _ in tiles_of(pair.source, pair.cuts.n_tiles):
        for tally in tallies:
            tally.cover(points)
    warnings = [] if is_error_known else [UNKNOWN_ERROR]
    warnings += few_points_warnings(n_few, n_seen, told["min_points"])
    told |= {"areas": tuple(tally.row() for tally in tallies), "warnings": tuple(warnings)}
    entries = change_entries(
        told,
        statistics_of_parts(distances),
        n_without=n_cores - n_seen,
        n_significant=n_significant,
        share_significant=n_significant / n_known if n_known else None,
        median_level=quantile_of_parts(levels, 0.5) if n_known else None,
    )
    return StreamedChange(path, n_cores, told["tolerance"], tuple(warnings), entries)
