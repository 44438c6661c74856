"""The documentation site builds without a warning, has every public name, and loads nothing from outside."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import tmchho

REPOSITORY = Path(__file__).resolve().parents[2]
# What a browser would fetch by itself; links that a reader may follow are left alone.
LOADED = re.compile(
    r"<(?:script|img|iframe|source|video|audio|embed)\b[^>]*?\b(?:src|srcset)=[\"']?((?:https?:)?//[^\"'\s>]*)"
    r"|<link\b[^>]*?\bhref=[\"']?((?:https?:)?//[^\"'\s>]*)"
    r"|url\([\"']?((?:https?:)?//[^\"')]*)"
    r"|@import\s+[\"']?((?:https?:)?//[^\"';]*)",
    re.IGNORECASE,
)


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(folder)],
        cwd=REPOSITORY,
        env={**os.environ, "NO_MKDOCS_2_WARNING": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


def test_the_check_for_addresses_finds_them() -> None:
    found = [
        '<script src="https://a.example/x.js">',
        "<link rel=stylesheet href=//a.example/x.css>",
        "body { background: url(https://a.example/x.png) }",
        '@import "https://a.example/x.css";',
    ]
    assert all(LOADED.search(text) for text in found)
    assert not LOADED.search('<a href="https://a.example/">a link</a> <script src="assets/x.js">')


def test_no_page_and_no_style_loads_anything_from_elsewhere(site: Path) -> None:
    files = [path for path in site.rglob("*") if path.suffix in {".html", ".css"}]
    assert len(files) > 20
    loaded = {
        f"{path.name}: {found[0]}" for path in files for found in LOADED.finditer(path.read_text("utf-8"))
    }
    assert not loaded


def test_no_page_starts_a_part_of_the_theme_that_asks_servers(site: Path) -> None:
    # The theme's script fetches these by itself: a library for diagrams, and counts of a repository.
    for page in site.rglob("*.html"):
        text = page.read_text("utf-8")
        assert 'class="mermaid"' not in text, page
        assert 'data-md-component="source"' not in text, page


def test_every_public_name_is_in_the_reference(site: Path) -> None:
    pages = "".join(path.read_text("utf-8") for path in (site / "reference").glob("*.html"))
    names = [name for name in tmchho.__all__ if name not in {"__version__", "simulate"}]
    names += [f"simulate.{name}" for name in tmchho.simulate.__all__]
    missing = [name for name in names if not re.search(rf'id="tmchho\.{re.escape(name)}"', pages)]
    assert not missing


def test_the_documents_of_the_root_are_pages_whose_links_lead_to_pages(site: Path) -> None:
    first = (site / "index.html").read_text("utf-8")
    assert 'href="robust_search.html' in first
    assert 'href="architecture.html' in first
    assert not list(site.rglob("*.py"))


def test_the_benchmark_page_has_the_measured_tables(site: Path) -> None:
    page = (site / "benchmarks.html").read_text("utf-8")
    assert "<!-- include" not in page
    for words in ("KISS-Matcher", "small_gicp", "bun045_to_bun000", "radius outlier removal"):
        assert words in page
