"""Engines: the same results wherever the work is done, and a clear end when it is not."""

from __future__ import annotations

import math
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from network_units import (
    begun_or_waiting,
    deadly,
    deadly_once,
    normal_equations,
    not_plain,
    refused,
    squared,
    surroundings_of,
)
from threadpoolctl import threadpool_info, threadpool_limits

from tmchho.errors import BudgetError, InvalidArgumentError, InvalidCloudError, StoppedError, TmchhoError
from tmchho.network.cluster import Cluster, local_cluster, scheduler
from tmchho.network.engine import InProcess
from tmchho.progress import ProgressEvent

ITEMS = [{"value": number / 7, "seconds": 0.01 * (number % 3)} for number in range(12)]
RESULTS = [{"square": (number / 7) * (number / 7), "as_tuple": [1, 0.1]} for number in range(12)]


@pytest.fixture(scope="module")
def two_workers() -> Iterator[Cluster]:
    with local_cluster(2, memory_per_worker=400_000_000) as cluster:
        yield cluster


@pytest.mark.parametrize("n_workers", [1, 2, 5])
def test_results_are_in_the_order_of_the_items_at_any_number_of_workers(n_workers: int) -> None:
    assert InProcess(n_workers).run("squaring", squared, ITEMS) == RESULTS


def test_a_cluster_gives_the_results_of_one_process(two_workers: Cluster) -> None:
    places: list[int] = []
    found = two_workers.run("squaring", squared, ITEMS, finished=lambda place, _: places.append(place))
    assert found == RESULTS
    assert sorted(places) == list(range(len(ITEMS)))
    assert two_workers.n_workers == 2


def test_sums_do_not_depend_on_the_threads_of_blas(two_workers: Cluster) -> None:
    items = [{"seed": seed} for seed in range(4)]
    expected = two_workers.run("summing", normal_equations, items)
    for n_threads in (1, 2):
        with threadpool_limits(n_threads, user_api="blas"):
            assert InProcess(2).run("summing", normal_equations, items) == expected
            # As it was before.
            blas = [library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"]
            assert set(blas) == {n_threads}


def test_a_scheduler_address_takes_the_same_call(two_workers: Cluster) -> None:
    with scheduler(two_workers.client.scheduler.address) as engine:
        assert engine.run("squaring", squared, ITEMS) == RESULTS
    # The workers are left as they were.
    assert two_workers.run("squaring", squared, ITEMS[:2]) == RESULTS[:2]


def test_no_items_are_no_work(two_workers: Cluster) -> None:
    for engine in (InProcess(2), two_workers):
        assert engine.run("nothing", squared, []) == []


def test_a_unit_is_told_its_threads_and_where_it_runs(two_workers: Cluster) -> None:
    item = {"process": os.getpid()}
    n_processors = os.cpu_count() or 1
    inside, outside = (
        engine.run("looking", surroundings_of, [item])[0] for engine in (InProcess(2), two_workers)
    )
    assert inside == {"n_threads": max(1, n_processors // 2), "is_main": True}
    assert outside == {"n_threads": max(1, n_processors // 2), "is_main": False}


def test_progress_counts_every_item(two_workers: Cluster) -> None:
    def counts_of(engine: InProcess | Cluster) -> list[tuple[str, int, int, bool]]:
        events: list[ProgressEvent] = []
        engine.progress = events.append
        engine.run("squaring", squared, ITEMS)
        engine.progress = None
        return [(event.stage, event.done, event.total, event.started) for event in events]

    expected = [("squaring", done, 12, done == 0) for done in range(13)]
    assert counts_of(InProcess(3)) == expected
    assert counts_of(two_workers) == expected


def test_an_error_of_a_unit_comes_out_as_it_was_raised(two_workers: Cluster) -> None:
    items = [{"value": number} for number in range(6)]
    for engine in (InProcess(2), two_workers):
        with pytest.raises(InvalidCloudError, match="cloud 3 is empty"):
            engine.run("refusing", refused, items)


def test_what_json_does_not_know_is_refused() -> None:
    with pytest.raises(TmchhoError, match="what JSON knows"):
        InProcess(1).run("squaring", not_plain, [{"value": 1}])
    with pytest.raises(TmchhoError, match="what JSON knows"):
        InProcess(1).run("squaring", squared, [{"value": math.nan}])


def test_a_killed_worker_changes_nothing(two_workers: Cluster, tmp_path: Path) -> None:
    items = [{"value": number, "folder": str(tmp_path), "seconds": 0.02} for number in range(10)]
    found = two_workers.run("killing", deadly_once, items)
    assert (tmp_path / "killed").exists()
    assert [result["square"] for result in found] == [number * number for number in range(10)]


def test_a_unit_that_kills_every_worker_ends_the_run(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tmchho.network.cluster._DEATHS", 1)
    with local_cluster(1) as cluster, pytest.raises(BudgetError, match="memory-per-worker"):
        cluster.run("killing", deadly, [{}])


def test_a_listener_that_answers_true_stops_the_run_and_what_runs(
    two_workers: Cluster, tmp_path: Path
) -> None:
    for number, engine in enumerate((InProcess(2), two_workers)):
        begun, stopped = tmp_path / f"begun-{number}", tmp_path / f"stopped-{number}"
        waiting = [{"begun": str(begun), "stopped": str(stopped)}]
        engine.progress = lambda event: event.done > 0
        with pytest.raises(StoppedError):
            engine.run("waiting", begun_or_waiting, [{"wait_for": str(begun)}, *waiting])
        engine.progress = None
        _wait_for(stopped.exists)


@pytest.mark.parametrize("engine", ["nullcontext(InProcess(2))", "local_cluster(2)"])
def test_ctrl_c_ends_a_run_soon(tmp_path: Path, engine: str) -> None:
    script = (
        "import sys, network_units\n"
        "from contextlib import nullcontext\n"
        "from pathlib import Path\n"
        "from tmchho.network.cluster import local_cluster\n"
        "from tmchho.network.engine import InProcess\n"
        "if __name__ == '__main__':\n"
        "    folder, names = Path(sys.argv[1]), ('begun', 'stopped')\n"
        "    items = [{name: str(folder / f'{name}-{n}') for name in names} for n in range(9)]\n"
        f"    with {engine} as engine:\n"
        "        engine.run('waiting', network_units.until_stopped, items)\n"
    )
    (tmp_path / "script.py").write_text(script)
    folder = tmp_path / "seen"
    folder.mkdir()
    process = subprocess.Popen(
        [sys.executable, str(tmp_path / "script.py"), str(folder)],
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parent)},
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    _wait_for(lambda: len(list(folder.glob("begun-*"))) >= 2, 60.0)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does it: to this process and all that it started
    _, said = process.communicate(timeout=60)
    assert said.count("KeyboardInterrupt") == 1
    # Those that ran were stopped; those that waited never began.
    begun = {path.name.removeprefix("begun-") for path in folder.glob("begun-*")}
    assert begun == {path.name.removeprefix("stopped-") for path in folder.glob("stopped-*")}
    assert len(begun) < 9


def test_an_address_where_nothing_answers_is_said() -> None:
    with pytest.raises(InvalidArgumentError, match="no Dask scheduler answers"), scheduler("nonsense://x"):
        pass


def test_without_dask_the_message_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(InvalidArgumentError, match=r"pip install 'tmchho\[network\]'"), local_cluster(1):
        pass


def _wait_for(is_so: Callable[[], bool], seconds: float = 20.0) -> None:
    end = time.monotonic() + seconds
    while not is_so():
        assert time.monotonic() < end
        time.sleep(0.01)
