"""`tmchho evaluate`: how far two clouds lie apart."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import click

from tmchho.cli.display import display
from tmchho.cli.failures import debug_option
from tmchho.cli.options import PATH, areas_option, json_option, positive, quiet_option, tolerance_option

# Heading, and what it is called in a row of the result; the first four as in the article's Table 7.
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
@areas_option
@tolerance_option
@click.option(
    "--max-distance",
    type=float,
    callback=positive,
    metavar="LENGTH",
    help="Points farther away have no counterpart and are counted apart.  [default: all are measured]",
)
@json_option
@quiet_option
@debug_option
def evaluate(
    source: Path,
    target: Path,
    transform: Path | None,
    areas: Path | None,
    tolerance: float | None,
    max_distance: float | None,
    as_json: bool,
    quiet: bool,
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
            result = measure(
                source_cloud,
                target_cloud,
                matrix,
                tolerance=tolerance,
                max_distance=max_distance,
                areas="automatic" if areas is None else areas,
            )
        for warning in result.warnings:
            shown.warn(warning)
    document = {"source": source.name, "target": target.name, **result.to_dict()}
    if as_json:
        click.echo(json_text(document), nl=False)
    else:
        click.echo(_tables(document))


def _tables(document: Mapping[str, Any]) -> str:
    directions = ("source_to_target", "target_to_source")
    whole = [(name.replace("_", " "), document[name]) for name in directions]
    tables = [_table("", whole, document["tolerance"], [])]
    if document["areas"]:
        before, after = ("target covers", "completeness_before"), ("both cover", "completeness_after")
        rows = [(row["name"], row) for row in document["areas"]]
        tables.append(_table("source to target", rows, document["tolerance"], [before, after]))
    return "\n\n".join(tables)


def _table(
    heading: str,
    rows: Sequence[tuple[str, Mapping[str, Any]]],
    tolerance: float | None,
    shares: Sequence[tuple[str, str]],
) -> str:
    """Return rows under headings; `shares` are further columns in percent."""
    shares = [*([] if tolerance is None else [(f"within {tolerance:g}", "share_within")]), *shares]
    beyond = any(row["n_beyond"] for _, row in rows)
    lines = [[heading, "points", *(["beyond"] if beyond else []), *_COLUMNS, *(title for title, _ in shares)]]
    for name, row in rows:
        cells = [name, f"{row['n_points']:,}", *([f"{row['n_beyond']:,}"] if beyond else [])]
        lengths = [row.get(key) for key in _COLUMNS.values()]
        cells += ["no data" if value is None else f"{value:.5g}" for value in lengths]
        percents = [row.get(key) for _, key in shares]
        cells += ["no data" if value is None else f"{100 * value:.1f} %" for value in percents]
        lines.append(cells)
    widths = [max(len(cells[column]) for cells in lines) for column in range(len(lines[0]))]
    return "\n".join(
        "  ".join([cells[0].ljust(widths[0]), *map(str.rjust, cells[1:], widths[1:])]).rstrip()
        for cells in lines
    )
