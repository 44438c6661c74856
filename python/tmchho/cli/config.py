"""`tmchho config`: all settings with their defaults, ready to be saved and changed."""

from __future__ import annotations

import inspect
import json
import re
import textwrap
from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import click

from tmchho.cli.failures import debug_option

_WIDTH = 100

_EXAMPLES = """\b
Examples:
  tmchho config > settings.toml
  # change a line in it, then
  tmchho register uav.laz tls.laz -o out --config settings.toml

"""


@click.command(short_help="Print all settings with their defaults.", epilog=_EXAMPLES)
@debug_option
def config() -> None:
    """Print all settings with their defaults, as TOML for `tmchho register --config`.

    Every setting is commented out: take the # away from what you change.
    """
    from tmchho import Config, default_config

    click.echo("# Settings of tmchho with their defaults. Take the # away from what you change.")
    click.echo("\n".join(toml_lines(default_config(), Config)))


def toml_lines(settings: Mapping[str, Any], section: type, path: str = "") -> list[str]:
    """Return settings as commented-out TOML, explained in the words of the class's docstring.

    Parameters
    ----------
    settings : mapping
        The defaults; None means that the value is derived.
    section : type
        The dataclass that has these keys; its fields that are dataclasses are sections of their own.
    path : str
        Name of the section, empty at the top.
    """
    words = _explanations(section)
    sections = {field.name: type(field.default) for field in fields(section) if field.name in settings}
    lines = [f"[{path}]"] if path else []
    for key, value in settings.items():
        if not isinstance(value, Mapping):
            lines += [
                "",
                *textwrap.wrap(words.get(key, key), _WIDTH, initial_indent="# ", subsequent_indent="# "),
            ]
            lines.append(f"#{key} = {'...' if value is None else json.dumps(value)}")
    for key, value in settings.items():
        if isinstance(value, Mapping):
            inner = f"{path}.{key}" if path else key
            title = (inspect.getdoc(sections[key]) or key).partition("\n")[0]
            lines += ["", "", f"# {title}", *toml_lines(value, sections[key], inner)]
    return lines


def _explanations(section: type) -> dict[str, str]:
    """Return what a docstring in numpydoc's form says about each parameter."""
    _, _, parameters = (inspect.getdoc(section) or "").partition("----------\n")
    found: dict[str, str] = {}
    for names, text in re.findall(r"^(\w[\w, ]*?)(?: :.*)?\n((?:[ ]{4}.*\n?)+)", parameters, re.MULTILINE):
        found.update(dict.fromkeys(re.split(r",\s*", names), " ".join(text.split())))
    return found
