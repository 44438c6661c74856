"""The part of a file that is asked for: a box, and how close together the points need to be."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tmchho.cloud import PointCloud
from tmchho.errors import InvalidArgumentError


@dataclass(frozen=True, eq=False)
class Window:
    """A box in the file's coordinates and a resolution in their unit.

    Parameters
    ----------
    lowest, highest : (3,) float64 arrays
        Opposite corners, which belong to the box; infinite where it is open.
    resolution : float, optional
        Distance between points that is close enough.
    """

    lowest: NDArray[np.float64]
    highest: NDArray[np.float64]
    resolution: float | None = None

    def holds(self, xyz: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return for each point whether it lies in the box; points that are not finite do not."""
        inside = np.asarray(np.isfinite(xyz).all(axis=1))
        for axis in range(3):
            inside &= (xyz[:, axis] >= self.lowest[axis]) & (xyz[:, axis] <= self.highest[axis])
        return inside

    def cut(self, cloud: PointCloud) -> PointCloud:
        """Return the points of a cloud that lie in the box, with their attributes."""
        inside = self.holds(cloud.xyz)
        if inside.all():
            return cloud
        attributes = {name: values[inside] for name, values in cloud.attributes.items()}
        return PointCloud(cloud.xyz[inside], attributes, cloud.crs, cloud.metadata, cloud.name)


def window_of(box: Any, resolution: float | None) -> Window | None:
    """Check the arguments of `tmchho.read` and return the window, None where all is asked for.

    Parameters
    ----------
    box : (2, 2) or (2, 3) array_like, optional
        Lowest and highest corner; of two numbers each, it is open upwards and downwards.
    resolution : float, optional
        Above 0.

    Raises
    ------
    InvalidArgumentError
        If the box is none or the resolution is not a length.
    """
    if resolution is not None and not 0 < resolution < math.inf:
        raise InvalidArgumentError(f"resolution is {resolution}; give a distance above 0")
    if box is None and resolution is None:
        return None
    corners = np.full((2, 3), [[-np.inf], [np.inf]])
    if box is not None:
        try:
            given = np.asarray(box, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise InvalidArgumentError(f"box holds something that is not a number ({error})") from error
        if given.shape not in ((2, 2), (2, 3)) or not (given[0] <= given[1]).all():
            raise InvalidArgumentError(
                f"box is {given.tolist()}; give the lowest and the highest corner, each of 2 or 3 numbers"
            )
        corners[:, : given.shape[1]] = given
    return Window(corners[0], corners[1], resolution)
