"""A small network from clouds to poses, against the truth of the simulation."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tmchho.errors import InvalidArgumentError, NoSolutionError
from tmchho.network import NetworkRegistration, Station, StationControl, register_network
from tmchho.network.engine import InProcess, Item, Unit
from tmchho.network.poses import applied, inverse
from tmchho.simulate import SimulatedNetwork, make_network, make_site, random_pose, survey_scanner

Array = np.ndarray


PLACES = ((-9.0, -7.0), (8.0, -8.0), (9.0, 9.0), (-6.0, 10.0), (0.0, -14.0))


@cache
def surveyed() -> SimulatedNetwork:
    """Five scans whose stations stand so near to each other that every pair overlaps."""
    site = make_site(size_m=80.0, area_ratio=1.0, seed=3)
    clouds, poses = [], []
    for number, place in enumerate(PLACES):
        seen = survey_scanner(site, stations=[place], n_points=20_000, max_range_m=45.0, seed=number)
        pose = random_pose(np.random.default_rng(number), 30.0)
        clouds.append(replace(seen, xyz=applied(inverse(pose), seen.xyz), name=f"S{number}"))
        poses.append(pose)
    return SimulatedNetwork(tuple(c.name for c in clouds), tuple(clouds), tuple(poses), site)


@cache
def found() -> NetworkRegistration:
    site = surveyed()
    stations = [Station(name, cloud) for name, cloud in zip(site.names, site.clouds, strict=True)]
    return register_network(stations, seed=5, engine=InProcess(1))


def truth() -> dict[str, Array]:
    return dict(zip(surveyed().names, surveyed().world_from_station, strict=True))


def displacement(name: str, pose: Array, wanted: Array) -> float:
    points = surveyed().clouds[surveyed().names.index(name)].xyz
    return float(np.sqrt(((applied(pose, points) - applied(wanted, points)) ** 2).sum(axis=1).mean()))


def test_all_stations_lie_within_a_third_of_a_voxel() -> None:
    assert found().verdict == "accepted", found().summary()
    assert_all_right(found())


def assert_all_right(network: NetworkRegistration) -> None:
    (reference,) = [station.name for station in network.stations if station.fixed]
    world_from_network = truth()[reference] @ inverse(network.pose(reference))
    for station in network.stations:
        pose = world_from_network @ station.world_from_station
        assert displacement(station.name, pose, truth()[station.name]) < network.voxel_size / 3


def test_links_loops_and_errors_are_told() -> None:
    network = found()
    kept = [link for link in network.links if link.kept]
    assert len(kept) > 3
    for link in kept:
        wanted = inverse(truth()[link.target]) @ truth()[link.source]
        assert displacement(link.source, link.target_from_source, wanted) < network.voxel_size
        assert link.residual_m < network.voxel_size
    assert all(loop.closed for loop in network.loops if loop.kept)
    for station in network.stations:
        assert (station.sigma_point_m == 0) == station.fixed
        assert station.sigma_point_m < network.voxel_size / 3
    assert json.loads(json.dumps(network.to_dict(), allow_nan=False))["verdict"] == "accepted"


class Misled(InProcess):
    """Takes one pair for another and is sure of it, as where two piers are equal."""

    wrong: tuple[str, str] | None = None

    def run(self, stage: str, unit: Unit, items: Sequence[Item], **further: Any) -> list[Item]:
        results = super().run(stage, unit, items, **further)
        for item, result in zip(items, results, strict=True):
            if stage == "links" and self.wrong is None and result["verdict"] == "accepted":
                result["pose"] = (
                    np.array(result["pose"]) @ random_pose(np.random.default_rng(9), 40.0)
                ).tolist()
                result |= {"ambiguity_ratio": None, "overlap_of_source": 1.0, "overlap_of_target": 1.0}
                self.wrong = tuple(
                    f"S{int(Path(item[end]['path']).name[:5])}" for end in ("source", "target")
                )
        return results


def test_a_wrong_link_that_is_sure_of_itself_is_thrown_out_by_the_loops() -> None:
    site, engine = surveyed(), Misled(1)
    stations = [Station(name, cloud) for name, cloud in zip(site.names, site.clouds, strict=True)]
    network = register_network(stations, seed=5, engine=engine)
    (wrong,) = [link for link in network.links if (link.source, link.target) == engine.wrong]
    assert wrong.verdict == "accepted"
    assert not wrong.kept
    assert re.match(r"the loop of \d links through it misses by", wrong.left_out_because)
    assert f"left out   {wrong.source} – {wrong.target}: the loop of" in network.summary()
    assert wrong.n_open_loops == wrong.n_loops > 0
    assert all(link.kept for link in network.links if link.verdict == "accepted" and link is not wrong)
    # Nobody was harmed by it.
    assert network.verdict == "accepted", network.summary()
    assert_all_right(network)


def test_any_number_of_workers_finds_the_same() -> None:
    site = surveyed()
    stations = [Station(name, cloud) for name, cloud in zip(site.names, site.clouds, strict=True)]
    again = register_network(stations, seed=5, engine=InProcess(3))
    assert json.dumps(again.to_dict()) == json.dumps(found().to_dict())


def test_measured_positions_give_the_frame_even_at_national_grid_size() -> None:
    site, grid = surveyed(), np.array([500_000.0, 4_000_000.0, 200.0])
    rng = np.random.default_rng(0)
    stations = []
    for name, cloud, pose in zip(site.names[:3], site.clouds, site.world_from_station, strict=False):
        measured = pose[:3, 3] + grid + 0.01 * rng.standard_normal(3)
        stations.append(Station(name, cloud, position=measured, position_sigma_m=0.01))
    last = site.names[3]
    stations.append(Station(last, site.clouds[3]))
    place = np.array([3.0, 1.0, 2.0])
    control = [StationControl(last, place, applied(truth()[last], place) + grid, 0.01)]
    network = register_network(stations, control_points=control, seed=5)
    assert network.gauge == "4 observed positions"
    for station in network.stations:
        wanted = truth()[station.name].copy()
        wanted[:3, 3] += grid
        assert displacement(station.name, station.world_from_station, wanted) < 0.05
        assert not station.fixed


def test_what_is_known_wrongly_is_refused_by_name() -> None:
    cloud = np.random.default_rng(0).standard_normal((100, 3))
    with pytest.raises(InvalidArgumentError, match="at least two"):
        register_network([cloud])
    with pytest.raises(InvalidArgumentError, match="two stations are called 'A'"):
        register_network([Station("A", cloud), Station("A", cloud)])
    with pytest.raises(InvalidArgumentError, match="'B', which is no station"):
        register_network(
            [Station("A", cloud), Station("C", cloud)],
            control_points=[StationControl("B", [0, 0, 0], [0, 0, 0], 1.0)],
        )
    with pytest.raises(InvalidArgumentError, match="station 'A': it needs a pose"):
        Station("A", cloud, fixed=True)
    with pytest.raises(InvalidArgumentError, match="station 'A': pose must be a rotation"):
        Station("A", cloud, pose=2 * np.eye(4))
    with pytest.raises(InvalidArgumentError, match="free scale"):
        register_network([Station("A", cloud, free_scale=True), Station("B", cloud, free_scale=True)])


def test_clouds_that_share_nothing_are_no_network() -> None:
    rng = np.random.default_rng(0)
    clouds = [rng.standard_normal((3000, 3)) * [1, 1, scale] for scale in (1.0, 0.2)]
    with pytest.raises(NoSolutionError, match="no two stations"):
        register_network(clouds, config={"coarse": {"rotations_per_round": [60]}})


def test_a_simulated_network_is_what_it_says() -> None:
    network = make_network(
        n_stations=3, n_points=2_000, n_block_points=3_000, block_scale=1.5, equal_piers=True, seed=1
    )
    assert network.names == ("S01", "S02", "S03", "pier A", "pier B", "UAV")
    assert [len(cloud) for cloud in network.clouds] == [2_000] * 5 + [3_000]
    for name, cloud, pose in zip(network.names, network.clouds, network.world_from_station, strict=True):
        assert np.cbrt(np.linalg.det(pose[:3, :3])) == pytest.approx(1.5 if name == "UAV" else 1.0)
        here = applied(pose, cloud.xyz[cloud.attributes["classification"] == 2])
        # What is ground lies on the ground, in the frame of the site.
        above = here[:, 2] - network.site.ground.height(here[:, 0], here[:, 1])
        assert np.median(np.abs(above)) < 0.2
    again = make_network(
        n_stations=3, n_points=2_000, n_block_points=3_000, block_scale=1.5, equal_piers=True, seed=1
    )
    assert all(np.array_equal(a.xyz, b.xyz) for a, b in zip(network.clouds, again.clouds, strict=True))
