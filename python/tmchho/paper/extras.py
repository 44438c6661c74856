"""Libraries that only this command needs, and what to do where they are missing."""

from __future__ import annotations

from importlib.util import find_spec

from tmchho.errors import InvalidArgumentError

NEEDED = ("matplotlib", "jinja2", "scipy")


def require_extras() -> None:
    """Make sure that pictures, page and tests can be made, before anything is run.

    Raises
    ------
    InvalidArgumentError
        Naming what is missing and how to get it.
    """
    missing = [name for name in NEEDED if not is_there(name)]
    if missing:
        raise InvalidArgumentError(
            f"tmchho paper needs {' and '.join(missing)}; get it by: pip install 'tmchho[paper]'"
        )


def is_there(name: str) -> bool:
    """Return whether a library can be imported, without importing it."""
    return find_spec(name) is not None
