"""The searches from Python: the same as in Rust, stoppable, and honest about what they were given."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any, get_args

import numpy as np
import pytest
from scipy import optimize, stats

import tmchho
from tmchho import errors
from tmchho.config import Method

FUNCTIONS: dict[str, Callable[[Any], float]] = {
    "f1": lambda x: (x**2).sum(),
    "f2": lambda x: np.abs(x).sum() + np.abs(x).prod(),
    "f3": lambda x: (np.cumsum(x) ** 2).sum(),
    "f4": lambda x: np.abs(x).max(),
    "f5": lambda x: (x**2 - 10 * np.cos(2 * np.pi * x) + 10).sum(),
    "f6": lambda x: (
        -20 * np.exp(-0.2 * np.sqrt((x**2).mean())) - np.exp(np.cos(2 * np.pi * x).mean()) + 20 + np.e
    ),
    "f7": lambda x: (x**2).sum() / 4000 - np.cos(x / np.sqrt(np.arange(1, len(x) + 1))).prod() + 1,
}
BOX = [(-5.0, 10.0)] * 4
METHODS = get_args(Method)


def bowl(x: Any) -> float:
    return float(((x - 1.0) ** 2).sum())


# ---- the functions of Table 1


def test_the_seven_functions_are_those_of_table_1() -> None:
    rng = np.random.default_rng(0)
    found = {function.name: function for function in tmchho.benchmark_functions()}
    assert list(found) == list(FUNCTIONS)
    assert [function.range for function in found.values()] == [100, 10, 100, 100, 5.12, 32, 600]
    for name, function in found.items():
        for dimension in (1, 2, 10, 50):
            x = rng.uniform(-function.range, function.range, dimension)
            assert tmchho.benchmark_value(name, x) == pytest.approx(FUNCTIONS[name](x), rel=1e-9, abs=1e-9)
        assert tmchho.benchmark_value(name, np.zeros(10)) == pytest.approx(function.minimum, abs=1e-14)


@pytest.mark.parametrize("name", FUNCTIONS)
@pytest.mark.parametrize("method", METHODS)
def test_a_callable_is_searched_exactly_as_the_built_in(name: str, method: Any) -> None:
    half = next(function.range for function in tmchho.benchmark_functions() if function.name == name)
    settings: dict[str, Any] = {"method": method, "population_size": 8, "n_iterations": 12, "seed": 6}
    built_in = tmchho.minimize(name, dimension=5, **settings)
    called = tmchho.minimize(lambda x: tmchho.benchmark_value(name, x), [(-half, half)] * 5, **settings)
    np.testing.assert_array_equal(called.x, built_in.x)
    np.testing.assert_array_equal(called.history, built_in.history)
    many = tmchho.minimize(
        tmchho.BenchmarkProblem(name, 5).__call__, [(-half, half)] * 5, vectorized=True, **settings
    )
    np.testing.assert_array_equal(many.history, built_in.history)
    assert (called.nfev, called.nit, called.status) == (built_in.nfev, built_in.nit, built_in.status)


def test_numpy_and_built_in_agree_in_distribution() -> None:
    """The last bits of numpy's sum differ, and with them single runs; the results of many do not."""
    runs = {"population_size": 10, "n_iterations": 15}
    ours = [tmchho.minimize("f1", dimension=6, seed=seed, **runs).fun for seed in range(60)]
    numpys = [
        tmchho.minimize(FUNCTIONS["f1"], [(-100, 100)] * 6, seed=1000 + seed, **runs).fun
        for seed in range(60)
    ]
    assert stats.ks_2samp(np.log(ours), np.log(numpys)).pvalue > 1e-3


# ---- the result


def test_the_result_adds_up() -> None:
    values: list[float] = []

    def noted(x: Any) -> float:
        values.append(bowl(x))
        return values[-1]

    result = tmchho.minimize(noted, BOX, population_size=9, n_iterations=30, seed=2)
    assert result.nfev == len(values)
    assert result.fun == min(values) == bowl(result.x) == result.history[-1]
    assert result.nit == len(result.history) == 30
    assert (np.diff(result.history) <= 0).all()
    assert (result.success, result.status, result.n_nan) == (True, 0, 0)
    assert result.message == "all iterations are done"
    assert all(low <= x <= high for x, (low, high) in zip(result.x, BOX, strict=True))
    with pytest.raises(ValueError, match="read-only"):
        result.x[0] = 3.0


def test_the_seed_decides_everything() -> None:
    results = [tmchho.minimize(bowl, BOX, n_iterations=20, seed=seed) for seed in (5, 5, 6)]
    np.testing.assert_array_equal(results[0].x, results[1].x)
    np.testing.assert_array_equal(results[0].history, results[1].history)
    assert not np.array_equal(results[0].history, results[2].history)


def test_the_defaults_are_those_of_the_core() -> None:
    hawks = tmchho.default_config()["paper"]["hawks"]
    given = {key: hawks[key] for key in ("n_iterations", "levy_factor", "mutation_variance")}
    given["population_size"] = hawks["n_hawks"]
    default, explicit = tmchho.minimize("f3", dimension=3), tmchho.minimize("f3", dimension=3, **given)
    np.testing.assert_array_equal(default.history, explicit.history)
    assert default.nit == hawks["n_iterations"]


def test_each_improvement_can_be_had_alone() -> None:
    both = {"chaotic_start": True, "trigonometric_mutation": True}
    runs: dict[str, Any] = {"dimension": 4, "n_iterations": 10, "seed": 3}
    np.testing.assert_array_equal(
        tmchho.minimize("f5", method="hho", **both, **runs).history, tmchho.minimize("f5", **runs).history
    )
    starts = [
        tmchho.minimize("f5", chaotic_start=chaotic, trigonometric_mutation=False, **runs).history[0]
        for chaotic in (True, False)
    ]
    assert starts[0] != starts[1]


def test_the_first_population_is_the_chaotic_one() -> None:
    seen: list[Any] = []
    tmchho.minimize(lambda x: seen.append(x) or bowl(x), BOX, population_size=6, n_iterations=1, seed=8)
    assert np.shape(seen) == (6, 4)
    fractions = (np.array(seen).ravel() + 5) / 15
    np.testing.assert_allclose(fractions, tmchho.chaotic_sequence(24, seed=8), rtol=1e-12)


def test_points_to_start_from_are_clipped_and_tried() -> None:
    seen: list[Any] = []
    tmchho.minimize(
        lambda x: seen.append(x.tolist()) or bowl(x),
        BOX,
        x0=[[1, 2, 3, 4], [99, -99, 0, 0]],
        population_size=6,
        n_iterations=1,
    )
    assert seen[-2:] == [[1, 2, 3, 4], [10, -5, 0, 0]]
    assert tmchho.minimize(bowl, BOX, x0=[1.0] * 4, n_iterations=1).fun == 0.0


def test_bounds_of_scipy_and_fixed_coordinates() -> None:
    pairs = tmchho.minimize(bowl, [(0, 2), (3, 3)], n_iterations=20)
    scipys = tmchho.minimize(bowl, optimize.Bounds([0, 3], [2, 3]), n_iterations=20)
    np.testing.assert_array_equal(pairs.x, scipys.x)
    assert pairs.x[1] == 3.0


def test_calls_are_limited() -> None:
    result = tmchho.minimize(bowl, BOX, max_evaluations=77)
    assert (result.nfev, result.status, result.success) == (77, 1, True)


# ---- values that are no numbers


def test_nan_counts_as_infinite_and_is_counted() -> None:
    def half_nan(x: Any) -> float:
        return float("nan") if x[0] < 0 else bowl(x)

    seen: list[float] = []
    result = tmchho.minimize(lambda x: seen.append(half_nan(x)) or seen[-1], BOX, n_iterations=30)
    assert result.n_nan == np.isnan(seen).sum() > 0
    assert np.isfinite(result.fun)
    never = tmchho.minimize(lambda x: float("nan"), BOX, population_size=5, n_iterations=4)
    assert (never.fun, never.success, never.n_nan) == (np.inf, False, never.nfev)


@pytest.mark.parametrize("value", [None, "high", [1.0, 2.0], 1j])
def test_a_value_of_another_kind_is_refused(value: Any) -> None:
    with pytest.raises(errors.InvalidArgumentError, match="fun must return a number"):
        tmchho.minimize(lambda x: value, BOX)


@pytest.mark.parametrize("value", [np.float32(2), np.array(2.0), 2, True])
def test_what_is_almost_a_float_will_do(value: Any) -> None:
    assert tmchho.minimize(lambda x: value, BOX, population_size=4, n_iterations=2).fun == float(value)


# ---- callbacks and exceptions


def test_the_callback_hears_of_every_iteration_and_stops() -> None:
    heard: list[tuple[Any, float]] = []

    def listen(x: Any, value: float) -> bool:
        heard.append((x, value))
        return len(heard) == 7

    for fun in (bowl, "f1"):
        heard.clear()
        result = tmchho.minimize(fun, BOX, callback=listen, seed=4)
        assert (result.nit, result.status, result.success) == (7, 2, False)
        assert [value for _, value in heard] == result.history.tolist()
        np.testing.assert_array_equal(heard[-1][0], result.x)


def test_python_is_called_by_the_calling_thread_only() -> None:
    threads = set()

    def note(*_: Any) -> float:
        threads.add(threading.get_ident())
        with pytest.raises(FloatingPointError):  # what numpy was told outside holds inside
            np.float64(1.0) / np.float64(0.0)
        return 0.0

    with np.errstate(divide="raise"):
        tmchho.minimize(note, BOX, callback=note, population_size=4, n_iterations=3)
    assert threads == {threading.get_ident()}


@pytest.mark.parametrize("error", [ZeroDivisionError("mine"), KeyboardInterrupt(), StopIteration()])
def test_exceptions_come_out_unchanged(error: BaseException) -> None:
    calls = 0

    def fail(*_: Any) -> float:
        nonlocal calls
        calls += 1
        if calls == 5:
            raise error
        return 1.0

    for arguments in ({"fun": fail}, {"fun": bowl, "callback": fail}):
        calls = 0
        with pytest.raises(type(error)) as raised:
            tmchho.minimize(bounds=BOX, **arguments)  # type: ignore[arg-type]
        assert raised.value is error
        assert calls == 5


def test_a_search_within_a_search() -> None:
    def outer(x: Any) -> float:
        return tmchho.minimize(lambda y: bowl(y) + x[0] ** 2, [(0, 2)], population_size=4, n_iterations=3).fun

    assert tmchho.minimize(outer, [(-1, 1)], population_size=4, n_iterations=3).fun >= 0.0


# ---- arguments


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        ({"fun": "f8", "bounds": None, "dimension": 2}, "f8"),
        ({"fun": "f8", "bounds": BOX}, "f8"),
        ({"fun": 3}, "fun must be callable"),
        ({"fun": "f1", "bounds": None}, "bounds must be given"),
        ({"bounds": None}, "bounds must be given"),
        ({"bounds": None, "dimension": 3}, "bounds must be given"),
        ({"bounds": [(0, 1)], "dimension": 3}, "dimension = 3"),
        ({"bounds": []}, "bounds"),
        ({"bounds": [(1, 0)]}, "bounds"),
        ({"bounds": [(0, np.inf)]}, "bounds"),
        ({"bounds": [(0, 1, 2)]}, "bounds"),
        ({"bounds": "box"}, "bounds"),
        ({"method": "gwo"}, "method"),
        ({"method": "pso", "chaotic_start": True}, "chaotic_start is a setting of hho"),
        ({"method": "woa", "levy_factor": 1.0}, "levy_factor is a setting of hho"),
        ({"n_threads": 2}, "n_threads"),
        ({"max_seconds": -1}, "max_seconds"),
        ({"mutation_reading": "never"}, "never"),
        ({"population_size": 3}, "population_size must be between 4"),
        ({"population_size": 10**12}, "population_size"),
        ({"n_iterations": 2.5}, "n_iterations"),
        ({"n_iterations": 10**15}, "n_iterations"),
        ({"max_evaluations": 0}, "max_evaluations"),
        ({"levy_factor": -1.0}, "levy_factor"),
        ({"mutation_variance": float("nan")}, "mutation_variance"),
        ({"seed": -1}, "seed"),
        ({"seed": None}, "seed"),
        ({"callback": 3}, "callback"),
        ({"x0": [1.0, 2.0]}, "x0"),
        ({"x0": [[np.nan] * 4]}, "finite"),
        ({"x0": [[1.0] * 4] * 5, "population_size": 4}, "start must"),
    ],
)
def test_a_wrong_argument_is_refused_by_its_name(arguments: dict[str, Any], problem: str) -> None:
    with pytest.raises(errors.InvalidArgumentError, match=problem) as raised:
        tmchho.minimize(**{"fun": bowl, "bounds": BOX, **arguments})
    assert isinstance(raised.value, ValueError)


def test_a_population_that_does_not_fit_into_memory_is_refused() -> None:
    with pytest.raises(errors.BudgetError, match="population_size"):
        tmchho.minimize("f1", dimension=10**6, population_size=10**6)
