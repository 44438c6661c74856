"""From words and figures to a page that needs nothing else."""

from __future__ import annotations

from importlib.resources import files
from importlib.util import find_spec
from typing import Any

from tmchho.errors import InvalidArgumentError
from tmchho.report import colours, words

NEEDED = ("jinja2", "matplotlib")


def missing_extras() -> str | None:
    """Return what to say where a library of the extra `report` is missing, None where all are there."""
    missing = [name for name in NEEDED if find_spec(name) is None]
    if not missing:
        return None
    return f"a report needs {' and '.join(missing)}; get it by: pip install 'tmchho[report]'"


def require_extras() -> None:
    """Make sure that a page can be made.

    Raises
    ------
    InvalidArgumentError
        Naming what is missing and how to get it.
    """
    missing = missing_extras()
    if missing is not None:
        raise InvalidArgumentError(missing)


def render(template: str, has_viewer: bool, **context: Any) -> str:
    """Return a page.

    Parameters
    ----------
    template : str
        Name of its template in this package.
    has_viewer : bool
        Whether the page has a 3D view.
    **context
        What the template names.

    Returns
    -------
    str
        HTML with all styles and scripts in it.
    """
    from jinja2 import Environment, FunctionLoader, StrictUndefined
    from markupsafe import Markup

    environment = Environment(
        loader=FunctionLoader(_text),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=StrictUndefined,
    )
    environment.filters |= {
        "number": words.number,
        "length": words.length,
        "percent": words.percent,
        "count": words.count,
    }
    shades = {
        "source": colours.SOURCE,
        "target": colours.TARGET,
        "source_on_dark": colours.SOURCE_ON_DARK,
        "target_on_dark": colours.TARGET_ON_DARK,
        "marked": colours.MARKED,
        "faint": colours.FAINT,
    }
    return environment.get_template(template).render(
        css=Markup(_text("page.css")),
        scripts={
            "viewer": Markup(_text("viewer.js")) if has_viewer else "",
            "page": Markup(_text("page.js")),
        },
        colours=shades,
        **context,
    )


def _text(name: str) -> str:
    return files("tmchho.report").joinpath(name).read_text(encoding="utf-8")
