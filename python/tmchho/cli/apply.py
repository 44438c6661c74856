"""`tmchho apply`: move files by a transform that is already known."""

from __future__ import annotations

from pathlib import Path

import click

from tmchho.cli.display import display
from tmchho.cli.failures import EXIT_CODES, debug_option
from tmchho.cli.options import PATH, output_option, overwrite_option, quiet_option

_EXAMPLES = """\b
Examples:
  tmchho apply out/transform.json tile_*.laz -o moved
  # back again
  tmchho apply out/transform.json moved/*.laz -o back --inverse

"""


@click.command("apply", short_help="Move files by a known transform.", epilog=_EXAMPLES + EXIT_CODES)
@click.argument("transform", type=PATH)
@click.argument("files", type=PATH, nargs=-1, required=True, metavar="FILE...")
@output_option(required=True)
@click.option("--inverse", is_flag=True, help="Move from the target to the source instead.")
@quiet_option
@overwrite_option
@debug_option
def apply(
    transform: Path, files: tuple[Path, ...], output: Path, inverse: bool, quiet: bool, overwrite: bool
) -> None:
    """Move each FILE by TRANSFORM and write it, with its name, into the folder given with -o.

    TRANSFORM is the transform.json, result.json, transform.txt or pdal.json of a registration, or 16 numbers
    in a text. LAS and LAZ files may have any size; their attributes, scale and records come out as they went
    in.
    """
    from tmchho.moving import apply_transform, check_names, output_name
    from tmchho.outputs import check_folder
    from tmchho.transform import read_target_crs, read_transform

    known = read_transform(transform)
    crs = None if inverse else read_target_crs(transform)
    if inverse:
        known = known.inverse()
    check_names(files)
    names = [output_name(path) for path in files]
    check_folder(output, names=names, overwrite=overwrite, inputs=[transform, *files])
    output.mkdir(parents=True, exist_ok=True)
    with display(quiet) as shown:
        for path, name in zip(files, names, strict=True):
            with shown.step("apply", f"moving {path}"):
                n_points = apply_transform(known, path, output / name, crs=crs, overwrite=overwrite)
            shown.note(f"{path}: {n_points:,} points moved")
    click.echo("\n".join(str(output / name) for name in names))
