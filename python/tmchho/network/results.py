"""What the registration of a network leaves: plain frozen data, for people and for JSON."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from tmchho.results import ReadOnlyArrays, Verdict, plain


@dataclass(frozen=True, eq=False)
class PlacedStation(ReadOnlyArrays):
    """Where a station stands.

    Parameters
    ----------
    name : str
        As given.
    kind : {'scan', 'block'}
        As given.
    world_from_station : (4, 4) float64 array or None
        Takes its coordinates to those of the world, scale included; None where nothing kept ties it to the
        frame of the network.
    scale : float
        Length in the world of what is one unit long in its cloud; 1 unless its scale was free.
    sigma_position_m : (3,) float64 array or None
        Standard errors of the middle of its cloud along the axes of the world; zeros where it is held.
    sigma_rotation_rad : (3,) float64 array or None
        Standard errors of the rotation about these axes.
    sigma_scale : float or None
        Standard error of the scale, relative to it; None unless free.
    sigma_point_m : float or None
        The 1σ displacement of a point of its cloud by the errors of the pose, in all directions together.
    n_links : int
        Links that were kept.
    fixed : bool
        Whether it was held as given, or gives the frame where nothing else does.
    note : str
        What a person should know of it; empty where nothing.
    middle_m : (3,) float64 array or None
        The middle of its cloud in the world, which the standard errors are of.
    """

    name: str
    kind: str
    world_from_station: NDArray[np.float64] | None
    scale: float
    sigma_position_m: NDArray[np.float64] | None
    sigma_rotation_rad: NDArray[np.float64] | None
    sigma_scale: float | None
    sigma_point_m: float | None
    n_links: int
    fixed: bool
    note: str
    middle_m: NDArray[np.float64] | None


@dataclass(frozen=True, eq=False)
class NetworkLink(ReadOnlyArrays):
    """Two stations that were registered with each other.

    Parameters
    ----------
    source, target : str
        Names of the stations.
    target_from_source : (4, 4) float64 array or None
        The pose found for the pair alone; None where the search ended without any.
    verdict : {'accepted', 'review', 'rejected'}
        Of the pair alone.
    reasons : tuple of str
        Why, the weightiest first.
    kept : bool
        Whether the network rests on it.
    left_out_because : str
        One sentence; empty where kept.
    overlap_of_source, overlap_of_target, rms, strength, ambiguity_ratio : float
        See `Registration`.
    n_loops, n_open_loops : int
        Loops through it that were looked at, and those of them that do not close.
    residual_m : float or None
        How far its pose lies from that of the network: displacement of a point, root mean square over the
        smaller cloud. None where a station of it was not placed.
    residual_rad : float or None
        The same as an angle.
    normalised_residual : float or None
        By what its own covariance lets expect: about 1 where all is well.
    """

    source: str
    target: str
    target_from_source: NDArray[np.float64] | None
    verdict: Verdict
    reasons: tuple[str, ...]
    kept: bool
    left_out_because: str
    overlap_of_source: float
    overlap_of_target: float
    rms: float
    strength: float
    ambiguity_ratio: float
    n_loops: int
    n_open_loops: int
    residual_m: float | None
    residual_rad: float | None
    normalised_residual: float | None


@dataclass(frozen=True)
class LoopClosure:
    """A round trip over links, which should end where it began.

    Parameters
    ----------
    stations : tuple of str
        In order; the last is linked with the first.
    misclosure_m : float
        Displacement of a point of the first station's cloud after the round trip, root mean square.
    misclosure_rad : float
        The same as an angle.
    tolerance_m : float
        What is allowed for so many links.
    closed : bool
        Whether the misclosure keeps to it.
    kept : bool
        Whether all of its links were kept.
    """

    stations: tuple[str, ...]
    misclosure_m: float
    misclosure_rad: float
    tolerance_m: float
    closed: bool
    kept: bool


@dataclass(frozen=True)
class FineOverlap:
    """Two clouds that took part in the fine adjustment together.

    Parameters
    ----------
    first, second : str
        Names of the stations.
    overlap : float
        Share of the voxels of the smaller cloud with a partner.
    rms : float
        Root mean square of the distances across planes.
    n_pairs : int
        Partners that counted.
    """

    first: str
    second: str
    overlap: float
    rms: float
    n_pairs: int


@dataclass(frozen=True, eq=False)
class NetworkRegistration(ReadOnlyArrays):
    """The stations of a network in one frame, and everything that tells how far to trust it.

    Parameters
    ----------
    stations : tuple of PlacedStation
        In the order given.
    links : tuple of NetworkLink
        All pairs that were registered, those left out included.
    loops : tuple of LoopClosure
        The loops of a cycle basis of the links kept, and every short loop that does not close.
    overlaps : tuple of FineOverlap
        The pairs of the fine adjustment.
    gauge : str
        What gives the network its frame, in words.
    unit_weight_error : float
        Root of what the weighted residuals of the links amount to by what their covariances let expect. The
        standard errors contain it where it is above 1. NaN where no link is redundant.
    voxel_size : float
        Edge of the voxels of the fine adjustment.
    n_pairs_possible, n_pairs_screened, n_pairs_registered : int
        Pairs of stations there are, those that were looked at briefly, and those that were registered.
    n_iterations : int
        Of the fine adjustment.
    converged : bool
        Whether it came to rest.
    seed : int
        Seed of all random numbers.
    settings : dict
        All settings.
    version : str
        Version of this package.
    """

    stations: tuple[PlacedStation, ...]
    links: tuple[NetworkLink, ...]
    loops: tuple[LoopClosure, ...]
    overlaps: tuple[FineOverlap, ...]
    gauge: str
    unit_weight_error: float
    voxel_size: float
    n_pairs_possible: int
    n_pairs_screened: int
    n_pairs_registered: int
    n_iterations: int
    converged: bool
    seed: int
    settings: dict[str, Any]
    version: str

    @property
    def verdict(self) -> Literal["accepted", "review", "rejected"]:
        """One word for the network: all stations sure, those named not, or fewer than half of them placed."""
        n_placed = sum(station.world_from_station is not None for station in self.stations)
        if 2 * n_placed < len(self.stations):
            return "rejected"
        return "review" if any(station.note for station in self.stations) else "accepted"

    def pose(self, name: str) -> NDArray[np.float64] | None:
        """Return ``world_from_station`` of a station, None where it was not placed.

        Raises
        ------
        KeyError
            If no station has that name.
        """
        return {station.name: station.world_from_station for station in self.stations}[name]

    def to_dict(self) -> dict[str, Any]:
        """Return everything as what JSON knows; the same input and seed give the same values."""
        values: dict[str, Any] = plain(self)
        return {"verdict": self.verdict, **values}

    def summary(self) -> str:
        """Return the result in a few lines for people."""
        placed = sum(station.world_from_station is not None for station in self.stations)
        kept = sum(link.kept for link in self.links)
        lines = [
            f"{self.verdict}: {placed} of {len(self.stations)} stations placed, frame from {self.gauge}",
            f"links      {kept} kept, {len(self.links) - kept} left out; of {self.n_pairs_possible} pairs"
            f" {self.n_pairs_screened} were looked at and {self.n_pairs_registered} registered",
        ]
        lines += [
            f"left out   {link.source} – {link.target}: {link.left_out_because}"
            for link in self.links
            if not link.kept and link.verdict == "accepted"
        ]
        lines += [f"station    {station.name}: {station.note}" for station in self.stations if station.note]
        return "\n".join(lines)
