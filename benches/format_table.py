"""Read every file of a folder, each in a process of its own, and write the table of docs/formats.md.

    python benches/format_table.py FOLDER [docs/formats.md]

Every process may take 60 s and ten times the file's size plus 200 MB of memory; `INDEX.tsv` of the folder
says what other readers make of the files. Without a document the table goes to the terminal. Linux only.
"""

from __future__ import annotations

import contextlib
import importlib
import json
import multiprocessing
import re
import resource
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import tmchho

MAX_SECONDS = 60
MAX_TIMES_FILE, MAX_EXTRA_BYTES = 10, 200 * 2**20
START, END = "<!-- table: written by benches/format_table.py -->", "<!-- end of the table -->"
ROUNDED = 0.005001  # the index holds two digits, and headers are off by up to a step of their grid


@dataclass(frozen=True)
class Row:
    """What became of one file."""

    name: str
    n_bytes: int
    found: dict[str, Any]  # n_points, box and step, or refusal; seconds and peak_bytes
    told: str  # the line of the index


def read_in_child(path: Path, pipe: Connection) -> None:
    """Read one file under the limits and send what came out."""
    before = resident_bytes()
    limit = virtual_bytes() + MAX_TIMES_FILE * path.stat().st_size + MAX_EXTRA_BYTES
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    start = time.perf_counter()
    found: dict[str, Any] = {}
    try:
        cloud = tmchho.read(path)
        box = [float(value) for value in (*cloud.xyz.min(axis=0), *cloud.xyz.max(axis=0))]
        header = cloud.metadata.get("header")
        step = max(map(abs, header.scales)) if header is not None else 0.0
        found = {"n_points": len(cloud), "box": box, "step": step}
    except tmchho.errors.TmchhoError as error:
        found = {"refusal": str(error).removeprefix(f"{path}: "), "class": type(error).__name__}
    found["seconds"] = time.perf_counter() - start
    found["peak_bytes"] = max(0, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 - before)
    pipe.send(found)


def virtual_bytes() -> int:
    return int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()


def resident_bytes() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()


def outcomes(folder: Path) -> Iterator[Row]:
    """Read the files one after another."""
    told = dict(
        (line.split("\t")[0], line.split("\t")[3])
        for line in (folder / "INDEX.tsv").read_text().splitlines()[1:]
    )
    fork = multiprocessing.get_context("fork")  # nothing has used threads yet
    for name in sorted(told):
        path = folder / name
        ours, theirs = fork.Pipe(duplex=False)
        child = fork.Process(target=read_in_child, args=(path, theirs))
        child.start()
        theirs.close()
        found: dict[str, Any] = {"refusal": f"no answer after {MAX_SECONDS} s", "class": "HANG"}
        with contextlib.suppress(EOFError):
            if ours.poll(MAX_SECONDS):
                found = {"refusal": "the process ended", "class": "CRASH"}
                found = ours.recv()
        child.kill() if found.get("class") == "HANG" else child.join()
        yield Row(name, path.stat().st_size, found, told[name])


def judgement(row: Row) -> str:
    """Compare with what the index says: number of points and box."""
    counts = [int(count) for count in re.findall(r"\bn=(\d+)", row.told)]
    is_read = "n_points" in row.found
    if not sum(counts):
        return "others find none" if row.told.startswith("ERR") or counts else ""
    if not is_read:
        return f"others find {sum(counts)}"
    if row.found["n_points"] != sum(counts):
        return f"others count {sum(counts)}"
    box = re.search(r"bbox \[(.*)\]\.\.\[(.*?)\]", row.told)
    if box is None:
        return "count agrees"
    numbers = [float(word) for word in ", ".join(box.groups()).split(", ")]
    slack = ROUNDED + row.found["step"]
    agrees = all(abs(a - b) < slack for a, b in zip(numbers, row.found["box"], strict=True))
    return "count and box agree" if agrees else "box is not that of the header"


def line_of(row: Row) -> str:
    found = row.found
    if "n_points" in found:
        lowest, highest = (", ".join(f"{value:.2f}" for value in found["box"][at : at + 3]) for at in (0, 3))
        result = f"{found['n_points']} points, {lowest} .. {highest}"
    else:
        result = f"{found['class']}: {found['refusal']}".replace("|", "\\|")
    measured = (
        f"{found['seconds'] * 1000:.0f} | {found['peak_bytes'] / 2**20:.1f}" if "seconds" in found else "| |"
    )
    return f"| {row.name} | {row.n_bytes} | {result} | {judgement(row)} | {measured} |"


def table(rows: list[Row]) -> str:
    n_read = sum("n_points" in row.found for row in rows)
    measured = [row for row in rows if "seconds" in row.found]
    widest = max(measured, key=lambda row: row.found["peak_bytes"] - MAX_TIMES_FILE * row.n_bytes)
    beyond = max(0, widest.found["peak_bytes"] - MAX_TIMES_FILE * widest.n_bytes)
    counted = [row for row in rows if sum(map(int, re.findall(r"\bn=(\d+)", row.told)))]
    n_agree = sum(judgement(row).endswith("agree") or judgement(row) == "count agrees" for row in counted)
    slowest = max(measured, key=lambda row: row.found["seconds"])
    summary = (
        f"{len(rows)} files: {n_read} read, {len(measured) - n_read} refused in a sentence, "
        f"{len(rows) - len(measured)} crashed or hung. Of the {len(counted)} in which another reader finds "
        f"points, {n_agree} agree in number and, where it is told, box. Most memory beyond ten times the "
        f"file: {beyond / 2**20:.0f} MB ({widest.name}). "
        f"Slowest: {slowest.found['seconds']:.2f} s ({slowest.name})."
    )
    head = "| file | bytes | read as | beside other readers | ms | MB |\n|---|---:|---|---|---:|---:|"
    return "\n".join([summary, "", head, *map(line_of, rows)])


def main(folder: Path, document: Path | None) -> None:
    for name in ("pye57.libe57", "pyproj"):  # loaded late by the readers; not the memory of a file
        importlib.import_module(name)
    rows = list(outcomes(folder))
    text = table(rows)
    if document is None:
        print(text)
        return
    before, _, rest = document.read_text().partition(START)
    _, _, after = rest.partition(END)
    document.write_text(f"{before}{START}\n{text}\n{END}{after}")
    print(text.partition("\n")[0])
    print(json.dumps({"crashed": [row.name for row in rows if "seconds" not in row.found]}))


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]) if len(sys.argv) > 2 else None)
