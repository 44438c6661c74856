"""`tmchho demo`: a dam site made by code, surveyed twice, registered, and compared with the truth."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from tmchho.cli.display import Display, display
from tmchho.cli.failures import debug_option, end
from tmchho.cli.options import json_option, output_option, overwrite_option, quiet_option, report_option
from tmchho.cli.register import replay_command

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from tmchho import PointCloud, Registration
    from tmchho.cli.workflow import Outcome

UAV, TLS = "uav.laz", "tls.laz"
# The scanner's points for each of the photogrammetry's, as in the default pair.
_SCANNER_SHARE = 320 / 420

_EXAMPLES = """\b
Examples:
  tmchho demo
  # in a few seconds, and another site
  tmchho demo --points 60000 --seed 5 -o out/small

"""


@click.command(short_help="Simulate, register and check a dam site.", epilog=_EXAMPLES)
@output_option(default=Path("out/demo"), show_default=True)
@click.option(
    "--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Seed of site, pose and search."
)
@click.option(
    "--points",
    type=click.IntRange(min=1000),
    default=420_000,
    show_default=True,
    help="Points of the photogrammetry; the scanner has three quarters as many.",
)
@report_option
@json_option
@quiet_option
@overwrite_option
@debug_option
def demo(
    output: Path, seed: int, points: int, report: bool, as_json: bool, quiet: bool, overwrite: bool
) -> None:
    """Simulate a dam site, survey it by drone and by scanner, register the two and compare with the truth.

    The drone's cloud is turned and shifted at random. uav.laz and tls.laz are written into the folder, and
    beside them what `tmchho register uav.laz tls.laz` writes.

    Here the truth is known and so decides instead of the verdict: the exit code is 0 where the source points
    are within a voxel edge (root mean square) of their true places, and 4 where they are not.
    """
    from tmchho import Config
    from tmchho.cli.workflow import Job, run
    from tmchho.outputs import OUTPUTS, REPORT, check_folder

    check_folder(output, names=(UAV, TLS, *OUTPUTS, REPORT), overwrite=overwrite)
    with display(quiet) as shown:
        truth = _simulate(output, seed, points, overwrite, shown)
        source, target = output / UAV, output / TLS
        command = replay_command(source, target, {"--seed": seed})
        job = Job(source, target, output, Config(seed=seed), command, overwrite, has_report=report)
        outcome = run(job, shown, lambda cloud, found: {"truth": compare(cloud, found, truth)})
        seconds = shown.seconds
    is_right = outcome.document["truth"]["rms_displacement_in_voxels"] <= 1
    end(outcome.document, lambda: _table(outcome, seconds), as_json=as_json, accepted=is_right)


def compare(source: PointCloud, found: Registration, truth: NDArray[np.float64]) -> dict[str, Any]:
    """Return how far a registration is from the known pose.

    Parameters
    ----------
    source : PointCloud
        The cloud that was moved.
    found : Registration
        The pose found for it.
    truth : (4, 4) float64 array
        The pose it should have.

    Returns
    -------
    dict
        The true pose; the angle between the two; the distance between the two places of the source's
        centroid; the root mean square over all source points of the distance between their two places, in
        the unit of the clouds and as a share of the voxel edge.
    """
    import numpy as np

    # About the centroid, because near 4 000 000 m the digits after the ninth are noise.
    centroid = source.xyz.mean(axis=0)
    rotation = truth[:3, :3]
    true_places = (source.xyz - centroid) @ rotation.T + (rotation @ centroid + truth[:3, 3])
    apart = found.apply(source.xyz) - true_places
    rms = float(np.sqrt((apart**2).sum(axis=1).mean()))
    difference = float(np.linalg.norm(found.transformation[:3, :3] - rotation))
    return {
        "target_from_source": truth.tolist(),
        "rotation_error_deg": float(np.degrees(2 * np.arcsin(min(1.0, difference / np.sqrt(8))))),
        "translation_error_at_centroid": float(np.linalg.norm(apart.mean(axis=0))),
        "rms_displacement": rms,
        "rms_displacement_in_voxels": rms / found.voxel_size,
    }


def _simulate(folder: Path, seed: int, n_points: int, overwrite: bool, shown: Display) -> NDArray[np.float64]:
    """Write the two surveys and return the pose that takes the first to the second."""
    from tmchho import write
    from tmchho.outputs import write_together
    from tmchho.simulate import make_pair

    with shown.step("simulate", "simulating the site and its two surveys"):
        pair = make_pair(
            n_photogrammetry_points=n_points, n_scanner_points=round(_SCANNER_SHARE * n_points), seed=seed
        )
    with shown.step("simulate", "writing the two surveys"):
        files = {UAV: lambda path: write(pair.source, path), TLS: lambda path: write(pair.target, path)}
        write_together(folder, files, overwrite=overwrite)
    return pair.target_from_source


def _table(outcome: Outcome, seconds: dict[str, float]) -> str:
    from tmchho.cli.register import summary

    found, truth = outcome.registration, outcome.document["truth"]
    voxel = found.voxel_size
    rows = {
        "rotation": f"{truth['rotation_error_deg']:.4f}°",
        "translation at the centroid": f"{truth['translation_error_at_centroid']:.4f} m",
        "RMS displacement": f"{truth['rms_displacement']:.4f} m = "
        f"{100 * truth['rms_displacement_in_voxels']:.1f} % of the voxel edge ({voxel:.3f} m)",
    }
    lines = [summary(outcome), "error against the known pose:"]
    lines += [f"  {name:<28}  {value}" for name, value in rows.items()]
    lines += ["time: " + ", ".join(f"{name} {value:.1f} s" for name, value in seconds.items())]
    return "\n".join(lines)
