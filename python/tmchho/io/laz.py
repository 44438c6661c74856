"""LAZ: the compressed points of a LAS file, checked before the decoder sees them.

Why: the decoder believes every length it finds. A single wrong byte can make it ask for more memory than
there is, and then it does not raise an error but ends the whole program.

Source: M. Isenburg, "LASzip: lossless compression of LiDAR data" (2013); "LAZ Specification 1.4" (2021).
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import lazrs  # type: ignore[import-untyped, unused-ignore]
import numpy as np
from numpy.typing import NDArray

from tmchho.errors import ReadError
from tmchho.io.las_header import LASZIP, LasHeader

_POINTS_AT_ONCE = 500_000
_POINTWISE, _LAYERED = 1, 3  # the first compressor, one stream without chunks, and that of LAS 1.4
_VARIABLE_CHUNKS = 0xFFFFFFFF
# Identical points, the best case, come to less than 150 a byte.
MAX_POINTS_PER_BYTE = 500
# Layers of the parts of a point, by the number of the part; extra bytes have one layer each.
_N_LAYERS = {10: 9, 11: 1, 12: 2, 13: 1}
_EXTRA_BYTES_PART = 14
_LAYERED_PARTS = (*_N_LAYERS, _EXTRA_BYTES_PART)


@dataclass(frozen=True)
class Chunk:
    """Points that are packed together: where, how many bytes, how many points."""

    start: int
    n_bytes: int
    n_points: int


@dataclass(frozen=True)
class Compression:
    """What the LASzip record says."""

    compressor: int
    chunk_size: int
    parts: list[tuple[int, int, int]]  # number, bytes, version
    record: bytes

    @property
    def n_layers(self) -> int:
        """How many layers a chunk of the layered compressor has."""
        return sum(
            n_bytes if number == _EXTRA_BYTES_PART else _N_LAYERS.get(number, 0)
            for number, n_bytes, _ in self.parts
        )

    def with_chunk_size(self, chunk_size: int) -> bytes:
        """Return the record with another chunk size."""
        return self.record[:12] + struct.pack("<I", chunk_size) + self.record[16:]


def decompress(path: Path, header: LasHeader) -> NDArray[np.uint8]:
    """Return the bytes of all points.

    Raises
    ------
    ReadError
        If the file is truncated or damaged.
    """
    compression = read_compression(header)
    n_bytes = path.stat().st_size
    n_packed = n_bytes - header.points_at
    if header.n_points > n_packed * MAX_POINTS_PER_BYTE:
        raise ReadError(
            f"promises {header.n_points} points in {n_packed} compressed bytes, which cannot be; "
            "export it again"
        )
    with path.open("rb") as stream:
        if compression.compressor == _POINTWISE:
            stream.seek(header.points_at)
            # These old files know no chunks; any length will do, but the decoder stumbles over none.
            decoder = lazrs.LasZipDecompressor(stream, compression.with_chunk_size(_VARIABLE_CHUNKS - 1))
        else:
            _check_chunks(stream, header, compression, n_bytes)
            stream.seek(header.points_at)
            chunk_size = compression.chunk_size
            if chunk_size != _VARIABLE_CHUNKS:  # the decoder makes room for a whole chunk at once
                chunk_size = min(chunk_size, header.n_points)
            decoder = lazrs.ParLasZipDecompressor(stream, compression.with_chunk_size(chunk_size))
        data = np.empty(header.n_points * header.point_bytes, dtype=np.uint8)
        try:
            for part in _parts_between_signals(data, header, compression):
                decoder.decompress_many(part)
        except lazrs.LazrsError as error:
            raise ReadError(
                f"is damaged: its {header.n_points} points cannot be decompressed ({error}); copy it again"
            ) from error
    return data


def _parts_between_signals(
    data: NDArray[np.uint8], header: LasHeader, compression: Compression
) -> list[NDArray[np.uint8]]:
    """Cut the buffer into whole chunks: the decoder does not hear Ctrl-C, the loop over these does."""
    chunk_size = compression.chunk_size
    if compression.compressor == _POINTWISE or chunk_size == _VARIABLE_CHUNKS:
        return [data]
    step = -(-_POINTS_AT_ONCE // chunk_size) * chunk_size * header.point_bytes
    return [data[start : start + step] for start in range(0, len(data), step)]


def read_compression(header: LasHeader) -> Compression:
    """Return how the points of a file are compressed; raise ReadError if its record is missing or wrong."""
    record = header.find(LASZIP)
    if record is None or len(record) < 34:
        raise ReadError("is damaged: the record that tells how it is compressed is missing; copy it again")
    (n_parts,) = struct.unpack_from("<H", record, 32)
    listed = record[34 : 34 + 6 * n_parts]
    parts = list(struct.iter_unpack("<HHH", listed[: len(listed) // 6 * 6]))
    if len(parts) < n_parts or sum(n_bytes for _, n_bytes, _ in parts) != header.point_bytes:
        raise ReadError("contradicts itself: its compressed points have another size; export it again")
    compressor, chunk_size = struct.unpack_from("<H10xI", record)
    if any((compressor == _LAYERED) != (number in _LAYERED_PARTS) for number, _, _ in parts):
        raise ReadError(
            f"contradicts itself: compressor {compressor} for points of another kind; export it again"
        )
    return Compression(compressor, chunk_size, parts, record)


def _check_chunks(stream: IO[bytes], header: LasHeader, compression: Compression, n_bytes: int) -> None:
    """Raise if the table of chunks, at the end of the file, is missing or does not add up."""
    expected = f"expected {header.n_points} points"
    stream.seek(header.points_at)
    (table_at,) = struct.unpack("<q", stream.read(8).ljust(8, b"\0"))
    if table_at == -1:  # written to a stream: the place is in the last bytes of the file
        stream.seek(-8, 2)
        (table_at,) = struct.unpack("<q", stream.read(8))
    n_chunk_bytes = table_at - header.points_at - 8
    if n_chunk_bytes < 0 or table_at + 8 > n_bytes:
        raise ReadError(
            f"is truncated: {expected}, but its table of compressed chunks should be at byte {table_at} of "
            f"{n_bytes}; copy it again"
        )
    stream.seek(table_at)
    _, n_chunks = struct.unpack("<II", stream.read(8))
    if n_chunks * header.point_bytes > n_chunk_bytes:  # each chunk begins with one plain point
        raise ReadError(f"is damaged: {n_chunks} compressed chunks do not fit into it; copy it again")
    stream.seek(header.points_at)
    chunks: list[tuple[int, int]] = lazrs.read_chunk_table(stream, lazrs.LazVlr(compression.record))
    if sum(length for _, length in chunks) != n_chunk_bytes:
        raise ReadError(f"is damaged: {expected}, but the lengths of its chunks do not add up; copy it again")
    if compression.compressor == _LAYERED:
        listed, start = [], header.points_at + 8
        for n_points, length in chunks:
            listed.append(Chunk(start, length, n_points))
            start += length
        n_held = check_layers(stream, header, compression, listed)
    else:
        n_held = sum(n_points for n_points, _ in chunks)
    if n_held < header.n_points:
        raise ReadError(f"is truncated or damaged: {expected}, file holds {n_held}; copy it again")
    if compression.chunk_size == _VARIABLE_CHUNKS and n_held != header.n_points:
        raise ReadError(f"contradicts itself: {expected}, its chunks hold {n_held}; export it again")


def check_layers(stream: IO[bytes], header: LasHeader, compression: Compression, chunks: list[Chunk]) -> int:
    """Check that the layers of every chunk fill it exactly.

    Parameters
    ----------
    stream : binary file
        The LAZ file.
    header, compression
        What it says of itself; the compressor is the layered one.
    chunks : list of Chunk
        Inside the file; each holds at most the number of points that is listed.

    Returns
    -------
    int
        How many points the chunks themselves say they hold.

    Raises
    ------
    ReadError
        If one does not add up.
    """
    layout = struct.Struct(f"<{1 + compression.n_layers}I")
    n_fixed = header.point_bytes + layout.size
    n_held = 0
    for number, chunk in enumerate(chunks, 1):
        stream.seek(chunk.start + header.point_bytes)
        n_points, *layers = layout.unpack(stream.read(layout.size).ljust(layout.size, b"\0"))
        if sum(layers) + n_fixed != chunk.n_bytes or n_points > chunk.n_points:
            raise ReadError(f"is damaged in compressed chunk {number} of {len(chunks)}; copy it again")
        n_held += n_points
    return n_held
