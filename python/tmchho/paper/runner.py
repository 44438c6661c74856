"""Does the jobs of a series that are not done yet, several at a time.

Threads are enough: the core lets go of the interpreter while it works, so each of them keeps a processor
busy. Only the calling thread writes down results and shows progress.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, as_completed
from threading import Event
from typing import TypeAlias

from tmchho.paper.plan import Job, Result, Run, Series, Settings
from tmchho.paper.store import RunStore

Progress: TypeAlias = Callable[[str, int, int], None]
"""Gets what is run, how many jobs are done, and how many there are."""


def complete(series: Series, settings: Settings, store: RunStore, progress: Progress) -> list[Run]:
    """Return all runs of a series, after doing those that the store lacks.

    Parameters
    ----------
    series : Series
        What is to be run.
    settings : Settings
        How many, and from which seed.
    store : RunStore
        What is done already; every run is added as soon as it has ended.
    progress : callable
        Is told of every run.

    Returns
    -------
    list of Run
        In the order of the series, whatever the order in which they ended.
    """
    jobs = series.jobs(settings)
    missing = [job for job in jobs if store.get(job) is None]
    n_done = len(jobs) - len(missing)
    progress(series.title, n_done, len(jobs))
    stop = Event()
    with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
        try:
            running = {pool.submit(_timed, series, job, stop): job for job in missing}
            for ended in as_completed(running):
                store.add(running[ended], *ended.result())
                n_done += 1
                progress(series.title, n_done, len(jobs))
        except BaseException:
            # An interrupt or an error: what runs ends at its next step, what waits never begins.
            stop.set()
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    return [Run(job, result) for job in jobs if (result := store.get(job)) is not None]


def _timed(series: Series, job: Job, stop: Event) -> tuple[Result, float]:
    begun = time.perf_counter()
    return series.run(job, stop.is_set), time.perf_counter() - begun
