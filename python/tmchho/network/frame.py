"""What gives a network its frame: stations that stand still, observations, or, for want of both, a station.

Inside, the world is counted from an origin near the network, and every station from one inside its cloud, so
that national-grid coordinates cost no digits.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tmchho.network.adjust import PlaceObservation, PoseObservation
from tmchho.network.poses import applied, inverse
from tmchho.network.propose import fitted_pose
from tmchho.network.stations import Station, StationControl

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Frame:
    """What is known of the world, in inner coordinates.

    Parameters
    ----------
    world_origin : (3,) float64 array
        What coordinates of the world have more than inner ones.
    origins : (n, 3) float64 array
        What given coordinates of each station have more than local ones.
    fixed : dict of int to (4, 4) array
        Stations that stand still, and where.
    places : tuple of PlaceObservation
        Measured positions and control points.
    known_poses : tuple of PoseObservation
        Measured poses.
    """

    world_origin: Array
    origins: Array
    fixed: dict[int, Array]
    places: tuple[PlaceObservation, ...]
    known_poses: tuple[PoseObservation, ...]

    def inner(self, station: int, world_from_station: Array) -> Array:
        """Return ``world_from_local`` in inner coordinates for a pose as given."""
        return _shift(-self.world_origin) @ world_from_station @ _shift(self.origins[station])

    def outer(self, station: int, world_from_local: Array) -> Array:
        """Return ``world_from_station`` as given for a pose in inner coordinates."""
        return _shift(self.world_origin) @ world_from_local @ _shift(-self.origins[station])

    def within(self, group: Sequence[int]) -> Frame:
        """Return what concerns some of the stations."""
        return Frame(
            self.world_origin,
            self.origins,
            {station: pose for station, pose in self.fixed.items() if station in group},
            tuple(o for o in self.places if o.station in group),
            tuple(o for o in self.known_poses if o.station in group),
        )

    @property
    def is_enough(self) -> bool:
        """Whether this says where a group of linked stations lies: a pose, or three places not in line."""
        if self.fixed or self.known_poses:
            return True
        positions = np.array([o.position for o in self.places]).reshape(-1, 3)
        if len(positions) < 3:
            return False
        spread = np.linalg.svd(positions - positions.mean(axis=0), compute_uv=False)
        return bool(spread[1] > 1e-3 * spread[0])

    def onto(self, poses: dict[int, Array]) -> dict[int, Array]:
        """Return poses of one group, in any frame, moved as a whole to where the world has them."""
        if self.fixed:
            station = min(self.fixed)
            whole = self.fixed[station] @ inverse(poses[station])
        elif self.known_poses:
            first = self.known_poses[0]
            whole = first.pose @ inverse(poses[first.station])
        else:
            here = np.array([applied(poses[o.station], o.place) for o in self.places])
            whole = fitted_pose(here, np.array([o.position for o in self.places]))
        return {station: whole @ pose for station, pose in poses.items()}

    def words(self) -> str:
        """Say what gives the frame."""
        parts = []
        for number, what in (
            (len(self.fixed), "fixed station"),
            (len(self.known_poses), "observed pose"),
            (len(self.places), "observed position"),
        ):
            if number:
                parts.append(f"{number} {what}{'s' if number > 1 else ''}")
        return " and ".join(parts)


def frame_of(stations: Sequence[Station], control_points: Sequence[StationControl], origins: Array) -> Frame:
    """Gather what is known of the world.

    Parameters
    ----------
    stations : sequence of Station
        All of the network.
    control_points : sequence of StationControl
        All of the network.
    origins : (n, 3) float64 array
        Of the local frames.
    """
    known: list[Any] = [point.position for point in control_points]
    known += [s.position for s in stations if s.position is not None]
    known += [np.array(s.pose)[:3, 3] for s in stations if s.pose is not None]
    middle = np.array(known).reshape(-1, 3).mean(axis=0) if known else np.zeros(3)
    world_origin: Array = np.asarray(np.round(middle))
    bare = Frame(world_origin, origins, {}, (), ())
    fixed: dict[int, Array] = {}
    places, known_poses = [], []
    for number, station in enumerate(stations):
        if station.pose is not None:
            inner = bare.inner(number, np.array(station.pose))
            if station.fixed:
                fixed[number] = inner
            elif station.pose_sigma_m is not None and station.pose_sigma_rad is not None:
                known_poses.append(
                    PoseObservation(
                        number, inner, -origins[number], station.pose_sigma_rad, station.pose_sigma_m
                    )
                )
        if station.position_sigma_m is not None:
            places.append(
                PlaceObservation(
                    number,
                    np.array(station.place) - origins[number],
                    np.array(station.position) - world_origin,
                    np.array(station.position_sigma_m),
                )
            )
    numbers = {station.name: number for number, station in enumerate(stations)}
    for point in control_points:
        number = numbers[point.station]
        places.append(
            PlaceObservation(
                number,
                np.array(point.place) - origins[number],
                np.array(point.position) - world_origin,
                np.full(3, point.sigma_m),
            )
        )
    return Frame(world_origin, origins, fixed, tuple(places), tuple(known_poses))


def rough_centres(
    stations: Sequence[Station], frame: Frame, middles: Array, reaches: Array
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Return where the middles of clouds lie if that is known, how far they reach, and of which it is known.

    A position without a heading says only on which sphere the middle lies: the reach grows by its radius.
    """
    n = len(stations)
    centres, wide, known = np.zeros((n, 3)), reaches.copy(), np.zeros(n, dtype=bool)
    for number, station in enumerate(stations):
        if station.pose is not None:
            centres[number] = applied(frame.inner(number, np.array(station.pose)), middles[number])
            known[number] = True
        elif station.position is not None:
            centres[number] = np.array(station.position) - frame.world_origin
            away = np.array(station.place) - frame.origins[number] - middles[number]
            wide[number] += float(np.linalg.norm(away))
            known[number] = True
    return centres, wide, known


def _shift(by: Array) -> Array:
    pose = np.eye(4)
    pose[:3, 3] = by
    return pose
