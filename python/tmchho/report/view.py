"""Clouds as they lie, in a page of their own: the 3D view without a report."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tmchho.cloud import PointCloud
from tmchho.errors import InvalidArgumentError, InvalidCloudError
from tmchho.inputs import CloudLike, open_cloud
from tmchho.io.atomic import atomic_path
from tmchho.report.colours import LAYERS, LAYERS_ON_DARK, gradient
from tmchho.report.described import length_unit
from tmchho.report.points import colour_of, joined_colours, quantised, spread
from tmchho.report.rounding import nice_ceiling
from tmchho.report.scene import Field, Scene, height_mode, pack
from tmchho.report.template import render, require_extras
from tmchho.report.words import BLANK

# Attributes that are shown by a ramp of colours: those of floats, but for these.
_NO_RAMP = ("gps_time", "nx", "ny", "nz")
_MAX_FIELDS = 6
_CUBES_ALONG = 250


def write_view(
    clouds: Sequence[CloudLike],
    path: str | os.PathLike[str],
    *,
    max_points: int = 1_000_000,
    overwrite: bool = False,
) -> Path:
    """Write a page that shows clouds in 3D, in any browser, without loading anything from anywhere.

    Parameters
    ----------
    clouds : sequence of CloudLike
        Up to eight: paths, `PointCloud`, or (n, 3) real numbers, all in one frame.
    path : str or path
        The page to make, ``.html``.
    max_points : int, default 1_000_000
        Of all clouds together, spread evenly; 12 MB or more of page for a million.
    overwrite : bool, default False
        Replace an existing file.

    Returns
    -------
    Path
        The page.

    Raises
    ------
    InvalidArgumentError
        If jinja2 or matplotlib is missing (``pip install 'tmchho[report]'``), or there are too many clouds.
    InvalidCloudError, ReadError
        If a cloud has no finite point, or a file cannot be read.
    WriteError
        If the page cannot be written.
    """
    require_extras()
    if isinstance(clouds, (str, os.PathLike, PointCloud)):
        raise InvalidArgumentError("clouds must be a list of clouds; put a single one in brackets")
    if not 0 < len(clouds) <= len(LAYERS):
        raise InvalidArgumentError(f"give 1 to {len(LAYERS)} clouds to show, got {len(clouds)}")
    with atomic_path(path, overwrite) as temporary:
        opened = [open_cloud(cloud, f"cloud {number}") for number, cloud in enumerate(clouds, start=1)]
        scene = view_scene(opened, max_points)
        names = [Path(cloud.name).name for cloud in opened]
        page = render(
            "view.html.jinja", has_viewer=True, title=", ".join(names), scene=scene, notes=_notes(opened)
        )
        temporary.write_text(page, encoding="utf-8", newline="\n")
    return Path(path)


def view_scene(clouds: Sequence[PointCloud], max_points: int) -> Scene:
    """Return the 3D view of clouds, each a layer.

    Raises
    ------
    InvalidCloudError
        If a cloud has no finite point.
    """
    layers, places, rows = [], [], []
    first = 0
    shares = _shares([len(cloud) for cloud in clouds], max_points)
    for number, (cloud, share) in enumerate(zip(clouds, shares, strict=True)):
        finite = np.flatnonzero(np.isfinite(cloud.xyz).all(axis=1))
        if len(finite) == 0:
            raise InvalidCloudError(f"{cloud.name}: has no finite point to show")
        extent = float(np.ptp(cloud.xyz[finite], axis=0).max()) or 1.0
        random = np.random.default_rng(number)
        kept = finite[spread(cloud.xyz[finite], share, extent / _CUBES_ALONG, random)]
        layers.append(
            {
                "name": Path(cloud.name).name,
                "first": first,
                "count": len(kept),
                "colour": LAYERS[number],
                "colour_on_dark": LAYERS_ON_DARK[number],
            }
        )
        first += len(kept)
        places.append(cloud.xyz[kept])
        rows.append(kept)
    unit = _unit(clouds)
    colour = joined_colours(
        [colour_of(cloud.attributes, kept) for cloud, kept in zip(clouds, rows, strict=True)],
        [len(kept) for kept in rows],
    )
    fields = _fields(clouds, rows, unit)
    modes: list[dict[str, Any]] = []
    legend = {"rows": [{"words": layer["name"], "colour": layer["colour"]} for layer in layers]}
    modes.append({"key": "clouds", "label": "Clouds", "paint": "layer", "legend": legend})
    if len(colour):
        sentence = {"sentence": "as recorded, or the intensity as grey"}
        # What was recorded is what most people want to see first.
        modes.insert(0, {"key": "colour", "label": "Recorded", "paint": "colour", "legend": sentence})
    for number, one in enumerate(fields):
        ramp = {"ramp": gradient(one.ramp), "words": one.label}
        mode = {"key": f"field{number}", "label": one.label, "paint": "field", "field": number}
        modes.append({**mode, "legend": ramp})
    modes.append(height_mode())
    origin, step, steps = quantised(np.concatenate(places))
    flags = np.zeros(len(steps), dtype=np.uint8)
    return pack(steps, origin, step, layers, modes, fields, colour, flags, unit, whole_page=True)


def _fields(clouds: Sequence[PointCloud], rows: Sequence[NDArray[np.intp]], unit: str) -> list[Field]:
    names = dict.fromkeys(
        name
        for cloud in clouds
        for name, values in cloud.attributes.items()
        if np.asarray(values).dtype.kind == "f" and np.asarray(values).ndim == 1 and name not in _NO_RAMP
    )
    fields = []
    for name in list(names)[:_MAX_FIELDS]:
        values = np.concatenate(
            [
                np.asarray(cloud.attributes[name], dtype=np.float64)[kept]
                if name in cloud.attributes
                else np.full(len(kept), np.nan)
                for cloud, kept in zip(clouds, rows, strict=True)
            ]
        )
        known = values[np.isfinite(values)]
        if len(known) == 0:
            continue
        is_signed = bool(known.min() < 0 < known.max())
        high = nice_ceiling(float(np.percentile(np.abs(known), 95)))
        low = -high if is_signed else 0.0
        label = name.replace("_", " ")
        is_length = "distance" in name.lower()
        ramp = "diverging" if is_signed else "sequential"
        fields.append(Field(label, unit if is_length else "", values, low, high, ramp))
    return fields


def _shares(counts: Sequence[int], most: int) -> list[int]:
    """Return how many points of each cloud are taken: as even as can be, and no more than there are."""
    shares = [0] * len(counts)
    left = most
    for n_waiting, number in zip(
        range(len(counts), 0, -1), sorted(range(len(counts)), key=counts.__getitem__), strict=True
    ):
        shares[number] = min(counts[number], left // n_waiting)
        left -= shares[number]
    return shares


def _unit(clouds: Sequence[PointCloud]) -> str:
    stated = [length_unit(cloud.crs) for cloud in clouds]
    return f"{BLANK}{next(filter(None, stated), 'm')}"


def _notes(clouds: Sequence[PointCloud]) -> list[str]:
    """Return what a viewer must be told: clouds that lie so far apart that all of them are dots."""
    boxes = [
        (cloud.xyz[np.isfinite(cloud.xyz).all(axis=1)].min(axis=0), np.nanmax(cloud.xyz, axis=0))
        for cloud in clouds
    ]
    low = np.min([box[0] for box in boxes], axis=0)
    high = np.max([box[1] for box in boxes], axis=0)
    widest = max(float((box[1] - box[0]).max()) for box in boxes)
    if float((high - low).max()) > 10 * widest > 0:
        return ["The clouds lie far apart, as their coordinates say: switch one off to see the other."]
    return []
