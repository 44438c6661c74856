"""From names of tables and figures to their files."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from tmchho.io.atomic import check_writable_folder
from tmchho.outputs import write_together
from tmchho.paper import (
    ablation,
    budgets,
    dam,
    figure3,
    figure6,
    figure8,
    ranks,
    success,
    table3,
    table4,
    table5,
)
from tmchho.paper.extras import require_extras
from tmchho.paper.page import page
from tmchho.paper.plan import Content, Section, Settings
from tmchho.paper.runner import Progress, complete
from tmchho.paper.store import RunStore

PAGE = "paper.html"

SECTIONS: dict[str, Section] = {
    section.name: section
    for section in (
        figure3.SECTION,
        table3.SECTION,
        figure6.SECTION,
        ranks.SECTION,
        ablation.SECTION,
        *budgets.SECTIONS,
        table4.SECTION,
        figure8.FIGURE8,
        figure8.FIGURE9,
        table5.TABLE5,
        table5.FIGURE10,
        success.SECTION,
        *dam.SECTIONS,
    )
}
"""All sections by name, in the order of the page."""


def reproduce(
    names: Sequence[str], folder: Path, settings: Settings, command: str, progress: Progress
) -> tuple[list[tuple[Section, Content]], tuple[Path, ...]]:
    """Run what is missing, and write tables, pictures and the page.

    Parameters
    ----------
    names : sequence of str
        Keys of `SECTIONS`; the page has them in its own order.
    folder : Path
        For the results, and for the runs that are done. Files of an earlier call are replaced; runs are kept.
    settings : Settings
        How much is run.
    command : str
        What the page says would make it again.
    progress : callable
        Is told of every run.

    Returns
    -------
    shown : list of (Section, Content)
    files : tuple of Path
        The page first.

    Raises
    ------
    InvalidArgumentError
        If a library is missing that pictures, page or tests need.
    WriteError, ReadError
        If the folder cannot be used.
    """
    require_extras()
    check_writable_folder(folder)
    store = RunStore(folder)
    shown = []
    for section in SECTIONS.values():
        if section.name in names:
            runs = complete(section.series, settings, store, progress)
            shown.append((section, section.show(runs)))
    files: dict[str, Callable[[Path], object]] = {PAGE: _text(page(shown, command))}
    for _, content in shown:
        files |= {f"{table.name}.csv": _text(table.csv()) for table in content.tables}
        files |= {f"{picture.name}.png": _bytes(picture.png) for picture in content.pictures}
    write_together(folder, files, overwrite=True)
    return shown, tuple(folder / name for name in files)


def _text(text: str) -> Callable[[Path], object]:
    return lambda path: path.write_text(text, encoding="utf-8", newline="\n")


def _bytes(content: bytes) -> Callable[[Path], object]:
    return lambda path: path.write_bytes(content)
