"""Every public function with hostile arrays, every reader with damaged files: no panic, hang, runaway memory.

    python benches/fuzz.py --cases 100000 --files 3000
    python benches/fuzz.py --only 4711

A case is settled by its number alone. It passes where the function returns, or raises an error of this
package, a `TypeError`, a `ValueError` or a `MemoryError`; and leaves what it was given as it was. Cases run
in processes of their own, within an address space of 4 GB, so that an abort is seen and named. Files are
damaged by `tests/python/mutations.py`, so many of each format and of each kind of document.
"""

from __future__ import annotations

import argparse
import faulthandler
import json
import logging
import multiprocessing
import os
import resource
import signal
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

import tmchho

ADDRESS_SPACE = 4_000_000_000
PATIENCE_S = 30
CASES_PER_PROCESS = 2000
MUTATIONS = Path(__file__).resolve().parents[1] / "tests" / "python" / "mutations.py"
SPECIAL = (np.nan, np.inf, -np.inf, 5e-324, 1e-308, 1e308, -1e308, 0.0, -0.0, 1e15, 1.0)
NUMBERS = (
    *(0, 1, -1, 2, 3, 16, 2**31, 2**63, 2**64, 10**30, 0.5, -0.5, 1e-9, 5e-324, 1e308, -1e308),
    *(np.nan, np.inf, -np.inf, None, True, "1", "x", [], [1.0], np.float32(0.25), np.int8(3), 1j),
)
Call = Callable[[Any, Any, "Draw"], Any]


class Draw:
    """Draws what a case is made of.

    Parameters
    ----------
    number : int
        Of the case.
    """

    def __init__(self, number: int) -> None:
        self.rng = np.random.default_rng([20_26, number])

    def one(self, choices: Any) -> Any:
        """Return one of them."""
        return choices[int(self.rng.integers(len(choices)))]

    def number(self, usual: float) -> Any:
        """Return a usual number, or now and then a hostile one."""
        return usual if self.rng.random() < 0.7 else self.one(NUMBERS)

    def options(self, **usual: Any) -> dict[str, Any]:
        """Return some of the options."""
        return {name: self.number(value) for name, value in usual.items() if self.rng.random() < 0.4}

    def cloud(self) -> Any:
        """Return what is given for a cloud."""
        n = int(self.one((0, 1, 2, 3, 4, 5, 7, 20, 60, 200)))
        points = self.rng.normal(size=(n, 3)) * self.one((1.0, 1.0, 1e-3, 1e6, 1e-300, 1e150))
        shapes: dict[str, Callable[[], Any]] = {
            "usual": lambda: points,
            "far": lambda: points + self.one((5e5, 4e6, 1e15, 1e300)),
            "one place": lambda: np.repeat(points[:1], n, axis=0),
            "line": lambda: points * [1, 0, 0],
            "plane": lambda: points * [1, 1, 0],
            "grid": lambda: np.round(points),
            "special": lambda: self.rng.choice(SPECIAL, (n, 3)),
            "some special": lambda: np.where(
                self.rng.random((n, 3)) < 0.1, self.rng.choice(SPECIAL, (n, 3)), points
            ),
            "float32": lambda: points.astype(np.float32),
            "whole": lambda: self.rng.integers(-(2**62), 2**62, (n, 3)),
            "bytes": lambda: self.rng.integers(0, 255, (n, 3)).astype(np.uint8),
            "strided": lambda: np.repeat(points, 2, axis=0)[::-2],
            "fortran": lambda: np.asfortranarray(points),
            "read-only": lambda: read_only(points),
            "swapped bytes": lambda: points.astype(">f8"),
            "list": lambda: points.tolist(),
            "cloud": lambda: tmchho.PointCloud(points),
            "wide": lambda: np.hstack([points, points]),
            "flat": lambda: points.ravel(),
            "deep": lambda: points[None],
            "objects": lambda: points.astype(object),
            "mixed": lambda: np.array([[1, "x", None]] * max(n, 1), dtype=object),
            "words": lambda: np.full((n, 3), "12"),
            "complex": lambda: points + 1j,
            "truth": lambda: points > 0,
            "ragged": lambda: [[1.0, 2.0, 3.0], [4.0]],
            "huge": lambda: np.broadcast_to(np.zeros(3), (10**11, 3)),
            "nothing": lambda: None,
            "number": lambda: 3.0,
            "mapping": lambda: {"x": points},
        }
        names = list(shapes)
        with np.errstate(over="ignore"):
            return shapes["usual" if self.rng.random() < 0.3 else self.one(names)]()

    def matrix(self) -> Any:
        """Return what is given for a pose."""
        pose = np.eye(4)
        angle = self.rng.uniform(-4, 4)
        pose[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
        pose[:3, 3] = self.rng.normal(size=3)
        if self.rng.random() < 0.5:
            return pose
        spoilt = pose.copy()
        spoilt[tuple(self.rng.integers(0, 4, 2))] = self.one(SPECIAL)
        return self.one((spoilt, np.zeros((4, 4)), -pose, pose[:3], pose.tolist(), None, "x", 1e308 * pose))


def read_only(points: Any) -> Any:
    """Return a copy that cannot be written to."""
    kept = points.copy()
    kept.setflags(write=False)
    return kept


def column(points: Any) -> Any:
    """Return the first coordinate of each point, where there are points."""
    return points[:, 0] if isinstance(points, np.ndarray) and points.ndim == 2 else points


def write(given: Any, other: Any, draw: Draw) -> None:
    """Write a cloud with an attribute, and read it back."""
    suffix = draw.one(sorted({".las", ".laz", ".ply", ".pcd", ".npy", ".npz", ".xyz", ".pts", ".csv"}))
    attribute = draw.one((np.arange(len(given)), other, given, draw.number(1.0)))
    cloud = tmchho.PointCloud(given, {draw.one(("intensity", "red", "x", "", "a b")): attribute})
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"a{suffix}"
        try:
            tmchho.write(cloud, path)
            tmchho.read(path)
        finally:
            left = [name for name in os.listdir(folder) if name != path.name]
            assert not left, left


def told(given: Any, _other: Any, draw: Draw) -> None:
    """Tell a search hostile values."""
    search = tmchho.Optimizer([(-1, 1)] * 3, **draw.options(population_size=5, n_iterations=4, seed=3))
    for _ in range(6):
        if search.done:
            break
        asked = search.ask()
        search.tell(draw.one(([draw.number(1.0)] * len(asked), draw.rng.choice(SPECIAL, len(asked)), given)))


def known(given: Any, other: Any, draw: Draw) -> None:
    """Say hostile things of the pose."""
    prior = tmchho.PosePrior(draw.matrix(), **draw.options(rotation_rad=[0.1] * 3, translation_m=[0.1] * 3))
    three = draw.one(([1.0, 2.0, 3.0], given, [draw.number(0.5)] * 3))
    points = [tmchho.ControlPoint([0.0, 0.0, 0.0], three, draw.number(0.1)) for _ in range(3)]
    tmchho.icp(given, other, prior=prior, control_points=points)


def station(given: Any, other: Any, draw: Draw) -> None:
    """Describe two stations; of what is no network, nothing is begun."""
    for cloud in (given, other):
        name, pose = draw.one(("a", "b", "../a", draw.number(1.0))), draw.one((None, draw.matrix()))
        three = draw.one((None, None, given, [draw.number(0.5)] * 3))
        tmchho.Station(name, cloud, pose=pose, position=three, **draw.options(fixed=True))


# Weight, name, call; what takes long comes seldom.
CALLS: tuple[tuple[int, str, Call], ...] = (
    (
        8,
        "remove_outliers",
        lambda a, b, d: tmchho.remove_outliers(a, **d.options(radius=0.5, min_neighbors=3)),
    ),
    (8, "voxel_downsample", lambda a, b, d: tmchho.voxel_downsample(a, d.number(0.3))),
    (
        6,
        "iss_keypoints",
        lambda a, b, d: tmchho.iss_keypoints(
            a, radius=d.number(0.5), **d.options(min_neighbors=3, non_max_radius=0.4)
        ),
    ),
    (8, "estimate_normals", lambda a, b, d: tmchho.estimate_normals(a, **d.options(n_neighbors=8))),
    (8, "median_spacing", lambda a, b, d: tmchho.median_spacing(a)),
    (8, "nearest_distances", lambda a, b, d: tmchho.nearest_distances(a, b)),
    (8, "kabsch", lambda a, b, d: tmchho.kabsch(a, b)),
    (
        6,
        "rms_fitness",
        lambda a, b, d: tmchho.rms_fitness(a, b, d.one((np.zeros(6), a, [d.number(1.0)] * 6))),
    ),
    (
        4,
        "icp",
        lambda a, b, d: tmchho.icp(a, b, init=d.matrix(), **d.options(max_distance=2.0, kept_share=0.7)),
    ),
    (4, "fuse", lambda a, b, d: tmchho.fuse(a, b, d.matrix(), **d.options(hole_radius=0.5))),
    (
        4,
        "evaluate",
        lambda a, b, d: tmchho.evaluate(
            a,
            b,
            d.matrix(),
            method=d.one(("nearest", "plane", "normal", "vertical", "x")),
            areas=d.one((None, "automatic")),
            **d.options(tolerance=0.1, max_distance=1.0, n_neighbors=6),
        ),
    ),
    (
        4,
        "m3c2",
        lambda a, b, d: tmchho.m3c2(
            a,
            b,
            d.matrix(),
            **d.options(cylinder_radius=0.5, max_depth=2.0, registration_error=0.1, min_points=3),
        ),
    ),
    (6, "euler_to_matrix", lambda a, b, d: tmchho.euler_to_matrix(d.one((a, [d.number(0.3)] * 6)))),
    (6, "matrix_to_euler", lambda a, b, d: tmchho.matrix_to_euler(d.matrix())),
    (4, "chaotic_sequence", lambda a, b, d: tmchho.chaotic_sequence(d.number(9), **d.options(seed=3))),
    (4, "levy_steps", lambda a, b, d: tmchho.levy_steps(d.number(9), **d.options(seed=3, factor=0.1))),
    (4, "benchmark_value", lambda a, b, d: tmchho.benchmark_value(d.one(("f1", "x")), d.one((a, column(a))))),
    (4, "Transform", lambda a, b, d: tmchho.Transform.of(d.matrix()).apply(a)),
    (4, "PointCloud", lambda a, b, d: tmchho.moved(tmchho.PointCloud(a), d.matrix())),
    (2, "DistanceStatistics", lambda a, b, d: tmchho.DistanceStatistics.of(d.one((a, column(a))))),
    (3, "write", write),
    (2, "Optimizer", told),
    (2, "Station", station),
    (2, "PosePrior, ControlPoint", known),
    (
        1,
        "minimize",
        lambda a, b, d: tmchho.minimize(
            lambda x: d.number(float(np.sum(x))),
            d.one(([(-1, 1)] * 2, a, [(d.number(-1.0), d.number(1.0))])),
            **{"max_evaluations": 60, **d.options(population_size=5, seed=3)},
        ),
    ),
    (
        1,
        "register",
        lambda a, b, d: tmchho.register(
            a, b, seed=d.number(0), config={"voxel": d.options(voxel_size_m=0.3)}
        ),
    ),
)
WEIGHTS = np.array([weight for weight, _, _ in CALLS], dtype=float)


def run_case(number: int) -> str | None:
    """Run a case; return what is wrong with how it ended, None where nothing is."""
    draw = Draw(number)
    _, name, call = CALLS[int(draw.rng.choice(len(CALLS), p=WEIGHTS / WEIGHTS.sum()))]
    first = draw.cloud()
    second = first if draw.rng.random() < 0.2 else draw.cloud()
    before = [bytes_of(given) for given in (first, second)]
    try:
        with patience(), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            call(first, second, draw)
    except tmchho.TmchhoError as error:
        if type(error) is tmchho.TmchhoError:
            return f"case {number}: {name}: panic: {error}"
    except (TypeError, ValueError, MemoryError):
        pass
    except BaseException as error:
        return f"case {number}: {name}: {type(error).__name__}: {error}"
    if [bytes_of(given) for given in (first, second)] != before:
        return f"case {number}: {name}: changed what it was given"
    return None


def bytes_of(given: Any) -> bytes | None:
    """Return the bytes of an array of numbers of some size."""
    is_array = isinstance(given, np.ndarray) and given.dtype != object and given.size < 10**6
    return given.tobytes() if is_array else None


@contextmanager
def patience() -> Iterator[None]:
    """Raise `TimeoutError` in the block after some time."""

    def give_up(_number: int, _frame: object) -> None:
        raise TimeoutError(f"no answer within {PATIENCE_S} s")

    before = signal.signal(signal.SIGALRM, give_up)
    signal.alarm(PATIENCE_S)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def run_some(start: int, stop: int, at: Any, found: Any) -> None:
    """Run cases within a process of their own; `at` tells which one is running."""
    faulthandler.enable()
    logging.disable(logging.ERROR)
    resource.setrlimit(resource.RLIMIT_AS, (ADDRESS_SPACE, ADDRESS_SPACE))
    for number in range(start, stop):
        at.value = number
        problem = run_case(number)
        if problem is not None:
            found.put(problem)


def problems(start: int, stop: int) -> list[str]:
    """Run cases and return what is wrong with them."""
    context = multiprocessing.get_context("spawn")
    wrong: list[str] = []
    while start < stop:
        last = min(start + CASES_PER_PROCESS, stop)
        at, found = context.Value("q", start), context.Queue()
        process = context.Process(target=run_some, args=(start, last, at, found))
        process.start()
        process.join()
        while not found.empty():
            wrong.append(found.get())
        if process.exitcode != 0:
            wrong.append(f"case {at.value}: the process ended with {process.exitcode}")
            last = at.value + 1
        start = last
    return wrong


def problems_of_files(n_files: int, seed: int) -> list[str]:
    """Damage so many files of each kind; return what went wrong."""
    sys.path.insert(0, str(MUTATIONS.parent))
    from mutations import MAKERS

    wrong = []
    # One arena: else every thread of the allocator reserves address space, which the limit would count.
    environment = {**os.environ, "MALLOC_ARENA_MAX": "1"}
    for name in MAKERS:
        command = [sys.executable, "-W", "ignore", str(MUTATIONS), name, str(n_files), str(seed)]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            wrong.append(f"{name}: {done.stderr[-2000:]}")
            continue
        found = json.loads(done.stdout.splitlines()[-1])
        print(f"{name}: {n_files} files, {found['n_read']} read all the same", flush=True)
    return wrong


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--cases", type=int, default=100_000)
    parser.add_argument("--files", type=int, default=3000, help="damaged files of each kind")
    parser.add_argument("--start", type=int, default=0, help="number of the first case")
    parser.add_argument("--only", type=int, help="run this case alone, in this process")
    arguments = parser.parse_args()
    if arguments.only is not None:
        print(run_case(arguments.only) or "passed")
        return
    began = time.perf_counter()
    wrong = problems(arguments.start, arguments.start + arguments.cases)
    if arguments.files:
        wrong += problems_of_files(arguments.files, arguments.start)
    print(
        "\n".join(
            [
                *wrong,
                f"{arguments.cases} cases and files, {len(wrong)} wrong, {time.perf_counter() - began:.0f} s",
            ]
        )
    )
    raise SystemExit(bool(wrong))


if __name__ == "__main__":
    main()
