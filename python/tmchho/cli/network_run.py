"""The route of a network: check, choose where to work, register, fuse, write, report."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tmchho.cli.display import Display
from tmchho.errors import WriteError

if TYPE_CHECKING:
    from tmchho.config import ConfigLike
    from tmchho.network.engine import Engine
    from tmchho.network.project import Project
    from tmchho.network.results import NetworkRegistration
    from tmchho.network.tiles import FuseMode

WORK = "work"
_MARK = "made-by-tmchho-network.txt"
_MARK_TEXT = """What this network has finished so far. `tmchho network ... --resume` goes on from here.
Once the network is done and nothing will be added to it, the folder may be deleted.
"""


@dataclass(frozen=True)
class Where:
    """Where units of work run.

    Parameters
    ----------
    scheduler : str, optional
        Address of a Dask scheduler.
    n_workers : int, optional
        Processes to start on this machine.
    memory_per_worker : int, optional
        Bytes that each of these may take.
    n_threads : int, optional
        Units at a time in this process, where neither of the first two is given.
    """

    scheduler: str | None = None
    n_workers: int | None = None
    memory_per_worker: int | None = None
    n_threads: int | None = None


@dataclass(frozen=True)
class NetworkJob:
    """A network to register.

    Parameters
    ----------
    project : Project
        Stations and what is known of them.
    folder : Path
        Where the results go.
    settings : ConfigLike
        Of the registration of a pair.
    command : str
        Command line that gives the same result again.
    where : Where
        Where the work is done.
    levelled, voxel_size, min_overlap
        See `tmchho.network.route.register_network`.
    fuse : {'merge', 'dedup'}, optional
        Also fuse all stations into one file.
    repeat_radius : float, optional
        Within this a point repeats another, for ``dedup``; a quarter of the voxel where not given.
    resume : bool
        Go on from what an earlier run has finished.
    overwrite : bool
        Replace what an earlier run has left, and begin anew.
    has_report : bool
        Also make ``report.html``.
    """

    project: Project
    folder: Path
    settings: ConfigLike
    command: str
    where: Where
    levelled: bool = False
    voxel_size: float | None = None
    min_overlap: float = 0.1
    fuse: FuseMode | None = None
    repeat_radius: float | None = None
    resume: bool = False
    overwrite: bool = False
    has_report: bool = True


@dataclass(frozen=True)
class NetworkOutcome:
    """What came of it."""

    found: NetworkRegistration
    document: dict[str, Any]
    files: tuple[Path, ...]


def run_network(job: NetworkJob, shown: Display) -> NetworkOutcome:
    """Register a network and write what came of it.

    Raises
    ------
    TmchhoError
        As its class says; what was finished stays in the folder for ``--resume``, results do not.
    """
    from tmchho.network.files import checksum_of, network_document, write_network
    from tmchho.network.route import register_network
    from tmchho.network.store import Resumed, Store, input_reference

    stations = job.project.stations
    references = [input_reference(str(station.cloud)) for station in stations]  # missing files are said now
    work = prepared_folder(job)
    store = Store(work / "finished")
    store.tidy()
    with _engine(job.where, shown) as workers, _told_of_resume(shown):
        engine = Resumed(workers, store)
        inputs = engine.run("checksums", checksum_of, [{"cloud": reference} for reference in references])
        found = register_network(
            stations,
            control_points=job.project.control_points,
            levelled=job.levelled,
            voxel_size=job.voxel_size,
            min_overlap=job.min_overlap,
            config=job.settings,
            engine=engine,
            work_folder=work / "clouds",
        )
        fused = _fuse(job, found, engine, work) if job.fuse is not None else None
    document = network_document(found, job.project.name, inputs, job.command, fused)
    with shown.step("write", "writing"):
        files = write_network(job.folder, document, overwrite=True)
    return NetworkOutcome(found, document, (*files, *_extras(job, shown)))


def prepared_folder(job: NetworkJob) -> Path:
    """Return the folder of what is finished, after refusing or clearing one of an earlier run.

    Raises
    ------
    WriteError
        If the output folder holds an earlier run that is neither to be resumed nor overwritten, or the folder
        of what is finished is not ours.
    """
    from tmchho.io import check_writable_folder
    from tmchho.network.files import OUTPUTS
    from tmchho.outputs import REPORT, check_folder

    work = job.folder / WORK
    names = (*OUTPUTS, REPORT)
    for path in (*(job.folder / name for name in names), work):
        if path.exists() and not (job.resume or job.overwrite):
            raise WriteError(
                f"{path}: exists already; go on from it by --resume, begin anew by --overwrite, or choose "
                "another folder"
            )
    inputs = [Path(str(station.cloud)) for station in job.project.stations]
    check_folder(job.folder, names=names, overwrite=True, inputs=inputs)
    if work.exists() and not (work / _MARK).exists():
        raise WriteError(f"{work}: was not made by a network; move it away, or choose another folder")
    if job.overwrite and work.exists():
        shutil.rmtree(work)  # the results stay until there are others
    check_writable_folder(work)
    (work / _MARK).write_text(_MARK_TEXT, encoding="utf-8")
    return work


@contextmanager
def _engine(where: Where, shown: Display) -> Iterator[Engine]:
    from tmchho.network.cluster import local_cluster, scheduler
    from tmchho.network.engine import InProcess

    if where.scheduler is not None:
        with scheduler(where.scheduler, progress=shown.on_event) as cluster:
            shown.note(f"{where.scheduler}: {cluster.n_workers} units at a time")
            yield cluster
    elif where.n_workers is not None:
        with local_cluster(
            where.n_workers, memory_per_worker=where.memory_per_worker, progress=shown.on_event
        ) as cluster:
            yield cluster
    else:
        yield InProcess(where.n_threads, progress=shown.on_event)


@contextmanager
def _told_of_resume(shown: Display) -> Iterator[None]:
    """Say what an interrupt leaves."""
    try:
        yield
    except KeyboardInterrupt:
        shown.note("what was finished is kept; the same command with --resume goes on from it")
        raise


def _fuse(job: NetworkJob, found: NetworkRegistration, engine: Engine, work: Path) -> dict[str, Any]:
    """Fuse the stations that were placed."""
    from tmchho.io import atomic_path
    from tmchho.network.files import FUSED
    from tmchho.network.tiles import PlacedCloud, fuse_network

    clouds = [
        PlacedCloud(station.name, Path(str(given.cloud)), station.world_from_station)
        for station, given in zip(found.stations, job.project.stations, strict=True)
        if station.world_from_station is not None
    ]
    radius = found.voxel_size / 4 if job.repeat_radius is None else job.repeat_radius
    with atomic_path(job.folder / FUSED, overwrite=True) as temporary:
        return fuse_network(
            clouds,
            temporary,
            engine=engine,
            folder=work / "fusion",
            reach=max(2 * found.voxel_size, radius),
            mode=job.fuse or "merge",
            repeat_radius=radius if job.fuse == "dedup" else 0.0,
        )


def _extras(job: NetworkJob, shown: Display) -> tuple[Path, ...]:
    """Make the report from what was just written; without the libraries for it, say so and go on.

    What was not made now is removed: left from an earlier run, it would be taken for ours.
    """
    from tmchho.network.files import FUSED
    from tmchho.outputs import REPORT
    from tmchho.report import missing_extras
    from tmchho.report.network import write_network_report

    made = (job.folder / FUSED,) if job.fuse is not None else ()
    for name in (REPORT, *(() if made else (FUSED,))):
        (job.folder / name).unlink(missing_ok=True)
    missing = missing_extras()
    if not job.has_report:
        return made
    if missing is not None:
        shown.note(f"{job.folder / 'report.html'} was not made: {missing}")
        return made
    with shown.step("report", "making the report"):
        return (*made, write_network_report(job.folder))
