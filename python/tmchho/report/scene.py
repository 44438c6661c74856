"""What the 3D view draws: layers of points, ways to colour them, and the bytes of both for the page."""

from __future__ import annotations

import base64
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tmchho.report.colours import (
    MARKED,
    RAMPS,
    SOURCE,
    SOURCE_ON_DARK,
    TARGET,
    TARGET_ON_DARK,
    gradient,
    swatches,
)
from tmchho.report.points import NO_COLOUR, ReportPoints
from tmchho.stages import median_spacing

if TYPE_CHECKING:
    from tmchho.report.change import StoredChange

FILLS_HOLE, IS_FUSED, IS_CLOUD, IS_CORE = 1, 2, 4, 8
_NO_VALUE = 65_535
# Nearest neighbours of a random choice lie nearer than the points of a grid as dense; this closes the gaps.
_CLOSED = 1.7


@dataclass(frozen=True, eq=False)
class Field:
    """A value for every point, shown by a ramp of colours.

    Parameters
    ----------
    label : str
        What it is, as the middle of a sentence.
    unit : str
        With the blank before it.
    values : (n,) array
        NaN where there is none.
    low, high : float
        Ends of the ramp.
    ramp : str
        Key of `tmchho.report.colours.RAMPS`.
    """

    label: str
    unit: str
    values: NDArray[Any]
    low: float
    high: float
    ramp: str = "sequential"

    def encoded(self) -> tuple[dict[str, Any], NDArray[np.uint16]]:
        """Return what the view must know, and the values in 65 534 steps."""
        known = np.isfinite(self.values)
        lowest, highest = self.low, self.high
        if known.any():
            lowest = min(lowest, float(self.values[known].min()))
            highest = max(highest, float(self.values[known].max()))
        step = max((highest - lowest) / (_NO_VALUE - 1), np.finfo(float).tiny)
        codes = np.full(len(self.values), _NO_VALUE, dtype=np.uint16)
        codes[known] = np.rint((self.values[known].astype(np.float64) - lowest) / step)
        words = {"label": self.label, "unit": self.unit, "low": self.low, "high": self.high}
        return words | {"low_end": lowest, "value_step": step, "ramp": self.ramp}, codes


@dataclass(frozen=True, eq=False)
class Scene:
    """Everything of one 3D view, ready for the template.

    Parameters
    ----------
    words : dict
        What ``viewer.js`` reads as JSON.
    blocks : dict of str to str
        Bytes in base64.
    legends : list of dict
        For each mode its rows or its ramp.
    n_points : int
        Points in it.
    """

    words: dict[str, Any]
    blocks: dict[str, str]
    legends: list[dict[str, Any]] = field(default_factory=list)
    n_points: int = 0


def pack(
    steps: NDArray[np.uint16],
    origin: NDArray[np.float64],
    step: NDArray[np.float64],
    layers: Sequence[Mapping[str, Any]],
    modes: Sequence[Mapping[str, Any]],
    fields: Sequence[Field],
    colour: NDArray[np.uint8],
    flags: NDArray[np.uint8],
    unit: str,
    **further: Any,
) -> Scene:
    """Put a scene together; ``legend`` of a mode stays with the template, the rest goes to the view."""
    middle = step * _NO_VALUE / 2
    local = steps * step - middle
    # Where to look, so that a few points far away do not make a dot of all others.
    box = np.percentile(local, [1, 99], axis=0) if len(local) else np.zeros((2, 3))
    look_at = box.mean(axis=0)
    reach = float(np.percentile(np.linalg.norm(local - look_at, axis=1), 99)) if len(local) else 1.0
    encoded = [one.encoded() for one in fields]
    blocks = {"positions": _base64(steps), "flags": _base64(flags)}
    if len(colour):
        blocks["colours"] = _base64(colour)
    blocks |= {f"field{number}": _base64(codes) for number, (_, codes) in enumerate(encoded)}
    words = {
        "origin": origin.tolist(),
        "step": step.tolist(),
        "look_at": look_at.tolist(),
        "reach": max(reach, 1e-9),
        "unit": unit,
        "layers": [{**layer, "spacing": _spacing(local, layer)} for layer in layers],
        "fields": [described for described, _ in encoded],
        "modes": [{key: value for key, value in mode.items() if key != "legend"} for mode in modes],
        "ramps": {name: list(stops) for name, stops in RAMPS.items()},
        "marked": MARKED,
        **further,
    }
    empty = {"rows": (), "ramp": None, "words": "", "ends": None, "sentence": ""}
    legends = [{**empty, "key": mode["key"], **mode["legend"]} for mode in modes]
    return Scene(words, blocks, legends, len(steps))


def report_scene(
    points: ReportPoints,
    document: Mapping[str, Any],
    unit: str,
    fields: Mapping[str, Field],
    change: StoredChange | None = None,
) -> Scene:
    """Return the 3D view of a registration.

    Parameters
    ----------
    points : ReportPoints
        What is shown.
    document : mapping
        The content of ``result.json``.
    unit : str
        Of lengths, with the blank before it.
    fields : mapping of str to Field
        The values that points can be coloured by, under the names of their buttons.
    change : StoredChange, optional
        M3C2 distances, shown at their cores instead of the clouds.

    Returns
    -------
    Scene
    """
    counts = (points.n_target, len(points.steps) - points.n_target)
    layers = [
        _layer("Source", counts[0], counts[1], SOURCE, SOURCE_ON_DARK) | {"moves": True},
        _layer("Target", 0, counts[0], TARGET, TARGET_ON_DARK),
    ]
    modes: list[dict[str, Any]] = [
        {
            "key": "clouds",
            "label": "Clouds",
            "paint": "layer",
            "legend": {"rows": swatches(("source, moved", "source"), ("target", "target"))},
        }
    ]
    for number, (label, one) in enumerate(fields.items()):
        legend = {"ramp": gradient(one.ramp), "words": one.label}
        modes.append(
            {"key": f"field{number}", "label": label, "paint": "field", "field": number, "legend": legend}
        )
    has_colour = len(points.colour) > 0
    if points.is_fused.any():
        rows = swatches(("fills a hole of the other cloud", "marked"), ("all other points", "faint"))
        modes.append(
            {
                "key": "holes",
                "label": "Holes filled",
                "paint": "flag",
                "bit": FILLS_HOLE,
                "only": IS_FUSED,
                "legend": {"rows": rows},
            }
        )
        words = "the fused cloud in its own colours" if has_colour else "the fused cloud, coloured by height"
        modes.append(
            {
                "key": "fused",
                "label": "Fused cloud",
                "paint": "colour" if has_colour else "height",
                "only": IS_FUSED,
                "legend": {"sentence": words},
            }
        )
    modes.append(height_mode())
    modes = [{"only": IS_CLOUD, **mode} for mode in modes]
    steps, colour, shown = points.steps, points.colour, list(fields.values())
    flags = IS_CLOUD + points.fills_hole * FILLS_HOLE + points.is_fused * IS_FUSED
    if change is not None:
        # Cores lie on the target, whose box the steps cover.
        cores = np.clip(np.rint((change.xyz - points.origin) / points.step), 0, _NO_VALUE).astype(np.uint16)
        one = change.field(unit)
        shown = [replace(each, values=_padded(each.values, after=len(cores))) for each in shown]
        shown.append(replace(one, values=_padded(one.values, before=len(steps))))
        layers.append(_layer("Change", len(steps), len(cores), MARKED, MARKED))
        legend = {"ramp": gradient(one.ramp), "words": one.label}
        mode = {"key": "change", "label": "Change (M3C2)", "paint": "field", "field": len(shown) - 1}
        modes.insert(2, {**mode, "only": IS_CORE, "legend": legend})
        steps = np.concatenate([steps, cores])
        flags = np.concatenate([flags, np.full(len(cores), IS_CORE)])
        if len(colour):
            colour = np.concatenate([colour, np.full((len(cores), 3), NO_COLOUR, dtype=np.uint8)])
    return pack(
        steps,
        points.origin,
        points.step,
        layers,
        modes,
        shown,
        colour,
        flags.astype(np.uint8),
        unit,
        before=before_pose(document, points),
    )


def _padded(values: NDArray[Any], before: int = 0, after: int = 0) -> NDArray[np.float64]:
    return np.pad(np.asarray(values, dtype=np.float64), (before, after), constant_values=np.nan)


def height_mode() -> dict[str, Any]:
    """Return the mode that colours by height."""
    legend = {"ramp": gradient("height"), "words": "height", "ends": ("low", "high")}
    return {"key": "height", "label": "Height", "paint": "height", "legend": legend}


def before_pose(document: Mapping[str, Any], points: ReportPoints) -> dict[str, Any]:
    """Return how the source lay before, as a turn about its middle and a shift, in the frame of the view.

    Where the source as given lies far from the target, it is only turned, because both would be dots;
    ``is_shifted`` says so. A scale is left out.
    """
    matrix = np.array(document["pivot_transformation"])
    source_pivot, target_pivot = (np.array(document[f"{side}_pivot"]) for side in ("source", "target"))
    back = matrix[:3, :3].T / document["scale"]
    now = matrix[:3, 3] + target_pivot
    shift = source_pivot - now
    is_shifted = bool(np.linalg.norm(shift) < 3 * np.linalg.norm(points.step) * _NO_VALUE)
    angle, axis = angle_and_axis(back)
    middle = points.origin + points.step * _NO_VALUE / 2
    return {
        "axis": axis.tolist(),
        "angle": angle,
        "centre": (now - middle).tolist(),
        "shift": shift.tolist() if is_shifted else [0.0, 0.0, 0.0],
        "is_shifted": is_shifted,
    }


def angle_and_axis(rotation: ArrayLike) -> tuple[float, NDArray[np.float64]]:
    """Return the angle of a 3 × 3 rotation in radians, and the axis that it turns about.

    Examples
    --------
    >>> angle, axis = angle_and_axis([[0, -1, 0], [1, 0, 0], [0, 0, 1]])
    >>> round(math.degrees(angle), 9), axis.tolist()
    (90.0, [0.0, 0.0, 1.0])
    """
    r = np.asarray(rotation, dtype=np.float64)
    twice_sine = np.array([r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]])
    angle = math.atan2(float(np.linalg.norm(twice_sine)), float(np.trace(r)) - 1)
    # Near half a turn the sines vanish; the axis is then the one that the rotation leaves where it is.
    values, vectors = np.linalg.eigh(r + r.T)
    axis = vectors[:, int(np.argmax(values))]
    if np.dot(axis, twice_sine) < 0:
        axis = -axis
    return angle, axis + 0.0


def _layer(name: str, first: int, count: int, colour: str, on_dark: str) -> dict[str, Any]:
    return {"name": name, "first": first, "count": count, "colour": colour, "colour_on_dark": on_dark}


def _spacing(local: NDArray[np.float64], layer: Mapping[str, Any]) -> float:
    """Return how large a point of a layer must be drawn to leave no gaps."""
    points = local[layer["first"] : layer["first"] + layer["count"]]
    return _CLOSED * median_spacing(points) if len(points) > 1 else 1.0


def _base64(values: NDArray[Any]) -> str:
    data = np.ascontiguousarray(values)
    little = data.astype(data.dtype.newbyteorder("<"), copy=False)
    return base64.b64encode(little.tobytes()).decode("ascii")
