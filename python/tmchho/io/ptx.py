"""PTX: Leica's text format of gridded scans, each with the pose of its scanner.

A scan is two lines with the size of its grid (columns, rows), four with the scanner's place and axes, four
with the matrix that takes its points to the common frame (of rows: the shift is in the last line), and one
line for each cell, column by column: ``x y z intensity [red green blue]``. Cells without a point hold zeros.

Source: Leica Geosystems, "Cyclone pointcloud export format: description of ASCII .ptx format".
"""

from __future__ import annotations

import logging
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tmchho.cloud import PointCloud
from tmchho.errors import ReadError
from tmchho.io.fields import COLOURS, attributes_to_write, cast_if_it_fits, colours_as_8_bit
from tmchho.io.format import NOTE, Format
from tmchho.io.scans import COLUMN, ROW, SCAN_INDEX, Scan, check_pose, joined, split, valid_points
from tmchho.io.table import BLANK_LINE, parse_table, write_table

logger = logging.getLogger(__name__)

_N_HEADER_LINES = 10
_HEADER_WIDTHS = (1, 1, 3, 3, 3, 3, 4, 4, 4, 4)
_COLUMNS = {3: (), 4: ("intensity",), 7: ("intensity", *COLOURS)}
_EMPTY_INTENSITY = 0.5  # of cells without a point


def _recognises(head: bytes) -> bool:
    """Return whether the first lines have as many words as those of a scan, the first two a whole number."""
    lines = [line.split() for line in re.split(rb"[\r\n]+", head.lstrip(), maxsplit=_N_HEADER_LINES)]
    return (
        len(lines) > _N_HEADER_LINES
        and tuple(map(len, lines[:_N_HEADER_LINES])) == _HEADER_WIDTHS
        and all(line[0].isdigit() for line in lines[:2])
    )


def _read(path: Path) -> PointCloud:
    data = path.read_bytes().replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    data = BLANK_LINE.sub(b"", data).removesuffix(b"\n")
    ends = np.append(np.flatnonzero(np.frombuffer(data, dtype=np.uint8) == ord("\n")), len(data))
    parts: list[PointCloud] = []
    scans: list[Scan] = []
    line, number = 0, 0
    while line < len(ends):
        n_columns, n_rows, matrix = _read_header(data, ends, line, number)
        line += _N_HEADER_LINES
        n_cells = n_columns * n_rows
        if n_cells > len(ends) - line:
            raise ReadError(
                f"is truncated: expected {n_cells} points in scan {number + 1}, "
                f"file holds {len(ends) - line}; copy it again"
            )
        body = data[_start(ends, line) : _start(ends, line + n_cells)]
        scan = Scan("", matrix)
        part = _read_points(body, line + 1, n_rows, scan, number, path) if n_cells else None
        if part is not None and len(part):
            parts.append(part)
            scans.append(scan)
        line += n_cells
        number += 1
    if not parts:
        raise ReadError("contains no points: every cell of its grids is empty; choose a file with points")
    return joined(parts, scans, {"format": "ptx"})


def _start(ends: NDArray[np.intp], line: int) -> int:
    return int(ends[line - 1]) + 1 if line else 0


def _read_header(
    data: bytes, ends: NDArray[np.intp], line: int, number: int
) -> tuple[int, int, NDArray[np.float64]]:
    last = min(line + _N_HEADER_LINES, len(ends)) - 1
    words = [text.split() for text in data[_start(ends, line) : int(ends[last])].split(b"\n")]
    is_size = len(words) > 1 and all(len(line) == 1 and line[0].isdigit() for line in words[:2])
    if not is_size or tuple(map(len, words)) != _HEADER_WIDTHS:
        raise ReadError(
            f"line {line + 1} does not begin the header of scan {number + 1} (columns, rows, 4 lines of the "
            "scanner, 4 of the matrix); export it again"
        )
    try:
        matrix = np.array([[float(word) for word in row] for row in words[6:]]).T
    except ValueError as error:
        raise ReadError(f"the matrix of scan {number + 1} is not of numbers; export it again") from error
    check_pose(matrix, number)
    return int(words[0][0]), int(words[1][0]), matrix


def _read_points(
    body: bytes, first_line: int, n_rows: int, scan: Scan, number: int, path: Path
) -> PointCloud:
    n_values = len(body.partition(b"\n")[0].split())
    if n_values not in _COLUMNS:
        raise ReadError(f"line {first_line} has {n_values} values; 3, 4 or 7 are known")
    table = parse_table(body, n_values, first_line=first_line)
    local = np.ascontiguousarray(table[:, :3])
    attributes: dict[str, NDArray[Any]] = {}
    for index, name in enumerate(_COLUMNS[n_values], 3):
        values = np.ascontiguousarray(table[:, index])
        attributes[name] = cast_if_it_fits(values, "u1") if name in COLOURS else values
    is_valid = np.asarray(local.any(axis=1))
    if not is_valid.all():  # a grid with gaps is only a grid while the places of its points are known
        cells = np.arange(len(local), dtype=np.uint32)
        attributes[COLUMN], attributes[ROW] = np.divmod(cells, np.uint32(n_rows))
    return valid_points(scan.to_world(local), attributes, is_valid, str(path), number)


def _write(cloud: PointCloud, path: Path, kept: Mapping[str, Any]) -> None:
    attributes = colours_as_8_bit(attributes_to_write(cloud))
    held = ("intensity", *COLOURS) if all(name in attributes for name in COLOURS) else ("intensity",)
    lost = [name for name in attributes if name not in (*held, SCAN_INDEX, ROW, COLUMN)]
    if lost:
        logger.warning("PTX has room for intensity and colours only; left out: %s", ", ".join(lost))
    with path.open("wb") as stream:
        for scan, rows in split(cloud, kept):
            n_columns, n_rows, cells = _grid(attributes, rows)
            local = scan.from_world(cloud.xyz[rows])
            n_hidden = len(local) - int(np.count_nonzero(local.any(axis=1)))
            if n_hidden:
                logger.warning("%d points lie in the scanner itself, which PTX takes for no point", n_hidden)
            columns = [(values, 0.0) for values in local.T]
            for name in held:
                empty = _EMPTY_INTENSITY if name == "intensity" else 0
                values = attributes[name][rows] if name in attributes else np.full(len(rows), empty)
                columns.append((values, empty))
            stream.write(_header(scan, n_columns, n_rows).encode())
            filled = [_filled(values, cells, n_columns * n_rows, empty) for values, empty in columns]
            write_table(stream, filled, b" ")


def _filled(values: NDArray[Any], cells: NDArray[np.intp], n_cells: int, empty: float) -> NDArray[Any]:
    """Return the values of a whole grid, `empty` where it has no point."""
    if n_cells > len(cells) and empty % 1:
        values = values.astype(np.float64)
    result = np.full(n_cells, empty, dtype=values.dtype)
    result[cells] = values
    return result


def _grid(
    attributes: Mapping[str, NDArray[Any]], rows: NDArray[np.intp]
) -> tuple[int, int, NDArray[np.intp]]:
    """Return the size of the grid and the cell of each point: those it came from, or one long column."""
    if ROW in attributes and COLUMN in attributes:
        row, column = (attributes[name][rows].astype(np.int64) for name in (ROW, COLUMN))
        n_columns, n_rows = int(column.max()) + 1, int(row.max()) + 1
        cells = column * n_rows + row
        is_grid = min(row.min(), column.min()) >= 0 and n_columns * n_rows <= 100 * len(rows)
        if is_grid and len(np.unique(cells)) == len(cells):
            return n_columns, n_rows, cells
        logger.log(NOTE, "rows and columns of the points are not those of one grid; written as one column")
    return 1, len(rows), np.arange(len(rows))


def _header(scan: Scan, n_columns: int, n_rows: int) -> str:
    matrix = scan.world_from_scan.T
    lines = [*matrix[[3, 0, 1, 2], :3].tolist(), *matrix.tolist()]
    return "\n".join([str(n_columns), str(n_rows), *(" ".join(map(repr, line)) for line in lines), ""])


FORMAT = Format(name="PTX", extensions=(".ptx",), recognises=_recognises, read=_read, write=_write)
