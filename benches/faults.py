"""Faults put into registrations on purpose: kills, interrupts, full disks, little memory, two runs at once.

    python benches/faults.py --folder out/faults --kills 60 --interrupts 60

Each registration is a process of its own. After a fault there must be no half of a result under a name of a
result, inputs must have their bytes, and a rerun must give what an undisturbed run gives. The first
violation ends the script with exit code 1.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import random
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import tmchho
from tmchho.outputs import OUTPUTS, RESULT
from tmchho.simulate import make_pair

PATIENCE_S = 300
STOPS_WITHIN_S = 1.0


class Faults:
    """Two small files, what registering them gives, and ways to disturb that.

    Parameters
    ----------
    folder : Path
        For the files and everything that comes of them.
    options : sequence of str
        Further words of the command line.
    """

    def __init__(self, folder: Path, *options: str) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.folder, self.options = folder, options
        pair = make_pair(n_photogrammetry_points=12_000, n_scanner_points=9_000, area_ratio=1.2, seed=0)
        self.inputs = folder / "source.laz", folder / "target.laz"
        for path, cloud in zip(self.inputs, (pair.source, pair.target), strict=True):
            tmchho.write(cloud, path, overwrite=True)
        self.checksums = self._checksums()
        began = time.perf_counter()
        done = self.run(folder / "undisturbed")
        self.seconds = time.perf_counter() - began
        assert done.returncode == 0, done.stderr
        self.wanted = self.result(folder / "undisturbed")

    def command(self, out: Path, *more: str) -> list[str]:
        """Return the words that register the two files."""
        words = [sys.executable, "-m", "tmchho", "register", *map(str, self.inputs), "-o", str(out)]
        return [*words, "--no-report", "--quiet", *self.options, *more]

    def run(self, out: Path, *more: str, before: Any = None) -> subprocess.CompletedProcess[str]:
        """Register; `before` runs in the child first."""
        return subprocess.run(
            self.command(out, *more),
            capture_output=True,
            text=True,
            timeout=PATIENCE_S,
            check=False,
            preexec_fn=before,
        )

    def result(self, out: Path) -> dict[str, Any]:
        """Return what ``result.json`` says, but for times and the command; it must be whole."""
        document: dict[str, Any] = json.loads((out / RESULT).read_text(encoding="utf-8"))
        return without_seconds({key: value for key, value in document.items() if key != "command"})

    def disturbed(self, out: Path, number: signal.Signals, after_s: float) -> tuple[int, float]:
        """Send a signal to a run after some time; return its exit code and how long it took to end."""
        process = subprocess.Popen(
            self.command(out, "--overwrite"), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        time.sleep(after_s)
        process.send_signal(number)
        began = time.perf_counter()
        code = process.wait(timeout=PATIENCE_S)
        return code, time.perf_counter() - began

    def check(self, out: Path) -> None:
        """Raise unless everything under a name of a result is whole, and the inputs are as they were."""
        assert self._checksums() == self.checksums, "an input was touched"
        if not out.exists():
            return
        for path in out.iterdir():
            if path.name.startswith("."):
                continue  # of a process that was killed; the next run clears it away
            assert path.name in OUTPUTS, f"{path.name} should not be there"
            if path.suffix == ".laz":
                tmchho.read(path)
            elif path.suffix == ".json":
                json.loads(path.read_text(encoding="utf-8"))
        if (out / RESULT).exists():
            assert self.result(out) == self.wanted
            assert sorted(p.name for p in out.iterdir() if p.name[0] != ".") == sorted(OUTPUTS)

    def check_rerun(self, out: Path) -> None:
        """Raise unless a run after the fault gives what an undisturbed one does, and leaves nothing else."""
        done = self.run(out, "--overwrite")
        assert done.returncode == 0, done.stderr
        assert self.result(out) == self.wanted
        assert sorted(path.name for path in out.iterdir()) == sorted(OUTPUTS)

    def _checksums(self) -> list[str]:
        return [hashlib.sha256(path.read_bytes()).hexdigest() for path in self.inputs]


def without_seconds(value: Any) -> Any:
    """Return a document without its times."""
    if isinstance(value, dict):
        return {key: without_seconds(item) for key, item in value.items() if key != "seconds"}
    return [without_seconds(item) for item in value] if isinstance(value, list) else value


def kills(faults: Faults, n: int, rng: random.Random) -> str:
    """Kill runs at random moments, each followed by a look and now and then by a rerun."""
    n_unfinished = 0
    for number in range(n):
        out = faults.folder / f"killed{number % 4}"
        code, _ = faults.disturbed(out, signal.SIGKILL, rng.uniform(0, 1.05 * faults.seconds))
        n_unfinished += code != 0
        faults.check(out)
        if number % 4 == 3:
            faults.check_rerun(out)
    return f"{n} kills, {n_unfinished} before the end: no half of a result, reruns as undisturbed"


def interrupts(faults: Faults, n: int, rng: random.Random, within_s: float | None = STOPS_WITHIN_S) -> str:
    """Interrupt runs at random moments: they stop soon, say 130 and leave nothing."""
    longest, n_stopped = 0.0, 0
    starting_s = 0.15 * faults.seconds  # before, the interpreter is loading, and Python itself answers
    for number in range(n):
        out = faults.folder / f"interrupted{number}"
        code, seconds = faults.disturbed(out, signal.SIGINT, rng.uniform(starting_s, faults.seconds))
        assert code in (0, 130, 1, -signal.SIGINT), code
        if code != 0:
            n_stopped += 1
            longest = max(longest, seconds)
            assert not out.exists(), sorted(out.iterdir())
        faults.check(out)
    assert within_s is None or longest < within_s, f"one took {longest:.2f} s"
    return f"{n} interrupts, {n_stopped} before the end: nothing left, the longest took {longest:.2f} s"


def full_disks(faults: Faults) -> str:
    """Let files grow to some size only: exit 5, one sentence, nothing left."""
    for n_bytes in (1, 1_000, 50_000, 200_000):
        out = faults.folder / f"full{n_bytes}"

        def limited(n_bytes: int = n_bytes) -> None:
            signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
            resource.setrlimit(resource.RLIMIT_FSIZE, (n_bytes, n_bytes))

        done = faults.run(out, before=limited)
        assert done.returncode == 5, (done.returncode, done.stderr)
        assert "Traceback" not in done.stderr
        assert not out.exists()
    return "full disks: exit 5, nothing left"


def little_memory(faults: Faults) -> str:
    """Limit the address space: a run ends well or with exit 6 and a figure, never otherwise."""
    codes = []
    for megabytes in (230, 260, 300, 400, 800):
        out = faults.folder / f"little{megabytes}"

        def limited(n_bytes: int = megabytes * 1_000_000) -> None:
            resource.setrlimit(resource.RLIMIT_AS, (n_bytes, n_bytes))

        done = faults.run(out, before=limited)
        codes.append(done.returncode)
        assert done.returncode in (0, 6), (megabytes, done.returncode, done.stderr)
        faults.check(out)
    return f"little memory: exit codes {codes}"


def two_at_once(faults: Faults, n: int) -> str:
    """Start two runs into one folder at the same time: one result, whole, and a refusal or two of a kind."""
    for number in range(n):
        for more in ((), ("--overwrite",)):
            out = faults.folder / f"both{number}{len(more)}"
            both = [
                subprocess.Popen(
                    faults.command(out, *more), stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
                )
                for _ in range(2)
            ]
            ended = [(process.communicate(timeout=PATIENCE_S)[1], process.returncode) for process in both]
            codes = sorted(code for _, code in ended)
            assert codes == ([0, 0] if more else [0, 5]), ended
            faults.check(out)
            assert sorted(path.name for path in out.iterdir()) == sorted(OUTPUTS)
    return f"two runs into one folder, {2 * n} times: one whole result"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--folder", type=Path, required=True, help="for the files and the results")
    parser.add_argument("--kills", type=int, default=60)
    parser.add_argument("--interrupts", type=int, default=60)
    parser.add_argument("--pairs", type=int, default=5, help="how often two runs start at once")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    rng = random.Random(arguments.seed)
    faults = Faults(arguments.folder)
    print(f"an undisturbed run takes {faults.seconds:.1f} s; load {os.getloadavg()[0]:.1f}", flush=True)
    print(kills(faults, arguments.kills, rng), flush=True)
    print(interrupts(faults, arguments.interrupts, rng), flush=True)
    print(full_disks(faults), flush=True)
    print(little_memory(faults), flush=True)
    print(two_at_once(faults, arguments.pairs), flush=True)


if __name__ == "__main__":
    main()
