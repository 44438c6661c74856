"""How a network grows: pairs are proposed, registered and checked, and what they place proposes the next.

1. What is known roughly says which pairs can touch. A block is tried with every station.
2. Links place stations; who overlaps with whom there, and was not tried, is tried near that place. Only
   stations that are sure are asked: a closed loop, or a block, confirms their place. Of two equal piers the
   second would otherwise be taken for the first by all neighbours, and agree with all of them.
3. Stations that are not sure ask the votes of the descriptors, look briefly at those named, and try the best;
   each round goes further down their lists.
4. Stations that a block should hold, but does not alone, or whose links contradict each other, are sought
   there thoroughly, all their places compared. One with two places is given up, whoever took it for his
   neighbour.
5. What is still not placed is searched as thoroughly as a pair alone would be.

So the number of registrations follows the links that exist, not the pairs that could be thought of.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tmchho.network.descriptors import VOXEL_BY_UNIT
from tmchho.network.engine import Engine, Item
from tmchho.network.links import Link, link_of, register_link
from tmchho.network.loops import Bodies, Checked, check_loops, components, confirming_links, placed_by
from tmchho.network.poses import inverse
from tmchho.network.propose import Pair, overlapping_pairs, screen_pair, voted_pairs
from tmchho.network.seat import seat_station

Array = NDArray[np.float64]

# In each round a station looks at so many of those that the votes name, and tries so many of them.
N_SCREENED = 12
N_TRIED = 5
MAX_ROUNDS = 3
# A thorough search costs ten times as much as a quick one.
N_THOROUGH = 3
MAX_THOROUGH_ROUNDS = 2
MAX_SEATING_ROUNDS = 2
# A station is sought at once in a block up to so many times its size; a smaller one asks others first.
MAX_SIZE_RATIO = 4.0
# Standard deviations of where a pair is looked for that overlaps as its stations are placed.
NEAR_VOXELS, NEAR_RAD = 5.0, 0.05
# A pair that is not accepted alone, for want of overlap, may be confirmed by others from this lead on.
MIN_DOUBTFUL_RATIO = 1.3


@dataclass(frozen=True, eq=False)
class Material:
    """What is known of all clouds after they were prepared.

    Parameters
    ----------
    prepared, described : tuple of dict
        References as `prepare_cloud` and `describe_cloud` return them.
    blocks, free_scale : frozenset of int
        Which are blocks, and whose scale is unknown.
    bodies : Bodies
        Middles, radii and the voxel.
    reaches : (n,) float64 array
        From the middle of a cloud to its rim.
    unit : float
        Extent of a usual station.
    """

    prepared: tuple[dict[str, str], ...]
    described: tuple[dict[str, str], ...]
    blocks: frozenset[int]
    free_scale: frozenset[int]
    bodies: Bodies
    reaches: Array
    unit: float

    def __len__(self) -> int:
        return len(self.prepared)


@dataclass(eq=False)
class Growth:
    """A network while it grows.

    Parameters
    ----------
    material : Material
        The clouds.
    config : dict
        Settings of `tmchho.register`, complete. A quick registration makes the first of its rounds only.
    min_overlap : float
        Least share of the smaller cloud that a proposal by places must have.
    engine : Engine
        Does the work.
    """

    material: Material
    config: dict[str, Any]
    min_overlap: float
    engine: Engine
    results: dict[Pair, Item] = field(default_factory=dict)
    screened: dict[Pair, Item] = field(default_factory=dict)
    # Stations that fit at two places alike, and what is said of them.
    two_places: dict[int, str] = field(default_factory=dict)
    # What `checked` returns, until there are other results.
    _checked: tuple[list[Link], Checked] | None = field(default=None, init=False)

    def grow(self, near: Iterable[Pair], known: NDArray[np.bool_]) -> None:
        """Register what is worth it until every station is placed or nothing is left to try.

        Parameters
        ----------
        near : iterable of (int, int)
            Pairs that can touch, of stations whose place is roughly known.
        known : (n,) bool array
            Which stations these are.
        """
        blocks = self.material.blocks
        first = set(near)
        for block in blocks:
            others = (k for k in range(len(self.material)) if k != block)
            first |= {
                ordered(block, k)
                for k in others
                if not (known[block] and known[k]) and self._is_alike(block, k)
            }
        self.register(first, quick=True)
        self.spread()
        votes: list[list[int]] | None = None
        for turn in range(MAX_ROUNDS):
            # A station that is placed, though not confirmed, asks once; one that is lost goes on.
            asking = self.lost() if turn else sorted(set(range(len(self.material))) - self.sure())
            if not asking:
                break
            votes = votes or voted_pairs(self.material.described)
            self.register(self._best_voted(asking, votes, turn), quick=True)
            self.spread()
        for block in sorted(blocks - self.material.free_scale):
            self.seat(block)
        for turn in range(MAX_THOROUGH_ROUNDS):
            lost = sorted(set(self.lost()) - set(self.two_places))
            if not lost:
                return
            self.register(self._thorough(lost, turn), quick=False)
            self.spread()

    def register(self, pairs: Iterable[Pair], *, quick: bool, near: dict[Pair, Array] | None = None) -> None:
        """Register the pairs that were not yet, or, if not quick, were not accepted.

        Parameters
        ----------
        pairs : iterable of (int, int)
            Rising.
        quick : bool
            Whether one round of the search has to do.
        near : dict of pair to (4, 4) array, optional
            About where the pose of a pair, from source to target, is looked for.
        """
        tried = self.results
        wanted = sorted(
            pair
            for pair in set(pairs)
            if pair not in tried or not (quick or tried[pair]["verdict"] == "accepted" or tried[pair]["full"])
        )
        items = []
        for a, b in wanted:
            source, target = self.direction((a, b))
            config = dict(self.config)
            if quick:
                rounds = config["coarse"]["rotations_per_round"]
                config["coarse"] = {**config["coarse"], "rotations_per_round": rounds[:1]}
            if {source, target} & self.material.free_scale:
                config["dof"] = 7
            elif near and (a, b) in near:
                config["known"] = {**config["known"], "prior": self._prior(near[a, b])}
            items.append(
                {
                    "source": self.material.prepared[source],
                    "target": self.material.prepared[target],
                    "config": config,
                }
            )
        found = self.engine.run("links", register_link, items)
        for pair, result in zip(wanted, found, strict=True):
            self.results[pair] = {**result, "full": not quick}
        self._checked = None

    def direction(self, pair: Pair) -> Pair:
        """Return source and target of a pair: a cloud whose scale is free moves, otherwise the first does."""
        a, b = pair
        return (b, a) if b in self.material.free_scale and a not in self.material.free_scale else (a, b)

    def links(self, verdicts: tuple[str, ...] = ("accepted",), *, of_two_places: bool = False) -> list[Link]:
        """Return the links of some verdicts, in the order of their stations.

        Parameters
        ----------
        verdicts : tuple of str
            Of the pairs alone.
        of_two_places : bool, default False
            Whether those of stations that fit at two places are wanted, or those of all others.
        """
        found = []
        bodies = self.material.bodies
        for pair in sorted(self.results):
            result = self.results[pair]
            if result["verdict"] in verdicts and bool(set(pair) & set(self.two_places)) == of_two_places:
                source, target = self.direction(pair)
                link = link_of(source, target, result, bodies.voxel_size, bodies.middles[target])
                if link is not None:
                    found.append(link)
        return found

    def checked(self) -> tuple[list[Link], Checked]:
        """Return the links that are accepted, or confirmed by each other, and what their loops say."""
        if self._checked is None:
            bodies, n = self.material.bodies, len(self.material)
            links = self.links()
            checked = check_loops(links, n, bodies)
            doubtful = [
                link
                for link in self.links(("review", "rejected"))
                if link.ambiguity_ratio >= MIN_DOUBTFUL_RATIO
            ]
            confirming = confirming_links(links, checked, doubtful, n, bodies)
            if confirming:
                links = [*links, *confirming]
                checked = check_loops(links, n, bodies)
            self._checked = links, checked
        return self._checked

    def groups(self) -> list[dict[int, Array]]:
        """Return the poses of each group of stations that links tie together, each in a frame of its own."""
        links, checked = self.checked()
        kept = [links[number] for number in checked.kept]
        groups = []
        for group in components(kept, len(self.material)):
            free_scale = self.material.free_scale
            start = best_linked(kept, group, free_scale)
            groups.append(placed_by(kept, range(len(kept)), len(self.material), start, free_scale))
        return groups

    def spread(self) -> None:
        """Register pairs of sure stations that overlap where links have placed them, while there are any."""
        material = self.material
        while True:
            sure = self.sure()
            near: dict[Pair, Array] = {}
            for group in self.groups():
                poses = {station: pose for station, pose in group.items() if station in sure}
                pairs = overlapping_pairs(
                    poses,
                    material.described,
                    material.bodies.middles,
                    material.reaches,
                    VOXEL_BY_UNIT * material.unit,
                    self.min_overlap,
                )
                for pair in pairs:
                    if pair not in self.results:
                        source, target = self.direction(pair)
                        near[pair] = inverse(poses[target]) @ poses[source]
            if not near:
                return
            self.register(near, quick=True, near=near)

    def sure(self) -> set[int]:
        """Return the stations whose place is confirmed: by a closed loop, or by a block."""
        links, checked = self.checked()
        found = set()
        for number in checked.kept:
            link = links[number]
            ends = {link.source, link.target}
            if checked.n_loops[number] > checked.n_open[number] or ends & self.material.blocks:
                found |= ends
        return found

    def seat(self, block: int) -> None:
        """Seek the stations in a block that it does not hold alone, and give up those that fit twice.

        Parameters
        ----------
        block : int
            One of known scale.
        """
        material = self.material
        for turn in range(MAX_SEATING_ROUNDS):
            (group,) = (group for group in self.groups() if block in group)
            in_block = {station: inverse(group[block]) @ pose for station, pose in group.items()}
            lost = set(self.lost())
            links, checked = self.checked()
            contradicted = checked.contradicted(links)
            contradicted |= {
                station
                for number in checked.left_out
                for station in (links[number].source, links[number].target)
                if block in (links[number].source, links[number].target)
            }
            wanted = [
                ordered(station, block)
                for station in range(len(material))
                if station not in material.blocks
                and (station in contradicted or not self._is_held(station, block))
                and not self.results.get(ordered(station, block), {}).get("is_only_place")
                and station not in self.two_places
                and (station in lost or not turn)
            ]
            if not wanted:
                return
            sure = self.sure()
            items = [self._seat_item(pair, block, in_block, sure) for pair in wanted]
            before = len(lost)
            for pair, found in zip(wanted, self.engine.run("seats", seat_station, items), strict=True):
                (station,) = set(pair) - {block}
                self._take_seat(pair, station, block, found, in_block.get(station))
            self.spread()
            if len(self.lost()) >= before:
                return

    def _is_held(self, station: int, block: int) -> bool:
        result = self.results.get(ordered(station, block))
        return result is not None and bool(result["verdict"] == "accepted")

    def _seat_item(self, pair: Pair, block: int, in_block: dict[int, Array], sure: set[int]) -> Item:
        material = self.material
        (station,) = set(pair) - {block}
        seen = sorted((set(in_block) & sure) - {block, station})
        places = [in_block[station]] if station in in_block else []
        alone = self.results.get(pair, {"pose": None})["pose"]
        if alone is not None:
            pose = np.array(alone)
            places.append(pose if self.direction(pair) == (station, block) else inverse(pose))
        rounds = self.config["coarse"]["rotations_per_round"]
        quick = {**self.config["coarse"], "rotations_per_round": rounds[:1]}
        prior = self._prior(np.eye(4))
        return {
            "source": material.prepared[station],
            "target": material.prepared[block],
            "station": material.described[station],
            "block": material.described[block],
            "config": self.config,
            "near_config": {
                **self.config,
                "coarse": quick,
                "known": {**self.config["known"], "prior": prior},
            },
            "places": [pose.tolist() for pose in places],
            "seen": [{"cloud": material.described[k], "pose": in_block[k].tolist()} for k in seen],
            "voxel_size": material.bodies.voxel_size,
        }

    def _take_seat(self, pair: Pair, station: int, block: int, found: Item, place: Array | None) -> None:
        """Believe what was found in the block, or give a station up that was placed and fits twice."""
        if found["pose"] is None:
            return
        self._checked = None
        if found["verdict"] == "accepted":
            if self.direction(pair) != (station, block):
                back = inverse(np.array(found["pose"])).tolist()
                shares = {
                    "overlap_of_source": found["overlap_of_target"],
                    "overlap_of_target": found["overlap_of_source"],
                }
                found = {**found, **shares, "pose": back, "covariance": None, "middle": None}
            self.results[pair] = {**found, "full": True, "is_only_place": True}
        elif found["verdict"] == "review" and place is not None:
            self.two_places[station] = found["reasons"][0]

    def _prior(self, pose: Array) -> dict[str, Any]:
        """Return a pose as loose prior knowledge: what is found within it has still found itself."""
        away = [NEAR_VOXELS * self.material.bodies.voxel_size] * 3
        return {
            "target_from_source": pose.tolist(),
            "rotation_rad": [NEAR_RAD] * 3,
            "translation_m": away,
        }

    def lost(self) -> list[int]:
        """Return the stations outside the largest group."""
        groups = self.groups()
        return sorted(station for group in groups[1:] for station in group)

    def _is_alike(self, a: int, b: int) -> bool:
        """Tell whether a cloud is not too small to be found in the other one soon."""
        reaches = self.material.reaches
        return bool(max(reaches[a], reaches[b]) <= MAX_SIZE_RATIO * min(reaches[a], reaches[b]))

    def _best_voted(self, asking: Sequence[int], votes: Sequence[Sequence[int]], turn: int) -> set[Pair]:
        """Return for each station that asks the pairs that look best among those that the votes name."""
        named = {
            station: [k for k in votes[station] if k not in self.material.blocks][
                turn * N_SCREENED : (turn + 1) * N_SCREENED
            ]
            for station in asking
            if station not in self.material.blocks
        }
        self._screen({ordered(station, k) for station, others in named.items() for k in others})
        chosen: set[Pair] = set()
        for station, others in named.items():
            pairs = [ordered(station, k) for k in others]
            pairs = [pair for pair in pairs if pair not in self.results]
            pairs.sort(key=lambda pair: -self.screened[pair]["n_agreeing"])
            chosen |= set(pairs[:N_TRIED])
        return chosen

    def _thorough(self, lost: Sequence[int], turn: int) -> set[Pair]:
        """Return for each lost station the next best pairs of all that were looked at."""
        chosen: set[Pair] = set()
        for station in lost:
            pairs = [pair for pair in self.screened if station in pair]
            pairs += [ordered(station, block) for block in sorted(self.material.blocks) if block != station]
            pairs.sort(key=lambda pair: -self.screened.get(pair, {"n_agreeing": 1 << 30})["n_agreeing"])
            chosen |= set(pairs[turn * N_THOROUGH : (turn + 1) * N_THOROUGH])
        return chosen

    def _screen(self, pairs: set[Pair]) -> None:
        wanted = sorted(pair for pair in pairs if pair not in self.screened)
        described = self.material.described
        items = [
            {"first": described[a], "second": described[b], "unit": self.material.unit} for a, b in wanted
        ]
        found = self.engine.run("screen", screen_pair, items)
        self.screened.update(zip(wanted, found, strict=True))


def ordered(a: int, b: int) -> Pair:
    """Return a pair with the smaller number first."""
    return (a, b) if a < b else (b, a)


def best_linked(links: Sequence[Link], group: Sequence[int], free_scale: frozenset[int]) -> int:
    """Return the station of a group, of known scale if one is, with the most links, the first of equals."""
    count = dict.fromkeys(group, 0)
    for link in links:
        for station in (link.source, link.target):
            if station in count:
                count[station] += 1
    return max(group, key=lambda station: (station not in free_scale, count[station], -station))
