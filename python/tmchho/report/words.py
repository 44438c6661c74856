"""What the figures of a registration mean, for somebody who knows nothing of the method."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

# What a client must know: may this be used?
VERDICTS = {
    "accepted": (
        "The result can be used.",
        "The two clouds fit together in this position, and in no other one that was found.",
    ),
    "review": (
        "A person must look before the result is used.",
        "The position may be right, but something that would make it sure is missing.",
    ),
    "rejected": (
        "The result must not be used.",
        "The data do not support this position. The clouds were not fused.",
    ),
}
NOT_MEASURED = "not measured"
BLANK = "\u00a0"  # between a number and its unit, where no line may break
FITS = {
    "point_to_plane": "Typical distance of a point from the surface of the other cloud where the two match",
    "plane_to_plane": "Typical distance of the surfaces where the two clouds match",
    "point_to_point": "Typical distance of points that match",
}

STAGES = {
    "thin": "Thinning to what fits into memory",
    "outliers": "Removal of outliers",
    "voxel": "Thinning to one point a voxel",
    "keypoints": "Keypoints",
    "coarse": "Search for the position",
    "icp": "Fine registration (ICP)",
    "verdict": "Judgement",
    "evaluate": "Distances of all points",
}


def number(value: float | None, digits: int = 3) -> str:
    r"""Return a number with so many significant digits, in full: people do not read exponents.

    Examples
    --------
    >>> number(0.0034567), number(12345.6), number(0.0), number(None), number(3.2e-9)
    ('0.00346', '12\u202f346', '0', 'not measured', '3.2e-09')
    """
    if value is None:
        return NOT_MEASURED
    if value == 0:
        return "0"
    magnitude = math.floor(math.log10(abs(value)))
    if not -7 < magnitude < 12:
        return f"{value:.2g}"
    return f"{value:,.{max(0, digits - 1 - magnitude)}f}".replace(",", "\u202f")


def length(value: float | None, unit: str, digits: int = 3) -> str:
    r"""Return a length with its unit; below a tenth of a metre in millimetres.

    Examples
    --------
    >>> length(0.00588, f"{BLANK}m"), length(0.25, f"{BLANK}m"), length(0.01, " ft"), length(None, " ft")
    ('5.9\xa0mm', '0.250\xa0m', '0.0100 ft', 'not measured')
    """
    if value is None:
        return NOT_MEASURED
    if unit == f"{BLANK}m" and 0 < abs(value) < 0.1:
        return f"{number(1000 * value, 2)}{BLANK}mm"
    return number(value, digits) + unit


def percent(value: float | None) -> str:
    r"""Return a share as people say it.

    Examples
    --------
    >>> percent(0.2558), percent(1.0475), percent(0.004)
    ('26\xa0%', '100\xa0%', '0.4\xa0%')
    """
    if value is None:
        return NOT_MEASURED
    share = 100 * min(value, 1.0)
    return f"{share:.{1 if 0 < share < 1 or 99 < share < 100 else 0}f}{BLANK}%"


def sentence(text: str) -> str:
    """Return a reason or a warning as a sentence of its own.

    Examples
    --------
    >>> sentence("the pose scores 2.1 times the next one")
    'The pose scores 2.1 times the next one.'
    """
    return f"{text[:1].upper()}{text[1:]}" + ("" if text.endswith(".") else ".")


def count(value: int) -> str:
    """Return a count with narrow blanks between the thousands."""
    return f"{value:,}".replace(",", "\u202f")


def better_direction(document: Mapping[str, Any]) -> str:
    """Return the direction whose distances tell most: from the cloud of which more is common."""
    more_of_source = document["overlap_of_source"] >= document["overlap_of_target"]
    return "source_to_target" if more_of_source else "target_to_source"


def key_figures(document: Mapping[str, Any], unit: str) -> list[dict[str, str]]:
    """Return the four figures of page one: a name, a value, and what it says."""
    direction = better_direction(document)
    distances = document[direction]
    method = document["config"]["icp"]["method"]
    fit = math.sqrt(document["icp_history"][-1]) if document["icp_history"] else None
    shares = [(document[f"overlap_of_{side}"], side) for side in ("source", "target")]
    figures = [
        {
            "name": "Accuracy of the position",
            "value": length(document["registration_error"], unit, 2),
            "words": "By so much a point may typically be displaced because of the errors of the position "
            "(1σ). Errors that both clouds share, such as a wrong scale bar, do not show in it.",
        },
        {
            "name": "Fit of the surfaces",
            "value": length(fit, unit, 2),
            "words": f"{FITS.get(method, 'Root mean square residual')}, at the end of the fine registration. "
            f"From point to nearest point it is {length(distances['median'], unit)} (median, "
            f"{direction.replace('_', ' ')}), the spacing of the points included.",
        },
        {
            "name": "Overlap",
            "value": percent(max(shares)[0]),
            "words": f"of the {max(shares)[1]} lies within {length(document['max_distance'], unit)} of the "
            f"{min(shares)[1]}; of the {min(shares)[1]} it is {percent(min(shares)[0])}.",
        },
        {
            "name": "Hold in the weakest direction",
            "value": percent(6 * document["strength"]) if document["strength"] is not None else NOT_MEASURED,
            "words": f"100 % is held alike in all directions, 0 % slides or turns freely. Weakest: "
            f"{document['weakest_direction']}.",
        },
    ]
    return figures


def evidence(document: Mapping[str, Any], unit: str) -> list[dict[str, Any]]:
    """Return what the verdict rests on: each check with its value, its limit and its meaning.

    ``passed`` is None where nothing was measured.
    """
    limits = document["config"]["verdict"]
    ratio, least_ratio = document["ambiguity_ratio"], document["least_ambiguity_ratio"]
    no_rival = ratio is None and document["mode"] == "robust"
    rows = [
        _check(
            "Matching surface",
            "share of the smaller cloud that finds surface with the same direction in the other",
            document["inlier_share"],
            limits["accept_inlier_share"],
            percent,
        ),
        {
            "name": "Lead over the next best position",
            "words": "how many times better the position fits than any clearly different one that was found",
            "value": "no other was found" if no_rival else _times(ratio),
            "limit": "—" if least_ratio is None else f"above {least_ratio:.2f} times",
            "passed": True if no_rival else None if ratio is None else ratio > (least_ratio or math.inf),
        },
        _check(
            "Lead over chance",
            "how many times better the position fits than random ones do",
            document["lead_over_chance"],
            limits["accept_lead_over_chance"],
            _times,
        ),
        _check(
            "Test with points held back",
            "distance of points that took no part in the fit, by that of those that did",
            document["held_out_ratio"],
            limits["accept_held_out_ratio"],
            _times,
            most=True,
        ),
        _check(
            "Misfit of the surfaces",
            "how far the surfaces lie apart, by how rough they are themselves",
            document["misfit"],
            limits["accept_misfit"],
            _times,
            most=True,
        ),
        _check(
            "Conflicting surface",
            "share of the surface near the other cloud that lies above or below it, where surfaces cross",
            document["conflict_share"],
            limits["accept_conflict_share"],
            percent,
            most=True,
        ),
        _check(
            "Offset of the surfaces",
            "within which distance nine tenths of even surface lie once their noise is averaged out",
            document["surface_offset"],
            document["most_surface_offset"],
            lambda value: length(value, unit, 2),
            most=True,
        ),
        _check(
            "Hold in the weakest direction",
            "how firmly the common surface holds the position against sliding and turning",
            document["strength"],
            limits["accept_strength"],
            lambda value: percent(None if value is None else 6 * value),
        ),
        {
            "name": "Fine registration came to rest",
            "words": "further iterations would change nothing",
            "value": "yes" if document["converged"] else "no",
            "limit": "yes",
            "passed": bool(document["converged"]),
        },
        {
            "name": "Search was not cut short",
            "words": "it ended because it was done, not because a time limit was up",
            "value": "no" if document["ended_early"] else "yes",
            "limit": "yes",
            "passed": not document["ended_early"],
        },
    ]
    return rows


def stage_rows(document: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return what each stage did, with the share of the time it took."""
    stages = document["stages"]
    longest = max((stage["seconds"] for stage in stages), default=0.0) or 1.0
    return [
        {**stage, "title": STAGES.get(stage["name"], stage["name"]), "share": stage["seconds"] / longest}
        for stage in stages
    ]


def _check(
    name: str, words: str, value: float | None, limit: float, say: Any, most: bool = False
) -> dict[str, Any]:
    passed = None if value is None else value <= limit if most else value >= limit
    side = "at most" if most else "at least"
    return {
        "name": name,
        "words": words,
        "value": say(value),
        "limit": f"{side} {say(limit)}",
        "passed": passed,
    }


def _times(value: float | None) -> str:
    return NOT_MEASURED if value is None else f"{number(value)} times"
