"""No change of bytes in a valid file makes a reader crash, hang or ask for memory beyond all reason.

Clouds in every format, and the documents that come with them: settings, poses, areas, results.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from mutated_documents import DOCUMENTS
from mutations import MAKERS

from tmchho.io import known_extensions

N_MUTATIONS, N_OF_DOCUMENTS = 2000, 600
PROGRAM = Path(__file__).with_name("mutations.py")


@pytest.mark.parametrize("name", MAKERS)
def test_any_damage_is_a_cloud_or_a_sentence(name: str) -> None:
    if name == "e57":
        pytest.importorskip("pye57")
    # One arena: else every thread of the allocator reserves address space, which the limit would count.
    environment = {**os.environ, "MALLOC_ARENA_MAX": "1"}
    n_mutations = N_OF_DOCUMENTS if name in DOCUMENTS else N_MUTATIONS
    command = [sys.executable, "-W", "ignore", str(PROGRAM), name, str(n_mutations), "0"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr[-3000:]
    found = json.loads(done.stdout.splitlines()[-1])
    assert 0 < found["n_read"] < n_mutations  # some damage is harmless and some is not
    # The damage reaches different places.
    assert found["n_sentences"] > (1 if name in DOCUMENTS else 5)


def test_every_format_is_damaged() -> None:
    damaged = {name.partition("_")[0].rstrip("14") for name in MAKERS} | {"laz", "txt", "asc"}
    assert {extension.removeprefix(".") for extension in known_extensions()} <= damaged
