"""What can be told from a coordinate reference system without a library for it."""

from __future__ import annotations

import re


def crs_name(wkt: str | None) -> str | None:
    """Return the name that stands first in a WKT, with its EPSG number where it ends with one.

    Examples
    --------
    >>> crs_name('PROJCS["WGS 84 / UTM zone 47N",GEOGCS["WGS 84"],AUTHORITY["EPSG","32647"]]')
    'WGS 84 / UTM zone 47N (EPSG:32647)'
    >>> crs_name('LOCAL_CS["dam axis"]'), crs_name(None)
    ('dam axis', None)
    """
    if wkt is None or not wkt.strip():
        return None
    name = re.search(r'"([^"]*)"', wkt)
    code = re.search(r'(?:AUTHORITY|ID)\["EPSG",\s*"?(\d+)"?\]\s*\]\s*$', wkt)
    words = name.group(1) if name else wkt.strip()[:40]
    return f"{words} (EPSG:{code.group(1)})" if code else words


def is_geographic(wkt: str | None) -> bool:
    """Return whether coordinates are degrees of longitude and latitude.

    Examples
    --------
    >>> is_geographic('GEOGCS["WGS 84"]'), is_geographic('PROJCS["UTM",GEOGCS["WGS 84"]]')
    (True, False)
    """
    horizontal = re.sub(
        r'^\s*(?:COMPD_CS|COMPOUNDCRS|BOUNDCRS)\s*\[\s*(?:"[^"]*"\s*,|SOURCECRS\s*\[)', "", wkt or ""
    )
    return re.match(r"\s*(?:GEOGCS|GEOGCRS|GEOGRAPHICCRS)\s*\[", horizontal, re.IGNORECASE) is not None
