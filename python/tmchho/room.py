"""How much memory this process may still take, and a refusal with figures before it runs out.

Why before: where the system refuses memory in the middle of a computation, the process ends without a word.
"""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Iterator
from pathlib import Path

from tmchho.errors import BudgetError

_GROUPS = Path("/proc/self/cgroup")
_GROUPS_ROOT = Path("/sys/fs/cgroup")
_STATUS = Path("/proc/self/status")
# Measured: registering, evaluating or fusing two clouds that are in memory takes 250 to 400 bytes a point.
_BYTES_PER_POINT = 400
_NO_LIMIT = 2**60  # what the first version of groups writes where there is none is larger
_LEAST = 60_000_000  # threads, whatever they work on
_LEAST_FOR_PARTS = 600_000_000
_MOST_HEAPS = -8  # M_ARENA_MAX of glibc's malloc.h


def machine_memory() -> int:
    """Return the bytes of memory of the machine, or of the group that this process is confined to."""
    total = _physical_memory()
    confined = _confined()
    return total if confined is None else min(total, confined)


def room_left() -> int | None:
    """Return the bytes that this process may still take by `ulimit -v` or its group; None without a limit."""
    rooms = []
    limit = _address_limit()
    if limit is not None:
        rooms.append(limit - _kilobytes("VmSize:"))
    confined = _confined()
    if confined is not None:
        rooms.append(confined - _kilobytes("VmRSS:"))
    return max(0, min(rooms)) if rooms else None


def spare_addresses() -> None:
    """Let all threads share one heap where `ulimit -v` counts addresses; for a process that is ours alone.

    Otherwise the allocator of glibc reserves 64 MB of addresses for each of them, nearly all unused, and how
    many come to have one is chance: the same limit was enough in one run and ended the next without a word.
    """
    if _address_limit() is None:
        return
    set_option = getattr(ctypes.CDLL(None), "mallopt", None)  # other systems reserve nothing
    if set_option is not None:
        set_option(_MOST_HEAPS, 1)


def check_room(n_points: int, bytes_per_point: int = _BYTES_PER_POINT) -> None:
    """Raise `BudgetError` if so many points need more memory than this process may take.

    Parameters
    ----------
    n_points : int
        Of both clouds.
    bytes_per_point : int, default 400
        What each takes.
    """
    room, needed = room_left(), _LEAST + n_points * bytes_per_point
    if room is not None and needed > room:
        raise BudgetError(
            f"{n_points:,} points need about {in_words(needed)} of memory, and this process may take only "
            f"{in_words(room)} more (ulimit -v, or the limit of its group); raise the limit, thin the clouds "
            "out, or give LAS or LAZ files to tmchho register, which works on them in parts"
        )


def check_room_for_parts() -> None:
    """Raise `BudgetError` if not even files in parts can be worked on."""
    room = room_left()
    if room is not None and room < _LEAST_FOR_PARTS:
        raise BudgetError(
            f"to work on files in parts takes about {in_words(_LEAST_FOR_PARTS)} of memory, and this process "
            f"may take only {in_words(room)} more (ulimit -v, or the limit of its group); raise the limit"
        )


def in_words(n_bytes: float) -> str:
    """Return an amount of memory for people.

    Examples
    --------
    >>> in_words(1_234_000_000), in_words(56_700_000)
    ('1.2 GB', '57 MB')
    """
    return f"{n_bytes / 1e9:.1f} GB" if n_bytes >= 1e9 else f"{n_bytes / 1e6:.0f} MB"


def _physical_memory() -> int:
    if sys.platform == "win32":
        status = (ctypes.c_ulonglong * 8)(64)  # MEMORYSTATUSEX: its own size, then the bytes of the machine
        ctypes.windll.kernel32.GlobalMemoryStatusEx(ctypes.byref(status))
        return status[1]
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")


def _address_limit() -> int | None:
    try:
        import resource
    except ImportError:  # Windows has no such limit
        return None
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    return None if limit == resource.RLIM_INFINITY else limit


def _confined() -> int | None:
    """Return the smallest limit of the groups that this process is in, or None without any."""
    limits = []
    for folder, name in _groups():
        try:
            text = (folder / name).read_text(encoding="ascii").strip()
        except OSError:
            continue  # a container sees the last part of the path, or its root only
        if text.isdigit() and int(text) < _NO_LIMIT:
            limits.append(int(text))
    return min(limits) if limits else None


def _groups() -> Iterator[tuple[Path, str]]:
    """Give the folder of every group that limits this process, and the file of the limit in it.

    Each line of the list is ``number:controllers:path``, without controllers in the second version of groups.
    A limit holds for all groups below it.
    """
    try:
        lines = _GROUPS.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return
    for line in lines:
        _, _, rest = line.partition(":")
        controllers, _, path = rest.partition(":")
        if controllers and "memory" not in controllers.split(","):
            continue
        root, name = _GROUPS_ROOT, "memory.max"
        if controllers:
            root, name = root / "memory", "memory.limit_in_bytes"
        parts = [part for part in path.split("/") if part not in ("", "..")]
        for n_parts in range(len(parts) + 1):
            yield root.joinpath(*parts[:n_parts]), name


def _kilobytes(key: str) -> int:
    """Return a figure of this process in bytes; 0 where the system does not tell."""
    try:
        text = _STATUS.read_text(encoding="ascii", errors="replace")
    except OSError:
        return 0
    found = text.partition(key)[2].split()
    return 1024 * int(found[0]) if found else 0
