"""Stations sorted by where their points lie in the world, on disk: what tiles of a network are cut from.

Why: a tile needs the points of every station there, and of each of them only those. A unit reads a station
once, part by part where the file is LAS, moves it, and sorts each part by square cells seen from above. What
a tile then reads is a few runs of each file.
Absent on purpose: more than the attributes that a fused survey is looked at by.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tmchho.errors import InvalidCloudError
from tmchho.io import atomic_path, is_las, las_parts, open_las, read
from tmchho.network.engine import Item
from tmchho.network.store import made_reference
from tmchho.transform import Transform

Floats = NDArray[np.float64]
Cells = NDArray[np.int64]

COLOURS = ("red", "green", "blue")
POINT = np.dtype(
    [
        ("xyz", "<f8", (3,)),
        ("index", "<u8"),
        ("intensity", "<u2"),
        ("classification", "u1"),
        *((name, "<u2") for name in COLOURS),
    ]
)
_RUN = np.dtype([("cell", "<i8", (2,)), ("start", "<i8"), ("count", "<i8")])
_FULL, _BYTE = 65535, 256


def sort_station(item: Item) -> Item:
    """Move a station into the world and sort its points by cell.

    Parameters
    ----------
    item : dict
        ``cloud``, a reference; ``name``; ``pose``, 4 × 4, to the world; ``cell``, edge of the squares;
        ``folder`` and ``number`` for the files made.

    Returns
    -------
    dict
        ``points`` and ``runs``, references to files; ``cells``, the number of points by cell as lists of x, y
        and count; ``n_points``; ``lowest`` and ``highest`` corner; ``colour_factor``, 0 without colours.

    Raises
    ------
    ReadError
        If the file cannot be read.
    InvalidCloudError
        If no point is finite.
    """
    transform, edge = Transform.of(item["pose"]), item["cell"]
    base = Path(item["folder"]) / f"{item['number']:05d}"
    lowest, highest = np.full(3, np.inf), np.full(3, -np.inf)
    runs: list[NDArray[np.void]] = []
    start, n_read, brightest, has_colours = 0, 0, 0, False
    path = base.with_suffix(".points")
    with atomic_path(path, overwrite=True) as temporary, temporary.open("wb") as stream:
        for xyz, attributes in _parts(Path(item["cloud"]["path"])):
            index = np.arange(n_read, n_read + len(xyz), dtype=np.uint64)
            n_read += len(xyz)
            finite = np.isfinite(xyz).all(axis=1)
            places = transform.apply(xyz[finite])
            if not len(places):
                continue
            cells = np.floor(places[:, :2] / edge).astype(np.int64)
            order = np.lexsort((cells[:, 1], cells[:, 0]))
            points = np.zeros(len(places), dtype=POINT)
            points["xyz"], points["index"] = places[order], index[finite][order]
            has_colours |= all(name in attributes for name in COLOURS)
            for name in ("intensity", "classification", *COLOURS):
                if name in attributes:
                    points[name] = _whole(attributes[name][finite][order], POINT[name], name)
            brightest = max(brightest, *(int(points[name].max()) for name in COLOURS))
            stream.write(points.tobytes())
            runs.append(_runs(cells[order], start))
            start += len(points)
            lowest, highest = np.minimum(lowest, places.min(axis=0)), np.maximum(highest, places.max(axis=0))
    if not runs:
        raise InvalidCloudError(f"{item['name']}: has no finite point")
    every = np.concatenate(runs)
    runs_path = base.with_suffix(".runs.npy")
    with atomic_path(runs_path, overwrite=True) as temporary, temporary.open("wb") as stream:
        np.save(stream, every)
    cells, where = np.unique(every["cell"], axis=0, return_inverse=True)
    counts = np.bincount(where.ravel(), weights=every["count"]).astype(np.int64)
    return {
        "points": made_reference(path),
        "runs": made_reference(runs_path),
        "cells": [*cells.T.tolist(), counts.tolist()],
        "n_points": start,
        "lowest": lowest.tolist(),
        "highest": highest.tolist(),
        "colour_factor": 0 if not has_colours else _BYTE if brightest < _BYTE else 1,
    }


def read_cells(sorted_station: Mapping[str, Any], first: Cells, last: Cells) -> NDArray[np.void]:
    """Return the points of a rectangle of cells, in the order of the file they came from.

    Parameters
    ----------
    sorted_station : mapping
        With ``points`` and ``runs``, as `sort_station` returns them.
    first, last : (2,) int64 array
        The corners, both included.
    """
    runs = np.load(sorted_station["runs"]["path"])
    wanted = runs[((runs["cell"] >= first) & (runs["cell"] <= last)).all(axis=1)]
    points = np.empty(int(wanted["count"].sum()), dtype=POINT)
    at = 0
    with Path(sorted_station["points"]["path"]).open("rb") as stream:
        for _, start, count in wanted:
            stream.seek(int(start) * POINT.itemsize)
            points[at : at + count] = np.fromfile(stream, dtype=POINT, count=int(count))
            at += count
    return points[np.argsort(points["index"])]


def _parts(path: Path) -> Iterator[tuple[Floats, Mapping[str, NDArray[Any]]]]:
    """Give coordinates and attributes, of LAS about a million points at once, of others all."""
    if not is_las(path):
        cloud = read(path)
        yield cloud.xyz, cloud.attributes
        return
    file = open_las(path)
    for records in las_parts(file):
        yield file.xyz(file.steps(records)), file.attributes(records)


def _runs(cells: Cells, start: int) -> NDArray[np.void]:
    """Return where the points of each cell stand, for cells that are sorted."""
    begins = np.flatnonzero(np.r_[True, (cells[1:] != cells[:-1]).any(axis=1)])
    runs = np.empty(len(begins), dtype=_RUN)
    runs["cell"], runs["start"] = cells[begins], begins + start
    runs["count"] = np.diff(np.r_[begins, len(cells)])
    return runs


def _whole(values: NDArray[Any], kind: np.dtype[Any], name: str) -> NDArray[Any]:
    """Return an attribute in the whole numbers of a LAS file; shares of 1 fill their range."""
    limit = np.iinfo(kind).max
    if values.dtype.kind == "f" and name != "classification" and values.max(initial=0.0) <= 1.0:
        values = values * _FULL
    if name in COLOURS and values.dtype == np.uint8:
        return values.astype(np.uint16)  # spread with the others of the station, by its colour factor
    return np.clip(np.rint(np.nan_to_num(values.astype(np.float64))), 0, limit).astype(kind)
