"""`tmchho doctor`: what is installed here, what is missing, and whether it works."""

from __future__ import annotations

import importlib.util
import os
import platform
import time
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import click

from tmchho.cli.failures import INTERNAL, debug_option
from tmchho.cli.options import json_option

_PARTS = ("numpy", "laspy", "lazrs", "shapely", "click", "rich")
# Of each extra: what it needs, and what it gives.
_EXTRAS = {
    "crs": (("pyproj",), "coordinate reference systems compared by what they mean"),
    "areas": (("pyogrio", "pyproj"), "areas from shapefiles and GeoPackages"),
    "report": (("matplotlib", "jinja2"), "report.html, tmchho view and figures"),
    "e57": (("pye57",), "E57 files"),
    "network": (("scipy", "dask", "distributed", "threadpoolctl"), "networks of stations"),
    "paper": (
        ("matplotlib", "jinja2", "scipy", "cma", "threadpoolctl"),
        "the tables and figures of the paper",
    ),
}
_POINTS, _TOLERANCE = 3000, 1e-6

_EXAMPLES = """\b
Examples:
  tmchho doctor
  # to enclose with a question
  tmchho doctor --json > doctor.json

"""


@click.command(short_help="Tell what is installed, what is missing, and whether it works.", epilog=_EXAMPLES)
@json_option
@debug_option
def doctor(as_json: bool) -> None:
    """Tell the versions, extras, threads and memory, and find a known pose as a test.

    Ends with exit code 1 if the test fails; a missing extra is no failure.
    """
    from tmchho.outputs import json_text

    found = examine()
    if as_json:
        click.echo(json_text(found), nl=False)
    else:
        click.echo(_in_words(found))
    if not found["self_test"]["passed"]:
        click.get_current_context().exit(INTERNAL)


def examine() -> dict[str, Any]:
    """Return what `tmchho doctor` tells, ready for JSON.

    Returns
    -------
    dict
        ``versions``, ``extras`` (``has``, ``lacks``, ``gives``), ``threads``, ``memory`` in bytes (of the
        ``machine``, ``max_memory`` where nothing is said, ``limit``: what may still be taken, None without a
        limit), ``browser`` for PDF, and ``self_test`` (``passed``, ``error``, ``seconds``).
    """
    from tmchho import __version__
    from tmchho.report.browser import find_browser
    from tmchho.room import machine_memory, room_left
    from tmchho.streams import default_max_memory

    extras = {}
    for extra, (needs, gives) in _EXTRAS.items():
        lacks = [name for name in needs if importlib.util.find_spec(name) is None]
        extras[extra] = {"has": [name for name in needs if name not in lacks], "lacks": lacks, "gives": gives}
    browser = find_browser(required=False)
    return {
        "versions": {
            "tmchho": __version__,
            "python": platform.python_version(),
            "system": platform.platform(),
            **{name: _version(name) for name in _PARTS},
        },
        "extras": extras,
        "threads": _threads(),
        "memory": {
            "machine": machine_memory(),
            "max_memory": default_max_memory(),
            "limit": room_left(),
        },
        "browser": None if browser is None else str(browser),
        "self_test": _self_test(),
    }


def _version(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None


def _threads() -> int:
    """Return how many threads the core starts."""
    asked = os.environ.get("RAYON_NUM_THREADS", "")
    if asked.isdigit() and int(asked) > 0:
        return int(asked)
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _self_test() -> dict[str, Any]:
    """Move a small uneven cloud by a known pose, and look whether it is found."""
    import numpy as np

    from tmchho import Transform, register

    rng = np.random.default_rng(0)
    xy = rng.uniform(0, 10, (_POINTS, 2))
    bumps = rng.uniform(0, 10, (12, 3))
    heights = np.exp(-((xy[:, None] - bumps[None, :, :2]) ** 2).sum(axis=2)) @ (bumps[:, 2] - 5)
    cloud = np.column_stack([xy, heights])
    pose = np.eye(4)
    pose[:3, :3] = [[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]]
    pose[:3, 3] = [500.0, -20.0, 3.0]
    known = Transform.of(pose)
    began = time.perf_counter()
    found = register(cloud, known.apply(cloud), seed=0)
    seconds = time.perf_counter() - began
    error = float(np.abs(found.apply(cloud) - known.apply(cloud)).max())
    passed = found.verdict == "accepted" and error < _TOLERANCE
    return {"passed": passed, "verdict": found.verdict, "error": error, "seconds": seconds}


def _in_words(found: dict[str, Any]) -> str:
    from tmchho.room import in_words

    versions = found["versions"]
    parts = ", ".join(f"{name} {versions[name] or 'missing'}" for name in _PARTS)
    memory = found["memory"]
    limit = (
        ""
        if memory["limit"] is None
        else f", of which this process may take {in_words(memory['limit'])} more"
    )
    lines = [
        f"tmchho {versions['tmchho']}, Python {versions['python']}, {versions['system']}",
        f"  with {parts}",
        f"threads   {found['threads']}",
        f"memory    {in_words(memory['machine'])}{limit}; LAS files that need more than "
        f"{in_words(memory['max_memory'])} are worked on in parts",
        f"browser   {found['browser'] or 'none found: no report.pdf'}",
        "extras",
    ]
    for name, extra in found["extras"].items():
        state = "there" if not extra["lacks"] else f"missing: pip install 'tmchho[{name}]'"
        lines.append(f"  {name:<8}{extra['gives']}: {state}")
    test = found["self_test"]
    word = "passed" if test["passed"] else f"FAILED ({test['verdict']})"
    lines.append(f"self test {word}: a known pose found to {test['error']:.1e} in {test['seconds']:.1f} s")
    return "\n".join(lines)
