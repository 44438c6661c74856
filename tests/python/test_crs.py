"""Coordinate reference systems: what differs is found, whatever its words, and what does not fit is named."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from tmchho.crs import crs_differences, crs_doubts, crs_facts, float32_step
from tmchho.io import open_las

pyproj = pytest.importorskip("pyproj")

UTM32, UTM33, FEET = 25832, 25833, 2229  # ETRS89 / UTM; NAD83 / California zone 5 (ftUS)


def wkt(code: int | str, version: str = "WKT1_GDAL") -> str:
    return str(pyproj.CRS.from_user_input(code).to_wkt(version))


HERE = np.array([500_000.0, 5_500_000.0, 100.0])


def test_one_system_in_many_words() -> None:
    words = [wkt(UTM32), wkt(UTM32, "WKT2_2019"), wkt(UTM32, "WKT1_ESRI"), wkt(UTM32) + "\0"]
    for one in words:
        for other in words:
            assert crs_differences(one, other) == []
    assert crs_differences(None, words[0]) == crs_differences(words[0], None) == []


def test_differences_are_named() -> None:
    (zones,) = crs_differences(wkt(UTM32), wkt(UTM33))
    assert "UTM zone 32N" in zones
    assert "UTM zone 33N" in zones
    units, names = crs_differences(wkt(FEET), wkt(UTM32))
    assert "foot" in units
    assert "metre" in units
    assert "0.3048006096" in units
    assert "California" in names


def test_heights_are_compared_where_both_tell_them() -> None:
    ellipsoid_free, evrf, amsterdam = (
        wkt(UTM32),
        wkt("EPSG:25832+5730", "WKT2_2019"),
        wkt("EPSG:25832+5709", "WKT2_2019"),
    )
    assert crs_differences(ellipsoid_free, evrf) == []
    (heights,) = crs_differences(evrf, amsterdam)
    assert "EVRF2000" in heights
    assert "NAP" in heights
    facts = crs_facts(evrf)
    assert facts is not None
    assert (facts.kind, facts.unit, facts.height_unit) == ("projected", "metre", "metre")


def test_heights_in_another_unit_than_the_plan_are_named() -> None:
    mixed = wkt("EPSG:26911+6360", "WKT2_2019")  # UTM 11 north in metres, NAVD88 heights in survey feet
    (doubt,) = crs_doubts(mixed, [400_000, 3_700_000, 0], [400_100, 3_700_100, 50])
    assert "heights are in US survey foot" in doubt
    both = wkt("EPSG:2229+6360", "WKT2_2019")
    assert crs_doubts(both, [6_326_651, 2_067_603, 0], [6_330_335, 2_071_980, 50]) == []


def test_swapped_axes_are_recognised_by_where_they_lead() -> None:
    assert crs_doubts(wkt(UTM32), HERE, HERE + 100) == []
    (doubt,) = crs_doubts(wkt(UTM32), HERE[[1, 0, 2]], HERE[[1, 0, 2]] + 100)
    assert "easting and northing are swapped" in doubt
    (outside,) = crs_doubts(wkt(UTM32), HERE * 100, HERE * 100)
    assert "outside the area" in outside
    assert "swapped" not in outside


def test_degrees_are_recognised_with_and_without_a_label() -> None:
    low, high = [-94.6835, 31.0367, 39.0], [-94.6606, 31.0473, 78.1]
    for crs in (wkt(4326), None):
        (doubt,) = crs_doubts(crs, low, high)
        assert "degrees" in doubt
    assert crs_doubts(None, [0, 0, 0], [30, 20, 10]) == []


def test_what_is_no_wkt_is_not_known() -> None:
    assert crs_facts("no such thing") is None
    assert crs_facts(None) is crs_facts("\0") is None
    assert crs_doubts("no such thing", HERE, HERE) == []


def test_without_pyproj_other_words_count_as_another_system(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyproj", None)
    assert crs_differences("PROJCS[...]", "PROJCS[...] ") == []
    (told,) = crs_differences("PROJCS[...]", "PROJCRS[...]")
    assert "tmchho[crs]" in told


def test_steps_of_float32_are_seen() -> None:
    rng = np.random.default_rng(0)
    exact = rng.uniform(0, 100, (1000, 3)) + HERE
    assert float32_step(exact) is None
    assert float32_step(exact.astype(np.float32).astype(np.float64)) == 0.5
    assert float32_step(np.full((3, 3), np.nan)) is None


@pytest.mark.parametrize(
    ("name", "unit", "kind"),
    [
        ("4_6_crop.las", "US survey foot", "projected"),
        ("autzen_trim_7.las", "foot", "projected"),
        ("certainty3d-color-utm-feet-navd88.las", "US survey foot", "projected"),
        ("epsg_4326.las", "degree", "geographic"),
        ("las_with_several_extra_byte_bloc.laz", "metre", "projected"),
    ],
)
def test_files_of_surveyors(data_dir: object, name: str, unit: str, kind: str) -> None:
    file = open_las(f"{data_dir}/survey/single/{name}")
    facts = crs_facts(file.crs)
    assert facts is not None
    assert (facts.unit, facts.kind) == (unit, kind)
    doubts = crs_doubts(file.crs, file.header.minima, file.header.maxima)
    assert bool(doubts) == (kind == "geographic")
