"""The doorway between Python and Rust: threads, signals, callbacks, and what must not get through it."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from scenes import QUICK, Floats, field, pair

import tmchho
from tmchho import ProgressEvent, _core, errors

# Of clouds that do not belong together no pose stands out: all rounds are run, which takes minutes.
ENDLESS = {"coarse": {"rotations_per_round": [500] * 200, "n_verified": 8}}


@pytest.fixture(scope="module")
def clouds() -> tuple[Floats, Floats]:
    return pair()


@pytest.fixture(scope="module")
def strangers() -> tuple[Floats, Floats]:
    return field(3000, 0, 50, scene=1), field(3000, 8, 60, scene=2)


# ---- progress


def test_progress_tells_of_every_stage_on_the_calling_thread(clouds: tuple[Floats, Floats]) -> None:
    events: list[ProgressEvent] = []
    threads = set()

    def listen(event: ProgressEvent) -> None:
        events.append(event)
        threads.add(threading.get_ident())

    result = tmchho.register(*clouds, config=QUICK, progress=listen)
    assert threads == {threading.get_ident()}
    assert [event.stage for event in events if event.started] == [stage.name for stage in result.stages]
    steps = [event for event in events if event.stage == "coarse" and not event.started]
    assert steps
    assert all(0 < event.done <= event.total for event in steps)
    assert all(earlier.best <= later.best for earlier, later in pairwise(steps))
    assert len([event for event in events if event.stage == "icp"]) == 1 + result.n_icp_iterations


def test_listening_changes_nothing(clouds: tuple[Floats, Floats]) -> None:
    results = [tmchho.register(*clouds, config=QUICK, progress=heard) for heard in (None, lambda event: 0)]
    np.testing.assert_array_equal(results[0].transformation, results[1].transformation)


class _MineError(Exception):
    pass


@pytest.mark.parametrize("stage", ["outliers", "coarse", "evaluate"])
@pytest.mark.parametrize("error", [_MineError("mine"), KeyboardInterrupt(), SystemExit(3), MemoryError()])
def test_an_exception_in_the_callback_comes_out_unchanged(
    clouds: tuple[Floats, Floats], stage: str, error: BaseException
) -> None:
    def fail(event: ProgressEvent) -> None:
        if event.stage == stage:
            raise error

    with pytest.raises(type(error)) as raised:
        tmchho.register(*clouds, config=QUICK, progress=fail)
    assert raised.value is error


@pytest.mark.parametrize("answer", [True, np.True_])
def test_true_stops(strangers: tuple[Floats, Floats], answer: Any) -> None:
    with pytest.raises(errors.StoppedError) as stopped:
        tmchho.register(*strangers, config=ENDLESS, progress=lambda event: event.done > 2 and answer)
    assert stopped.value.exit_code == 130


@pytest.mark.parametrize("answer", [None, False, 1, "yes", [0]])
def test_nothing_but_true_stops(clouds: tuple[Floats, Floats], answer: Any) -> None:
    # What tqdm's update or list.append happen to return must not end a registration.
    tmchho.register(*clouds, config=QUICK, progress=lambda event: answer)


def test_a_callback_that_cannot_be_called_is_refused(clouds: tuple[Floats, Floats]) -> None:
    with pytest.raises(errors.InvalidArgumentError, match="progress"):
        tmchho.register(*clouds, progress="tell me")  # type: ignore[arg-type]


def test_a_callback_may_call_tmchho(clouds: tuple[Floats, Floats]) -> None:
    spacings = []
    tmchho.register(
        *clouds,
        config=QUICK,
        progress=lambda event: event.started and spacings.append(tmchho.median_spacing(clouds[0])),
    )
    assert len(set(spacings)) == 1


# ---- Ctrl-C


def _interrupt_soon(seconds: float) -> None:
    def interrupt() -> None:
        time.sleep(seconds)
        os.kill(os.getpid(), signal.SIGINT)

    threading.Thread(target=interrupt, daemon=True).start()


@pytest.mark.skipif(sys.platform == "win32", reason="there is no SIGINT to send")
@pytest.mark.parametrize("progress", [None, lambda event: None])
def test_ctrl_c_ends_a_call_of_minutes(strangers: tuple[Floats, Floats], progress: Any) -> None:
    _interrupt_soon(0.3)
    with pytest.raises(KeyboardInterrupt):
        tmchho.register(*strangers, config=ENDLESS, progress=progress)
    # And what was interrupted works again.
    tmchho.register(strangers[0], strangers[0], config=QUICK)


@pytest.mark.skipif(sys.platform == "win32", reason="there is no SIGINT to send")
def test_ctrl_c_ends_a_search_that_never_calls_python() -> None:
    _interrupt_soon(0.2)
    with pytest.raises(KeyboardInterrupt):
        tmchho.minimize("f3", dimension=2000, n_iterations=10**6)


# ---- threads


def test_other_python_threads_run_on(strangers: tuple[Floats, Floats]) -> None:
    ticks_at_end: list[int] = []
    ticks = 0
    done = threading.Event()

    def register() -> None:
        tmchho.register(*strangers, config={"coarse": {"rotations_per_round": [100]}})
        ticks_at_end.append(ticks)
        done.set()

    thread = threading.Thread(target=register)
    thread.start()
    while not done.is_set():
        time.sleep(0.001)
        ticks += 1
    thread.join()
    # With the interpreter held, the loop would get a turn only before and after the call.
    assert ticks_at_end[0] > 10


def test_eight_threads_at_once_get_what_one_gets(clouds: tuple[Floats, Floats]) -> None:
    alone = tmchho.register(*clouds, config=QUICK)
    with ThreadPoolExecutor(8) as pool:
        together = list(pool.map(lambda _: tmchho.register(*clouds, config=QUICK), range(8)))
    for result in together:
        np.testing.assert_array_equal(result.transformation, alone.transformation)
        np.testing.assert_array_equal(result.history, alone.history)


def _spacing_in_child(queue: Any) -> None:
    try:
        queue.put(tmchho.median_spacing(np.eye(3)))
    except errors.TmchhoError as error:
        queue.put(str(error))


@pytest.mark.skipif("fork" not in multiprocessing.get_all_start_methods(), reason="there is no fork")
@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_a_forked_child_says_so_instead_of_hanging() -> None:
    tmchho.median_spacing(np.eye(3))  # from now on there are threads that a child does not have
    context = multiprocessing.get_context("fork")
    queue = context.Queue()
    child = context.Process(target=_spacing_in_child, args=(queue,))
    child.start()
    answer = queue.get(timeout=60)
    child.join()
    assert "forked" in answer
    assert "spawn" in answer


# ---- the extension itself


def test_the_core_refuses_arrays_that_the_package_would_have_converted() -> None:
    for points in (
        np.eye(3, dtype=np.float32),
        np.asfortranarray(np.ones((5, 3))),
        np.ones((5, 4)),
        [[1.0, 2.0, 3.0]],
    ):
        with pytest.raises((TypeError, ValueError)):
            _core.median_spacing(points)  # type: ignore[arg-type]


def test_every_error_of_the_core_is_a_class_of_the_package() -> None:
    line = np.outer(np.arange(9.0), np.ones(3))
    cases: list[tuple[type[Exception], Any]] = [
        (errors.InvalidCloudError, lambda: _core.register(line, line, "{}", None)),
        (errors.InvalidArgumentError, lambda: _core.complete_config('{"x": 1}')),
        (errors.InvalidArgumentError, lambda: _core.voxel_downsample(line, 0.0)),
        (errors.InvalidArgumentError, lambda: _core.fuse(line, line, 2 * np.eye(4), "{}")),
        (
            errors.InvalidArgumentError,
            lambda: _core.icp(line, line, np.eye(4), 6, "{}", '{"max_iteration": 3}'),
        ),
        (errors.NoSolutionError, _without_keypoints),
    ]
    for expected, call in cases:
        with pytest.raises(expected) as raised:
            call()
        assert isinstance(raised.value, errors.TmchhoError)


def _without_keypoints() -> None:
    points = field(500, 0, 50)
    _core.register(points, points, '{"mode": "paper", "keypoints": {"min_neighbors": 100000}}', None)


def test_the_errors_are_caught_by_the_classes_that_python_programmers_know() -> None:
    with pytest.raises(ValueError, match="voxel_size"):
        tmchho.voxel_downsample(np.eye(3), 0.0)
    with pytest.raises(OSError, match="nowhere"):
        tmchho.read("nowhere.las")
    codes = {error.__name__: error.exit_code for error in errors.TmchhoError.__subclasses__()}
    assert codes["InvalidArgumentError"] == 2
    assert codes["InvalidCloudError"] == codes["ReadError"] == 3
    assert codes["NoSolutionError"] == 4
    assert codes["StoppedError"] == 130
