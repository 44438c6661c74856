"""Files that appear whole or not at all.

Why: a long run must not leave half a file behind, nor lose the old one, when the disk is full or the user
interrupts. Everything is written under a temporary name in the same folder and renamed at the very end.
"""

from __future__ import annotations

import os
import platform
import re
import secrets
import shutil
import signal
import threading
import zlib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from tmchho.errors import TmchhoError, WriteError

StrPath = str | os.PathLike[str]

# Hidden, then the machine and the process that made it.
_MARK = re.compile(r"^\..*tmchho-([0-9a-f]{8})-(\d+)-")


@contextmanager
def atomic_path(path: StrPath, overwrite: bool = False, inputs: Iterable[StrPath] = ()) -> Iterator[Path]:
    """Lend a temporary path that becomes `path` when the block ends without an error.

    Parameters
    ----------
    path : str or path
        The file to make. A symbolic link is followed: its target is replaced, the link stays.
    overwrite : bool, default False
        Replace an existing file.
    inputs : iterable of str or path
        Files that must never be replaced, even with `overwrite`.

    Yields
    ------
    Path
        A name in the same folder with the same suffix. The block creates the file.

    Raises
    ------
    WriteError
        If `path` exists and may not be replaced, or the file system refuses. The temporary file is
        removed on every error, an interrupt included.

    Examples
    --------
    >>> import tempfile
    >>> folder = Path(tempfile.mkdtemp())
    >>> with atomic_path(folder / "pose.txt") as temporary:
    ...     _ = temporary.write_text("1 0 0 0")
    >>> [file.name for file in folder.iterdir()]
    ['pose.txt']
    """
    inputs = tuple(inputs)
    with pending(path, overwrite, inputs) as (temporary, target):
        yield temporary
        flush_to_disk(temporary)
        check_output(path, overwrite, inputs)  # another program may have been quicker
        os.replace(temporary, target)
        flush_folder(target.parent)


@contextmanager
def pending(
    path: StrPath, overwrite: bool = False, inputs: Iterable[StrPath] = ()
) -> Iterator[tuple[Path, Path]]:
    """Lend a temporary path and the one that it may be renamed to; removed at the end where it is not.

    Parameters
    ----------
    path, overwrite, inputs
        As for `atomic_path`.
    """
    check_output(path, overwrite, inputs)
    target = Path(path).resolve()
    # The stem is cut because file systems allow 255 bytes for a name.
    unique = f"tmp-{own_mark()}-{secrets.token_hex(4)}"
    temporary = target.with_name(f".{target.stem[:40]}.{unique}{target.suffix}")
    try:
        yield temporary, target
    except TmchhoError:
        raise
    except OSError as error:
        raise WriteError(
            f"{path}: cannot be written ({reason(error)}); check the disk and the rights"
        ) from error
    finally:
        temporary.unlink(missing_ok=True)


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Put off Ctrl-C and polite requests to end until the block is done; for what takes no time."""
    if threading.current_thread() is not threading.main_thread():
        yield  # which alone is interrupted
        return
    came: list[int] = []
    before = {
        number: signal.signal(number, lambda number, _frame: came.append(number))
        for number in (signal.SIGINT, signal.SIGTERM)
        if callable(signal.getsignal(number))
    }
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    for late in came:
        signal.raise_signal(late)


def own_mark() -> str:
    """Return what the names of temporary files of this process have in common."""
    return f"tmchho-{_machine()}-{os.getpid()}"


def sweep(folder: Path) -> None:
    """Remove temporary files and folders of processes of this machine that are gone: they were killed."""
    with suppress(OSError):
        for path in folder.iterdir():
            found = _MARK.search(path.name)
            if found is None or found[1] != _machine() or _is_running(int(found[2])):
                continue
            if path.is_dir() and not path.is_symlink():
                shutil.rmtree(path, ignore_errors=True)
            else:
                path.unlink(missing_ok=True)


def _machine() -> str:
    return f"{zlib.crc32(platform.node().encode()):08x}"


def _is_running(process: int) -> bool:
    if os.name != "posix":
        return True  # there is no harmless way to ask
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:
        pass  # somebody else's
    return True


def check_output(path: StrPath, overwrite: bool = False, inputs: Iterable[StrPath] = ()) -> None:
    """Raise `WriteError` if `path` may not be written: a cheap test before a long computation.

    Parameters
    ----------
    path : str or path
        The file that is going to be made.
    overwrite : bool, default False
        Whether an existing file may be replaced.
    inputs : iterable of str or path
        Files that must never be replaced, even with `overwrite`.
    """
    path = Path(path)
    if not path.parent.is_dir():
        raise WriteError(f"{path}: the folder {path.parent} does not exist; create it or choose another")
    if not path.exists():
        return
    if not path.is_file():
        raise WriteError(f"{path}: is not a file that could be replaced; choose another name")
    for source in inputs:
        if Path(source).exists() and path.samefile(source):
            raise WriteError(f"{path}: is an input and is never overwritten; choose another name")
    if not overwrite:
        raise WriteError(f"{path}: exists already; choose another name or allow overwriting")


def check_writable_folder(path: StrPath) -> Path:
    """Make sure that files can be made in a folder, before hours are spent on what goes into it.

    Parameters
    ----------
    path : str or path
        The folder; it is created, with its parents, if it does not exist.

    Returns
    -------
    Path
        The folder.

    Raises
    ------
    WriteError
        If it cannot be created or no file can be made in it.
    """
    folder = Path(path)
    probe = folder / f".probe-{own_mark()}-{secrets.token_hex(4)}"  # swept up if this process is killed
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe.touch(exist_ok=False)
        probe.unlink()
    except OSError as error:
        raise WriteError(
            f"{folder}: no file can be written into this folder ({reason(error)}); choose another"
        ) from error
    return folder


def reason(error: BaseException) -> str:
    """Return the first line of an error's message, or its class name where it has none."""
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    lines = str(error).strip().splitlines()
    return lines[0][:200] if lines else type(error).__name__


def flush_folder(folder: Path) -> None:
    """Wait until the new name is on the disk, where the system can: a power cut must not undo it."""
    with suppress(OSError):  # Windows opens no folders, and some network drives sync none
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def flush_to_disk(path: Path) -> None:
    """Wait until the file's bytes are on the disk, so that the rename cannot overtake them."""
    # Opened for updating because some systems refuse to sync a file that is only read.
    with path.open("rb+") as stream:
        os.fsync(stream.fileno())
