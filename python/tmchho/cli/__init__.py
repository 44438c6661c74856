"""The command line: one file for each command.

Results go to stdout, everything else to stderr; the exit code says how it ended. Whatever takes long to
import is imported inside the commands, so that ``--help`` answers at once.
"""

import click

from tmchho.cli.apply import apply
from tmchho.cli.completion import completion
from tmchho.cli.config import config
from tmchho.cli.demo import demo
from tmchho.cli.doctor import doctor
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


_EXAMPLES = """\b
Examples:
  tmchho demo                                   # a simulated site into out/demo
  tmchho register uav.las tls.laz -o out        # moves uav.las onto tls.laz
  tmchho COMMAND --help                         # all options, with examples

"""


@click.group(
    cls=Commands,
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog=_EXAMPLES + EXIT_CODES,
)
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

    Try `tmchho demo` first.
    """
    from tmchho.room import spare_addresses

    spare_addresses()


# In the order in which a newcomer needs them: `--help` lists them so.
_COMMANDS = (demo, info, register, report, view, evaluate, apply, network, config, paper, doctor, completion)
for _command in _COMMANDS:
    main.add_command(_command)

__all__ = ["main"]
