"""Areas from files: GeoJSON, WKT, and through pyogrio whatever a GIS writes.

Why: outlines come from a GIS in its own coordinate reference system. One that is taken for another puts an
area on the wrong side of the valley, so differing systems are converted or refused, never ignored.
Source: RFC 7946 (GeoJSON: longitude and latitude of WGS 84 where no ``crs`` says otherwise); the ``crs``
member of the GeoJSON of 2008; OGC 06-103r4 (WKT), with PostGIS' prefix ``SRID=…;``.
"""

from __future__ import annotations

import json
import logging
import os
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import shapely

from tmchho.errors import InvalidArgumentError, ReadError
from tmchho.evaluation.areas import Area

logger = logging.getLogger(__name__)

_GEOJSON = (".geojson", ".json")
_WKT = (".wkt", ".txt", ".csv")
_NAME_KEYS = ("name", "area", "label", "title", "id")
_WKT_LINE = re.compile(
    r"""^\s*(?:(?!SRID=)"?(?P<name>[^";\t]*?)"?\s*[;\t]\s*)?(?:SRID=(?P<srid>\d+)\s*;\s*)?
        "?(?P<wkt>(?:MULTI)?POLYGON\b[^"]*)"?\s*$""",
    re.IGNORECASE | re.VERBOSE,
)
_LONGITUDE_LATITUDE = "OGC:CRS84"


class _Named(NamedTuple):
    """A geometry as the file has it; `crs` None where the file does not say."""

    name: str
    geometry: Any
    crs: str | None


def read_areas(path: str | os.PathLike[str], crs: str | None = None) -> tuple[Area, ...]:
    """Read the areas of a survey from a file.

    Parameters
    ----------
    path : str or path
        ``.geojson`` or ``.json``; ``.wkt``, ``.txt`` or ``.csv`` with a polygon in WKT on each line, perhaps
        after a name and a semicolon; anything else (shapefile, GeoPackage, …) through pyogrio.
    crs : str, optional
        Coordinate reference system of the target, as WKT. Areas in another one are converted into it, which
        needs pyproj.

    Returns
    -------
    tuple of Area
        At least one. What the file calls ``name``, ``area``, ``label``, ``title`` or ``id`` is its name, else
        its number; names that come twice are numbered.

    Raises
    ------
    ReadError
        If the file cannot be read, or holds no polygon or one without a surface.
    InvalidArgumentError
        If a coordinate reference system has to be converted and pyproj is missing or does not know it.
    """
    path = Path(path)
    if not path.exists():
        raise ReadError(f"{path}: does not exist; check the name and the folder")
    suffix = path.suffix.lower()
    try:
        if suffix in _GEOJSON:
            found = _read_geojson(path)
        elif suffix in _WKT:
            found = _read_wkt(path)
        else:
            found = _read_with_pyogrio(path)
    except (UnicodeDecodeError, ValueError, shapely.errors.ShapelyError) as error:
        if isinstance(error, InvalidArgumentError):
            raise
        # What the libraries below say may end with a new line.
        what = " ".join(str(error).split())
        raise ReadError(
            f"{path}: does not hold areas that can be read ({what}); export them as GeoJSON"
        ) from error
    except OSError as error:
        if isinstance(error, ReadError):
            raise
        raise ReadError(f"{path}: cannot be read ({error.strerror}); check the rights") from error
    if not found:
        raise ReadError(f"{path}: holds no polygon; draw at least one area")
    converted = _in_system(path, found, crs)
    names = _distinct(item.name for item in converted)
    try:
        return tuple(Area(name, item.geometry) for name, item in zip(names, converted, strict=True))
    except InvalidArgumentError as error:
        raise ReadError(f"{path}: {error}") from error


def _read_geojson(path: Path) -> list[_Named]:
    document = json.loads(path.read_text(encoding="utf-8-sig"))
    if not isinstance(document, dict) or "type" not in document:
        raise ReadError(f"{path}: is not GeoJSON; export the areas as GeoJSON, WKT or a shapefile")
    crs = _crs_member(path, document)
    if document["type"] == "FeatureCollection":
        features = document.get("features") or []
    elif document["type"] == "Feature":
        features = [document]
    else:
        features = [{"geometry": document}]
    found = []
    for number, feature in enumerate(features, start=1):
        geometry = feature.get("geometry") if isinstance(feature, dict) else None
        if geometry is None:
            raise ReadError(f"{path}: feature {number} has no geometry; give it an outline or delete it")
        properties = {
            **({"id": feature["id"]} if "id" in feature else {}),
            **(feature.get("properties") or {}),
        }
        found.append(_Named(_name_of(properties, number), shapely.from_geojson(json.dumps(geometry)), crs))
    return found


def _crs_member(path: Path, document: dict[str, Any]) -> str | None:
    """Return the name of the system in the ``crs`` member that GeoJSON had until 2016."""
    if document.get("crs") is None:
        return None
    try:
        return str(document["crs"]["properties"]["name"])
    except (KeyError, TypeError) as error:
        raise ReadError(
            f"{path}: its 'crs' has no properties.name; write the name of the system, such as EPSG:32647"
        ) from error


def _read_wkt(path: Path) -> list[_Named]:
    found: list[_Named] = []
    for number, line in enumerate(path.read_text(encoding="utf-8-sig").splitlines(), start=1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        match = _WKT_LINE.match(line)
        if match is None:
            if number == 1:
                continue  # a heading
            raise ReadError(
                f"{path}: line {number} is no POLYGON or MULTIPOLYGON in WKT; write one a line, such as "
                "POLYGON ((0 0, 9 0, 9 9, 0 0))"
            )
        crs = None if match["srid"] is None else f"EPSG:{match['srid']}"
        found.append(_Named(match["name"] or str(len(found) + 1), shapely.from_wkt(match["wkt"]), crs))
    return found


def _read_with_pyogrio(path: Path) -> list[_Named]:
    try:
        import pyogrio
        import pyogrio.raw
    except ImportError as error:
        raise InvalidArgumentError(
            f"{path}: reading {path.suffix or 'this file'} needs pyogrio: pip install 'tmchho[areas]', "
            "or export the areas as GeoJSON"
        ) from error
    try:
        about, _, geometries, columns = pyogrio.raw.read(path)
    except (pyogrio.errors.DataSourceError, pyogrio.errors.DataLayerError) as error:
        raise ReadError(
            f"{path}: cannot be read as a layer of areas ({error}); export it as GeoJSON"
        ) from error
    found: list[_Named] = []
    for number, geometry in enumerate(geometries, start=1):
        row = {str(key): column[number - 1] for key, column in zip(about["fields"], columns, strict=True)}
        if geometry is None:
            raise ReadError(f"{path}: feature {number} has no geometry; give it an outline or delete it")
        found.append(_Named(_name_of(row, number), shapely.from_wkb(geometry), about["crs"]))
    return found


def _name_of(properties: dict[str, Any], number: int) -> str:
    lower = {key.lower(): value for key, value in properties.items()}
    given = (lower[key] for key in _NAME_KEYS if lower.get(key) not in (None, ""))
    return str(next(given, number))


def _distinct(names: Iterable[str]) -> list[str]:
    taken: list[str] = []
    for name in names:
        copies = (f"{name} ({number})" for number in range(2, len(taken) + 3))
        taken.append(name if name not in taken else next(copy for copy in copies if copy not in taken))
    return taken


def _in_system(path: Path, found: list[_Named], crs: str | None) -> list[_Named]:
    """Return the geometries in the system of the target."""
    converted = []
    for item in found:
        given = item.crs
        if (
            given is None
            and crs is not None
            and path.suffix.lower() in _GEOJSON
            and _is_lon_lat(item.geometry)
        ):
            given = _LONGITUDE_LATITUDE
        if given is None or crs is None:
            if given is not None:
                logger.warning(
                    "%s: its areas are in %s, and the target does not say its system: taken for the same",
                    path,
                    given,
                )
            converted.append(item)
        else:
            geometry = _converted(path, item.geometry, given, crs)
            converted.append(item._replace(geometry=geometry))
    return converted


def _is_lon_lat(geometry: Any) -> bool:
    places = np.abs(shapely.get_coordinates(geometry))
    return bool((places <= [180.0, 90.0]).all())


def _converted(path: Path, geometry: Any, given: str, crs: str) -> Any:
    try:
        import pyproj
    except ImportError as error:
        raise InvalidArgumentError(
            f"{path}: its areas are in {given}; to convert them to the system of the target needs pyproj: "
            "pip install 'tmchho[crs]', or export the areas in the target's system"
        ) from error
    try:
        from_system, to_system = _horizontal(pyproj, given), _horizontal(pyproj, crs)
        if from_system == to_system:
            return geometry
        convert = pyproj.Transformer.from_crs(from_system, to_system, always_xy=True, only_best=False)
        result = shapely.transform(
            geometry, lambda xy: np.column_stack(convert.transform(xy[:, 0], xy[:, 1]))
        )
    except pyproj.exceptions.ProjError as error:
        raise InvalidArgumentError(
            f"{path}: its areas cannot be converted from {given} to the system of the target ({error}); "
            "export them in the target's system"
        ) from error
    if not np.isfinite(shapely.get_coordinates(result)).all():
        raise InvalidArgumentError(
            f"{path}: an area lies where the system of the target is not defined; check its coordinates"
        )
    return result


def _horizontal(pyproj: Any, name: str) -> Any:
    """Return the part of a system that is about places on the map."""
    system = pyproj.CRS.from_user_input(name)
    return system.sub_crs_list[0] if system.is_compound else system.to_2d()
