"""Pictures as PNG, the same bytes for the same numbers."""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# The colour of a method is the same in all pictures; told apart also by people who see no red or green.
COLOURS = {
    "boa": "#999999",
    "woa": "#e69f00",
    "pso": "#56b4e9",
    "doa": "#009e73",
    "hho": "#0072b2",
    "tmchho": "#d55e00",
    "tmchho_free": "#cc79a7",
    "robust": "#000000",
}


@dataclass(frozen=True)
class Picture:
    """A picture.

    Parameters
    ----------
    name : str
        Name of its PNG file, without the ending.
    caption : str
        What it shows, with the units of the axes.
    png : bytes
        The file.
    """

    name: str
    caption: str
    png: bytes


def draw(
    name: str, caption: str, shape: tuple[int, int], paint: Callable[[Figure, list[Axes]], None]
) -> Picture:
    """Make a picture of panels in rows and columns.

    Parameters
    ----------
    name, caption : str
        See `Picture`.
    shape : (int, int)
        Rows and columns of panels.
    paint : callable
        Gets the figure and its panels, row by row.

    Returns
    -------
    Picture
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    rows, columns = shape
    figure = Figure(figsize=(1.0 + 3.4 * columns, 0.4 + 2.7 * rows), layout="constrained", dpi=110)
    FigureCanvasAgg(figure)
    panels = figure.subplots(rows, columns, squeeze=False)
    paint(figure, list(panels.flat))
    stream = io.BytesIO()
    # Without the library's name, whose version would change the bytes.
    figure.savefig(stream, format="png", metadata={"Software": None})
    return Picture(name, caption, stream.getvalue())
