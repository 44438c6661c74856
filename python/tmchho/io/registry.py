"""The table from file name to format, and the two doors `read` and `write`.

Why: what holds for every format is said once, here: the file exists, is not empty, is what its name says;
every error names the file; nothing half-written stays behind.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from tmchho.cloud import PointCloud
from tmchho.errors import (
    BudgetError,
    InvalidArgumentError,
    InvalidCloudError,
    ReadError,
    TmchhoError,
    WriteError,
)
from tmchho.io import las, las_stream, mesh, npy, pcd, ply, text
from tmchho.io.atomic import atomic_path, reason
from tmchho.io.format import Format

logger = logging.getLogger(__name__)

FORMATS: tuple[Format, ...] = (
    las.FORMAT,
    ply.FORMAT,
    pcd.FORMAT,
    text.FORMAT,
    npy.FORMAT,
    npy.ARCHIVE_FORMAT,
    mesh.FORMAT,
)
_BY_EXTENSION = {extension: family for family in FORMATS for extension in family.extensions}

# Enough for every family's first bytes and for a NUL to turn up in a binary file.
_HEAD_BYTES = 1024
_UTF16_MARKS = (b"\xff\xfe", b"\xfe\xff")


def known_extensions(*, writable: bool = False) -> tuple[str, ...]:
    """Return the extensions that `read` knows, or those that `write` knows.

    Parameters
    ----------
    writable : bool, default False
        Only the formats that can be written.

    Returns
    -------
    tuple of str
        Lower case, with the dot, sorted.
    """
    return tuple(sorted(key for key, family in _BY_EXTENSION.items() if family.write or not writable))


def read(path: str | os.PathLike[str], *, format: str | None = None) -> PointCloud:
    """Read a point cloud with all its attributes.

    Parameters
    ----------
    path : str or path
        The file; its extension chooses the format, in upper or lower case.
    format : str, optional
        An extension (``"laz"``, ``".xyz"``) to use instead of the file's own.

    Returns
    -------
    PointCloud
        Coordinates in float64 exactly as the file has them, at least one point; NaN stays NaN. Colours
        keep the depth of the file: uint8 is 0..255, uint16 is 0..65535.

    Raises
    ------
    ReadError
        If the file is missing, empty, of an unknown kind, not what its name says, truncated, damaged or
        without points. The message is one sentence that names the file.
    InvalidArgumentError
        If `format` is not known.
    BudgetError
        If the points do not fit into memory.
    """
    path = Path(path)
    _check_exists(path)
    family = _format_to_read(path, format)
    with _reading(path, family):
        head = _head_of(path)
        _check_kind(head, family)
        cloud = family.read(path)
        if len(cloud) == 0:
            raise ReadError("contains no points; choose a file with points")
    logger.info("%s: read %d points, attributes %s", path, len(cloud), sorted(cloud.attributes))
    return cloud


def write(
    cloud: PointCloud,
    path: str | os.PathLike[str],
    *,
    overwrite: bool = False,
    like: PointCloud | None = None,
    inputs: Iterable[str | os.PathLike[str]] = (),
) -> None:
    """Write a point cloud with all its attributes, whole or not at all.

    Parameters
    ----------
    cloud : PointCloud
        At least one point.
    path : str or path
        The file to make; its extension chooses the format.
    overwrite : bool, default False
        Replace an existing file.
    like : PointCloud, optional
        Keep the layout of this cloud's file (LAS version, point format, scale, VLRs, …) where it is of the
        same format; by default that of the file which `cloud` itself was read from.
    inputs : iterable of str or path
        Files that must never be replaced, even with `overwrite`.

    Raises
    ------
    InvalidArgumentError
        If the extension is not known or the format can only be read.
    InvalidCloudError
        If the cloud has no points.
    WriteError
        If the file exists, is an input, cannot be written, or the format cannot hold the values. Neither
        a new file nor a temporary one is left behind.
    """
    path = Path(path)
    family = _format_to_write(path)
    if family.write is None:
        raise InvalidArgumentError(
            f"{path}: {family.name} can only be read; choose one of {_listed_writable()}"
        )
    if len(cloud) == 0:
        raise InvalidCloudError(f"{cloud.name}: has no points to write to {path}")
    if cloud.crs is not None and family is not las.FORMAT:
        logger.info("%s: %s has no room for the coordinate reference system", path, family.name)
    with atomic_path(path, overwrite, inputs) as temporary, _writing(path, family):
        family.write(cloud, temporary, (cloud if like is None else like).metadata)
    logger.info("%s: wrote %d points", path, len(cloud))


def is_las(path: str | os.PathLike[str]) -> bool:
    """Return whether `read` would read this file as LAS or LAZ."""
    return _BY_EXTENSION.get(Path(path).suffix.lower()) is las.FORMAT


def open_las(path: str | os.PathLike[str]) -> las_stream.LasPoints:
    """Open a LAS or LAZ file for reading in parts.

    Raises
    ------
    ReadError
        If it is missing, empty, damaged or without points, in one sentence that names the file.
    """
    path = Path(path)
    _check_exists(path)
    with _reading(path, las.FORMAT):
        _check_kind(_head_of(path), las.FORMAT)
        return las_stream.LasPoints.open(path)


def las_parts(
    points: las_stream.LasPoints, points_at_once: int = las_stream.POINTS_AT_ONCE
) -> Iterator[las_stream.Records]:
    """Give the records of an open file in parts; errors name the file, as those of `read` do."""
    with _reading(points.path, las.FORMAT):
        yield from points.parts(points_at_once)


@contextmanager
def writing_las(path: str | os.PathLike[str]) -> Iterator[None]:
    """Turn what goes wrong while a LAS file is written into one sentence that names it."""
    with _writing(Path(path), las.FORMAT):
        yield


def _check_exists(path: Path) -> None:
    if not os.path.exists(path):
        raise ReadError(f"{path}: does not exist; check the name and the folder")
    if path.is_dir():
        raise ReadError(f"{path}: is a folder; name a file in it")


def _format_to_read(path: Path, format: str | None) -> Format:
    if format is not None:
        extension = "." + format.lower().lstrip(".")
        if extension not in _BY_EXTENSION:
            raise InvalidArgumentError(f"format '{format}' is not one of {_listed(known_extensions())}")
        return _BY_EXTENSION[extension]
    family = _BY_EXTENSION.get(path.suffix.lower())
    if family is None:
        raise ReadError(
            f"{path}: unknown extension '{path.suffix}'; the known ones are {_listed(known_extensions())}"
        )
    return family


def _format_to_write(path: Path) -> Format:
    family = _BY_EXTENSION.get(path.suffix.lower())
    if family is None:
        raise InvalidArgumentError(
            f"{path}: unknown extension '{path.suffix}'; choose one of {_listed_writable()}"
        )
    if path.name.lower().endswith(".copc.laz"):
        raise InvalidArgumentError(f"{path}: COPC files can only be read; choose a name with plain .laz")
    return family


def _head_of(path: Path) -> bytes:
    with path.open("rb") as stream:
        head = stream.read(_HEAD_BYTES)
    if not head:
        raise ReadError("is empty (0 bytes); copy or export it again")
    return head


def _check_kind(head: bytes, family: Format) -> None:
    """Raise if the first bytes belong to another format than the one chosen by name."""
    if family.first_bytes and head.startswith(family.first_bytes):
        return
    for other in FORMATS:
        if other is not family and other.first_bytes and head.startswith(other.first_bytes):
            raise ReadError(
                f"is a {other.name} file although it was to be read as {family.name}; "
                f"rename it to {_listed(other.extensions)} or give that format"
            )
    if family.mark_is_needed:
        raise ReadError(f"is not a {family.name} file: the mark at its start is missing")
    if not family.first_bytes and b"\0" in head and not head.startswith(_UTF16_MARKS):
        raise ReadError(f"is not a {family.name} file: it holds binary data")


@contextmanager
def _reading(path: Path, family: Format) -> Iterator[None]:
    """Turn whatever a reader or its library raises into one sentence that names the file."""
    try:
        yield
    except ReadError as error:
        raise ReadError(f"{path}: {error}") from error.__cause__
    except TmchhoError:
        raise
    except MemoryError as error:
        raise BudgetError(f"{path}: does not fit into memory; thin it out or cut it into tiles") from error
    except OSError as error:
        raise ReadError(f"{path}: cannot be read ({reason(error)}); check the rights and the disk") from error
    except (KeyboardInterrupt, SystemExit, GeneratorExit):
        raise
    except BaseException as error:  # a panic in a Rust decoder does not derive from Exception
        raise ReadError(
            f"{path}: is damaged or not a valid {family.name} file ({reason(error)}); export it again"
        ) from error


@contextmanager
def _writing(path: Path, family: Format) -> Iterator[None]:
    """Turn whatever a writer or its library raises into one sentence that names the file."""
    try:
        yield
    except WriteError as error:
        raise WriteError(f"{path}: {error}") from error.__cause__
    except (TmchhoError, OSError):
        raise
    except MemoryError as error:
        raise BudgetError(f"{path}: writing needs more memory than there is; write fewer points") from error
    except (KeyboardInterrupt, SystemExit, GeneratorExit):
        raise
    except BaseException as error:  # a panic in a Rust encoder does not derive from Exception
        raise WriteError(
            f"{path}: the cloud cannot be written as {family.name} ({reason(error)}); try another format"
        ) from error


def _listed(extensions: Iterable[str]) -> str:
    return ", ".join(extensions)


def _listed_writable() -> str:
    return _listed(known_extensions(writable=True))
