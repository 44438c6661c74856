"""Colours of pictures, legends and the 3D view, told apart also by people who see no red or green."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.colors import LinearSegmentedColormap

SOURCE, TARGET, MARKED, FAINT = "#d55e00", "#0072b2", "#cc3f8f", "#9aa1a9"
SOURCE_ON_DARK, TARGET_ON_DARK = "#ff8f3f", "#5bb8f0"

# Each of these is interpolated evenly; lightness rises or falls along it, so that it prints in grey as well.
RAMPS: dict[str, tuple[str, ...]] = {
    "sequential": ("#2c4fa3", "#2f7fb8", "#2aa198", "#7fb23d", "#e0b020", "#e06c1f", "#a61c2c"),
    "diverging": ("#1f4e9c", "#5b8ec9", "#a9b7c6", "#b9b5ae", "#d9a37c", "#cf6a3a", "#9c2a1f"),
    "height": ("#3f5e8c", "#3f8f8a", "#8aa65a", "#cdb35f", "#c98b52", "#e9dfd2"),
}

# Colours of further clouds in `tmchho view`.
LAYERS = (TARGET, SOURCE, "#009e73", "#cc79a7", "#8a6d00", "#7f5fc7", "#5a6570", "#b0413e")
LAYERS_ON_DARK = (
    TARGET_ON_DARK,
    SOURCE_ON_DARK,
    "#3fd3a5",
    "#eba3cd",
    "#f0d24a",
    "#b59cf2",
    "#b8c2cc",
    "#f28c86",
)


def colour_map(name: str) -> LinearSegmentedColormap:
    """Return a ramp for matplotlib."""
    from matplotlib.colors import LinearSegmentedColormap

    return LinearSegmentedColormap.from_list(name, list(RAMPS[name]))


def gradient(name: str) -> str:
    """Return a ramp as a CSS background."""
    return f"linear-gradient(to right, {', '.join(RAMPS[name])})"


def rgba(colour: str, opacity: float = 1.0) -> tuple[float, float, float, float]:
    """Return a colour of CSS as matplotlib takes it."""
    red, green, blue = (int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5))
    return red, green, blue, opacity


def swatches(*pairs: tuple[str, str]) -> list[dict[str, Any]]:
    """Return the rows of a legend: words and their colour."""
    return [{"words": words, "colour": colour} for words, colour in pairs]
