"""A table, as a CSV file with every digit and as text for the page."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Column:
    """One column.

    Parameters
    ----------
    key : str
        Its name in the CSV file and in the rows.
    title : str
        Its heading on the page.
    form : str
        How numbers look on the page, as in `format`.
    is_printed : bool
        Whether it holds what the paper prints.
    """

    key: str
    title: str
    form: str = ""
    is_printed: bool = False

    def text(self, value: Any) -> str:
        """Return a value as the page shows it; nothing is a dash."""
        if value is None:
            return "–"
        if isinstance(value, bool):
            return "yes" if value else "no"
        if isinstance(value, float) and not math.isfinite(value):
            return "–" if math.isnan(value) else ("∞" if value > 0 else "−∞")
        if value == 0 and self.form.endswith("e"):
            return "0"
        return format(value, self.form if isinstance(value, (int, float)) else "")


@dataclass(frozen=True)
class Table:
    """A table.

    Parameters
    ----------
    name : str
        Name of its CSV file, without the ending.
    caption : str
        What it holds, with the unit.
    columns : sequence of Column
    rows : sequence of mapping
        One value for each column; a missing one is None.
    on_page : bool
        Whether the page shows it; curves are files only.
    n_group_columns : int
        Rows that agree in so many of the first columns belong together; the page draws a line between others.
    """

    name: str
    caption: str
    columns: Sequence[Column]
    rows: Sequence[Mapping[str, Any]]
    on_page: bool = True
    n_group_columns: int = 1

    def csv(self) -> str:
        """Return the table as CSV: every digit, nothing for None."""
        stream = io.StringIO()
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow([column.key for column in self.columns])
        for row in self.rows:
            writer.writerow([_exact(row.get(column.key)) for column in self.columns])
        return stream.getvalue()

    def is_text(self, column: Column) -> bool:
        """Return whether a column holds words, which the page sets to the left."""
        return all(isinstance(row.get(column.key), (str, type(None))) for row in self.rows)

    def is_grouped(self) -> bool:
        """Return whether any rows belong together."""
        keys = [column.key for column in self.columns[: self.n_group_columns]]
        return len({tuple(row.get(key) for key in keys) for row in self.rows}) < len(self.rows)

    def texts(self) -> list[list[str]]:
        """Return the cells as the page shows them."""
        return [[column.text(row.get(column.key)) for column in self.columns] for row in self.rows]


def _exact(value: Any) -> str:
    return "" if value is None else repr(value) if isinstance(value, float) else str(value)
