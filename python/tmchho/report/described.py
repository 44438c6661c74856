"""What the report tells about a cloud besides its name and size; noted while the cloud is at hand."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

import numpy as np

from tmchho.cloud import PointCloud
from tmchho.stages import median_spacing

if TYPE_CHECKING:
    from tmchho.io.las_stream import LasPoints


def describe(cloud: PointCloud, crs: str | None) -> dict[str, Any]:
    """Return what stands in the table of inputs.

    Parameters
    ----------
    cloud : PointCloud
        At least two points.
    crs : str, optional
        Name of its coordinate reference system.

    Returns
    -------
    dict
        ``format``, ``sensor`` (the words of the file about where it comes from), ``crs``, ``unit`` (of
        lengths), ``spacing`` (median distance to the nearest other point), ``lowest`` and ``highest`` corner,
        ``attributes`` (their names); None for what is not known.
    """
    finite = cloud.xyz[np.isfinite(cloud.xyz).all(axis=1)]
    return {
        "format": cloud.metadata.get("format"),
        "sensor": sensor_words(cloud),
        "crs": crs,
        "unit": length_unit(cloud.crs),
        "spacing": median_spacing(finite) or None,
        "lowest": finite.min(axis=0).tolist(),
        "highest": finite.max(axis=0).tolist(),
        "attributes": sorted(cloud.attributes),
    }


def describe_parts(file: LasPoints, crs: str | None) -> dict[str, Any]:
    """Return the same of a file too large to hold: what its header says, and no spacing."""
    named = PointCloud(np.empty((0, 3)), metadata={"header": file.header})
    return {
        "format": "las",
        "sensor": sensor_words(named),
        "crs": crs,
        "unit": length_unit(file.crs),
        "spacing": None,
        "lowest": list(file.header.minima),
        "highest": list(file.header.maxima),
        "attributes": sorted(set(file.point_format.dimension_names) - {"X", "Y", "Z"}),
    }


def sensor_words(cloud: PointCloud) -> str | None:
    """Return what a file says of the sensor or program that it comes from, None where it says nothing."""
    header = cloud.metadata.get("header")
    stated = [getattr(header, name, "") for name in ("system_identifier", "generating_software")]
    stated += [str(words) for words in (cloud.metadata.get("sensor"), *cloud.metadata.get("comments", ()))]
    return (
        "; ".join(dict.fromkeys(words.strip() for words in stated if words.strip() not in ("", "None")))
        or None
    )


def length_unit(wkt: str | None) -> str | None:
    """Return the sign of the unit in which a coordinate reference system measures lengths.

    Examples
    --------
    >>> length_unit('PROJCS["x",GEOGCS["y",UNIT["degree",0.0174532925]],UNIT["metre",1]]')
    'm'
    >>> length_unit('PROJCRS["x",CS[Cartesian,2],LENGTHUNIT["US survey foot",0.304800609601219]]')
    'ft (US)'
    >>> length_unit(None) is None
    True
    """
    signs = {1.0: "m", 0.3048: "ft", 0.3048006096: "ft (US)"}
    # The ellipsoid is in metres, whatever the coordinates are in.
    text = re.sub(r"\b(?:ELLIPSOID|SPHEROID)\s*\[[^\]]*(?:\[[^\]]*\][^\]]*)*\]", "", wkt or "")
    found = re.findall(r'\b(?:LENGTHUNIT|UNIT)\s*\[\s*"[^"]*"\s*,\s*([0-9.eE+-]+)', text)
    lengths = [signs[round(float(f), 10)] for f in found if round(float(f), 10) in signs]
    return lengths[0] if lengths else None
