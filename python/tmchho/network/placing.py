"""From links to poses: which links are believed, where the frame comes from, both adjustments.

The links that loops agree on are adjusted; a link that then still lies far from what all others say is left
out and the rest adjusted again; a link that was doubtful alone but says the same as the network is kept. From
there the fine adjustment goes on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tmchho.network.adjust import Unknowns, adjust, normalised_residual, standard_errors
from tmchho.network.descriptors import VOXEL_BY_UNIT
from tmchho.network.engine import Item
from tmchho.network.frame import Frame
from tmchho.network.growth import Growth, best_linked, ordered
from tmchho.network.links import Link
from tmchho.network.loops import TOLERANCE_VOXELS, Bodies, Checked, Loop, components, placed_by
from tmchho.network.poses import inverse
from tmchho.network.propose import Pair, overlapping_pairs
from tmchho.network.refine import Refined, refine

Array = NDArray[np.float64]

# Overlaps of at least this share of the smaller cloud take part in the fine adjustment.
FINE_OVERLAP = 0.03


@dataclass(frozen=True, eq=False)
class JudgedLink:
    """A link and what the network makes of it.

    Parameters
    ----------
    link : Link
        The pair alone.
    kept : bool
        Whether the network rests on it.
    why : str
        Why not; empty where kept.
    loop : Loop or None
        One that it keeps open.
    n_loops, n_open : int
        Loops through it, and those that stay open.
    residual : (float, float) or None
        Displacement and angle between the pair's pose and the network's.
    normalised : float or None
        The same by what its covariance lets expect.
    """

    link: Link
    kept: bool
    why: str
    loop: Loop | None
    n_loops: int
    n_open: int
    residual: tuple[float, float] | None
    normalised: float | None


@dataclass(frozen=True, eq=False)
class NetworkPlaces:
    """Where the stations of a network lie.

    Parameters
    ----------
    poses : dict of int to (4, 4) array
        ``world_from_local`` of those that were placed, in inner coordinates.
    frame : Frame
        What leads from there to coordinates as given.
    covariances : dict of int to array
        Of the small motion of each station that was not held.
    held : set of int
        Those that give the frame.
    reference : int or None
        The station that gives it for want of anything else.
    judged : tuple of JudgedLink
        Every pair with a pose.
    loops : tuple of Loop
        A cycle basis of the kept links, and the loops that those left out keep open.
    trip_links : tuple of Link
        What the numbers in `loops` mean.
    shares : dict of pair to dict
        See `Refined`.
    unit_weight_error : float
        Of the links.
    n_iterations : int
        Of the fine adjustment.
    converged : bool
        Whether it came to rest.
    """

    poses: dict[int, Array]
    frame: Frame
    covariances: dict[int, Array]
    held: set[int]
    reference: int | None
    judged: tuple[JudgedLink, ...]
    loops: tuple[Loop, ...]
    trip_links: tuple[Link, ...]
    shares: dict[Pair, Item]
    unit_weight_error: float
    n_iterations: int
    converged: bool

    def gauge_words(self, names: Sequence[str]) -> str:
        """Say what gives the network its frame."""
        return self.frame.words() if self.reference is None else f"the frame of '{names[self.reference]}'"


def place(growth: Growth, frame: Frame) -> NetworkPlaces:
    """Place the stations of a grown network.

    Parameters
    ----------
    growth : Growth
        With all pairs registered.
    frame : Frame
        What is known of the world.

    Returns
    -------
    NetworkPlaces
    """
    material, bodies = growth.material, growth.material.bodies
    accepted, checked = growth.checked()
    why = {number: _open_words(loop) for number, loop in checked.left_out.items()}
    kept = {number: accepted[number] for number in checked.kept}
    while True:
        believed = list(kept.values())
        start, held, reference = _started(believed, frame, material.free_scale, len(material))
        unknowns = Unknowns(sorted(start), held, set(material.free_scale))
        used = frame.within(list(start)) if reference is None else _nothing(frame)
        inside = [link for link in believed if link.source in start and link.target in start]
        found = adjust(start, inside, bodies.middles, unknowns, used.places, used.known_poses)
        worst = _farthest(kept, found.poses, bodies)
        if worst is None:
            break
        number, away = worst
        why[number] = f"its pose lies {away:.3g} from what all other links say together"
        del kept[number]
    believed_pairs = {ordered(link.source, link.target) for link in accepted}
    doubtful = [
        link
        for link in growth.links(("review", "rejected"))
        if ordered(link.source, link.target) not in believed_pairs
    ]
    confirmed = [link for link in doubtful if _says_the_same(link, found.poses, bodies)]
    if confirmed:
        found = adjust(
            found.poses, [*inside, *confirmed], bodies.middles, unknowns, used.places, used.known_poses
        )
    fine = _refined(growth, found.poses, [*inside, *confirmed], unknowns, used)
    errors = standard_errors(fine.normal, unknowns)
    factor = max(1.0, found.unit_weight_error**2) if np.isfinite(found.unit_weight_error) else 1.0

    judged = _judged(accepted, checked, why, fine.poses, bodies)
    confirmed_ids = {id(link) for link in confirmed}
    for link in doubtful:
        is_kept = id(link) in confirmed_ids
        reason = "" if is_kept else f"the pair alone is not accepted ({link.record['reasons'][0]})"
        residual, normalised = _residuals(link, fine.poses, bodies)
        # What says the same as a network that was placed without it has closed a loop.
        judged.append(JudgedLink(link, is_kept, reason, None, int(is_kept), 0, residual, normalised))
    for link in growth.links(("accepted", "review", "rejected"), of_two_places=True):
        said = [growth.two_places[k] for k in (link.source, link.target) if k in growth.two_places]
        judged.append(
            JudgedLink(link, False, f"a station of it fits twice: {said[0]}", None, 0, 0, None, None)
        )
    judged.sort(key=lambda one: ordered(one.link.source, one.link.target))
    return NetworkPlaces(
        fine.poses,
        frame,
        {station: covariance * factor for station, covariance in errors.items()},
        held,
        reference,
        tuple(judged),
        checked.loops,
        tuple(accepted),
        fine.shares,
        found.unit_weight_error,
        fine.n_iterations,
        fine.converged,
    )


def _started(
    links: Sequence[Link], frame: Frame, free_scale: frozenset[int], n_stations: int
) -> tuple[dict[int, Array], set[int], int | None]:
    """Return poses to begin with, who is held, and the station that gives the frame for want of others."""
    groups = components(links, n_stations)
    start: dict[int, Array] = {}
    for group in groups:
        known = frame.within(group)
        if known.is_enough:
            middle = best_linked(links, group, free_scale)
            poses = placed_by(links, range(len(links)), n_stations, middle, free_scale)
            start.update({**known.onto(poses), **known.fixed})
    if start:
        return start, set(frame.fixed), None
    reference = best_linked(links, groups[0], free_scale)
    start = placed_by(links, range(len(links)), n_stations, reference, free_scale)
    return start, {reference}, reference


def _nothing(frame: Frame) -> Frame:
    return Frame(frame.world_origin, frame.origins, {}, (), ())


def _refined(
    growth: Growth, poses: dict[int, Array], links: Sequence[Link], unknowns: Unknowns, used: Frame
) -> Refined:
    material, bodies = growth.material, growth.material.bodies
    linked = {ordered(link.source, link.target) for link in links}
    near = overlapping_pairs(
        poses,
        material.described,
        bodies.middles,
        material.reaches,
        VOXEL_BY_UNIT * material.unit,
        FINE_OVERLAP,
    )
    return refine(
        poses,
        sorted(linked | set(near)),
        material.described,
        bodies.middles,
        bodies.radii,
        bodies.voxel_size,
        FINE_OVERLAP,
        unknowns,
        growth.engine,
        used.places,
        used.known_poses,
        believed=lambda pair: pair in linked,
    )


def _residuals(
    link: Link, poses: dict[int, Array], bodies: Bodies
) -> tuple[tuple[float, float] | None, float | None]:
    if link.source not in poses or link.target not in poses:
        return None, None
    source, target = poses[link.source], poses[link.target]
    # The smaller cloud tells best how far the overlap is off, from whichever side the link was found.
    station = min((link.source, link.target), key=lambda k: float(bodies.radii[k]))
    if station == link.source:
        residual = bodies.disagreement(station, link.pose, inverse(target) @ source)
    else:
        residual = bodies.disagreement(station, inverse(link.pose), inverse(source) @ target)
    return residual, normalised_residual(link, source, target)


def _says_the_same(link: Link, poses: dict[int, Array], bodies: Bodies) -> bool:
    residual, _ = _residuals(link, poses, bodies)
    return residual is not None and residual[0] <= TOLERANCE_VOXELS * bodies.voxel_size


def _farthest(kept: dict[int, Link], poses: dict[int, Array], bodies: Bodies) -> tuple[int, float] | None:
    """Return the link that lies farthest from the network, and how far, if it is too far."""
    limit = 2.0 * TOLERANCE_VOXELS * bodies.voxel_size
    away = {number: _residuals(link, poses, bodies)[0] for number, link in kept.items()}
    beyond = [(residual[0], number) for number, residual in away.items() if residual and residual[0] > limit]
    return (max(beyond)[1], max(beyond)[0]) if beyond else None


def _judged(
    accepted: Sequence[Link], checked: Checked, why: dict[int, str], poses: dict[int, Array], bodies: Bodies
) -> list[JudgedLink]:
    judged = []
    for number, link in enumerate(accepted):
        residual, normalised = _residuals(link, poses, bodies)
        if residual is None and number not in why:
            why = {**why, number: "nothing that is kept ties its stations to the frame of the network"}
        judged.append(
            JudgedLink(
                link,
                number not in why,
                why.get(number, ""),
                checked.left_out.get(number),
                checked.n_loops[number],
                checked.n_open[number],
                residual,
                normalised,
            )
        )
    return judged


def _open_words(loop: Loop) -> str:
    return (
        f"the loop of {len(loop.links)} links through it misses by {loop.misclosure_m:.3g}"
        f" and {np.degrees(loop.misclosure_rad):.2g}°, where {loop.tolerance_m:.2g} is allowed"
    )
