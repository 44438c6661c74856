"""Change along the normal with the smallest change that can be told from noise: M3C2."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tmchho import _core
from tmchho.arguments import checked_array, checked_count, checked_number
from tmchho.cloud import PointCloud
from tmchho.config import options_json
from tmchho.evaluation.areas import automatic_areas, measure_areas
from tmchho.evaluation.distances import AreasLike, given_areas_of
from tmchho.evaluation.tally import AreaStatistics
from tmchho.inputs import CloudLike, naming, open_cloud, open_points
from tmchho.results import DistanceStatistics, ReadOnlyArrays, Registration, plain, pose_matrix
from tmchho.room import check_room

# Where more cores than this see too few points, a level of detection is missing for too much of the site.
_FEW_POINTS_SHARE = 0.2


@dataclass(frozen=True, eq=False)
class Change(ReadOnlyArrays):
    """What changed from the target to the source, and what of it can be told from noise.

    Numbers of a core are NaN where the clouds give none. Lengths are in the unit of the target.

    Parameters
    ----------
    cores : (n, 3) float64 array
        Where change was measured, in target coordinates.
    normals : (n, 3) float64 array
        Unit normals of the target there.
    normal_radius : (n,) float64 array
        Radius in which each was found.
    distance : (n,) float64 array
        From the target to the source along the normal: positive where the source lies on its side, above.
    level_of_detection : (n,) float64 array
        As published, at 95 %: every point counts as an observation of its own.
    significant_from : (n,) float64 array
        The smallest change that is significant here: the level of detection, or the one in which
        neighbouring points, which err alike, count as one observation, whichever is larger; infinite where
        all points of a cloud are neighbours. Neighbours lie in the same sixth of the cylinder and in the
        same slab of it, as thick as its radius.
    is_significant : (n,) bool array
        Whether the change exceeds that, from enough points.
    n_target, n_source : (n,) uint32 array
        Points of both clouds in the cylinder.
    target_spread, source_spread : (n,) float64 array
        Standard deviations along the normal in it.
    statistics : DistanceStatistics or None
        The distances summed up; mean and median keep the sign.
    share_significant : float or None
        Significant cores by those with a level of detection.
    registration_error : float
        That went into the level of detection.
    normal_radii : tuple of float
        Of which the flattest was taken.
    cylinder_radius, max_depth : float
        The cylinder: its radius, and how far it reaches to either side.
    min_points : int
        Points of each cloud that a significant change needs.
    tolerance : float or None
        As asked for.
    areas : tuple of AreaStatistics
        By area, of cores; empty unless asked for.
    warnings : tuple of str
        What the figures do not tell, in sentences.
    """

    cores: NDArray[np.float64]
    normals: NDArray[np.float64]
    normal_radius: NDArray[np.float64]
    distance: NDArray[np.float64]
    level_of_detection: NDArray[np.float64]
    significant_from: NDArray[np.float64]
    is_significant: NDArray[np.bool_]
    n_target: NDArray[np.uint32]
    n_source: NDArray[np.uint32]
    target_spread: NDArray[np.float64]
    source_spread: NDArray[np.float64]
    statistics: DistanceStatistics | None
    share_significant: float | None
    registration_error: float
    normal_radii: tuple[float, ...]
    cylinder_radius: float
    max_depth: float
    min_points: int
    tolerance: float | None
    areas: tuple[AreaStatistics, ...]
    warnings: tuple[str, ...]

    def to_dict(self) -> dict[str, Any]:
        """Return everything but the numbers of single cores as what JSON knows."""
        levels = self.level_of_detection[np.isfinite(self.level_of_detection)]
        return change_entries(
            vars(self),
            self.statistics,
            n_without=int(np.count_nonzero(np.isnan(self.distance))),
            n_significant=int(np.count_nonzero(self.is_significant)),
            share_significant=self.share_significant,
            median_level=float(np.median(levels)) if len(levels) else None,
        )

    def to_point_cloud(self, crs: str | None = None) -> PointCloud:
        """Return the cores as a cloud, with attributes called as CloudCompare calls them.

        Parameters
        ----------
        crs : str, optional
            Coordinate reference system of the target.

        Returns
        -------
        PointCloud
            Cores with a coordinate that is not finite are left out.
        """
        return change_cloud(vars(self), crs)


def change_entries(
    told: Mapping[str, Any],
    statistics: DistanceStatistics | None,
    *,
    n_without: int,
    n_significant: int,
    share_significant: float | None,
    median_level: float | None,
) -> dict[str, Any]:
    """Return what `Change.to_dict` does; `told` has the settings, the lengths, the areas and the warnings."""
    lengths = ("registration_error", "normal_radii", "cylinder_radius", "max_depth")
    entries: dict[str, Any] = plain(
        {
            "method": "m3c2",
            "tolerance": told["tolerance"],
            "target_to_source": {
                **({"n_points": 0} if statistics is None else vars(statistics)),
                "n_beyond": n_without,
                "n_significant": n_significant,
                "share_significant": share_significant,
                "median_level_of_detection": median_level,
            },
            **{name: told[name] for name in (*lengths, "min_points", "areas", "warnings")},
        }
    )
    return entries


def change_cloud(found: Mapping[str, Any], crs: str | None) -> PointCloud:
    """Return what `Change.to_point_cloud` does, of its arrays or of a part of them."""
    rows = np.isfinite(found["cores"]).all(axis=1)
    attributes: dict[str, NDArray[Any]] = {
        "M3C2_distance": found["distance"],
        "distance_uncertainty": found["level_of_detection"],
        "significant_change": found["is_significant"].astype(np.uint8),
        "significant_from": found["significant_from"],
        "Npoints_cloud1": found["n_target"],
        "Npoints_cloud2": found["n_source"],
        "STD_cloud1": found["target_spread"],
        "STD_cloud2": found["source_spread"],
        "normal_scale": 2 * found["normal_radius"],
        **{f"n{axis}": found["normals"][:, at] for at, axis in enumerate("xyz")},
    }
    kept = {name: values[rows] for name, values in attributes.items()}
    return PointCloud(found["cores"][rows], kept, crs=crs, name="M3C2 cores")


def m3c2(
    source: CloudLike,
    target: CloudLike,
    transformation: Registration | ArrayLike | None = None,
    *,
    cores: CloudLike | None = None,
    normal_radii: Sequence[float] | None = None,
    cylinder_radius: float | None = None,
    max_depth: float | None = None,
    registration_error: float | None = None,
    orientation: ArrayLike = (0.0, 0.0, 1.0),
    min_points: int | None = None,
    tolerance: float | None = None,
    areas: AreasLike | None = None,
) -> Change:
    """Measure what changed from target to source along the normal, with its level of detection.

    Parameters
    ----------
    source, target : CloudLike
        The later and the earlier survey, or the one to be checked and the reference.
    transformation : Registration or (4, 4) array_like, optional
        Takes source to target coordinates; may contain a scale. The clouds are measured as they lie where not
        given.
    cores : CloudLike, optional
        Where to measure, in target coordinates. Centroids of the target in voxels as large as the radius of
        the cylinder where not given.
    normal_radii : sequence of float, optional
        Radii of the balls in which the normal of the target is sought; the flattest is taken. Where not
        given, one whose diameter is 25 times the roughness across it (at most 4 radii of the cylinder), and
        twice that.
    cylinder_radius : float, optional
        Radius of the cylinder in which points are averaged. Where not given, such that nine cylinders in ten
        hold 20 points of the sparser cloud.
    max_depth : float, optional
        How far the cylinder reaches to either side; ten of its radii where not given.
    registration_error : float, optional
        What the pose may be wrong by, 1σ. Where not given, `Registration.registration_error` if the
        transformation is a registration, else 0, of which a warning tells.
    orientation : (3,) array_like, default (0, 0, 1)
        Normals point to this side.
    min_points : int, optional
        Points of each cloud that a significant change needs, at least 2; 5 where not given.
    tolerance : float, optional
        For the share of cores, by area, whose change does not exceed it.
    areas : 'automatic', path, or sequence of Area, optional
        Also sum up by area; see `evaluate`.

    Returns
    -------
    Change

    Raises
    ------
    ReadError, InvalidCloudError
        If a path cannot be read, or a cloud has too few points.
    InvalidArgumentError
        Naming the argument.

    Notes
    -----
    Lague, Brodu & Leroux (2013), "Accurate 3D comparison of complex topography with terrestrial laser
    scanner", ISPRS J. 82: the level of detection is 1.96·(√(σ₁²/n₁ + σ₂²/n₂) + reg), their Eq. (1). It takes
    neighbouring points for independent, which edges and rough ground punish with false alarms; significance
    is therefore judged with clustered points besides, as `docs/evaluation.md` says.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> before, after = (np.column_stack([rng.uniform(0, 9, (4000, 2)), rng.normal(z, 0.01, 4000)])
    ...                  for z in (0.0, -0.05))
    >>> change = m3c2(after, before, registration_error=0.003)
    >>> round(change.statistics.median, 2), bool(change.share_significant > 0.99)
    (-0.05, True)
    """
    matrix = pose_matrix(transformation)
    if registration_error is None and isinstance(transformation, Registration):
        registration_error = transformation.registration_error
    warnings = [] if registration_error is not None else [UNKNOWN_ERROR]
    options = m3c2_options(
        normal_radii, cylinder_radius, max_depth, registration_error, orientation, min_points
    )
    if tolerance is not None:
        checked_number("tolerance", tolerance, 0.0)
    source_cloud, target_cloud = open_cloud(source, "source"), open_cloud(target, "target")
    places = None if cores is None else open_points(cores, "cores")
    given_areas = given_areas_of(areas, target_cloud.crs)
    check_room(len(source_cloud) + len(target_cloud))
    with naming(source_cloud, target_cloud):
        found = _core.m3c2(source_cloud.xyz, target_cloud.xyz, matrix, places, options)
    distance, level = found["distance"], found["level_of_detection"]
    n_known = int(np.count_nonzero(np.isfinite(level)))
    seen = np.isfinite(distance)
    n_seen = int(np.count_nonzero(seen))
    few = seen & (np.minimum(found["n_target"], found["n_source"]) < found["min_points"])
    warnings += few_points_warnings(int(np.count_nonzero(few)), n_seen, found["min_points"])
    rows: tuple[AreaStatistics, ...] = ()
    if areas is not None:
        cell = 2 * found["cylinder_radius"]
        if given_areas is None:
            given_areas = automatic_areas(found["cores"][seen], cell)
        rows = measure_areas(
            given_areas,
            found["cores"],
            distance,
            target_cloud.xyz,
            cell=cell,
            tolerance=tolerance,
            significant=found["is_significant"],
            other=source_cloud.xyz @ matrix[:3, :3].T + matrix[:3, 3],
        )
    return Change(
        **{**found, "normal_radii": tuple(found["normal_radii"])},
        statistics=DistanceStatistics.of(distance[seen]),
        share_significant=int(np.count_nonzero(found["is_significant"])) / n_known if n_known else None,
        registration_error=registration_error or 0.0,
        tolerance=tolerance,
        areas=rows,
        warnings=tuple(warnings),
    )


UNKNOWN_ERROR = (
    "the error of the registration is not known and counts as 0: what it shifted may pass for change"
)


def few_points_warnings(n_few: int, n_seen: int, min_points: int) -> list[str]:
    """Return a sentence where too many cores see too few points."""
    if n_few <= _FEW_POINTS_SHARE * n_seen:
        return []
    return [
        f"{n_few:,} of {n_seen:,} cores have fewer than {min_points} points of "
        "one of the clouds in the cylinder, and tell of no change; take a larger cylinder radius"
    ]


def m3c2_options(
    normal_radii: Sequence[float] | None,
    cylinder_radius: float | None,
    max_depth: float | None,
    registration_error: float | None,
    orientation: ArrayLike = (0.0, 0.0, 1.0),
    min_points: int | None = None,
) -> str:
    """Return the arguments of `m3c2` as options of the core, checked."""
    radius = None if cylinder_radius is None else checked_number("cylinder_radius", cylinder_radius)
    return options_json(
        normal_radii_m=_radii(normal_radii),
        cylinder_radius_m=radius,
        max_depth_m=None if max_depth is None else checked_number("max_depth", max_depth),
        registration_error_m=checked_number("registration_error", registration_error or 0.0),
        orientation=checked_array("orientation", orientation, (3,)),
        min_points=None if min_points is None else checked_count("min_points", min_points),
    )


def _radii(radii: Sequence[float] | None) -> list[float] | None:
    if radii is None:
        return None
    return [checked_number("normal_radii", radius) for radius in radii]
