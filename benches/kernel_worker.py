"""One library in a process of its own: runs a kernel whenever it is told to, and tells what it took.

Started by `kernel_run.py` with the number of threads in its environment; not meant to be called by hand.
Each line of standard input is a JSON object of settings; the first of them names the kernel, the library,
the threads, the folder of the clouds and that of the answer.
"""

from __future__ import annotations

import gc
import json
import os
import sys
import time
from pathlib import Path
from typing import Any

import kernel_nearest  # noqa: F401 - makes its kernels known
import numpy as np
from kernel_peers import KERNELS, MODULES

KIB = 1024


def memory(entry: str) -> int:
    """Return the bytes held now (``VmRSS``) or at most since `forget_peak` (``VmHWM``).

    The peak that `resource` knows would be that of the starting process, were that larger.
    """
    status = Path("/proc/self/status").read_text()
    return KIB * next(int(line.split()[1]) for line in status.splitlines() if line.startswith(entry))


def forget_peak() -> None:
    """Let the peak of memory start at what is held now; the imports had one of their own."""
    Path("/proc/self/clear_refs").write_text("5")


def serve(order: dict[str, Any], answers: Any) -> None:
    os.sched_setaffinity(0, order["processors"])
    __import__(MODULES[order["library"]])
    run = KERNELS[order["kernel"]][order["library"]]
    clouds = {path.stem: np.load(path) for path in Path(order["clouds"]).glob("*.npy")}
    answers.write(json.dumps({"ready": True}) + "\n")
    answers.flush()
    for line in sys.stdin:
        settings = json.loads(line)
        gc.collect()
        forget_peak()
        held = memory("VmRSS")
        cpu, began = time.process_time(), time.perf_counter()
        try:
            answer = run(clouds, settings, order["n_threads"])
        except Exception as error:
            told: dict[str, Any] = {"error": f"{type(error).__name__}: {error}"}
        else:
            seconds, cpu = time.perf_counter() - began, time.process_time() - cpu
            peak = memory("VmHWM")
            told = {"seconds": seconds, "cpu_seconds": cpu, "peak": max(peak - held, 0), "whole": peak}
            if settings.get("keep"):
                np.savez(order["answer"], **answer)
            del answer
        answers.write(json.dumps(told) + "\n")
        answers.flush()


if __name__ == "__main__":
    # Libraries print as they like: that goes to standard error.
    private = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    serve(json.loads(sys.stdin.readline()), private)
