"""`tmchho network`: many stations in, one frame out."""

from __future__ import annotations

import json
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from tmchho.cli.display import display
from tmchho.cli.failures import EXIT_CODES, debug_option, end
from tmchho.cli.options import (
    PATH,
    json_option,
    memory,
    output_option,
    overwrite_option,
    positive,
    quiet_option,
    report_option,
)

if TYPE_CHECKING:
    from tmchho import Config
    from tmchho.cli.network_run import NetworkOutcome
    from tmchho.network.project import Project

_EXAMPLES = """\b
Examples:
  # scans of which nothing is known, on all processors of this machine
  tmchho network scans/*.laz -o out
  # a project file with rough positions, control points and a UAV block
  tmchho network PROJECT.toml -o out
  # four processes of at most 8 GB each; the same results
  tmchho network PROJECT.toml -o out --workers 4 --memory-per-worker 8GB
  # the workers of a cluster, which see the files under the same paths
  tmchho network PROJECT.toml -o /shared/out --scheduler tcp://10.0.0.1:8786
  # after a power cut: go on from what was finished
  tmchho network PROJECT.toml -o out --resume

"""

# What the result depends on, in the order of a command that gives it again.
_REPLAYED = ("config", "seed", "levelled", "voxel_size", "min_overlap", "fuse", "repeat_radius")


@click.command(short_help="Move many stations into one frame.", epilog=_EXAMPLES + EXIT_CODES)
@click.argument("paths", type=PATH, nargs=-1, required=True, metavar="PROJECT.toml|FILES...")
@output_option(required=True)
@click.option("--seed", type=click.IntRange(min=0), help="Seed of all random numbers.  [default: 0]")
@click.option(
    "--config",
    type=PATH,
    metavar="FILE",
    help="TOML file with settings of the registration of a pair; see `tmchho config`. Replaces the section "
    "[registration] of a project.",
)
@click.option(
    "--levelled", is_flag=True, help="All clouds have z up: pairs are found sooner and more surely."
)
@click.option(
    "--voxel-size",
    type=float,
    callback=positive,
    metavar="LENGTH",
    help="Edge of the voxels of the fine adjustment.  [default: derived from the clouds]",
)
@click.option(
    "--min-overlap",
    type=click.FloatRange(0.01, 0.9),
    metavar="SHARE",
    help="Pairs of which less overlaps are not tried where positions are known.  [default: 0.1]",
)
@click.option("--threads", type=click.IntRange(min=1), help="Units of work at a time in this process.")
@click.option("--workers", type=click.IntRange(min=1), help="Processes to start on this machine, by Dask.")
@click.option(
    "--memory-per-worker",
    callback=memory,
    metavar="SIZE",
    help="Such as 4GB. A worker that takes more is replaced.  [default: the machine's by --workers]",
)
@click.option(
    "--scheduler",
    metavar="ADDRESS",
    help="Such as tcp://10.0.0.1:8786: a Dask scheduler whose workers do the work.",
)
@click.option(
    "--fuse",
    type=click.Choice(["merge", "dedup"]),
    help="Also write all stations into fused.laz: all points, or without those that repeat an earlier one's.",
)
@click.option(
    "--repeat-radius",
    type=float,
    callback=positive,
    metavar="LENGTH",
    help="Within this a point repeats another, for --fuse dedup.  [default: a quarter of the voxel]",
)
@click.option(
    "--resume", is_flag=True, help="Go on from what an earlier run in the same folder has finished."
)
@report_option
@json_option
@quiet_option
@overwrite_option
@debug_option
def network(
    paths: tuple[Path, ...], output: Path, as_json: bool, quiet: bool, overwrite: bool, **options: Any
) -> None:
    """Move many stations into one frame, and say how far each can be trusted.

    Pairs of stations are registered for themselves, checked by loops, and adjusted together. Give a project
    file, which says what is known of the stations, or the files alone.

    \b
    Writes into the folder given with -o:
      network.json  verdict, poses, links, loops, settings and checksums
      stations.csv  each station with its position and standard errors
      links.csv     each pair that was registered: overlap, RMS, strength, residual
      poses/        the pose of each station, as CloudCompare, PDAL and `tmchho apply` read it
      fused.laz     with --fuse: all points in one file, with station and distance to the others
      report.html   the same for people, with a map
      work/         what is finished so far, for --resume; may be deleted in the end

    Numbers of workers, threads and machines change nothing in the results.
    """  # noqa: D301 (\b is for click: keep these lines as they are)
    from tmchho.cli.network_run import NetworkJob, Where, run_network

    _check_usage(options, overwrite)
    project = _project(paths)
    given = project.network
    job = NetworkJob(
        project=project,
        folder=output,
        settings=_settings(project, options),
        command=_replay_command(paths, options),
        where=Where(
            options["scheduler"], options["workers"], options["memory_per_worker"], options["threads"]
        ),
        levelled=options["levelled"] or given.get("levelled", False),
        voxel_size=options["voxel_size"] or given.get("voxel_size_m"),
        min_overlap=options["min_overlap"] or given.get("min_overlap", 0.1),
        fuse=options["fuse"],
        repeat_radius=options["repeat_radius"],
        resume=options["resume"],
        overwrite=overwrite,
        has_report=options["report"],
    )
    with display(quiet) as shown:
        outcome = run_network(job, shown)
    is_accepted = outcome.found.verdict == "accepted"
    end(outcome.document, lambda: _summary(outcome), as_json=as_json, accepted=is_accepted)


def _check_usage(options: dict[str, Any], overwrite: bool) -> None:
    if options["resume"] and overwrite:
        raise click.UsageError("--resume goes on from an earlier run, --overwrite drops it: give one of them")
    if options["scheduler"] is not None:
        for name in ("workers", "memory_per_worker", "threads"):
            if options[name] is not None:
                raise click.UsageError(
                    f"--{name.replace('_', '-')} is for this machine; with --scheduler it is said where the "
                    "workers are started"
                )
    if options["memory_per_worker"] is not None and options["workers"] is None:
        raise click.UsageError("--memory-per-worker needs --workers")
    if options["workers"] is not None and options["threads"] is not None:
        raise click.UsageError("--threads is for this process alone: give it or --workers")
    if options["repeat_radius"] is not None and options["fuse"] != "dedup":
        raise click.UsageError("--repeat-radius belongs to --fuse dedup")


def _project(paths: tuple[Path, ...]) -> Project:
    from tmchho.network.project import project_of_files, read_project

    projects = [path for path in paths if path.suffix.lower() == ".toml"]
    if not projects:
        return project_of_files(paths)
    if len(paths) > 1:
        raise click.UsageError("give one project file, or the files of the clouds, not both")
    return read_project(projects[0])


def _settings(project: Project, options: dict[str, Any]) -> Config:
    """Return the settings of a pair, checked before a cloud is read."""
    from tmchho import Config
    from tmchho.config import config_json

    chosen = options["config"] if options["config"] is not None else dict(project.registration)
    return Config.from_dict(json.loads(config_json(chosen, seed=options["seed"])))


def _replay_command(paths: tuple[Path, ...], options: dict[str, Any]) -> str:
    words = ["tmchho", "network", *map(str, paths), "-o", "replay"]
    for name in _REPLAYED:
        value = options[name]
        if value is not None and value is not False:
            words += [f"--{name.replace('_', '-')}"] + ([] if value is True else [str(value)])
    return shlex.join(words)


def _summary(outcome: NetworkOutcome) -> str:
    lines = [outcome.found.summary()]
    fused = outcome.document["fused"]
    if fused is not None:
        lines.append(f"fused      {fused['n_points']:,} points, {fused['n_repeated']:,} repetitions left out")
    lines += ["written:", *(f"  {path}" for path in outcome.files)]
    if outcome.found.verdict != "accepted":
        lines.append("A person must look at report.html before anyone relies on the stations named above.")
    return "\n".join(lines)
