"""The command line: one file for each command.

Results go to stdout, everything else to stderr; the exit code says how it ended. Whatever takes long to
import is imported inside the commands, so that ``--help`` answers at once.
"""

import click

from tmchho.cli.apply import apply
from tmchho.cli.config import config
from tmchho.cli.demo import demo
from tmchho.cli.evaluate import evaluate
from tmchho.cli.failures import EXIT_CODES, Commands
from tmchho.cli.info import info
from tmchho.cli.network import network
from tmchho.cli.paper import paper
from tmchho.cli.register import register
from tmchho.cli.report import report
from tmchho.cli.view import view


def _print_version(context: click.Context, _option: click.Parameter, wanted: bool) -> None:
    if wanted:
        from tmchho import __version__

        click.echo(f"tmchho {__version__}")
        context.exit()


@click.group(cls=Commands, context_settings={"help_option_names": ["-h", "--help"]}, epilog=EXIT_CODES)
@click.option(
    "--version",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=_print_version,
    help="Show the version and exit.",
)
def main() -> None:
    """Register point clouds of different sensors, without targets and without an initial guess.

    SOURCE is moved, TARGET stays where it is. Try `tmchho demo` first.
    """


for _command in (register, network, evaluate, apply, info, demo, config, paper, report, view):
    main.add_command(_command)

__all__ = ["main"]
