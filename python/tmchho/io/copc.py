"""COPC: a LAZ file whose chunks are the nodes of an octree, so that a part of it can be read alone.

The hierarchy is read here and not by laspy, because pages of it may be wrong: they may point beyond the file
or back at themselves, and a reader that believes them never ends.

Source: A. Bell, H. Butler, C. Manning, "Cloud Optimized Point Cloud Specification 1.0" (2021).
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import lazrs  # type: ignore[import-untyped, unused-ignore]
import numpy as np
from numpy.typing import NDArray

from tmchho.errors import ReadError
from tmchho.io.las_header import LasHeader
from tmchho.io.laz import MAX_POINTS_PER_BYTE, Chunk, check_layers, read_compression
from tmchho.io.window import Window

INFO = ("copc", 1)
_INFO = struct.Struct("<5d2Q")
_ENTRY = np.dtype(
    [("key", "<i4", (4,)), ("start", "<u8"), ("n_bytes", "<i4"), ("n_points", "<i4")]
)  # key: level, x, y, z
_A_PAGE = -1  # in place of a count: the entry points to a further page
_MAX_LEVEL = 30  # deeper, the integers of the keys would overflow
_POINTS_AT_ONCE = 500_000


@dataclass(frozen=True)
class _Octree:
    """The cube that is divided, the spacing of the points in its root, and where its nodes are listed.

    Points are stored as integers, so that they may lie up to `step` outside their node.
    """

    lowest: NDArray[np.float64]
    edge: float
    spacing: float
    step: float
    root_page: tuple[int, int]  # start, bytes


def decompress_part(path: Path, header: LasHeader, window: Window) -> NDArray[np.uint8]:
    """Return the bytes of all points in the nodes that a window needs.

    Parameters
    ----------
    path : Path
        The file.
    header : LasHeader
        Its header, with the record that makes it COPC.
    window : Window
        Nodes that do not touch its box are left out, and those of finer levels than its resolution.

    Returns
    -------
    uint8 array
        Whole points, in the order of the file; more than those in the box.

    Raises
    ------
    ReadError
        If the octree is damaged.
    """
    octree = _octree(header)
    compression = read_compression(header)
    n_bytes = path.stat().st_size
    with path.open("rb") as stream:
        chunks = _chunks(stream, octree, window, header, n_bytes)
        check_layers(stream, header, compression, chunks)
        data = np.empty(sum(chunk.n_points for chunk in chunks) * header.point_bytes, dtype=np.uint8)
        n_done = 0
        for group in _groups(chunks):
            packed = bytearray()
            for chunk in group:
                stream.seek(chunk.start)
                packed += stream.read(chunk.n_bytes)
            n_group = sum(chunk.n_points for chunk in group) * header.point_bytes
            table = [(chunk.n_points, chunk.n_bytes) for chunk in group]
            try:
                lazrs.decompress_points_with_chunk_table(
                    packed, compression.record, data[n_done : n_done + n_group], table
                )
            except lazrs.LazrsError as error:
                raise ReadError(
                    f"is damaged: its points cannot be decompressed ({error}); copy it again"
                ) from error
            n_done += n_group
    return data


def _octree(header: LasHeader) -> _Octree:
    record = header.find(INFO) or b""
    if len(record) < _INFO.size:
        raise ReadError("is damaged: its COPC record is too short; copy it again")
    x, y, z, half, spacing, start, n_bytes = _INFO.unpack_from(record)
    if not (all(map(math.isfinite, (x, y, z))) and 0 < half < math.inf and 0 < spacing < math.inf):
        raise ReadError(
            f"is damaged: its octree has half an edge of {half} and a spacing of {spacing}; copy it again"
        )
    return _Octree(
        np.array([x, y, z]) - half, 2 * half, spacing, max(map(abs, header.scales)), (start, n_bytes)
    )


def _chunks(
    stream: IO[bytes], octree: _Octree, window: Window, header: LasHeader, n_bytes: int
) -> list[Chunk]:
    """Return the chunks of the wanted nodes in the order of the file."""
    max_level = _MAX_LEVEL
    if window.resolution is not None:
        max_level = min(max_level, max(0, math.ceil(math.log2(octree.spacing / window.resolution))))
    chunks: list[Chunk] = []
    pages, seen, n_left = [octree.root_page], set[int](), n_bytes
    while pages:
        start, n_page = pages.pop()
        n_left -= n_page
        if start in seen or n_page < 0 or start + n_page > n_bytes or n_left < 0:
            raise ReadError(f"is damaged: a page of its octree should be at byte {start}; copy it again")
        seen.add(start)
        stream.seek(start)
        entries = np.frombuffer(stream.read(n_page // _ENTRY.itemsize * _ENTRY.itemsize), dtype=_ENTRY)
        wanted = entries[_touches(entries, octree, window, max_level)]
        for _, entry_start, n_entry, n_points in wanted.tolist():
            if n_points == _A_PAGE:
                pages.append((entry_start, n_entry))
            elif n_points > 0:
                if n_entry <= 0 or entry_start < header.points_at or entry_start + n_entry > n_bytes:
                    raise ReadError(
                        f"is truncated or damaged: {n_points} of its points should be at byte {entry_start} "
                        f"of {n_bytes}; copy it again"
                    )
                chunks.append(Chunk(entry_start, n_entry, n_points))
    n_points = sum(chunk.n_points for chunk in chunks)
    if sum(chunk.n_bytes for chunk in chunks) > n_bytes or n_points > n_bytes * MAX_POINTS_PER_BYTE:
        raise ReadError("contradicts itself: nodes of its octree overlap in the file; copy it again")
    if n_points > header.n_points:
        raise ReadError(
            f"contradicts itself: expected {header.n_points} points, its octree holds {n_points}; "
            "copy it again"
        )
    return sorted(chunks, key=lambda chunk: chunk.start)


def _touches(entries: NDArray[np.void], octree: _Octree, window: Window, max_level: int) -> NDArray[np.bool_]:
    """Return which entries belong to nodes that touch the box and are not too fine."""
    level = entries["key"][:, 0]
    wanted = (level >= 0) & (level <= max_level)
    edge = octree.edge / 2.0 ** np.clip(level, 0, _MAX_LEVEL)
    for axis in range(3):
        lowest = octree.lowest[axis] + entries["key"][:, axis + 1] * edge
        wanted &= (lowest <= window.highest[axis] + octree.step) & (
            lowest + edge >= window.lowest[axis] - octree.step
        )
    return np.asarray(wanted)


def _groups(chunks: list[Chunk]) -> list[list[Chunk]]:
    """Cut the chunks into groups of about half a million points: the decoder does not hear Ctrl-C."""
    groups: list[list[Chunk]] = []
    n_points = _POINTS_AT_ONCE
    for chunk in chunks:
        if n_points >= _POINTS_AT_ONCE:
            groups.append([])
            n_points = 0
        groups[-1].append(chunk)
        n_points += chunk.n_points
    return groups
