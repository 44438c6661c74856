"""Stations sought in a block: the right place of several, and two places that are the same."""

from __future__ import annotations

import numpy as np
import pytest
from made_networks import pose_at, rough_terrain

from tmchho.network import Station, register_network
from tmchho.network.engine import InProcess
from tmchho.network.poses import applied
from tmchho.network.prepare import VoxelCloud
from tmchho.network.seat import compare_places
from tmchho.stages import estimate_normals, voxel_downsample

Array = np.ndarray
VOXEL = 0.25
# The ground from x = 20 on for so many metres is there once more, so far away.
TWIN_FROM, TWIN_LENGTH, TWIN_AWAY = 18.0, 14.0, 16.0


def ground(xy: Array) -> Array:
    """Return heights that are the same in two places."""
    own = xy.copy()
    second = xy[:, 0] >= TWIN_FROM + TWIN_AWAY
    own[second, 0] -= TWIN_AWAY
    return rough_terrain(own)


def window(low: float, high: float, n_points: int, seed: int) -> Array:
    generator = np.random.default_rng(seed)
    xy = generator.uniform([low, 0.0], [high, 14.0], (n_points, 2))
    return np.column_stack([xy, ground(xy)]) + generator.normal(0.0, 0.01, (n_points, 3))


def described(points: Array) -> VoxelCloud:
    points = voxel_downsample(points, VOXEL).points
    normals, curvatures = estimate_normals(points)
    nothing = np.zeros((0, 3))
    return VoxelCloud(points, normals, curvatures, nothing, nothing, np.zeros((0, 33), np.float32))


def shifted(x: float, y: float = 0.0) -> Array:
    pose = np.eye(4)
    pose[:2, 3] = x, y
    return pose


@pytest.mark.parametrize(("low", "is_only"), [(4.0, True), (TWIN_FROM + TWIN_AWAY + 1.0, False)])
def test_a_place_is_the_only_one_where_the_other_does_not_fit(low: float, is_only: bool) -> None:
    block = described(window(0.0, TWIN_FROM + TWIN_AWAY + TWIN_LENGTH, 40_000, 1))
    station = described(window(low, low + 11.0, 12_000, 2))
    # The truth is no shift at all; the search would have come near to it, and to others.
    poses = [shifted(-TWIN_AWAY + 0.3, 0.2), shifted(0.3, -0.2), shifted(8.0)]
    places = compare_places(station, block, poses, VOXEL)
    away = [float(np.linalg.norm(pose[:3, 3])) for pose, _ in places]
    if is_only:
        assert away[0] < 0.05
        assert all(1.0 - share > 2.0 * (1.0 - places[0][1]) for _, share in places[1:])
    else:
        assert sorted(np.round(away[:2])) == [0.0, TWIN_AWAY]
        assert 1.0 - places[1][1] < 1.2 * (1.0 - places[0][1])


def test_a_station_that_fits_twice_is_given_up_and_its_wrong_link_named() -> None:
    windows = {
        "A": window(0.0, 14.0, 6000, 3),
        "B": window(7.0, 21.0, 6000, 4),
        "first twin": window(11.0, TWIN_FROM + 12.0, 8000, 5),
        "second twin": window(TWIN_FROM + TWIN_AWAY + 1.0, TWIN_FROM + TWIN_AWAY + 12.0, 6000, 6),
        "UAV": window(0.0, TWIN_FROM + TWIN_AWAY + TWIN_LENGTH, 20_000, 7),
    }
    stations, truth = [], {}
    for number, (name, world) in enumerate(windows.items()):
        pose = pose_at(0.0, 0.0, 2.0, 0.7 * number)
        pose[:3, 3] = [5.0 * number, 3.0, 1.0]
        local = (world - pose[:3, 3]) @ pose[:3, :3]
        stations.append(Station(name, local, kind="block" if name == "UAV" else "scan"))
        truth[name] = pose
    found = register_network(stations, seed=1, engine=InProcess(1))
    for station in found.stations:
        if station.name == "second twin":
            assert station.world_from_station is None
            assert "another place in the block" in station.note
            continue
        pose = truth["UAV"] @ np.linalg.inv(found.pose("UAV")) @ station.world_from_station
        points = windows[station.name] - truth[station.name][:3, 3]
        points = points @ truth[station.name][:3, :3]
        away = applied(pose, points) - applied(truth[station.name], points)
        assert np.sqrt((away**2).sum(axis=1).mean()) < found.voxel_size
    (wrong,) = [link for link in found.links if {link.source, link.target} == {"first twin", "second twin"}]
    # Alone it is as good as any.
    assert wrong.verdict == "accepted"
    assert not wrong.kept
    assert "fits twice" in wrong.left_out_because
