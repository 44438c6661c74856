"""What was measured, as Markdown tables and as JSON, with the machine and the versions it holds for."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import subprocess
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from kernel_peers import PACKAGES, US
from kernel_rows import ROUTE_MIB, ROUTE_SECONDS, Row
from kernel_run import Runs

if TYPE_CHECKING:
    from compare_peers import Measured

GAIN_WANTED = 1.6
# Above n·log n by no more than this.
GROWTH_SLACK = 1.25
QUIET_LOAD = 0.5


def machine(arguments: Sequence[str]) -> dict[str, Any]:
    """Return what the times hold for: processor, versions, commit, and how busy the machine is."""
    repository = Path(__file__).parent
    git = ["git", "-C", str(repository)]
    commit = subprocess.run(
        [*git, "rev-parse", "--short", "HEAD"], capture_output=True, text=True
    ).stdout.strip()
    changed = subprocess.run(
        [*git, "status", "--porcelain", "--untracked-files=no"], capture_output=True, text=True
    ).stdout
    names = [
        line.split(":", 1)[1].strip()
        for line in Path("/proc/cpuinfo").read_text().splitlines()
        if line.startswith("model name")
    ]
    versions = {}
    for name in ("numpy", *sorted(set(PACKAGES.values()))):
        try:
            versions[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            versions[name] = "not installed"
    return {
        "processor": names[0] if names else platform.processor(),
        "n_processors": len(os.sched_getaffinity(0)),
        "memory_gib": round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30, 1),
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        "commit": (commit or "unknown") + (" with changes" if changed else ""),
        "date": time.strftime("%Y-%m-%d", time.gmtime()),
        "load_before": os.getloadavg()[0],
        "arguments": " ".join(arguments),
        "versions": versions,
    }


def ms(seconds: float) -> str:
    return f"{1e3 * seconds:,.0f}".replace(",", " ") if np.isfinite(seconds) else "–"


def ratio_text(ratio: float) -> str:
    return f"{ratio:.2f}" if np.isfinite(ratio) else "–"


class Report:
    """Grows row by row; can be written at any time."""

    def __init__(self, machine: dict[str, Any], threads: Sequence[int], repeat: int) -> None:
        self._machine, self._threads, self._repeat = machine, list(threads), repeat
        self._measured: list[Measured] = []

    def add(self, measured: Measured) -> None:
        """Take one more row."""
        self._measured.append(measured)

    def as_json(self) -> dict[str, Any]:
        """Return every single time, with the machine."""
        rows = [
            {
                "group": measured.row.group,
                "title": measured.row.title,
                "n": measured.row.n,
                "at_least": measured.row.at_least,
                "library": run.library,
                "n_threads": n_threads,
                "seconds": run.seconds,
                "cpu_seconds": run.cpu_seconds,
                "peak_mib": run.peak_mib if np.isfinite(run.peak_mib) else None,
                "process_mib": run.process_mib if np.isfinite(run.process_mib) else None,
                "step": run.settings.get("step"),
                "failure": run.failure,
                "same": agreement.same if agreement else None,
                "answer": agreement.words if agreement else "",
            }
            for measured in self._measured
            for n_threads, some in measured.runs.items()
            for run in some
            for agreement in [measured.agreements.get((run.library, n_threads))]
        ]
        return {"machine": self._machine, "rows": rows}

    def markdown(self) -> str:
        """Return the tables."""
        beside = [m for m in self._measured if m.row.group not in ("growth", "route")]
        route = [m for m in self._measured if m.row.group == "route"]
        growth = [m for m in self._measured if m.row.group == "growth"]
        parts = [self._head()]
        if beside:
            parts += [self._summary(beside)]
        if route:
            parts += [self._route(route)]
        if growth:
            parts += [self._growth(growth)]
        if beside:
            parts += [self._everything(beside)]
        return "\n\n".join(parts) + "\n"

    def _head(self) -> str:
        it = self._machine
        busy = it["load_before"] > QUIET_LOAD
        loaded = (
            f" **The machine was not quiet** (load {it['load_before']:.1f} before the run): ratios and the "
            "processor's seconds tell more than times."
            if busy
            else ""
        )
        versions = ", ".join(f"{name} {version}" for name, version in it["versions"].items())
        return (
            "# Kernels beside their peers\n\n"
            f"Written by `{' '.join(['python benches/compare_peers.py', it['arguments']]).strip()}` "
            f"at commit {it['commit']}, {it['date']}, on {it['n_processors']} processors "
            f"({it['processor']}, {it['memory_gib']} GiB, {it['system']}, "
            f"Python {it['python']}): {versions}. Medians of {self._repeat} rounds.{loaded} "
            "What is measured and how stands at the top of that file."
        )

    def _summary(self, every: Sequence[Measured]) -> str:
        most = max(self._threads)
        times = [f"ours ms, {n} {'threads' if n > 1 else 'thread'}" for n in self._threads]
        heads = [
            "kernel",
            "points",
            *times,
            *(["gain by the second"] if self._has_gain else []),
            f"fastest peer, {most} threads",
            "ms",
            *[f"ratio, {n}" for n in self._threads],
            "of CPU",
            "wanted",
            "met",
            "ours MiB",
            "peer MiB",
            "faster with another answer",
        ]
        lines = [line_of(heads), line_of(["---"] * len(heads))]
        for measured in every:
            cells = [measured.row.title, measured.row.size]
            cells += [ms(median_of(measured, US, n)) for n in self._threads]
            if self._has_gain:
                cells.append(ratio_text(median_of(measured, US, 1) / median_of(measured, US, 2)))
            best = {n: fastest(measured, n, same=True) for n in self._threads}
            ours, peer = run_of(measured, US, most), best[most]
            cells += [peer.library, ms(peer.median)] if peer else ["none", "–"]
            ratios = {
                n: run.median / median_of(measured, US, n) if run else float("nan") for n, run in best.items()
            }
            cells += [ratio_text(ratio) for ratio in ratios.values()]
            cells.append(ratio_text(peer.cpu_median / ours.cpu_median) if peer and ours else "–")
            wanted = measured.row.at_least
            cells += [f"{wanted:g}", "yes" if wanted is not None and ratios[most] >= wanted else "**no**"]
            cells += [f"{ours.peak_mib:.0f}" if ours else "–", f"{peer.peak_mib:.0f}" if peer else "–"]
            other = fastest(measured, most, same=False)
            if other is not None and (peer is None or other.median < peer.median):
                cells.append(f"{other.library} {ratio_text(other.median / median_of(measured, US, most))}")
            else:
                cells.append("")
            lines.append(line_of(cells))
        return "## Fastest peer's median by ours\n\n" + "\n".join(lines)

    @property
    def _has_gain(self) -> bool:
        return {1, 2} <= set(self._threads)

    def _route(self, every: Sequence[Measured]) -> str:
        heads = ["route", "threads", "s", "CPU s", "peak of the process MiB", "wanted", "met", "answer"]
        lines = [line_of(heads), line_of(["---"] * len(heads))]
        wanted = f"{ROUTE_SECONDS:g} s, {ROUTE_MIB:.0f} MiB"
        for measured in every:
            for n_threads, runs in measured.runs.items():
                for run in runs:
                    agreement = measured.agreements.get((run.library, n_threads))
                    right = agreement is not None and agreement.same
                    met = right and run.median < ROUTE_SECONDS and run.process_mib < ROUTE_MIB
                    cells = [f"{measured.row.title} {measured.row.size}", str(n_threads)]
                    cells += [f"{run.median:.1f}", f"{run.cpu_median:.1f}", f"{run.process_mib:.0f}", wanted]
                    cells += [
                        "yes" if met else "**no**",
                        run.failure or (agreement.words if agreement else ""),
                    ]
                    lines.append(line_of(cells))
        return "## The whole route, which no peer has\n\n" + "\n".join(lines)

    def _growth(self, every: Sequence[Measured]) -> str:
        heads = ["kernel", "points", "ms", "CPU ms", "ns per point", "by n·log n from the smallest", "met"]
        heads += ["MiB", "bytes per point"]
        lines = [line_of(heads), line_of(["---"] * len(heads))]
        first: dict[str, tuple[Row, float]] = {}
        for measured in every:
            row = measured.row
            (run,) = next(iter(measured.runs.values()))
            start, seconds = first.setdefault(row.title, (row, run.median))
            by = run.median / seconds / (row.n * np.log(row.n)) * (start.n * np.log(start.n))
            cells = [row.title, row.size, ms(run.median), ms(run.cpu_median)]
            cells += [f"{1e9 * run.median / row.n:.0f}", ratio_text(by)]
            cells.append("yes" if by <= GROWTH_SLACK else f"**no** {run.failure}".rstrip())
            cells += [f"{run.peak_mib:.0f}", f"{run.peak_mib * 2**20 / row.n:.0f}"]
            lines.append(line_of(cells))
        return "## Growth\n\n" + "\n".join(lines)

    def _everything(self, every: Sequence[Measured]) -> str:
        heads = ["kernel", "points", "library"]
        heads += [f"ms (CPU ms), {n} {'threads' if n > 1 else 'thread'}" for n in self._threads]
        heads += [f"by ours, {n}" for n in self._threads] + ["MiB", "same", "answer"]
        lines = [line_of(heads), line_of(["---"] * len(heads))]
        most = max(self._threads)
        for measured in every:
            for last in sorted(measured.runs[most], key=lambda run: (not run.seconds, run.median)):
                name = last.library
                runs = [run_of(measured, name, n) for n in self._threads]
                agreement = measured.agreements.get((name, most))
                cells = [measured.row.title, measured.row.size, name]
                cells += [f"{ms(run.median)} ({ms(run.cpu_median)})" if run else "–" for run in runs]
                cells += [
                    ratio_text(run.median / median_of(measured, US, run.n_threads)) if run else "–"
                    for run in runs
                ]
                cells.append(f"{last.peak_mib:.0f}" if last.answer else "–")
                cells.append("yes" if agreement and agreement.same else "no")
                cells.append(last.failure or (agreement.words if agreement else ""))
                lines.append(line_of(cells))
            for module in measured.missing:
                blank = ["–"] * (2 * len(self._threads) + 1)
                title, size = measured.row.title, measured.row.size
                lines.append(line_of([title, size, module, *blank, "no", "not installed"]))
        return "## Every library\n\n" + "\n".join(lines)


def line_of(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"


def run_of(measured: Measured, library: str, n_threads: int) -> Runs | None:
    return next((run for run in measured.runs[n_threads] if run.library == library), None)


def median_of(measured: Measured, library: str, n_threads: int) -> float:
    run = run_of(measured, library, n_threads)
    return run.median if run else float("nan")


def fastest(measured: Measured, n_threads: int, same: bool) -> Runs | None:
    """Return the fastest peer whose answer is the same, or is not."""
    runs = [
        run
        for run in measured.runs[n_threads]
        if run.library != US
        and run.seconds
        and not run.failure
        and (run.library, n_threads) in measured.agreements
        and measured.agreements[run.library, n_threads].same == same
    ]
    return min(runs, key=lambda run: run.median, default=None)
