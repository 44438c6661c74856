"""The fused file and the moved source, written part by part in one run through each input."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import laspy  # type: ignore[import-untyped, unused-ignore]
import numpy as np
from numpy.typing import NDArray

from tmchho import _core
from tmchho.io import las_parts
from tmchho.io.las_grid import Grid, fitted_grid
from tmchho.io.las_stream import LasPoints, las_copy
from tmchho.io.las_write import open_las_writer
from tmchho.streams.distances import DistanceFile
from tmchho.streams.layout import DISTANCE, FILLS_HOLE, ORIGIN, FusedLayout
from tmchho.transform import Transform

Floats = NDArray[np.float64]

_TARGET, _SOURCE = 0, 1


@dataclass(frozen=True)
class Fusion:
    """What is fused, and how.

    Parameters
    ----------
    source, target : LasPoints
        The files.
    transform : Transform
        Takes source to target coordinates.
    of_source, of_target : DistanceFile
        Distances to the other cloud.
    hole_radius : float
        Points farther away fill a hole.
    mode : {'merge', 'dedup', 'fill_holes'}
        Which points of the source are taken.
    lowest, highest : (3,) float64 array
        Box of both clouds in target coordinates.
    colour_factors : (int, int)
        By what the colours of source and target are multiplied.
    """

    source: LasPoints
    target: LasPoints
    transform: Transform
    of_source: DistanceFile
    of_target: DistanceFile
    hole_radius: float
    mode: str
    lowest: Floats
    highest: Floats
    colour_factors: tuple[int, int]

    @property
    def grid(self) -> Grid:
        """Scale and offset of the target, or another offset where it cannot reach all points."""
        header = self.target.header
        kept = Grid(np.array(header.scales), np.array(header.offsets))
        if kept.holds(self.lowest, self.highest):
            return kept
        return fitted_grid(self.lowest, self.highest, np.abs(kept.scales))


def write_fusion(fusion: Fusion, fused_path: Path, moved_path: Path | None) -> dict[str, Any]:
    """Write the fused file, and the moved source if a path is given; return the report on the fusion.

    The points of the target come first, in their order, then those of the source. The moved source keeps its
    own point layout, on the target's grid.
    """
    layout = FusedLayout.of(fusion.source, fusion.target)
    grid, crs = fusion.grid, fusion.target.crs
    counts = dict.fromkeys(("n_from_target", "n_from_source", "n_filled_by_target", "n_filled_by_source"), 0)
    n_repeated = 0
    areas = {_TARGET: _core.SurfaceArea(fusion.hole_radius), _SOURCE: _core.SurfaceArea(fusion.hole_radius)}
    with ExitStack() as stack:
        writer, point_format = stack.enter_context(
            open_las_writer(
                fused_path,
                fusion.target.header,
                (layout.point_format, layout.version),
                grid,
                layout.parameters,
                crs=crs,
                kept_crs=crs,
            )
        )
        write_moved = None
        if moved_path is not None:
            write_moved = stack.enter_context(las_copy(moved_path, fusion.source, grid, crs=crs))
        for origin, file, names, distances, factor in (
            (_TARGET, fusion.target, layout.target_names, fusion.of_target, fusion.colour_factors[1]),
            (_SOURCE, fusion.source, layout.source_names, fusion.of_source, fusion.colour_factors[0]),
        ):
            start = 0
            for records in las_parts(file):
                signed = distances.part(start, start + len(records))
                start += len(records)
                distance, repeated = np.abs(signed), np.signbit(signed)
                fills = distance > fusion.hole_radius
                xyz = file.xyz(file.steps(records))
                if origin == _SOURCE:
                    xyz = fusion.transform.apply(xyz)
                steps = grid.steps(xyz)
                if origin == _SOURCE and write_moved is not None:
                    for index, axis in enumerate("XYZ"):
                        records[axis] = steps[:, index]
                    write_moved(records)
                if fills.any():
                    areas[origin].add(np.ascontiguousarray(xyz[fills]))
                if origin == _SOURCE and fusion.mode != "merge":
                    taken = fills if fusion.mode == "fill_holes" else ~repeated
                    n_repeated += int(np.count_nonzero(repeated))
                    records, steps = records[taken], steps[taken]
                    distance, fills = distance[taken], fills[taken]
                role = "source" if origin == _SOURCE else "target"
                counts[f"n_from_{role}"] += len(records)
                counts[f"n_filled_by_{role}"] += int(np.count_nonzero(fills))
                if not len(records):
                    continue
                out = layout.blank(len(records), point_format.dtype())
                layout.put(records, out, file, names, factor)
                for index, axis in enumerate("XYZ"):
                    out[axis] = steps[:, index]
                out[ORIGIN.name], out[FILLS_HOLE.name], out[DISTANCE.name] = origin, fills, distance
                writer.write_points(laspy.PackedPointRecord(out, point_format))
    lacking = {
        "source": layout.lacking(fusion.source, layout.source_names),
        "target": layout.lacking(fusion.target, layout.target_names),
    }
    return {
        "n_points": counts["n_from_target"] + counts["n_from_source"],
        **counts,
        "n_repeated": n_repeated,
        "area_filled_by_source": areas[_SOURCE].total(),
        "area_filled_by_target": areas[_TARGET].total(),
        "hole_radius": fusion.hole_radius,
        "mode": fusion.mode,
        "no_data": lacking,
    }
