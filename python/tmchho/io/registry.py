"""The table of formats, and the two doors `read` and `write`.

Why: what holds for every format is said once, here: the file exists and is not empty, its content decides
what it is; every error names the file; nothing half-written stays behind.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tmchho.cloud import PointCloud
from tmchho.errors import (
    BudgetError,
    InvalidArgumentError,
    InvalidCloudError,
    ReadError,
    TmchhoError,
    WriteError,
)
from tmchho.io import e57, las, las_stream, mesh, npy, pcd, ply, ptx, text
from tmchho.io.atomic import atomic_path, reason
from tmchho.io.format import Format
from tmchho.io.kinds import HEAD_BYTES, check_family, family_of
from tmchho.io.las_header import SIGNATURE
from tmchho.io.window import Window, window_of

logger = logging.getLogger(__name__)

FORMATS: tuple[Format, ...] = (
    las.FORMAT,
    e57.FORMAT,
    ply.FORMAT,
    pcd.FORMAT,
    npy.FORMAT,
    npy.ARCHIVE_FORMAT,
    ptx.FORMAT,
    mesh.FORMAT,
    text.FORMAT,
)
_BY_EXTENSION = {extension: family for family in FORMATS for extension in family.extensions}


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


def read(
    path: str | os.PathLike[str],
    *,
    format: str | None = None,
    box: Any = None,
    resolution: float | None = None,
) -> PointCloud:
    """Read a point cloud with all its attributes.

    Parameters
    ----------
    path : str or path
        The file. Its content decides what it is; a name that says otherwise is warned of.
    format : str, optional
        An extension (``"laz"``, ``".xyz"``) whose format is to be used; a file of another one is refused.
    box : (2, 2) or (2, 3) array_like, optional
        Lowest and highest corner, in the file's coordinates, of the part that is wanted; with two numbers
        each it is open upwards and downwards. Of a COPC file only that part is read.
    resolution : float, optional
        Distance between points, in the file's unit, that is close enough. Only COPC files can be read more
        thinly; where they are, the next finer level is taken.

    Returns
    -------
    PointCloud
        Coordinates in float64 exactly as the file has them, at least one point; NaN stays NaN. Colours
        keep the depth of the file: uint8 is 0..255, uint16 is 0..65535. Scans of an E57 or PTX file are
        moved by their poses and joined; ``scan_index`` tells them apart where there are several.

    Raises
    ------
    ReadError
        If the file is missing, empty, of an unknown kind, truncated, damaged or without points, also in
        the box, or if `resolution` is asked of a file without levels. The message is one sentence that names
        the file.
    InvalidArgumentError
        If `format` is not known, or `box` and `resolution` are none.
    BudgetError
        If the points do not fit into memory.
    """
    path = Path(path)
    window = window_of(box, resolution)
    chosen = None if format is None else _chosen_family(format)
    _check_exists(path)
    with _reading(path, chosen):
        head = _head_of(path)
        if chosen is not None:
            check_family(head, chosen, FORMATS, text.FORMAT)
        family = chosen or family_of(head, path, FORMATS, text.FORMAT)
    with _reading(path, family):
        cloud = _read_part(family, path, window) if window else family.read(path)
        if len(cloud) == 0:
            where = " in that box" if window else ""
            raise ReadError(
                f"contains no points{where}; choose {'another' if window else 'a file with points'}"
            )
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
    if cloud.crs is not None and family not in (las.FORMAT, e57.FORMAT):
        logger.info("%s: %s has no room for the coordinate reference system", path, family.name)
    with atomic_path(path, overwrite, inputs) as temporary, _writing(path, family):
        family.write(cloud, temporary, (cloud if like is None else like).metadata)
    logger.info("%s: wrote %d points", path, len(cloud))


def is_las(path: str | os.PathLike[str]) -> bool:
    """Return whether `read` would read this file as LAS or LAZ."""
    try:
        if not os.path.isfile(path):
            return False
        with open(path, "rb") as stream:
            return stream.read(len(SIGNATURE)) == SIGNATURE
    except OSError:
        return False  # whoever reads it will say why


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
        check_family(_head_of(path), las.FORMAT, FORMATS, text.FORMAT)
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
    if not path.is_file():  # opening a pipe would wait for whoever writes into it
        raise ReadError(f"{path}: is a pipe or a device; copy its points into a file and name that")


def _chosen_family(format: str) -> Format:
    extension = "." + format.lower().lstrip(".")
    if extension not in _BY_EXTENSION:
        raise InvalidArgumentError(f"format '{format}' is not one of {_listed(known_extensions())}")
    return _BY_EXTENSION[extension]


def _read_part(family: Format, path: Path, window: Window) -> PointCloud:
    if family.read_part is not None:
        return family.read_part(path, window)
    if window.resolution is not None:
        raise ReadError("is no COPC file, so that it cannot be read at a resolution; leave it out")
    return window.cut(family.read(path))


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
        head = stream.read(HEAD_BYTES)
    if not head:
        raise ReadError("is empty (0 bytes); copy or export it again")
    return head


@contextmanager
def _reading(path: Path, family: Format | None) -> Iterator[None]:
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
            f"{path}: is damaged or not a valid {family.name if family else 'point'} file ({reason(error)}); "
            "export it again"
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
