"""The bare ground of the site: a height grid made of a valley and the earthworks in it.

All heights are functions of the place alone: value noise is drawn cell by cell, so that a larger
site with the same seed shows the same ground where both exist.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tmchho.simulate.arguments import stream

Array = NDArray[np.float64]

# Edge of the blocks of lattice nodes that share one random generator.
LATTICE_BLOCK = 32
# The splines average over nodes: nodes in this range give noise that mostly fills [-1, 1].
NODE_RANGE = 2.0


class Area(NamedTuple):
    """A rectangle of the plan, in metres of the site's own frame."""

    west: float
    south: float
    east: float
    north: float

    @property
    def square_metres(self) -> float:
        """The rectangle's area, in m²."""
        return (self.east - self.west) * (self.north - self.south)

    def contains(self, x: Array, y: Array) -> NDArray[np.bool_]:
        """Tell which places lie inside; `x` and `y` in metres, same shape."""
        return (x >= self.west) & (x <= self.east) & (y >= self.south) & (y <= self.north)


@dataclass(frozen=True, eq=False)
class Ground:
    """Heights on a square grid, bilinear in between.

    Parameters
    ----------
    heights : (n_y, n_x) float64 array
        Height of every node, in metres; the row is the north index, the column the east index.
    materials : (n_y, n_x) uint8 array
        `Material` of every node.
    west, south : float
        Place of node [0, 0], in metres.
    cell_m : float
        Distance between neighbouring nodes, in metres.
    """

    heights: Array
    materials: NDArray[np.uint8]
    west: float
    south: float
    cell_m: float

    def height(self, x: Array, y: Array) -> Array:
        """Bilinear height at places of any common shape, in metres; outside, that of the rim."""
        return bilinear(self.heights, (x - self.west) / self.cell_m, (y - self.south) / self.cell_m)

    def gradient(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Slope towards east and north at the given places, over one cell, without unit."""
        half = 0.5 * self.cell_m
        east = self.height(x + half, y) - self.height(x - half, y)
        north = self.height(x, y + half) - self.height(x, y - half)
        return east / self.cell_m, north / self.cell_m

    def normals(self, x: Array, y: Array) -> Array:
        """Upward unit normals at places of shape (n,), as an (n, 3) array."""
        east, north = self.gradient(x, y)
        normals = np.stack([-east, -north, np.ones_like(east)], axis=-1)
        return np.asarray(normals / np.linalg.norm(normals, axis=-1, keepdims=True))

    def material(self, x: Array, y: Array) -> NDArray[np.uint8]:
        """Material of the nearest node, for places of any common shape."""
        n_y, n_x = self.materials.shape
        column = np.clip(np.rint((x - self.west) / self.cell_m).astype(np.intp), 0, n_x - 1)
        row = np.clip(np.rint((y - self.south) / self.cell_m).astype(np.intp), 0, n_y - 1)
        return self.materials[row, column]


def bilinear(grid: Array, column: Array, row: Array) -> Array:
    """Interpolate a grid at fractional indices of any common shape, clipped to the grid's rim."""
    n_y, n_x = grid.shape
    column = np.clip(column, 0.0, n_x - 1.0)
    row = np.clip(row, 0.0, n_y - 1.0)
    left = np.minimum(column.astype(np.intp), n_x - 2)
    lower = np.minimum(row.astype(np.intp), n_y - 2)
    column = column - left
    row = row - lower
    corner = lower * n_x + left
    values = grid.ravel()
    south = values.take(corner)
    south += column * (values.take(corner + 1) - south)
    corner += n_x
    north = values.take(corner)
    north += column * (values.take(corner + 1) - north)
    south += row * (north - south)
    return np.asarray(south)


def value_noise(x: Array, y: Array, wavelength_m: float, seed: int, name: str) -> Array:
    """Smooth noise, mostly within [-1, 1] and never beyond [-2, 2], on the grid spanned by two axes.

    Parameters
    ----------
    x, y : (n_x,) and (n_y,) float64 arrays
        Ascending axes of the grid, in metres.
    wavelength_m : float
        Distance between the lattice nodes that carry the random values, in metres.
    seed : int
        Seed of the site.
    name : str
        Name of the random stream.

    Returns
    -------
    (n_y, n_x) float64 array
    """
    columns, east = _spline_weights(x / wavelength_m)
    rows, north = _spline_weights(y / wavelength_m)
    lattice = _lattice(rows[0], rows[-1] + 4, columns[0], columns[-1] + 4, seed, name)
    columns -= columns[0]
    rows -= rows[0]
    stretched = sum(east[k] * lattice[:, columns + k] for k in range(4))
    noise = north[0][:, None] * stretched[rows]
    for k in range(1, 4):
        noise += north[k][:, None] * stretched[rows + k]
    return np.asarray(noise)


def _spline_weights(position: Array) -> tuple[NDArray[np.int64], Array]:
    """Split lattice positions into first node numbers and the four cubic B-spline weights.

    B-splines hide the squares of the lattice, which interpolation through its nodes would show.
    """
    node = np.floor(position).astype(np.int64)
    t = position - node
    return node - 1, np.stack(
        [(1.0 - t) ** 3, 3.0 * t**3 - 6.0 * t**2 + 4.0, 1.0 + 3.0 * t * (1.0 + t - t * t), t**3]
    ) / 6.0


def _lattice(row_0: int, row_1: int, column_0: int, column_1: int, seed: int, name: str) -> Array:
    """Random values of the lattice nodes [row_0, row_1) x [column_0, column_1)."""
    size = LATTICE_BLOCK
    block_rows = range(row_0 // size, (row_1 - 1) // size + 1)
    block_columns = range(column_0 // size, (column_1 - 1) // size + 1)
    blocks = [
        [
            stream(seed, name, row, column).uniform(-NODE_RANGE, NODE_RANGE, (size, size))
            for column in block_columns
        ]
        for row in block_rows
    ]
    row_0 -= block_rows[0] * size
    row_1 -= block_rows[0] * size
    column_0 -= block_columns[0] * size
    column_1 -= block_columns[0] * size
    return np.asarray(np.block(blocks)[row_0:row_1, column_0:column_1])


def grade(
    heights: Array,
    x: Array,
    y: Array,
    centre_line: Sequence[tuple[float, float, float]],
    half_width_m: float,
    batter: float,
) -> NDArray[np.bool_]:
    """Cut and fill `heights` in place to a road bed and give back where the bed lies.

    Parameters
    ----------
    heights : (n_y, n_x) float64 array
        Changed in place.
    x, y : (n_x,) and (n_y,) float64 arrays
        Axes of the grid, in metres.
    centre_line : sequence of (x, y, z)
        Corners of the bed's centre line, in metres.
    half_width_m : float
        Half the width of the bed.
    batter : float
        Rise over run of the slopes on both sides, cut as well as fill.
    """
    bed = np.zeros(heights.shape, dtype=bool)
    corners = np.asarray(centre_line)
    # Slopes end where they meet the ground; 40 m are enough for every cut of this site.
    reach = half_width_m + 40.0
    columns = _span(x, corners[:, 0].min() - reach, corners[:, 0].max() + reach)
    rows = _span(y, corners[:, 1].min() - reach, corners[:, 1].max() + reach)
    east, north = x[columns][None, :], y[rows][:, None]
    nearest_sq = np.full((north.size, east.size), np.inf)
    level = np.zeros_like(nearest_sq)
    for start, end in pairwise(corners):
        along = end - start
        part = ((east - start[0]) * along[0] + (north - start[1]) * along[1]) / (along[:2] @ along[:2])
        part = np.clip(part, 0.0, 1.0)
        distance_sq = (east - start[0] - part * along[0]) ** 2 + (north - start[1] - part * along[1]) ** 2
        closer = distance_sq < nearest_sq
        nearest_sq[closer] = distance_sq[closer]
        level[closer] = (start[2] + part * along[2])[closer]
    distance = np.sqrt(nearest_sq)
    room = np.maximum(distance - half_width_m, 0.0) * batter
    window = (rows, columns)
    inside = distance < reach
    heights[window] = np.where(inside, np.clip(heights[window], level - room, level + room), heights[window])
    bed[window] = distance <= half_width_m
    return bed


def _span(axis: Array, low: float, high: float) -> slice:
    """Slice of an ascending axis that lies within [low, high]."""
    return slice(int(np.searchsorted(axis, low)), int(np.searchsorted(axis, high, side="right")))


def terrace(heights: Array, step_m: float, berm_share: float) -> Array:
    """Turn slopes into benches `step_m` high, of which `berm_share` of the run is flat."""
    steps = heights / step_m
    whole = np.floor(steps)
    return np.asarray(step_m * (whole + np.maximum(steps - whole - berm_share, 0.0) / (1.0 - berm_share)))
