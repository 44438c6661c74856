"""`tmchho evaluate` for files that are larger than memory: the same figures and files, part by part."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tmchho.cli.display import Display
from tmchho.cli.streamed import open_in_parts
from tmchho.errors import TmchhoError, WriteError

if TYPE_CHECKING:
    from tmchho.cli.evaluate import EvaluationJob
    from tmchho.streams import StreamedChange, StreamedEvaluation


def evaluate_in_parts(
    job: EvaluationJob, shown: Display, max_memory: int
) -> tuple[dict[str, Any], tuple[Path, ...]]:
    """Measure two LAS or LAZ files within about `max_memory` bytes; return the document and the files.

    Raises
    ------
    TmchhoError
        As its class says; no file was written then.
    """
    from tmchho.io.unchanged import Unchanged
    from tmchho.streams import evaluate_files, m3c2_files, write_streamed_evaluation

    unchanged = Unchanged((job.source, job.target))
    source, target = open_in_parts((job.source, job.target), max_memory, shown)
    areas = job.areas(target.crs) or None
    with scratch_in(job.output) as scratch:
        with shown.step("evaluate", "measuring in tiles"):
            result: StreamedEvaluation | StreamedChange
            if job.options["method"] == "m3c2":
                result = m3c2_files(
                    source,
                    target,
                    job.matrix,
                    folder=scratch,
                    areas=areas,
                    max_memory=max_memory,
                    **job.for_change,
                )
            else:
                result = evaluate_files(
                    source,
                    target,
                    job.matrix,
                    folder=scratch,
                    areas=areas,
                    max_memory=max_memory,
                    **job.for_distances,
                )
        for warning in result.warnings:
            shown.warn(warning)
        unchanged.check()
        document = job.document(result)
        written: tuple[Path, ...] = ()
        if job.output is not None:
            with shown.step("write", "writing"):
                written = write_streamed_evaluation(
                    job.output,
                    result,
                    source,
                    target,
                    job.matrix,
                    document,
                    scratch=scratch,
                    forms=job.options["forms"],
                    overwrite=job.overwrite,
                )
    return document, written


@contextmanager
def scratch_in(folder: Path | None) -> Iterator[Path]:
    """Lend a folder for intermediate files: within `folder`, or where the machine keeps such files."""
    from tmchho.outputs import staging

    if folder is not None:
        with staging(folder) as scratch:
            yield scratch
        return
    place = Path(tempfile.gettempdir())
    try:
        with tempfile.TemporaryDirectory(prefix="tmchho-") as made:
            yield Path(made)
    except TmchhoError:
        raise
    except OSError as error:
        raise WriteError(
            f"{place}: the intermediate files, about 24 bytes a point, cannot be written there "
            f"({error.strerror or error}); make room, or name another folder in the variable TMPDIR"
        ) from error
