"""OBJ: the vertices of a mesh, in the order of the file.

Why not a mesh library: those are made to keep surfaces, and repeat the vertices for every material; a
registration needs each ``v`` line once. Faces, normals and texture coordinates are left out.
"""

from __future__ import annotations

import logging
import re
from pathlib import Path

import numpy as np

from tmchho.cloud import PointCloud
from tmchho.errors import ReadError
from tmchho.io.fields import AXES, COLOURS, cloud_from_columns
from tmchho.io.format import Format
from tmchho.io.table import parse_table

logger = logging.getLogger(__name__)

_OTHER_LINE = re.compile(rb"^(?![ \t]*v[ \t]).*$", re.MULTILINE)
_VERTEX_MARK = re.compile(rb"^[ \t]*v[ \t]", re.MULTILINE)

_FIRST_KEYWORD = re.compile(rb"(?:#[^\n]*\n|\s)*(?:v|vn|vt|vp|o|g|s|mtllib|usemtl)[ \t]")
_TELLING_LINE = re.compile(rb"^[ \t]*(?:v|vn|vt|f|mtllib|usemtl)[ \t]", re.MULTILINE)

# What may follow x y z, by the number of values: a weight, a colour, or both.
_EXTRA_COLUMNS = {3: (), 4: ("weight",), 6: COLOURS, 7: (*COLOURS, "alpha")}


def _is_mesh(head: bytes) -> bool:
    lines = head.replace(b"\r", b"\n")
    return _FIRST_KEYWORD.match(lines) is not None and _TELLING_LINE.search(lines) is not None


def _read(path: Path) -> PointCloud:
    data = path.read_bytes().replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    # Other lines stay, empty, so that line numbers stay right.
    vertices = _VERTEX_MARK.sub(b"", _OTHER_LINE.sub(b"", data))
    first = vertices.lstrip().partition(b"\n")[0].split()
    if not first:
        raise ReadError("contains no points: it has no 'v' lines; choose a file with vertices")
    if len(first) not in _EXTRA_COLUMNS:
        raise ReadError(f"has vertices of {len(first)} values; 3, 4, 6 or 7 are known")
    names = (*AXES, *_EXTRA_COLUMNS[len(first)])
    table = parse_table(vertices, len(names))
    columns = {name: table[:, index] for index, name in enumerate(names)}
    if "weight" in columns and np.all(columns["weight"] == 1):
        del columns["weight"]
    logger.info("%s: vertices only, faces and materials are left out", path)
    return cloud_from_columns(columns, {"format": "obj"}, str(path))


FORMAT = Format(
    name="OBJ",
    extensions=(".obj",),
    recognises=_is_mesh,
    read=_read,
    write=None,
)
