"""Real pairs of clouds from end to end, where they are at hand."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from cli_tools import REAL_PAIRS, names_in, run

import tmchho
from tmchho.outputs import OUTPUTS, read_matrix


@pytest.mark.parametrize("name", REAL_PAIRS)
def test_a_real_pair_runs_from_end_to_end(data_dir: Path, tmp_path: Path, name: str) -> None:
    survey = data_dir / "survey"
    pair = next(pair for pair in json.loads((survey / "pairs.json").read_text()) if pair["name"] == name)
    paths = [survey / pair[role] for role in ("source", "target")]
    result = run("register", *paths, "-o", tmp_path / "out", "--json", "--quiet")
    document = json.loads(result.stdout)
    assert result.exit_code == (0 if document["verdict"] == "accepted" else 4)
    if document["verdict"] == "rejected":
        assert names_in(tmp_path / "out") == ["report_points.npz", "result.json"]
        return
    assert names_in(tmp_path / "out") == sorted(OUTPUTS)

    source = tmchho.read(paths[0])
    found, true = read_matrix(tmp_path / "out" / "transform.txt"), np.array(pair["target_from_source"])
    centroid = source.xyz.mean(axis=0)
    apart = (found[:3, :3] - true[:3, :3]) @ centroid + found[:3, 3] - true[:3, 3]
    difference = np.linalg.norm(found[:3, :3] - true[:3, :3]) / np.sqrt(8)
    if document["verdict"] == "accepted":  # what is signed must be right
        assert np.linalg.norm(apart) < pair["tolerance_m"]
        assert np.degrees(2 * np.arcsin(difference)) < pair["tolerance_deg"]

    moved = tmchho.read(tmp_path / "out" / "source_registered.laz")
    finite = np.isfinite(source.xyz).all(axis=1)
    assert len(moved) == np.count_nonzero(finite)
    renamed = {"scan_angle_rank": "scan_angle"}  # in the point formats of LAS 1.4
    for attribute, values in source.attributes.items():
        if attribute in ("red", "green", "blue") or not np.any(values):
            continue  # depth of colours follows the format; LAS has no field for flags that are never set
        written = moved.attributes.get(attribute, moved.attributes.get(renamed.get(attribute, "")))
        assert written is not None, attribute
        if written.dtype == values.dtype:
            assert np.array_equal(written, values[finite], equal_nan=True), attribute


def test_another_plot_is_not_accepted(data_dir: Path, tmp_path: Path) -> None:
    forest = data_dir / "survey" / "forest"
    result = run("register", forest / "TLS_Clip.laz", forest / "UAS_Clip.laz", "-o", tmp_path / "out")
    assert result.exit_code == 4


def test_a_mirrored_room_is_not_accepted_though_two_thirds_of_it_fit(data_dir: Path) -> None:
    room = tmchho.read(data_dir / "survey" / "room" / "room_scan1.pcd").xyz
    found = tmchho.register(room * [-1, 1, 1], room)
    assert found.inlier_share > 0.6
    assert found.verdict == "review"
    assert any("mirrored" in reason for reason in found.reasons)
