"""Faults put into registrations on purpose: kills, interrupts, full disks, little memory, inputs that change.

    python benches/faults.py --folder out/faults --kills 60 --interrupts 60 --changes 40

Each registration is a process of its own. After a fault there must be no half of a result under a name of a
result, inputs must have their bytes, and a rerun must give what an undisturbed run gives. The first
violation ends the script with exit code 1. Small file systems, which root may mount, are filled up for good;
others get a limit on the size of files. To be started in the foreground: what a shell starts in the
background may ignore interrupts.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import random
import re
import resource
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import tmchho
from tmchho.outputs import OUTPUTS, RESULT
from tmchho.simulate import make_pair

PATIENCE_S = 300
STOPS_WITHIN_S = 1.0
INTERRUPTED = 130
# Runs the command on files in parts, however small they are.
IN_PARTS = (
    "import sys; from tmchho.streams import memory; memory._BYTES_PER_POINT = 10**6; "
    "from tmchho.cli import main; main(sys.argv[1:])"
)
# Root may write everywhere, but for a right that can be given up.
AS_A_USER = ("setpriv", "--bounding-set=-dac_override") if os.geteuid() == 0 else ()


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
        began = time.perf_counter()
        subprocess.run([sys.executable, "-m", "tmchho", "--version"], capture_output=True, check=True)
        self.loading_s = time.perf_counter() - began

    def command(self, out: Path, *more: str, in_parts: bool = False) -> list[str]:
        """Return the words that register the two files."""
        program = ["-c", IN_PARTS] if in_parts else ["-m", "tmchho"]
        words = [sys.executable, *program, "register", *map(str, self.inputs), "-o", str(out)]
        return [*words, "--no-report", "--quiet", *self.options, *more]

    def run(
        self, out: Path, *more: str, before: Any = None, within: tuple[str, ...] = ()
    ) -> subprocess.CompletedProcess[str]:
        """Register; `before` runs in the child first, `within` are words in front of the command."""
        return subprocess.run(
            [*within, *self.command(out, *more)],
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
    """Kill runs at random moments, each followed by a look and, but for every fifth, a rerun."""
    n_unfinished = 0
    for number in range(n):
        out = faults.folder / f"killed{number % 4}"
        code, _ = faults.disturbed(out, signal.SIGKILL, rng.uniform(0, 1.05 * faults.seconds))
        n_unfinished += code != 0
        faults.check(out)
        if number % 5:
            faults.check_rerun(out)
    return f"{n} kills, {n_unfinished} before the end: no half of a result, reruns as undisturbed"


def interrupts(faults: Faults, n: int, rng: random.Random, within_s: float | None = STOPS_WITHIN_S) -> str:
    """Interrupt runs at random moments, every third politely (SIGTERM): they stop soon and leave nothing."""
    took, ends = list[tuple[float, float]](), Counter[str]()
    for index in range(n):
        number = signal.SIGTERM if index % 3 == 2 else signal.SIGINT
        out = faults.folder / f"interrupted{index}"
        after_s = rng.uniform(0, faults.seconds)
        code, seconds = faults.disturbed(out, number, after_s)
        if code != 0:
            # Before the command takes over and after it is done Python answers: by the signal, or with 1.
            is_done = (out / RESULT).exists()
            is_outside = code in (-number, 1) and (is_done or after_s < 2 * faults.loading_s)
            assert is_outside or code == INTERRUPTED, (code, after_s)
            ends["at the very end" if is_done else "while loading" if is_outside else "with 130"] += 1
            took.append((seconds, after_s))
            assert not out.exists() or is_done, sorted(out.iterdir())
        faults.check(out)
    assert took, "every run was over before it was interrupted"
    took.sort()
    (usual_s, _), (longest_s, after_s) = took[len(took) // 2], took[-1]
    words = ", ".join(f"{count} {end}" for end, count in sorted(ends.items()))
    told = f"usually {usual_s:.2f} s, at most {longest_s:.2f} s (begun {after_s:.1f} s before)"
    assert within_s is None or longest_s < within_s, told
    return f"{n} interrupts, {words}: nothing left; {told}"


def full_disks(faults: Faults) -> str:
    """Let the disk be full at some size: exit 5, one sentence, nothing left."""
    for n_bytes in (1, 1_000, 50_000, 200_000):
        out = faults.folder / f"full{n_bytes}"

        def limited(n_bytes: int = n_bytes) -> None:
            signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
            resource.setrlimit(resource.RLIMIT_FSIZE, (n_bytes, n_bytes))

        assert_not_written(faults.run(out, before=limited), "File too large")
        assert not out.exists()
    n_mounted = 0
    for kilobytes in (8, 64, 200, 500):
        with mounted(faults.folder / "disk", f"size={kilobytes}k") as disk:
            if disk is not None:
                n_mounted += 1
                assert_not_written(faults.run(disk / "out"), "No space left on device")
                assert not list(disk.iterdir())
    return f"full disks, 4 by a limit and {n_mounted} by a small file system: exit 5, nothing left"


def read_only(faults: Faults) -> str:
    """Take the right to write away, of the folder and of a whole file system."""
    folder = faults.folder / "kept"
    folder.mkdir(exist_ok=True)
    folder.chmod(0o500)
    n_tried = 0
    if not AS_A_USER or shutil.which(AS_A_USER[0]):
        n_tried += 1
        for out in (folder, folder / "out"):
            assert_not_written(faults.run(out, within=AS_A_USER), "Permission denied")
    with mounted(faults.folder / "disk", "ro") as disk:
        if disk is not None:
            n_tried += 1
            assert_not_written(faults.run(disk / "out"), "Read-only file system")
    assert not list(folder.iterdir())
    return f"{n_tried} of 2 kinds of read-only folders: exit 5, nothing left"


def assert_not_written(done: subprocess.CompletedProcess[str], words: str) -> None:
    assert done.returncode == 5, (done.returncode, done.stderr)
    assert "Traceback" not in done.stderr
    assert words in done.stderr, done.stderr


@contextmanager
def mounted(folder: Path, options: str) -> Iterator[Path | None]:
    """Lend a file system in memory with these options; None where that is not allowed."""
    folder.mkdir(exist_ok=True)
    command = ["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(folder)]
    is_mounted = (
        shutil.which("mount") is not None
        and subprocess.run(command, capture_output=True, check=False).returncode == 0
    )
    try:
        yield folder if is_mounted else None
    finally:
        if is_mounted:
            subprocess.run(["umount", str(folder)], check=True)


def changes(faults: Faults, n: int, rng: random.Random) -> str:
    """Cut off, damage or replace an input at random moments, in whole files and in parts."""
    codes = Counter[int]()
    for number in range(n):
        out, path = faults.folder / f"changed{number}", faults.inputs[number % 2]
        kept = path.read_bytes()
        in_parts = number % 4 > 1
        process = subprocess.Popen(
            faults.command(out, in_parts=in_parts),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
        )
        time.sleep(rng.uniform(0.1, 1.0) * faults.seconds)
        how = rng.choice(("cut", "damage", "replace", "remove"))
        change(path, kept, how, rng)
        told = process.communicate(timeout=PATIENCE_S)[1]
        path.write_bytes(kept)
        codes[process.returncode] += 1
        # It was read before, or it is refused; a replaced file may also have been read whole.
        assert process.returncode in (0, 3), (how, in_parts, process.returncode, told)
        assert "Traceback" not in told, told
        if process.returncode == 0:
            # Of the file as it was; one that was changed before it was opened has another checksum.
            side, document = ("source", "target")[number % 2], faults.result(out)
            is_of_ours = document["inputs"][side]["sha256"] == faults.checksums[number % 2]
            assert in_parts or not is_of_ours or document == faults.wanted
        else:
            assert path.name in told, told
            assert not out.exists(), sorted(out.iterdir())
    told = ", ".join(f"{count} ended with {code}" for code, count in sorted(codes.items()))
    return f"{n} inputs changed while a run was on: {told}; nothing of a changed input was written"


def change(path: Path, kept: bytes, how: str, rng: random.Random) -> None:
    """Do to a file what another program may do to it."""
    at = rng.randrange(len(kept))
    if how == "cut":
        os.truncate(path, at)
    elif how == "damage":
        with path.open("r+b") as stream:
            stream.seek(at)
            stream.write(rng.randbytes(200))
    elif how == "replace":
        other = path.with_name("other.laz")
        other.write_bytes(kept[:at])
        os.replace(other, path)
    else:
        path.unlink()


def little_memory(faults: Faults) -> str:
    """Limit the address space: a run ends well or with exit 6 and a figure, never otherwise."""
    codes = []
    for megabytes in (230, 260, 300, 350, 400, 500, 800):
        out = faults.folder / f"little{megabytes}"

        def limited(n_bytes: int = megabytes * 1_000_000) -> None:
            resource.setrlimit(resource.RLIMIT_AS, (n_bytes, n_bytes))

        done = faults.run(out, before=limited)
        codes.append(done.returncode)
        assert done.returncode in (0, 6), (megabytes, done.returncode, done.stderr)
        if done.returncode:
            assert re.search(r"(need|takes) about [\d.]+ [MG]B", done.stderr), done.stderr
            assert re.search(r"only [\d.]+ [MG]B more", done.stderr), done.stderr
            assert not out.exists()
        faults.check(out)
    # What is enough once is enough for good: no chance in which thread came to reserve what.
    assert codes == sorted(codes, reverse=True), codes
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
    parser.add_argument("--changes", type=int, default=40, help="how often an input changes meanwhile")
    parser.add_argument(
        "--pairs",
        type=int,
        default=5,
        help="how often two runs start at once; 0 leaves out disks and memory, too",
    )
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    rng = random.Random(arguments.seed)
    faults = Faults(arguments.folder)
    print(f"an undisturbed run takes {faults.seconds:.1f} s; load {os.getloadavg()[0]:.1f}", flush=True)
    for inject, n in (
        (kills, arguments.kills),
        (interrupts, arguments.interrupts),
        (changes, arguments.changes),
    ):
        if n:
            print(inject(faults, n, rng), flush=True)
    if arguments.pairs:
        print(full_disks(faults), flush=True)
        print(read_only(faults), flush=True)
        print(little_memory(faults), flush=True)
        print(two_at_once(faults, arguments.pairs), flush=True)


if __name__ == "__main__":
    main()
