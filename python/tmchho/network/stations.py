"""What goes into a network: stations with what is known of them, and control points.

Frames: every station has one of its own. ``world_from_station`` takes its coordinates to those of the world.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from tmchho.arguments import checked_array, checked_choice, checked_number
from tmchho.errors import InvalidArgumentError
from tmchho.inputs import CloudLike
from tmchho.observations import as_tuples

StationKind = Literal["scan", "block"]


@dataclass(frozen=True, eq=False)
class Station:
    """One cloud of a network, with whatever is known of where it stands.

    Parameters
    ----------
    name : str
        How tables and messages call it; no two stations have the same.
    cloud : CloudLike
        Its points, in a frame of its own. A path is opened by the workers, arrays are laid down as files.
    kind : {'scan', 'block'}
        A scanner's station, or a block of photogrammetry.
    position : (3,) array_like, optional
        Where `place` lies in the world, if only roughly. It tells which stations can see each other; with
        `position_sigma_m` it is an observation as well.
    place : (3,) array_like
        The place in the station's frame whose position is given; its origin, where the scanner stands, where
        not given.
    position_sigma_m : float or (3,) array_like, optional
        Standard deviations of `position` along the axes of the world, above 0: that of a GNSS receiver, say.
    pose : (4, 4) array_like, optional
        ``world_from_station``, if only roughly; with both standard deviations it is an observation as well.
    pose_sigma_rad, pose_sigma_m : float, optional
        Standard deviations of the rotation about each axis, and of the position of the station's origin along
        each axis, above 0. Both or none.
    fixed : bool, default False
        Whether the station stands at `pose` and gives the network its frame.
    free_scale : bool, default False
        Whether its lengths have an unknown scale, as photogrammetry without control has.

    Raises
    ------
    InvalidArgumentError
        Naming the station and what is wrong.
    """

    name: str
    cloud: CloudLike
    kind: StationKind = "scan"
    position: ArrayLike | None = None
    place: ArrayLike = (0.0, 0.0, 0.0)
    position_sigma_m: ArrayLike | None = None
    pose: ArrayLike | None = None
    pose_sigma_rad: float | None = None
    pose_sigma_m: float | None = None
    fixed: bool = False
    free_scale: bool = False

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not self.name:
            raise InvalidArgumentError(f"a station's name must be text, got {self.name!r}")
        where = f"station '{self.name}'"
        checked_choice(f"{where}: kind", self.kind, get_args(StationKind))
        for key, shape in (("position", (3,)), ("place", (3,)), ("pose", (4, 4))):
            value = getattr(self, key)
            if value is not None:
                array = checked_array(f"{where}: {key}", value, shape)
                if not np.isfinite(array).all():
                    raise InvalidArgumentError(f"{where}: {key} must be finite")
                object.__setattr__(self, key, as_tuples(array))
        if self.position_sigma_m is not None:
            if self.position is None:
                raise InvalidArgumentError(f"{where}: position_sigma_m needs a position")
            given = self.position_sigma_m
            wanted: tuple[int, ...] = (3,) if isinstance(given, Sequence | np.ndarray) else ()
            sigma = np.broadcast_to(checked_array(f"{where}: position_sigma_m", given, wanted), (3,))
            if not (np.isfinite(sigma) & (sigma > 0)).all():
                raise InvalidArgumentError(f"{where}: position_sigma_m must be above 0")
            object.__setattr__(self, "position_sigma_m", as_tuples(sigma))
        if (self.pose_sigma_rad is None) != (self.pose_sigma_m is None):
            raise InvalidArgumentError(f"{where}: give pose_sigma_rad and pose_sigma_m together")
        if self.pose_sigma_m is not None:
            for key in ("pose_sigma_rad", "pose_sigma_m"):
                if checked_number(f"{where}: {key}", getattr(self, key)) <= 0:
                    raise InvalidArgumentError(f"{where}: {key} must be above 0")
        if self.pose is None and (self.fixed or self.pose_sigma_m is not None):
            raise InvalidArgumentError(f"{where}: it needs a pose to be fixed or observed at")
        if self.pose is not None:
            _check_rigid(where, np.asarray(self.pose))
        if self.fixed and self.free_scale:
            raise InvalidArgumentError(f"{where}: a fixed station cannot have a free scale")


@dataclass(frozen=True)
class StationControl:
    """A control point that one station sees.

    Parameters
    ----------
    station : str
        Name of the station.
    place : (3,) array_like
        Where the point lies in the station's frame.
    position : (3,) array_like
        Where it lies in the world.
    sigma_m : float
        Standard deviation of each coordinate of the difference, both measurements together, above 0.
    """

    station: str
    place: ArrayLike
    position: ArrayLike
    sigma_m: float

    def __post_init__(self) -> None:
        for key in ("place", "position"):
            array = checked_array(f"control point of '{self.station}': {key}", getattr(self, key), (3,))
            if not np.isfinite(array).all():
                raise InvalidArgumentError(f"control point of '{self.station}': {key} must be finite")
            object.__setattr__(self, key, as_tuples(array))
        if checked_number(f"control point of '{self.station}': sigma_m", self.sigma_m) <= 0:
            raise InvalidArgumentError(f"control point of '{self.station}': sigma_m must be above 0")


def checked_stations(
    clouds: Sequence[Any], control_points: Sequence[StationControl]
) -> tuple[tuple[Station, ...], tuple[StationControl, ...]]:
    """Return stations for what a caller gave, or say what is wrong with them.

    Parameters
    ----------
    clouds : sequence of Station or CloudLike
        A cloud that is no `Station` becomes one that nothing is known of, called by its file or its number.
    control_points : sequence of StationControl
        Each of a station of the network.

    Raises
    ------
    InvalidArgumentError
        If there are fewer than two, two share a name, or a control point is of an unknown station.
    """
    stations = tuple(
        cloud if isinstance(cloud, Station) else Station(_name(cloud, number), cloud)
        for number, cloud in enumerate(clouds, start=1)
    )
    if len(stations) < 2:
        raise InvalidArgumentError(f"a network needs at least two stations, got {len(stations)}")
    names = [station.name for station in stations]
    for name in names:
        if names.count(name) > 1:
            raise InvalidArgumentError(f"two stations are called '{name}'; give each a name of its own")
    for point in control_points:
        if not isinstance(point, StationControl):
            raise InvalidArgumentError(f"control_points must hold StationControl, got {type(point).__name__}")
        if point.station not in names:
            raise InvalidArgumentError(f"a control point is of '{point.station}', which is no station")
    if all(station.free_scale for station in stations):
        raise InvalidArgumentError("every station has a free scale; one of them must have a known one")
    return stations, tuple(control_points)


def _name(cloud: Any, number: int) -> str:
    from tmchho.cloud import PointCloud

    if isinstance(cloud, PointCloud):
        return cloud.name if cloud.name != "cloud" else f"station {number}"
    return str(cloud) if hasattr(cloud, "__fspath__") or isinstance(cloud, str) else f"station {number}"


def _check_rigid(where: str, pose: Any) -> None:
    turned = pose[:3, :3]
    rigid = np.abs(turned @ turned.T - np.eye(3)).max() < 1e-6 and np.linalg.det(turned) > 0
    if not rigid or not np.array_equal(pose[3], [0.0, 0.0, 0.0, 1.0]):
        raise InvalidArgumentError(f"{where}: pose must be a rotation and a shift over the row 0 0 0 1")
