"""One process that registers again and again: its memory stays flat, and every answer is the first one.

    python benches/soak.py --runs 500 --threads 8

Afterwards some Python threads register at once; before, a child that was forked after the import does: all
answers must be the same, bit by bit. A child that is forked after a registration has none of the threads; it
must say so, not hang. Anything else ends the script with exit code 1.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np

import tmchho
from tmchho.simulate import make_pair

GROWTH = 1.1  # of the memory after the first tenth of the runs


def memory_mb() -> float:
    """Return the memory of this process."""
    with open("/proc/self/status", encoding="ascii") as stream:
        return int(stream.read().split("VmRSS:")[1].split()[0]) / 1000


def answer(pair: Sequence[np.ndarray]) -> bytes:
    """Register, and return the pose and the figures as bytes."""
    found = tmchho.register(*pair, seed=1)
    figures = [found.inlier_rmse, found.overlap_of_source, found.overlap_of_target]
    return found.transformation.tobytes() + np.array(figures).tobytes()


def small_pair() -> tuple[np.ndarray, np.ndarray]:
    """Return two small clouds."""
    pair = make_pair(n_photogrammetry_points=6_000, n_scanner_points=5_000, area_ratio=1.2, seed=0)
    return pair.source.xyz, pair.target.xyz


def in_one_process(pair: Sequence[np.ndarray], n_runs: int) -> tuple[bytes, list[float]]:
    """Return the answer of all runs and the memory after each; raises where answers differ or it grows."""
    first, used = answer(pair), []
    for number in range(n_runs):
        assert answer(pair) == first, f"run {number} gave another answer"
        used.append(memory_mb())
    settled = used[n_runs // 10]
    assert max(used[n_runs // 2 :]) < GROWTH * settled, (
        f"memory grew from {settled:.0f} to {max(used):.0f} MB"
    )
    return first, used


def in_threads(pair: Sequence[np.ndarray], wanted: bytes, n_threads: int) -> None:
    """Register in several threads at once."""
    with ThreadPoolExecutor(n_threads) as pool:
        answers = list(pool.map(lambda _: answer(pair), range(2 * n_threads)))
    assert answers == [wanted] * (2 * n_threads), "a thread gave another answer"


def in_fork(pair: Sequence[np.ndarray], patience_s: float = 120) -> bytes:
    """Return what a forked child answers: the figures, or the sentence of its error."""
    ours, theirs = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(ours)
        try:
            told = answer(pair)
        except tmchho.TmchhoError as error:
            told = str(error).encode()
        os.write(theirs, told)
        os._exit(0)
    os.close(theirs)
    until = time.monotonic() + patience_s
    while not os.waitpid(child, os.WNOHANG)[0]:
        if time.monotonic() > until:
            os.kill(child, 9)
            os.waitpid(child, 0)
            raise AssertionError("a forked child hangs")
        time.sleep(0.05)
    with os.fdopen(ours, "rb") as stream:
        return stream.read()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--runs", type=int, default=500)
    parser.add_argument("--threads", type=int, default=8)
    arguments = parser.parse_args()
    pair = small_pair()
    forked = in_fork(pair)
    began = time.perf_counter()
    wanted, used = in_one_process(pair, arguments.runs)
    seconds = time.perf_counter() - began
    print(
        f"{arguments.runs} runs in {seconds:.0f} s: one answer, {used[0]:.0f} to {max(used):.0f} MB",
        flush=True,
    )
    in_threads(pair, wanted, arguments.threads)
    print(f"{arguments.threads} threads at once: the same answer", flush=True)
    assert forked == wanted, "a forked child gave another answer"
    assert b"was forked" in in_fork(pair)
    print(
        "a child forked after the import: the same answer; one forked after a registration is told what to do"
    )


if __name__ == "__main__":
    main()
