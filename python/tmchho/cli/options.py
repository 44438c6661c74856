"""Options that several commands have, said once."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

if TYPE_CHECKING:
    from tmchho import Area

_Command = TypeVar("_Command", bound=Callable[..., Any])

# Whether a file exists is checked on reading: a missing file is no wrong usage (exit code 3, not 2).
PATH = click.Path(path_type=Path)

json_option = click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
quiet_option = click.option(
    "-q", "--quiet", is_flag=True, help="No progress and no notes, only warnings and errors."
)
report_option = click.option(
    "--report/--no-report", default=True, help="Make report.html.  [default: report]"
)
overwrite_option = click.option("--overwrite", is_flag=True, help="Replace the files of an earlier run.")


def output_option(**settings: Any) -> Callable[[_Command], _Command]:
    """Return the option for the folder of the results."""
    return click.option(
        "-o", "--output", type=PATH, metavar="FOLDER", help="Folder for the results.", **settings
    )


def corners(
    _context: click.Context, _option: click.Parameter, value: str | None
) -> tuple[tuple[float, ...], tuple[float, ...]] | None:
    """Read an option whose value is the lower and the upper corner of a box: six numbers and commas."""
    if value is None:
        return None
    try:
        numbers = tuple(float(word) for word in value.split(","))
    except ValueError:
        numbers = ()
    low, high = numbers[:3], numbers[3:]
    if len(numbers) != 6 or not all(map(math.isfinite, numbers)):
        raise click.BadParameter(f"must be six numbers with commas between them, got {value!r}")
    if not all(least < most for least, most in zip(low, high, strict=True)):
        raise click.BadParameter(
            f"must be xmin,ymin,zmin,xmax,ymax,zmax, each min below its max, got {value}"
        )
    return low, high


def area(
    context: click.Context, option: click.Parameter, value: str | None
) -> tuple[tuple[float, ...], tuple[float, ...]] | Path | None:
    """Read an option whose value is a box, or the name of a file with a polygon."""
    if value is not None and Path(value).is_file():
        return Path(value)
    try:
        return corners(context, option, value)
    except click.BadParameter as error:
        raise click.BadParameter(f"{error.message}, and no file has that name") from error


def classes(_context: click.Context, _option: click.Parameter, value: str | None) -> tuple[int, ...]:
    """Read an option whose value are classifications with commas between them."""
    if value is None:
        return ()
    words = value.split(",")
    if not all(word.strip().isdigit() and int(word) <= 255 for word in words):
        raise click.BadParameter(f"must be numbers from 0 to 255 with commas between them, got {value!r}")
    return tuple(int(word) for word in words)


def memory(_context: click.Context, _option: click.Parameter, value: str | None) -> int | None:
    """Read an option whose value is an amount of memory."""
    from tmchho.errors import InvalidArgumentError
    from tmchho.streams.memory import parse_bytes

    if value is None:
        return None
    try:
        return parse_bytes(value)
    except InvalidArgumentError as error:
        raise click.BadParameter(str(error)) from error


def positive(_context: click.Context, _option: click.Parameter, value: float | None) -> float | None:
    """Check an option whose value must be a finite number above zero."""
    if value is not None and not (math.isfinite(value) and value > 0):
        raise click.BadParameter(f"must be a number above 0, got {value:g}")
    return value


max_memory_option = click.option(
    "--max-memory",
    callback=memory,
    metavar="SIZE",
    help="Such as 2GB. LAS and LAZ files that need more are worked on in parts.  [default: half of the "
    "machine's]",
)
areas_option = click.option(
    "--areas",
    type=PATH,
    metavar="FILE",
    help="Polygons by which distances are summed up: GeoJSON, WKT, or what pyogrio reads (shapefile, …).  "
    "[default: five strips along the overlap]",
)
tolerance_option = click.option(
    "--tolerance",
    type=float,
    callback=positive,
    metavar="LENGTH",
    help="Also tell the share of points whose distance does not exceed this.",
)


def boxes(_context: click.Context, _option: click.Parameter, values: tuple[str, ...]) -> tuple[Area, ...]:
    """Read an option whose values are areas: an optional name, then four numbers, or six with heights."""
    from tmchho.evaluation import Area

    areas = []
    for number, value in enumerate(values, start=1):
        name, _, text = value.rpartition("=")
        try:
            numbers = tuple(float(word) for word in text.split(","))
        except ValueError:
            numbers = ()
        half = len(numbers) // 2
        if len(numbers) not in (4, 6) or not all(map(math.isfinite, numbers)):
            raise click.BadParameter(f"must be four or six numbers with commas between them, got {value!r}")
        low, high = numbers[:half], numbers[half:]
        if not all(least < most for least, most in zip(low, high, strict=True)):
            raise click.BadParameter(f"each minimum must lie below its maximum, got {value}")
        heights = None if half == 2 else (low[2], high[2])
        areas.append(Area.box(name or f"box {number}", low[0], low[1], high[0], high[1], heights))
    return tuple(areas)
