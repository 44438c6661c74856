"""What is said on stderr while a command works.

A terminal gets one moving line with the stage, its share done and the best score; a file or a pipe gets a
line for each step; ``--quiet`` silences both. Warnings of the library appear here, too.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from tmchho.cli.failures import wants_debug
from tmchho.io.format import NOTE

if TYPE_CHECKING:
    from tmchho import ProgressEvent

_STAGES = {
    "outliers": "removing outliers",
    "voxel": "thinning both clouds",
    "keypoints": "finding keypoints",
    "coarse": "searching for the pose",
    "icp": "refining the pose (ICP)",
    "verdict": "judging the pose",
    "evaluate": "measuring distances",
    "fuse": "fusing",
}


class Display:
    """Progress and notes on stderr.

    Parameters
    ----------
    console : rich.console.Console
        Where to.
    progress : rich.progress.Progress, optional
        The moving line, on a terminal.
    quiet : bool
        Say nothing but warnings and errors.
    """

    def __init__(self, console: Console, progress: Progress | None, quiet: bool) -> None:
        self.console = console
        self.quiet = quiet
        self.seconds: dict[str, float] = {}
        self._progress = progress
        self._task = None if progress is None else progress.add_task("", total=None, best="")

    def note(self, text: str) -> None:
        """Say something that stays on the screen."""
        if not self.quiet:
            self._print(text)

    def warn(self, text: str) -> None:
        """Say something that must be heard even if quiet."""
        self._print(f"warning: {text}")

    def fail(self, text: str) -> None:
        """Tell of an error after which the command goes on."""
        self._print(f"error: {text}")

    @contextmanager
    def step(self, key: str, heading: str | None = None) -> Iterator[None]:
        """Show the heading, if there is one, and add the time the block takes to ``seconds[key]``."""
        if heading is not None:
            self._head(heading)
        start = time.perf_counter()
        yield
        self.seconds[key] = self.seconds.get(key, 0.0) + time.perf_counter() - start

    def on_event(self, event: ProgressEvent) -> None:
        """Show what a registration tells about itself."""
        if event.started:
            self._head(_STAGES.get(event.stage, event.stage))
        elif self._progress is not None and self._task is not None:
            best = "" if event.best is None else f"best {event.best:.6g}"
            self._progress.update(self._task, completed=event.done, total=event.total, best=best)

    def _head(self, text: str) -> None:
        if self._progress is not None and self._task is not None:
            self._progress.reset(self._task, total=None, description=escape(text), best="")
        else:
            self.note(text)

    def _print(self, text: str) -> None:
        self.console.print(f"tmchho: {text}", markup=False, highlight=False, soft_wrap=True)


@contextmanager
def display(quiet: bool) -> Iterator[Display]:
    """Open the display for one command.

    Parameters
    ----------
    quiet : bool
        Say nothing but warnings and errors.

    Yields
    ------
    Display
    """
    console = Console(stderr=True)
    if quiet or not console.is_terminal:
        with _logging_to(Display(console, None, quiet)) as shown:
            yield shown
        return
    columns = (
        SpinnerColumn(),
        TextColumn("{task.description}"),
        BarColumn(bar_width=24),
        TextColumn("{task.fields[best]}", style="dim"),
        TimeElapsedColumn(),
    )
    with (
        Progress(*columns, console=console, transient=True) as progress,
        _logging_to(Display(console, progress, quiet)) as shown,
    ):
        yield shown


@contextmanager
def _logging_to(shown: Display) -> Iterator[Display]:
    """Send what the library logs to the display while a command works."""

    class Handler(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            say = shown.warn if record.levelno >= logging.WARNING else shown.note
            say(record.getMessage())

    logger, handler = logging.getLogger("tmchho"), Handler()
    propagates, level = logger.propagate, logger.level
    logger.addHandler(handler)
    logger.propagate = False
    logger.setLevel(logging.INFO if wants_debug() else NOTE)
    try:
        yield shown
    finally:
        logger.removeHandler(handler)
        logger.propagate = propagates
        logger.setLevel(level)
