"""What a network has finished, on disk, so that a killed run goes on where it was.

A result lies under a key made of everything that it depends on: the version of the program, the function,
and the item with its settings and references to files. Nothing has to be told about an earlier run: what is
still valid is found, and what is not has another key. A file appears whole or not at all, and is on the disk
before it counts.
Absent on purpose: pickle. What is read back is JSON and its checksum, and cannot run anything.
"""

from __future__ import annotations

import hashlib
import json
import logging
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tmchho import __version__
from tmchho.errors import ReadError, WriteError
from tmchho.io.atomic import atomic_path, reason
from tmchho.io.format import NOTE
from tmchho.network.engine import Engine, Finished, Item, Unit, plain

logger = logging.getLogger(__name__)

StrPath = str | os.PathLike[str]
_CHUNK_BYTES = 1 << 20


def input_reference(path: StrPath) -> dict[str, Any]:
    """Refer to a file that somebody brings: it is taken for another one when its size or its time changes.

    Parameters
    ----------
    path : str or path
        The file.

    Returns
    -------
    dict
        ``path``, made absolute, ``n_bytes`` and ``modified_ns``. The path counts, too.

    Raises
    ------
    ReadError
        If there is no such file.
    """
    path = Path(path).absolute()
    try:
        status = path.stat()
    except OSError as error:
        raise ReadError(f"{path}: cannot be read ({reason(error)}); check the name") from error
    return {"path": str(path), "n_bytes": status.st_size, "modified_ns": status.st_mtime_ns}


def made_reference(path: StrPath) -> dict[str, str]:
    """Refer to a file that a unit made: by its checksum, whatever it is called and wherever it lies.

    Parameters
    ----------
    path : str or path
        The file, complete.

    Returns
    -------
    dict
        ``path``, made absolute, and ``sha256``. Only the latter counts.

    Raises
    ------
    ReadError
        If there is no such file.
    """
    path = Path(path).absolute()
    return {"path": str(path), "sha256": _checksum(path)}


class Store:
    """Finished results, one file each.

    Parameters
    ----------
    folder : str or path
        Made when the first result is written.
    """

    def __init__(self, folder: StrPath) -> None:
        self.folder = Path(folder)

    def get(self, stage: str, key: str) -> Item | None:
        """Return a result, or None where there is none that can be relied on; damage is said."""
        path = self._path(stage, key)
        try:
            text = path.read_text(encoding="utf-8")
        except FileNotFoundError:
            return None
        except (OSError, UnicodeDecodeError) as error:
            _complain(path, reason(error))
            return None
        try:
            entry = json.loads(text)
            result, checksum = entry["result"], entry["sha256"]
        except (ValueError, KeyError, TypeError):
            result, checksum = None, ""
        if not isinstance(result, dict) or checksum != _digest(result):
            _complain(path, "it is damaged")
            return None
        for made in _made_files(result):
            file = Path(made["path"])
            if not file.is_file() or _checksum(file) != made["sha256"]:
                _complain(path, f"{file}, which it speaks of, is gone, changed or damaged")
                return None
        return result

    def put(self, stage: str, key: str, result: Item) -> None:
        """Write down a result, which is on the disk when this returns.

        Raises
        ------
        WriteError
            If it cannot be written.
        """
        path = self._path(stage, key)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise WriteError(f"{path.parent}: cannot be made ({reason(error)}); check the disk") from error
        # In its own order, in which it is read back: a result must be the same wherever it comes from.
        text = json.dumps({"sha256": _digest(result), "result": result})
        with atomic_path(path, overwrite=True) as temporary:
            temporary.write_text(text + "\n", encoding="utf-8", newline="\n")

    def tidy(self) -> None:
        """Remove the unfinished files that a kill left; only where no other run works in the folder."""
        for leftover in self.folder.rglob(".*.tmp-*"):
            leftover.unlink(missing_ok=True)

    def _path(self, stage: str, key: str) -> Path:
        # Two digits more, so that no folder holds a hundred thousand files.
        return self.folder / stage / key[:2] / f"{key}.json"


class Resumed:
    """An engine that does only what is not in the store, and puts there whatever it does.

    Parameters
    ----------
    engine : Engine
        Does the work.
    store : Store
        What is done already.
    """

    def __init__(self, engine: Engine, store: Store) -> None:
        self.engine, self.store = engine, store

    def run(
        self, stage: str, unit: Unit, items: Sequence[Item], *, finished: Finished | None = None
    ) -> list[Item]:
        """Return the results of all items; see `Engine.run`."""
        items = [plain(item) for item in items]
        keys = [unit_key(stage, unit, item) for item in items]
        known = [self.store.get(stage, key) for key in keys]
        missing = [place for place, result in enumerate(known) if result is None]
        if len(missing) < len(items):
            n_done = len(items) - len(missing)
            logger.log(NOTE, "%s: %d of %d are done already", stage, n_done, len(items))
        results = [{} if result is None else result for result in known]

        def keep(number: int, result: Item) -> None:
            place = missing[number]
            self.store.put(stage, keys[place], result)
            results[place] = result
            if finished is not None:
                finished(place, result)

        if finished is not None:
            for place, result in enumerate(known):
                if result is not None:
                    finished(place, result)
        self.engine.run(stage, unit, [items[place] for place in missing], finished=keep)
        return results


def unit_key(stage: str, unit: Unit, item: Item) -> str:
    """Return the key of a result: 64 hexadecimal digits of everything that it depends on."""
    name = f"{unit.__module__}.{unit.__qualname__}"
    return _digest({"version": __version__, "stage": stage, "unit": name, "item": _without_places(item)})


def _without_places(value: Any) -> Any:
    """Leave out where files lie that are known by their checksum."""
    if isinstance(value, dict):
        if _is_made(value):
            return {"sha256": value["sha256"]}
        return {key: _without_places(part) for key, part in value.items()}
    if isinstance(value, list):
        return [_without_places(part) for part in value]
    return value


def _made_files(value: Any) -> list[dict[str, str]]:
    """Return the references to files that a unit made, wherever they stand."""
    if isinstance(value, dict) and not _is_made(value):
        value = list(value.values())
    if isinstance(value, list):
        return [made for part in value for made in _made_files(part)]
    return [value] if _is_made(value) else []


def _is_made(value: Any) -> bool:
    return isinstance(value, dict) and value.keys() == {"path", "sha256"}


def _digest(document: Item) -> str:
    text = json.dumps(document, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def _checksum(path: Path) -> str:
    digest = hashlib.sha256()
    try:
        with path.open("rb") as stream:
            while chunk := stream.read(_CHUNK_BYTES):
                digest.update(chunk)
    except OSError as error:
        raise ReadError(f"{path}: cannot be read ({reason(error)}); check the name") from error
    return digest.hexdigest()


def _complain(path: Path, why: str) -> None:
    logger.warning("%s: cannot be used again (%s); it is computed anew", path, why)
