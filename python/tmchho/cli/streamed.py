"""The route of files that are larger than memory: the same results, part by part."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tmchho.cli.crs import crs_name
from tmchho.cli.display import Display
from tmchho.cli.workflow import Job, Outcome, check_crs, write_results
from tmchho.errors import BudgetError, WriteError

if TYPE_CHECKING:
    from tmchho import Registration
    from tmchho.io.las_stream import LasPoints
    from tmchho.selection import Selection
    from tmchho.streams.thin import Keep


def run_streamed(job: Job, shown: Display, max_memory: int) -> Outcome:
    """Register two LAS or LAZ files and write what came of it, within `max_memory` bytes, about.

    Raises
    ------
    TmchhoError
        As its class says; no file was written then.
    """
    from tmchho import PointCloud, read_areas
    from tmchho.io.unchanged import Unchanged
    from tmchho.outputs import (
        FUSED,
        REPORT_POINTS,
        RESULT,
        SOURCE_REGISTERED,
        InputFile,
        json_text,
        pose_files,
        result_document,
        staging,
    )
    from tmchho.report.described import describe_parts
    from tmchho.report.fused_points import points_of_fused_file
    from tmchho.report.points import points_of
    from tmchho.streams import fuse_files, register_files
    from tmchho.transform import Transform

    paths = (job.source, job.target)
    unchanged = Unchanged(paths)
    source, target = open_in_parts(paths, max_memory, shown)
    if source.header.has_waveforms:
        raise WriteError(
            f"{job.source}: LAZ cannot hold waveforms; convert the file to a format without them"
        )
    check_crs(
        *((str(file.path), file.crs, file.header.minima, file.header.maxima) for file in (source, target)),
        assume_same=job.assume_same_crs,
        shown=shown,
    )
    areas = None if job.areas is None else read_areas(job.areas, target.crs)
    with shown.step("read", "taking checksums"):
        files = (InputFile.of(job.source, len(source)), InputFile.of(job.target, len(target)))
    keeps = [
        _keep(selection, file)
        for selection, file in zip(job.selections or (None, None), (source, target), strict=True)
    ]
    with shown.step("register", "thinning both files"):
        found = register_files(
            job.source,
            job.target,
            config=job.settings,
            max_memory=max_memory,
            keep_source=keeps[0],
            keep_target=keeps[1],
            progress=shown.on_event,
        )
    registration = found.registration

    def document_of(of: Registration, fused: Mapping[str, Any] | None) -> dict[str, Any]:
        document = result_document(of, *files, fused, job.command)
        for side, file in (("source", source), ("target", target)):
            told = describe_parts(file, crs_name(file.crs))
            document["inputs"][side] = {**document["inputs"][side], **told}
        return document

    if registration.verdict == "rejected":
        document = document_of(registration, None)
        text = json_text(document)
        thinned = PointCloud(found.source.points), PointCloud(found.target.points)
        rejected: dict[str, Callable[[Path], object]] = {
            RESULT: lambda path: path.write_text(text, encoding="utf-8", newline="\n"),
            REPORT_POINTS: points_of(registration, *thinned, None).save,
        }
        unchanged.check()
        return Outcome(registration, document, write_results(job, rejected))
    options = registration.config["fuse"]
    with staging(job.folder) as scratch:
        with shown.step("fuse", "measuring and fusing in tiles"):
            fusion = fuse_files(
                source,
                target,
                found.source,
                found.target,
                Transform.of(registration),
                scratch / FUSED,
                scratch / SOURCE_REGISTERED,
                folder=scratch,
                mode=options["mode"],
                hole_radius=options["hole_radius_m"],
                max_distance=registration.max_distance,
                max_memory=max_memory,
                areas=areas,
                tolerance=job.tolerance,
            )
        registration = replace(
            registration,
            source_to_target=fusion.source_to_target,
            target_to_source=fusion.target_to_source,
            overlap_of_source=fusion.overlap_of_source,
            overlap_of_target=fusion.overlap_of_target,
        )
        document = document_of(registration, fusion.report) | fusion.entries
        document["in_parts"] = {
            "max_memory": max_memory,
            "source_voxel_size": found.source.voxel_size,
            "target_voxel_size": found.target.voxel_size,
            "distances_exact_up_to": fusion.exact_up_to,
            "error_of_larger_distances": fusion.far_error,
            "seconds": found.seconds | fusion.seconds,
        }
        text = json_text(document)
        shown_points = points_of_fused_file(scratch / FUSED, registration.seed, registration.voxel_size)
        outputs: dict[str, Callable[[Path], object]] = {
            RESULT: lambda path: path.write_text(text, encoding="utf-8", newline="\n"),
            REPORT_POINTS: shown_points.save,
            **pose_files(registration, str(job.source), source.crs, target.crs, target.header.scales),
            SOURCE_REGISTERED: lambda path: os.replace(scratch / SOURCE_REGISTERED, path),
            FUSED: lambda path: os.replace(scratch / FUSED, path),
        }
        unchanged.check()
        with shown.step("write", "writing"):
            written = write_results(job, outputs)
    return Outcome(registration, document, written)


def open_in_parts(paths: tuple[Path, Path], max_memory: int, shown: Display) -> tuple[LasPoints, LasPoints]:
    """Open two files that are too large to be read as wholes; `BudgetError` if one is neither LAS nor LAZ."""
    from tmchho.io import is_las, open_las
    from tmchho.room import check_room_for_parts

    check_room_for_parts()
    for path in paths:
        if not is_las(path):
            raise BudgetError(
                f"{path}: together with the other file needs more memory than is allowed, and only LAS and "
                "LAZ can be read in parts; convert it to LAZ, or allow more with --max-memory"
            )
    source, target = map(open_las, paths)
    shown.note(
        f"{len(source):,} and {len(target):,} points do not fit into {max_memory / 1e9:.3g} GB: "
        "they are worked on in parts"
    )
    return source, target


def _keep(selection: Selection | None, file: LasPoints) -> Keep | None:
    """Return what chooses the points of a part, None where all are kept."""
    if not selection:
        return None
    return lambda xyz, records: selection.keep(
        xyz, file.attributes(records) if selection.classes else {}, str(file.path)
    )
