"""From every format into every format: each attribute of each point, and nothing lost but what is said."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tmchho.cloud import PointCloud
from tmchho.io import known_extensions, read, write

WRITABLE = known_extensions(writable=True)
N_POINTS = 120
HELD_BY_PTX = {"intensity", "red", "green", "blue", "scan_index"}


def cloud() -> PointCloud:
    rng = np.random.default_rng(0)
    xyz = np.array([500_000, 4_000_000, 100]) + rng.normal(0, 50, (N_POINTS, 3)).round(3)
    attributes: dict[str, NDArray[Any]] = {
        "intensity": rng.integers(0, 65536, N_POINTS).astype(np.uint16),
        **{name: rng.integers(0, 256, N_POINTS).astype(np.uint8) for name in ("red", "green", "blue")},
        "classification": rng.integers(1, 19, N_POINTS).astype(np.uint8),
        "gps_time": rng.random(N_POINTS) * 3e8,
        "roughness": rng.random(N_POINTS),
        "change": rng.integers(-9, 10, N_POINTS),
        "scan_index": np.sort(rng.integers(0, 3, N_POINTS)).astype(np.uint16),
    }
    return PointCloud(xyz, attributes)


def as_8_bit(name: str, values: NDArray[Any]) -> NDArray[Any]:
    """Return colours with the depth that all formats have, everything else as it is."""
    is_deep = name in ("red", "green", "blue") and values.max() > 255
    return values // 256 if is_deep else values


@pytest.mark.parametrize("source", WRITABLE)
def test_every_attribute_of_every_point(tmp_path: Path, source: str) -> None:
    write(cloud(), tmp_path / f"a{source}")
    first = read(tmp_path / f"a{source}")
    for target in WRITABLE:
        if ".e57" in (source, target):
            pytest.importorskip("pye57")
        write(first, tmp_path / f"b{target}", overwrite=True)
        back = read(tmp_path / f"b{target}")
        np.testing.assert_allclose(back.xyz, first.xyz, atol=1e-6, rtol=0, err_msg=target)
        for name, values in cloud().attributes.items():
            if name in HELD_BY_PTX or ".ptx" not in (source, target):
                found = as_8_bit(name, back.attributes[name])
                np.testing.assert_array_equal(found, values, err_msg=f"{source} {target} {name}")
        left_out = {name for name in first.attributes if name not in back.attributes}
        if target != ".ptx":
            assert not left_out
