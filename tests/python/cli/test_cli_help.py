"""The help of every command, and the commands that help and documents show: their options exist."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import click
import pytest
from cli_tools import run

import tmchho
from tmchho.cli import main

REPOSITORY = Path(__file__).resolve().parents[3]
DOCUMENTS = sorted([*REPOSITORY.glob("*.md"), *(REPOSITORY / "docs").rglob("*.md")])
COMMANDS = list(main.commands)
# A command of a document stands in a fenced or an indented block.
FENCED = re.compile(r"^```(?:sh|console)?\n(.*?)^```$", re.MULTILINE | re.DOTALL)
INDENTED = re.compile(r"(?:^ {4}\S.*\n)+", re.MULTILINE)


def test_the_version() -> None:
    assert run("--version").stdout == f"tmchho {tmchho.__version__}\n"


@pytest.mark.parametrize("command", ["", *COMMANDS])
def test_every_help_has_examples_that_name_real_options(command: str) -> None:
    text = run(*command.split(), "--help").stdout
    assert "\\b" not in text  # a mark for click that it did not understand
    _, found, examples = text.partition("Examples:\n")
    assert found
    shown = commands_in(examples.partition("Exit codes:")[0])
    assert shown
    for words in shown:
        check(words)


@pytest.mark.parametrize("command", ["", "register", "network", "evaluate", "apply", "info", "view"])
def test_the_help_of_a_command_that_reads_files_tells_the_exit_codes(command: str) -> None:
    text = run(*command.split(), "--help").stdout
    assert "130  interrupted" in text
    assert "4    not accepted" in text


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: str(path.relative_to(REPOSITORY)))
def test_the_commands_of_a_document_name_real_options(document: Path) -> None:
    text = document.read_text(encoding="utf-8")
    blocks = [*FENCED.findall(text), *INDENTED.findall(text)]
    for words in commands_in("\n".join(blocks)):
        check(words)


def commands_in(text: str) -> list[list[str]]:
    """Return the words behind `tmchho` of each command, without variables before it or a redirection."""
    joined = re.sub(r"\\\n\s*", " ", text)
    found = re.findall(r"^\s*(?:[A-Z_]+=\S+ )?tmchho +(.+)$", joined, re.MULTILINE)
    return [shlex.split(line.partition(" > ")[0], comments=True) for line in found]


def check(words: list[str]) -> None:
    """Parse a command as it would be, without looking at files or running it."""
    name, *rest = words
    if name in {"COMMAND", "--version", "--help"}:
        return
    command = main.commands[name]
    context = click.Context(command, info_name=name)
    _, left, _ = command.make_parser(context).parse_args(rest)
    assert left == [], words
