"""The files of a report: made beside the results of a registration, from these alone."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from tmchho.io import check_output
from tmchho.outputs import FIGURES, FUSED, REPORT, REPORT_PDF, REPORT_POINTS, RESULT, write_together
from tmchho.report.browser import find_browser, print_to_pdf
from tmchho.report.change import load_change
from tmchho.report.fused_points import points_of_fused_file
from tmchho.report.page import make_page
from tmchho.report.points import ReportPoints
from tmchho.report.stored import day_of, read_document
from tmchho.report.template import require_extras


def write_report(
    folder: str | os.PathLike[str],
    *,
    pdf: bool | None = False,
    figures: bool = False,
    overwrite: bool = True,
) -> tuple[Path, ...]:
    """Make the report of a registration from what it left in its folder; nothing is computed again.

    Parameters
    ----------
    folder : str or path
        With ``result.json`` and ``report_points.npz``, as `tmchho register` leaves them. Without the latter
        the points are taken from ``fused.laz``; without both the report has no pictures of them. Where
        ``tmchho evaluate --method m3c2`` left its files for the same pose, its change is shown, too.
    pdf : bool or None, default False
        Also print it to ``report.pdf`` by a Chromium, Chrome or Edge of this machine; with None only where
        there is one.
    figures : bool, default False
        Also write every picture to ``figures`` as PNG.
    overwrite : bool, default True
        Replace an earlier report.

    Returns
    -------
    tuple of Path
        The files, ``report.html`` first. It is one file that loads nothing from anywhere.

    Raises
    ------
    InvalidArgumentError
        If jinja2 or matplotlib is missing: they come with ``pip install 'tmchho[report]'``; or if `pdf` is
        True and there is no browser.
    ReadError
        If ``result.json`` is missing, or is not that of a registration.
    WriteError
        If a file cannot be written.
    """
    require_extras()
    folder = Path(folder)
    browser = find_browser(required=bool(pdf)) if pdf in (True, None) else None
    document = read_result(folder)
    check_output(folder / REPORT, overwrite)
    stored = _points(folder, document)
    page, charts = make_page(
        document, stored, day_of(folder / RESULT), load_change(folder, document["transformation"])
    )

    files: dict[str, Callable[[Path], object]] = {
        REPORT: lambda path: path.write_text(page, encoding="utf-8", newline="\n")
    }
    if browser is not None:
        files[REPORT_PDF] = lambda path: print_to_pdf(browser, page, path)
    write_together(folder, files, overwrite=overwrite)
    written = [folder / name for name in files]
    if figures:
        pictures: dict[str, Callable[[Path], object]] = {
            f"{chart.name}.png": lambda path, chart=chart: path.write_bytes(chart.png())  # type: ignore[misc]
            for chart in charts
        }
        write_together(folder / FIGURES, pictures, overwrite=overwrite)
        written += [folder / FIGURES / name for name in pictures]
    return tuple(written)


def _points(folder: Path, document: Mapping[str, Any]) -> ReportPoints | None:
    """Return the points that were kept or, where none were, some of the fused cloud; None without either."""
    if (folder / REPORT_POINTS).exists():
        return ReportPoints.load(folder / REPORT_POINTS)
    if document.get("fused") is None or not (folder / FUSED).exists():
        return None
    return points_of_fused_file(folder / FUSED, document["seed"], document["voxel_size"])


def read_result(folder: Path) -> Mapping[str, Any]:
    """Return the content of the ``result.json`` of a registration.

    Raises
    ------
    ReadError
        If it is missing, damaged or of something else.
    """
    return read_document(
        folder / RESULT,
        needed=("verdict", "reasons", "transformation", "inputs", "config", "stages"),
        what="registration",
        command="tmchho register",
    )
