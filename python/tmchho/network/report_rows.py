"""The rows of the tables of a network: what was found, under the names and in the frames of the user."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from tmchho.network.growth import Growth
from tmchho.network.placing import NetworkPlaces
from tmchho.network.poses import applied, scale_of
from tmchho.network.results import FineOverlap, LoopClosure, NetworkLink, PlacedStation
from tmchho.network.stations import Station


def station_rows(
    stations: Sequence[Station], found: NetworkPlaces, growth: Growth
) -> tuple[PlacedStation, ...]:
    """Return where each station stands."""
    rows, material = [], growth.material
    for number, station in enumerate(stations):
        kept = [one for one in found.judged if one.kept and number in (one.link.source, one.link.target)]
        unchecked = all(one.n_loops <= one.n_open for one in kept)
        is_contradicted = any(
            one.loop is not None and number in (one.link.source, one.link.target) for one in found.judged
        )
        was_compared = any(one.link.is_only_place for one in kept)
        pose = found.poses.get(number)
        if pose is None and number in growth.two_places:
            note = f"not placed: {growth.two_places[number]}"
        elif pose is None:
            note = "not placed: no accepted link ties it to the frame of the network"
        elif len(stations) > 2 and number not in found.held and unchecked:
            note = "no loop checks its links"
            if was_compared:
                note += "; of all its places in the block it was given the one that fits best"
            elif is_contradicted:
                note += ", which contradict each other: the one left out may be the right one"
        else:
            note = ""
        covariance = found.covariances.get(number)
        held = number in found.held
        sigma_rotation = sigma_position = None
        sigma_scale = sigma_point = None
        if pose is not None and (covariance is not None or held):
            block = np.zeros((7, 7))
            if covariance is not None:
                block[: len(covariance), : len(covariance)] = covariance
            sigmas = np.sqrt(np.maximum(np.diag(block), 0.0))
            sigma_rotation, sigma_position = sigmas[:3], sigmas[3:6]
            sigma_scale = float(sigmas[6]) if station.free_scale else None
            # Turn and scale move a point by its distance from the middle, here that of gyration.
            radius = float(material.bodies.radii[number]) * scale_of(pose)
            turning = 2.0 / 3.0 * float(sigma_rotation @ sigma_rotation) + float(sigmas[6]) ** 2
            sigma_point = math.sqrt(float(sigma_position @ sigma_position) + radius**2 * turning)
        rows.append(
            PlacedStation(
                station.name,
                station.kind,
                None if pose is None else found.frame.outer(number, pose),
                1.0 if pose is None else scale_of(pose) if station.free_scale else 1.0,
                sigma_position,
                sigma_rotation,
                sigma_scale,
                sigma_point,
                len(kept),
                held,
                note,
                None
                if pose is None
                else found.frame.world_origin + applied(pose, material.bodies.middles[number]),
            )
        )
    return tuple(rows)


def link_rows(names: Sequence[str], found: NetworkPlaces, growth: Growth) -> tuple[NetworkLink, ...]:
    """Return every pair that was registered: the kept ones first, the largest residual first."""
    origins = found.frame.origins
    rows = []
    for one in found.judged:
        link, record = one.link, one.link.record
        # From the local frames to those of the clouds as given.
        pose = link.pose.copy()
        pose[:3, 3] = applied(link.pose, -origins[link.source]) + origins[link.target]
        residual_m, residual_rad = one.residual or (None, None)
        rows.append(
            NetworkLink(
                names[link.source],
                names[link.target],
                pose,
                link.verdict,
                tuple(record["reasons"]),
                one.kept,
                one.why,
                record["overlap_of_source"],
                record["overlap_of_target"],
                _number(record["rms"]),
                _number(record["strength"]),
                link.ambiguity_ratio,
                one.n_loops,
                one.n_open,
                residual_m,
                residual_rad,
                one.normalised,
            )
        )
    for (a, b), result in sorted(growth.results.items()):
        if result["pose"] is None:
            nothing = math.nan
            reason = result["reasons"][0]
            rows.append(
                NetworkLink(
                    names[a],
                    names[b],
                    None,
                    "rejected",
                    tuple(result["reasons"]),
                    False,
                    f"the pair alone is not accepted ({reason})",
                    nothing,
                    nothing,
                    nothing,
                    nothing,
                    nothing,
                    0,
                    0,
                    None,
                    None,
                    None,
                )
            )
    rows.sort(key=lambda row: (not row.kept, row.verdict, -(row.residual_m or 0.0)))
    return tuple(rows)


def loop_rows(names: Sequence[str], found: NetworkPlaces) -> tuple[LoopClosure, ...]:
    """Return the loops that were looked at, the worst first."""
    left_out = {id(one.link) for one in found.judged if not one.kept}
    rows = [
        LoopClosure(
            tuple(names[station] for station in loop.stations),
            loop.misclosure_m,
            loop.misclosure_rad,
            loop.tolerance_m,
            loop.is_closed,
            not any(id(found.trip_links[number]) in left_out for number in loop.links),
        )
        for loop in found.loops
    ]
    return tuple(sorted(rows, key=lambda row: -row.misclosure_m / row.tolerance_m))


def overlap_rows(names: Sequence[str], found: NetworkPlaces) -> tuple[FineOverlap, ...]:
    """Return the pairs of the fine adjustment, the worst first."""
    rows = [
        FineOverlap(names[a], names[b], share["overlap"], share["rms"], share["n_pairs"])
        for (a, b), share in found.shares.items()
    ]
    return tuple(sorted(rows, key=lambda row: -row.rms))


def _number(value: float | None) -> float:
    return math.nan if value is None else value
