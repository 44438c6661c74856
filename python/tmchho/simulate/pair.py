"""Two surveys of one site with the pose that joins them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tmchho.arguments import checked_number, checked_seed
from tmchho.cloud import PointCloud
from tmchho.errors import InvalidArgumentError
from tmchho.simulate.arguments import checked_n_points, checked_noise, checked_outlier_share, stream
from tmchho.simulate.ground import Array
from tmchho.simulate.photogrammetry import survey_photogrammetry
from tmchho.simulate.scanner import survey_scanner
from tmchho.simulate.site import Site, make_site
from tmchho.simulate.solids import random_rotation

# Where the site's origin lies in the national grid: east, north, height, in metres.
NATIONAL_ORIGIN = (500_000.0, 4_000_000.0, 200.0)
NATIONAL_CRS = (
    'PROJCS["WGS 84 / UTM zone 47N",GEOGCS["WGS 84",DATUM["WGS_1984",'
    'SPHEROID["WGS 84",6378137,298.257223563,AUTHORITY["EPSG","7030"]],AUTHORITY["EPSG","6326"]],'
    'PRIMEM["Greenwich",0,AUTHORITY["EPSG","8901"]],'
    'UNIT["degree",0.0174532925199433,AUTHORITY["EPSG","9122"]],AUTHORITY["EPSG","4326"]],'
    'PROJECTION["Transverse_Mercator"],PARAMETER["latitude_of_origin",0],'
    'PARAMETER["central_meridian",99],PARAMETER["scale_factor",0.9996],'
    'PARAMETER["false_easting",500000],PARAMETER["false_northing",0],'
    'UNIT["metre",1,AUTHORITY["EPSG","9001"]],AXIS["Easting",EAST],AXIS["Northing",NORTH],'
    'AUTHORITY["EPSG","32647"]]'
)


@dataclass(frozen=True, eq=False)
class SimulatedPair:
    """Two surveys of one site and the truth about them.

    Parameters
    ----------
    source : PointCloud
        The photogrammetry, moved away by the pose.
    target : PointCloud
        The scanner's survey, in place.
    target_from_source : (4, 4) float64 array
        The true pose: takes coordinates of `source` to those of `target`.
    site : Site
        The scene, in its own frame.
    target_from_site : (4, 4) float64 array
        Takes the site's own frame to that of `target` (a shift to the national grid, or nothing).
    """

    source: PointCloud
    target: PointCloud
    target_from_source: Array
    site: Site
    target_from_site: Array


def make_pair(
    *,
    size_m: float = 120.0,
    area_ratio: float = 4.0,
    overlap: float = 1.0,
    centre_offset: tuple[float, float] = (-0.55, 0.35),
    n_photogrammetry_points: int | None = None,
    n_scanner_points: int = 320_000,
    density_ratio: float | None = None,
    stations: int | Sequence[Sequence[float]] | Array = 8,
    photogrammetry_noise_m: float = 0.03,
    scanner_noise_m: float = 0.004,
    photogrammetry_outlier_share: float = 0.005,
    scanner_outlier_share: float = 0.01,
    national_grid: bool = True,
    pose: str | Array = "random",
    seed: int = 0,
) -> SimulatedPair:
    """Make a site, survey it with both sensors, and move the photogrammetry by a known pose.

    Parameters
    ----------
    size_m, area_ratio, overlap, centre_offset
        Extent of the two surveys; see `make_site`.
    n_photogrammetry_points, n_scanner_points : int, default 420000 and 320000
        Exact numbers of points.
    density_ratio : float, optional
        Points per area of the scanner's square over those of the photogrammetry's, 0.01 to 1000: sets
        the number of photogrammetric points, which is not given then.
    stations : int or (k, 2) array, default 8
        Number of scanner stations, or their plan coordinates in the site's own frame.
    photogrammetry_noise_m, photogrammetry_outlier_share
        See `survey_photogrammetry`.
    scanner_noise_m, scanner_outlier_share
        See `survey_scanner`.
    national_grid : bool, default True
        Put both clouds near E 500000, N 4000000, H 200 (UTM zone 47 north) instead of around the
        site's own origin. The photogrammetry is in the grid before it is moved.
    pose : {"random", "identity"} or (4, 4) array, default "random"
        How the photogrammetry is moved: turned evenly over all rotations about its centroid and
        shifted by up to one diagonal of its bounding box; not at all; or so that this rigid matrix
        is the true `target_from_source`.
    seed : int, default 0
        Fixes everything.

    Returns
    -------
    SimulatedPair
        At national-grid size the pose is exact to some nanometres, the resolution of such numbers.

    Raises
    ------
    InvalidArgumentError
        If an argument is out of its range, or `pose` is not rigid.

    Examples
    --------
    >>> from tmchho.simulate import make_pair
    >>> pair = make_pair(n_photogrammetry_points=2000, n_scanner_points=1000, seed=7)
    >>> len(pair.source), len(pair.target), pair.target_from_source.shape
    (2000, 1000, (4, 4))
    """
    # Here, so that messages name the arguments of this function, and before anything takes time.
    seed = checked_seed(seed)
    n_scanned = checked_n_points("n_scanner_points", n_scanner_points)
    n_flown = _n_photogrammetry_points(n_photogrammetry_points, density_ratio, n_scanned, area_ratio)
    flown_noise_m = checked_noise("photogrammetry_noise_m", photogrammetry_noise_m)
    scanned_noise_m = checked_noise("scanner_noise_m", scanner_noise_m)
    flown_outliers = checked_outlier_share("photogrammetry_outlier_share", photogrammetry_outlier_share)
    scanned_outliers = checked_outlier_share("scanner_outlier_share", scanner_outlier_share)
    if not isinstance(national_grid, (bool, np.bool_)):
        raise InvalidArgumentError(f"national_grid must be True or False, got {national_grid!r}")
    given_pose = None if isinstance(pose, str) else checked_pose("pose", pose)
    if isinstance(pose, str) and pose not in ("random", "identity"):
        raise InvalidArgumentError(f"pose must be 'random', 'identity' or a 4 x 4 matrix, got {pose!r}")
    site = make_site(
        size_m=size_m, area_ratio=area_ratio, overlap=overlap, centre_offset=centre_offset, seed=seed
    )
    flown = survey_photogrammetry(
        site, n_points=n_flown, noise_m=flown_noise_m, outlier_share=flown_outliers, seed=seed
    )
    scanned = survey_scanner(
        site,
        stations=stations,
        n_points=n_scanned,
        range_noise_m=scanned_noise_m,
        outlier_share=scanned_outliers,
        seed=seed,
    )
    target_from_site = np.eye(4)
    if national_grid:
        target_from_site[:3, 3] = NATIONAL_ORIGIN
    in_grid = flown.xyz + target_from_site[:3, 3]
    crs = NATIONAL_CRS if national_grid else None
    target = replace(scanned, xyz=scanned.xyz + target_from_site[:3, 3], crs=crs)

    if given_pose is not None:
        source_from_target = invert(given_pose)
    elif pose == "random":
        diagonal_m = float(np.linalg.norm(np.ptp(in_grid, axis=0)))
        source_from_target = about(random_pose(stream(seed, "pose"), diagonal_m), in_grid.mean(axis=0))
    else:
        source_from_target = np.eye(4)
    moved = not np.array_equal(source_from_target, np.eye(4))
    xyz = in_grid @ source_from_target[:3, :3].T + source_from_target[:3, 3] if moved else in_grid
    target_from_source = invert(source_from_target) if given_pose is None else given_pose
    source = replace(flown, xyz=xyz, crs=None if moved else crs)
    return SimulatedPair(source, target, target_from_source, site, target_from_site)


def _n_photogrammetry_points(
    given: int | None, density_ratio: float | None, n_scanned: int, area_ratio: float
) -> int:
    """Return the number of points that is given, or follows from the densities, or is usual."""
    if density_ratio is None:
        return checked_n_points("n_photogrammetry_points", 420_000 if given is None else given)
    if given is not None:
        raise InvalidArgumentError(
            "density_ratio sets the number of photogrammetric points: leave out n_photogrammetry_points"
        )
    ratio = checked_number("density_ratio", density_ratio, 0.01, 1000.0)
    times = checked_number("area_ratio", area_ratio, 1.0, 16.0) / ratio
    return max(round(n_scanned * times), 1)


def random_pose(rng: np.random.Generator, max_shift_m: float) -> Array:
    """Draw a rigid pose: even over all rotations, the shift even within a ball.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of the random numbers.
    max_shift_m : float
        Radius of the ball, in metres.

    Returns
    -------
    (4, 4) float64 array
        A rotation about the origin, then the shift.

    Raises
    ------
    InvalidArgumentError
        If `max_shift_m` is negative or not finite.
    """
    max_shift_m = checked_number("max_shift_m", max_shift_m, 0.0)
    pose = np.eye(4)
    pose[:3, :3] = random_rotation(rng)
    direction = rng.standard_normal(3)
    radius = max_shift_m * np.cbrt(rng.random())
    pose[:3, 3] = direction / np.linalg.norm(direction) * radius
    return pose


def about(pose: Array, centre: Array) -> Array:
    """Return the pose that turns about `centre` instead of the origin; the shift stays."""
    moved = pose.copy()
    moved[:3, 3] += centre - pose[:3, :3] @ centre
    return moved


def invert(pose: Array) -> Array:
    """Inverse of a rigid pose."""
    inverse = np.eye(4)
    inverse[:3, :3] = pose[:3, :3].T
    inverse[:3, 3] = -pose[:3, :3].T @ pose[:3, 3]
    return inverse


def checked_pose(name: str, value: Any) -> Array:
    """Return a rigid 4 x 4 pose as float64, or raise `InvalidArgumentError` naming the argument."""
    try:
        pose = np.array(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InvalidArgumentError(f"{name} must be a 4 x 4 matrix of numbers ({error})") from error
    if pose.shape != (4, 4) or not np.isfinite(pose).all():
        raise InvalidArgumentError(f"{name} must be a finite 4 x 4 matrix, got shape {pose.shape}")
    rotation = pose[:3, :3]
    rigid = np.abs(rotation @ rotation.T - np.eye(3)).max() < 1e-9 and np.linalg.det(rotation) > 0.0
    if not rigid or not np.array_equal(pose[3], [0.0, 0.0, 0.0, 1.0]):
        raise InvalidArgumentError(
            f"{name} must be rigid: an orthonormal rotation of determinant +1 over the row 0 0 0 1"
        )
    return pose
