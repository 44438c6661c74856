"""What a network leaves in its folder: all for machines, tables for spreadsheets, a pose for each station.

Nothing in them tells of the day, the machine, or how often the run was interrupted: two runs with the same
input, settings and seed leave the same bytes.
"""

from __future__ import annotations

import csv
import hashlib
import io
import json
import math
import platform
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tmchho.errors import ReadError
from tmchho.io.atomic import reason
from tmchho.network.engine import Item
from tmchho.network.results import NetworkRegistration
from tmchho.outputs import json_text, write_together
from tmchho.transform import Transform, matrix_text, pdal_pipeline, transform_document

NETWORK, LINKS, STATIONS, FUSED = "network.json", "links.csv", "stations.csv", "fused.laz"
OUTPUTS = (NETWORK, LINKS, STATIONS, FUSED)
POSES = "poses"
_POSE_ENDINGS = (".txt", ".json", ".pdal.json")
_CHUNK_BYTES = 1 << 20

_LINK_COLUMNS = (
    "source",
    "target",
    "kept",
    "verdict",
    "overlap_of_source",
    "overlap_of_target",
    "rms_m",
    "strength",
    "ambiguity_ratio",
    "residual_m",
    "residual_deg",
    "normalised_residual",
    "n_loops",
    "n_open_loops",
    "left_out_because",
)
_STATION_COLUMNS = (
    "number",
    "name",
    "kind",
    "file",
    "pose_file",
    *("x", "y", "z"),
    "scale",
    *("sigma_x_m", "sigma_y_m", "sigma_z_m"),
    *("sigma_rotation_x_deg", "sigma_rotation_y_deg", "sigma_rotation_z_deg"),
    "sigma_scale",
    "sigma_point_m",
    "n_links",
    "fixed",
    "note",
)


def checksum_of(item: Item) -> Item:
    """Return the size and the checksum of an input: a unit of work, because it reads the whole file.

    Parameters
    ----------
    item : dict
        ``cloud``, a reference.

    Returns
    -------
    dict
        ``file``, the name without its folder, ``n_bytes`` and ``sha256``.
    """
    path, digest = Path(item["cloud"]["path"]), hashlib.sha256()
    try:
        with path.open("rb") as stream:
            while chunk := stream.read(_CHUNK_BYTES):
                digest.update(chunk)
    except OSError as error:
        raise ReadError(f"{path}: cannot be read ({reason(error)}); check the rights") from error
    return {"file": path.name, "n_bytes": item["cloud"]["n_bytes"], "sha256": digest.hexdigest()}


def network_document(
    found: NetworkRegistration,
    name: str,
    inputs: Sequence[Mapping[str, Any]],
    command: str,
    fused: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Return what ``network.json`` holds.

    Parameters
    ----------
    found : NetworkRegistration
        The result.
    name : str
        How the network is called.
    inputs : sequence of mapping
        Of each station, as `checksum_of` returns it.
    command : str
        Command line that gives the same result again.
    fused : mapping, optional
        What `tmchho.network.tiles.fuse_network` tells.
    """
    document = {"name": name, **found.to_dict()}
    files = pose_names([station.name for station in found.stations])
    for station, row, file in zip(document["stations"], inputs, files, strict=True):
        station |= {"input": dict(row), "pose_file": f"{POSES}/{file}.json"}
    return {
        **document,
        "fused": None if fused is None else dict(fused),
        "versions": {
            "tmchho": found.version,
            "numpy": np.__version__,
            "python": platform.python_version(),
        },
        "command": command,
    }


def write_network(folder: Path, document: Mapping[str, Any], *, overwrite: bool = False) -> tuple[Path, ...]:
    """Write the files of a network; ``network.json`` appears last: where it is, the others are.

    Poses of an earlier network in the folder are removed where this one has none of that name.

    Returns
    -------
    tuple of Path
        Those files, and the folder of the poses.
    """
    earlier = _poses_of_earlier(folder)
    poses: dict[str, Callable[[Path], object]] = {}
    for station in document["stations"]:
        if station["world_from_station"] is not None:
            poses |= _pose_files(station)
    folder.mkdir(parents=True, exist_ok=True)
    write_together(folder / POSES, poses, overwrite=overwrite)
    texts = {
        NETWORK: json_text(document),
        LINKS: links_csv(document["links"]),
        STATIONS: stations_csv(document["stations"]),
    }
    write_together(folder, {name: _writer(text) for name, text in texts.items()}, overwrite=overwrite)
    for name in earlier - set(poses):
        (folder / POSES / name).unlink(missing_ok=True)
    return (*(folder / name for name in texts), folder / POSES)


def pose_names(names: Iterable[str]) -> list[str]:
    """Return names for files: what every file system bears, no two of them alike.

    Examples
    --------
    >>> pose_names(["S01", "pier, left", "pier/left", "s01"])
    ['S01', 'pier_left', 'pier_left-3', 's01-4']
    """
    found: list[str] = []
    taken: set[str] = set()
    for number, name in enumerate(names, start=1):
        plain = re.sub(r"[^\w.-]+", "_", name).strip("._")[:80] or "station"
        plain = plain if plain.lower() not in taken else f"{plain}-{number}"
        taken.add(plain.lower())
        found.append(plain)
    return found


def links_csv(links: Sequence[Mapping[str, Any]]) -> str:
    """Return the table of links, in their order, with commas between; what was not measured is empty."""
    rows = [
        {
            **link,
            "rms_m": link["rms"],
            "residual_deg": _deg(link["residual_rad"]),
        }
        for link in links
    ]
    return _csv(_LINK_COLUMNS, rows)


def stations_csv(stations: Sequence[Mapping[str, Any]]) -> str:
    """Return the table of stations; x, y and z are where the origin of the station lies in the world."""
    rows = []
    for number, station in enumerate(stations, start=1):
        pose = station["world_from_station"]
        origin = [None] * 3 if pose is None else [pose[axis][3] for axis in range(3)]
        sigma = station["sigma_position_m"] or [None] * 3
        turn = station["sigma_rotation_rad"] or [None] * 3
        row = {**station, "number": number, "file": station["input"]["file"]}
        row["pose_file"] = None if pose is None else station["pose_file"]
        for axis, place, length, angle in zip("xyz", origin, sigma, turn, strict=True):
            row |= {axis: place, f"sigma_{axis}_m": length, f"sigma_rotation_{axis}_deg": _deg(angle)}
        rows.append(row)
    return _csv(_STATION_COLUMNS, rows)


def _poses_of_earlier(folder: Path) -> set[str]:
    """Return the files of poses that the ``network.json`` in the folder speaks of."""
    try:
        stations = json.loads((folder / NETWORK).read_text(encoding="utf-8"))["stations"]
        bases = [Path(station["pose_file"]).stem for station in stations]
    except (OSError, ValueError, KeyError, TypeError):
        return set()  # none, or not ours
    return {f"{base}{ending}" for base in bases for ending in _POSE_ENDINGS}


def _pose_files(station: Mapping[str, Any]) -> dict[str, Callable[[Path], object]]:
    """Return what writes the pose of a station in every form that people paste somewhere else."""
    transform = Transform.of(station["world_from_station"])
    base = Path(station["pose_file"]).stem
    pipeline = pdal_pipeline(transform, station["input"]["file"], f"{base}_registered.laz")
    texts = (matrix_text(transform.matrix), json_text(transform_document(transform)), json_text(pipeline))
    return {f"{base}{ending}": _writer(text) for ending, text in zip(_POSE_ENDINGS, texts, strict=True)}


def _csv(columns: Sequence[str], rows: Iterable[Mapping[str, Any]]) -> str:
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(columns)
    for row in rows:
        writer.writerow(["" if row[column] is None else _cell(row[column]) for column in columns])
    return stream.getvalue()


def _cell(value: Any) -> Any:
    return {True: "yes", False: "no"}[value] if isinstance(value, bool) else value


def _deg(angle_rad: float | None) -> float | None:
    return None if angle_rad is None else math.degrees(angle_rad)


def _writer(text: str) -> Callable[[Path], object]:
    return lambda path: path.write_text(text, encoding="utf-8", newline="\n")
