"""Brings documents from outside `docs/` into the site, and makes links between all of them lead somewhere.

The documents are written for people who read them in the repository, where README.md links to docs/report.md.
In the site README.md is the first page, so links are turned to where the pages lie there.
"""

from __future__ import annotations

import re
from pathlib import Path, PurePosixPath
from posixpath import normpath, relpath

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

REPOSITORY = Path(__file__).resolve().parents[1]
# Where a document of the repository lies in the site.
PAGES = {
    "README.md": "index.md",
    "ARCHITECTURE.md": "architecture.md",
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
}
# Shown as a part of another page.
PARTS = {"benches/RESULTS.md": "benchmarks.md"}

FENCED = re.compile(r"(^```.*?^```$)", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"(!?)\[([^\]]*)\]\(([^)\s#]*)(#[^)\s]*)?\)")
INCLUDED = re.compile(r"^<!-- include (\S+): (.+) -->$", re.MULTILINE)


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the documents of the repository's root."""
    for document, page in PAGES.items():
        text = (REPOSITORY / document).read_text(encoding="utf-8")
        files.append(File.generated(config, page, content=text))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Fill in the sections that a page shows of other documents, and turn its links."""
    uri = page.file.src_uri
    roots = {made: document for document, made in PAGES.items()}
    document = roots.get(uri, f"docs/{uri}")
    markdown = turned(markdown, document, uri)
    return INCLUDED.sub(lambda found: turned(section(found[1], found[2]), found[1], uri), markdown)


def section(document: str, heading: str) -> str:
    """Return what stands below a heading of the second level, down to the next one."""
    text = (REPOSITORY / document).read_text(encoding="utf-8")
    parts = re.split(r"^## (.+)$", text, flags=re.MULTILINE)
    bodies = dict(zip(parts[1::2], parts[2::2], strict=True))
    if heading not in bodies:
        raise PluginError(f"{document} has no heading '## {heading}'; name another one in the page")
    return bodies[heading].strip()


def turned(markdown: str, document: str, uri: str) -> str:
    """Return a document's text with its links turned to the pages of the site, as seen from the page `uri`.

    A link to a file that is no page keeps its words alone: the site has no source code in it.
    """

    def turn(found: re.Match[str]) -> str:
        picture, words, path, anchor = found[1], found[2], found[3], found[4] or ""
        if not path or ":" in path:
            return found[0]
        goal = normpath(str(PurePosixPath(document).parent / path))
        page = PAGES.get(goal) or PARTS.get(goal) or (goal[5:] if goal.startswith("docs/") else None)
        if page is None:
            return words
        return f"{picture}[{words}]({relpath(page, str(PurePosixPath(uri).parent))}{anchor})"

    parts = FENCED.split(markdown)
    return "".join(part if part.startswith("```") else LINK.sub(turn, part) for part in parts)
