"""The stages of the route one by one, on arrays, for those who build a route of their own.

What is None keeps the default of the core. Rows with a coordinate that is not finite: results with a value
for each row have NaN there; results without leave such rows out and count them; where neither would show,
they are refused. Calls release the interpreter, and Ctrl-C ends them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tmchho import _core
from tmchho.arguments import checked_array, checked_choice, checked_count, checked_number
from tmchho.config import options_json
from tmchho.inputs import CloudLike, open_points
from tmchho.observations import ControlPoint, Observations, PosePrior
from tmchho.results import ReadOnlyArrays


@dataclass(frozen=True, eq=False)
class OutlierResult(ReadOnlyArrays):
    """What `remove_outliers` kept.

    Parameters
    ----------
    indices : (k,) uint32 array
        Rows of the points kept, rising.
    radius : float
        As given or derived.
    n_non_finite : int
        Rows left out because a coordinate is not finite.
    """

    indices: NDArray[np.uint32]
    radius: float
    n_non_finite: int


@dataclass(frozen=True, eq=False)
class VoxelResult(ReadOnlyArrays):
    """What `voxel_downsample` made.

    Parameters
    ----------
    points : (k, 3) float64 array
        Centroids, sorted by voxel: by z, then y, then x.
    counts : (k,) uint32 array
        How many points each of them stands for.
    n_non_finite : int
        Rows left out because a coordinate is not finite.
    """

    points: NDArray[np.float64]
    counts: NDArray[np.uint32]
    n_non_finite: int


@dataclass(frozen=True, eq=False)
class IcpResult(ReadOnlyArrays):
    """What `icp` found.

    Parameters
    ----------
    transformation : (4, 4) float64 array
        Takes source to target coordinates; with ``dof=7`` its 3 × 3 part is scaled.
    stop_reason : {'converged', 'max_iterations', 'no_partners', 'scale_ran_away'}
        Why it ended.
    n_iterations : int
        Iterations made.
    n_inliers : int
        Source points with a partner that counted, at the last iteration.
    inlier_rmse : float
        Root mean squared point distance of those pairs; NaN where there never were enough.
    history : (n,) float64 array
        Mean squared distance at each iteration: of points, after its step, for point-to-point; across
        planes, as the kernel weighs it, before its step, otherwise.
    scale : float
        Length in the target of what is one unit long in the source; that of `init` unless ``dof=7``.
    registration_error : float or None
        The 1σ displacement of a point by the errors of the pose: in all directions together, root mean
        square over the overlap. It is the term "reg" of the level of detection of M3C2. About the radius of
        the overlap where the common surface leaves a direction open. None for point-to-point, and with too
        few pairs to tell.
    covariance : (7, 7) float64 array or None
        Of the rotation about the axes of the target (rad), the shift of `middle`, and the logarithm of the
        scale; rows of zeros for what was not free.
    middle : (3,) float64 array or None
        The place in the target about which the covariance is stated.
    scale_standard_error : float or None
        Standard error of the scale, relative to it; None unless ``dof=7``.
    """

    transformation: NDArray[np.float64]
    stop_reason: str
    n_iterations: int
    n_inliers: int
    inlier_rmse: float
    history: NDArray[np.float64]
    scale: float
    registration_error: float | None
    covariance: NDArray[np.float64] | None
    middle: NDArray[np.float64] | None
    scale_standard_error: float | None

    @property
    def converged(self) -> bool:
        """Whether the pose came to rest."""
        return self.stop_reason == "converged"


def remove_outliers(
    points: CloudLike, *, radius: float | None = None, min_neighbors: int | None = None
) -> OutlierResult:
    """Find the points that do not stand alone.

    Parameters
    ----------
    points : CloudLike
        (n, 3).
    radius : float, optional
        Radius of the neighbourhood, above 0, rim included. Where not given, four times the spacing that nine
        points in ten keep to.
    min_neighbors : int, optional
        Fewest neighbours, the point itself not counted, that keep a point.

    Returns
    -------
    OutlierResult

    Raises
    ------
    InvalidArgumentError, InvalidCloudError, ReadError
        Naming the argument or the file.

    Notes
    -----
    Ren, Zhao & Han (2023), Section 4.2.

    Examples
    --------
    >>> row = [[float(x), 0.0, 0.0] for x in range(10)]
    >>> remove_outliers([*row, [50.0, 0.0, 0.0]], radius=2.5).indices
    array([1, 2, 3, 4, 5, 6, 7, 8], dtype=uint32)
    """
    options = options_json(
        radius_m=None if radius is None else checked_number("radius", radius),
        min_neighbors=None if min_neighbors is None else checked_count("min_neighbors", min_neighbors),
    )
    return OutlierResult(**_core.remove_outliers(open_points(points, "points"), options))


def voxel_downsample(points: CloudLike, voxel_size: float) -> VoxelResult:
    """Replace the points in each voxel by their centroid.

    Parameters
    ----------
    points : CloudLike
        (n, 3). The grid stands on the lower corner of its box.
    voxel_size : float
        Edge of a voxel, above 0 and so large that fewer than 2²⁰ stand along each axis.

    Returns
    -------
    VoxelResult

    Raises
    ------
    InvalidArgumentError, InvalidCloudError, ReadError
        Naming the argument or the file; for a voxel that is too small, also the smallest possible.

    Notes
    -----
    Ren, Zhao & Han (2023), Section 4.2.

    Examples
    --------
    >>> voxel_downsample([[0.0, 0.0, 0.0], [0.5, 0.0, 0.0], [3.0, 0.0, 0.0]], 1.0).points[:, 0]
    array([0.25, 3.  ])
    """
    edge = checked_number("voxel_size", voxel_size)
    return VoxelResult(**_core.voxel_downsample(open_points(points, "points"), edge))


def iss_keypoints(
    points: CloudLike,
    *,
    radius: float,
    min_neighbors: int | None = None,
    max_ratio_second_to_first: float | None = None,
    max_ratio_third_to_second: float | None = None,
    non_max_radius: float | None = None,
) -> NDArray[np.uint32]:
    """Find the points whose surroundings have a direction of their own.

    Parameters
    ----------
    points : CloudLike
        (n, 3), of even density: thin them out by `voxel_downsample` first.
    radius : float
        Radius of the neighbourhood, above 0, rim excluded; three voxels suit.
    min_neighbors : int, optional
        Fewest neighbours of a keypoint, itself and its copies not counted.
    max_ratio_second_to_first, max_ratio_third_to_second : float, optional
        ε1 and ε2: the ratios λ2/λ1 and λ3/λ2 of a keypoint lie below them.
    non_max_radius : float, optional
        Keep only keypoints whose λ3 is the largest within this radius; all are kept where not given.

    Returns
    -------
    (k,) uint32 array
        Rows of the keypoints, rising. Rows that are not finite are never among them.

    Raises
    ------
    InvalidArgumentError, InvalidCloudError, ReadError
        Naming the argument or the file.

    Notes
    -----
    Ren, Zhao & Han (2023), Section 4.2, Eqs. (2) to (4).
    """
    options = options_json(
        radius_m=checked_number("radius", radius),
        min_neighbors=None if min_neighbors is None else checked_count("min_neighbors", min_neighbors),
        max_ratio_second_to_first=_number("max_ratio_second_to_first", max_ratio_second_to_first),
        max_ratio_third_to_second=_number("max_ratio_third_to_second", max_ratio_third_to_second),
        non_max_radius_m=_number("non_max_radius", non_max_radius),
    )
    return _core.iss_keypoints(open_points(points, "points"), options)


def estimate_normals(
    points: CloudLike, *, n_neighbors: int | None = None
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Estimate the surface round each point.

    Parameters
    ----------
    points : CloudLike
        (n, 3).
    n_neighbors : int, optional
        From how many nearest points, itself included; at least 3.

    Returns
    -------
    normals : (n, 3) float64 array
        Unit normals whose largest component is positive; zero where the neighbours stand on one line or in
        one place, NaN for rows that are not finite.
    curvatures : (n,) float64 array
        λ3/(λ1+λ2+λ3) of the covariance: 0 in a plane, 1/3 at most.

    Raises
    ------
    InvalidArgumentError, InvalidCloudError, ReadError
        Naming the argument or the file.

    Notes
    -----
    Hoppe et al. (1992); Pauly, Gross & Kobbelt (2002).

    Examples
    --------
    >>> floor = [[float(x), float(y), 7.0] for x in range(5) for y in range(5)]
    >>> estimate_normals(floor, n_neighbors=9)[0][0].tolist()
    [0.0, 0.0, 1.0]
    """
    n = None if n_neighbors is None else checked_count("n_neighbors", n_neighbors)
    return _core.estimate_normals(open_points(points, "points"), n)


def nearest_distances(source: CloudLike, target: CloudLike) -> NDArray[np.float64]:
    """Measure the distance from each source point to the nearest target point.

    Parameters
    ----------
    source, target : CloudLike
        (n, 3) and (m, 3) in one frame; rows of `target` that are not finite are nobody's neighbours.

    Returns
    -------
    (n,) float64 array
        NaN for rows of `source` that are not finite.

    Raises
    ------
    InvalidCloudError, ReadError
        If `target` has no finite point, or a file cannot be read.

    Examples
    --------
    >>> nearest_distances([[3.0, 4.0, 0.0], [9.0, 0.0, 0.0]], [[0.0, 0.0, 0.0], [10.0, 0.0, 0.0]])
    array([5., 1.])
    """
    return _core.nearest_distances(open_points(source, "source"), open_points(target, "target"))


def median_spacing(points: CloudLike) -> float:
    """Return the median distance from a point to the nearest one at another position.

    Parameters
    ----------
    points : CloudLike
        (n, 3), finite. At most 10 000 evenly strided points are looked at.

    Returns
    -------
    float
        0 where no two points differ in position.

    Raises
    ------
    InvalidCloudError, ReadError
        If a coordinate is not finite, or a file cannot be read.
    """
    return _core.median_spacing(open_points(points, "points", finite=True))


def icp(
    source: CloudLike,
    target: CloudLike,
    *,
    init: ArrayLike | None = None,
    dof: Literal[4, 6, 7] = 6,
    prior: PosePrior | None = None,
    control_points: Sequence[ControlPoint] | None = None,
    method: Literal["point_to_point", "point_to_plane", "plane_to_plane"] | None = None,
    kernel: Literal["least_squares", "tukey"] | None = None,
    max_distance: float | None = None,
    kept_share: float | None = None,
    coarse_to_fine: bool = True,
    max_iterations: int | None = None,
    relative_tolerance: float | None = None,
) -> IcpResult:
    """Bring `source` onto `target` by iterative closest point.

    Parameters
    ----------
    source, target : CloudLike
        (n, 3) and (m, 3), finite.
    init : (4, 4) array_like, optional
        The pose to start from, whose scale is kept unless ``dof=7``; where not given, the clouds as they lie.
    dof : {4, 6, 7}
        What is free: a turn about z and a shift (both clouds are levelled; a tilt of `init` is kept), any
        rotation and a shift, or a scale as well.
    prior : PosePrior, optional
        A pose that is known with some uncertainty.
    control_points : sequence of ControlPoint, optional
        Places measured in both clouds.
    method : {'point_to_point', 'point_to_plane', 'plane_to_plane'}, optional
        ``'point_to_point'`` (Eq. 8) where not given.
    kernel : {'least_squares', 'tukey'}, optional
        What large residuals count: their square (point-to-point where not given), or less and less and
        then nothing (the others).
    max_distance : float, optional
        Partners farther away do not count, above 0; no limit where not given.
    kept_share : float, optional
        Share of the pairs that count, closest first, in (0, 1]; where not given, all for point-to-point,
        estimated from their distances otherwise.
    coarse_to_fine : bool
        Whether samples of the source, each eight times as large as the one before, come to rest before all
        its points do: the same pose in a fraction of the time.
    max_iterations : int, optional
        At least 1; of every sample as well.
    relative_tolerance : float, optional
        Stop when the mean squared distance changes by less than this share of itself.

    Returns
    -------
    IcpResult

    Raises
    ------
    InvalidArgumentError, InvalidCloudError, ReadError
        Naming the argument or the file.

    Notes
    -----
    Ren, Zhao & Han (2023), Section 4.5, Eq. (8); point-to-plane after Chen & Medioni (1992), on the normals
    of the target; plane-to-plane after Segal, Haehnel & Thrun (2009), on the normals of both clouds;
    trimming after Chetverikov et al. (2002), its share after Phillips, Liu & Tomasi (2007).
    """
    methods = ("point_to_point", "point_to_plane", "plane_to_plane")
    kernels = ("least_squares", "tukey")
    options = options_json(
        method=None if method is None else checked_choice("method", method, methods),
        kernel=None if kernel is None else checked_choice("kernel", kernel, kernels),
        max_distance_m=_number("max_distance", max_distance),
        kept_share=_number("kept_share", kept_share),
        coarse_to_fine=bool(coarse_to_fine),
        max_iterations=None if max_iterations is None else checked_count("max_iterations", max_iterations),
        relative_tolerance=_number("relative_tolerance", relative_tolerance),
    )
    start = np.eye(4) if init is None else checked_array("init", init, (4, 4))
    clouds = open_points(source, "source", finite=True), open_points(target, "target", finite=True)
    known = Observations(prior, control_points)
    observations = options_json(prior=known.prior, control_points=known.control_points)
    return IcpResult(**_core.icp(*clouds, start, checked_count("dof", dof, 4, 7), observations, options))


def _number(name: str, value: float | None) -> float | None:
    return None if value is None else checked_number(name, value)
