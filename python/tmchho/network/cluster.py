"""Units of work on several processes or machines: Dask distributed does it, under the interface of an engine.

Why Dask: it knows which workers live, gives the work of a lost one to another, ends a worker that takes too
much memory, and runs on batch systems and clouds alike. Nothing of this is done here a second time.

A worker gets the name of a function and a dict, and answers with a dict, a few kilobytes each way: clouds
stay in files, which every worker reads under the same path. Results come back in the order of the items,
and each is computed by one thread alone, so that nothing depends on how many workers there are.
"""

from __future__ import annotations

import os
import tempfile
import uuid
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from typing import Any

from tmchho import __version__
from tmchho.errors import BudgetError, InvalidArgumentError, TmchhoError
from tmchho.network.engine import Counted, Finished, Item, Unit, keep_sums_steady, plain, surroundings
from tmchho.progress import ProgressCallback

_DEATHS = 3  # of workers that had the same unit: the unit is to blame then, not the workers
_WAIT = "60s"
# A terminal sends Ctrl-C to all processes; this one alone decides what ends, and in what order.
_LEAVE_INTERRUPTS = "import signal; signal.signal(signal.SIGINT, signal.SIG_IGN)"


@contextmanager
def local_cluster(
    n_workers: int,
    *,
    memory_per_worker: int | None = None,
    progress: ProgressCallback | None = None,
    threads_of_unit: int | None = None,
) -> Iterator[Cluster]:
    """Start processes on this machine, and end them with the block.

    Parameters
    ----------
    n_workers : int
        How many, at least 1.
    memory_per_worker : int, optional
        Bytes. A worker that takes more is ended and replaced, and its unit begun anew; a unit to which that
        happens several times ends the run. The machine's memory by the number of workers where not given.
    progress : callable, optional
        Gets an event after each item; answers True to stop.
    threads_of_unit : int, optional
        Threads of each unit; its share of the processors where not given. Never changes the results.

    Yields
    ------
    Cluster
        An engine.

    Raises
    ------
    InvalidArgumentError
        If Dask is not installed, or there is to be no worker.

    Notes
    -----
    The processes are spawned: a script must begin its work under ``if __name__ == "__main__":``.
    """
    dask, distributed = _dask()
    if n_workers < 1:
        raise InvalidArgumentError(f"n_workers must be at least 1, got {n_workers}")
    settings = {
        "distributed.scheduler.allowed-failures": _DEATHS,
        "distributed.worker.multiprocessing-method": "spawn",
        # Results are a few kilobytes: nothing is worth being moved to the disk, where it would be a pickle.
        "distributed.worker.memory.target": False,
        "distributed.worker.memory.spill": False,
        "distributed.worker.memory.pause": False,
        "distributed.worker.memory.terminate": 0.95,
    }
    n_threads = threads_of_unit or max(1, (os.cpu_count() or 1) // n_workers)
    with (
        tempfile.TemporaryDirectory(prefix="tmchho-") as scratch,
        dask.config.set(settings),
        distributed.LocalCluster(
            n_workers=n_workers,
            threads_per_worker=1,
            memory_limit="auto" if memory_per_worker is None else memory_per_worker,
            dashboard_address="127.0.0.1:0",
            local_directory=scratch,
            preload=[_LEAVE_INTERRUPTS],
        ) as processes,
        distributed.Client(processes, set_as_default=False) as client,
    ):
        yield Cluster(client, n_threads=n_threads, progress=progress)


@contextmanager
def scheduler(address: str, *, progress: ProgressCallback | None = None) -> Iterator[Cluster]:
    """Connect to the workers of a Dask scheduler that runs already, and leave them running.

    Parameters
    ----------
    address : str
        Such as ``tcp://10.0.0.1:8786``. The workers' memory is limited where they are started, by
        ``dask worker --memory-limit``.
    progress : callable, optional
        Gets an event after each item; answers True to stop.

    Yields
    ------
    Cluster
        An engine. Its units use one thread each.

    Raises
    ------
    InvalidArgumentError
        If Dask is not installed, nothing answers at the address, or no worker comes within a minute.
    """
    _, distributed = _dask()
    try:
        client = distributed.Client(address, timeout="20s", set_as_default=False)
    except (OSError, ValueError) as error:
        raise InvalidArgumentError(
            f"{address}: no Dask scheduler answers there; start one with `dask scheduler`, and give the "
            "address that it prints"
        ) from error
    with client:
        try:
            client.wait_for_workers(1, timeout=_WAIT)
        except distributed.TimeoutError as error:
            raise InvalidArgumentError(
                f"{address}: the scheduler has no workers; start some with `dask worker {address}`"
            ) from error
        yield Cluster(client, n_threads=1, progress=progress)


class Cluster:
    """An engine on the workers that a Dask client knows; see `local_cluster` and `scheduler`.

    Parameters
    ----------
    client : distributed.Client
        Connected to a scheduler.
    n_threads : int
        Threads of each unit.
    progress : callable, optional
        Gets an event after each item; answers True to stop.
    """

    def __init__(self, client: Any, *, n_threads: int, progress: ProgressCallback | None = None) -> None:
        self.client = client
        self.progress = progress
        self._n_threads = n_threads

    @property
    def n_workers(self) -> int:
        """How many units the workers do at a time, now."""
        return sum(self.client.nthreads().values())

    def run(
        self, stage: str, unit: Unit, items: Sequence[Item], *, finished: Finished | None = None
    ) -> list[Item]:
        """Return the results of all items; see `tmchho.network.engine.Engine.run`."""
        _, distributed = _dask()
        counted = Counted(self.progress, stage, len(items))
        results: list[Item] = [{} for _ in items]
        if not items:
            return results
        name = f"{stage}-{uuid.uuid4().hex}"
        # No two runs share a key: Dask would take the results of the one for those of the other.
        keys = [f"{name}-{place}" for place in range(len(items))]
        places = {key: place for place, key in enumerate(keys)}
        futures = self.client.map(
            _work,
            [plain(item) for item in items],
            key=keys,
            unit=unit,
            n_threads=self._n_threads,
            version=__version__,
        )
        try:
            for future, result in distributed.as_completed(futures, with_results=True, loop=self.client.loop):
                place = places[future.key]
                results[place] = result
                if finished is not None:
                    finished(place, result)
                counted.add()
                future.release()
        except distributed.KilledWorker as error:
            raise BudgetError(
                f"{stage}: the same unit of work ended {_DEATHS + 1} workers, which points to memory: allow "
                "more for each worker (--memory-per-worker), or thin the clouds out"
            ) from error
        finally:
            self.client.cancel(futures)
        return results


def _work(item: Item, *, unit: Unit, n_threads: int, version: str) -> Item:
    """Do one unit, on a worker."""
    if version != __version__:
        raise TmchhoError(
            f"a worker has tmchho {__version__}, but the network is run by {version}: install the same "
            "version everywhere"
        )
    keep_sums_steady()
    with surroundings(n_threads, _Cancelled()):
        return plain(unit(item))


class _Cancelled:
    """Tells whether nobody waits any more for the unit that this thread does."""

    def __init__(self) -> None:
        _, distributed = _dask()
        self._worker = distributed.get_worker()
        self._key = self._worker.get_current_task()

    def is_set(self) -> bool:
        """Return whether the run was stopped, or the process that waited for it has gone."""
        task = self._worker.state.tasks.get(self._key)
        return task is None or task.state == "cancelled"


def _dask() -> tuple[Any, Any]:
    """Return the modules of Dask, which takes a second to import and need not be installed."""
    try:
        return import_module("dask"), import_module("distributed")
    except ImportError as error:
        raise InvalidArgumentError(
            "several processes or machines need Dask; get it by: pip install 'tmchho[network]'"
        ) from error
