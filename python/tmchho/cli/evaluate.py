"""`tmchho evaluate`: how far two clouds lie apart."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from tmchho.cli.display import Display, display
from tmchho.cli.failures import EXIT_CODES, debug_option
from tmchho.cli.options import (
    PATH,
    areas_option,
    boxes,
    json_option,
    max_memory_option,
    output_option,
    overwrite_option,
    positive,
    quiet_option,
    tolerance_option,
)

if TYPE_CHECKING:
    from tmchho import Area, Change, Evaluation

_EXAMPLES = """\b
Examples:
  tmchho evaluate uav.laz tls.laz --transform out/result.json --areas areas.geojson --tolerance 0.05 -o check
  # what changed between two epochs, and what of it is more than noise
  tmchho evaluate june.laz may.laz --method m3c2 --registration-error 0.004 -o change

"""

# Heading, and what it is called in a row of the result; the first four as in the article's Table 7.
_COLUMNS = {
    "Avg": "mean",
    "Best": "best",
    "Worst": "worst",
    "Std": "std",
    "RMS": "rms",
    "Median": "median",
    "95 %": "percentile_95",
}
_FORMS = ("laz", "csv", "coloured-laz", "coloured-ply")


@click.command(short_help="Measure how far two clouds lie apart.", epilog=_EXAMPLES + EXIT_CODES)
@click.argument("source", type=PATH)
@click.argument("target", type=PATH)
@output_option()
@click.option(
    "--transform",
    type=PATH,
    metavar="FILE",
    help="transform.txt or result.json that takes SOURCE to TARGET.  [default: as they lie]",
)
@click.option(
    "--method",
    type=click.Choice(["nearest", "plane", "normal", "vertical", "m3c2"]),
    default="nearest",
    help="To the nearest point (default), to a plane through the points there, signed along its normal or "
    "along z, or M3C2: change along the normal with its level of detection.",
)
@areas_option
@click.option(
    "--area-box",
    "area_boxes",
    multiple=True,
    callback=boxes,
    metavar="BOX",
    help="[NAME=]xmin,ymin,xmax,ymax, or with heights xmin,ymin,zmin,xmax,ymax,zmax: one more area. Can be "
    "repeated.",
)
@tolerance_option
@click.option(
    "--max-distance",
    type=float,
    callback=positive,
    metavar="LENGTH",
    help="Points farther away have no counterpart and are counted apart.  [default: all are measured]",
)
@click.option(
    "--registration-error",
    type=click.FloatRange(min=0),
    metavar="LENGTH",
    help="M3C2: what the pose may be wrong by, 1 sigma.  [default: that of --transform result.json]",
)
@click.option(
    "--cylinder-radius",
    type=float,
    callback=positive,
    metavar="LENGTH",
    help="M3C2: where points are averaged.  [default: 20 points of the sparser cloud]",
)
@click.option(
    "--normal-radius",
    type=float,
    multiple=True,
    metavar="LENGTH",
    help="M3C2: where normals are sought; repeated, the flattest is taken.  [default: from the roughness]",
)
@click.option(
    "--max-depth",
    type=float,
    callback=positive,
    metavar="LENGTH",
    help="M3C2: how far cylinders reach to either side.  [default: ten radii]",
)
@click.option(
    "--form",
    "forms",
    type=click.Choice(_FORMS),
    multiple=True,
    default=_FORMS[:3],
    help="Forms in which clouds are written. Can be repeated.  [default: laz, csv, coloured-laz]",
)
@max_memory_option
@json_option
@quiet_option
@overwrite_option
@debug_option
def evaluate(
    source: Path,
    target: Path,
    output: Path | None,
    transform: Path | None,
    as_json: bool,
    quiet: bool,
    overwrite: bool,
    **options: Any,
) -> None:
    """Measure the distances from each point of SOURCE to TARGET, and the other way round.

    The distances are in the unit of the clouds. Where the clouds overlap only in part, the largest ones tell
    of the overlap, not of the fit: see --max-distance.

    \b
    Writes into the folder given with -o:
      source_to_target.laz/.csv   SOURCE in the frame of TARGET, with a distance for each point
      target_to_source.laz/.csv   TARGET with its distances
      *_coloured.laz, legend.csv  the same in colours, and what they mean
      areas.csv                   the figures by area, as the article's Table 7
      evaluation.json             all figures and settings

    With --method m3c2, change.* holds the cores in place of the clouds.
    """  # noqa: D301 (\b is for click: keep these lines as they are)
    import numpy as np

    from tmchho.outputs import check_folder, json_text, read_matrix
    from tmchho.streams import default_max_memory, needs_streams

    matrix = np.eye(4) if transform is None else read_matrix(transform)
    if output is not None:
        check_folder(output, names=(), overwrite=overwrite, inputs=(source, target))
    job = EvaluationJob(source, target, matrix, transform, output, overwrite, options)
    allowed = options["max_memory"] or default_max_memory()
    with display(quiet) as shown:
        if needs_streams((source, target), allowed):
            from tmchho.cli.streamed_evaluate import evaluate_in_parts

            document, written = evaluate_in_parts(job, shown, allowed)
        else:
            document, written = _evaluate(job, shown)
    if as_json:
        click.echo(json_text(document), nl=False)
    else:
        click.echo("\n\n".join([*_tables(document), *_written(written)]))


@dataclass(frozen=True)
class EvaluationJob:
    """Two files to measure, where they lie, and what was asked for."""

    source: Path
    target: Path
    matrix: Any
    transform: Path | None
    output: Path | None
    overwrite: bool
    options: Mapping[str, Any]

    def areas(self, crs: str | None) -> list[Area]:
        """Return the areas that were asked for, in the target's system."""
        from tmchho.evaluation import read_areas

        given = self.options["areas"]
        return [*([] if given is None else read_areas(given, crs)), *self.options["area_boxes"]]

    @property
    def for_distances(self) -> dict[str, Any]:
        """Arguments of `tmchho.evaluate`."""
        return {name: self.options[name] for name in ("method", "tolerance", "max_distance")}

    @property
    def for_change(self) -> dict[str, Any]:
        """Arguments of `tmchho.m3c2`."""
        error = self.options["registration_error"]
        return {
            "normal_radii": self.options["normal_radius"] or None,
            "cylinder_radius": self.options["cylinder_radius"],
            "max_depth": self.options["max_depth"],
            "registration_error": _recorded_error(self.transform) if error is None else error,
            "tolerance": self.options["tolerance"],
        }

    def document(self, result: Any) -> dict[str, Any]:
        """Return what ``evaluation.json`` holds."""
        return {
            "source": self.source.name,
            "target": self.target.name,
            "transformation": self.matrix.tolist(),
            **result.to_dict(),
        }


def _evaluate(job: EvaluationJob, shown: Display) -> tuple[dict[str, Any], tuple[Path, ...]]:
    """Measure both files as wholes."""
    from tmchho import evaluate, m3c2, read
    from tmchho.evaluation.files import write_evaluation
    from tmchho.io.unchanged import Unchanged

    unchanged = Unchanged((job.source, job.target))
    clouds = []
    for path in (job.source, job.target):
        with shown.step("read", f"reading {path}"):
            clouds.append(read(path))
    source, target = clouds
    with shown.step("evaluate", "measuring"):
        areas: Any = job.areas(target.crs) or "automatic"
        result: Evaluation | Change
        if job.options["method"] == "m3c2":
            result = m3c2(source, target, job.matrix, areas=areas, **job.for_change)
        else:
            result = evaluate(source, target, job.matrix, areas=areas, **job.for_distances)
    for warning in result.warnings:
        shown.warn(warning)
    unchanged.check()
    document = job.document(result)
    written: tuple[Path, ...] = ()
    if job.output is not None:
        with shown.step("write", "writing"):
            written = write_evaluation(
                job.output,
                result,
                source,
                target,
                job.matrix,
                document,
                forms=job.options["forms"],
                overwrite=job.overwrite,
                inputs=(job.source, job.target),
            )
    return document, written


def _recorded_error(transform: Path | None) -> float | None:
    """Return the error of the registration that a result.json records, None where there is none."""
    import json

    if transform is None:
        return None
    text = transform.read_text(encoding="utf-8-sig")
    error = json.loads(text).get("registration_error") if text.lstrip().startswith("{") else None
    return None if error is None else float(error)


def _tables(document: Mapping[str, Any]) -> list[str]:
    directions = [name for name in ("source_to_target", "target_to_source") if name in document]
    whole = [(name.replace("_", " "), document[name]) for name in directions]
    significant = [] if document["method"] != "m3c2" else [("significant", "share_significant")]
    tables = [_table("", whole, None if significant else document["tolerance"], significant)]
    if document["areas"]:
        covered = [("target covers", "completeness_before"), ("both cover", "completeness_after")]
        rows = [(row["name"], row) for row in document["areas"]]
        heading = "target to source" if significant else "source to target"
        tables.append(_table(heading, rows, document["tolerance"], [*significant, *covered]))
    return tables


def _table(
    heading: str,
    rows: Sequence[tuple[str, Mapping[str, Any]]],
    tolerance: float | None,
    shares: Sequence[tuple[str, str]],
) -> str:
    """Return rows under headings; `shares` are further columns in percent."""
    shares = [*([] if tolerance is None else [(f"within {tolerance:g}", "share_within")]), *shares]
    beyond = any(row["n_beyond"] for _, row in rows)
    lines = [[heading, "points", *(["beyond"] if beyond else []), *_COLUMNS, *(title for title, _ in shares)]]
    for name, row in rows:
        cells = [name, f"{row['n_points']:,}", *([f"{row['n_beyond']:,}"] if beyond else [])]
        lengths = [row.get(key) for key in _COLUMNS.values()]
        cells += ["no data" if value is None else f"{value:.5g}" for value in lengths]
        percents = [row.get(key) for _, key in shares]
        cells += ["no data" if value is None else f"{100 * value:.1f} %" for value in percents]
        lines.append(cells)
    widths = [max(len(cells[column]) for cells in lines) for column in range(len(lines[0]))]
    return "\n".join(
        "  ".join([cells[0].ljust(widths[0]), *map(str.rjust, cells[1:], widths[1:])]).rstrip()
        for cells in lines
    )


def _written(files: Sequence[Path]) -> list[str]:
    return ["\n".join(["written:", *(f"  {path}" for path in files)])] if files else []
