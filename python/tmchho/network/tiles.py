"""A whole network fused and measured tile by tile, by the engine that registered it.

Why tiles: all stations of a project together are larger than any memory. A tile is a rectangle of cells with
so many points as a worker may hold; it reads the points around it as well, as far as distances are measured,
so that no result depends on where the cuts lie.
Absent on purpose: a second way to measure distances; the kernel is that of `tmchho.streams`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import laspy  # type: ignore[import-untyped, unused-ignore]
import numpy as np
from numpy.typing import ArrayLike, NDArray

from tmchho import _core
from tmchho.errors import InvalidArgumentError
from tmchho.io import atomic_path, writing_las
from tmchho.io.las_grid import fitted_grid
from tmchho.io.las_write import open_las_writer
from tmchho.network.engine import Engine, Item
from tmchho.network.sorting import COLOURS, POINT, Cells, Floats, read_cells, sort_station
from tmchho.network.store import input_reference, made_reference
from tmchho.streams.layout import DISTANCE

FuseMode = Literal["merge", "dedup"]

_BINS = 256  # of the distances up to the reach, for their quantiles
_CELL_IN_REACHES = 16.0
_SCALE = 1e-4  # metres: of the fused file
_FORMAT, _COLOUR_FORMAT, _VERSION = 6, 7, (1, 4)
_FUSED_POINT = np.dtype([*POINT.descr, ("station", "<u2"), ("distance", "<f4")])
_AT_ONCE = 1_000_000


@dataclass(frozen=True, eq=False)
class PlacedCloud:
    """A station whose pose is known.

    Parameters
    ----------
    name : str
        How tables call it.
    path : Path
        Its file.
    world_from_station : (4, 4) array_like
        Its pose, a scale included.
    """

    name: str
    path: Path
    world_from_station: ArrayLike


def fuse_network(
    clouds: Sequence[PlacedCloud],
    output: Path,
    *,
    engine: Engine,
    folder: Path,
    reach: float,
    mode: FuseMode = "merge",
    repeat_radius: float = 0.0,
    points_per_tile: int = 2_000_000,
    crs: str | None = None,
) -> dict[str, Any]:
    """Fuse all stations into one file, and measure every point against all other stations.

    Parameters
    ----------
    clouds : sequence of PlacedCloud
        At most 65 535; where two repeat each other, the earlier one stays.
    output : Path
        LAS or LAZ, not yet there. Each point has its station's number, from 1, as ``point_source_id``, and as
        ``C2C_absolute_distances`` its distance to the nearest point of any other station, NaN beyond `reach`.
    engine : Engine
        Where the work is done.
    folder : Path
        Where the workers keep sorted points and tiles: about 90 bytes for each point.
    reach : float
        Distances up to this are measured, above 0.
    mode : {'merge', 'dedup'}
        Take all points, or leave out those that repeat one of an earlier station.
    repeat_radius : float, default 0
        Within this a point repeats another; at most `reach`.
    points_per_tile : int, default 2 000 000
        A worker holds about so many, and those within reach around them; one cell at least.
    crs : str, optional
        Coordinate reference system of the world as WKT.

    Returns
    -------
    dict
        ``n_points`` written, ``n_repeated``, ``n_tiles``, ``reach``, ``mode``, and ``stations``: for each its
        number, name, points, share with a counterpart and the RMS, median and 95 % of those distances.
    """
    if not (math.isfinite(reach) and reach > 0):
        raise InvalidArgumentError(f"reach must be above 0, got {reach:g}")
    if not 0 <= repeat_radius <= reach:
        raise InvalidArgumentError(
            f"repeat_radius must be from 0 to the reach, {reach:g}; got {repeat_radius:g}"
        )
    cell = _CELL_IN_REACHES * reach
    sorted_folder, tile_folder = folder / "sorted", folder / "tiles"
    for made in (sorted_folder, tile_folder):
        made.mkdir(parents=True, exist_ok=True)
    stations = engine.run(
        "sort",
        sort_station,
        [
            {
                "cloud": input_reference(cloud.path),
                "name": cloud.name,
                "pose": np.asarray(cloud.world_from_station, dtype=np.float64).tolist(),
                "cell": cell,
                "folder": str(sorted_folder.absolute()),
                "number": number,
            }
            for number, cloud in enumerate(clouds, start=1)
        ],
    )
    corners = cut_cells([station["cells"] for station in stations], points_per_tile)
    boxes = np.array([[station["lowest"][:2], station["highest"][:2]] for station in stations])
    tiles = engine.run(
        "tiles",
        fuse_tile,
        [
            {
                "first": first.tolist(),
                "last": last.tolist(),
                "cell": cell,
                "reach": reach,
                "repeat_radius": repeat_radius if mode == "dedup" else None,
                "stations": [
                    {"number": number + 1, "points": station["points"], "runs": station["runs"]}
                    | {"colour_factor": station["colour_factor"]}
                    for number, station in enumerate(stations)
                    if (boxes[number, 0] <= (last + 1) * cell + reach).all()
                    and (boxes[number, 1] >= first * cell - reach).all()
                ],
                "folder": str(tile_folder.absolute()),
                "number": number,
            }
            for number, (first, last) in enumerate(corners)
        ],
    )
    _write(tiles, stations, output, crs)
    measured = _summed(tiles, len(clouds), reach)
    return {
        "n_points": sum(tile["n_points"] for tile in tiles),
        "n_repeated": sum(tile["n_repeated"] for tile in tiles),
        "n_tiles": len(tiles),
        "reach": reach,
        "mode": mode,
        "stations": [
            {"number": number, "name": cloud.name, **figures}
            for number, (cloud, figures) in enumerate(zip(clouds, measured, strict=True), start=1)
        ],
    }


def cut_cells(cells: Sequence[Sequence[Sequence[int]]], points_per_tile: int) -> list[tuple[Cells, Cells]]:
    """Cut a plane of cells into rectangles that hold no more points than asked for, or one cell.

    Parameters
    ----------
    cells : sequence of (x, y, count)
        Of each station, as `sort_station` returns them.
    points_per_tile : int
        At least 1.

    Returns
    -------
    list of (first, last)
        Corners, both included, of rectangles with points; none shares a cell with another.
    """
    every = np.concatenate([np.array(station, dtype=np.int64).T for station in cells])
    places, where = np.unique(every[:, :2], axis=0, return_inverse=True)
    counts = np.bincount(where.ravel(), weights=every[:, 2])
    tiles, waiting = [], [np.arange(len(places))]
    while waiting:
        rows = waiting.pop()
        first, last = places[rows].min(axis=0), places[rows].max(axis=0)
        if counts[rows].sum() <= points_per_tile or len(rows) == 1:
            tiles.append((first, last))
            continue
        axis = int(np.argmax(last - first))
        rows = rows[np.argsort(places[rows, axis], kind="stable")]
        along = places[rows, axis]
        half = along[np.searchsorted(np.cumsum(counts[rows]), counts[rows].sum() / 2)]
        split = int(np.searchsorted(along, half if half > along[0] else half + 1))
        waiting += [rows[split:], rows[:split]]
    return tiles


def fuse_tile(item: Item) -> Item:
    """Fuse and measure the points of one tile.

    Parameters
    ----------
    item : dict
        ``first`` and ``last`` cell; ``cell``, their edge; ``reach``; ``repeat_radius``, None where nothing is
        left out; ``stations`` that may have points there; ``folder`` and ``number`` for the file made.

    Returns
    -------
    dict
        ``points``, a reference to the points that stay; ``n_points`` and ``n_repeated``; ``stations``: for
        each with points its number, ``n``, ``squares`` and ``histogram`` of the distances within reach.
    """
    first, last = np.array(item["first"]), np.array(item["last"])
    edge, reach, radius = item["cell"], item["reach"], item["repeat_radius"]
    around = math.ceil(reach / edge)
    low, high = first * edge - reach, (last + 1) * edge + reach
    owns, nears = [], []
    for station in item["stations"]:
        points = read_cells(station, first - around, last + around)
        cells = np.floor(points["xyz"][:, :2] / edge).astype(np.int64)
        near = ((points["xyz"][:, :2] >= low) & (points["xyz"][:, :2] <= high)).all(axis=1)
        owns.append(points[((cells >= first) & (cells <= last)).all(axis=1)])
        nears.append(np.ascontiguousarray(points["xyz"][near]))
    kept, figures, n_repeated = [], [], 0
    for k, (station, own) in enumerate(zip(item["stations"], owns, strict=True)):
        if not len(own):
            continue
        places = np.ascontiguousarray(own["xyz"])
        distances = _distances(places, nears[:k] + nears[k + 1 :], reach)
        within = distances[distances <= reach].astype(np.float64)
        figures.append(
            {
                "number": station["number"],
                "n": len(own),
                "squares": float((within * within).sum()),
                "histogram": np.histogram(within, bins=_BINS, range=(0.0, reach))[0].tolist(),
            }
        )
        fused = np.zeros(len(own), dtype=_FUSED_POINT)
        for name in POINT.names or ():
            fused[name] = own[name]
        for name in COLOURS:
            fused[name] *= np.uint16(max(1, station["colour_factor"]))
        fused["station"] = station["number"]
        fused["distance"] = np.where(distances <= reach, distances, np.float32(np.nan))
        if radius is not None:
            stays = ~(_distances(places, nears[:k], radius) <= radius)
            n_repeated += len(fused) - int(np.count_nonzero(stays))
            fused = fused[stays]
        kept.append(fused)
    result = np.concatenate(kept) if kept else np.zeros(0, dtype=_FUSED_POINT)
    path = Path(item["folder"]) / f"{item['number']:06d}.npy"
    with atomic_path(path, overwrite=True) as temporary, temporary.open("wb") as stream:
        np.save(stream, result)
    return {
        "points": made_reference(path),
        "n_points": len(result),
        "n_repeated": n_repeated,
        "stations": figures,
    }


def _distances(places: Floats, others: Sequence[Floats], reach: float) -> NDArray[np.float32]:
    """Return the distances to the nearest of other points, infinite beyond the reach."""
    together = np.concatenate(others) if others else np.zeros((0, 3))
    if not len(together):
        return np.full(len(places), np.inf, dtype=np.float32)
    distances, _ = _core.distances_within(places, len(places), together, reach, False)
    return distances


def _summed(tiles: Sequence[Item], n_stations: int, reach: float) -> list[dict[str, Any]]:
    """Add up the figures of all tiles, in their order."""
    n, squares = np.zeros(n_stations, dtype=np.int64), np.zeros(n_stations)
    histograms = np.zeros((n_stations, _BINS), dtype=np.int64)
    for tile in tiles:
        for figures in tile["stations"]:
            at = figures["number"] - 1
            n[at] += figures["n"]
            squares[at] += figures["squares"]
            histograms[at] += np.array(figures["histogram"], dtype=np.int64)
    found = []
    for count, square, histogram in zip(n.tolist(), squares.tolist(), histograms, strict=True):
        n_within = int(histogram.sum())
        found.append(
            {
                "n_points": count,
                "share_with_counterpart": n_within / count,
                "rms": math.sqrt(square / n_within) if n_within else None,
                "median": _quantile(histogram, 0.5, reach),
                "percentile_95": _quantile(histogram, 0.95, reach),
            }
        )
    return found


def _quantile(histogram: NDArray[np.int64], share: float, reach: float) -> float | None:
    """Return a quantile to a 256th of the reach: the upper end of the bin in which it lies."""
    total = int(histogram.sum())
    if total == 0:
        return None
    at = int(np.searchsorted(np.cumsum(histogram), share * total))
    return (at + 1) * reach / _BINS


def _write(
    tiles: Sequence[Item], stations: Sequence[Mapping[str, Any]], output: Path, crs: str | None
) -> None:
    """Write the points of all tiles, one tile after another."""
    lowest = np.min([station["lowest"] for station in stations], axis=0)
    highest = np.max([station["highest"] for station in stations], axis=0)
    grid = fitted_grid(lowest, highest, np.full(3, _SCALE))
    has_colours = any(station["colour_factor"] for station in stations)
    layout = (_COLOUR_FORMAT if has_colours else _FORMAT, _VERSION)
    with (
        writing_las(output),
        open_las_writer(output, None, layout, grid, [DISTANCE.parameters], crs=crs, kept_crs=None) as opened,
    ):
        writer, point_format = opened
        for tile in tiles:
            points = np.load(tile["points"]["path"], mmap_mode="r")
            for start in range(0, len(points), _AT_ONCE):
                part = np.array(points[start : start + _AT_ONCE])
                records = laspy.PackedPointRecord.zeros(len(part), point_format)
                for column, axis in enumerate("XYZ"):
                    records[axis] = grid.steps(part["xyz"])[:, column].astype(np.int32)
                for name in ("intensity", "classification", *(COLOURS if has_colours else ())):
                    records[name] = part[name]
                records["return_number"][:] = records["number_of_returns"][:] = 1
                records["point_source_id"] = part["station"]
                records[DISTANCE.name] = part["distance"]
                writer.write_points(records)
