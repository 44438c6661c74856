"""`tmchho register` where the pose is not accepted."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from cli_tools import names_in, run

import tmchho
from tmchho.cloud import PointCloud
from tmchho.outputs import OUTPUTS


@pytest.fixture(scope="module")
def strangers(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Two clouds that have nothing in common: a ball's surface and a flight of stairs, both noisy."""
    rng = np.random.default_rng(0)
    ball = rng.standard_normal((3000, 3))
    ball = 10 * ball / np.linalg.norm(ball, axis=1, keepdims=True)
    stairs = rng.uniform(0, 30, (3000, 3))
    stairs[:, 2] = np.floor(stairs[:, 0] / 4) * 3 + 0.3 * np.sin(stairs[:, 1])
    folder = tmp_path_factory.mktemp("strangers")
    tmchho.write(PointCloud(ball), folder / "ball.ply")
    tmchho.write(PointCloud(stairs), folder / "stairs.ply")
    return folder / "ball.ply", folder / "stairs.ply"


def test_clouds_that_do_not_belong_together_are_not_accepted(
    strangers: tuple[Path, Path], tmp_path: Path
) -> None:
    folder = tmp_path / "out"
    result = run("register", *strangers, "-o", folder)
    assert result.exit_code == 4
    verdict = json.loads((folder / "result.json").read_text())["verdict"]
    assert verdict in ("review", "rejected")
    assert verdict in result.stdout.lower()


def test_a_rejected_pose_leaves_only_the_reasons(strangers: tuple[Path, Path], tmp_path: Path) -> None:
    folder = tmp_path / "out"
    folder.mkdir()
    (folder / "fused.laz").write_text("of an earlier run")
    (folder / "notes.txt").write_text("the user's own")
    config = tmp_path / "strict.toml"
    config.write_text("[verdict]\naccept_inlier_share = 1.0\nreject_inlier_share = 1.0\n")
    result = run("register", *strangers, "-o", folder, "--config", config, "--overwrite")
    assert result.exit_code == 4
    document = json.loads((folder / "result.json").read_text())
    assert document["verdict"] == "rejected"
    assert document["reasons"]
    assert document["fused"] is None
    assert names_in(folder) == ["notes.txt", "report_points.npz", "result.json"]
    assert "must not be used" in result.stdout


def test_a_pose_to_review_is_written_and_says_so(files: tuple[Path, Path], tmp_path: Path) -> None:
    config = tmp_path / "strict.toml"
    config.write_text("[verdict]\naccept_ambiguity_ratio = 1e6\n")
    result = run("register", *files, "-o", tmp_path / "out", "--config", config)
    assert result.exit_code == 4
    assert names_in(tmp_path / "out") == sorted(OUTPUTS)
    assert "A person must look" in result.stdout
    assert "What may settle it: --dof 4 if z is up in both files, or --prior with" in result.stdout


def test_what_was_given_already_is_not_proposed(files: tuple[Path, Path], tmp_path: Path) -> None:
    config = tmp_path / "strict.toml"
    config.write_text("[verdict]\naccept_ambiguity_ratio = 1e6\n")
    result = run("register", *files, "-o", tmp_path / "out", "--config", config, "--dof", "4")
    assert result.exit_code == 4
    assert "What may settle it: --prior" in result.stdout
    assert "--dof" not in result.stdout
