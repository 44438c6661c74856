"""Fine registration against scipy's least squares of the same objective."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scenes import field, moved
from scipy.optimize import least_squares
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

import tmchho
from tmchho import ControlPoint, PosePrior, errors


def motion(rotation_rad: tuple[float, float, float], shift: tuple[float, float, float]) -> Any:
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_rotvec(rotation_rad).as_matrix()
    matrix[:3, 3] = shift
    return matrix


def test_control_points_alone_are_weighed_like_scipy_weighs_them() -> None:
    # The clouds are a flat floor: x, y and the turn about z are the control points' alone.
    rng = np.random.default_rng(1)
    source, target = (
        np.column_stack([rng.uniform(-20, 20, (2000, 2)), rng.normal(0, 0.005, 2000)]) for _ in range(2)
    )
    places = rng.uniform(-15, 15, (5, 3))
    sigmas = rng.uniform(0.01, 0.05, 5)
    measured = places + [0.3, -0.2, 0.0] + rng.normal(0, 1, (5, 3)) * sigmas[:, None] * [1, 1, 0]
    points = [ControlPoint(*pair) for pair in zip(places, measured, sigmas, strict=True)]
    found = tmchho.icp(
        source, target, dof=4, method="point_to_plane", max_distance=1.0, control_points=points
    )

    def misfit(parameters: Any) -> Any:
        turn = Rotation.from_rotvec([0, 0, parameters[0]])
        off = turn.apply(places)[:, :2] + parameters[1:] - measured[:, :2]
        return (off / sigmas[:, None]).ravel()

    best = least_squares(misfit, [0.0, 0.3, -0.2], xtol=1e-12, ftol=1e-12)
    wanted = motion((0, 0, best.x[0]), (best.x[1], best.x[2], 0.0))
    assert np.abs(moved(found.transformation, places) - moved(wanted, places))[:, :2].max() < 2e-3
    assert found.registration_error is not None
    assert 0.005 < found.registration_error < 0.1


@pytest.mark.parametrize("dof", [6, 7])
def test_plain_point_to_plane_comes_to_rest_where_scipy_does(dof: Any) -> None:
    rng = np.random.default_rng(2)
    target = field(3000, 0, 30)
    source = moved(motion((0.004, -0.003, 0.005), (0.05, -0.04, 0.03)), target)
    source = source + rng.normal(0, 0.01, source.shape)
    settings: Any = {"kept_share": 1.0, "kernel": "least_squares", "max_distance": 1.0}
    found = tmchho.icp(source, target, dof=dof, method="point_to_plane", relative_tolerance=0.0, **settings)
    normals = [tmchho.estimate_normals(points)[0] for points in (source, target)]
    rows = cKDTree(target).query(moved(found.transformation, source))[1]

    def misfit(parameters: Any) -> Any:
        turn = Rotation.from_rotvec(parameters[:3])
        scale = np.exp(parameters[6]) if dof == 7 else 1.0
        start = moved(found.transformation, source)
        places = scale * turn.apply(start - start.mean(axis=0)) + start.mean(axis=0) + parameters[3:6]
        turned = normals[0] @ found.transformation[:3, :3].T / found.scale
        signs = np.sign((turned * normals[1][rows]).sum(axis=1))
        both = turned * signs[:, None] + normals[1][rows]
        both /= np.linalg.norm(both, axis=1)[:, None]
        return ((places - target[rows]) * both).sum(axis=1)

    best = least_squares(misfit, np.zeros(dof), xtol=1e-14, ftol=1e-14)
    assert np.abs(best.x[3:6]).max() < 2e-3
    assert found.converged
    assert (found.scale_standard_error is None) == (dof == 6)
    assert abs(found.scale - 1.0) < 1e-3


def test_a_prior_holds_what_it_knows() -> None:
    points, others = (field(2000, 0, 30, survey=survey) for survey in (1, 2))
    prior = PosePrior(motion((0, 0, 0), (0.3, 0.0, 0.0)), rotation_rad=[1e-6] * 3, translation_m=[1e-6] * 3)
    found = tmchho.icp(points, others, prior=prior, method="plane_to_plane", max_distance=3.0)
    assert np.abs(found.transformation[:3, 3] - [0.3, 0, 0]).max() < 1e-3


def test_a_scale_is_found() -> None:
    points = field(3000, 0, 30)
    middle = points.mean(axis=0)
    found = tmchho.icp((points - middle) / 1.01 + middle, points, dof=7, method="point_to_plane")
    assert found.scale == pytest.approx(1.01, abs=1e-6)
    assert np.linalg.det(found.transformation[:3, :3]) == pytest.approx(1.01**3, abs=1e-5)


@pytest.mark.parametrize(
    ("settings", "name"),
    [
        ({"dof": 5}, "dof"),
        ({"kernel": "huber"}, "kernel"),
        ({"prior": np.eye(4)}, "prior"),
        ({"prior": PosePrior(np.eye(4))}, "prior"),
        ({"prior": PosePrior(np.eye(3), rotation_rad=[1, 1, 1])}, "prior.target_from_source"),
        ({"control_points": [ControlPoint([0, 0, 0], [0, 0, 0], 0.0)]}, r"control_points\[0\].sigma_m"),
        ({"control_points": [ControlPoint([0, 0], [0, 0, 0], 1.0)]}, r"control_points\[0\].source"),
        ({"control_points": [(1, 2)]}, r"control_points\[0\]"),
    ],
)
def test_what_cannot_be_used_is_named(settings: Any, name: str) -> None:
    points = field(200, 0, 30)
    with pytest.raises(errors.InvalidArgumentError, match=name):
        tmchho.icp(points, points, **settings)
