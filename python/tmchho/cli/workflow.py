"""The route of the files: check, read, register, fuse, write. `register` and `demo` share it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tmchho.cli.crs import crs_name, is_geographic
from tmchho.cli.display import Display
from tmchho.errors import InvalidCloudError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import ArrayLike, NDArray

    from tmchho import Config, FusedCloud, PointCloud, Registration
    from tmchho.selection import Selection

    Remarks = Callable[[PointCloud, Registration], dict[str, Any]]


@dataclass(frozen=True)
class Job:
    """Two files to register.

    Parameters
    ----------
    source, target : Path
        The cloud that is moved, and the one that stays.
    folder : Path
        Where the results go.
    settings : Config
        Checked settings.
    command : str
        Command line that gives the same result again.
    overwrite : bool
        Replace results of an earlier run.
    max_memory : int, optional
        Bytes to keep to; files that need more are worked on in parts. Half of the machine's where not given.
    assume_same_crs : bool, default False
        Go on where the coordinate reference systems differ.
    selections : (Selection, Selection), optional
        Which points of source and target take part in finding the pose.
    areas : Path, optional
        Polygons by which distances are summed up; five strips along the overlap where not given.
    tolerance : float, optional
        Distance within which points are counted.
    has_report : bool
        Also make ``report.html``.
    """

    source: Path
    target: Path
    folder: Path
    settings: Config
    command: str
    overwrite: bool = False
    max_memory: int | None = None
    assume_same_crs: bool = False
    selections: tuple[Selection, ...] = ()
    areas: Path | None = None
    tolerance: float | None = None
    has_report: bool = True


@dataclass(frozen=True)
class Outcome:
    """What came of it."""

    registration: Registration
    document: dict[str, Any]
    files: tuple[Path, ...]

    @property
    def is_accepted(self) -> bool:
        """Whether nobody has to look."""
        return self.registration.verdict == "accepted"


def run(job: Job, shown: Display, remarks: Remarks | None = None) -> Outcome:
    """Register two files and write what came of it; nothing is written before all is computed.

    Parameters
    ----------
    job : Job
        What to do.
    shown : Display
        Where progress goes.
    remarks : callable, optional
        Gets the source cloud and the registration, and returns further entries of ``result.json``. Files are
        then read as wholes, whatever their size.

    Returns
    -------
    Outcome

    Raises
    ------
    TmchhoError
        As its class says; no file was written then.
    """
    from tmchho import fuse, read_areas
    from tmchho.evaluation import distance_entries
    from tmchho.io.unchanged import Unchanged
    from tmchho.outputs import OUTPUTS, REPORT, InputFile, check_folder, fused_counts, result_document
    from tmchho.report.described import describe
    from tmchho.streams import default_max_memory, needs_streams

    paths = (job.source, job.target)
    check_folder(job.folder, names=(*OUTPUTS, REPORT), overwrite=job.overwrite, inputs=paths)
    unchanged = Unchanged(paths)
    allowed = default_max_memory() if job.max_memory is None else job.max_memory
    if remarks is None and needs_streams(paths, allowed):
        from tmchho.cli.streamed import run_streamed

        return _reported(run_streamed(job, shown, allowed), job, shown)
    source, target = (_read(path, shown) for path in paths)
    check_crs(
        *((cloud.name, cloud.crs, *_box(cloud)) for cloud in (source, target)),
        assume_same=job.assume_same_crs,
        shown=shown,
    )
    areas = None if job.areas is None else read_areas(job.areas, target.crs)
    with shown.step("read", "taking checksums"):
        files = (InputFile.of(job.source, len(source)), InputFile.of(job.target, len(target)))
    with shown.step("register"):
        registration = _register(job, source, target, shown)
    for path, n_dropped in zip(paths, registration.n_non_finite, strict=True):
        if n_dropped:
            shown.warn(f"{path}: {n_dropped:,} points left out because a coordinate is not finite")
    fused, counts = None, None
    if registration.verdict != "rejected":
        options = registration.config["fuse"]
        with shown.step("fuse", "fusing"):
            fused = fuse(
                source, target, registration, mode=options["mode"], hole_radius=options["hole_radius_m"]
            )
            counts = fused_counts(fused, source, target, options["mode"])
    document = result_document(registration, *files, counts, job.command)
    for side, cloud in (("source", source), ("target", target)):
        document["inputs"][side] = {**document["inputs"][side], **describe(cloud, crs_name(cloud.crs))}
    if fused is not None:
        with shown.step("evaluate", "summing up by area"):
            document |= distance_entries(registration, source, target, fused, areas, job.tolerance)
    if remarks is not None:
        document |= remarks(source, registration)
    unchanged.check()
    with shown.step("write", "writing"):
        written = _write(job, registration, source, target, fused, document)
    return _reported(Outcome(registration, document, written), job, shown)


def _read(path: Path, shown: Display) -> PointCloud:
    from tmchho import read

    with shown.step("read", f"reading {path}"):
        cloud = read(path)
    shown.note(f"{path}: {len(cloud):,} points")
    return cloud


def _register(job: Job, source: PointCloud, target: PointCloud, shown: Display) -> Registration:
    """Find the pose, for the points that were selected, and measure the distances of all."""
    from tmchho import evaluate, register

    if not any(job.selections):
        return register(source, target, config=job.settings, progress=shown.on_event)
    clouds = [
        selection.of(cloud) if selection else cloud
        for selection, cloud in zip(job.selections, (source, target), strict=True)
    ]
    for cloud in clouds:
        shown.note(f"{cloud.name}: {len(cloud):,} points take part in finding the pose")
    found = register(*clouds, config=job.settings, progress=shown.on_event)
    measured = evaluate(source, target, found, tolerance=found.max_distance)
    # There are points, or there were no pose.
    forth, back = measured.source_to_target_statistics, measured.target_to_source_statistics
    assert forth is not None
    assert back is not None
    assert measured.share_within is not None
    overlaps = [share or 0.0 for share in measured.share_within]
    return replace(
        found,
        source_to_target=forth,
        target_to_source=back,
        overlap_of_source=overlaps[0],
        overlap_of_target=overlaps[1],
    )


def _box(cloud: PointCloud) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    import numpy as np

    finite = cloud.xyz[np.isfinite(cloud.xyz).all(axis=1)]
    if not len(finite):
        return np.zeros(3), np.zeros(3)
    return finite.min(axis=0), finite.max(axis=0)


def check_crs(
    source: tuple[str, str | None, ArrayLike, ArrayLike],
    target: tuple[str, str | None, ArrayLike, ArrayLike],
    *,
    assume_same: bool,
    shown: Display,
) -> None:
    """Refuse what makes a pose meaningless, and warn of what may.

    Parameters
    ----------
    source, target : tuple
        Name, coordinate reference system as WKT or None, lower and upper corner of the box.
    assume_same : bool
        Only warn where the systems differ.
    shown : Display
        Where warnings go.

    Raises
    ------
    InvalidCloudError
        If coordinates are degrees, or the systems differ.
    """
    from tmchho.crs import crs_differences, crs_doubts

    for name, crs, low, high in (source, target):
        if is_geographic(crs):
            raise InvalidCloudError(
                f"{name}: coordinates are degrees of {crs_name(crs)}, in which no rigid pose "
                "exists; project the cloud to metres first"
            )
        for doubt in crs_doubts(crs, low, high):
            shown.warn(f"{name}: {doubt}")
    differences = crs_differences(source[1], target[1])
    if not differences:
        return
    said = f"{source[0]} and {target[0]}: {'; '.join(differences)}"
    if not assume_same:
        raise InvalidCloudError(
            f"{said}; bring both into one system first (for example by `pdal translate` with "
            "filters.reprojection), or give --assume-same-crs if a label is wrong"
        )
    shown.warn(f"{said}; both are taken for that of the target, because --assume-same-crs was given")


def scales_of(cloud: PointCloud) -> tuple[float, ...] | None:
    """Return the steps in which a LAS file stores coordinates, None for other files."""
    header = cloud.metadata.get("header") if cloud.metadata.get("format") == "las" else None
    return None if header is None else header.scales


def _write(
    job: Job,
    registration: Registration,
    source: PointCloud,
    target: PointCloud,
    fused: FusedCloud | None,
    document: Mapping[str, Any],
) -> tuple[Path, ...]:
    from tmchho import write
    from tmchho.moving import turned
    from tmchho.outputs import (
        FUSED,
        REPORT_POINTS,
        RESULT,
        SOURCE_REGISTERED,
        json_text,
        moved_source,
        pose_files,
    )
    from tmchho.report.points import points_of
    from tmchho.transform import Transform

    # Listed first, result.json appears last: where it is, the others are.
    files = {RESULT: lambda path: path.write_text(json_text(document), encoding="utf-8", newline="\n")}
    points = points_of(registration, source, target, fused)
    files[REPORT_POINTS] = points.save
    if fused is not None:
        merged = fused.to_point_cloud(turned(source, Transform.of(registration)), target)
        moved = moved_source(registration, source, target)
        files |= {
            **pose_files(registration, str(job.source), source.crs, target.crs, scales_of(target)),
            SOURCE_REGISTERED: lambda path: write(moved, path, like=target),
            FUSED: lambda path: write(merged, path, like=target),
        }
    return write_results(job, files)


def write_results(job: Job, files: Mapping[str, Callable[[Path], object]]) -> tuple[Path, ...]:
    """Write the files of a registration, and remove those of an earlier one; return their paths."""
    from tmchho.outputs import OUTPUTS, REPORT, REPORT_PDF, write_together

    paths = (job.source, job.target)
    others = (*OUTPUTS, REPORT, REPORT_PDF)
    write_together(job.folder, files, overwrite=job.overwrite, inputs=paths, others=others)
    return tuple(job.folder / name for name in OUTPUTS if name in files)


def _reported(outcome: Outcome, job: Job, shown: Display) -> Outcome:
    """Make the report from what was just written; without the libraries for it, say so and go on."""
    from tmchho.report import missing_extras, write_report

    if not job.has_report:
        return outcome
    missing = missing_extras()
    if missing is not None:
        shown.note(f"{job.folder / 'report.html'} was not made: {missing}")
        return outcome
    with shown.step("report", "making the report"):
        return replace(outcome, files=(*outcome.files, *write_report(job.folder)))
