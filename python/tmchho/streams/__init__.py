"""Clouds larger than memory: LAS, LAZ and COPC files thinned, measured and fused part by part.

The route is that of `tmchho.register`: a file is thinned to as many centroids as memory allows, the pose is
found for those, and all points are measured and fused again at full density, tile by tile.
"""

from tmchho.streams.change import StreamedChange, m3c2_files
from tmchho.streams.evaluate import StreamedEvaluation, evaluate_files
from tmchho.streams.evaluation_files import write_streamed_evaluation
from tmchho.streams.memory import default_max_memory, needs_streams, parse_bytes
from tmchho.streams.route import StreamedFusion, StreamedRegistration, fuse_files, register_files

__all__ = [
    "StreamedChange",
    "StreamedEvaluation",
    "StreamedFusion",
    "StreamedRegistration",
    "default_max_memory",
    "evaluate_files",
    "fuse_files",
    "m3c2_files",
    "needs_streams",
    "parse_bytes",
    "register_files",
    "write_streamed_evaluation",
]
