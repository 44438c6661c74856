"""What kind of file this is, told by its content; the name only decides where the content leaves it open.

Why: survey data come by mail and by stick, renamed on the way. A PLY that is called .las is a PLY, and a
picture that is called .xyz is not a damaged table of points.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Sequence
from pathlib import Path

from tmchho.errors import ReadError
from tmchho.io.format import Format

logger = logging.getLogger(__name__)

HEAD_BYTES = 4096
_UTF16_MARKS = (b"\xff\xfe", b"\xfe\xff")

# Kinds that hold no points, or none that are read here, and what to do with them.
_FOREIGN = (
    (rb"\s*<\?xml|\s*<!DOCTYPE|\s*<html", "XML or HTML", "save the points as LAS, PLY or text"),
    (rb"\s*[{\[]\s*(?:[\"{}\[\]]|$)", "JSON", "save the points as LAS, PLY or text"),
    (rb"C?O?F?OFF\b", "an OFF mesh", "save it as PLY or OBJ"),
    (rb"solid\b[^\0]*?\n\s*facet\b", "an STL mesh", "save it as PLY or OBJ"),
    (rb"# vtk DataFile", "VTK", "save the points as PLY or text"),
    (rb"glTF", "a glTF scene", "save the points as PLY"),
    (rb"\x89HDF\r\n", "HDF5", "save the points as LAS, PLY or text"),
    (rb"\x1f\x8b|BZh|\xfd7zXZ\0|7z\xbc\xaf|Rar!|\x28\xb5\x2f\xfd", "a packed file", "unpack it first"),
    (rb"PK\x03\x04", "a ZIP archive of other files", "unpack it first"),
    (rb"%PDF", "a PDF document", "choose a file with points"),
    (rb"\x89PNG|\xff\xd8\xff|GIF8|BM.{4}\0{4}", "a picture", "choose a file with points"),
    (rb"II\*\0|MM\0\*|II\+\0|MM\0\+", "a TIFF raster", "export its cells as points"),
    (rb"SQLite format 3", "an SQLite database", "export its points"),
    (rb"(?i:ncols)\s+\d+\s+(?i:nrows)", "an ESRI grid of heights", "export its cells as x y z"),
)


def family_of(head: bytes, path: Path, families: Sequence[Format], text: Format) -> Format:
    """Return the family that the first bytes of a file belong to.

    Parameters
    ----------
    head : bytes
        The first `HEAD_BYTES` of the file, at least one.
    path : Path
        Its name, which decides between families that look alike.
    families : sequence of Format
        All that are known; the first that recognises the bytes is taken.
    text : Format
        The family of plain tables, which no mark gives away.

    Raises
    ------
    ReadError
        If it is none of them; the message says what it is instead, where that is known.
    """
    by_name = next((family for family in families if path.suffix.lower() in family.extensions), None)
    family = next((family for family in families if family.recognises(head)), None)
    is_table = is_plain_text(head) and (by_name is text or _has_numbers(head))
    if family is None and is_table and _foreign(head) is None:
        family = text
    if family is None:
        raise _unknown(head, path, by_name)
    if by_name is not None and family is not by_name:
        logger.warning(
            "%s: holds %s although its name ends in %s; read as what it is",
            *(path, family.name, path.suffix),
        )
    return family


def check_family(head: bytes, chosen: Format, families: Sequence[Format], text: Format) -> None:
    """Raise if the first bytes belong to another family than the one the caller chose."""
    if chosen.recognises(head) or (chosen is text and is_plain_text(head)):
        return
    other = next((family for family in families if family.recognises(head)), None)
    if other is not None and chosen is not text:
        raise ReadError(
            f"is a {other.name} file although it was to be read as {chosen.name}; leave the format out"
        )
    if other is not None and not is_plain_text(head):
        raise ReadError(f"is a {other.name} file, not {chosen.name}; leave the format out")
    raise _missing_mark(head, chosen)


def is_plain_text(head: bytes) -> bool:
    """Return whether the first bytes could be those of a text, in ASCII, UTF-8, UTF-16 or Latin-1."""
    return head.startswith(_UTF16_MARKS) or b"\0" not in head


def _has_numbers(head: bytes) -> bool:
    """Return whether one of the first two lines, comments aside, begins like a point: three numbers."""
    number = rb"[\s\"]*[-+]?(?:\d+[.,]?\d*|[.,]\d+)(?:[eE][-+]?\d+)?[\"]?"
    three = re.compile(number + rb"(?:\s*[;,\t ]" + number + rb"){2}")
    lines = re.split(rb"[\r\n]+", head.replace(b"\0", b"").lstrip())  # in UTF-16 every other byte is zero
    told = [line for line in lines if not re.match(rb"\s*(?://|[#%!;]|\d+\s*$|$)", line)]
    return any(three.match(line) for line in told[:2])


def _foreign(head: bytes) -> tuple[str, str] | None:
    return next(((what, advice) for mark, what, advice in _FOREIGN if re.match(mark, head)), None)


def _unknown(head: bytes, path: Path, by_name: Format | None) -> ReadError:
    foreign = _foreign(head)
    if foreign is not None:
        return ReadError("is {}, which is not read; {}".format(*foreign))
    if by_name is not None:
        return _missing_mark(head, by_name)
    return ReadError(
        f"is of an unknown kind: neither its content nor the extension '{path.suffix}' tells which; "
        "export it as LAS, E57, PLY or text"
    )


def _missing_mark(head: bytes, family: Format) -> ReadError:
    if family.name == "text":
        return ReadError("is not a text file: it holds binary data; export it again")
    return ReadError(f"is not a {family.name} file: the mark at its start is missing; export it again")
