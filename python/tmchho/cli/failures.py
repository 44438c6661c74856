"""How a command ends: one clear sentence on stderr and an exit code that a script can trust."""

from __future__ import annotations

import errno
import signal
import threading
import traceback
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, TypeVar

import click

from tmchho.errors import BudgetError, TmchhoError

INTERNAL, NOT_ACCEPTED, INTERRUPTED = 1, 4, 130

EXIT_CODES = """\b
Exit codes:
  0    done; for a registration: the pose is accepted
  1    internal error
  2    wrong usage: an option, an argument or a configuration key
  3    an input file cannot be read, or its points cannot be registered
  4    not accepted: a person must look (review), or the pose is wrong (rejected), or none was found
  5    the output cannot be written
  6    more memory would be needed than there is
  130  interrupted
"""

_DEBUG = "tmchho.debug"

Command = TypeVar("Command", bound=Callable[..., Any])


class Commands(click.Group):
    """A group of commands that turns every error into its sentence and its exit code."""

    def list_commands(self, context: click.Context) -> list[str]:
        """Return the names in the order in which they were added, not in that of the alphabet."""
        return list(self.commands)

    def invoke(self, context: click.Context) -> Any:
        """Run the command that was asked for."""
        interrupts = _Interrupts()
        try:
            with interrupts.watched():
                return super().invoke(context)
        except (click.exceptions.Exit, click.Abort, click.ClickException, SystemExit, GeneratorExit):
            raise  # click's own ways out
        except BaseException as error:  # a panic in Rust does not derive from Exception
            if isinstance(error, OSError) and error.errno == errno.EPIPE:
                raise  # nobody reads our output any more: click ends quietly
            if context.meta.get(_DEBUG):
                click.echo(traceback.format_exc(), err=True, nl=False)
            message, code = _explained(KeyboardInterrupt() if interrupts.seen else error)
            click.echo(f"tmchho: {message}", err=True)
            context.exit(code)


def _explained(error: BaseException) -> tuple[str, int]:
    """Return the sentence for an error, and the exit code."""
    what = " ".join(str(error).split()) or type(error).__name__
    if isinstance(error, KeyboardInterrupt):
        return "interrupted; no unfinished file is left", INTERRUPTED
    if isinstance(error, TmchhoError):
        return f"error: {what}", error.exit_code
    if isinstance(error, MemoryError):
        return "error: not enough memory; thin the clouds out or cut them into tiles", BudgetError.exit_code
    return f"error: unexpected {type(error).__name__}: {what}; run with --debug for the traceback", INTERNAL


def end(document: Mapping[str, Any], summary: Callable[[], str], *, as_json: bool, accepted: bool) -> None:
    """Print what came out, as JSON or in words, and end the command with the exit code that belongs to it.

    Parameters
    ----------
    document : mapping
        The result for machines.
    summary : callable
        Makes the result for people.
    as_json : bool
        Which of the two is asked for.
    accepted : bool
        Whether nobody has to look at it.
    """
    from tmchho.outputs import json_text

    if as_json:
        click.echo(json_text(document), nl=False)
    else:
        click.echo(summary())
    if not accepted:
        click.get_current_context().exit(NOT_ACCEPTED)


def debug_option(command: Command) -> Command:
    """Give a command the flag ``--debug``."""

    def remember(context: click.Context, _option: click.Parameter, wanted: bool) -> None:
        if wanted:
            context.meta[_DEBUG] = True

    return click.option(
        "--debug",
        is_flag=True,
        is_eager=True,
        expose_value=False,
        callback=remember,
        help="Show every log message, and the traceback of an error.",
    )(command)


def wants_debug() -> bool:
    """Return whether the command that is running was given ``--debug``."""
    context = click.get_current_context(silent=True)
    return context is not None and bool(context.meta.get(_DEBUG))


class _Interrupts:
    """Raises `KeyboardInterrupt` on Ctrl-C and on a polite request to end (SIGTERM), and remembers it.

    Remembers, because a library may turn what is raised within its own callbacks into an error of its own.
    """

    def __init__(self) -> None:
        self.seen = False

    @contextmanager
    def watched(self) -> Iterator[None]:
        """Watch while the block runs; only the main thread can."""
        if threading.current_thread() is not threading.main_thread():
            yield
            return
        # Whoever ignores a signal (nohup) wants it ignored here, too.
        numbers = [n for n in (signal.SIGINT, signal.SIGTERM) if signal.getsignal(n) is not signal.SIG_IGN]
        before = {number: signal.signal(number, self._handle) for number in numbers}
        try:
            yield
        finally:
            for number, handler in before.items():
                signal.signal(number, handler or signal.SIG_DFL)

    def _handle(self, _number: int, _frame: object) -> None:
        self.seen = True
        raise KeyboardInterrupt
