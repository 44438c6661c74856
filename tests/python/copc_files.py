"""A small COPC file made by code: an octree of LAZ chunks behind a LAS 1.4 header.

Source: the COPC specification 1.0. laspy's reader is the judge of what comes out.
"""

from __future__ import annotations

import io
import struct
from pathlib import Path

import laspy
import lazrs
import numpy as np
from numpy.typing import NDArray

HALF, SPACING = 8.0, 1.0
CENTRE = np.array([500_000.0, 4_000_000.0, 100.0])
N_POINTS = (40, 200, 900)  # of the levels


def write_copc(path: Path, *, n_points: tuple[int, ...] = N_POINTS, further_page: bool = False) -> None:
    """Write random points; those of each level are spread over its nodes."""
    rng = np.random.default_rng(0)
    nodes: dict[tuple[int, int, int, int], NDArray[np.float64]] = {}
    for level, n_level in enumerate(n_points):
        places = rng.uniform(0, 1, (n_level, 3)) ** 2  # denser in one corner
        cells = np.floor(places * 2**level).astype(int)
        for cell in np.unique(cells, axis=0):
            inside = (cells == cell).all(axis=1)
            nodes[(level, *cell.tolist())] = CENTRE - HALF + 2 * HALF * places[inside]  # type: ignore[index]

    header = laspy.LasHeader(version="1.4", point_format=6)
    header.scales, header.offsets = [0.001] * 3, CENTRE
    record = lazrs.LazVlr.new_for_compression(6, 0, True)
    info = laspy.VLR("copc", 1, "", b"\0" * 160)
    header.vlrs = [info, laspy.VLR("laszip encoded", 22204, "", record.record_data())]
    header.are_points_compressed = True
    everything = np.concatenate(list(nodes.values()))
    header.maxs, header.mins = everything.max(axis=0), everything.min(axis=0)
    header.point_count = len(everything)
    header.number_of_points_by_return = np.array([len(everything), *[0] * 14])

    stream = io.BytesIO()
    header.write_to(stream)
    points_at = stream.tell()
    entries = []
    compressor = lazrs.LasZipCompressor(stream, record)
    start = points_at + 8
    for number, (key, xyz) in enumerate(nodes.items(), 1):
        points = laspy.ScaleAwarePointRecord.zeros(len(xyz), header=header)
        points.x, points.y, points.z = xyz.T
        points.intensity = np.arange(len(xyz))
        points.return_number = points.number_of_returns = np.ones(len(xyz), np.uint8)
        compressor.compress_many(np.frombuffer(points.array.tobytes(), np.uint8))
        if number < len(nodes):
            compressor.finish_current_chunk()
            end = stream.tell()
        else:  # the table of chunks follows the last one
            compressor.done()
            (end,) = struct.unpack_from("<q", stream.getvalue(), points_at)
        entries.append((key, start, end - start, len(xyz)))
        start = end
    stream.seek(0, io.SEEK_END)
    pages = [entries]
    if further_page:
        # One octant, with all that lies in it.
        deep = [entry for entry in entries if entry[0][0] and max(entry[0][1:]) < 2 ** (entry[0][0] - 1)]
        pages = [[entry for entry in entries if entry not in deep], deep]
    page_at = stream.tell() + 60
    root = pages[0]
    if further_page:
        at = page_at + 32 * (len(root) + 1)
        root = [*root, ((1, 0, 0, 0), at, 32 * len(pages[1]), -1)]
    data = b"".join(
        struct.pack("<4iQ2i", *key, at, n_bytes, count)
        for page in [root, *pages[1:]]
        for key, at, n_bytes, count in page
    )
    stream.write(struct.pack("<2x16sHQ32s", b"copc", 1000, len(data), b"") + data)
    whole = bytearray(stream.getvalue())
    struct.pack_into("<QI", whole, 235, page_at - 60, 1)
    struct.pack_into("<5d2Q", whole, 375 + 54, *CENTRE, HALF, SPACING, page_at, 32 * len(root))
    path.write_bytes(whole)
