"""`tmchho register`: two files in, a folder of results out."""

from __future__ import annotations

import json
import math
import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from tmchho.cli.display import display
from tmchho.cli.failures import EXIT_CODES, debug_option, end
from tmchho.cli.options import (
    PATH,
    area,
    areas_option,
    classes,
    json_option,
    max_memory_option,
    output_option,
    overwrite_option,
    positive,
    quiet_option,
    report_option,
    tolerance_option,
)

if TYPE_CHECKING:
    from tmchho import Config, ControlPoint, PosePrior
    from tmchho.cli.workflow import Outcome
    from tmchho.selection import Selection

_EXAMPLES = """\b
Examples:
  tmchho register uav.las tls.laz -o out
  # both clouds are levelled
  tmchho register uav.las tls.laz -o out --dof 4
  # a model without a scale, and where four targets lie in both clouds
  tmchho register model.ply tls.laz -o out --dof 7 --control-points targets.csv
  # a pose that is known to 10 degrees and 5 metres
  tmchho register uav.las tls.laz -o out --prior rough.txt --prior-sigma-deg 10 --prior-sigma 5
  # only what lies in a box of the source takes part
  tmchho register uav.las tls.laz -o out --crop-source 0,0,-5,100,80,40

"""

# What the result depends on, in the order of a command that gives it again.
_REPLAYED = (
    "config",
    "mode",
    "seed",
    "dof",
    "prior",
    "prior_sigma_deg",
    "prior_sigma",
    "control_points",
    "crop_source",
    "crop_target",
    "crop",
    "keep_class",
    "max_seconds",
    "voxel_size",
    "fuse",
    "areas",
    "tolerance",
)


@click.command(short_help="Move a cloud onto another and fuse the two.", epilog=_EXAMPLES + EXIT_CODES)
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
    "--dof",
    type=click.Choice(["4", "6", "7"]),
    help="Degrees of freedom. 4: both clouds are levelled, z is up. 6 (default): any rotation. 7: the source "
    "has another scale as well, within scale_bounds of --config.",
)
@click.option(
    "--prior",
    type=PATH,
    metavar="FILE",
    help="transform.txt or result.json that takes SOURCE to TARGET roughly; how roughly is said by the next "
    "two, of which at least one is needed.",
)
@click.option(
    "--prior-sigma-deg",
    type=float,
    callback=positive,
    metavar="DEGREES",
    help="Standard deviation of the rotation about each axis.  [default: the rotation is not known]",
)
@click.option(
    "--prior-sigma",
    type=float,
    callback=positive,
    metavar="LENGTH",
    help="Standard deviation, along each axis, of where the middle of SOURCE comes to lie.  [default: the "
    "position is not known]",
)
@click.option(
    "--control-points",
    type=PATH,
    metavar="FILE",
    help="Places measured in both clouds, one a line: x,y,z in SOURCE, x,y,z in TARGET, standard deviation.",
)
@click.option(
    "--crop-source",
    callback=area,
    metavar="AREA",
    help="xmin,ymin,zmin,xmax,ymax,zmax, or a file with a polygon (GeoJSON, or lines with x y): only points "
    "of SOURCE in it take part in finding the pose.",
)
@click.option("--crop-target", callback=area, metavar="AREA", help="The same for TARGET.")
@click.option(
    "--crop", callback=area, metavar="AREA", help="The same for both, where they lie in one frame already."
)
@click.option(
    "--keep-class",
    callback=classes,
    metavar="CLASSES",
    help="Only points of these classifications, such as 2,6, take part in finding the pose.",
)
@click.option(
    "--assume-same-crs",
    is_flag=True,
    help="Go on where the coordinate reference systems of the files differ: the result is in that of TARGET.",
)
@max_memory_option
@click.option(
    "--max-seconds",
    type=float,
    callback=positive,
    metavar="SECONDS",
    help="Take the best pose that the search has found by then; it is not accepted unless it stands out.",
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
    type=click.Choice(["merge", "dedup", "fill-holes"]),
    help="Take all points of the source (merge, default), all but those that repeat the target (dedup), or "
    "only those that fill holes of the target.",
)
@areas_option
@tolerance_option
@report_option
@json_option
@quiet_option
@overwrite_option
@debug_option
def register(
    source: Path, target: Path, output: Path, as_json: bool, quiet: bool, overwrite: bool, **options: Any
) -> None:
    """Move SOURCE onto TARGET, fuse the two, and say how far the result can be trusted.

    \b
    Writes into the folder given with -o:
      fused.laz              both clouds in one, with the origin of each point
      source_registered.laz  SOURCE in the frame of TARGET, with all its attributes
      transform.txt          the 4 x 4 matrix from SOURCE to TARGET, as CloudCompare reads it
      transform.json         the same in every form, also about pivots; for `tmchho apply`
      pdal.json              a PDAL pipeline that moves SOURCE
      result.json            verdict, figures, settings and checksums
      report.html            the same for people, with pictures and a 3D view
      report_points.npz      the points that the report shows

    Where the pose is rejected, only the last three are written.
    """  # noqa: D301 (\b is for click: keep these lines as they are)
    from tmchho.cli.workflow import Job, run

    settings = _settings(options)
    replayed = {f"--{name.replace('_', '-')}": _word(options[name]) for name in _REPLAYED}
    if options["assume_same_crs"]:
        replayed["--assume-same-crs"] = ""
    command = replay_command(source, target, replayed)
    job = Job(
        source,
        target,
        output,
        settings,
        command,
        overwrite,
        max_memory=options["max_memory"],
        assume_same_crs=options["assume_same_crs"],
        selections=tuple(
            _selection(options["crop"] or options[name], options["keep_class"])
            for name in ("crop_source", "crop_target")
        ),
        areas=options["areas"],
        tolerance=options["tolerance"],
        has_report=options["report"],
    )
    with display(quiet) as shown:
        outcome = run(job, shown)
    end(outcome.document, lambda: summary(outcome), as_json=as_json, accepted=outcome.is_accepted)


def replay_command(source: Path, target: Path, options: dict[str, Any]) -> str:
    """Return a command line that gives the same result again, in a folder of its own."""
    words = ["tmchho", "register", str(source), str(target), "-o", "replay"]
    for name, value in options.items():
        if value is not None:
            words += [name, str(value)] if value != "" else [name]
    return shlex.join(words)


def summary(outcome: Outcome) -> str:
    """Return the result in words: verdict, figures, files, and what to do next."""
    lines = [outcome.registration.summary()]
    counts = outcome.document["fused"]
    if counts is not None:
        lines.append(
            f"fused: {counts['n_points']:,} points, {counts['n_from_target']:,} of the target and "
            f"{counts['n_from_source']:,} of the source; {counts['n_filled_by_source']:,} of these fill "
            f"holes of the target (farther than {counts['hole_radius']:.4g} from it), an area of "
            f"{counts['area_filled_by_source']:.4g}"
        )
        if counts["n_repeated"]:
            lines.append(f"left out: {counts['n_repeated']:,} points of the source that repeat the target")
    lines += ["written:", *(f"  {path}" for path in outcome.files)]
    if outcome.registration.verdict == "review":
        lines.append(
            "A person must look at fused.laz before anyone relies on it: the pose may be right, but the "
            "data alone do not make it sure."
        )
    if outcome.registration.verdict == "rejected":
        lines.append("The clouds were not fused, because this pose must not be used.")
    if outcome.registration.verdict != "accepted":
        ways = _ways_to_settle(outcome.registration.config)
        lines += [f"What may settle it: {', or '.join(ways)}."] if ways else []
    return "\n".join(lines)


def _ways_to_settle(config: Mapping[str, Any]) -> list[str]:
    """Return what somebody could add to what was said of the pose."""
    if config["mode"] == "paper":
        return ["--mode robust, which compares the pose with others"]
    ways = []
    if config["dof"] != 4:
        ways.append("--dof 4 if z is up in both files")
    if not config["known"]["prior"]:
        ways.append("--prior with a rough pose")
    if not config["known"]["control_points"]:
        ways.append("--control-points measured in both clouds")
    return ways


def _settings(options: Mapping[str, Any]) -> Config:
    """Return the settings of the file with those of the options on top."""
    from tmchho import Config
    from tmchho.config import config_json

    fuse, dof = options["fuse"], options["dof"]
    settings = config_json(
        options["config"],
        mode=options["mode"],
        seed=options["seed"],
        n_threads=options["threads"],
        dof=None if dof is None else int(dof),
        known__prior=_prior(options["prior"], options["prior_sigma_deg"], options["prior_sigma"]),
        known__control_points=_control_points(options["control_points"]),
        source_crop_m=_box(options["crop"] or options["crop_source"]),
        target_crop_m=_box(options["crop"] or options["crop_target"]),
        coarse__max_seconds=options["max_seconds"],
        voxel__voxel_size_m=options["voxel_size"],
        fuse__mode=None if fuse is None else fuse.replace("-", "_"),
    )
    return Config.from_dict(json.loads(settings))  # checked now, before a cloud is read


def _prior(path: Path | None, sigma_deg: float | None, sigma: float | None) -> PosePrior | None:
    from tmchho import PosePrior
    from tmchho.outputs import read_matrix

    if path is None:
        if sigma_deg is not None or sigma is not None:
            raise click.UsageError("--prior-sigma-deg and --prior-sigma belong to --prior, which is missing")
        return None
    if sigma_deg is None and sigma is None:
        raise click.UsageError("--prior needs --prior-sigma-deg or --prior-sigma: how far may it be wrong?")
    return PosePrior(
        read_matrix(path),
        rotation_rad=None if sigma_deg is None else [math.radians(sigma_deg)] * 3,
        translation_m=None if sigma is None else [sigma] * 3,
    )


def _control_points(path: Path | None) -> tuple[ControlPoint, ...] | None:
    from tmchho import read_control_points

    return None if path is None else read_control_points(path)


def _box(area: Any) -> Any:
    """Return a box, which the core takes; polygons are cut out before."""
    return None if isinstance(area, Path) else area


def _selection(area: Any, classes: tuple[int, ...]) -> Selection:
    from tmchho.selection import Selection, read_polygon

    return Selection(read_polygon(area) if isinstance(area, Path) else None, classes)


def _word(value: Any) -> str | None:
    """Return the value of an option as somebody would type it."""
    if value == ():
        return None
    if isinstance(value, tuple) and isinstance(value[0], int):
        return ",".join(map(str, value))
    if isinstance(value, tuple):
        return ",".join(repr(number) for corner in value for number in corner)
    return None if value is None else str(value)
