"""A chart of the report: the same figure as SVG within the page and as PNG beside it."""

from __future__ import annotations

import io
import re
from collections.abc import Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

from tmchho.report.colours import SOURCE, TARGET

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Everything drawn in this colour takes the page's text colour, so that charts follow light and dark.
INK, PAPER = "#1b1f24", "#fefefd"
_PAGE_COLOURS = {INK: "currentColor", PAPER: "var(--paper)", SOURCE: "var(--source)", TARGET: "var(--target)"}
_STYLE: dict[str, Any] = {
    "font.size": 9.0,
    "font.family": "sans-serif",
    "svg.fonttype": "none",  # text stays text: it can be searched, and read aloud
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "axes.titlecolor": INK,
    "axes.titlesize": 9.5,
    "axes.titlelocation": "left",
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "xtick.color": INK,
    "ytick.color": INK,
    "xtick.labelsize": 8.0,
    "ytick.labelsize": 8.0,
    "text.color": INK,
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "grid.color": INK,
    "grid.alpha": 0.12,
    "grid.linewidth": 0.6,
    "image.interpolation": "nearest",
}


@dataclass(frozen=True, eq=False)
class Chart:
    """A figure with its words.

    Parameters
    ----------
    name : str
        Of its PNG file, without the ending.
    title : str
        What it is, in a few words.
    caption : str
        What it shows, for those who see it and for those who do not.
    figure : matplotlib.figure.Figure
        Made by `new_figure`.
    """

    name: str
    title: str
    caption: str
    figure: Figure

    def svg(self) -> str:
        """Return the figure for a page: without the head of the file, in the colours of the page."""
        stream = io.StringIO()
        with styled({"svg.hashsalt": self.name}):
            self.figure.savefig(
                stream, format="svg", transparent=True, dpi=150, metadata={"Date": None, "Creator": None}
            )
        text = stream.getvalue()
        text = re.sub(r"<metadata>.*?</metadata>\s*", "", text[text.index("<svg") :], flags=re.DOTALL)
        # Names must differ from those of the other charts of the page.
        text = re.sub(r'\bid="', f'id="{self.name}-', text)
        text = re.sub(r'(url\(|href=")#', rf"\1#{self.name}-", text)
        for colour, of_page in _PAGE_COLOURS.items():
            text = text.replace(colour, of_page)
        # The size is the page's business; what the figure shows is said by its caption.
        head, body = text.split(">", 1)
        head = re.sub(r' (height|width)="[^"]*"', "", head)
        return f'{head} role="img" aria-labelledby="{self.name}-caption" focusable="false">{body}'

    def png(self) -> bytes:
        """Return the figure as a picture on white."""
        stream = io.BytesIO()
        with styled():
            # Without the library's name, whose version would change the bytes.
            self.figure.savefig(stream, format="png", dpi=160, facecolor="white", metadata={"Software": None})
        return stream.getvalue()


def new_figure(width: float, height: float) -> Figure:
    """Return an empty figure, in inches, that needs no display and shows itself in a notebook."""
    with styled():
        return _figure_class()(figsize=(width, height), layout="constrained", facecolor="none")


@cache
def _figure_class() -> type[Figure]:
    from matplotlib.figure import Figure

    class NotebookFigure(Figure):
        """A figure that a notebook shows, whether or not it was made by pyplot."""

        def _repr_png_(self) -> bytes:
            stream = io.BytesIO()
            self.savefig(stream, format="png", dpi=110)
            return stream.getvalue()

    return NotebookFigure


def styled(further: Mapping[str, Any] | None = None) -> AbstractContextManager[None]:
    """Return the context in which a chart is drawn, so that no setting of the caller's shows in it."""
    import matplotlib

    settings: Any = {**_STYLE, **(further or {})}
    return matplotlib.rc_context(settings)
