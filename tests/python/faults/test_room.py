"""How much memory a process may take, as the kernel tells it."""

from __future__ import annotations

from pathlib import Path

import pytest

from tmchho import room
from tmchho.errors import BudgetError

# What the kernel lists for a process, the files with limits, and what follows.
GROUPS = {
    "none": ("0::/\n", {}, None),
    "container": ("0::/\n", {"memory.max": "512000000\n"}, 512_000_000),
    "service": (
        "0::/system.slice/run-7.scope\n",
        {"system.slice/run-7.scope/memory.max": "300000000\n", "system.slice/memory.max": "max\n"},
        300_000_000,
    ),
    "a limit above": (
        "0::/user.slice/user-1.slice\n",
        {"user.slice/memory.max": "200000000\n", "user.slice/user-1.slice/memory.max": "900000000\n"},
        200_000_000,
    ),
    "first version": (
        "9:cpu,cpuacct:/a\n8:pids:/b\n4:memory:/jobs/7\n",
        {"memory/jobs/7/memory.limit_in_bytes": "400000000\n", "memory/b/memory.limit_in_bytes": "1\n"},
        400_000_000,
    ),
    "first version without a limit": (
        "4:memory:/jobs/7\n",
        {"memory/memory.limit_in_bytes": "9223372036854771712\n"},
        None,
    ),
    "first version, seen from inside": (
        "4:memory:/docker/0123\n",
        {"memory/memory.limit_in_bytes": "100000000\n"},
        100_000_000,
    ),
    "odd": ("memory\n::\n0::/../..\n", {"memory.max": "a lot\n"}, None),
}


@pytest.mark.parametrize("name", GROUPS)
def test_the_limit_of_a_group_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    listed, files, wanted = GROUPS[name]
    (tmp_path / "groups").write_text(listed)
    for path, text in files.items():
        (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / path).write_text(text)
    monkeypatch.setattr(room, "_GROUPS", tmp_path / "groups")
    monkeypatch.setattr(room, "_GROUPS_ROOT", tmp_path)
    monkeypatch.setattr(room, "_address_limit", lambda: None)
    monkeypatch.setattr(room, "_kilobytes", lambda _key: 40_000_000)
    if wanted is None:
        assert room.room_left() is None
        return
    assert room.room_left() == wanted - 40_000_000
    assert room.machine_memory() == wanted
    with pytest.raises(BudgetError, match=rf"may take only {(wanted - 40_000_000) // 10**6} MB more"):
        room.check_room(3_000_000)
