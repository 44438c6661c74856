"""Where the work of a network is done: units of work, handed to whoever has a processor free.

Why: pairs of stations and tiles know nothing of each other, so that they can be worked on in any order, on
any number of machines. Whoever computes writes one function for one unit and never learns where it runs.

A unit is a pure function at the top of a module: a dict in, a dict out. Both hold only what JSON knows,
clouds as references to files and never as points, so that they can be sent to another machine, written down,
and compared. Everything that the result depends on stands in the item: the settings, too.
Absent on purpose: how work is spread over machines, which `tmchho.network.cluster` leaves to Dask; what was
finished before, which `tmchho.network.store` knows.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from threading import Event
from typing import Any, Protocol, TypeAlias

from tmchho.errors import InvalidArgumentError, StoppedError, TmchhoError
from tmchho.progress import ProgressCallback, ProgressEvent, says_stop

Item: TypeAlias = dict[str, Any]
"""What a unit gets, and what it returns: only what JSON knows."""

Unit: TypeAlias = Callable[[Item], Item]
"""A pure function at the top of a module."""

Finished: TypeAlias = Callable[[int, Item], object]
"""Gets the place of an item and its result, on the calling thread, as soon as it is there."""


class Engine(Protocol):
    """Runs one unit for many items."""

    def run(
        self, stage: str, unit: Unit, items: Sequence[Item], *, finished: Finished | None = None
    ) -> list[Item]:
        """Return the results of all items, in the order of the items.

        Parameters
        ----------
        stage : str
            What is done, in a word: progress is told under it.
        unit : callable
            A pure function at the top of a module.
        items : sequence of dict
            What it is called with.
        finished : callable, optional
            Gets each result as soon as it is there, in the order of chance.

        Returns
        -------
        list of dict
            As JSON gives them back: tuples are lists, and every number is the same to the bit.

        Raises
        ------
        KeyboardInterrupt, StoppedError
            By Ctrl-C, or where the listener to the progress asks for it; what waits is not begun.
        TmchhoError
            Whatever a unit raises; what waits is not begun then.
        """
        ...


class Stop(Protocol):
    """Whether a unit should end early, because nobody waits for it any more."""

    def is_set(self) -> bool:
        """Return whether it should."""
        ...


@dataclass(frozen=True)
class _Surroundings:
    """What a unit may ask for, and what must not change its result."""

    n_threads: int | None = None
    stop: Stop | None = None


_NONE_SAID = _Surroundings()
_surroundings: ContextVar[_Surroundings] = ContextVar("surroundings", default=_NONE_SAID)


def unit_threads() -> int | None:
    """Return how many threads the running unit should use, None for as many as the machine has.

    For the setting ``n_threads`` of `tmchho.register`, which never changes a result.
    """
    return _surroundings.get().n_threads


def unit_progress(_event: ProgressEvent) -> bool:
    """Tell a long call within a unit whether to stop: hand it over as ``progress=unit_progress``."""
    stop = _surroundings.get().stop
    return stop is not None and stop.is_set()


@contextmanager
def surroundings(n_threads: int | None, stop: Stop | None = None) -> Iterator[None]:
    """Say what `unit_threads` and `unit_progress` answer within the block."""
    token = _surroundings.set(_Surroundings(n_threads, stop))
    try:
        yield
    finally:
        _surroundings.reset(token)


@contextmanager
def steady_sums() -> Iterator[None]:
    """Let BLAS add up on one thread within the block: how it cuts a sum depends on their number.

    Without it a matrix product on two threads differs in its last digit from the same on one, and a network
    on a cluster from the same in this process.

    Raises
    ------
    InvalidArgumentError
        If threadpoolctl is not installed.
    """
    limits = _limits_of_blas()
    try:
        yield
    finally:
        limits.restore_original_limits()


@cache
def keep_sums_steady() -> None:
    """Do as `steady_sums` from now on, in a process that does nothing but units of work."""
    _limits_of_blas()


def _limits_of_blas() -> Any:
    try:
        # Each brings a BLAS of its own, which can only be told once it is there.
        import_module("scipy.linalg")
        threadpoolctl = import_module("threadpoolctl")
    except ImportError as error:
        raise InvalidArgumentError(
            f"a network needs {error.name}; get it by: pip install 'tmchho[network]'"
        ) from error
    return threadpoolctl.threadpool_limits(1, user_api="blas")


def plain(value: Item) -> Item:
    """Return a dict as it comes back from JSON, so that it is the same whether or not it was written down.

    Raises
    ------
    TmchhoError
        If it holds anything that JSON does not know: a unit is wrong then, not its input.

    Examples
    --------
    >>> plain({"links": (1, 2)})
    {'links': [1, 2]}
    """
    try:
        found: Item = json.loads(json.dumps(value, allow_nan=False))
    except (TypeError, ValueError) as error:
        raise TmchhoError(f"a unit of work must take and return what JSON knows: {error}") from error
    return found


class Counted:
    """Tells a listener how many of the items of a stage are done.

    Parameters
    ----------
    progress : callable, optional
        See `tmchho.progress.ProgressCallback`.
    stage : str
        What is done.
    total : int
        How many items there are.
    """

    def __init__(self, progress: ProgressCallback | None, stage: str, total: int) -> None:
        self._progress, self._stage, self._total = progress, stage, total
        self._done = 0
        self._tell(started=True)

    def add(self) -> None:
        """Count one more."""
        self._done += 1
        self._tell(started=False)

    def _tell(self, *, started: bool) -> None:
        event = ProgressEvent(self._stage, self._done, self._total, None, started)
        if self._progress is not None and says_stop(self._progress(event)):
            raise StoppedError("stopped by the progress callback")


class InProcess:
    """Threads of this process: enough for one machine, because the core lets go of the interpreter.

    Parameters
    ----------
    n_workers : int, optional
        Units at a time; as many as the machine has processors where not given. Never changes the results.
    progress : callable, optional
        Gets an event after each item; answers True to stop.
    threads_of_unit : int, optional
        Threads of each unit; its share of the processors where not given. Never changes the results.

    Examples
    --------
    >>> def doubled(item):
    ...     return {"value": 2 * item["value"]}
    >>> InProcess(2).run("doubling", doubled, [{"value": 3}, {"value": 4}])
    [{'value': 6}, {'value': 8}]
    """

    def __init__(
        self,
        n_workers: int | None = None,
        progress: ProgressCallback | None = None,
        threads_of_unit: int | None = None,
    ) -> None:
        n_processors = os.cpu_count() or 1
        self.n_workers = n_workers or n_processors
        self.progress = progress
        self._threads_of_unit = threads_of_unit or max(1, n_processors // self.n_workers)

    def run(
        self, stage: str, unit: Unit, items: Sequence[Item], *, finished: Finished | None = None
    ) -> list[Item]:
        """Return the results of all items; see `Engine.run`."""
        stop = Event()

        def work(item: Item) -> Item:
            with surroundings(self._threads_of_unit, stop):
                return plain(unit(item))

        results: list[Item] = [{} for _ in items]
        counted = Counted(self.progress, stage, len(items))
        with (
            steady_sums(),
            ThreadPoolExecutor(self.n_workers, thread_name_prefix=f"tmchho-{stage}") as pool,
        ):
            try:
                places = {pool.submit(work, plain(item)): place for place, item in enumerate(items)}
                for future in as_completed(places):
                    place = places[future]
                    results[place] = future.result()
                    if finished is not None:
                        finished(place, results[place])
                    counted.add()
            except BaseException:
                # What runs ends where it next asks; what waits never begins.
                stop.set()
                pool.shutdown(wait=False, cancel_futures=True)
                raise
        return results
