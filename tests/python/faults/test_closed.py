"""Nothing that a file says is ever run, nothing is asked of a network, and no file outside is touched."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from faults import Faults

import tmchho
from tmchho.errors import InvalidArgumentError, ReadError
from tmchho.network.project import read_project

PACKAGE = Path(tmchho.__file__).parent
# What would run code, or talk to other machines.
CALLS = {
    "eval",
    "exec",
    "compile",
    "__import__",
    "os.system",
    "os.popen",
    "os.execv",
    "os.execvp",
    "os.startfile",
}
MODULES = (
    *("pickle", "cPickle", "_pickle", "dill", "cloudpickle", "marshal", "shelve", "joblib", "yaml", "runpy"),
    *("ctypes", "cffi", "xml", "lxml"),
    *(
        "socket",
        "ssl",
        "http",
        "urllib",
        "ftplib",
        "smtplib",
        "telnetlib",
        "xmlrpc",
        "requests",
        "httpx",
        "asyncio",
    ),
)
# A browser that is installed makes the PDF; Windows is asked how much memory it has.
ALLOWED = {"report/browser.py": {"subprocess"}, "room.py": {"ctypes"}}


def trees() -> Iterator[tuple[str, ast.Module]]:
    for path in sorted(PACKAGE.rglob("*.py")):
        yield path.relative_to(PACKAGE).as_posix(), ast.parse(path.read_text(encoding="utf-8"))


def imported(tree: ast.Module) -> Iterator[str]:
    """Give the modules that are imported, by a statement or by name."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (name.name for name in node.names)
        elif isinstance(node, ast.ImportFrom) and not node.level:
            yield str(node.module)
        elif isinstance(node, ast.Call) and ast.unparse(node.func).endswith("import_module"):
            (name,) = node.args
            # A name that is computed could be anything.
            yield name.value if isinstance(name, ast.Constant) else f"computed {ast.unparse(name)}"


def breaches(name: str, tree: ast.Module) -> Iterator[str]:
    for module in imported(tree):
        root = module.split(".")[0]
        if root in (*MODULES, "subprocess") and root not in ALLOWED.get(name, ()):
            yield f"{name} imports {module}"
        if root.startswith("computed"):
            yield f"{name} imports what is {module}"
    for node in ast.walk(tree):
        if not isinstance(node, ast.Call):
            continue
        called = ast.unparse(node.func)
        if called in CALLS:
            yield f"{name} calls {called}"
        options = {keyword.arg: ast.unparse(keyword.value) for keyword in node.keywords}
        if options.get("allow_pickle", "False") != "False" or options.get("shell", "False") != "False":
            yield f"{name} calls {called} with {options}"


def test_nothing_unpickles_evaluates_or_opens_a_connection() -> None:
    found = list(trees())
    assert len(found) > 90
    assert [breach for name, tree in found for breach in breaches(name, tree)] == []


@pytest.mark.parametrize(
    "line",
    [
        "import pickle",
        "from urllib.request import urlopen",
        "import subprocess",
        "eval('1')",
        "np.load(path, allow_pickle=True)",
        "run(word, shell=True)",
        "importlib.import_module('socket')",
        "import_module(name)",
    ],
)
def test_such_a_line_would_be_found(line: str) -> None:
    assert list(breaches("any.py", ast.parse(line)))


WATCHED = """
import sys
def watch(event, _arguments):
    if event.startswith(("socket.", "urllib.", "ftplib.", "smtplib.", "pickle.", "os.system", "subprocess.")):
        raise SystemExit(f"refused: {event}")
import tmchho.cli
import matplotlib.font_manager  # may look for fonts with a program of the system
sys.addaudithook(watch)
tmchho.cli.main(sys.argv[1:])
"""


@pytest.mark.parametrize("command", ["register", "evaluate", "info"])
def test_a_run_asks_no_network_and_starts_no_program(faults: Faults, tmp_path: Path, command: str) -> None:
    words = [command, *map(str, faults.inputs), *(["-o", str(tmp_path / "out")] if command != "info" else [])]
    done = subprocess.run(
        [sys.executable, "-c", WATCHED, *words], capture_output=True, text=True, check=False, timeout=300
    )
    assert done.returncode == 0, done.stderr
    assert "refused" not in done.stderr
    if command == "register":
        assert (tmp_path / "out" / "report.html").exists()


@pytest.mark.parametrize(
    "words",
    [
        "import socket; socket.socket().connect(('127.0.0.1', 9))",
        "import pickle; pickle.loads(pickle.dumps(print))",
        "import subprocess; subprocess.run(['true'])",
    ],
)
def test_the_watch_sees_what_it_looks_for(words: str) -> None:
    code = WATCHED.replace("tmchho.cli.main(sys.argv[1:])", words)
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=120
    )
    assert "refused" in done.stderr


@pytest.mark.parametrize(
    "line",
    [
        'file = "../secret.laz"',
        'file = "scans/../../secret.laz"',
        'file = "a.laz"\npose = "../../pose.txt"',
    ],
)
def test_a_project_file_cannot_lead_out_of_its_folder(tmp_path: Path, line: str) -> None:
    """Someone else's project names files of its own folder, or says openly where they lie."""
    folder = tmp_path / "project"
    folder.mkdir()
    (tmp_path / "secret.laz").write_bytes(b"")
    (tmp_path / "pose.txt").write_text("1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n")
    path = folder / "PROJECT.toml"
    path.write_text(f'[[station]]\n{line}\n[[station]]\nfile = "b.laz"\n')
    with pytest.raises(InvalidArgumentError, match="leads out of the project's folder"):
        read_project(path)


def test_names_within_an_archive_touch_no_file(tmp_path: Path) -> None:
    import io
    import zipfile

    import numpy as np

    content = io.BytesIO()
    np.save(content, np.eye(5, 3))
    inner = tmp_path / "inner"
    inner.mkdir()
    with zipfile.ZipFile(inner / "a.npz", "w") as archive:
        archive.writestr("xyz.npy", content.getvalue())
        archive.writestr("../outside.npy", content.getvalue())
        archive.writestr("/tmp/outside.npy", content.getvalue())
    assert len(tmchho.read(inner / "a.npz")) == 5
    assert [path.name for path in tmp_path.rglob("*")] == ["inner", "a.npz"]


BOMB = (
    '<?xml version="1.0"?><!DOCTYPE e [<!ENTITY a "aaaaaaaaaaaaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;">]>'
    "<e57Root>&b;</e57Root>"
)


def test_entities_of_xml_are_not_unfolded(tmp_path: Path) -> None:
    pytest.importorskip("pye57")
    path = tmp_path / "a.e57"
    tmchho.write(tmchho.PointCloud([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]), path)
    data = bytearray(path.read_bytes())
    start = data.index(b"<?xml")
    data[start : start + len(BOMB)] = BOMB.encode()
    path.write_bytes(data)
    with pytest.raises(ReadError, match=r"a\.e57: "):
        tmchho.read(path)
