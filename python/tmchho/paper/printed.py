"""The numbers that the paper prints, as they stand there.

Source: Ren, Zhao & Han (2023), Tables 3 to 7 (CC BY 4.0).
"""

from __future__ import annotations

import csv
from functools import lru_cache
from importlib.resources import files


@lru_cache
def printed_table(number: int) -> tuple[dict[str, str], ...]:
    """Return the rows of a table of the paper.

    Parameters
    ----------
    number : int
        3 to 7.

    Returns
    -------
    tuple of dict
        From heading to text.

    Examples
    --------
    >>> printed_table(5)[1]
    {'model': 'bunny', 'icp': '1.75e-2', 'tmchho_icp': '4.33e-4'}
    """
    text = files("tmchho.paper").joinpath("printed", f"table{number}.csv").read_text(encoding="utf-8")
    return tuple(csv.DictReader(text.splitlines()))


def printed_row(number: int, **where: object) -> dict[str, str]:
    """Return the row of a table in which the columns have these values; empty where there is none.

    Examples
    --------
    >>> printed_row(3, function="f1", algorithm="HHO", dimension=10)["ave"]
    '2.34e-22'
    """
    for row in printed_table(number):
        if all(row[column] == str(value) for column, value in where.items()):
            return row
    return {}


def printed_number(row: dict[str, str], column: str) -> float | None:
    """Return a printed number, or None where nothing is printed."""
    return float(row[column]) if column in row else None
