"""`tmchho view`: clouds in the browser."""

from __future__ import annotations

import tempfile
import webbrowser
from pathlib import Path

import click

from tmchho.cli.display import display
from tmchho.cli.failures import EXIT_CODES, debug_option
from tmchho.cli.options import PATH, overwrite_option, quiet_option

_EXAMPLES = """\b
Examples:
  tmchho view uav.laz tls.laz
  # a file to pass on
  tmchho view out/fused.laz -o fused.html --points 300000

"""


@click.command(short_help="Show clouds in the browser.", epilog=_EXAMPLES + EXIT_CODES)
@click.argument("clouds", type=PATH, nargs=-1, required=True, metavar="CLOUD...")
@click.option(
    "-o",
    "--output",
    type=PATH,
    metavar="FILE",
    help="Write the page to FILE instead of opening it.",
)
@click.option(
    "--points",
    type=click.IntRange(min=1000, max=1_500_000),
    default=1_000_000,
    show_default=True,
    help="Points shown at most, of all clouds together, spread evenly.",
)
@overwrite_option
@quiet_option
@debug_option
def view(clouds: tuple[Path, ...], output: Path | None, points: int, overwrite: bool, quiet: bool) -> None:
    """Show each CLOUD in 3D in the browser: turn, colour, switch on and off, measure between points.

    The page is one file that loads nothing from anywhere; -o keeps it.
    """
    from tmchho.report import write_view

    with display(quiet) as shown:
        page = output
        if page is None:
            # Not removed at the end: the browser still reads it then.
            page = Path(tempfile.mkdtemp(prefix="tmchho-view-")) / "view.html"
        with shown.step("view", "reading and packing"):
            write_view(clouds, page, max_points=points, overwrite=overwrite)
        if output is None and not webbrowser.open(page.as_uri()):
            shown.warn("no browser could be opened; open the page yourself")
    click.echo(str(page))
