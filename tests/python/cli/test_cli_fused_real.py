"""Real pairs: every attribute of every point of both files is found in the fused one."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from cli_tools import REAL_PAIRS, run
from numpy.typing import NDArray

import tmchho
from tmchho.fused import colour_factors, no_data_value
from tmchho.moving import turned
from tmchho.transform import read_transform

COLOURS = ("red", "green", "blue")


@pytest.mark.parametrize("name", REAL_PAIRS)
def test_every_attribute_of_every_point_is_in_the_fused_file(
    data_dir: Path, tmp_path: Path, name: str
) -> None:
    survey = data_dir / "survey"
    pair = next(pair for pair in json.loads((survey / "pairs.json").read_text()) if pair["name"] == name)
    paths = [survey / pair[role] for role in ("source", "target")]
    result = run("register", *paths, "-o", tmp_path / "out", "--json", "--quiet")
    document = json.loads(result.stdout)
    assert document["verdict"] != "rejected", document["reasons"]
    transform = read_transform(tmp_path / "out" / "transform.json")
    source, target = (without_gaps(tmchho.read(path)) for path in paths)
    source = turned(source, transform)
    fused = tmchho.read(tmp_path / "out" / "fused.laz")
    rows = {"target": slice(0, len(target)), "source": slice(len(target), None)}
    assert len(fused) == len(source) + len(target)
    factors = dict(zip(("source", "target"), colour_factors(source, target), strict=True))
    places = {"target": target.xyz, "source": transform.apply(source.xyz)}
    clouds = {"target": target, "source": source}
    for role, cloud in clouds.items():
        step = np.abs(fused.metadata["header"].scales).max()
        assert np.abs(fused.xyz[rows[role]] - places[role]).max() <= 0.5001 * step
        for attribute, values in cloud.attributes.items():
            written = found(fused, attribute)[rows[role]]
            is_colour = attribute in COLOURS
            assert same(written, values, factors[role] if is_colour else 1, is_colour), (role, attribute)
    for role, other in (("source", "target"), ("target", "source")):
        for attribute in set(clouds[other].attributes) - set(clouds[role].attributes):
            if attribute in fused.attributes:
                missing = no_data_value(attribute, clouds[other])
                written = fused.attributes[attribute][rows[role]]
                assert np.array_equal(written, np.full_like(written, missing), equal_nan=True), attribute
    assert set(np.unique(fused.attributes["origin"])) == {0, 1}
    assert {"fills_hole", "C2C_absolute_distances"} <= set(fused.attributes)


def without_gaps(cloud: tmchho.PointCloud) -> tmchho.PointCloud:
    """Return the points that have coordinates; some scanners write NaN for a ray without an echo."""
    finite = np.isfinite(cloud.xyz).all(axis=1)
    attributes = {name: values[finite] for name, values in cloud.attributes.items()}
    return tmchho.PointCloud(cloud.xyz[finite], attributes, cloud.crs, cloud.metadata, cloud.name)


def found(fused: tmchho.PointCloud, attribute: str) -> NDArray[np.generic]:
    """Return a column of the fused file; a field with several values a point stands in several columns."""
    for name in (attribute, f"{attribute}_value"):
        if name in fused.attributes:
            return np.asarray(fused.attributes[name])
    columns = [name for name in fused.attributes if name.startswith(f"{attribute}_")]
    if columns:
        return np.column_stack([fused.attributes[name] for name in sorted(columns)])
    return np.zeros(len(fused), dtype=np.uint8)  # a flag that is never set, for which the format has no field


def same(written: NDArray[np.generic], values: NDArray[np.generic], factor: int, is_colour: bool) -> bool:
    """Return whether nothing was lost; 8-bit colours may come out with 16 bits."""
    flat = values.reshape(len(values), -1) if values.ndim > 1 else values
    factors = (factor, 256 * factor) if is_colour else (factor,)
    return any(
        np.array_equal(written.astype(np.float64), flat.astype(np.float64) * each, equal_nan=True)
        for each in factors
    )
