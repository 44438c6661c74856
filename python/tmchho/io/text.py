"""Plain text: one point a line, as total stations, spreadsheets and CloudCompare write it.

Why so much guessing: there is no standard. Separator, decimal comma, header line, comments and a leading
number of points are recognised from the first lines; what was assumed is said.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tmchho.cloud import PointCloud
from tmchho.errors import ReadError
from tmchho.io.fields import (
    AXES,
    COLOURS,
    NORMALS,
    attributes_to_write,
    canonical_name,
    canonical_names,
    cloud_from_columns,
    is_integral,
    split_columns,
)
from tmchho.io.format import NOTE, Format
from tmchho.io.table import is_number, parse_table, split_line, write_table

logger = logging.getLogger(__name__)

_COMMENT_MARKS = ("//", "#", "%", "!", ";")
_COMMENT_LINE = re.compile(rb"^[ \t]*(?://|[#%!;]).*$", re.MULTILINE)

_COUNT_LINE = re.compile(rb"^[ \t]*\d{1,18}[ \t]*$", re.MULTILINE)

# (separator, decimal mark), the stricter reading first: the first of the best ones wins.
_DIALECTS = ((";", "."), (";", ","), ("\t", "."), ("\t", ","), (",", "."), (None, "."), (None, ","))
_SEPARATOR_NAMES = {";": "semicolons", "\t": "tabs", ",": "commas", None: "blanks"}

# Surveyors' words for the axes, on top of the names all formats share.
_AXIS_NAMES = {
    **{"easting": "x", "east": "x", "e": "x"},
    **{"northing": "y", "north": "y", "n": "y"},
    **{"elevation": "z", "height": "z", "h": "z"},
}

# What Leica's .pts puts after x y z, by the total number of columns.
_PTS_COLUMNS = {4: ("intensity",), 6: COLOURS, 7: ("intensity", *COLOURS)}

_N_LOOKED_AT = 20  # lines after the first point, which tell whether a word in it is a mistake
_MAX_PREAMBLE = 1000  # lines in which the first point must turn up


@dataclass(frozen=True)
class _Layout:
    """Where the numbers are and what they are called."""

    separator: str | None
    decimal: str
    first_line: int  # of the numbers, counted from 1
    n_columns: int
    numeric: list[int]  # columns that hold numbers, counted from 0
    names: list[str] | None  # of all columns, from a header
    n_announced: int | None  # points, where the file says so


def _read(path: Path) -> PointCloud:
    data = _as_utf8_lines(path.read_bytes())
    layout = _recognise(data)
    body = data.split(b"\n", layout.first_line - 1)[-1]
    if any(mark.encode() in body for mark in _COMMENT_MARKS):
        body = _COMMENT_LINE.sub(b"", body)  # the lines stay, empty, so that line numbers stay right
    if layout.n_announced is not None:
        body, layout = _without_further_counts(body, layout)
    if layout.decimal == ",":
        body = body.replace(b",", b".")
    all_numeric = len(layout.numeric) == layout.n_columns
    table = parse_table(
        body,
        layout.n_columns,
        separator=layout.separator,
        columns=None if all_numeric else layout.numeric,
        first_line=layout.first_line,
    )
    if layout.n_announced is not None and len(table) < layout.n_announced:
        raise ReadError(
            f"is truncated: expected {layout.n_announced} points, file holds {len(table)}; copy it again"
        )
    if layout.n_announced is not None and len(table) > layout.n_announced:
        logger.warning("%s: announces %d points and holds %d", path, layout.n_announced, len(table))
    columns = _named_columns(table, layout, path)
    logger.log(
        NOTE,
        "%s: assumed %s between values, decimal '%s', numbers from line %d on, columns %s",
        *(path, _SEPARATOR_NAMES[layout.separator], layout.decimal, layout.first_line, " ".join(columns)),
    )
    metadata = {"format": "text", "separator": layout.separator, "decimal": layout.decimal}
    return cloud_from_columns(columns, metadata, str(path))


def _without_further_counts(body: bytes, layout: _Layout) -> tuple[bytes, _Layout]:
    """Add up the counts of a file of several scans, each of which begins with its own."""
    counts = _COUNT_LINE.findall(body)
    if not counts:
        return body, layout
    n_announced = (layout.n_announced or 0) + sum(map(int, counts))
    return _COUNT_LINE.sub(b"", body), replace(layout, n_announced=n_announced)


def _as_utf8_lines(data: bytes) -> bytes:
    """Return the text without byte order mark, its lines ending in a newline character."""
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        data = data.decode("utf-16").encode()
    data = data.removeprefix(b"\xef\xbb\xbf")
    return data.replace(b"\r\n", b"\n").replace(b"\r", b"\n") if b"\r" in data else data


def _recognise(data: bytes) -> _Layout:
    """Find the first line of numbers and read what stands before it."""
    header: tuple[int, str] | None = None
    comment: str | None = None
    n_announced: int | None = None
    for number, raw in enumerate(data.split(b"\n", _MAX_PREAMBLE)[:_MAX_PREAMBLE], 1):
        line = raw.decode("utf-8", errors="replace").strip()
        if not line:
            continue
        if line.startswith(_COMMENT_MARKS):
            comment = line.lstrip("/#%!; \t")
            continue
        dialect = max(_DIALECTS, key=lambda candidate: len(_numeric_columns(line, *candidate)))
        numeric = _numeric_columns(line, *dialect)
        n_columns = len(split_line(line, dialect[0]))
        if len(numeric) >= 3:
            _check_dropped(data, number, dialect, numeric, n_columns)
            names = _names(header, comment, dialect[0], n_columns)
            return _Layout(*dialect, number, n_columns, numeric, names, n_announced)
        if n_announced is None and line.isdigit():
            n_announced = int(line)
        elif numeric and len(numeric) == n_columns:
            plural = "value" if n_columns == 1 else "values"
            raise ReadError(
                f"line {number} has {n_columns} {plural}; x, y and z are needed; choose one with all three"
            )
        elif header is None:
            header = (number, line)
        else:
            raise ReadError(f"line {number} is not a line of numbers; remove what is not points")
    if header is not None:
        raise ReadError(
            f"has no line of numbers (line {header[0]} begins '{header[1][:40]}'); choose a point cloud"
        )
    raise ReadError("contains no points; choose a file with points")


def _check_dropped(
    data: bytes, first_line: int, dialect: tuple[str | None, str], numeric: list[int], n_columns: int
) -> None:
    """Raise if a word of the first point is no number, but all that stand below it are."""
    lines = data.split(b"\n", first_line + _N_LOOKED_AT)[first_line : first_line + _N_LOOKED_AT]
    decoded = [line.decode("utf-8", errors="replace").strip() for line in lines]
    points = [line for line in decoded if line and not line.startswith(_COMMENT_MARKS)]
    below = [set(_numeric_columns(line, *dialect)) for line in points]
    for column in sorted(set(range(n_columns)) - set(numeric)):
        if below and all(column in others for others in below):
            raise ReadError(
                f"line {first_line}, column {column + 1} is not a number, but those below it are; correct it"
            )


def _numeric_columns(line: str, separator: str | None, decimal: str) -> list[int]:
    words = split_line(line, separator)
    if decimal == ",":
        words = ["not a number" if "." in word else word.replace(",", ".") for word in words]
    return [index for index, word in enumerate(words) if is_number(word)]


def _names(
    header: tuple[int, str] | None, comment: str | None, separator: str | None, n_columns: int
) -> list[str] | None:
    """Return the columns' names from the header line, or from a comment that looks like one."""
    line = header[1] if header else comment
    if line is None:
        return None
    # Some headers are separated otherwise than their numbers.
    splits = (split_line(line, separator), [word for word in re.split(r"[\s,;\"']+", line) if word])
    words = next((words for words in splits if len(words) == n_columns), None)
    if header is None:
        is_header = words is not None and set(AXES) <= {canonical_name(word) for word in words}
        return canonical_names(words) if words and is_header else None
    if words is None:
        raise ReadError(
            f"line {header[0]} names {len(splits[0])} columns but the numbers have {n_columns}; correct it"
        )
    names = canonical_names(words)
    if not set(AXES) & set(names):
        names = canonical_names([_AXIS_NAMES.get(word.lower(), word) for word in words])
    return names


def _named_columns(table: NDArray[np.float64], layout: _Layout, path: Path) -> dict[str, NDArray[Any]]:
    if layout.names is None:
        names = _names_by_position(table, path)
    else:
        names = [layout.names[index] for index in layout.numeric]
        dropped = [name for name in layout.names if name not in names]
        if dropped:
            logger.warning("%s: columns without numbers are left out: %s", path, ", ".join(dropped))
        if not set(AXES) & set(names):
            logger.warning("%s: no column is called x, y or z; taking %s", path, ", ".join(names[:3]))
            names[:3] = AXES
    return {
        name: table[:, index] if name in AXES else _narrowed(name, table[:, index])
        for index, name in enumerate(names)
    }


def _names_by_position(table: NDArray[np.float64], path: Path) -> list[str]:
    """Name the columns of a file without header: x y z, then colours or normals where the values allow."""
    n_columns = table.shape[1]
    names = [*AXES, *(f"column_{number}" for number in range(4, n_columns + 1))]
    if n_columns > 3 and len(table) > 2 and (np.diff(table[:, 0]) == 1).all():
        logger.warning("%s: the first column counts up by one and is taken as x; is it a point number?", path)
    if path.suffix.lower() == ".pts" and n_columns in _PTS_COLUMNS:
        names[3:] = _PTS_COLUMNS[n_columns]
    elif n_columns >= 6 and is_integral(table[:, 3:6], 0, 255) and table[:, 3:6].max(initial=0) > 1:
        names[3:6] = COLOURS
    if _are_directions(table[:, 3:6]):
        names[3:6] = NORMALS
    elif names[3:6] == list(COLOURS) and _are_directions(table[:, 6:9]):
        names[6:9] = NORMALS
    return names


def _are_directions(table: NDArray[np.float64]) -> bool:
    """Return whether every row is a vector of length 1, as normals are."""
    return table.shape[1] == 3 and bool((np.abs(np.linalg.norm(table, axis=1) - 1) < 1e-3).all())


def _narrowed(name: str, values: NDArray[np.float64]) -> NDArray[Any]:
    """Return whole numbers as integers, so that classes and colours are what they were."""
    if name == "gps_time" or not is_integral(values, -(2**53), 2**53):
        return values
    if name in COLOURS and is_integral(values, 0, 65535):
        return values.astype(np.uint8 if values.max(initial=0) <= 255 else np.uint16)
    return values.astype(np.int64)


def _write(cloud: PointCloud, path: Path, kept: Mapping[str, Any]) -> None:
    """Write commas and a header line for .csv, a number of points for .pts, else blanks and a // line."""
    if path.suffix.lower() == ".csv":
        with writing_csv_parts(path, cloud) as put:
            put(cloud)
        return
    columns: dict[str, NDArray[Any]] = {axis: cloud.xyz[:, index] for index, axis in enumerate(AXES)}
    columns.update(split_columns(attributes_to_write(cloud)))
    suffix = path.suffix.lower()
    header = f"//{' '.join(columns)}\n"
    if suffix == ".pts":
        standard = (*AXES, *_PTS_COLUMNS.get(len(columns), ()))
        if set(columns) == set(standard):  # Leica's own order needs no names
            columns = {name: columns[name] for name in standard}
            header = ""
        header = f"{len(cloud)}\n{header}"
    with path.open("wb") as stream:
        stream.write(header.encode())
        write_table(stream, list(columns.values()), b" ")


@contextmanager
def writing_csv_parts(path: Path, first: PointCloud) -> Iterator[Callable[[PointCloud], None]]:
    """Open a file for clouds with the attributes of `first`; lends what writes one of them after another."""

    def columns(cloud: PointCloud) -> dict[str, NDArray[Any]]:
        coordinates: dict[str, NDArray[Any]] = {axis: cloud.xyz[:, at] for at, axis in enumerate(AXES)}
        return coordinates | split_columns(attributes_to_write(cloud))

    with path.open("wb") as stream:
        stream.write((",".join(columns(first)) + "\n").encode())
        yield lambda part: write_table(stream, list(columns(part).values()), b",")


FORMAT = Format(
    name="text",
    extensions=(".xyz", ".txt", ".csv", ".asc", ".pts"),
    recognises=lambda head: False,  # no mark tells; see `tmchho.io.kinds`
    read=_read,
    write=_write,
)
