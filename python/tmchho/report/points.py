"""The points that a report shows: few enough for a page, spread evenly, kept beside the other results.

Why kept: a report is made from results alone, also years later, when the clouds lie elsewhere. Positions are
16-bit steps from an origin, as the 3D view draws them.
"""

from __future__ import annotations

import zipfile
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from tmchho.errors import ReadError
from tmchho.report.cut import cut_through

if TYPE_CHECKING:
    from tmchho.cloud import PointCloud
    from tmchho.fused import FusedCloud
    from tmchho.results import Registration

# Of both clouds together; 300 000 points are 4 MB in the page, and any phone turns them.
MAX_POINTS = 300_000
N_STEPS = 65_535
NO_COLOUR = 150  # grey
_COLOURS = ("red", "green", "blue")
# What damaged archives end in: names, shapes and packing that are none, encryption, sizes beyond all memory.
_DAMAGE = (
    KeyError,
    ValueError,
    TypeError,
    EOFError,
    MemoryError,
    RuntimeError,
    zipfile.BadZipFile,
    zlib.error,
)


class Fusion(Protocol):
    """What is asked of a fused cloud; see `tmchho.FusedCloud`."""

    @property
    def origin(self) -> NDArray[np.uint8]:
        """0 for points of the target, 1 for points of the source."""

    @property
    def index(self) -> NDArray[np.uint32]:
        """Row of the point in its own cloud."""

    @property
    def fills_hole(self) -> NDArray[np.bool_]:
        """Whether the other cloud has no point nearby."""

    @property
    def distance(self) -> NDArray[np.float64]:
        """Distance to the nearest point of the other cloud."""


@dataclass(frozen=True, eq=False)
class ReportPoints:
    """Points of both clouds in the frame of the target: first those of the target, then those of the source.

    Within each cloud the order is such that the first points, however many, are spread evenly too.

    Parameters
    ----------
    origin, step : (3,) float64 array
        A point lies at ``origin + step * steps``.
    steps : (n, 3) uint16 array
        Positions.
    n_target : int
        How many of the points are the target's.
    distance : (n,) float32 array
        Distance to the nearest point of the other cloud; NaN where it was not measured.
    fills_hole, is_fused : (n,) bool array
        Whether the other cloud has no point nearby, and whether the point is in the fused cloud.
    colour : (n, 3) uint8 array
        As recorded, or the intensity as grey; no rows where neither cloud has any of it.
    cut : (k, 2) float32 array
        Points of both clouds in a thin upright cut, at full density: along the cut and upwards. No rows where
        the clouds share too little.
    cut_is_source : (k,) bool array
        Which of them are the source's.
    cut_thickness : float
        Of the cut.
    """

    origin: NDArray[np.float64]
    step: NDArray[np.float64]
    steps: NDArray[np.uint16]
    n_target: int
    distance: NDArray[np.float32]
    fills_hole: NDArray[np.bool_]
    is_fused: NDArray[np.bool_]
    colour: NDArray[np.uint8]
    cut: NDArray[np.float32]
    cut_is_source: NDArray[np.bool_]
    cut_thickness: float

    @property
    def xyz(self) -> NDArray[np.float64]:
        """Coordinates in the frame of the target."""
        return np.asarray(self.origin + self.step * self.steps)

    @property
    def is_source(self) -> NDArray[np.bool_]:
        """Which points are the source's."""
        return np.arange(len(self.steps)) >= self.n_target

    def save(self, path: Path) -> None:
        """Write the points as a compressed ``.npz`` file; equal points give equal bytes."""
        with path.open("wb") as stream:
            np.savez_compressed(stream, **{field.name: getattr(self, field.name) for field in fields(self)})

    @classmethod
    def load(cls, path: Path) -> ReportPoints:
        """Read what `save` wrote.

        Raises
        ------
        ReadError
            If the file is missing, damaged or something else.
        """
        try:
            with np.load(path, allow_pickle=False) as file:
                values: dict[str, Any] = {field.name: file[field.name] for field in fields(cls)}
            values["n_target"] = int(values["n_target"])
            values["cut_thickness"] = float(values["cut_thickness"])
        except OSError as error:
            raise ReadError(
                f"{path}: cannot be read ({error.strerror or error}); check the rights"
            ) from error
        except _DAMAGE as error:
            raise ReadError(f"{path}: does not hold the points of a report; register once more") from error
        return cls(**values)


def points_of(
    registration: Registration,
    source: PointCloud,
    target: PointCloud,
    fused: FusedCloud | None,
    max_points: int = MAX_POINTS,
) -> ReportPoints:
    """Choose the points that the report of a registration shows.

    Parameters
    ----------
    registration : Registration
        Its pose moves the source, its seed settles the choice.
    source, target : PointCloud
        The clouds that were registered.
    fused : FusedCloud, optional
        What they were fused to; without it distances and holes are not known.
    max_points : int
        Of both clouds together; a cloud that needs less than half leaves the rest to the other.

    Returns
    -------
    ReportPoints
    """
    edge = registration.voxel_size / registration.scale
    return choose(source, target, registration.apply, fused, registration.seed, edge, max_points)


def choose(
    source: PointCloud,
    target: PointCloud,
    move: Callable[[NDArray[np.float64]], NDArray[np.float64]],
    fused: Fusion | None,
    seed: int,
    edge: float,
    max_points: int = MAX_POINTS,
) -> ReportPoints:
    """Do what `points_of` does, for clouds of which only the move is known.

    `move` takes source to target coordinates; `edge` is that of the cubes in which points are counted.
    """
    clouds = (target, source)
    finite = [np.flatnonzero(np.isfinite(cloud.xyz).all(axis=1)) for cloud in clouds]
    shares = _shares([len(rows) for rows in finite], max_points)
    chosen, places = [], []
    for number, (cloud, rows, share) in enumerate(zip(clouds, finite, shares, strict=True)):
        random = np.random.default_rng([seed, number])
        kept = rows[spread(cloud.xyz[rows], share, edge, random)]
        chosen.append(kept)
        places.append(cloud.xyz[kept] if number == 0 else move(cloud.xyz[kept]))
    xyz = np.concatenate(places)
    origin, step, steps = quantised(xyz)
    distance, fills_hole, is_fused = (
        np.concatenate([values[rows] for values, rows in zip(of_clouds, chosen, strict=True)])
        for of_clouds in _fused_values(fused, [len(cloud) for cloud in clouds])
    )
    common = np.isfinite(distance) & ~fills_hole
    is_source = np.arange(len(xyz)) >= len(chosen[0])
    cut, cut_is_source, cut_thickness = cut_through(
        xyz[common],
        is_source[common],
        (source, target),
        move,
        np.random.default_rng([seed, 2]),
    )
    colours = [colour_of(cloud.attributes, rows) for cloud, rows in zip(clouds, chosen, strict=True)]
    return ReportPoints(
        origin=origin,
        step=step,
        steps=steps,
        n_target=len(chosen[0]),
        distance=distance,
        fills_hole=fills_hole,
        is_fused=is_fused,
        colour=joined_colours(colours, [len(rows) for rows in chosen]),
        cut=cut,
        cut_is_source=cut_is_source,
        cut_thickness=cut_thickness,
    )


def spread(
    xyz: NDArray[np.float64], n_wanted: int, edge: float, random: np.random.Generator
) -> NDArray[np.intp]:
    """Return rows of points that are spread evenly over the surface, whatever the density there.

    Parameters
    ----------
    xyz : (n, 3) float64 array
        Finite points.
    n_wanted : int
        How many rows at most.
    edge : float
        Edge of the cubes in each of which as many points are wanted; above 0.
    random : numpy.random.Generator
        Settles which.

    Returns
    -------
    (k,) array of int
        In an order of which every beginning is spread evenly.

    Notes
    -----
    Drawn without replacement with weights 1 / (points in the cube): Efraimidis & Spirakis (2006).
    """
    cube = np.floor((xyz - xyz.min(axis=0)) / edge).astype(np.int64) if len(xyz) else np.empty((0, 3), int)
    # Cubes may share a number in a cloud of more than 2 000 000 edges, which thins it a little unevenly.
    number = (cube[:, 0] << 42) ^ (cube[:, 1] << 21) ^ cube[:, 2]
    _, inverse, counts = np.unique(number, return_inverse=True, return_counts=True)
    key = random.exponential(size=len(xyz)) * counts[inverse.ravel()]
    if n_wanted >= len(xyz):
        return np.argsort(key, kind="stable")
    smallest = np.argpartition(key, n_wanted)[:n_wanted]
    return smallest[np.argsort(key[smallest], kind="stable")]


def quantised(
    xyz: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.uint16]]:
    """Return the origin, the steps along the axes, and the positions in steps."""
    origin = xyz.min(axis=0)
    step = np.maximum((xyz.max(axis=0) - origin) / N_STEPS, np.finfo(float).tiny)
    return origin, step, np.rint((xyz - origin) / step).astype(np.uint16)


def colour_of(attributes: Mapping[str, NDArray[Any]], rows: NDArray[np.intp]) -> NDArray[np.uint8] | None:
    """Return the colours of some rows, the intensity as grey where there are none, None without either."""
    grey = _grey_of_intensity(attributes, rows)
    if not all(name in attributes for name in _COLOURS):
        return grey
    values = np.stack([np.asarray(attributes[name])[rows] for name in _COLOURS], axis=1)
    if values.dtype.kind not in "ui" or not values.any():
        return grey
    # 16-bit colours use the upper byte, though some programs write 8-bit values into them.
    colour = np.asarray((values >> 8 if values.max() > 255 else values).astype(np.uint8))
    # Black is what a fused cloud has where the one cloud had no colour.
    is_black = ~values.any(axis=1)
    colour[is_black] = NO_COLOUR if grey is None else grey[is_black]
    return colour


def _grey_of_intensity(
    attributes: Mapping[str, NDArray[Any]], rows: NDArray[np.intp]
) -> NDArray[np.uint8] | None:
    if "intensity" not in attributes or len(rows) == 0:
        return None
    values = np.asarray(attributes["intensity"])[rows].astype(np.float64)
    known = values[np.isfinite(values)]
    low, high = np.percentile(known, [2, 98]) if len(known) else (0.0, 0.0)
    if not high > low:
        return None
    grey = np.nan_to_num(np.clip((values - low) / (high - low), 0, 1)) * 205 + 40
    return np.repeat(grey.astype(np.uint8)[:, None], 3, axis=1)


def joined_colours(colours: list[NDArray[np.uint8] | None], counts: list[int]) -> NDArray[np.uint8]:
    """Return the colours of several clouds, grey for one that has none; no rows where none has any."""
    if all(colour is None for colour in colours):
        return np.empty((0, 3), dtype=np.uint8)
    return np.concatenate(
        [
            np.full((count, 3), NO_COLOUR, dtype=np.uint8) if colour is None else colour
            for colour, count in zip(colours, counts, strict=True)
        ]
    )


def _shares(counts: list[int], most: int) -> list[int]:
    """Return how many points of two clouds are taken."""
    half = most // 2
    first = min(counts[0], max(half, most - counts[1]))
    return [first, min(counts[1], most - first)]


def _fused_values(
    fused: Fusion | None, counts: list[int]
) -> tuple[list[NDArray[np.float32]], list[NDArray[np.bool_]], list[NDArray[np.bool_]]]:
    """Return distance, whether a hole is filled, and whether fused, for every row of target and source."""
    distance = [np.full(count, np.nan, dtype=np.float32) for count in counts]
    fills_hole, is_fused = ([np.zeros(count, dtype=bool) for count in counts] for _ in range(2))
    if fused is not None:
        for origin in (0, 1):
            taken = fused.origin == origin
            rows = fused.index[taken]
            distance[origin][rows] = fused.distance[taken]
            fills_hole[origin][rows] = fused.fills_hole[taken]
            is_fused[origin][rows] = True
    return distance, fills_hole, is_fused
