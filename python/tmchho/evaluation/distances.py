"""Cloud-to-cloud distances: from every point of the one cloud to the other, both ways, and by area."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tmchho import _core
from tmchho.arguments import checked_choice, checked_count, checked_number
from tmchho.config import options_json
from tmchho.errors import InvalidArgumentError
from tmchho.evaluation.area_files import read_areas
from tmchho.evaluation.areas import Area, automatic_areas, measure_areas
from tmchho.evaluation.tally import AreaStatistics
from tmchho.inputs import CloudLike, naming, open_cloud
from tmchho.results import DistanceStatistics, ReadOnlyArrays, Registration, plain, pose_matrix
from tmchho.room import check_room

if TYPE_CHECKING:
    from matplotlib.figure import Figure

AreasLike: TypeAlias = Literal["automatic"] | str | os.PathLike[str] | Sequence[Area]
"""The word 'automatic', the path of a file that `read_areas` knows, or areas."""

DistanceMethod: TypeAlias = Literal["nearest", "plane", "normal", "vertical"]
_METHODS = ("nearest", "plane", "normal", "vertical")
SIGNED = ("normal", "vertical")

# As for fusion: a place farther than so many spacings, of those that nine points in ten of the sparser
# cloud keep to, is a hole.
HOLE_IN_SPACINGS = 3.0


@dataclass(frozen=True, eq=False)
class Evaluation(ReadOnlyArrays):
    """How far two clouds lie apart.

    Parameters
    ----------
    method : {'nearest', 'plane', 'normal', 'vertical'}
        What was measured; see `evaluate`.
    source_to_target : (n,) float64 array
        Distance from each source point to the target, in the order of the rows given; NaN for rows with a
        coordinate that is not finite, and where the method has none. Of signed methods, positive where the
        point lies above the other cloud.
    target_to_source : (m,) float64 array
        The other way round.
    source_to_target_statistics, target_to_source_statistics : DistanceStatistics or None
        Both summed up, over the points that were measured; None where there is none.
    n_beyond : tuple of int
        Finite points of the source and of the target that were not measured, because they have no
        counterpart: none within `max_distance`, or no surface below or above them.
    share_within : tuple of float, or None
        Shares of the source and of the target points measured whose distance does not exceed `tolerance`.
    tolerance, max_distance : float or None
        As asked for.
    spacing : tuple of float
        Median distance from a point of the source, and of the target, to the nearest of its own cloud, at
        the points that the other cloud was measured to; in the unit of the target.
    areas : tuple of AreaStatistics
        From source to target, by area; empty unless asked for.
    warnings : tuple of str
        What the figures do not tell, in sentences; see `docs/evaluation.md`.
    """

    method: DistanceMethod
    source_to_target: NDArray[np.float64]
    target_to_source: NDArray[np.float64]
    source_to_target_statistics: DistanceStatistics | None
    target_to_source_statistics: DistanceStatistics | None
    n_beyond: tuple[int, int]
    share_within: tuple[float | None, float | None] | None
    tolerance: float | None
    max_distance: float | None
    spacing: tuple[float, float]
    areas: tuple[AreaStatistics, ...]
    warnings: tuple[str, ...]

    def plot(self) -> Figure:
        """Draw how the distances are spread; needs ``pip install 'tmchho[report]'``.

        Returns
        -------
        matplotlib.figure.Figure
        """
        from tmchho.report.notebook import plot_evaluation

        return plot_evaluation(self)

    def to_dict(self) -> dict[str, Any]:
        """Return everything but the distances of single points as what JSON knows."""
        return evaluation_entries(
            self.method,
            self.tolerance,
            self.max_distance,
            (self.source_to_target_statistics, self.target_to_source_statistics),
            self.share_within or (None, None),
            self.n_beyond,
            self.spacing,
            self.areas,
            self.warnings,
        )


def evaluation_entries(
    method: DistanceMethod,
    tolerance: float | None,
    max_distance: float | None,
    statistics: tuple[DistanceStatistics | None, DistanceStatistics | None],
    shares: tuple[float | None, float | None],
    n_beyond: tuple[int, int],
    spacing: tuple[float, float],
    areas: tuple[AreaStatistics, ...],
    warnings: tuple[str, ...],
) -> dict[str, Any]:
    """Return what `Evaluation.to_dict` does; of pairs, the first is from source to target."""
    directions = {
        name: {
            **({"n_points": 0} if summed_up is None else vars(summed_up)),
            "share_within": share,
            "n_beyond": beyond,
        }
        for name, summed_up, share, beyond in zip(
            ("source_to_target", "target_to_source"), statistics, shares, n_beyond, strict=True
        )
    }
    entries: dict[str, Any] = plain(
        {
            "method": method,
            "tolerance": tolerance,
            "max_distance": max_distance,
            **directions,
            "spacing": {"source": spacing[0], "target": spacing[1]},
            "areas": areas,
            "warnings": warnings,
        }
    )
    return entries


def evaluate(
    source: CloudLike,
    target: CloudLike,
    transformation: Registration | ArrayLike | None = None,
    *,
    method: DistanceMethod | None = None,
    n_neighbors: int | None = None,
    tolerance: float | None = None,
    max_distance: float | None = None,
    areas: AreasLike | None = None,
) -> Evaluation:
    """Measure the distance from each point of one cloud to the other, both ways.

    Parameters
    ----------
    source, target : CloudLike
        At least one finite point each; see `register`.
    transformation : Registration or (4, 4) array_like, optional
        Takes source to target coordinates; may contain a scale. Where not given, the clouds are measured as
        they lie. All distances are in the unit of the target.
    method : {'nearest', 'plane', 'normal', 'vertical'}, optional
        To the nearest point (where not given); to the plane through the points round it, or to that point
        where this is nearer or the plane ends; signed along the upward normal of this plane; signed along z,
        to a plane through the points nearest in plan. Signed distances are positive above the other cloud,
        and NaN where the surface ends.
    n_neighbors : int, optional
        How many points a plane goes through, at least 3; 16 where not given.
    tolerance : float, optional
        Also count the points whose distance, to either side, does not exceed this.
    max_distance : float, optional
        Points farther away have no counterpart: they are counted apart and not summed up. All are where not
        given.
    areas : 'automatic', path, or sequence of Area, optional
        Also sum up the distances of source points by area: in five strips along the overlap, in the polygons
        of a file (see `read_areas`), or in these.

    Returns
    -------
    Evaluation

    Raises
    ------
    ReadError, InvalidCloudError
        If a path cannot be read, or a cloud has no finite point.
    InvalidArgumentError
        If the transformation is not rigid, apart from a scale, or another argument is out of its range.

    Notes
    -----
    Ren, Zhao & Han (2023), Section 5.3, Table 7, for ``'nearest'``. `docs/evaluation.md` tells of each method
    what it is taken from and when it misleads. See `m3c2` for change with a level of detection.

    Examples
    --------
    >>> evaluate([[3.0, 4.0, 0.0]], [[0.0, 0.0, 0.0], [9.0, 0.0, 0.0]]).target_to_source
    array([5.        , 7.21110255])
    """
    matrix = pose_matrix(transformation)
    options = compare_options(method, n_neighbors, tolerance, max_distance)
    source_cloud, target_cloud = open_cloud(source, "source"), open_cloud(target, "target")
    given_areas = given_areas_of(areas, target_cloud.crs)
    check_room(len(source_cloud) + len(target_cloud))
    with naming(source_cloud, target_cloud):
        found = _core.evaluate(source_cloud.xyz, target_cloud.xyz, matrix, options)
    forth, back = found["source_to_target"], found["target_to_source"]
    spacing = (found["spacing_of_source"], found["spacing_of_target"])
    statistics, n_beyond, shares = [], [], []
    for distances, cloud in ((forth, source_cloud), (back, target_cloud)):
        measured = distances[np.isfinite(distances)]
        n_finite = int(np.count_nonzero(np.isfinite(cloud.xyz).all(axis=1)))
        if max_distance is not None:
            measured = measured[np.abs(measured) <= max_distance]
        statistics.append(DistanceStatistics.of(measured))
        n_beyond.append(n_finite - len(measured))
        within = None if tolerance is None or len(measured) == 0 else np.abs(measured) <= tolerance
        shares.append(None if within is None else float(within.mean()))
    rows: tuple[AreaStatistics, ...] = ()
    if areas is not None:
        hole_radius = HOLE_IN_SPACINGS * found["wide_spacing"] or 1.0  # one point has no spacing
        if given_areas is None:
            reach = hole_radius if max_distance is None else max_distance
            overlap = target_cloud.xyz[np.abs(back) <= reach]
            given_areas = automatic_areas(overlap, hole_radius)
        rows = measure_areas(
            given_areas,
            source_cloud.xyz @ matrix[:3, :3].T + matrix[:3, 3],
            forth,
            target_cloud.xyz,
            cell=hole_radius,
            tolerance=tolerance,
            max_distance=max_distance,
        )
    chosen: DistanceMethod = method or "nearest"
    return Evaluation(
        method=chosen,
        source_to_target=forth,
        target_to_source=back,
        source_to_target_statistics=statistics[0],
        target_to_source_statistics=statistics[1],
        n_beyond=(n_beyond[0], n_beyond[1]),
        share_within=None if tolerance is None else (shares[0], shares[1]),
        tolerance=tolerance,
        max_distance=max_distance,
        spacing=spacing,
        areas=rows,
        warnings=density_warnings((statistics[0], statistics[1]), spacing) if chosen == "nearest" else (),
    )


def compare_options(
    method: DistanceMethod | None,
    n_neighbors: int | None,
    tolerance: float | None,
    max_distance: float | None,
) -> str:
    """Return the arguments of `evaluate` as options of the core, checked."""
    for name, value in (("tolerance", tolerance), ("max_distance", max_distance)):
        if value is not None and checked_number(name, value) < 0:
            raise InvalidArgumentError(f"{name} must be at least 0, got {value}")
    return options_json(
        method=None if method is None else checked_choice("method", method, _METHODS),
        n_neighbors=None if n_neighbors is None else checked_count("n_neighbors", n_neighbors),
    )


def density_warnings(
    statistics: tuple[DistanceStatistics | None, DistanceStatistics | None], spacing: tuple[float, float]
) -> tuple[str, ...]:
    """Return a sentence for each direction in which the distances tell about the spacing, not the fit.

    Parameters
    ----------
    statistics : tuple of DistanceStatistics
        Of distances to the nearest point, from source to target and back.
    spacing : tuple of float
        Of source and target, where the other was measured to.
    """
    sentences = []
    for at, (here, there) in enumerate((("source", "target"), ("target", "source"))):
        summed_up, limit = statistics[at], spacing[1 - at]
        if summed_up is not None and 0 < summed_up.median <= limit:
            sentences.append(
                f"the median distance from {here} to {there}, {summed_up.median:.3g}, does not exceed the "
                f"point spacing of the {there}, {limit:.3g}: it tells about the spacing, not about the fit; "
                "measure to planes or with M3C2"
            )
    return tuple(sentences)


def given_areas_of(areas: AreasLike | None, crs: str | None) -> tuple[Area, ...] | None:
    """Return areas, or None where they are to be made or there are to be none."""
    if areas is None or (isinstance(areas, str) and areas == "automatic"):
        return None
    if isinstance(areas, (str, os.PathLike)):
        return read_areas(areas, crs)
    if not all(isinstance(area, Area) for area in areas):
        raise InvalidArgumentError("areas must be 'automatic', the path of a file, or a sequence of Area")
    return tuple(areas)
