"""Which links can be believed: round trips over links have to end where they began.

Why: two equal piers are registered with each other perfectly, and nothing in the pair tells that they are
two. The loops tell. A spanning tree of the links that most short loops confirm places the stations; every
other link closes a loop of the tree. While loops stay open, the link that most open and fewest closed ones
have in common is left out, the least certain of equals, and the tree is grown again. A link for which every
other place was compared is believed before all others: who looks like a pier agrees with all its neighbours.

Sources: the idea of checking cycles is Zach, Klopschitz & Pollefeys (2010), "Disambiguating visual relations
using loop constraints"; the search is our own, without random numbers.
Absent on purpose: least squares, which would spread a wrong link over all stations.
"""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tmchho.network.links import Link
from tmchho.network.poses import applied, displacement, inverse, motion_between, rigid, scale_of

Array = NDArray[np.float64]

# A closed loop of one link misses by less than this; of k links by √k times as much.
TOLERANCE_VOXELS = 1.0
# An ambiguity ratio above this says no more than this.
MAX_RATIO = 10.0
Path = tuple[int, ...]


@dataclass(frozen=True)
class Loop:
    """A round trip.

    Parameters
    ----------
    links : tuple of int
        Numbers of its links, in order.
    stations : tuple of int
        Where each of them begins.
    misclosure_m, misclosure_rad : float
        Displacement of the first station's points after the trip, root mean square; and as an angle.
    tolerance_m : float
        What is allowed.
    """

    links: Path
    stations: Path
    misclosure_m: float
    misclosure_rad: float
    tolerance_m: float

    @property
    def is_closed(self) -> bool:
        """Whether it ends where it began."""
        return self.misclosure_m <= self.tolerance_m


@dataclass(frozen=True)
class Checked:
    """What the loops say.

    Parameters
    ----------
    kept : tuple of int
        Numbers of the links that agree with each other.
    left_out : dict of int to Loop
        The others, each with a loop that it keeps open.
    n_loops, n_open : tuple of int
        For each link, in how many loops it was, and how many of those stayed open. Loops over a link that
        was left out count for that link alone.
    loops : tuple of Loop
        Those of a cycle basis of the kept links, and those of the links left out.
    """

    kept: Path
    left_out: dict[int, Loop]
    n_loops: Path
    n_open: Path
    loops: tuple[Loop, ...]

    def contradicted(self, links: Sequence[Link]) -> set[int]:
        """Return the stations of which a link was left out and none is in a loop that closes."""
        ends = {number: {link.source, link.target} for number, link in enumerate(links)}
        found = {station for number in self.left_out for station in ends[number]}
        for number in self.kept:
            if self.n_loops[number] > self.n_open[number]:
                found -= ends[number]
        return found


class Bodies:
    """Middles and radii of the clouds, local, and the voxel: what a misclosure is measured by."""

    def __init__(self, middles: Array, radii: Array, voxel_size: float) -> None:
        self.middles, self.radii, self.voxel_size = middles, radii, voxel_size

    def disagreement(self, station: int, found: Array, wanted: Array) -> tuple[float, float]:
        """Return how far two poses of a station differ: displacement in the frame they lead to, and angle."""
        middle = applied(wanted, self.middles[station])
        motion = motion_between(found, wanted, middle)
        radius = float(self.radii[station]) * scale_of(wanted)
        return displacement(motion, np.zeros(3), radius), float(np.linalg.norm(motion[:3]))

    def loop(self, links: Sequence[Link], trip: Sequence[tuple[int, bool]]) -> Loop:
        """Walk a round trip of (link, whether against its direction)."""
        pose = np.eye(4)
        stations = []
        for number, backwards in trip:
            link = links[number]
            stations.append(link.target if backwards else link.source)
            pose = (inverse(link.pose) if backwards else link.pose) @ pose
        shift, angle = self.disagreement(stations[0], pose, np.eye(4))
        tolerance = TOLERANCE_VOXELS * self.voxel_size * float(np.sqrt(len(trip)))
        return Loop(tuple(number for number, _ in trip), tuple(stations), shift, angle, tolerance)


def check_loops(links: Sequence[Link], n_stations: int, bodies: Bodies) -> Checked:
    """Find the links that agree with each other, and for each of the others a loop that it keeps open.

    Parameters
    ----------
    links : sequence of Link
        Those to be believed unless a loop speaks against them.
    n_stations : int
        Stations are numbered from 0.
    bodies : Bodies
        What misclosures are measured by.

    Returns
    -------
    Checked
    """
    triangles = _triangles(links, bodies)
    support = [0] * len(links)
    for loop in triangles:
        for number in loop.links:
            support[number] += 1 if loop.is_closed else -1
    certainty = [
        (link.is_only_place, support[number], min(link.ambiguity_ratio, MAX_RATIO) * link.overlap, -number)
        for number, link in enumerate(links)
    ]
    remaining = list(range(len(links)))
    left_out: dict[int, Loop] = {}
    while True:
        tree = spanning_forest([links[k] for k in remaining], [certainty[k] for k in remaining], n_stations)
        in_tree = {remaining[k] for k in tree}
        ways = _ways_up(links, in_tree, n_stations)
        closing = [
            bodies.loop(links, _trip(links, ways, number)) for number in remaining if number not in in_tree
        ]
        if all(loop.is_closed for loop in closing):
            break
        blame = dict.fromkeys(remaining, 0)
        proof: dict[int, Loop] = {}
        for loop in closing:
            for number in loop.links:
                blame[number] += -1 if loop.is_closed else 1
                if not loop.is_closed:
                    best = proof.get(number)
                    if best is None or len(loop.links) < len(best.links):
                        proof[number] = loop
        worst = max(
            proof, key=lambda k: (not links[k].is_only_place, blame[k], [-part for part in certainty[k]])
        )
        left_out[worst] = proof[worst]
        remaining.remove(worst)
    loops = (*closing, *left_out.values())
    n_loops, n_open = [0] * len(links), [0] * len(links)
    for loop in {frozenset(loop.links): loop for loop in (*loops, *triangles)}.values():
        wrong = left_out.keys() & set(loop.links)
        # A loop that a link left out keeps open says nothing against the others.
        for number in wrong or loop.links:
            n_loops[number] += 1
            n_open[number] += not loop.is_closed
    return Checked(tuple(remaining), left_out, tuple(n_loops), tuple(n_open), loops)


def confirming_links(
    links: Sequence[Link], checked: Checked, doubtful: Sequence[Link], n_stations: int, bodies: Bodies
) -> list[Link]:
    """Find links that are doubtful alone but agree with each other, where no loop has spoken yet.

    Parameters
    ----------
    links : sequence of Link
        Those that `checked` is about.
    checked : Checked
        What their loops say.
    doubtful : sequence of Link
        Each of a pair of its own.
    n_stations, bodies
        See `check_loops`.

    Returns
    -------
    list of Link
        As `agreeing_links` finds them between groups that nothing ties together yet, and between the two
        groups that hang together by one link alone: they close loops with it, or tell that it is wrong.
    """
    kept = [links[number] for number in checked.kept]
    found = agreeing_links(kept, doubtful, n_stations, bodies)
    for number in checked.kept:
        if not checked.n_loops[number]:
            rest = [link for link in kept if link is not links[number]]
            found += [
                link for link in agreeing_links(rest, doubtful, n_stations, bodies) if link not in found
            ]
    return found


def agreeing_links(
    kept: Sequence[Link], doubtful: Sequence[Link], n_stations: int, bodies: Bodies
) -> list[Link]:
    """Find links that are doubtful alone but say the same as another one, so that they close a loop.

    Parameters
    ----------
    kept : sequence of Link
        Those that are believed.
    doubtful : sequence of Link
        Each of a pair of its own.
    n_stations : int
        Stations are numbered from 0.
    bodies : Bodies
        What misclosures are measured by.

    Returns
    -------
    list of Link
        Those of `doubtful` of which at least two, between the same two groups of linked stations, place the
        one group alike with regard to the other. A single one proves nothing, however good it looks.
    """
    found: list[Link] = []
    while True:
        believed = [*kept, *found]
        group_of: dict[int, int] = {}
        poses: dict[int, Array] = {}
        for number, group in enumerate(components(believed, n_stations)):
            poses.update(placed_by(believed, range(len(believed)), n_stations, group[0]))
            group_of.update(dict.fromkeys(group, number))
        between: dict[tuple[int, int], list[Link]] = {}
        for link in doubtful:
            ends = sorted((group_of[link.source], group_of[link.target]))
            if ends[0] != ends[1]:
                between.setdefault((ends[0], ends[1]), []).append(link)
        clusters = [
            [other for other in links if other is one or _says_the_same(one, other, group_of, poses, bodies)]
            for links in between.values()
            for one in links
        ]
        largest = max(clusters, key=len, default=[])
        if len(largest) < 2:
            return found
        found += largest


def _says_the_same(
    one: Link, other: Link, group_of: dict[int, int], poses: dict[int, Array], bodies: Bodies
) -> bool:
    """Tell whether two links between the same two groups close the loop that they make with the groups."""
    whole = _between(other, poses)
    if group_of[other.source] != group_of[one.source]:
        whole = inverse(whole)
    wanted = inverse(poses[one.target]) @ whole @ poses[one.source]
    away, _ = bodies.disagreement(one.source, one.pose, wanted)
    return away <= TOLERANCE_VOXELS * bodies.voxel_size * 2.0


def _between(link: Link, poses: dict[int, Array]) -> Array:
    """Return the pose that takes the frame of the source's group to that of the target's."""
    return np.asarray(poses[link.target] @ link.pose @ inverse(poses[link.source]))


def spanning_forest(
    links: Sequence[Link], certainty: Sequence[tuple[float, ...]], n_stations: int
) -> list[int]:
    """Return the links of a spanning forest, the most certain first (Kruskal 1956)."""
    root = list(range(n_stations))

    def find(station: int) -> int:
        while root[station] != station:
            root[station] = root[root[station]]
            station = root[station]
        return station

    chosen = []
    for number in sorted(range(len(links)), key=lambda k: certainty[k], reverse=True):
        a, b = find(links[number].source), find(links[number].target)
        if a != b:
            root[a] = b
            chosen.append(number)
    return chosen


def components(links: Sequence[Link], n_stations: int) -> list[list[int]]:
    """Return the groups of stations that links tie together, the largest first."""
    neighbours = _neighbours(links, range(len(links)), n_stations)
    seen: set[int] = set()
    groups = []
    for start in range(n_stations):
        if start in seen:
            continue
        group, waiting = [], [start]
        seen.add(start)
        while waiting:
            station = waiting.pop()
            group.append(station)
            for other, _, _ in neighbours[station]:
                if other not in seen:
                    seen.add(other)
                    waiting.append(other)
        groups.append(sorted(group))
    return sorted(groups, key=lambda group: (-len(group), group[0]))


def placed_by(
    links: Sequence[Link],
    numbers: Sequence[int],
    n_stations: int,
    start: int,
    free_scale: frozenset[int] | None = None,
) -> dict[int, Array]:
    """Return the poses of all stations that links lead to from a start, in the start's local frame.

    The fewest links are taken, so that errors add up least. Where it is said whose scale is free, and the
    start's is not, no other pose has a scale: on the way over a block its error would come to the next.
    """
    has_scale = set(range(n_stations)) if free_scale is None or start in free_scale else free_scale
    neighbours = _neighbours(links, numbers, n_stations)
    poses = {start: np.eye(4)}
    waiting = [(0, start)]
    while waiting:
        depth, station = heapq.heappop(waiting)
        for other, number, backwards in neighbours[station]:
            if other not in poses:
                link = links[number]
                # The link leads from this station to the other one; poses lead to the start.
                step = inverse(link.pose) if not backwards else link.pose
                pose = poses[station] @ step
                poses[other] = pose if other in has_scale else rigid(pose)
                heapq.heappush(waiting, (depth + 1, other))
    return poses


def _neighbours(
    links: Sequence[Link], numbers: Sequence[int], n_stations: int
) -> list[list[tuple[int, int, bool]]]:
    """Return for each station (other station, link, whether walked against its direction)."""
    found: list[list[tuple[int, int, bool]]] = [[] for _ in range(n_stations)]
    for number in numbers:
        link = links[number]
        found[link.source].append((link.target, number, False))
        found[link.target].append((link.source, number, True))
    return found


def _triangles(links: Sequence[Link], bodies: Bodies) -> list[Loop]:
    n_stations = len(bodies.middles)
    neighbours = _neighbours(links, range(len(links)), n_stations)
    to = [{other: (number, back) for other, number, back in around} for around in neighbours]
    loops = []
    for a in range(n_stations):
        for b in sorted(k for k in to[a] if k > a):
            for c in sorted(k for k in to[b] if k > b and k in to[a]):
                loops.append(bodies.loop(links, [to[a][b], to[b][c], to[c][a]]))
    return loops


def _ways_up(links: Sequence[Link], tree: set[int], n_stations: int) -> dict[int, tuple[int, int, int, bool]]:
    """Return for each station of a forest its depth, and how to go up: to whom, by which link, which way."""
    neighbours = _neighbours(links, sorted(tree), n_stations)
    ways: dict[int, tuple[int, int, int, bool]] = {}
    for root in range(n_stations):
        if root in ways:
            continue
        ways[root] = (0, -1, -1, False)
        waiting = [root]
        while waiting:
            station = waiting.pop()
            for other, by, backwards in neighbours[station]:
                if other not in ways:
                    ways[other] = (ways[station][0] + 1, station, by, not backwards)
                    waiting.append(other)
    return ways


def _trip(
    links: Sequence[Link], ways: dict[int, tuple[int, int, int, bool]], number: int
) -> list[tuple[int, bool]]:
    """Return the round trip that a link makes with a forest, beginning with the link."""
    above, below = links[number].target, links[number].source
    there: list[tuple[int, bool]] = []
    back: list[tuple[int, bool]] = []
    while above != below:
        if ways[above][0] >= ways[below][0]:
            _, up, by, backwards = ways[above]
            there.append((by, backwards))
            above = up
        else:
            _, up, by, backwards = ways[below]
            back.append((by, not backwards))
            below = up
    return [(number, False), *there, *reversed(back)]
