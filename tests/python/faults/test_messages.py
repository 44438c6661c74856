"""The messages that `docs/failures.md` explains are those of the program."""

from __future__ import annotations

import re
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[3]
PAGE = REPOSITORY / "docs" / "failures.md"
ROW = re.compile(r"^\| (`.+?`.*?) \|", re.MULTILINE)


def said() -> str:
    """Return all that the code may say, as one line, strings that go on in the next one joined."""
    paths = [*(REPOSITORY / "python").rglob("*.py"), *(REPOSITORY / "rust").rglob("*.rs")]
    text = "\n".join(path.read_text(encoding="utf-8") for path in paths)
    return re.sub(r"\s+", " ", re.sub(r'(?:"\s*\n\s*f?"|\\\n\s*)', "", text))


def test_every_message_is_one_of_ours() -> None:
    page = PAGE.read_text(encoding="utf-8").partition("\n## What happens when")[0]
    code, n_found = said(), 0
    for cell in ROW.findall(page):
        for message in re.findall(r"`([^`]+)`", cell):
            # What depends on the case: names, numbers, and what the page leaves out.
            pieces = re.split(r"…|\bN\b|\bX\b|\bY\b|\d+(?: MB)?|LAS|\(No space left on device\)", message)
            for piece in (piece.strip(" ;:,()") for piece in pieces):
                if len(piece) > 8 and not piece.startswith("--"):
                    assert piece in code, (message, piece)
                    n_found += 1
    assert n_found > 30


def test_every_situation_has_an_exit_code_and_a_test() -> None:
    page = PAGE.read_text(encoding="utf-8")
    known = set(re.findall(r"^\| (\d+) \|", page, re.MULTILINE))
    rows = page.partition("## What happens when")[2].partition("\n## ")[0].splitlines()
    rows = [row for row in rows if row.startswith("|")][2:]
    assert len(rows) > 40
    for row in rows:
        situation, _, codes, tests = (cell.strip() for cell in row.strip("|").split("|"))
        assert set(codes.split(", ")) <= known, situation
        named = [test.split("::") for test in re.findall(r"`([^`]+)`", tests)]
        assert named, situation
        for path, name in named:
            text = (REPOSITORY / path).read_text(encoding="utf-8")
            pattern = rf"#\[test\]\s+fn {name}\(" if path.endswith(".rs") else rf"^def {name}\("
            assert re.search(pattern, text, re.MULTILINE), (situation, path, name)
