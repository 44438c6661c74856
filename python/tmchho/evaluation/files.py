"""The files that an evaluation leaves: clouds with distances, coloured ones with a legend, tables.

What each file is called and holds is said here, also for files that are written in parts.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tmchho.cloud import PointCloud
from tmchho.evaluation.change import Change
from tmchho.evaluation.colours import ColourScale
from tmchho.evaluation.distances import SIGNED, Evaluation
from tmchho.io import write
from tmchho.outputs import json_text, write_together
from tmchho.transform import about_middle

EVALUATION, AREAS, LEGEND = "evaluation.json", "areas.csv", "legend.csv"
CHANGE = "change"
FORMS = ("laz", "csv", "coloured-laz", "coloured-ply")
# How the distances are called in clouds: CloudCompare's names, with lines in place of blanks.
NAMES = {
    "nearest": "C2C_absolute_distances",
    "plane": "C2C_plane_distances",
    "normal": "C2C_signed_distances",
    "vertical": "vertical_distances",
}


def distance_clouds(
    result: Evaluation, source: PointCloud, target: PointCloud, matrix: NDArray[np.float64]
) -> dict[str, PointCloud]:
    """Return both clouds with their distances, in the frame of the target.

    Parameters
    ----------
    result : Evaluation
        What was measured.
    source, target : PointCloud
        The clouds that were measured.
    matrix : (4, 4) float64 array
        The pose at which they were.

    Returns
    -------
    dict of str to PointCloud
        ``"source_to_target"`` with the source's points and attributes and ``"target_to_source"`` with the
        target's; points with a coordinate that is not finite are left out.
    """
    name = NAMES[result.method]
    moved = source
    if not np.array_equal(matrix, np.eye(4)):
        middle = source.xyz[np.isfinite(source.xyz).all(axis=1)].mean(axis=0)
        xyz = about_middle(matrix, middle).apply(source.xyz)
        moved = replace(source, xyz=xyz, crs=target.crs)
    clouds = {}
    for direction, cloud, distances in (
        ("source_to_target", moved, result.source_to_target),
        ("target_to_source", target, result.target_to_source),
    ):
        rows = np.isfinite(cloud.xyz).all(axis=1)
        attributes = {key: np.asarray(values)[rows] for key, values in cloud.attributes.items()}
        attributes[name] = distances[rows]
        clouds[direction] = replace(cloud, xyz=cloud.xyz[rows], attributes=attributes)
    return clouds


def write_evaluation(
    folder: Path,
    result: Evaluation | Change,
    source: PointCloud,
    target: PointCloud,
    matrix: NDArray[np.float64],
    document: Mapping[str, Any],
    *,
    forms: Iterable[str] = FORMS[:3],
    overwrite: bool = False,
    inputs: Iterable[Path] = (),
) -> tuple[Path, ...]:
    """Write what was measured into a folder: all files or none.

    Parameters
    ----------
    folder : path
        Made if it does not exist.
    result : Evaluation or Change
        What was measured.
    source, target : PointCloud
        The clouds that were measured.
    matrix : (4, 4) float64 array
        The pose at which they were.
    document : mapping
        What ``evaluation.json`` holds.
    forms : iterable of str, default laz, csv and coloured-laz
        In which forms each cloud is written; also ``"coloured-ply"``. A coloured cloud has the colours of the
        classes in ``legend.csv`` instead of its own; csv holds coordinates and distances alone.
    overwrite : bool, default False
        Replace existing files.
    inputs : iterable of path
        Files that must never be replaced.

    Returns
    -------
    tuple of path
        The files written.

    Raises
    ------
    WriteError
        If one of them cannot be written; then none stays behind.
    """
    significant: NDArray[np.bool_] | None = None
    name, is_signed = measure(None if isinstance(result, Change) else result.method)
    if isinstance(result, Change):
        clouds = {CHANGE: result.to_point_cloud(target.crs)}
        significant = clouds[CHANGE].attributes["significant_change"].astype(bool)
    else:
        clouds = distance_clouds(result, source, target, matrix)
    every = np.concatenate([cloud.attributes[name] for cloud in clouds.values()])
    scale = ColourScale.of(every, is_signed=is_signed, tolerance=result.tolerance)

    files = tables(document)
    chosen = tuple(forms)
    for direction, cloud in clouds.items():
        colours = scale.apply(cloud.attributes[name], significant)
        for form in chosen:
            written = in_form(cloud, direction, form, colours, name)
            files[file_name(direction, form)] = _writer(written, target)
    if any(form.startswith("coloured") for form in chosen):
        files |= tables(document, scale.legend(every, significant))
    write_together(folder, files, overwrite=overwrite, inputs=inputs)
    return tuple(folder / file for file in files)


def measure(method: str | None) -> tuple[str, bool]:
    """Return what a method's lengths are called in clouds, and whether they have a sign; None is a change."""
    return ("M3C2_distance", True) if method is None else (NAMES[method], method in SIGNED)


def file_name(direction: str, form: str) -> str:
    """Return what the file of a cloud in one of its `FORMS` is called.

    Examples
    --------
    >>> file_name("change", "csv"), file_name("source_to_target", "coloured-laz")
    ('change.csv', 'source_to_target_coloured.laz')
    """
    extension = form.rpartition("-")[2]
    return f"{direction}_coloured.{extension}" if form.startswith("coloured") else f"{direction}.{extension}"


def in_form(
    cloud: PointCloud, direction: str, form: str, colours: Mapping[str, NDArray[Any]], name: str
) -> PointCloud:
    """Return a cloud with what one of its `FORMS` holds of it; `name` is its measured length."""
    if form.startswith("coloured"):
        return replace(cloud, attributes={**cloud.attributes, **colours})
    if form == "csv" and direction != CHANGE:  # as text, attributes take ten times the room
        return replace(cloud, attributes={name: cloud.attributes[name]})
    return cloud


def tables(
    document: Mapping[str, Any], legend: Sequence[Mapping[str, Any]] | None = None
) -> dict[str, Callable[[Path], object]]:
    """Return what writes ``evaluation.json``, ``areas.csv`` and, if there is one, ``legend.csv``."""
    files: dict[str, Callable[[Path], object]] = {
        EVALUATION: lambda path: path.write_text(json_text(document), encoding="utf-8", newline="\n"),
        AREAS: lambda path: _write_table(path, [_area_row(row) for row in document["areas"]], _AREA_COLUMNS),
    }
    if legend is not None:
        files[LEGEND] = lambda path: _write_table(path, legend, tuple(legend[0]))
    return files


_AREA_COLUMNS = (
    *("area", "n_points", "avg", "best", "worst", "std", "rms", "median", "percentile_95"),
    *("share_within", "share_significant", "n_beyond", "completeness_before", "completeness_after", "remark"),
)


def _area_row(row: Mapping[str, Any]) -> dict[str, Any]:
    """Return a row of the result under the column names of the article's Table 7."""
    return {**row, "area": row["name"], "avg": row["mean"]}


def _write_table(path: Path, rows: Sequence[Mapping[str, Any]], columns: Sequence[str]) -> None:
    with path.open("w", encoding="utf-8", newline="") as stream:
        table = csv.writer(stream, lineterminator="\n")
        table.writerow(columns)
        for row in rows:
            table.writerow("" if row[column] is None else row[column] for column in columns)


def _writer(cloud: PointCloud, target: PointCloud) -> Callable[[Path], None]:
    return lambda path: write(cloud, path, like=target)
