"""`tmchho register`: two files in, a folder of results out."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from tmchho.cli.display import display
from tmchho.cli.failures import EXIT_CODES, NOT_ACCEPTED, debug_option
from tmchho.cli.options import PATH, json_option, output_option, overwrite_option, positive, quiet_option

if TYPE_CHECKING:
    from tmchho import Config
    from tmchho.cli.workflow import Outcome


@click.command(short_help="Move a cloud onto another and fuse the two.", epilog=EXIT_CODES)
@click.argument("source", type=PATH)
@click.argument("target", type=PATH)
@output_option(required=True)
@click.option(
    "--mode",
    type=click.Choice(["robust", "paper"]),
    help="robust (default): many starts, checked in both directions. paper: the method as published.",
)
@click.option("--seed", type=click.IntRange(min=0), help="Seed of all random numbers.  [default: 0]")
@click.option(
    "--config",
    type=PATH,
    metavar="FILE",
    help="TOML file with settings; see `tmchho config`. Options here win.",
)
@click.option(
    "--threads", type=click.IntRange(min=1), help="Threads; never changes the result.  [default: all]"
)
@click.option(
    "--voxel-size",
    type=float,
    callback=positive,
    metavar="LENGTH",
    help="Edge of the voxels, in the unit of the clouds.  [default: derived from the clouds]",
)
@click.option(
    "--fuse",
    type=click.Choice(["merge", "fill-holes"]),
    help="Take all points of the source (merge, default), or only those that fill holes of the target.",
)
@json_option
@quiet_option
@overwrite_option
@debug_option
def register(
    source: Path,
    target: Path,
    output: Path,
    mode: str | None,
    seed: int | None,
    config: Path | None,
    threads: int | None,
    voxel_size: float | None,
    fuse: str | None,
    as_json: bool,
    quiet: bool,
    overwrite: bool,
) -> None:
    """Move SOURCE onto TARGET, fuse the two, and say how far the result can be trusted.

    \b
    Writes into the folder given with -o:
      fused.laz              both clouds in one, with the origin of each point
      source_registered.laz  SOURCE in the frame of TARGET, with all its attributes
      transform.txt          the 4 x 4 matrix from SOURCE to TARGET, as CloudCompare reads it
      result.json            verdict, figures, settings and checksums

    Where the pose is rejected, only result.json is written.
    """  # noqa: D301 (\b is for click: keep these lines as they are)
    from tmchho.cli.workflow import Job, run

    settings = _settings(config, mode, seed, threads, voxel_size, fuse)
    options = {"--config": config, "--mode": mode, "--seed": seed, "--voxel-size": voxel_size, "--fuse": fuse}
    command = replay_command(source, target, options)
    with display(quiet) as shown:
        outcome = run(Job(source, target, output, settings, command, overwrite), shown)
    if as_json:
        from tmchho.outputs import json_text

        click.echo(json_text(outcome.document), nl=False)
    else:
        click.echo(summary(outcome))
    if not outcome.is_accepted:
        click.get_current_context().exit(NOT_ACCEPTED)


def replay_command(source: Path, target: Path, options: dict[str, Any]) -> str:
    """Return a command line that gives the same result again, in a folder of its own."""
    words = ["tmchho", "register", str(source), str(target), "-o", "replay"]
    for name, value in options.items():
        if value is not None:
            words += [name, str(value)]
    return shlex.join(words)


def summary(outcome: Outcome) -> str:
    """Return the result in words: verdict, figures, files, and what to do next."""
    lines = [outcome.registration.summary()]
    if outcome.fused is not None:
        counts = outcome.document["fused"]
        lines.append(
            f"fused: {counts['n_points']:,} points, {counts['n_from_target']:,} of the target and "
            f"{counts['n_from_source']:,} of the source; {counts['n_filled_by_source']:,} of these fill "
            f"holes of the target (farther than {counts['hole_radius']:.4g} from it)"
        )
    lines += ["written:", *(f"  {path}" for path in outcome.files)]
    if outcome.registration.verdict == "review":
        lines.append(
            "A person must look at fused.laz before anyone relies on it: the pose is probably right, but "
            "not surely."
        )
    if outcome.registration.verdict == "rejected":
        lines.append("The clouds were not fused, because this pose must not be used.")
    return "\n".join(lines)


def _settings(
    config: Path | None,
    mode: str | None,
    seed: int | None,
    threads: int | None,
    voxel_size: float | None,
    fuse: str | None,
) -> Config:
    """Return the settings of the file with those of the options on top."""
    from tmchho import Config

    settings = Config.from_toml(config).to_dict() if config is not None else {}
    given = {
        (None, "mode"): mode,
        (None, "seed"): seed,
        (None, "n_threads"): threads,
        ("voxel", "voxel_size_m"): voxel_size,
        ("fuse", "mode"): None if fuse is None else fuse.replace("-", "_"),
    }
    for (section, key), value in given.items():
        if value is not None:
            (settings if section is None else settings.setdefault(section, {}))[key] = value
    return Config.from_dict(settings)  # checked now, before anything is read
