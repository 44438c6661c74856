"""A network as a surveyor writes it down: one TOML file with stations, what is known of them, and settings.

Paths are relative to the folder of the project file and stay within it, so that the folder can be moved,
packed, or handed on as a whole. What lies elsewhere is named by an absolute path, which is then meant. A
link in the folder that leads elsewhere is taken for the wish of whoever made it.
"""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tmchho.errors import InvalidArgumentError, ReadError
from tmchho.io.atomic import reason
from tmchho.network.stations import Station, StationControl
from tmchho.transform import read_matrix

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

_TOP = ("name", "files", "station", "block", "control_point", "control_points", "network", "registration")
_PLACED = (
    "name",
    "file",
    "position",
    "place",
    "position_sigma_m",
    "pose",
    "pose_sigma_deg",
    "pose_sigma_m",
    "fixed",
)
_TABLES: dict[str, tuple[str, ...]] = {
    "station": _PLACED,
    "block": (*_PLACED, "free_scale"),
    "control_point": ("station", "place", "position", "sigma_m"),
}
_NETWORK = ("levelled", "voxel_size_m", "min_overlap")
_POINT_COLUMNS = ("station", "place_x", "place_y", "place_z", "x", "y", "z", "sigma_m")


@dataclass(frozen=True, eq=False)
class Project:
    """What a project file says.

    Parameters
    ----------
    name : str
        How reports call the network.
    stations : tuple of Station
        Those with a table of their own first, then those of ``files``, in the order of the file.
    control_points : tuple of StationControl
        Places known in the world.
    network : mapping
        Those of ``levelled``, ``voxel_size_m`` and ``min_overlap`` that the file gives; see
        `tmchho.network.route.register_network`.
    registration : mapping
        Settings of the registration of a pair, as they stand in the file; see `tmchho.Config`.
    """

    name: str
    stations: tuple[Station, ...]
    control_points: tuple[StationControl, ...] = ()
    network: Mapping[str, Any] = field(default_factory=dict)
    registration: Mapping[str, Any] = field(default_factory=dict)


def read_project(path: str | os.PathLike[str]) -> Project:
    """Read a project file.

    Parameters
    ----------
    path : str or path
        TOML; see ``docs/network.md`` for its keys.

    Returns
    -------
    Project

    Raises
    ------
    ReadError
        If the file, or one that it names for control points or a pose, cannot be read.
    InvalidArgumentError
        Naming the file and the key that is not known, missing, or of the wrong kind.
    """
    path = Path(path)
    try:
        document = tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise ReadError(f"{path}: cannot be read ({reason(error)}); check the name and the rights") from error
    except ValueError as error:  # not TOML, or not text
        raise InvalidArgumentError(f"{path}: is not valid TOML: {error}") from error
    try:
        return _project(document, path)
    except InvalidArgumentError as error:
        raise InvalidArgumentError(f"{path}: {error}") from error


def project_of_files(paths: Sequence[str | os.PathLike[str]], name: str = "network") -> Project:
    """Return the project of clouds of which nothing else is known, each called by the name of its file.

    Raises
    ------
    InvalidArgumentError
        If two files would get the same name.
    """
    stations = tuple(Station(name=Path(path).stem, cloud=Path(path)) for path in paths)
    _check_names(stations)
    return Project(name=name, stations=stations)


def _project(document: Mapping[str, Any], path: Path) -> Project:
    _check_keys(document, _TOP, "")
    folder = path.absolute().parent
    stations = [
        _station(table, kind, f"[[{kind}]] number {number}", folder)
        for kind in ("station", "block")
        for number, table in enumerate(_tables(document, kind), start=1)
    ]
    taken = {Path(str(station.cloud)) for station in stations}
    stations += [
        Station(name=file.stem, cloud=file)
        for file in _found_files(document.get("files", []), folder)
        if file not in taken
    ]
    if len(stations) < 2:
        raise InvalidArgumentError(
            f"names {len(stations)} clouds, and a network has two or more: give each a [[station]], or name "
            'them all by files = ["scans/*.laz"]'
        )
    _check_names(stations)
    points = [
        _control_point(table, f"[[control_point]] number {number}")
        for number, table in enumerate(_tables(document, "control_point"), start=1)
    ]
    if "control_points" in document:
        points += read_station_control(_inside(document["control_points"], "control_points", folder))
    known = {station.name for station in stations}
    for point in points:
        if point.station not in known:
            raise InvalidArgumentError(
                f"a control point lies in station '{point.station}', which is not there"
            )
    network = _table(document, "network")
    _check_keys(network, _NETWORK, " in [network]")
    return Project(
        name=_text(document.get("name", path.stem), "name"),
        stations=tuple(stations),
        control_points=tuple(points),
        network=network,
        registration=_table(document, "registration"),
    )


def _station(table: Mapping[str, Any], kind: str, where: str, folder: Path) -> Station:
    _check_keys(table, _TABLES[kind], f" in {where}")
    if "file" not in table:
        raise InvalidArgumentError(f"{where}: needs the key file")
    file = _inside(table["file"], f"{where}: file", folder)
    pose = table.get("pose")
    if isinstance(pose, str):
        pose = read_matrix(_inside(pose, f"{where}: pose", folder))
    turn_deg = table.get("pose_sigma_deg")
    given = {
        key: table[key]
        for key in ("position", "place", "position_sigma_m", "pose_sigma_m", "fixed", "free_scale")
        if key in table
    }
    for key in ("fixed", "free_scale"):
        if not isinstance(given.get(key, False), bool):
            raise InvalidArgumentError(f"{where}: {key} must be true or false, got {given[key]!r}")
    return Station(
        name=_text(table.get("name", file.stem), f"{where}: name"),
        cloud=file,
        kind="block" if kind == "block" else "scan",
        pose=pose,
        pose_sigma_rad=None
        if turn_deg is None
        else math.radians(_number(turn_deg, f"{where}: pose_sigma_deg")),
        **given,
    )


def _control_point(table: Mapping[str, Any], where: str) -> StationControl:
    keys = _TABLES["control_point"]
    _check_keys(table, keys, f" in {where}")
    missing = [key for key in keys if key not in table]
    if missing:
        raise InvalidArgumentError(f"{where}: needs the key {missing[0]}")
    return StationControl(**{**table, "station": _text(table["station"], f"{where}: station")})


def read_station_control(path: Path) -> list[StationControl]:
    """Read control points from a table with a line of names: station, place_x … z, x, y, z, sigma_m.

    Parameters
    ----------
    path : Path
        Cells separated by commas, semicolons or tabs. ``place`` is in the station's frame, x, y, z in the
        world. Other columns, such as the number of a target, do not count; nor do lines that begin with #.

    Raises
    ------
    ReadError
        Naming the file and the line.
    """
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise ReadError(f"{path}: cannot be read ({reason(error)}); give a table of text") from error
    rows = [(n, line) for n, line in enumerate(lines, start=1) if line.strip() and not line.startswith("#")]
    if not rows:
        raise ReadError(f"{path}: is empty; its first line names the columns {', '.join(_POINT_COLUMNS)}")
    mark = next((mark for mark in ";\t" if mark in rows[0][1]), ",")
    header = [cell.strip(" \"'").lower() for cell in rows[0][1].split(mark)]
    missing = [name for name in _POINT_COLUMNS if header.count(name) != 1]
    if missing:
        raise ReadError(f"{path}, line {rows[0][0]}: has no one column called {', '.join(missing)}")
    points = []
    for number, line in rows[1:]:
        cells = [cell.strip(" \"'") for cell in line.split(mark)]
        if len(cells) != len(header):
            raise ReadError(f"{path}, line {number}: has {len(cells)} cells where {len(header)} are expected")
        values = dict(zip(header, cells, strict=True))
        try:
            numbers = [float(values[name]) for name in _POINT_COLUMNS[1:]]
            points.append(StationControl(values["station"], numbers[:3], numbers[3:6], numbers[6]))
        except ValueError as error:
            raise ReadError(f"{path}, line {number}: {error}") from error
    return points


def _found_files(patterns: Any, folder: Path) -> list[Path]:
    """Return the files that match, each once, those of one pattern in the order of their names."""
    if not isinstance(patterns, list):
        raise InvalidArgumentError('files must be a list such as ["scans/*.laz"]')
    found: dict[Path, None] = {}
    for pattern in patterns:
        whole = _inside(pattern, "files", folder)
        # Only what was written is a pattern; the folder of the project may have any name.
        base = folder if whole.is_relative_to(folder) else Path(whole.anchor)
        matches = sorted(base.glob(str(whole.relative_to(base))))
        if not matches:
            raise ReadError(f"{whole}: no file has such a name")
        found.update(dict.fromkeys(matches))
    return list(found)


def _inside(path: Any, key: str, folder: Path) -> Path:
    """Return an absolute path; a relative one must not lead out of the folder of the project."""
    text = _text(path, key)
    if os.path.isabs(text):
        return Path(os.path.normpath(text))
    whole = Path(os.path.normpath(folder / text))
    if not whole.is_relative_to(folder):
        raise InvalidArgumentError(
            f"{key}: '{text}' leads out of the project's folder; move the file in, or give an absolute path"
        )
    return whole


def _check_keys(table: Mapping[str, Any], known: Sequence[str], where: str) -> None:
    for key in table:
        if key not in known:
            raise InvalidArgumentError(f"unknown key '{key}'{where}; known are {', '.join(known)}")


def _check_names(stations: Sequence[Station]) -> None:
    # As names of files they must differ even where a file system takes no notice of capitals.
    seen: dict[str, Station] = {}
    for station in stations:
        other = seen.setdefault(station.name.lower(), station)
        if other is not station:
            raise InvalidArgumentError(
                f"{station.cloud!s} and {other.cloud!s} are both called '{station.name}'; give each a name "
                "of its own"
            )


def _tables(document: Mapping[str, Any], key: str) -> list[Mapping[str, Any]]:
    tables = document.get(key, [])
    if not isinstance(tables, list) or not all(isinstance(table, dict) for table in tables):
        raise InvalidArgumentError(f"{key} must be tables, each headed [[{key}]]")
    return tables


def _table(document: Mapping[str, Any], key: str) -> Mapping[str, Any]:
    table = document.get(key, {})
    if not isinstance(table, dict):
        raise InvalidArgumentError(f"{key} must be a table headed [{key}]")
    return table


def _text(value: Any, key: str) -> str:
    if not isinstance(value, str) or not value:
        raise InvalidArgumentError(f"{key} must be text, got {value!r}")
    return value


def _number(value: Any, key: str) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        raise InvalidArgumentError(f"{key} must be a number, got {value!r}")
    return float(value)
