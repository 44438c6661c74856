"""`tmchho completion`: the script that lets a shell complete commands and options."""

from __future__ import annotations

import click
from click.shell_completion import get_completion_class

from tmchho.cli.failures import debug_option

_EXAMPLES = """\b
Examples:
  eval "$(tmchho completion bash)"                # in ~/.bashrc
  eval "$(tmchho completion zsh)"                 # in ~/.zshrc
  tmchho completion fish > ~/.config/fish/completions/tmchho.fish

"""


@click.command(short_help="Print what lets a shell complete commands and options.", epilog=_EXAMPLES)
@click.argument("shell", type=click.Choice(["bash", "zsh", "fish"]))
@debug_option
def completion(shell: str) -> None:
    """Print the script for SHELL that completes commands, options and file names."""
    found = get_completion_class(shell)
    assert found is not None  # click knows all three
    root = click.get_current_context().find_root().command
    click.echo(found(root, {}, "tmchho", "_TMCHHO_COMPLETE").source())
