"""`tmchho info`: what is in a file, and what looks wrong with it."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from tmchho.cli.crs import crs_name
from tmchho.cli.display import display
from tmchho.cli.failures import EXIT_CODES, debug_option
from tmchho.cli.options import PATH, json_option, max_memory_option, quiet_option
from tmchho.errors import TmchhoError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from tmchho import PointCloud

# A float32 step longer than this share of the spacing shows in the shape of surfaces.
_VISIBLE_STEP = 0.02
_WIDTH = 96

_EXAMPLES = """\b
Examples:
  tmchho info uav.laz tls.e57
  # for a script
  tmchho info uav.laz --json

"""


@click.command(short_help="Tell what is in files and what looks wrong.", epilog=_EXAMPLES + EXIT_CODES)
@click.argument("files", type=PATH, nargs=-1, required=True, metavar="FILE...")
@max_memory_option
@json_option
@quiet_option
@debug_option
def info(files: tuple[Path, ...], max_memory: int | None, as_json: bool, quiet: bool) -> None:
    """Tell what is in each FILE: points, extent, spacing, CRS, attributes, and what looks wrong."""
    from tmchho import read
    from tmchho.outputs import json_text
    from tmchho.streams import default_max_memory, needs_streams

    allowed = max_memory or default_max_memory()

    described: list[dict[str, Any]] = []
    exit_code = 0
    with display(quiet) as shown:
        for path in files:
            try:
                if needs_streams((path,), allowed):
                    with shown.step("read", f"reading {path} in parts"):
                        described.append(describe_in_parts(path, allowed))
                    continue
                with shown.step("read", f"reading {path}"):
                    cloud = read(path)
                described.append(describe(cloud))
            except TmchhoError as error:  # the others are still worth a look
                shown.fail(str(error))
                exit_code = exit_code or error.exit_code
    if as_json:
        click.echo(json_text({"files": described}), nl=False)
    elif described:
        click.echo("\n\n".join(map(_in_words, described)))
    if exit_code:
        click.get_current_context().exit(exit_code)


def describe(cloud: PointCloud) -> dict[str, Any]:
    """Return what `info` tells about a cloud.

    Parameters
    ----------
    cloud : PointCloud
        At least one point.

    Returns
    -------
    dict
        ``name``, ``n_points``, ``lowest`` and ``highest`` corner of the box, ``spacing`` (median distance to
        the nearest other point; None where there is none), ``crs``, its ``unit`` and ``heights`` where pyproj
        can tell, ``attributes`` (type, lowest and highest value of each) and ``wrong`` (sentences), ready for
        JSON.
    """
    import numpy as np

    from tmchho import median_spacing
    from tmchho.crs import float32_step

    finite = cloud.xyz[np.isfinite(cloud.xyz).all(axis=1)]
    distinct = np.unique(finite, axis=0)
    return _described(
        name=cloud.name,
        crs=cloud.crs,
        counts=(len(cloud), len(finite), len(distinct)),
        box=(finite.min(axis=0), finite.max(axis=0)) if len(finite) else None,
        spacing=median_spacing(finite) if len(distinct) > 1 else None,
        step=float32_step(distinct),
        attributes={name: _range(values) for name, values in sorted(cloud.attributes.items())},
    )


def describe_in_parts(path: Path, max_memory: int) -> dict[str, Any]:
    """Return what `describe` does, of a LAS or LAZ file of any size.

    Raises
    ------
    TmchhoError
        If the file cannot be read, or there is no room for 16 bytes a point in the folder for such files.
    """
    from tmchho.cli.streamed_evaluate import scratch_in
    from tmchho.crs import float32_step
    from tmchho.io import las_parts, open_las
    from tmchho.room import check_room_for_parts
    from tmchho.streams.summary import summarise

    check_room_for_parts()
    file = open_las(path)
    ranges: dict[str, list[dict[str, Any]]] = {}
    for records in las_parts(file):
        for name, values in file.attributes(records).items():
            ranges.setdefault(name, []).append(_range(values))
    with scratch_in(None) as scratch:
        found = summarise(file, scratch, max_memory)
    return _described(
        name=str(path),
        crs=file.crs,
        counts=(len(file), len(file), found.n_distinct),
        box=(found.lowest, found.highest),
        spacing=found.spacing,
        step=float32_step(found.sample),
        attributes={name: _joined(ranges[name]) for name in sorted(ranges)},
    )


def _described(
    *,
    name: str,
    crs: str | None,
    counts: tuple[int, int, int],
    box: tuple[NDArray[np.float64], NDArray[np.float64]] | None,
    spacing: float | None,
    step: float | None,
    attributes: dict[str, Any],
) -> dict[str, Any]:
    from tmchho.crs import crs_facts

    facts = crs_facts(crs)
    return {
        "name": name,
        "n_points": counts[0],
        "lowest": None if box is None else box[0].tolist(),
        "highest": None if box is None else box[1].tolist(),
        "spacing": spacing,
        "crs": crs_name(crs),
        "unit": None if facts is None else facts.unit,
        "heights": None if facts is None else facts.heights,
        "attributes": attributes,
        "wrong": _what_looks_wrong(crs, counts, box, spacing, step),
    }


def _what_looks_wrong(
    crs: str | None,
    counts: tuple[int, int, int],
    box: tuple[NDArray[np.float64], NDArray[np.float64]] | None,
    spacing: float | None,
    step: float | None,
) -> list[str]:
    """Return sentences; `counts` are all points, the finite ones, and the distinct ones."""
    from tmchho.crs import crs_doubts

    n_points, n_finite, n_distinct = counts
    wrong = []
    if n_finite < n_points:
        wrong.append(f"points that are not finite: {n_points - n_finite:,} (they will be left out)")
    if n_distinct < n_finite:
        wrong.append(f"repeated points: {n_finite - n_distinct:,} (exactly where another one is)")
    if box is None:
        return wrong
    if step is not None and spacing is not None and step > _VISIBLE_STEP * spacing:
        wrong.append(
            f"coordinates were stored as float32, in steps of {step:.3g} at this distance from the origin; "
            "export again with double precision or after subtracting an offset"
        )
    wrong += crs_doubts(crs, *box)
    extent = box[1] - box[0]
    if n_distinct < 4 or bool((extent == 0).any()):
        wrong.append("the points do not spread in three directions, so no pose can be found for them")
    return wrong


def _joined(ranges: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the range of all parts of an attribute."""
    lows = [found["lowest"] for found in ranges if found["lowest"] is not None]
    highs = [found["highest"] for found in ranges if found["highest"] is not None]
    limits = {"lowest": min(lows), "highest": max(highs)} if lows else {"lowest": None, "highest": None}
    return {"type": ranges[0]["type"], **limits}


def _range(values: NDArray[Any]) -> dict[str, Any]:
    import numpy as np

    finite = np.asarray(values)[np.isfinite(values)]
    limits = (finite.min().item(), finite.max().item()) if finite.size else (None, None)
    return {"type": str(finite.dtype), "lowest": limits[0], "highest": limits[1]}


def _in_words(described: dict[str, Any]) -> str:
    def numbers(values: list[float] | None) -> str:
        return "-" if values is None else "  ".join(f"{value:.3f}" for value in values)

    low, high, spacing = described["lowest"], described["highest"], described["spacing"]
    extent = None if low is None else [b - a for a, b in zip(low, high, strict=True)]
    ranges = described["attributes"]
    unused = [name for name, values in ranges.items() if values["lowest"] == values["highest"] == 0]
    used = [f"{name} {_limits(values)}" for name, values in ranges.items() if name not in unused]
    lines = {
        "points": f"{described['n_points']:,}",
        "lowest": numbers(low),
        "highest": numbers(high),
        "extent": numbers(extent),
        "spacing": "-" if spacing is None else f"{spacing:.4g} (median distance to the nearest point)",
        "CRS": described["crs"] or "not in the file",
        "unit": described["unit"],
        "heights": described["heights"],
        "attributes": ", ".join(used) or "none",
        "all zero": ", ".join(unused),
        "looks wrong": "\n".join(described["wrong"]) or "nothing",
    }
    texts = [_indented(name, text) for name, text in lines.items() if text]
    return "\n".join([described["name"], *texts])


def _limits(values: dict[str, Any]) -> str:
    low, high = values["lowest"], values["highest"]
    if low is None:
        return "never finite"
    return f"{low:.10g}" if low == high else f"{low:.10g} to {high:.10g}"


def _indented(name: str, text: str) -> str:
    wrapped = [part for line in text.splitlines() for part in textwrap.wrap(line, _WIDTH)]
    heads = [name] + [""] * (len(wrapped) - 1)
    return "\n".join(f"  {head:<11}  {part}" for head, part in zip(heads, wrapped, strict=True))
