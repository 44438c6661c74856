"""What is known of a pose beside the clouds: a prior pose, and control points seen in both."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from tmchho.arguments import checked_array, checked_number
from tmchho.errors import InvalidArgumentError, ReadError

COLUMNS = ("source_x", "source_y", "source_z", "target_x", "target_y", "target_z", "sigma")


class _Tuples:
    """Keeps what a dataclass was given as tuples, so that it can be compared and nobody changes it."""

    def __post_init__(self) -> None:
        for field in fields(self):  # type: ignore[arg-type]
            object.__setattr__(self, field.name, as_tuples(getattr(self, field.name)))


@dataclass(frozen=True)
class PosePrior(_Tuples):
    """A pose that is known with some uncertainty, such as that of a GNSS receiver on a levelled tripod.

    Either the standard deviations or the covariance; what is None is not known. A scale is never prior
    knowledge: control points give it.

    Parameters
    ----------
    target_from_source : (4, 4) array_like
        Takes source to target coordinates, without a scale.
    rotation_rad : (3,) array_like, optional
        Standard deviations of the rotation about the axes of the target, in radians, above 0.
    translation_m : (3,) array_like, optional
        Standard deviations of the position of `about` along the axes of the target, above 0.
    covariance : (6, 6) array_like, optional
        Of rotation and position, in rad² and m², positive definite.
    about : (3,) array_like, optional
        The place in the source whose position is known; the middle of the source where not given.
    """

    target_from_source: ArrayLike
    rotation_rad: ArrayLike | None = None
    translation_m: ArrayLike | None = None
    covariance: ArrayLike | None = None
    about: ArrayLike | None = None


@dataclass(frozen=True)
class ControlPoint(_Tuples):
    """One place that was measured in both clouds.

    Parameters
    ----------
    source, target : (3,) array_like
        Its coordinates in either cloud.
    sigma_m : float
        Standard deviation of each coordinate of the difference, both measurements together, above 0.
    """

    source: ArrayLike
    target: ArrayLike
    sigma_m: float


_SHAPES: dict[str, tuple[int, ...]] = {
    "target_from_source": (4, 4),
    "rotation_rad": (3,),
    "translation_m": (3,),
    "covariance": (6, 6),
    "about": (3,),
}


@dataclass(frozen=True)
class Observations:
    """All that is known of a pose; each entry pulls as much as it is certain.

    Parameters
    ----------
    prior : PosePrior, optional
        A pose that is known roughly; in a file a section with the fields of `PosePrior`.
    control_points : sequence of ControlPoint, optional
        Places measured in both clouds, each with source, target and sigma_m. Three of them that are not on a
        line are a pose by themselves.

    Raises
    ------
    InvalidArgumentError
        Naming what is not an observation or has the wrong shape.
    """

    prior: PosePrior | None = None
    control_points: Sequence[ControlPoint] | None = None

    def __post_init__(self) -> None:
        """Check kinds and shapes; what cannot be weighed is refused by the core."""
        if self.prior is not None:
            if not isinstance(self.prior, PosePrior):
                raise InvalidArgumentError(f"prior must be a PosePrior, got {type(self.prior).__name__}")
            for name, shape in _SHAPES.items():
                if (value := getattr(self.prior, name)) is not None:
                    checked_array(f"prior.{name}", value, shape)
        if self.control_points is None:
            return
        if not isinstance(self.control_points, Sequence):
            raise InvalidArgumentError(
                f"control_points must be a sequence of ControlPoint, got {type(self.control_points).__name__}"
            )
        object.__setattr__(self, "control_points", tuple(self.control_points))
        for i, point in enumerate(self.control_points):
            name = f"control_points[{i}]"
            if not isinstance(point, ControlPoint):
                raise InvalidArgumentError(f"{name} must be a ControlPoint, got {type(point).__name__}")
            checked_array(f"{name}.source", point.source, (3,))
            checked_array(f"{name}.target", point.target, (3,))
            checked_number(f"{name}.sigma_m", point.sigma_m)

    @classmethod
    def from_dict(cls, settings: Mapping[str, Any]) -> Observations:
        """Read what the core has accepted as the section `known` of a configuration."""
        prior, points = settings.get("prior"), settings.get("control_points")
        return cls(
            None if prior is None else PosePrior(**prior),
            None if points is None else tuple(ControlPoint(**point) for point in points),
        )


def read_control_points(path: str | os.PathLike[str]) -> tuple[ControlPoint, ...]:
    """Read control points from a text file, one a line.

    Parameters
    ----------
    path : str or path
        Seven numbers a line, separated by commas, semicolons, tabs or blanks: x, y, z in the source, x, y, z
        in the target, and the standard deviation of their difference. A first line of words names the
        columns, which may then stand in any order and beside others: source_x, source_y, source_z, target_x,
        target_y, target_z, sigma. Lines that are empty or begin with # do not count.

    Returns
    -------
    tuple of ControlPoint

    Raises
    ------
    ReadError
        Naming the file, and the line where there is one.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise ReadError(
            f"{path}: cannot be read ({error.strerror}); check the name and the rights"
        ) from error
    except UnicodeDecodeError as error:
        raise ReadError(f"{path}: is not a text file; give seven numbers a line") from error
    rows = _rows(text)
    first = next(rows, None)
    if first is None:
        raise ReadError(f"{path}: holds no control points; give one a line: {', '.join(COLUMNS)}")
    places, header = list(range(len(COLUMNS))), first[1]
    if all(_number(cell) is None for cell in header):
        names = [cell.lower() for cell in header]
        missing = [column for column in COLUMNS if names.count(column) != 1]
        if missing:
            raise ReadError(
                f"{path}, line {first[0]}: has no one column called {', '.join(missing)}; give each of "
                f"{', '.join(COLUMNS)} once"
            )
        places, width = [names.index(column) for column in COLUMNS], len(names)
    else:
        rows, width = _rows(text), len(COLUMNS)
    points = tuple(_control_point(f"{path}, line {line}", cells, places, width) for line, cells in rows)
    if not points:
        raise ReadError(
            f"{path}: holds no control points, only the names of the columns; give one a line below"
        )
    return points


def _rows(text: str) -> Iterator[tuple[int, list[str]]]:
    """Give every line that counts with its number, cut where the first of them shows how."""
    separator = None
    for number, line in enumerate(text.splitlines(), start=1):
        line = line.strip()
        if not line or line.startswith("#"):
            continue
        if separator is None:
            separator = next((mark for mark in ";\t," if mark in line), r"\s+")
        yield number, [cell.strip(" \"'") for cell in re.split(separator, line)]


def _control_point(where: str, cells: list[str], places: list[int], width: int) -> ControlPoint:
    if len(cells) != width:
        raise ReadError(f"{where}: has {len(cells)} values where {width} are expected; correct the line")
    values = []
    for place, column in zip(places, COLUMNS, strict=True):
        value = _number(cells[place])
        if value is None or not math.isfinite(value):
            raise ReadError(f"{where}: {column} must be a finite number, got {cells[place]!r}")
        values.append(value)
    if values[6] <= 0:
        raise ReadError(f"{where}: sigma must be above 0, got {values[6]:g}")
    return ControlPoint(values[:3], values[3:6], values[6])


def _number(cell: str) -> float | None:
    try:
        return float(cell)
    except ValueError:
        return None


def as_tuples(value: Any) -> Any:
    """Return arrays and lists as tuples of plain numbers, everything else as it is."""
    if isinstance(value, (np.ndarray, np.generic)):
        return as_tuples(value.tolist())
    if isinstance(value, (list, tuple)):
        return tuple(as_tuples(item) for item in value)
    return value
