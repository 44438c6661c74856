"""Clouds in whatever form a caller has them: a path, a `PointCloud`, an array."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tmchho.cloud import PointCloud, as_points
from tmchho.errors import InvalidCloudError
from tmchho.io import read

CloudLike: TypeAlias = str | os.PathLike[str] | PointCloud | ArrayLike
"""A path to a file, a `PointCloud`, or anything numpy can turn into (n, 3) real numbers."""


def open_cloud(cloud: CloudLike, role: str) -> PointCloud:
    """Return `cloud` as a `PointCloud`; files are read, arrays are called by their `role`.

    Raises
    ------
    ReadError
        If it is a path that cannot be read.
    InvalidCloudError
        If it is an array of another shape than (n, 3), or not of real numbers.
    """
    if isinstance(cloud, PointCloud):
        return cloud
    if isinstance(cloud, (str, os.PathLike)):
        return read(cloud)
    return PointCloud(as_points(cloud, role), name=role)


def open_points(cloud: CloudLike, role: str, *, finite: bool = False) -> NDArray[np.float64]:
    """Return the coordinates of `cloud`, (n, 3) float64 C-contiguous.

    Parameters
    ----------
    cloud : CloudLike
        See `open_cloud`.
    role : str
        Name of the argument.
    finite : bool, default False
        Refuse NaN and infinity: for results in which a dropped point could not be seen.

    Raises
    ------
    ReadError, InvalidCloudError
        As `open_cloud`, or if `finite` and a coordinate is not.
    """
    opened = open_cloud(cloud, role)
    if finite:
        wrong = np.flatnonzero(~np.isfinite(opened.xyz).all(axis=1))
        if len(wrong):
            raise InvalidCloudError(
                f"{opened.name}: {len(wrong)} points have a coordinate that is not finite, "
                f"the first in row {wrong[0]}; drop them first"
            )
    return opened.xyz


@contextmanager
def naming(source: PointCloud, target: PointCloud) -> Iterator[None]:
    """Put the name of the file in front of what Rust says of "the source cloud" or "the target cloud"."""
    try:
        yield
    except InvalidCloudError as error:
        for role, cloud in (("source", source), ("target", target)):
            if f"{role} cloud" in str(error) and cloud.name not in ("cloud", role):
                raise InvalidCloudError(f"{cloud.name}: {error}") from None
        raise
