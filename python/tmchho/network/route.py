"""The map: a network from clouds to poses, on one page.

    clouds ─ prepare ─ describe ─ grow (propose, register, check loops) ─ adjust ─ refine ─ result

What takes time runs as units of work, wherever the engine has them run: one for each station, one for each
pair. What lies between is quick and without chance, so that a run that was killed goes on from the units
that are done.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np

from tmchho import __version__
from tmchho.arguments import checked_choice, checked_number, checked_seed
from tmchho.config import ConfigLike, config_json
from tmchho.errors import InvalidArgumentError, NoSolutionError
from tmchho.inputs import CloudLike
from tmchho.io.atomic import StrPath
from tmchho.network.engine import Engine, InProcess, steady_sums
from tmchho.network.frame import frame_of, rough_centres
from tmchho.network.growth import Growth, Material
from tmchho.network.loops import Bodies
from tmchho.network.placing import NetworkPlaces, place
from tmchho.network.prepare import VOXELS_IN_EXTENT, cloud_reference, describe_cloud, prepare_cloud
from tmchho.network.propose import near_pairs
from tmchho.network.report_rows import link_rows, loop_rows, overlap_rows, station_rows
from tmchho.network.results import NetworkRegistration
from tmchho.network.stations import Station, StationControl, checked_stations
from tmchho.progress import ProgressCallback

# Half of the extent of a round cloud is the reach from its middle; see `extent_of`.
_RADIUS_BY_EXTENT = 1.0 / 2.4


def register_network(
    clouds: Sequence[Station | CloudLike],
    *,
    control_points: Sequence[StationControl] = (),
    levelled: bool = False,
    voxel_size: float | None = None,
    min_overlap: float = 0.1,
    seed: int | None = None,
    config: ConfigLike | None = None,
    engine: Engine | None = None,
    work_folder: StrPath | None = None,
    progress: ProgressCallback | None = None,
) -> NetworkRegistration:
    """Register many stations with each other, without targets and without knowing where they stand.

    Parameters
    ----------
    clouds : sequence of Station or CloudLike
        At least two. A `Station` says what is known of it: a rough or measured position, a pose, whether its
        scale is free.
    control_points : sequence of StationControl
        Places that were measured in the world and in a station.
    levelled : bool, default False
        Whether all clouds have z up, as levelled scanners and georeferenced photogrammetry have: pairs are
        then searched with four degrees of freedom. The adjustment still corrects small tilts.
    voxel_size : float, optional
        Edge of the voxels of the fine adjustment, above 0; 1/250 of the extent of a usual station where not
        given.
    min_overlap : float, default 0.1
        Least share of the smaller cloud for which a pair is registered because of where its stations lie;
        0.01 to 0.9.
    seed : int, optional
        Seed of all random numbers. The same input and seed give the same result, whatever the engine.
    config : Config, mapping or path of a TOML file, optional
        Settings of the registration of pairs; see `tmchho.register`.
    engine : Engine, optional
        Where the units of work run; on threads of this process where not given.
    work_folder : str or path, optional
        Where prepared clouds are laid down; the workers must see it. A temporary one where not given.
    progress : callable, optional
        Gets a `ProgressEvent` after each unit where no `engine` is given; answers True to stop.

    Returns
    -------
    NetworkRegistration
        With poses, standard errors, and a table of all links, of which those that contradict the others are
        left out. Read its verdict: a station that nothing holds is no error.

    Raises
    ------
    ReadError, InvalidCloudError
        If a cloud cannot be read, or holds too few points.
    InvalidArgumentError
        Naming the argument, or a missing library.
    NoSolutionError
        If no two stations could be registered with each other.
    """
    stations, control = checked_stations(clouds, control_points)
    min_overlap = checked_number("min_overlap", min_overlap, 0.01, 0.9)
    if voxel_size is not None and checked_number("voxel_size", voxel_size) <= 0:
        raise InvalidArgumentError(f"voxel_size must be above 0, got {voxel_size}")
    if not isinstance(levelled, (bool, np.bool_)):
        raise InvalidArgumentError(f"levelled must be True or False, got {levelled!r}")
    seed = None if seed is None else checked_seed(seed)
    settings: dict[str, Any] = json.loads(config_json(config, seed=seed, dof=4 if levelled else None))
    settings.pop("n_threads", None)
    checked_choice("config: mode", settings["mode"], ("robust",))
    _need_scipy()
    engine = engine or InProcess(progress=progress)
    lent = tempfile.TemporaryDirectory(prefix="tmchho-") if work_folder is None else nullcontext(work_folder)
    with steady_sums(), lent as folder:
        folder = Path(folder).absolute()
        folder.mkdir(parents=True, exist_ok=True)
        material, origins, voxel_size = _prepared(stations, folder, voxel_size, engine)
        frame = frame_of(stations, control, origins)
        growth = Growth(material, settings, min_overlap, engine)
        centres, wide, known = rough_centres(stations, frame, material.bodies.middles, material.reaches)
        growth.grow(near_pairs(centres, wide, known), known)
        found = place(growth, frame)
    return _result(stations, found, growth, voxel_size, settings, min_overlap)


def _prepared(
    stations: Sequence[Station], folder: Path, voxel_size: float | None, engine: Engine
) -> tuple[Material, Any, float]:
    items: list[dict[str, Any]] = [
        {
            "cloud": cloud_reference(station.cloud, f"station '{station.name}'", folder),
            "name": f"station '{station.name}'",
            "folder": str(folder),
            "number": number,
        }
        for number, station in enumerate(stations)
    ]
    prepared = engine.run("prepare", prepare_cloud, items)
    scans = [number for number, station in enumerate(stations) if station.kind == "scan"]
    usual = scans or [number for number, station in enumerate(stations) if not station.free_scale]
    unit = float(np.median([prepared[number]["extent"] for number in usual]))
    voxel_size = unit / VOXELS_IN_EXTENT if voxel_size is None else voxel_size
    items = [
        {
            "points": made["points"],
            "voxel_size": voxel_size,
            "unit": unit,
            "folder": str(folder),
            "number": number,
        }
        for number, made in enumerate(prepared)
    ]
    described = engine.run("describe", describe_cloud, items)
    bodies = Bodies(
        np.array([made["middle"] for made in prepared]),
        np.array([made["radius"] for made in prepared]),
        voxel_size,
    )
    material = Material(
        tuple(made["points"] for made in prepared),
        tuple(made["cloud"] for made in described),
        frozenset(number for number, station in enumerate(stations) if station.kind == "block"),
        frozenset(number for number, station in enumerate(stations) if station.free_scale),
        bodies,
        np.array([made["extent"] for made in prepared]) * _RADIUS_BY_EXTENT,
        unit,
    )
    return material, np.array([made["origin"] for made in prepared]), voxel_size


def _result(
    stations: Sequence[Station],
    found: NetworkPlaces,
    growth: Growth,
    voxel_size: float,
    settings: dict[str, Any],
    min_overlap: float,
) -> NetworkRegistration:
    if not any(link.kept for link in found.judged):
        raise NoSolutionError(
            "no two stations could be registered with each other; give rough positions or clouds that overlap"
        )
    n = len(stations)
    names = [station.name for station in stations]
    return NetworkRegistration(
        stations=station_rows(stations, found, growth),
        links=link_rows(names, found, growth),
        loops=loop_rows(names, found),
        overlaps=overlap_rows(names, found),
        gauge=found.gauge_words(names),
        unit_weight_error=found.unit_weight_error,
        voxel_size=voxel_size,
        n_pairs_possible=n * (n - 1) // 2,
        n_pairs_screened=len(growth.screened),
        n_pairs_registered=len(growth.results),
        n_iterations=found.n_iterations,
        converged=found.converged,
        seed=settings["seed"],
        settings={**settings, "voxel_size": voxel_size, "min_overlap": min_overlap},
        version=__version__,
    )


def _need_scipy() -> None:
    try:
        import scipy  # noqa: F401
    except ImportError as error:
        raise InvalidArgumentError("networks need scipy: pip install 'tmchho[network]'") from error
