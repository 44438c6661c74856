"""Units of work for the tests, at the top of a module, where other processes find them."""

from __future__ import annotations

import hashlib
import os
import signal
import time
from pathlib import Path
from typing import Any

import numpy as np

from tmchho.errors import InvalidCloudError
from tmchho.io.atomic import atomic_path
from tmchho.network.engine import unit_progress, unit_threads
from tmchho.network.store import made_reference
from tmchho.progress import ProgressEvent


def squared(item: dict[str, Any]) -> dict[str, Any]:
    time.sleep(item.get("seconds", 0.0))
    return {"square": item["value"] * item["value"], "as_tuple": (1, 0.1)}


def refused(item: dict[str, Any]) -> dict[str, Any]:
    if item["value"] == 3:
        raise InvalidCloudError("cloud 3 is empty")
    return squared(item)


def not_plain(item: dict[str, Any]) -> dict[str, Any]:
    return {"value": {item["value"]}}


def surroundings_of(item: dict[str, Any]) -> dict[str, Any]:
    return {"n_threads": unit_threads(), "is_main": os.getpid() == item["process"]}


def until_stopped(item: dict[str, Any]) -> dict[str, Any]:
    Path(item["begun"]).touch()
    for _ in range(1000):
        if unit_progress(ProgressEvent("waiting", 0, 0, None, False)):
            Path(item["stopped"]).touch()
            break
        time.sleep(0.01)
    return {}


def normal_equations(item: dict[str, Any]) -> dict[str, Any]:
    """Multiply matrices that are large enough for BLAS to share the work among its threads."""
    values = np.random.default_rng(item["seed"]).normal(size=(4000, 60))
    return {"sums": (values.T @ values).tolist()}


def begun_or_waiting(item: dict[str, Any]) -> dict[str, Any]:
    """Wait to be stopped, or end once the other unit has begun."""
    if "wait_for" not in item:
        return until_stopped(item)
    while not Path(item["wait_for"]).exists():
        time.sleep(0.01)
    return {}


def deadly_once(item: dict[str, Any]) -> dict[str, Any]:
    """Kill the worker, the first time that item 2 comes."""
    seen = Path(item["folder"]) / "killed"
    if item["value"] == 2 and not seen.exists():
        seen.write_text(str(os.getpid()))
        os.kill(os.getpid(), signal.SIGKILL)
    return squared(item)


def deadly(item: dict[str, Any]) -> dict[str, Any]:
    os.kill(os.getpid(), signal.SIGKILL)
    return item


def file_made(item: dict[str, Any]) -> dict[str, Any]:
    """Leave a file, as the preparation of a cloud does, and count how often this was done."""
    time.sleep(item.get("seconds", 0.0))
    content = hashlib.sha256(str(item["value"]).encode()).digest() * 1000
    path = Path(item["folder"]) / f"made-{item['value']}.bin"
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_path(path, overwrite=True) as temporary:
        temporary.write_bytes(content)
    return {"made": made_reference(path)}


def file_read(item: dict[str, Any]) -> dict[str, Any]:
    time.sleep(item.get("seconds", 0.0))
    content = b"".join(Path(item[name]["path"]).read_bytes() for name in ("first", "second"))
    return {"sum": sum(content), "share": sum(content) / len(content) / 3.0}
