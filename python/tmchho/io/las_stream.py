"""LAS and LAZ in parts: clouds larger than memory, point records as the file has them.

Why records and not clouds: what only passes through a program must not change on its way, and the fastest
way to keep an attribute is not to look at it.
"""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import laspy  # type: ignore[import-untyped, unused-ignore]
import numpy as np
from numpy.typing import NDArray

from tmchho.errors import ReadError
from tmchho.io.las import crs_of
from tmchho.io.las_extra import ExtraDimension, read_dimensions
from tmchho.io.las_grid import Grid
from tmchho.io.las_header import EXTRA_BYTES, POINT_BYTES, LasHeader, read_header
from tmchho.io.las_write import open_las_writer
from tmchho.io.laz import decompress_parts

Records = NDArray[np.void]
_Item = TypeVar("_Item")

POINTS_AT_ONCE = 500_000


@dataclass(frozen=True)
class LasPoints:
    """A LAS or LAZ file of which only the header has been read.

    Parameters
    ----------
    path : Path
        The file.
    header : LasHeader
        Checked against the file.
    extra : tuple of ExtraDimension
        The extra dimensions of its points.
    """

    path: Path
    header: LasHeader
    extra: tuple[ExtraDimension, ...]

    @classmethod
    def open(cls, path: Path) -> LasPoints:
        """Read the header of a file with at least one point.

        Raises
        ------
        ReadError
            If the header is damaged, promises more than the file holds, or there are no points.
        """
        header = read_header(path)
        if header.n_points == 0:
            raise ReadError("contains no points; choose a file with points")
        standard = laspy.PointFormat(header.point_format)
        taken = {*(dimension.name for dimension in standard.dimensions), *standard.dtype().names}
        n_extra_bytes = header.point_bytes - POINT_BYTES[header.point_format]
        return cls(path, header, tuple(read_dimensions(header.find_all(EXTRA_BYTES), n_extra_bytes, taken)))

    def __len__(self) -> int:
        return self.header.n_points

    @property
    def point_format(self) -> Any:
        """The point format with its extra dimensions, as laspy describes it."""
        point_format = laspy.PointFormat(self.header.point_format)
        for dimension in self.extra:
            point_format.add_extra_dimension(dimension.parameters)
        return point_format

    @property
    def crs(self) -> str | None:
        """Coordinate reference system as WKT, if known."""
        return crs_of(self.header)

    def parts(self, points_at_once: int = POINTS_AT_ONCE) -> Iterator[Records]:
        """Give the point records in the file's order, about so many at once, read ahead by a thread."""
        dtype = self.point_format.dtype()
        read: Iterator[Records]
        if self.header.is_compressed:
            read = (part.view(dtype) for part in decompress_parts(self.path, self.header, points_at_once))
        else:
            read = self._plain_parts(dtype, points_at_once)
        return ahead(read)

    def _plain_parts(self, dtype: np.dtype[np.void], points_at_once: int) -> Iterator[Records]:
        for start in range(0, len(self), points_at_once):
            yield np.fromfile(
                self.path,
                dtype=dtype,
                count=min(points_at_once, len(self) - start),
                offset=self.header.points_at + start * dtype.itemsize,
            )

    def steps(self, records: Records) -> NDArray[np.int32]:
        """Return the (n, 3) whole numbers that stand for the coordinates."""
        return np.stack([records[axis] for axis in "XYZ"], axis=1)

    def xyz(self, steps: NDArray[np.int32]) -> NDArray[np.float64]:
        """Return the coordinates, (n, 3), of whole numbers."""
        # As the reader of whole files: product, then sum, axis by axis.
        return np.asarray(steps * np.array(self.header.scales) + np.array(self.header.offsets))

    def attributes(self, records: Records) -> dict[str, NDArray[Any]]:
        """Return the attributes of records, under the names and with the types of `tmchho.read`."""
        point_format = self.point_format
        unpacked = laspy.PackedPointRecord(records, point_format)
        standard = [dimension.name for dimension in laspy.PointFormat(self.header.point_format).dimensions]
        found = {name: np.array(unpacked[name]) for name in standard if name not in ("X", "Y", "Z")}
        found.update({dimension.name: dimension.decode(records[dimension.name]) for dimension in self.extra})
        return found


@contextmanager
def las_copy(
    path: Path,
    like: LasPoints,
    grid: Grid,
    *,
    crs: str | None,
    added: Sequence[ExtraDimension] = (),
) -> Iterator[Callable[[Records], None]]:
    """Open a file of the same layout as `like`, LAZ if the name ends in .laz; lends what writes records.

    Parameters
    ----------
    path : Path
        The file to make.
    like : LasPoints
        Version, point format, extra dimensions and records are taken from it.
    grid : Grid
        Scale and offset of the coordinates.
    crs : str, optional
        Coordinate reference system; where it is that of `like`, its records stay byte for byte.
    added : sequence of ExtraDimension
        Further extra dimensions, after those of `like`.
    """
    extra = (*like.extra, *added)
    with open_las_writer(
        path,
        like.header,
        (like.header.point_format, like.header.version),
        grid,
        [dimension.parameters for dimension in extra],
        crs=crs,
        kept_crs=like.crs,
    ) as (writer, point_format):

        def write(records: Records) -> None:
            writer.write_points(laspy.PackedPointRecord(records, point_format))

        yield write


def ahead(items: Iterator[_Item], n_ahead: int = 1) -> Iterator[_Item]:
    """Give the items while a thread already computes the next ones; errors come out where they belong."""
    waiting: queue.Queue[tuple[str, Any]] = queue.Queue(n_ahead)
    stopped = threading.Event()

    def put(word: str, value: Any) -> bool:
        while not stopped.is_set():
            try:
                waiting.put((word, value), timeout=0.1)
                return True
            except queue.Full:
                continue
        return False

    def work() -> None:
        try:
            for item in items:
                if not put("item", item):
                    return
            put("end", None)
        except BaseException as error:  # handed to the reader, also a panic of a decoder
            put("error", error)

    thread = threading.Thread(target=work, daemon=True)
    thread.start()
    try:
        while True:
            word, value = waiting.get()
            if word == "end":
                return
            if word == "error":
                raise value
            yield value
    finally:
        stopped.set()
        thread.join()
