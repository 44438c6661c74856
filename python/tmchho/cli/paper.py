"""`tmchho paper`: the paper's tables and figures, run again and shown beside what is printed."""

from __future__ import annotations

import shlex
from collections.abc import Callable
from pathlib import Path

import click

from tmchho.cli.display import Display, display
from tmchho.cli.failures import EXIT_CODES, debug_option
from tmchho.cli.options import output_option, quiet_option
from tmchho.paper import SECTIONS, Settings, reproduce
from tmchho.progress import ProgressEvent

ALL = "all"
_DEFAULTS = Settings()

_EXAMPLES = """\b
Examples:
  # the optimisers on functions, in seconds
  tmchho paper table3 figure6
  # registrations of real scans, as often as the article
  TMCHHO_DATA=/path/to/scans tmchho paper table4 table5 --runs 20

"""


@click.command(short_help="Reproduce the paper's tables and figures.", epilog=_EXAMPLES + EXIT_CODES)
@click.argument("names", nargs=-1, required=True, metavar="NAME...", type=click.Choice([*SECTIONS, ALL]))
@output_option(default=Path("out/paper"), show_default=True)
@click.option(
    "--runs",
    type=click.IntRange(min=1),
    help="Searches for each figure.  [default: 30 on functions, 15 at equal budgets, 3 registrations]",
)
@click.option(
    "--seed",
    type=click.IntRange(min=0),
    default=_DEFAULTS.seed,
    show_default=True,
    help="Seed of the first run.",
)
@click.option(
    "--iterations",
    type=click.IntRange(min=1),
    help="Iterations of each search.  [default: the paper's, 100 on functions, 500 for registrations]",
)
@click.option(
    "--points",
    type=click.IntRange(min=1000),
    default=_DEFAULTS.n_site_points,
    show_default=True,
    help="Points of the photogrammetry of the simulated dam site; the scanner has three fifths as many.",
)
@quiet_option
@debug_option
def paper(
    names: tuple[str, ...],
    output: Path,
    runs: int | None,
    seed: int,
    iterations: int | None,
    points: int,
    quiet: bool,
) -> None:
    """Run the paper's experiments again, and more; show ours beside the printed values.

    \b
    NAME is one or more of
      table3 figure6 figure3                          the optimisers on functions, the chaotic maps
      table4 table5 figure8 figure9 figure10          Stanford's objects (Section 5.2)
      table6 table7 figure14                          the dam site (Section 5.3), simulated
      ranks ablation budgets shifted modern success   what the paper leaves out
      all                                             everything

    The folder gets a CSV file for each table, a PNG file for each picture, and paper.html, one page with
    all that was asked for. Finished runs are kept there in runs.jsonl: an interrupted command goes on where
    it was, and more --runs are added to those that are there. Results of an earlier call are replaced.

    On two idle cores `all` takes about half an hour, nearly all of it registrations; with --runs 20, the
    number of the paper's Section 5.2, about two hours. Table 3 alone takes seconds. What each run took is in
    runs.jsonl.

    Real scans are read from the folder that TMCHHO_DATA names (stanford/pairs.json and what it lists);
    where it is not set, simulated objects stand in for them. Needs the extra: pip install 'tmchho[paper]'.
    """  # noqa: D301 (\b is for click: keep these lines as they are)
    wanted = list(SECTIONS) if ALL in names else [name for name in SECTIONS if name in names]
    settings = Settings(runs=runs, seed=seed, n_iterations=iterations, n_site_points=points)
    with display(quiet) as shown:
        found, files = reproduce(
            wanted, output, settings, _command(names, output, settings), _progress_on(shown)
        )
    for section, content in found:
        click.echo(section.title)
        for finding in content.findings:
            click.echo(f"  {finding}")
    click.echo(f"page: {files[0]}")


def _command(names: tuple[str, ...], output: Path, settings: Settings) -> str:
    words = ["tmchho", "paper", *names, "-o", str(output), "--seed", str(settings.seed)]
    if settings.runs is not None:
        words += ["--runs", str(settings.runs)]
    if settings.n_iterations is not None:
        words += ["--iterations", str(settings.n_iterations)]
    if settings.n_site_points != _DEFAULTS.n_site_points:
        words += ["--points", str(settings.n_site_points)]
    return shlex.join(words)


def _progress_on(shown: Display) -> Callable[[str, int, int], None]:
    begun: set[str] = set()

    def tell(title: str, done: int, total: int) -> None:
        if title not in begun:
            begun.add(title)
            heading = (
                f"{title}: {total - done:,} of {total:,} runs to do" if done else f"{title}: {total:,} runs"
            )
            shown.on_event(ProgressEvent(heading, 0, 0, None, started=True))
        shown.on_event(ProgressEvent(title, done, total, None, started=False))

    return tell
