"""The route of the files: check, read, register, fuse, write. `register` and `demo` share it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tmchho.cli.crs import crs_name, is_geographic
from tmchho.cli.display import Display
from tmchho.errors import InvalidCloudError

if TYPE_CHECKING:
    from tmchho import Config, FusedCloud, PointCloud, Registration

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
    areas: Path | None = None
    tolerance: float | None = None
    has_report: bool = True


@dataclass(frozen=True)
class Outcome:
    """What came of it: the fused cloud is None where the pose was rejected."""

    registration: Registration
    fused: FusedCloud | None
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
        Gets the source cloud and the registration, and returns further entries of ``result.json``.

    Returns
    -------
    Outcome

    Raises
    ------
    TmchhoError
        As its class says; no file was written then.
    """
    from tmchho import fuse, read_areas, register
    from tmchho.evaluation import distance_entries
    from tmchho.outputs import OUTPUTS, REPORT, InputFile, check_folder, result_document
    from tmchho.report.described import describe

    paths = (job.source, job.target)
    check_folder(job.folder, names=(*OUTPUTS, REPORT), overwrite=job.overwrite, inputs=paths)
    source, target = (_read(path, shown) for path in paths)
    _compare_crs(source, target, shown)
    areas = None if job.areas is None else read_areas(job.areas, target.crs)
    with shown.step("read", "taking checksums"):
        files = (InputFile.of(job.source, len(source)), InputFile.of(job.target, len(target)))
    with shown.step("register"):
        registration = register(source, target, config=job.settings, progress=shown.on_event)
    for path, n_dropped in zip(paths, registration.n_non_finite, strict=True):
        if n_dropped:
            shown.warn(f"{path}: {n_dropped:,} points left out because a coordinate is not finite")
    fused = None
    if registration.verdict != "rejected":
        options = registration.config["fuse"]
        with shown.step("fuse", "fusing"):
            fused = fuse(
                source, target, registration, mode=options["mode"], hole_radius=options["hole_radius_m"]
            )
    document = result_document(registration, *files, fused, job.command)
    for side, cloud in (("source", source), ("target", target)):
        document["inputs"][side] = {**document["inputs"][side], **describe(cloud, crs_name(cloud.crs))}
    if fused is not None:
        with shown.step("evaluate", "summing up by area"):
            document |= distance_entries(registration, source, target, fused, areas, job.tolerance)
    if remarks is not None:
        document |= remarks(source, registration)
    with shown.step("write", "writing"):
        written = _write(job, registration, source, target, fused, document)
    if job.has_report:
        written += _report(job.folder, shown)
    return Outcome(registration, fused, document, written)


def _read(path: Path, shown: Display) -> PointCloud:
    from tmchho import read

    with shown.step("read", f"reading {path}"):
        cloud = read(path)
    shown.note(f"{path}: {len(cloud):,} points")
    return cloud


def _compare_crs(source: PointCloud, target: PointCloud, shown: Display) -> None:
    for cloud in (source, target):
        if is_geographic(cloud.crs):
            raise InvalidCloudError(
                f"{cloud.name}: coordinates are degrees of {crs_name(cloud.crs)}, in which no rigid pose "
                "exists; project the cloud to metres first"
            )
    if source.crs is not None and target.crs is not None and source.crs != target.crs:
        shown.warn(
            f"{source.name} is in {crs_name(source.crs)}, {target.name} in {crs_name(target.crs)}; "
            "the result is in that of the target"
        )


def _write(
    job: Job,
    registration: Registration,
    source: PointCloud,
    target: PointCloud,
    fused: FusedCloud | None,
    document: Mapping[str, Any],
) -> tuple[Path, ...]:
    from tmchho import write
    from tmchho.outputs import (
        FUSED,
        OUTPUTS,
        REPORT,
        REPORT_PDF,
        REPORT_POINTS,
        RESULT,
        SOURCE_REGISTERED,
        TRANSFORM,
        json_text,
        matrix_text,
        moved_source,
        write_together,
    )
    from tmchho.report.points import points_of

    # Listed first, result.json appears last: where it is, the others are.
    files = {RESULT: lambda path: path.write_text(json_text(document), encoding="utf-8", newline="\n")}
    points = points_of(registration, source, target, fused)
    files[REPORT_POINTS] = points.save
    if fused is not None:
        merged = fused.to_point_cloud(source, target)
        moved = moved_source(registration, source, target)
        files |= {
            TRANSFORM: lambda path: path.write_text(
                matrix_text(registration.transformation), encoding="utf-8"
            ),
            SOURCE_REGISTERED: lambda path: write(moved, path, like=target),
            FUSED: lambda path: write(merged, path, like=target),
        }
    write_together(job.folder, files, overwrite=job.overwrite, inputs=(job.source, job.target))
    for name in {*OUTPUTS, REPORT, REPORT_PDF} - set(files):
        # Left from an earlier run, it would be taken for the result of this one.
        (job.folder / name).unlink(missing_ok=True)
    return tuple(job.folder / name for name in OUTPUTS if name in files)


def _report(folder: Path, shown: Display) -> tuple[Path, ...]:
    """Make the report from what was just written; without the libraries for it, say so and go on."""
    from tmchho.report import missing_extras, write_report

    missing = missing_extras()
    if missing is not None:
        shown.note(f"{folder / 'report.html'} was not made: {missing}")
        return ()
    with shown.step("report", "making the report"):
        return write_report(folder)
