"""Runs a kernel in several libraries side by side, each in a process of its own, in interleaved rounds.

A load that comes and goes on a shared machine hits all libraries alike: a round runs each of them once, one
after the other, and a median is over rounds.
"""

from __future__ import annotations

import json
import os
import select
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from kernel_peers import Answer, Settings

MIB = 2**20
START_SECONDS = 180.0
WORKER = Path(__file__).with_name("kernel_worker.py")


@dataclass(eq=False)
class Runs:
    """What one library took on one row: its answer is that of the first call, which is not timed."""

    library: str
    n_threads: int
    settings: dict[str, Any]
    answer: Answer = field(default_factory=dict)
    seconds: list[float] = field(default_factory=list)
    cpu_seconds: list[float] = field(default_factory=list)
    peak_mib: float = float("nan")
    process_mib: float = float("nan")
    failure: str = ""

    @property
    def median(self) -> float:
        """Seconds, NaN where it never ran."""
        return float(np.median(self.seconds)) if self.seconds else float("nan")

    @property
    def cpu_median(self) -> float:
        """Seconds of the processors, NaN where it never ran."""
        return float(np.median(self.cpu_seconds)) if self.cpu_seconds else float("nan")

    def take(self, told: Mapping[str, Any]) -> None:
        """Keep what one round took."""
        self.seconds.append(told["seconds"])
        self.cpu_seconds.append(told["cpu_seconds"])


class Worker:
    """A process with one library, one kernel and its clouds."""

    def __init__(self, kernel: str, library: str, n_threads: int, clouds: Path) -> None:
        self.answer_path = clouds.parent / f"answer {library} {n_threads}.npz"
        processors = sorted(os.sched_getaffinity(0))[:n_threads]
        threads = {
            name: str(n_threads)
            for name in (
                "OMP_NUM_THREADS",
                "RAYON_NUM_THREADS",
                "OPENBLAS_NUM_THREADS",
                "MKL_NUM_THREADS",
                "NUMBA_NUM_THREADS",
            )
        }
        self._process = subprocess.Popen(
            [sys.executable, str(WORKER)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            cwd=clouds.parent,  # some leave a log where they are started
            env={**os.environ, **threads},
        )
        order = {
            "kernel": kernel,
            "library": library,
            "n_threads": n_threads,
            "processors": processors,
            "clouds": str(clouds),
            "answer": str(self.answer_path),
        }
        self._tell(order)

    def _tell(self, message: Mapping[str, Any]) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write((json.dumps(message) + "\n").encode())
        self._process.stdin.flush()

    def hear(self, seconds: float) -> dict[str, Any]:
        """Return what the process says next, or an ``error`` where it says nothing in time or has died."""
        assert self._process.stdout is not None
        if not select.select([self._process.stdout], [], [], seconds)[0]:
            self.end()
            return {"error": f"more than {seconds:.0f} s"}
        line = self._process.stdout.readline()
        if not line:
            return {"error": f"its process ended with code {self._process.wait()}"}
        return dict(json.loads(line))

    def run(self, settings: Settings, patience: float) -> dict[str, Any]:
        """Run once; return what it took."""
        self._tell(settings)
        return self.hear(patience)

    def answer(self) -> Answer:
        """Return what the last call with ``keep`` gave."""
        with np.load(self.answer_path) as file:
            return dict(file)

    def end(self) -> None:
        """Stop the process, whatever it does."""
        self._process.kill()
        self._process.wait()


def run_side_by_side(
    kernel: str,
    settings: Mapping[str, dict[str, Any]],
    n_threads: int,
    clouds: Path,
    rounds: int,
    patience: float,
) -> list[Runs]:
    """Run a kernel in every library of `settings`: once for the answer and the memory, then in rounds.

    A library that takes longer than `patience` seconds, or fails, is left out from there on and says so.
    """
    every = [Runs(library, n_threads, dict(own)) for library, own in settings.items()]
    workers = {runs.library: Worker(kernel, runs.library, n_threads, clouds) for runs in every}
    try:
        for runs in every:
            runs.failure = workers[runs.library].hear(START_SECONDS).get("error", "")
        for runs in every:
            if runs.failure:
                continue
            told = workers[runs.library].run({**runs.settings, "keep": True}, patience)
            runs.failure = told.get("error", "")
            if not runs.failure:
                runs.answer = workers[runs.library].answer()
                runs.peak_mib, runs.process_mib = told["peak"] / MIB, told["whole"] / MIB
        for _ in range(rounds):
            for runs in every:
                if runs.failure:
                    continue
                told = workers[runs.library].run(runs.settings, patience)
                runs.failure = told.get("error", "")
                if not runs.failure:
                    runs.take(told)
    finally:
        for worker in workers.values():
            worker.end()
    return every


def coarsest_that_arrive(
    kernel: str,
    steps: Mapping[str, Sequence[float]],
    settings: Settings,
    clouds: Path,
    patience: float,
    error_of: Callable[[Answer], float],
    slack: float,
) -> tuple[float, dict[str, float]]:
    """Find how finely each library has to come to rest: to where the worst of them ends, and some slack.

    Steps run from coarse to fine. Returns the largest error and the coarsest step of each library from which
    on the error stays below it; a library that fails is left with its finest.
    """
    workers = {name: Worker(kernel, name, len(os.sched_getaffinity(0)), clouds) for name in steps}

    def error_at(library: str, step: float) -> float:
        told = workers[library].run({**settings, "step": step, "keep": True}, patience)
        return float("nan") if told.get("error") else error_of(workers[library].answer())

    try:
        started = [name for name, worker in workers.items() if not worker.hear(START_SECONDS).get("error")]
        largest = slack * float(np.nanmax([error_at(name, steps[name][-1]) for name in started]))
        chosen = {name: own[-1] for name, own in steps.items()}
        for name in started:
            for step in reversed(steps[name][:-1]):
                if not error_at(name, step) <= largest:
                    break
                chosen[name] = step
    finally:
        for worker in workers.values():
            worker.end()
    return largest, chosen
