"""Who may use this package may use what it is made of; none of that comes from anywhere but the registry."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path
from typing import Any

import pytest

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

REPOSITORY = Path(__file__).resolve().parents[2]
COPYLEFT = re.compile(r"\b(?:A|L)?GPL|General Public|Affero|CC-BY-NC|proprietary", re.IGNORECASE)


def toml(name: str) -> dict[str, Any]:
    return tomllib.loads((REPOSITORY / name).read_text(encoding="utf-8"))


def is_allowed(expression: str, allowed: set[str]) -> bool:
    """Return whether of every part that counts one choice is allowed; a slash is an old way to say OR."""
    parts = expression.replace("/", " OR ").split(" AND ")
    return all(any(choice.strip(" ()") in allowed for choice in part.split(" OR ")) for part in parts)


def test_the_reading_of_licences() -> None:
    allowed = {"MIT", "Zlib", "Apache-2.0 WITH LLVM-exception"}
    for good in ("MIT", "Apache-2.0/MIT", "(GPL-3.0 OR MIT) AND Zlib", "Apache-2.0 WITH LLVM-exception"):
        assert is_allowed(good, allowed), good
    for bad in ("GPL-3.0", "MIT AND GPL-3.0", "Apache-2.0", "(MIT OR Zlib) AND MPL-2.0"):
        assert not is_allowed(bad, allowed), bad


@pytest.mark.skipif(shutil.which("cargo") is None, reason="needs cargo")
def test_every_crate_has_a_licence_that_is_allowed() -> None:
    command = ["cargo", "metadata", "--locked", "--all-features", "--format-version", "1"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=REPOSITORY)
    assert done.returncode == 0, done.stderr
    packages = json.loads(done.stdout)["packages"]
    assert len(packages) > 50
    allowed = set(toml("deny.toml")["licenses"]["allow"])
    assert [
        (package["name"], package["license"])
        for package in packages
        if not is_allowed(package["license"] or "none", allowed)
    ] == []


def test_every_crate_comes_from_the_registry_with_a_checksum() -> None:
    packages = toml("Cargo.lock")["package"]
    others = [p["name"] for p in packages if not p.get("source", "").startswith("registry+")]
    assert others == ["tmchho"]
    assert all("checksum" in package for package in packages if package["name"] != "tmchho")


def required(name: str, extras: bool, seen: set[str]) -> Iterator[str]:
    """Give the packages that one needs, and those that they need; what is not installed is left out."""
    try:
        needs = metadata.requires(name) or []
    except metadata.PackageNotFoundError:
        return
    for need in needs:
        if "extra ==" in need and (not extras or "peers" in need):
            continue  # peers are what benches compare with, no part of this package
        found = re.match(r"[\w.-]+", need)
        assert found
        key = found[0].lower().replace("_", "-")
        if key not in seen:
            seen.add(key)
            yield key
            yield from required(key, False, seen)


def words_of_licence(name: str) -> str | None:
    """Return what an installed package says of its licence; None where it is not installed."""
    try:
        told = metadata.metadata(name)
    except metadata.PackageNotFoundError:
        return None
    classifiers = [line for line in told.get_all("Classifier", []) if line.startswith("License")]
    licence = told.get("License-Expression") or "; ".join(classifiers) or (told.get("License") or "")[:200]
    return licence or "nothing"


@pytest.mark.parametrize("extras", [False, True], ids=["needed", "extras"])
def test_no_python_package_is_under_a_licence_that_binds_the_user(extras: bool) -> None:
    names = list(required("tmchho", extras, set()))
    licences = {name: words for name in names if (words := words_of_licence(name)) is not None}
    if not licences:
        pytest.skip("the package is not installed, only found")
    bound = {
        name: words
        for name, words in licences.items()
        if COPYLEFT.search(words) and not re.search(r"\bMIT|BSD|Apache", words)
    }
    assert bound == {}
    if not extras:
        assert {"numpy", "laspy", "click", "rich", "shapely"} <= set(licences)
