"""What can be known of two coordinate reference systems before their clouds are compared.

Why: a pose between feet and metres, or between two grids, is found as surely as any other, and is wrong.
With pyproj (extra ``crs``) systems are compared by what they mean, without it by their words.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

_SAME_UNIT = 1e-9  # the survey foot is 2e-6 longer than the foot
_VISIBLE_UNIT = 1e-5  # the two feet beside each other do not show in heights
_MARGIN_DEG = 1.0  # by which surveys reach beyond the area for which a system was made
# Degrees look like a needle: metres upwards, thousandths sideways.
_NEEDLE = 1000.0
_STEPS_LOOKED_AT = 200_000


@dataclass(frozen=True)
class CrsFacts:
    """A coordinate reference system in words and numbers.

    Parameters
    ----------
    name : str
        As it calls itself.
    kind : {'projected', 'geographic', 'other'}
        Whether coordinates are lengths in a map, degrees, or neither (a local or an earth-centred frame).
    unit, unit_m : str, float
        Of the plan, and its length in metres (for degrees, in radians).
    heights : str, optional
        Name of the system of heights, where it says.
    height_unit, height_unit_m : str, float, optional
        Of the heights.
    """

    name: str
    kind: str
    unit: str
    unit_m: float
    heights: str | None
    height_unit: str | None
    height_unit_m: float | None


def crs_facts(wkt: str | None) -> CrsFacts | None:
    """Return what a WKT says; None where there is none, pyproj is missing or does not understand it."""
    crs = _parsed(wkt)
    if crs is None:
        return None
    plan, heights = _split(crs)
    kind = "geographic" if plan.is_geographic else "projected" if plan.is_projected else "other"
    axis = plan.axis_info[0] if plan.axis_info else None
    upward = heights.axis_info[0] if heights is not None and heights.axis_info else None
    if upward is None and len(plan.axis_info) == 3:
        upward = plan.axis_info[2]
    return CrsFacts(
        name=crs.name,
        kind=kind,
        unit=axis.unit_name if axis else "unknown",
        unit_m=float(axis.unit_conversion_factor) if axis else 1.0,
        heights=None if heights is None else heights.name,
        height_unit=upward.unit_name if upward else None,
        height_unit_m=float(upward.unit_conversion_factor) if upward else None,
    )


def crs_differences(source: str | None, target: str | None) -> list[str]:
    """Return in what two systems differ, in sentences; none where one is unknown or they mean the same.

    Parameters
    ----------
    source, target : str, optional
        WKT of each.
    """
    if source is None or target is None or source.strip("\0 \n") == target.strip("\0 \n"):
        return []
    of_source, of_target = _parsed(source), _parsed(target)
    if of_source is None or of_target is None:
        return [
            "their coordinate reference systems are worded differently, and whether they mean the same "
            "cannot be told without pyproj (pip install 'tmchho[crs]')"
        ]
    (plan_a, heights_a), (plan_b, heights_b) = _split(of_source), _split(of_target)
    found = []
    a, b = crs_facts(source), crs_facts(target)
    assert a is not None
    assert b is not None
    if abs(a.unit_m / b.unit_m - 1) > _SAME_UNIT:
        found.append(f"the source is in {a.unit}, the target in {b.unit} (factor {a.unit_m / b.unit_m:.10g})")
    if not _is_same(plan_a, plan_b):
        found.append(f"the source is in {plan_a.name}, the target in {plan_b.name}")
    if heights_a is not None and heights_b is not None:
        if not _is_same(heights_a, heights_b):
            found.append(f"heights are {heights_a.name} in the source, {heights_b.name} in the target")
        if abs((a.height_unit_m or 1) / (b.height_unit_m or 1) - 1) > _SAME_UNIT:
            found.append(f"heights are in {a.height_unit} in the source, in {b.height_unit} in the target")
    return found


def crs_doubts(wkt: str | None, lowest: ArrayLike, highest: ArrayLike) -> list[str]:
    """Return what does not fit between a system and the box of the points that are said to be in it.

    Parameters
    ----------
    wkt : str, optional
        The system.
    lowest, highest : (3,) array_like
        Corners of the box.
    """
    low, high = np.asarray(lowest, dtype=np.float64), np.asarray(highest, dtype=np.float64)
    if wkt is None:
        return (
            ["coordinates look like degrees of longitude and latitude; project them to metres first"]
            if looks_like_degrees(low, high)
            else []
        )
    facts, crs = crs_facts(wkt), _parsed(wkt)
    if facts is None or crs is None:
        return []
    found = []
    if facts.kind == "geographic":
        found.append("coordinates look like degrees of longitude and latitude; project them to metres first")
    if (
        facts.kind == "projected"
        and facts.height_unit_m
        and abs(facts.height_unit_m / facts.unit_m - 1) > 1e-5
    ):
        found.append(
            f"heights are in {facts.height_unit}, the plan in {facts.unit}: bring both to one unit first"
        )
    if facts.kind == "projected":
        inside = _is_in_area(crs, (low + high) / 2)
        if inside is False:
            outside = f"the points lie outside the area for which {facts.name} is made"
            is_swapped = _is_in_area(crs, ((low + high) / 2)[[1, 0, 2]])
            found.append(f"easting and northing are swapped: {outside}" if is_swapped else outside)
    return found


def looks_like_degrees(lowest: NDArray[np.float64], highest: NDArray[np.float64]) -> bool:
    """Return whether a box may be one of longitude, latitude and metres: tiny sideways, tall."""
    in_range = bool((np.abs(lowest[:2]) <= [180, 90]).all() and (np.abs(highest[:2]) <= [180, 90]).all())
    extent = highest - lowest
    return in_range and bool(extent[2] > _NEEDLE * extent[:2].max())


def float32_step(xyz: NDArray[np.float64]) -> float | None:
    """Return the step of coordinates that were once stored as float32, None where they were not.

    Judged by a sample; coordinates that have few digits anyway, such as whole numbers, count as well.
    """
    sample = xyz[:: max(1, len(xyz) // _STEPS_LOOKED_AT)]
    sample = sample[np.isfinite(sample).all(axis=1)]
    if not len(sample) or not (sample == sample.astype(np.float32)).all():
        return None
    return float(np.spacing(np.abs(sample).max(axis=0).astype(np.float32)).max())


def _parsed(wkt: str | None) -> Any:
    if wkt is None or not wkt.strip("\0 \n"):
        return None
    try:
        import pyproj
    except ImportError:
        return None
    try:
        return pyproj.CRS.from_user_input(wkt.strip("\0"))
    except pyproj.exceptions.CRSError:
        return None


def _split(crs: Any) -> tuple[Any, Any]:
    """Return the system of the plan and that of the heights, None where it has none."""
    if crs.is_bound:
        crs = crs.source_crs
    if not crs.is_compound:
        return crs, None
    plan = crs.sub_crs_list[0]
    return plan.source_crs if plan.is_bound else plan, crs.sub_crs_list[1]


def _is_same(a: Any, b: Any) -> bool:
    codes = [crs.to_epsg(min_confidence=60) for crs in (a, b)]
    return (None not in codes and codes[0] == codes[1]) or bool(a.equals(b, ignore_axis_order=True))


def _is_in_area(crs: Any, place: NDArray[np.float64]) -> bool | None:
    """Return whether a place lies in the area for which a system was made; None where that is not known."""
    import pyproj

    plan, _ = _split(crs)
    code = plan.to_epsg(min_confidence=60)
    known = pyproj.CRS.from_epsg(code) if code is not None else plan
    area = known.area_of_use
    if area is None:
        return None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        to_degrees = pyproj.Transformer.from_crs(plan, plan.geodetic_crs, always_xy=True)
        east, north = to_degrees.transform(place[0], place[1])
    if not np.isfinite([east, north]).all():
        return False
    is_north = area.south - _MARGIN_DEG <= north <= area.north + _MARGIN_DEG
    width = (area.east - area.west) % 360  # across the date line as well
    is_east = (east - area.west + _MARGIN_DEG) % 360 <= width + 2 * _MARGIN_DEG
    return bool(is_north and is_east)
