"""Loops and the adjustment, against closed forms, numpy and chance."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tmchho.network.adjust import (
    PlaceObservation,
    PoseObservation,
    Unknowns,
    _Problem,
    adjust,
    standard_errors,
)
from tmchho.network.links import Link
from tmchho.network.loops import Bodies, check_loops, components, confirming_links, placed_by
from tmchho.network.poses import applied, inverse, moved_by, scale_of

Array = np.ndarray
VOXEL = 0.1


def pose(turn: list[float], shift: list[float], scale: float = 1.0) -> Array:
    made = np.eye(4)
    made[:3, :3] = scale * Rotation.from_rotvec(turn).as_matrix()
    made[:3, 3] = shift
    return made


# A square of ten metres, every station turned differently.
SQUARE = [
    pose([0.0, 0.0, 0.3], [0.0, 0.0, 0.0]),
    pose([0.5, 0.0, 2.0], [10.0, 0.0, 1.0]),
    pose([0.0, -1.0, 0.0], [10.0, 10.0, 0.0]),
    pose([2.0, 1.0, 0.5], [0.0, 10.0, -1.0]),
]
MIDDLES = np.array([[1.0, 0.0, 0.5], [0.0, 1.0, 0.0], [0.0, 0.0, 2.0], [-1.0, 0.0, 0.0]])
BODIES = Bodies(MIDDLES, np.full(4, 5.0), VOXEL)


def link(
    source: int, target: int, wrong: Array | None = None, *, ratio: float = 5.0, sigma: float = 0.01
) -> Link:
    exact = inverse(SQUARE[target]) @ SQUARE[source]
    information = np.diag([(5 / sigma) ** 2] * 3 + [sigma**-2] * 3 + [0.0])
    found = exact if wrong is None else wrong @ exact
    return Link(source, target, found, information, MIDDLES[target], "accepted", ratio, 0.5, {})


def test_a_square_whose_diagonals_are_known_tells_which_link_is_wrong() -> None:
    wrong = pose([0.0, 0.0, np.pi], [3.0, 0.0, 0.0])
    # The wrong one is by far the most certain of itself, as that of two equal piers is.
    links = [link(0, 1), link(1, 2), link(2, 3, wrong, ratio=100.0), link(3, 0), link(0, 2), link(1, 3)]
    checked = check_loops(links, 4, BODIES)
    assert list(checked.left_out) == [2]
    assert checked.kept == (0, 1, 3, 4, 5)
    assert not checked.left_out[2].is_closed
    assert {2} < set(checked.left_out[2].links)
    assert checked.n_open[2] == checked.n_loops[2] > 0
    placed = placed_by(links, checked.kept, 4, 0)
    for station, found in placed.items():
        np.testing.assert_allclose(found, inverse(SQUARE[0]) @ SQUARE[station], atol=1e-12)


def test_the_misclosure_of_a_loop_is_the_known_error() -> None:
    # A shift by 0.3 m moves every point by as much, whatever is turned on the way.
    links = [link(0, 1, pose([0, 0, 0], [0.0, 0.3, 0.0])), link(1, 2), link(0, 2)]
    loop = BODIES.loop(links, [(0, False), (1, False), (2, True)])
    assert loop.stations == (0, 1, 2)
    assert loop.misclosure_m == pytest.approx(0.3, abs=1e-12)
    assert loop.misclosure_rad == pytest.approx(0.0, abs=1e-7)
    assert loop.tolerance_m == pytest.approx(VOXEL * np.sqrt(3))


def test_of_one_open_loop_the_least_certain_link_is_left_out() -> None:
    wrong = pose([0.0, 0.0, 1.0], [0.0, 0.0, 0.0])
    links = [link(0, 1), link(1, 2, wrong, ratio=1.8), link(2, 0)]
    assert list(check_loops(links, 4, BODIES).left_out) == [1]


def test_a_link_whose_other_places_were_compared_is_believed_before_one_that_fits_well() -> None:
    wrong = pose([0.0, 0.0, 0.0], [8.0, 0.0, 0.0])
    links = [link(0, 1, ratio=100.0), link(1, 2, wrong, ratio=9.0), link(2, 0, ratio=1.4)]
    assert list(check_loops(links, 4, BODIES).left_out) == [2]
    links[2] = replace(links[2], is_only_place=True)
    checked = check_loops(links, 4, BODIES)
    assert list(checked.left_out) == [1]
    # All three have but this open loop to speak for them; another that closes settles it for its stations.
    assert checked.contradicted(links) == {1, 2}
    more = [*links, link(0, 3), link(3, 1)]
    assert check_loops(more, 4, BODIES).contradicted(more) == {2}


def test_two_doubtful_links_that_agree_overrule_one_that_alone_ties_a_station() -> None:
    wrong = pose([0.0, 0.0, 0.2], [8.0, 0.0, 0.0])
    links = [link(0, 1), link(1, 2), link(2, 0), link(3, 0, wrong, ratio=100.0)]
    checked = check_loops(links, 4, BODIES)
    assert not checked.left_out
    elsewhere = link(3, 2, pose([0.0, 0.0, 1.0], [1.0, 0.0, 0.0]))
    assert confirming_links(links, checked, [link(3, 1), elsewhere], 4, BODIES) == []
    doubtful = [link(3, 1), link(2, 3), link(0, 2, wrong)]
    confirming = confirming_links(links, checked, doubtful, 4, BODIES)
    assert confirming == doubtful[:2]
    assert list(check_loops([*links, *confirming], 4, BODIES).left_out) == [3]


def test_on_the_way_over_a_block_no_station_gets_its_scale() -> None:
    to_block = Link(1, 0, pose([0, 0, 0.1], [1, 2, 3], 0.5), np.eye(7), MIDDLES[0], "accepted", 5, 0.5, {})
    to_next = Link(0, 2, pose([0, 0, 0.1], [1, 2, 3], 2.1), np.eye(7), MIDDLES[2], "accepted", 5, 0.5, {})
    placed = placed_by([to_block, to_next], [0, 1], 3, 1, frozenset({0}))
    assert [scale_of(placed[k]) for k in range(3)] == pytest.approx([2.0, 1.0, 1.0])
    bare = placed_by([to_block, to_next], [0, 1], 3, 1)
    assert scale_of(bare[2]) == pytest.approx(2.0 / 2.1)
    np.testing.assert_allclose(placed[2][:3, 3], bare[2][:3, 3])


def test_true_links_are_all_kept_and_every_loop_of_a_basis_is_told() -> None:
    links = [link(0, 1), link(1, 2), link(2, 3), link(3, 0), link(0, 2)]
    checked = check_loops(links, 4, BODIES)
    assert checked.kept == tuple(range(5))
    # Links minus stations plus one.
    assert len(checked.loops) == 2
    assert all(loop.is_closed for loop in checked.loops)
    assert components(links[:1] + links[2:3], 4) == [[0, 1], [2, 3]]


def test_exact_links_are_met_exactly_from_a_poor_start() -> None:
    rng = np.random.default_rng(0)
    links = [link(0, 1), link(1, 2), link(2, 3), link(3, 0), link(0, 2)]
    start = {k: SQUARE[k] for k in range(4)}
    for k in (1, 2, 3):
        start[k] = moved_by(np.append(0.1 * rng.standard_normal(6), 0.0), SQUARE[k], MIDDLES[k])
    found = adjust(start, links, MIDDLES, Unknowns(range(4), {0}, set()))
    for k in range(4):
        np.testing.assert_allclose(found.poses[k], SQUARE[k], atol=1e-7)


def test_the_jacobian_is_that_of_finite_differences() -> None:
    rng = np.random.default_rng(3)
    poses = {k: moved_by(0.3 * rng.standard_normal(7), SQUARE[k], np.ones(3)) for k in range(4)}
    unknowns = Unknowns(range(4), {0}, {2})
    full = np.linalg.inv(np.cov(rng.standard_normal((7, 40))))
    links = [link(0, 1), link(1, 2), Link(2, 3, SQUARE[1], full, MIDDLES[3], "accepted", 2.0, 0.5, {})]
    places = [PlaceObservation(1, np.array([1.0, 2.0, 3.0]), np.zeros(3), np.array([0.1, 0.2, 0.3]))]
    known = [PoseObservation(3, SQUARE[3], np.array([0.5, 0.0, 0.0]), 0.01, 0.1)]
    problem = _Problem(links, MIDDLES, unknowns, places, known)

    def residuals(x: Array) -> Array:
        moved = {
            k: moved_by(unknowns.motion(x, k), found, applied(found, MIDDLES[k]))
            for k, found in poses.items()
        }
        return problem.residuals(moved)

    step = 1e-6
    wanted = np.column_stack(
        [(residuals(step * e) - residuals(-step * e)) / (2 * step) for e in np.eye(unknowns.n)]
    )
    found = problem.jacobian(poses).toarray()
    np.testing.assert_allclose(found, wanted, atol=1e-5 * np.abs(wanted).max())


def test_standard_errors_are_those_of_chance_and_of_the_dense_inverse() -> None:
    rng = np.random.default_rng(1)
    exact = [link(0, 1), link(1, 2), link(2, 3), link(3, 0), link(0, 2)]
    unknowns = Unknowns(range(4), {0}, set())
    start = dict(enumerate(SQUARE))
    moves = []
    for _ in range(40):
        noisy = []
        for one in exact:
            sigma = 1 / np.sqrt(np.diag(one.information)[:6])
            motion = np.append(sigma * rng.standard_normal(6), 0.0)
            turned = moved_by(motion, one.pose, one.middle)
            noisy.append(
                Link(one.source, one.target, turned, one.information, one.middle, "accepted", 5, 0.5, {})
            )
        found = adjust(start, noisy, MIDDLES, unknowns)
        moves.append(
            np.concatenate(
                [applied(found.poses[k], MIDDLES[k]) - applied(SQUARE[k], MIDDLES[k]) for k in (1, 2, 3)]
            )
        )
    found = adjust(start, exact, MIDDLES, unknowns)
    errors = standard_errors(found.normal, unknowns)
    dense = np.linalg.inv(found.normal.toarray())
    for k in (1, 2, 3):
        columns = unknowns.columns(k)
        np.testing.assert_allclose(errors[k], dense[np.ix_(columns, columns)], rtol=1e-6, atol=1e-14)
    expected = np.sqrt(np.concatenate([np.diag(errors[k])[3:6] for k in (1, 2, 3)]))
    # 40 runs know a standard deviation to 11 %; Cauchy's loss costs a little.
    assert np.std(moves, axis=0) / expected == pytest.approx(np.ones(9), abs=0.4)
    assert np.mean(np.std(moves, axis=0) / expected) == pytest.approx(1.0, abs=0.12)


def test_a_wrong_link_hardly_moves_the_robust_adjustment() -> None:
    exact = [link(0, 1), link(1, 2), link(2, 3), link(3, 0), link(0, 2), link(1, 3)]
    wrong = link(3, 1, pose([0.0, 0.0, 0.5], [1.0, 0.0, 0.0]))
    found = adjust(dict(enumerate(SQUARE)), [*exact, wrong], MIDDLES, Unknowns(range(4), {0}, set()))
    for k in range(4):
        assert np.linalg.norm(applied(found.poses[k], MIDDLES[k]) - applied(SQUARE[k], MIDDLES[k])) < 0.01


def test_observed_places_give_frame_and_scale() -> None:
    truth = dict(enumerate(SQUARE))
    truth[3] = SQUARE[3] @ pose([0, 0, 0], [0, 0, 0], 1.7)
    # Station 3 is a block: what is one unit long in it is 1.7 long in the world.
    information = np.diag([250_000.0] * 3 + [10_000.0] * 3 + [1e6])
    block = Link(3, 0, inverse(SQUARE[0]) @ truth[3], information, MIDDLES[0], "accepted", 5.0, 0.5, {})
    links = [link(0, 1), link(1, 2), block]
    unknowns = Unknowns(range(4), set(), {3})
    places = [
        PlaceObservation(k, np.zeros(3), applied(truth[k], np.zeros(3)), np.full(3, 0.01)) for k in range(4)
    ]
    rng = np.random.default_rng(2)
    start = {
        k: moved_by(np.append(0.05 * rng.standard_normal(6), 0.1 * (k == 3)), one, np.zeros(3))
        for k, one in truth.items()
    }
    found = adjust(start, links, MIDDLES, unknowns, places)
    for k in range(4):
        np.testing.assert_allclose(found.poses[k], truth[k], atol=1e-6)
