"""Several files that appear in a folder together: all of them or none, and never those of two runs mixed."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from tmchho.errors import TmchhoError, WriteError
from tmchho.io.atomic import (
    check_output,
    check_writable_folder,
    flush_folder,
    flush_to_disk,
    own_mark,
    pending,
    sweep,
    uninterrupted,
)

StrPath = str | os.PathLike[str]


def write_together(
    folder: StrPath,
    files: Mapping[str, Callable[[Path], object]],
    *,
    overwrite: bool = False,
    inputs: Iterable[StrPath] = (),
    others: Iterable[str] = (),
) -> None:
    """Write several files into a folder: every one of them is complete before the first one appears.

    Two programs that write into one folder do so one after the other.

    Parameters
    ----------
    folder : str or path
        Made if it does not exist.
    files : mapping of str to callable
        For each name what writes the file, given a temporary path. The file named last appears first.
    overwrite : bool, default False
        Replace existing files.
    inputs : iterable of str or path
        Files that must never be replaced, even with `overwrite`.
    others : iterable of str
        Files of an earlier run that would be taken for ours: they are removed, unless they are among `files`.

    Raises
    ------
    WriteError
        If one of them cannot be written. No file of this call stays behind, nor a folder that it made;
        this holds for an interrupt, too.
    """
    folder, inputs = Path(folder), tuple(inputs)
    with _made_folder(folder), _alone_in(folder):
        sweep(folder)
        with ExitStack() as stack:
            moves = []
            for name, write in files.items():
                path = folder / name
                temporary, target = stack.enter_context(pending(path, overwrite, inputs))
                try:
                    write(temporary)
                except WriteError as error:
                    raise WriteError(str(error).replace(str(temporary), str(path))) from error.__cause__
                flush_to_disk(temporary)
                moves.append((temporary, target))
            for name in files:  # before the first appears, not one after the other
                check_output(folder / name, overwrite, inputs)
            with uninterrupted():  # all or none
                for temporary, target in reversed(moves):
                    os.replace(temporary, target)
                for name in set(others) - set(files):
                    (folder / name).unlink(missing_ok=True)
        flush_folder(folder)


@contextmanager
def _alone_in(folder: Path) -> Iterator[None]:
    """Wait until no other run writes into a folder, where the system can tell."""
    try:
        import fcntl
    except ImportError:  # Windows refuses to replace a file that another program has open
        yield
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        with suppress(OSError):  # some network drives know no locks
            fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        os.close(handle)


@contextmanager
def _made_folder(folder: Path) -> Iterator[None]:
    missing = [path for path in (folder, *folder.absolute().parents) if not path.exists()]
    check_writable_folder(folder)
    try:
        yield
    except BaseException:
        for path in missing:  # the innermost first; what is not empty is not ours
            with suppress(OSError):
                path.rmdir()
        raise


@contextmanager
def staging(folder: StrPath) -> Iterator[Path]:
    """Lend a folder within `folder` for files on their way.

    It goes whatever happens; on an error, so does every folder that had to be made. What a process that was
    killed has left goes as well.
    """
    folder = Path(folder)
    with _made_folder(folder):
        sweep(folder)
        try:
            scratch = Path(tempfile.mkdtemp(prefix=f".{own_mark()}-", dir=folder))
        except OSError as error:
            raise WriteError(f"{folder}: no folder can be made in it ({error.strerror})") from error
        try:
            yield scratch
        except TmchhoError:  # of an input that changed, say; some of them are OSError as well
            raise
        except OSError as error:
            raise WriteError(
                f"{folder}: the intermediate files, about 20 bytes a point, and the results cannot be "
                f"written there ({error.strerror or error}); make room or choose another folder"
            ) from error
        finally:
            shutil.rmtree(scratch, ignore_errors=True)
