"""Numbers out of lines of text and back, at numpy's speed, with a line number when they are wrong."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator, Sequence
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from tmchho.errors import ReadError

BLANK_LINE = re.compile(rb"^[ \t]*\n", re.MULTILINE)
_WRITE_ROWS = 100_000  # lines put together at once, so that memory stays small


def parse_table(
    body: bytes,
    n_columns: int,
    *,
    separator: str | None = None,
    columns: Sequence[int] | None = None,
    first_line: int = 1,
    max_rows: int | None = None,
) -> NDArray[np.float64]:
    """Parse lines of numbers.

    Parameters
    ----------
    body : bytes
        Lines ending in a newline character; blank lines are skipped.
    n_columns : int
        Values that each line must have.
    separator : str, optional
        What stands between values; None for any blanks.
    columns : sequence of int, optional
        Columns to return, counted from 0; None for all.
    first_line : int, default 1
        Number that messages give to the first line of `body`.
    max_rows : int, optional
        Stop after this many lines.

    Returns
    -------
    (n, k) float64 array
        No rows if there are no lines.

    Raises
    ------
    ReadError
        If a line has another number of values or something that is not a number.
    """
    if not body.strip() or max_rows == 0:
        return np.empty((0, n_columns if columns is None else len(columns)))
    if n_columns > len(body):  # a header may promise any number
        raise ReadError(f"line {first_line} has fewer than the {n_columns} values expected; correct it")
    wanted = list(range(n_columns)) if columns is None else list(columns)
    if max_rows is not None:
        max_rows = min(max_rows, body.count(b"\n") + 1)  # numpy makes room for all of them at once
    # numpy complains about blank lines; for messages they stay, so that line numbers stay right.
    rows = BLANK_LINE.sub(b"", body) if BLANK_LINE.search(body) else body
    try:
        # Without `usecols` numpy insists on lines of equal length, which is the check that is needed.
        table = np.loadtxt(
            io.BytesIO(rows),
            delimiter=separator,
            comments=None,
            quotechar='"',
            ndmin=2,
            max_rows=max_rows,
            usecols=None if columns is None else wanted,
            encoding="latin-1",
        )
        if columns is None and table.shape[1] != n_columns:
            raise ValueError("wrong number of columns")
    except ValueError as error:
        raise _explained(body, n_columns, separator, wanted, first_line, max_rows, error) from None
    return np.asarray(table, dtype=np.float64)


def write_table(stream: IO[bytes], columns: Sequence[NDArray[Any]], separator: bytes) -> None:
    """Write columns of equal length as lines, each number with the fewest digits that read back as it was.

    Parameters
    ----------
    stream : binary file
        Open for writing.
    columns : sequence of (n,) arrays
        Of plain numbers.
    separator : bytes
        One character.
    """
    for start in range(0, len(columns[0]), _WRITE_ROWS):
        stream.write(_lines([values[start : start + _WRITE_ROWS] for values in columns], separator))


def _lines(columns: list[NDArray[Any]], separator: bytes) -> bytes:
    n_rows = len(columns[0])
    pieces: list[NDArray[np.uint8]] = []
    for index, values in enumerate(columns):
        # numpy writes the shortest exact digits and pads with NUL bytes, which are dropped at the end.
        words = values.astype("S32")
        pieces.append(words.view(np.uint8).reshape(n_rows, -1))
        mark = b"\n" if index == len(columns) - 1 else separator
        pieces.append(np.full((n_rows, 1), mark[0], dtype=np.uint8))
    characters = np.hstack(pieces)
    return bytes(characters[characters != 0])


def is_number(word: str) -> bool:
    """Return whether numpy's reader would take a word for a number."""
    try:
        float(word)
    except ValueError:
        return False
    return "_" not in word  # Python allows 1_000, files do not


def split_line(line: str, separator: str | None) -> list[str]:
    """Return the words of a line without blanks and quotes around them."""
    return [word.strip().strip("\"'").strip() for word in line.split(separator)]


def _explained(
    body: bytes,
    n_columns: int,
    separator: str | None,
    wanted: Sequence[int],
    first_line: int,
    max_rows: int | None,
    error: ValueError,
) -> ReadError:
    """Find the first wrong line. Slow, but only ever run on a file that has one."""
    for index, (number, line) in enumerate(_numbered_lines(body, first_line)):
        if max_rows is not None and index >= max_rows:
            break
        words = split_line(line, separator)
        if len(words) != n_columns:
            plural = "value" if len(words) == 1 else "values"
            return ReadError(
                f"line {number} has {len(words)} {plural} where {n_columns} are expected; correct it"
            )
        for column in wanted:
            if not is_number(words[column]):
                return ReadError(
                    f"line {number}, column {column + 1}: '{words[column][:40]}' is not a number; correct it"
                )
    return ReadError(f"its numbers cannot be read ({error}); export it again")


def _numbered_lines(body: bytes, first_line: int) -> Iterator[tuple[int, str]]:
    for number, line in enumerate(body.split(b"\n"), first_line):
        if line.strip():
            yield number, line.decode("latin-1")
