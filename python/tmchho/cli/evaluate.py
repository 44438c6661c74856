"""`tmchho evaluate`: how far two clouds lie apart."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from tmchho.cli.display import display
from tmchho.cli.failures import debug_option
from tmchho.cli.options import PATH, json_option, positive, quiet_option

if TYPE_CHECKING:
    from tmchho import Evaluation

# Heading, and what it is called in DistanceStatistics; the first four as in the article's Table 7.
_COLUMNS = {
    "Avg": "mean",
    "Best": "best",
    "Worst": "worst",
    "Std": "std",
    "RMS": "rms",
    "Median": "median",
    "95 %": "percentile_95",
}


@click.command(short_help="Measure how far two clouds lie apart.")
@click.argument("source", type=PATH)
@click.argument("target", type=PATH)
@click.option(
    "--transform",
    type=PATH,
    metavar="FILE",
    help="transform.txt or result.json that takes SOURCE to TARGET.  [default: as they lie]",
)
@click.option(
    "--tolerance",
    type=float,
    callback=positive,
    metavar="LENGTH",
    help="Also tell the share of points that lie within this distance.",
)
@json_option
@quiet_option
@debug_option
def evaluate(
    source: Path, target: Path, transform: Path | None, tolerance: float | None, as_json: bool, quiet: bool
) -> None:
    """Measure the distances from each point of SOURCE to the nearest of TARGET, and the other way round.

    The distances are in the unit of the clouds. Where the clouds overlap only in part, the largest ones tell
    of the overlap, not of the fit.
    """
    from tmchho import evaluate as measure
    from tmchho import read
    from tmchho.outputs import json_text, read_matrix

    matrix = None if transform is None else read_matrix(transform)
    with display(quiet) as shown:
        with shown.step("read", f"reading {source}"):
            source_cloud = read(source)
        with shown.step("read", f"reading {target}"):
            target_cloud = read(target)
        with shown.step("evaluate", "measuring distances"):
            result = measure(source_cloud, target_cloud, matrix, tolerance=tolerance)
    rows = _rows(result)
    if as_json:
        document = {"source": source.name, "target": target.name, "tolerance": tolerance, **rows}
        click.echo(json_text(document), nl=False)
    else:
        click.echo(_table(rows, tolerance))


def _rows(result: Evaluation) -> dict[str, dict[str, Any]]:
    shares = result.share_within or (None, None)
    both = {
        "source_to_target": (result.source_to_target_statistics, shares[0]),
        "target_to_source": (result.target_to_source_statistics, shares[1]),
    }
    return {
        direction: {
            "n_points": statistics.n_points,
            **{name: getattr(statistics, name) for name in _COLUMNS.values()},
            "share_within": share,
        }
        for direction, (statistics, share) in both.items()
    }


def _table(rows: dict[str, dict[str, Any]], tolerance: float | None) -> str:
    headings = ["", "points", *_COLUMNS] + ([] if tolerance is None else [f"within {tolerance:g}"])
    lines = [headings]
    for direction, row in rows.items():
        cells = [direction.replace("_", " "), f"{row['n_points']:,}"]
        cells += [f"{row[name]:.5g}" for name in _COLUMNS.values()]
        cells += [] if tolerance is None else [f"{100 * row['share_within']:.1f} %"]
        lines.append(cells)
    widths = [max(len(cells[column]) for cells in lines) for column in range(len(headings))]
    return "\n".join(
        "  ".join([cells[0].ljust(widths[0]), *map(str.rjust, cells[1:], widths[1:])]).rstrip()
        for cells in lines
    )
