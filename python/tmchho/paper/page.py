"""The page: every section asked for, in one HTML file that needs nothing else."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from importlib.resources import files

from tmchho import __version__
from tmchho.paper.plan import Content, Section
from tmchho.paper.tables import Column, Table


def page(sections: Sequence[tuple[Section, Content]], command: str) -> str:
    """Return the page as HTML.

    Parameters
    ----------
    sections : sequence of (Section, Content)
        In the order of the page.
    command : str
        The command that makes the same page again.

    Returns
    -------
    str
        With the pictures in it; it loads nothing from anywhere.
    """
    from jinja2 import Environment

    environment = Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True)
    environment.filters["base64"] = lambda png: base64.b64encode(png).decode("ascii")
    environment.globals["kinds"] = _kinds
    template = files("tmchho.paper").joinpath("page.html.jinja").read_text(encoding="utf-8")
    return environment.from_string(template).render(sections=sections, command=command, version=__version__)


def _kinds(table: Table, column: Column) -> str:
    return " ".join(filter(None, ("text" * table.is_text(column), "printed" * column.is_printed)))
