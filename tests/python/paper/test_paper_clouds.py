"""Sections 5.2 and 5.3: the clouds, the searches on them, the pages."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from paper_tools import rows_of, run_paper
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

import tmchho
from tmchho.paper import Settings, dam, figure8, registrations, site, success, table4, table5
from tmchho.paper.plan import Run
from tmchho.paper.scans import KINDS, MODELS, VOXEL_SIZE, Pair, load_pair, moved
from tmchho.simulate import random_pose
from tmchho.simulate.pair import invert

NEVER = bool  # bool() is False: no job is asked to stop


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Every page of Section 5.2, on simulated objects; searches far too short to be right."""
    folder = tmp_path_factory.mktemp("objects")
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv("TMCHHO_DATA", raising=False)
        names = ("table4", "figure8", "figure9", "table5", "figure10", "success")
        assert run_paper(*names, "--runs", 1, "--iterations", 2, "-o", folder).exit_code == 0
    return folder


def test_without_real_scans_the_pages_say_so_and_print_nothing_beside(simulated: Path) -> None:
    page = (simulated / "paper.html").read_text(encoding="utf-8")
    assert page.count("SIMULATED OBJECTS, because TMCHHO_DATA is not set") == 6
    for name in ("table4", "table5"):
        rows = rows_of(simulated / f"{name}.csv")
        assert {row["model"] for row in rows} == {f"simulated object {n}" for n in (1, 2, 3, 4)}
        assert {value for row in rows for key, value in row.items() if key.startswith("printed")} == {""}


def test_the_tables_have_every_object_kind_and_method(simulated: Path) -> None:
    rows = rows_of(simulated / "table4.csv")
    assert len(rows) == len(KINDS) * len(MODELS) * 8
    assert [row["algorithm"] for row in rows[:8]] == [
        *("BOA", "WOA", "PSO", "DOA", "HHO", "TMCHHO"),
        *("robust mode", "true pose"),
    ]
    truths = [float(row["ave"]) for row in rows if row["algorithm"] == "true pose"]
    # A copy lies on itself to the last bits; two scans do not hold the same points.
    assert max(truths[:4]) < 1e-15
    assert min(truths[4:]) > 1e-3
    robust = [row for row in rows if row["algorithm"] == "robust mode"]
    assert sum(int(row["right_fine"]) for row in robust) == len(robust)
    table = rows_of(simulated / "success.csv")
    assert [row["right"] for row in table if row["method"] == "robust mode"] == ["4", "4"]


def test_data_that_are_not_there_are_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TMCHHO_DATA", str(tmp_path / "nowhere"))
    result = run_paper("table5", "--runs", 1, "--iterations", 1, "-o", tmp_path / "out")
    assert result.exit_code == 3
    assert "pairs.json" in result.stderr
    assert "TMCHHO_DATA" in result.stderr


def test_real_scans_stand_beside_printed_values(data_dir: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TMCHHO_DATA", str(data_dir))
    job = {"clouds": "stanford", "model": "bunny", "kind": "pair", "seed": 0, "method": "pso"}
    job |= {"n_population": 30, "n_iterations": 3}
    real = registrations.run(job, NEVER)
    pair = load_pair("stanford", "bunny", "pair")
    keypoints = moved(pair.target_from_source, pair.source.keypoints)
    distances = cKDTree(pair.target.keypoints).query(keypoints)[0]
    assert real["true_rms"] == pytest.approx(np.sqrt((distances**2).mean()), rel=1e-9)
    # What is shown of such runs, all cells having the same result.
    runs = [Run({**other, "clouds": "stanford"}, real) for other in registrations.jobs(Settings(runs=2))]
    rows = {(row["kind"], row["model"], row["algorithm"]): row for row in table4.rows(runs)}
    assert rows["two scans", "bunny", "TMCHHO"]["printed_ave"] == 1.46e-2
    fine = {(row["kind"], row["model"], row["method"]): row for row in table5.rows(runs)}
    assert fine["two scans", "armadillo", "TMCHHO + ICP"]["printed"] == 1.34e-6
    assert fine["two scans", "armadillo", "robust mode"]["printed"] is None
    assert "SIMULATED" not in table4.clouds_of(runs)


@pytest.fixture(scope="module")
def copy() -> Pair:
    return load_pair("simulated", "bunny", "copy")


def test_a_search_gets_the_keypoints_as_they_are(copy: Pair) -> None:
    job = {"method": "pso", "seed": 4, "n_population": 30, "n_iterations": 5}
    away = random_pose(np.random.default_rng(1), copy.diagonal)
    source = moved(away, copy.source.keypoints)
    found = registrations.search(source, copy.target.keypoints, job, NEVER)
    stage = next(record for record in found.stages if record.name == "coarse")
    assert (stage.n_source_in, stage.n_target_in) == (len(source), len(copy.target.keypoints))
    placed = moved(found.candidates[0].transformation, source)
    distances = cKDTree(copy.target.keypoints).query(placed)[0]
    assert -found.candidates[0].score == pytest.approx(np.sqrt((distances**2).mean()), rel=1e-9)
    assert found.config["paper"]["method"] == "pso"


def test_errors_are_measured_from_the_known_pose(copy: Pair) -> None:
    rng = np.random.default_rng(7)
    away = random_pose(rng, copy.diagonal)
    source = moved(away, copy.source.points)
    wanted = invert(away)
    off = np.eye(4)
    off[:3, :3] = Rotation.from_rotvec([0.0, 0.0, np.radians(3.0)]).as_matrix()
    middle = moved(wanted, (source.min(axis=0) + source.max(axis=0))[None] / 2)[0]
    off[:3, 3] = middle - off[:3, :3] @ middle + [0.0, 0.004, 0.003]
    rotation_deg, shift = registrations.pose_error(off @ wanted, wanted, source)
    assert rotation_deg == pytest.approx(3.0)
    assert shift == pytest.approx(0.005)


def test_a_copy_is_brought_back_to_the_last_bits(copy: Pair) -> None:
    away = random_pose(np.random.default_rng(2), copy.diagonal)
    turn = np.eye(4)
    turn[:3, :3] = Rotation.from_rotvec([0.02, 0.0, 0.05]).as_matrix()
    # Nearly home: ICP has to do the rest.
    result = registrations.bring_back(copy, turn, {"method": "icp", "seed": 0}, NEVER)
    assert result["rotation_deg"] > 1 > 1e-6 > result["fine_rotation_deg"]
    assert result["fine_rms"] < 1e-9 < VOXEL_SIZE
    assert np.abs(np.array(result["pose"]) - np.eye(4)).max() < 1e-9
    assert not np.allclose(away, np.eye(4))


def test_the_interval_of_a_share_is_that_of_scipy() -> None:
    from scipy.stats import binomtest

    for n_right, n in ((0, 10), (3, 10), (20, 20)):
        wanted = binomtest(n_right, n).proportion_ci(method="wilson")
        assert success.wilson(n_right, n) == pytest.approx((wanted.low, wanted.high), abs=1e-12)


def test_the_dam_site_has_its_tables_and_pictures(tmp_path: Path) -> None:
    names = ("table6", "table7", "figure14")
    arguments = ("--runs", 1, "--iterations", 2, "--points", 150_000)
    assert run_paper(*names, *arguments, "-o", tmp_path).exit_code == 0
    page = (tmp_path / "paper.html").read_text(encoding="utf-8")
    assert "A SIMULATED dam site stands in for them" in page
    for name in ("figure14", "figure16", "figure17"):
        assert (tmp_path / f"{name}.png").read_bytes().startswith(b"\x89PNG")
    counts = {row["survey"]: row for row in rows_of(tmp_path / "table6.csv")}
    assert float(counts["3D laser scanning"]["printed_before"]) == 303_919
    assert counts["UAV tilt photography"]["before_site"] == "150000"
    areas = rows_of(tmp_path / "table7.csv")
    assert [row["area"] for row in areas] == ["1", "2", "3", "4", "5"]
    assert float(areas[0]["printed_avg"]) == 0.0311

    # Area 3 at the true pose, measured by scipy.
    pair = site.survey(0, 150_000)
    scanned, flown = (c.xyz[tmchho.remove_outliers(c).indices] for c in (pair.target, pair.source))
    inside = scanned[(np.abs(scanned[:, :2] - site.AREAS[3]) <= site.AREA_M / 2).all(axis=1)]
    distances = cKDTree(flown).query(inside)[0]
    assert int(areas[2]["n_points"]) == len(inside)
    assert float(areas[2]["true_avg"]) == pytest.approx(distances.mean(), rel=1e-9)
    histogram = [int(row["points"]) for row in rows_of(tmp_path / "figure17.csv") if row["area"] == "3"]
    assert len(histogram) == site.N_BINS
    assert sum(histogram) <= len(inside)
    assert [section.name for section in dam.SECTIONS] == list(names)
    assert (figure8.FIGURE8.name, figure8.FIGURE9.name) == ("figure8", "figure9")
