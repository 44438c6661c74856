"""Clouds larger than memory: LAS, LAZ and COPC files thinned, measured and fused part by part.

The route is that of `tmchho.register`: a file is thinned to as many centroids as memory allows, the pose is
found for those, and all points are measured and fused again at full density, tile by tile.
"""

from tmchho.streams.memory import default_max_memory, needs_streams, parse_bytes
from tmchho.streams.route import StreamedFusion, StreamedRegistration, fuse_files, register_files

__all__ = [
    "StreamedFusion",
    "StreamedRegistration",
    "default_max_memory",
    "fuse_files",
    "needs_streams",
    "parse_bytes",
    "register_files",
]
