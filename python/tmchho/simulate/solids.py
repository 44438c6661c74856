"""Solids that stand on the ground: boxes, ellipsoids and cylinders with exact ray intersection."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from tmchho.simulate.ground import Array
from tmchho.simulate.materials import Material

Shape = Literal["box", "ellipsoid", "cylinder"]


@dataclass(frozen=True, eq=False)
class Solid:
    """One convex body.

    Parameters
    ----------
    shape : {"box", "ellipsoid", "cylinder"}
        The body in its own frame, where it fills the cube [-1, 1]³; a cylinder's axis is local z.
    centre : (3,) float64 array
        Place of the middle, in metres.
    axes : (3, 3) float64 array
        Rotation; the columns are the local axes in the site's frame.
    half_m : (3,) float64 array
        Half lengths along the local axes, in metres.
    material : Material
        What it is made of.
    """

    shape: Shape
    centre: Array
    axes: Array
    half_m: Array
    material: Material

    @property
    def radius_m(self) -> float:
        """Radius of a sphere around `centre` that holds the body."""
        if self.shape == "ellipsoid":
            return float(self.half_m.max())
        if self.shape == "cylinder":
            return float(np.hypot(self.half_m[:2].max(), self.half_m[2]))
        return float(np.linalg.norm(self.half_m))

    def to_unit(self, points: Array) -> Array:
        """Points of shape (n, 3) in the frame where the body fills [-1, 1]³."""
        return np.asarray((points - self.centre) @ self.axes / self.half_m)

    def first_hit(self, origins: Array, directions: Array) -> Array:
        """Distance from the origins to the body along unit directions; infinite where it is missed.

        Parameters
        ----------
        origins : (n, 3) or (3,) float64 array
            Starts of the rays, outside the body.
        directions : (n, 3) or (3,) float64 array
            Unit vectors.

        Returns
        -------
        (n,) float64 array
            In metres.
        """
        origin, direction = np.broadcast_arrays(
            self.to_unit(np.atleast_2d(origins)), np.atleast_2d(directions) @ self.axes / self.half_m
        )
        with np.errstate(divide="ignore", invalid="ignore"):
            if self.shape == "ellipsoid":
                enter, leave = _through_ball(origin, direction)
            elif self.shape == "cylinder":
                enter, leave = _through_ball(origin[:, :2], direction[:, :2])
                slab_enter, slab_leave = _through_slabs(origin[:, 2:], direction[:, 2:])
                enter, leave = np.maximum(enter, slab_enter), np.minimum(leave, slab_leave)
            else:
                enter, leave = _through_slabs(origin, direction)
            return np.where((enter <= leave) & (enter > 0.0), enter, np.inf)

    def contains(self, points: Array) -> NDArray[np.bool_]:
        """Tell which points of shape (n, 3) lie inside the body."""
        unit = np.abs(self.to_unit(points))
        if self.shape == "ellipsoid":
            return np.asarray(np.einsum("ij,ij->i", unit, unit) < 1.0)
        if self.shape == "cylinder":
            return np.asarray((np.hypot(unit[:, 0], unit[:, 1]) < 1.0) & (unit[:, 2] < 1.0))
        return np.asarray((unit < 1.0).all(axis=1))

    def normals(self, points: Array) -> Array:
        """Outward unit normals at points on the surface, shape (n, 3)."""
        unit = self.to_unit(points)
        if self.shape == "ellipsoid":
            local = unit / self.half_m
        else:
            size = np.abs(unit)
            if self.shape == "cylinder":
                size[:, 0] = size[:, 1] = np.hypot(unit[:, 0], unit[:, 1])
            face = np.argmax(size, axis=1)
            local = np.zeros_like(unit)
            rows = np.arange(len(unit))
            local[rows, face] = np.sign(unit[rows, face])
            if self.shape == "cylinder":
                side = face < 2
                local[side] = unit[side] / self.half_m
                local[side, 2] = 0.0
        world = local @ self.axes.T
        return np.asarray(world / np.linalg.norm(world, axis=1, keepdims=True))

    def side_points(self, spacing_m: float, rng: np.random.Generator) -> Array:
        """Points spread evenly over the side faces of a box or cylinder (local x and y), shape (n, 3).

        One point in each cell of about `spacing_m` squared, at a random place within the cell.
        """
        a, b, c = self.half_m
        if self.shape == "ellipsoid":
            return np.empty((0, 3))
        if self.shape == "cylinder":
            turn, up = _jittered(np.pi * (a + b), 2.0 * c, spacing_m, rng)
            unit = np.stack([np.cos(np.pi * turn), np.sin(np.pi * turn), up], axis=1)
        else:
            faces = []
            for axis, width in ((0, 2.0 * b), (1, 2.0 * a)):
                for sign in (-1.0, 1.0):
                    across, up = _jittered(width, 2.0 * c, spacing_m, rng)
                    ends = np.full_like(up, sign)
                    faces.append(np.stack([ends, across, up] if axis == 0 else [across, ends, up], axis=1))
            unit = np.concatenate(faces)
        return np.asarray(unit * self.half_m @ self.axes.T + self.centre)


def _through_ball(origin: Array, direction: Array) -> tuple[Array, Array]:
    """Ray parameters where lines enter and leave the unit ball (or circle); NaN where they miss."""
    a = np.einsum("ij,ij->i", direction, direction)
    b = np.einsum("ij,ij->i", origin, direction)
    c = np.einsum("ij,ij->i", origin, origin) - 1.0
    # A line along a cylinder's axis (a = 0) is inside everywhere or nowhere.
    inside = np.where(c <= 0.0, -np.inf, np.nan)
    root = np.sqrt(b * b - a * c)
    enter = np.where(a > 0.0, (-b - root) / a, inside)
    leave = np.where(a > 0.0, (-b + root) / a, -inside)
    return enter, leave


def _through_slabs(origin: Array, direction: Array) -> tuple[Array, Array]:
    """Ray parameters where lines enter and leave the cube (or slab) [-1, 1]."""
    low = (-1.0 - origin) / direction
    high = (1.0 - origin) / direction
    return np.minimum(low, high).max(axis=1), np.maximum(low, high).min(axis=1)


def _jittered(
    width_m: float, height_m: float, spacing_m: float, rng: np.random.Generator
) -> tuple[Array, Array]:
    """One random place in each cell of a rectangle, in [-1, 1] along both sides.

    The number of cells is rounded at random, so that small faces have the right density on average.
    """
    n_across = int(width_m / spacing_m + rng.random())
    n_up = int(height_m / spacing_m + rng.random())
    column, row = (index.ravel() for index in np.meshgrid(np.arange(n_across), np.arange(n_up)))
    across = 2.0 * (column + rng.random(len(column))) / max(n_across, 1) - 1.0
    up = 2.0 * (row + rng.random(len(row))) / max(n_up, 1) - 1.0
    return np.asarray(across), np.asarray(up)


def turned(yaw_rad: float, pitch_rad: float = 0.0, roll_rad: float = 0.0) -> Array:
    """Rotation that leans local y up by the roll, then x up by the pitch, then turns left by the yaw."""
    cos, sin = np.cos(roll_rad), np.sin(roll_rad)
    roll = np.array([[1.0, 0.0, 0.0], [0.0, cos, -sin], [0.0, sin, cos]])
    cos, sin = np.cos(pitch_rad), np.sin(pitch_rad)
    pitch = np.array([[cos, 0.0, -sin], [0.0, 1.0, 0.0], [sin, 0.0, cos]])
    cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
    yaw = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(yaw @ pitch @ roll)


def random_rotation(rng: np.random.Generator) -> Array:
    """Rotation drawn evenly from all rotations, as a 3 x 3 matrix.

    A quaternion of four normal numbers has an even direction on the sphere of unit quaternions
    (Shoemake 1992, "Uniform random rotations").
    """
    w, x, y, z = rng.standard_normal(4)
    norm = w * w + x * x + y * y + z * z
    rotation = np.array(
        [
            [-(y * y + z * z), x * y - w * z, x * z + w * y],
            [x * y + w * z, -(x * x + z * z), y * z - w * x],
            [x * z - w * y, y * z + w * x, -(x * x + y * y)],
        ]
    )
    return np.asarray(np.eye(3) + (2.0 / norm) * rotation)
