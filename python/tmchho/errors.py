"""Every error that `tmchho` raises on purpose.

Each class belongs to one exit code of the command line, and derives from the built-in class that
Python programmers already catch for that kind of mistake. The Rust core raises these very classes.
"""

from __future__ import annotations


class TmchhoError(Exception):
    """Base of all errors of this package."""

    exit_code = 1


class InvalidArgumentError(TmchhoError, ValueError):
    """An argument, option or configuration key is wrong; the message names it."""

    exit_code = 2


class InvalidCloudError(TmchhoError, ValueError):
    """A cloud cannot be registered as it is: empty, too few points, all on one line, not finite."""

    exit_code = 3


class ReadError(TmchhoError, OSError):
    """A file is missing, of an unknown kind, truncated or damaged; the message names it."""

    exit_code = 3


class NoSolutionError(TmchhoError):
    """The search ended without any pose that could be returned."""

    exit_code = 4


class WriteError(TmchhoError, OSError):
    """An output file or folder cannot be written; nothing half-written is left behind."""

    exit_code = 5


class BudgetError(TmchhoError, MemoryError):
    """The work would need more memory or time than allowed; the message says how much."""

    exit_code = 6


class StoppedError(TmchhoError):
    """The caller's own progress callback asked to stop; there is no result."""

    exit_code = 130
