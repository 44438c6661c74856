"""The words of an experiment: what is run, what came of it, what is shown.

A *job* is one search, told completely by what is in it, so that a job that was done once is never done again.
A *series* is the jobs of one experiment and how one of them is done. A *section* shows one table or figure of
the paper; it computes nothing but statistics, and several sections may look at the same series.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeAlias

from tmchho.paper.pictures import Picture
from tmchho.paper.tables import Table

Job: TypeAlias = dict[str, Any]
"""Everything that decides a result, as JSON knows it."""

Result: TypeAlias = dict[str, Any]
"""What came of a job, as JSON knows it."""

ShouldStop: TypeAlias = Callable[[], bool]
"""Tells a job that is running whether the user wants it to end."""


@dataclass(frozen=True)
class Settings:
    """What the user chooses.

    Parameters
    ----------
    runs : int, optional
        Searches for each figure; the default of each series where not given.
    seed : int
        Seed of the first run; the others follow.
    n_iterations : int, optional
        Iterations of each search; those of the paper where not given.
    n_site_points : int
        Points of the simulated photogrammetry of the dam site.
    """

    runs: int | None = None
    seed: int = 0
    n_iterations: int | None = None
    n_site_points: int = 503_555

    def seeds(self, default_runs: int) -> range:
        """Return the seeds of the runs of a series."""
        return range(self.seed, self.seed + (self.runs or default_runs))


@dataclass(frozen=True)
class Run:
    """A job that was done."""

    job: Job
    result: Result


@dataclass(frozen=True)
class Series:
    """The jobs of one experiment.

    Parameters
    ----------
    title : str
        What the display says while it runs.
    jobs : callable
        Gets the settings and returns the jobs, in the order in which sections see them.
    run : callable
        Does one job.
    """

    title: str
    jobs: Callable[[Settings], list[Job]]
    run: Callable[[Job, ShouldStop], Result]


@dataclass(frozen=True)
class Content:
    """What a section shows.

    Parameters
    ----------
    how : tuple of str
        How it was run: runs, evaluations, clouds.
    tables : tuple of Table
    pictures : tuple of Picture
    findings : tuple of str
        What this run shows, worked out from its numbers.
    differences : tuple of str
        What differs from the paper, and why.
    """

    how: tuple[str, ...] = ()
    tables: tuple[Table, ...] = ()
    pictures: tuple[Picture, ...] = ()
    findings: tuple[str, ...] = ()
    differences: tuple[str, ...] = ()


@dataclass(frozen=True)
class Section:
    """One table or figure.

    Parameters
    ----------
    name : str
        What the command line calls it.
    title : str
        Its heading.
    series : Series
        The runs it looks at.
    show : callable
        Makes the content from those runs.
    """

    name: str
    title: str
    series: Series
    show: Callable[[list[Run]], Content]
