"""Asking and telling, vectorised functions, time, threads, and the functions of Table 1 moved and turned."""

from __future__ import annotations

import subprocess
import sys
import textwrap
from typing import Any, get_args

import numpy as np
import pytest
from scipy import optimize

import tmchho
from tmchho import _core, errors
from tmchho.config import Method

METHODS = get_args(Method)
BOX = [(-5.0, 10.0)] * 4


def bowl(x: Any) -> Any:
    return ((x - 1.0) ** 2).sum(axis=-1)


def test_the_methods_are_those_of_the_core() -> None:
    assert list(METHODS) == _core.methods()


# ---- ask and tell


@pytest.mark.parametrize("method", METHODS)
def test_telling_is_the_same_search_as_minimize(method: Any) -> None:
    settings: dict[str, Any] = {"method": method, "population_size": 8, "n_iterations": 12, "seed": 4}
    search = tmchho.Optimizer(BOX, **settings)
    n_told = 0
    while not search.done:
        points = search.ask()
        assert points.shape == (len(points), 4)
        np.testing.assert_array_equal(points, search.ask())  # until they are told
        search.tell(bowl(points))
        n_told += len(points)
    assert search.ask().shape == (0, 4)
    expected = tmchho.minimize(bowl, BOX, vectorized=True, **settings)
    np.testing.assert_array_equal(search.result.x, expected.x)
    np.testing.assert_array_equal(search.result.history, expected.history)
    assert search.result.nfev == expected.nfev == n_told
    assert search.result.message == "all iterations are done"


def test_a_search_that_is_not_over_says_so() -> None:
    search = tmchho.Optimizer(BOX, population_size=5)
    assert (search.result.status, search.result.success, search.result.nit) == (-1, False, 0)
    assert search.result.fun == np.inf
    search.tell([4.0, np.nan, 2.0, 3.0, 5.0])
    result = search.result
    assert (result.fun, result.nit, result.nfev, result.n_nan) == (2.0, 1, 5, 1)
    assert result.message.startswith("not over")


@pytest.mark.parametrize("values", [[1.0] * 4, [1.0] * 6, [[1.0] * 5], 3.0, ["a"] * 5])
def test_values_that_do_not_fit_are_refused_and_change_nothing(values: Any) -> None:
    search = tmchho.Optimizer(BOX, population_size=5)
    with pytest.raises(errors.InvalidArgumentError, match="values must"):
        search.tell(values)
    assert search.result.nfev == 0
    search.tell([1.0] * 5)


def test_the_callback_of_tell_stops_the_search() -> None:
    search = tmchho.Optimizer(BOX, method="woa", population_size=5)
    heard = []
    search.tell(bowl(search.ask()), callback=lambda x, value: heard.append((x, value)))
    assert heard[0][1] == bowl(heard[0][0]) == search.result.fun
    search.tell(bowl(search.ask()), callback=lambda x, value: True)
    assert search.done
    assert search.result.status == 2
    broken = tmchho.Optimizer(BOX, population_size=5)
    error = ZeroDivisionError("mine")

    def fail(*_: Any) -> None:
        raise error

    with pytest.raises(ZeroDivisionError) as raised:
        broken.tell([1.0] * 5, callback=fail)
    assert raised.value is error


# ---- vectorised functions


@pytest.mark.parametrize("method", METHODS)
def test_a_vectorised_function_gets_batches(method: Any) -> None:
    sizes: list[int] = []

    def noted(points: Any) -> Any:
        sizes.append(len(points))
        return bowl(points)

    result = tmchho.minimize(noted, BOX, method=method, population_size=9, n_iterations=10, vectorized=True)
    assert sum(sizes) == result.nfev
    assert sizes[0] == 9
    assert min(sizes) >= 1
    if method in ("pso", "woa"):
        assert sizes == [9] * 10


@pytest.mark.parametrize("answer", [3.0, [1.0, 2.0], np.ones((30, 1)), None, "many"])
def test_a_vectorised_function_must_return_one_number_each(answer: Any) -> None:
    with pytest.raises(errors.InvalidArgumentError, match="fun must return"):
        tmchho.minimize(lambda points: answer, BOX, vectorized=True)


# ---- time and interruption


def test_time_is_a_limit() -> None:
    for fun in (bowl, "f1"):
        result = tmchho.minimize(fun, BOX, n_iterations=10**7, max_seconds=0.05)
        assert (result.status, result.message, result.success) == (3, "time is up", True)
        assert result.nit >= 1


@pytest.mark.parametrize("fun", ["'f5'", "lambda x: float(x @ x)"])
def test_ctrl_c_ends_a_search(fun: str) -> None:
    program = f"""
        import _thread, threading, tmchho
        threading.Timer(0.5, _thread.interrupt_main).start()
        try:
            tmchho.minimize({fun}, [(-1.0, 2.0)] * 20, n_iterations=10**7)
        except KeyboardInterrupt:
            print("interrupted")
    """
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(program)], capture_output=True, text=True, timeout=60
    )
    assert done.stdout == "interrupted\n", done.stderr


def test_threads_change_no_bit() -> None:
    problem = tmchho.BenchmarkProblem("f5", 300, rotation_seed=3)  # dear enough to be shared
    for method in METHODS:
        found = [
            tmchho.minimize(problem, method=method, n_iterations=4, n_threads=n_threads)
            for n_threads in (1, 2, 4)
        ]
        for other in found[1:]:
            np.testing.assert_array_equal(other.x, found[0].x)
            np.testing.assert_array_equal(other.history, found[0].history)
            assert other.nfev == found[0].nfev


# ---- the functions of Table 1, moved and turned


def test_a_moved_function_is_the_function_moved() -> None:
    rng = np.random.default_rng(5)
    for function in tmchho.benchmark_functions():
        shift = rng.uniform(-0.5, 0.5, 6) * function.range
        problem = tmchho.BenchmarkProblem(function.name, 6, shift=shift)
        x = rng.uniform(-function.range, function.range, (9, 6))
        expected = [tmchho.benchmark_value(function.name, point - shift) for point in x]
        np.testing.assert_allclose(problem(x), expected, rtol=1e-12)
        assert problem(x[3]) == problem(x)[3]  # type: ignore[index]
        np.testing.assert_array_equal(problem.x_min, shift)
        np.testing.assert_array_equal(problem.bounds, [[-function.range, function.range]] * 6)
        assert problem(shift) == pytest.approx(function.minimum, abs=1e-12)


def test_a_turned_function_is_the_function_of_turned_points() -> None:
    """The matrix is not shown, but f1 measures lengths, and f2 of its columns adds them up."""
    shift = np.array([1.0, -2.0, 0.5])
    x = np.random.default_rng(1).uniform(-3, 3, (20, 3))
    sphere = tmchho.BenchmarkProblem("f1", 3, shift=shift, rotation_seed=7)
    np.testing.assert_allclose(sphere(x), ((x - shift) ** 2).sum(axis=1), rtol=1e-13)
    turned = tmchho.BenchmarkProblem("f5", 3, rotation_seed=7)
    assert np.abs(turned(x) - tmchho.BenchmarkProblem("f5", 3)(x)).min() > 1e-3
    np.testing.assert_array_equal(turned(x), tmchho.BenchmarkProblem("f5", 3, rotation_seed=7)(x))
    assert (turned(x) != tmchho.BenchmarkProblem("f5", 3, rotation_seed=8)(x)).all()
    assert turned(np.zeros(3)) == 0.0


def test_a_problem_is_searched_in_rust_and_by_others() -> None:
    shift = np.linspace(-40, 60, 5)
    problem = tmchho.BenchmarkProblem("f1", 5, shift=shift)
    ours = tmchho.minimize(problem, method="pso", n_iterations=150)
    assert ours.fun == problem(ours.x) < 1e-3
    np.testing.assert_allclose(ours.x, shift, atol=0.05)
    called = tmchho.minimize(problem.__call__, problem.bounds, method="pso", n_iterations=150)
    np.testing.assert_array_equal(called.history, ours.history)
    theirs = optimize.minimize(problem, np.zeros(5), bounds=problem.bounds)
    np.testing.assert_allclose(theirs.x, shift, atol=1e-3)
    smaller = tmchho.minimize(problem, [(50, 60)] * 5, n_iterations=10)
    assert (smaller.x >= 50).all()


def test_a_problem_shows_itself() -> None:
    assert repr(tmchho.BenchmarkProblem("f2", 3)) == "BenchmarkProblem('f2', 3)"
    shown = repr(tmchho.BenchmarkProblem("f2", 2, shift=[1, 0], rotation_seed=4))
    assert shown == "BenchmarkProblem('f2', 2, shift=[1.0, 0.0], rotation_seed=4)"
    with pytest.raises(ValueError, match="read-only"):
        tmchho.BenchmarkProblem("f2", 3).bounds[0, 0] = 1


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        ({"name": "f8"}, "one of f1, f2"),
        ({"name": 5}, "one of f1, f2"),
        ({"dimension": 0}, "dimension"),
        ({"dimension": 2.0}, "dimension"),
        ({"shift": [1.0]}, "shift must have shape"),
        ({"shift": [1.0, np.nan, 0.0]}, "shift"),
        ({"rotation_seed": -1}, "seed"),
    ],
)
def test_a_wrong_problem_is_refused(arguments: dict[str, Any], problem: str) -> None:
    with pytest.raises(errors.InvalidArgumentError, match=problem):
        tmchho.BenchmarkProblem(**{"name": "f1", "dimension": 3, **arguments})


def test_a_problem_of_another_dimension_is_refused() -> None:
    problem = tmchho.BenchmarkProblem("f1", 3)
    with pytest.raises(errors.InvalidArgumentError, match="dimension = 3 does not agree with 4 pairs"):
        tmchho.minimize(problem, BOX)
    with pytest.raises(errors.InvalidArgumentError, match="x must have shape"):
        problem([1.0, 2.0])
