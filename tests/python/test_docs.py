"""What the documents say of the tree is true: names exist, links lead somewhere, examples run.

Addresses outside the repository are not opened. Of the shell blocks, those of the tutorial are run.
"""

from __future__ import annotations

import importlib
import inspect
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest
from click.testing import CliRunner

from tmchho.cli import main

REPOSITORY = Path(__file__).resolve().parents[2]
PAPER_MAP = REPOSITORY / "docs" / "paper_map.md"
BUILT = {"target", "out"}  # made by the build; their Markdown is not ours

ROOMS = ("rust/", "python/", "tests/", "benches/", "docs/", "examples/")
BACKTICKED = re.compile(r"`([^`\n]+)`")
FENCE = re.compile(r"^```(\w*)[^\n]*\n(.*?)^```$", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\[[^\]]*\]\(([^)\s]+)\)")
RUST_DEFINITION = r"\b(?:fn|struct|enum|trait|const|static|type|mod) {0}\b"
RUST_VARIANT = r"^\s*{0}\s*[,({{]"
PYTHON_DEFINITION = r"^\s*(?:def|class) {0}\b|^\s*{0}\s*[:=]"
RUST_TEST = r"#\[test\]\s*(?:#\[[^\]]*\]\s*)*fn {0}\("
PYTHON_TEST = r"^def {0}\("

EQUATIONS = [f"Eq. ({n})" for n in range(1, 9)]
SECTIONS = [f"Sec. {n}" for n in ("4.1", "4.2", "4.3", "4.4", "4.5", "5.1", "5.2", "5.3")]
TABLES = [f"Table {n}" for n in range(1, 8)]
FIGURES = [f"Figure {n}" for n in range(1, 19)]


def documents() -> list[Path]:
    folders = [p for p in REPOSITORY.iterdir() if p.is_dir() and not p.name.startswith(".")]
    nested = [path for folder in folders if folder.name not in BUILT for path in folder.rglob("*.md")]
    return sorted([*REPOSITORY.glob("*.md"), *nested])


@cache
def text_of(path: Path) -> str:
    return path.read_text(encoding="utf-8")


def prose_of(path: Path) -> str:
    """Return a document without its fenced blocks, whose brackets and backticks mean something else."""
    return FENCE.sub("", text_of(path))


def name_of(path: Path) -> str:
    return str(path.relative_to(REPOSITORY))


def paths_named(text: str) -> Iterator[tuple[str, list[str]]]:
    """Give every backticked `path::name` of this repository as the path and its names."""
    for token in BACKTICKED.findall(text):
        if token.startswith(ROOMS):
            path, *names = token.split("::")
            yield path, names


def is_defined(path: Path, name: str) -> bool:
    patterns = [PYTHON_DEFINITION]
    if path.suffix == ".rs":
        patterns = [RUST_DEFINITION, RUST_VARIANT] if name[0].isupper() else [RUST_DEFINITION]
    code = re.sub(r"^\s*(?://|#).*$", "", text_of(path), flags=re.MULTILINE)
    return any(re.search(pattern.format(name), code, re.MULTILINE) for pattern in patterns)


def is_test(path: Path, names: list[str]) -> bool:
    pattern = RUST_TEST if path.suffix == ".rs" else PYTHON_TEST
    found = len(names) == 1 and re.search(pattern.format(re.escape(names[0])), text_of(path), re.MULTILINE)
    return bool(found) and (path.suffix == ".rs" or names[0].startswith("test_"))


def rows(table_heading: str) -> list[list[str]]:
    """Return the cells of the rows of every table of the paper map with that heading."""
    found = []
    heading_seen = False
    for line in text_of(PAPER_MAP).splitlines():
        if not line.startswith("|"):
            heading_seen = False
        elif line.startswith(table_heading):
            heading_seen = True
        elif heading_seen and not line.startswith("|---"):
            found.append([cell.strip() for cell in line.strip("|").split("|")])
    return found


@pytest.mark.parametrize("document", documents(), ids=name_of)
def test_every_file_and_name_exists(document: Path) -> None:
    missing = []
    for path, names in paths_named(prose_of(document)):
        if not (REPOSITORY / path).exists():
            missing.append(path)
            continue
        missing += [f"{path}::{name}" for name in names if not is_defined(REPOSITORY / path, name)]
    assert not missing


@pytest.mark.parametrize("document", documents(), ids=name_of)
def test_every_python_name_exists(document: Path) -> None:
    missing = []
    for token in BACKTICKED.findall(prose_of(document)):
        name = token.split("(")[0]
        if not re.fullmatch(r"tmchho(\.\w+)+", name) or name == "tmchho._core":
            continue
        value: object = importlib.import_module("tmchho")
        for part in name.split(".")[1:]:
            if inspect.isclass(value) and part in inspect.get_annotations(value):
                break  # a field of a dataclass
            if not hasattr(value, part):
                missing.append(token)
                break
            value = getattr(value, part)
    assert not missing


@pytest.mark.parametrize("document", documents(), ids=name_of)
def test_every_relative_link_resolves(document: Path) -> None:
    broken = []
    for link in LINK.findall(prose_of(document)):
        if re.match(r"[a-z]+:", link):
            continue  # an address outside the repository
        path, _, anchor = link.partition("#")
        goal = (document.parent / path).resolve() if path else document
        if not goal.exists() or (anchor and anchor not in anchors_of(goal)):
            broken.append(link)
    assert not broken


def anchors_of(document: Path) -> set[str]:
    """Return the anchors of the headings, made the way that forges make them."""
    headings = re.findall(r"^#+ (.+)$", prose_of(document), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def test_the_architecture_names_every_room() -> None:
    text = text_of(REPOSITORY / "ARCHITECTURE.md")
    rooms = [*(REPOSITORY / "rust").iterdir(), *(REPOSITORY / "python" / "tmchho").iterdir()]
    passages = {"lib.rs", "__main__.py", "py.typed", "__pycache__"}
    unnamed = [
        name
        for room in rooms
        if room.name not in passages and room.suffix not in {".so", ".pyd"}
        for name in [name_of(room) + ("/" if room.is_dir() else "")]
        if f"`{name}" not in text
    ]
    assert not unnamed


def test_the_architecture_names_the_files_that_import_the_core() -> None:
    text = text_of(REPOSITORY / "ARCHITECTURE.md")
    sentence = re.search(r"^Only ([^.]*(?:\.[^.]+)*?) import\s+`tmchho\._core`", text, re.MULTILINE)
    assert sentence is not None
    told = set(BACKTICKED.findall(sentence[1]))
    package = REPOSITORY / "python" / "tmchho"
    imports = re.compile(
        r"^\s*(?:from tmchho import _core|from tmchho\._core import|import tmchho\._core)", re.MULTILINE
    )
    found = [path for path in package.rglob("*.py") if imports.search(text_of(path))]
    assert told == {
        name_of(path)
        if path.parent == package
        else name_of(package / path.relative_to(package).parts[0]) + "/"
        for path in found
    }


def test_the_paper_map_has_a_row_for_everything_in_the_paper() -> None:
    named = {
        label
        for row in rows("| paper |")
        for label in re.findall(r"Eq\. \(\d\)|Sec\. \d\.\d|(?:Table|Figure) \d+", row[0])
    }
    assert not {*EQUATIONS, *SECTIONS, *TABLES, *FIGURES} - named


def test_every_row_of_the_paper_map_has_a_function_a_test_and_a_deviation() -> None:
    assert rows("| paper |")
    for row in rows("| paper |"):
        assert len(row) == 4, row
        assert all(row), row
        _, function, test, _ = row
        assert "not yet" in function or list(paths_named(function)), row
        tests = list(paths_named(test))
        assert "not yet" in test or tests, row
        for path, names in tests:
            assert is_test(REPOSITORY / path, names), f"{path}::{'::'.join(names)} is no test"


def test_every_reading_states_its_evidence() -> None:
    assert len(rows("| reading |")) >= 9  # as many as places where the paper is silent
    assert all(len(row) == 3 and all(row) for row in rows("| reading |"))


def cargo_version() -> str:
    found = re.search(r'^version = "([^"]+)"$', text_of(REPOSITORY / "Cargo.toml"), re.MULTILINE)
    assert found is not None
    return found[1]


def test_the_citation_can_be_parsed_and_names_this_version() -> None:
    lines = text_of(REPOSITORY / "CITATION.cff").splitlines()
    # The part of YAML that the file keeps to: keys and list items, whose texts with blanks are in quotes.
    line = re.compile(r"(?:  )*(?:- )?(?:([a-z-]+):(?: |$))?(\"[^\"\\]*\"|[\w.-]+)?")
    parsed = [line.fullmatch(text) for text in lines]
    assert [text for text, match in zip(lines, parsed, strict=True) if match is None] == []
    top_level = {
        match[1]: (match[2] or "").strip('"')
        for text, match in zip(lines, parsed, strict=True)
        if match is not None and match[1] is not None and not text.startswith((" ", "-"))
    }
    assert {"cff-version", "message", "title", "type", "authors", "license", "references"} <= set(top_level)
    assert top_level["cff-version"] == "1.2.0"
    assert top_level["version"] == cargo_version()
    assert '    doi: "10.3390/s23104942"' in lines


def test_the_changelog_tells_of_this_version() -> None:
    headings = re.findall(r"^## \[([^\]]+)\]", text_of(REPOSITORY / "CHANGELOG.md"), re.MULTILINE)
    assert {"Unreleased", cargo_version()} & set(headings)


def run_python_examples(document: Path) -> None:
    """Run the Python blocks of a document from top to bottom, with the names that earlier ones made."""
    blocks = [match for match in FENCE.finditer(text_of(document)) if match[1] == "python"]
    assert blocks
    namespace: dict[str, object] = {"__name__": document.stem}
    for block in blocks:
        n_lines_before = text_of(document)[: block.start(2)].count("\n")
        code = compile("\n" * n_lines_before + block[2], name_of(document), "exec")
        exec(code, namespace)


@pytest.mark.parametrize("document", ["README.md", "docs/how_to/researcher.md"])
def test_the_python_examples_run_in_order(
    document: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    run_python_examples(REPOSITORY / document)


def test_the_tutorial_works_from_top_to_bottom(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tutorial = REPOSITORY / "docs" / "tutorial.md"
    blocks = [match[2] for match in FENCE.finditer(text_of(tutorial)) if match[1] == "sh"]
    commands = [shlex.split(line)[1:] for block in blocks for line in block.splitlines()]
    monkeypatch.chdir(tmp_path)
    outputs = {}
    for words in commands:
        # The page is made once, by `tmchho report`.
        quicker = ["--no-report"] if words[0] in {"demo", "register"} else []
        result = CliRunner().invoke(main, [*words, *quicker])
        assert result.exit_code == 0, (words, result.output)
        outputs[words[0]] = result.stdout
    (shown,) = (match[2].strip() for match in FENCE.finditer(text_of(tutorial)) if match[1] == "text")
    assert outputs["demo"].startswith(shown.split(":")[0] + ":")
    assert (tmp_path / "out/site/report.html").stat().st_size > 0
    run_python_examples(tutorial)


def test_the_python_examples_have_right_types(tmp_path: Path) -> None:
    pages = ["README.md", "docs/tutorial.md", "docs/how_to/researcher.md", "docs/network.md"]
    for number, page in enumerate(pages):
        blocks = [match[2] for match in FENCE.finditer(text_of(REPOSITORY / page)) if match[1] == "python"]
        (tmp_path / f"page_{number}.py").write_text("\n".join(blocks), encoding="utf-8")
    scripts = [*sorted(tmp_path.glob("*.py")), *sorted((REPOSITORY / "examples").glob("*.py"))]
    done = subprocess.run(
        [sys.executable, "-m", "mypy", "--config-file", REPOSITORY / "pyproject.toml", *scripts],
        cwd=REPOSITORY,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
