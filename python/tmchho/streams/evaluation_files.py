"""The files of an evaluation, written part by part: one run through each input makes all forms of it."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tmchho.cloud import PointCloud
from tmchho.evaluation.change import change_cloud
from tmchho.evaluation.colours import ColourScale
from tmchho.evaluation.files import CHANGE, FORMS, file_name, in_form, measure, tables
from tmchho.evaluation.lengths import quantile_of_parts
from tmchho.io import las_parts, writing_las
from tmchho.io.las_grid import Grid, fitted_grid
from tmchho.io.las_stream import LasPoints
from tmchho.io.las_write import writing_las_parts
from tmchho.io.ply import writing_ply_parts
from tmchho.io.text import writing_csv_parts
from tmchho.outputs import write_together
from tmchho.streams.change import StreamedChange
from tmchho.streams.evaluate import StreamedEvaluation
from tmchho.transform import about_middle

Floats = NDArray[np.float64]
Parts = Iterator[tuple[PointCloud, NDArray[np.bool_] | None]]
Put = Callable[[PointCloud], None]


def write_streamed_evaluation(
    folder: Path,
    result: StreamedEvaluation | StreamedChange,
    source: LasPoints,
    target: LasPoints,
    matrix: Floats,
    document: Mapping[str, Any],
    *,
    scratch: Path,
    forms: Iterable[str] = FORMS[:3],
    overwrite: bool = False,
) -> tuple[Path, ...]:
    """Do what `tmchho.evaluation.files.write_evaluation` does, within bounded memory.

    Clouds keep the point format of the file that they come from, and cores are in the order of the tiles.

    Parameters
    ----------
    folder, result, source, target, matrix, document, forms, overwrite
        As there.
    scratch : Path
        A folder on the same disk for files on their way.

    Returns
    -------
    tuple of path
        The files written.

    Raises
    ------
    WriteError
        If one of them cannot be written; then none stays behind.
    """
    chosen = tuple(forms)
    name, is_signed = measure(None if isinstance(result, StreamedChange) else result.method)
    usual = quantile_of_parts(lambda: _amounts(result), 0.95)
    scale = ColourScale.reaching(
        0.0 if np.isnan(usual) else usual, is_signed=is_signed, tolerance=result.tolerance
    )
    counts = np.zeros(len(scale.colours) + 3, dtype=np.int64)
    made: list[str] = []
    for direction, parts, n_points, kept, grid in _clouds(result, source, target, matrix, name):
        names = [file_name(direction, form) for form in chosen]
        made += names
        with ExitStack() as stack:
            writers: list[Put] = []
            for cloud, significant in parts:
                colours = scale.apply(cloud.attributes[name], significant)
                counts += scale.counts(cloud.attributes[name], significant)
                for number, form in enumerate(chosen):
                    given = in_form(cloud, direction, form, colours, name)
                    if number == len(writers):
                        path = scratch / names[number]
                        stack.enter_context(writing_las(path))
                        writers.append(stack.enter_context(_writer(path, given, n_points, kept, grid)))
                    writers[number](given)
    has_colours = any(form.startswith("coloured") for form in chosen)
    has_significance = isinstance(result, StreamedChange)
    legend = scale.legend_of(counts, has_significance=has_significance) if has_colours else None
    files = tables(document, legend)
    for file in made:
        if (scratch / file).exists():
            files[file] = _moving(scratch / file)
    write_together(folder, files, overwrite=overwrite, inputs=(source.path, target.path))
    return tuple(folder / file for file in files)


def _amounts(result: StreamedEvaluation | StreamedChange) -> Iterator[Floats]:
    if isinstance(result, StreamedChange):
        every: Iterable[Floats] = (part["distance"] for part in result.parts())
    else:
        every = (part for side in (result.source_to_target, result.target_to_source) for part in side.parts())
    return (np.abs(part[np.isfinite(part)]) for part in every)


def _clouds(
    result: StreamedEvaluation | StreamedChange,
    source: LasPoints,
    target: LasPoints,
    matrix: Floats,
    name: str,
) -> Iterator[tuple[str, Parts, int, dict[str, Any], Grid]]:
    """Give each cloud that is written: its name, parts, number of points, the layout to keep, the grid."""
    if isinstance(result, StreamedChange):
        yield CHANGE, _cores(result, target), result.n_cores, _kept(target), _grid(target)
        return
    standing = np.array_equal(matrix, np.eye(4))
    header = source.header
    middle = (np.array(header.minima) + np.array(header.maxima)) / 2
    transform = None if standing else about_middle(matrix, middle)

    def parts(file: LasPoints, of: Any, moves: bool, crs: str | None) -> Parts:
        start = 0
        for records in las_parts(file):
            xyz = file.xyz(file.steps(records))
            xyz = transform.apply(xyz) if moves and transform is not None else xyz
            attributes = file.attributes(records)
            attributes[name] = of.part(start, start + len(records))
            start += len(records)
            yield PointCloud(xyz, attributes, crs=crs, name=str(file.path)), None

    grid = _grid(source if standing else target)
    if not grid.holds(*result.source_box):
        grid = fitted_grid(*result.source_box, np.abs(grid.scales))
    moved_crs = source.crs if standing else target.crs
    forth, back = result.source_to_target, result.target_to_source
    yield "source_to_target", parts(source, forth, True, moved_crs), len(source), _kept(source), grid
    yield (
        "target_to_source",
        parts(target, back, False, target.crs),
        len(target),
        _kept(target),
        _grid(target),
    )


def _cores(result: StreamedChange, target: LasPoints) -> Parts:
    for part in result.parts():
        cloud = change_cloud({name: part[name] for name in part.dtype.names or ()}, target.crs)
        yield cloud, cloud.attributes["significant_change"].astype(bool)


def _kept(file: LasPoints) -> dict[str, Any]:
    return {"format": "las", "header": file.header, "extra_dimensions": file.extra, "crs": file.crs}


def _grid(file: LasPoints) -> Grid:
    return Grid(np.array(file.header.scales), np.array(file.header.offsets))


def _writer(path: Path, first: PointCloud, n_points: int, kept: dict[str, Any], grid: Grid) -> Any:
    if path.suffix == ".csv":
        return writing_csv_parts(path, first)
    if path.suffix == ".ply":
        return writing_ply_parts(path, first, n_points, kept)
    return writing_las_parts(path, first, kept, grid)


def _moving(path: Path) -> Callable[[Path], object]:
    return lambda to: os.replace(path, to)
