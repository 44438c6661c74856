"""Results of networks that were never registered: figures made up, for reports, tables and files."""

from __future__ import annotations

import math

import numpy as np

from tmchho.network.results import FineOverlap, LoopClosure, NetworkLink, NetworkRegistration, PlacedStation

ORIGIN = np.array([4_512_000.0, 5_402_500.0, 640.0])


def pose_at(x: float, y: float, z: float, turn_rad: float = 0.3) -> np.ndarray:
    pose = np.eye(4)
    pose[:2, :2] = [[math.cos(turn_rad), -math.sin(turn_rad)], [math.sin(turn_rad), math.cos(turn_rad)]]
    pose[:3, 3] = ORIGIN + np.array([x, y, z])
    return pose


def made_station(number: int, n_stations: int, note: str = "", placed: bool = True) -> PlacedStation:
    angle = 2 * math.pi * number / max(n_stations, 1)
    is_block = number == n_stations - 1
    pose = (
        pose_at(0, 0, 80, 1.0) if is_block else pose_at(140 * math.cos(angle), 80 * math.sin(angle), number)
    )
    if is_block:
        pose[:3, :3] *= 1.004
    sigma = 0.0 if number == 0 else 0.0015 + 0.0004 * number
    return PlacedStation(
        name="UAV" if is_block else f"S{number + 1:02d}",
        kind="block" if is_block else "scan",
        world_from_station=pose if placed else None,
        scale=1.004 if is_block else 1.0,
        sigma_position_m=np.array([sigma, sigma, 0.6 * sigma]) if placed else None,
        sigma_rotation_rad=np.array([1e-5, 1e-5, 3e-5]) if placed else None,
        sigma_scale=2e-5 if is_block else None,
        sigma_point_m=1.7 * sigma if placed else None,
        n_links=2 if placed else 0,
        fixed=number == 0,
        note=note,
        middle_m=pose[:3, 3].copy() if placed else None,
    )


def made_link(
    source: str, target: str, number: int, *, kept: bool = True, weight: float = 1.0
) -> NetworkLink:
    return NetworkLink(
        source=source,
        target=target,
        target_from_source=np.eye(4),
        verdict="accepted",
        reasons=("the surfaces match",),
        kept=kept,
        left_out_because="" if kept else "loops with other links miss by 4.1 m where 30 mm are allowed",
        overlap_of_source=0.30 + 0.01 * number,
        overlap_of_target=0.25,
        rms=0.004 + 0.0002 * number,
        strength=0.08,
        ambiguity_ratio=2.0,
        n_loops=2,
        n_open_loops=0 if kept else 2,
        residual_m=0.002 * weight if kept else 4.1,
        residual_rad=1e-4,
        normalised_residual=weight if kept else 900.0,
    )


def made_network(n_stations: int = 12, *, is_wrong: bool = False) -> NetworkRegistration:
    """Return a ring of stations with a block over it; one wrong link and a lost station where asked for."""
    stations = [made_station(number, n_stations) for number in range(n_stations)]
    names = [station.name for station in stations]
    ring = list(zip(names[:-1], [*names[1:-1], names[0]], strict=True))
    links = [made_link(a, b, number, weight=0.5 + 0.35 * (number % 7)) for number, (a, b) in enumerate(ring)]
    links += [made_link(name, "UAV", number, weight=0.9) for number, name in enumerate(names[:-1:2])]
    loops = [LoopClosure((a, b, "UAV"), 0.004, 2e-5, 0.03, True, True) for a, b in ring[:-1]]
    if is_wrong:
        links.append(made_link(names[0], names[n_stations // 2], 3, kept=False))
        loops.append(LoopClosure((names[0], names[n_stations // 2], "UAV"), 4.1, 0.05, 0.03, False, False))
        stations[3] = made_station(3, n_stations, note="no link to it was kept", placed=False)
        links = [link for link in links if "S04" not in (link.source, link.target)]
    return NetworkRegistration(
        stations=tuple(stations),
        links=tuple(links),
        loops=tuple(loops),
        overlaps=tuple(FineOverlap(a, b, 0.33, 0.004, 2300) for a, b in ring),
        gauge="station 'S01', held as given",
        unit_weight_error=1.1,
        voxel_size=0.4,
        n_pairs_possible=n_stations * (n_stations - 1) // 2,
        n_pairs_screened=40,
        n_pairs_registered=len(links),
        n_iterations=6,
        converged=True,
        seed=3,
        settings={"seed": 3, "adjust": {"kernel": "cauchy"}},
        version="0.1.0",
    )


def rough_terrain(xy: np.ndarray) -> np.ndarray:
    """Return heights of a ground that looks like itself nowhere else."""
    generator = np.random.default_rng(11)
    height = np.zeros(len(xy))
    for _ in range(60):
        middle, size = generator.uniform([-5, -5], [35, 20]), generator.uniform(0.8, 2.5)
        bump = generator.uniform(-2.0, 3.0)
        height += bump * np.exp(-((xy - middle) ** 2).sum(axis=1) / (2 * size**2))
    return height


def make_clouds(n_clouds: int, n_points: int = 4000) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Return windows of one ground, each in a frame of its own, and their poses; each meets the next two."""
    clouds, poses = [], []
    for number in range(n_clouds):
        generator = np.random.default_rng(100 + number)
        low = np.array([4.0 * number, 0.0])
        xy = generator.uniform(low, low + np.array([12.0, 14.0]), (n_points, 2))
        world = np.column_stack([xy, rough_terrain(xy)]) + generator.normal(0.0, 0.005, (n_points, 3))
        pose = pose_at(4.0 * number + 6.0, 7.0, 1.5, 0.9 * number)
        pose[:3, 3] -= ORIGIN
        clouds.append((world - pose[:3, 3]) @ pose[:3, :3])
        poses.append(pose)
    return clouds, poses
