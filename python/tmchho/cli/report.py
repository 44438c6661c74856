"""`tmchho report`: the report of a registration once more, with all that belongs to it."""

from __future__ import annotations

from pathlib import Path

import click

from tmchho.cli.display import display
from tmchho.cli.failures import EXIT_CODES, debug_option
from tmchho.cli.options import PATH, quiet_option

_EXAMPLES = """\b
Examples:
  tmchho report out
  # the page alone, without pictures for a slide
  tmchho report out --no-pdf --no-figures

"""


@click.command(short_help="Make the report of a registration, also as PDF.", epilog=_EXAMPLES + EXIT_CODES)
@click.argument("folder", type=PATH)
@click.option(
    "--pdf/--no-pdf",
    default=None,
    help="Print the report to report.pdf by a Chromium, Chrome or Edge of this machine.  [default: where "
    "there is one]",
)
@click.option(
    "--figures/--no-figures", default=True, help="Write every picture as PNG, too.  [default: figures]"
)
@quiet_option
@debug_option
def report(folder: Path, pdf: bool | None, figures: bool, quiet: bool) -> None:
    """Make the report of a registration from what `tmchho register` left in FOLDER.

    \b
    Writes into the same folder, replacing an earlier report:
      report.html  one file that loads nothing from anywhere
      report.pdf   the same on paper
      figures/     the pictures as PNG

    Nothing is computed again: the figures are those of result.json.
    """  # noqa: D301 (\b is for click: keep these lines as they are)
    from tmchho.report import write_report

    with display(quiet) as shown, shown.step("report", "making the report"):
        files = write_report(folder, pdf=pdf, figures=figures)
    click.echo("\n".join(["written:", *(f"  {path}" for path in files)]))
