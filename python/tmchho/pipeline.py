"""What is done with two clouds: register them, fuse them; `tmchho.evaluation` measures them."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tmchho import _core
from tmchho.arguments import checked_array, checked_choice, checked_number
from tmchho.config import ConfigLike, DegreesOfFreedom, Mode, config_json, options_json
from tmchho.fused import FusedCloud
from tmchho.inputs import CloudLike, naming, open_cloud
from tmchho.observations import ControlPoint, Observations, PosePrior
from tmchho.progress import ProgressCallback, listener
from tmchho.results import Registration, pose_matrix
from tmchho.room import check_room


def register(
    source: CloudLike,
    target: CloudLike,
    *,
    mode: Mode | None = None,
    seed: int | None = None,
    dof: DegreesOfFreedom | None = None,
    prior: PosePrior | None = None,
    control_points: Sequence[ControlPoint] | None = None,
    source_crop: ArrayLike | None = None,
    target_crop: ArrayLike | None = None,
    max_seconds: float | None = None,
    config: ConfigLike | None = None,
    progress: ProgressCallback | None = None,
) -> Registration:
    """Register `source` onto `target`: no targets, no initial guess, no numbers needed.

    Parameters
    ----------
    source, target : CloudLike
        The cloud that moves and the one that stays, in the same length unit unless ``dof=7``: a path, a
        `PointCloud`, or (n, 3) real numbers. Points with NaN or infinite coordinates are left out and
        counted. The arrays are not modified, and must not be by other threads during the call.
    mode : {'robust', 'paper'}, optional
        Which search is run: many starts verified in both directions, or the paper's method, plain. Where not
        given, what `config` says, else ``'robust'``.
    seed : int, optional
        Seed of all random numbers, 0 to 2⁶⁴ - 1: the same input and seed give the same result, at any number
        of threads. Where not given, what `config` says, else 0.
    dof : {4, 6, 7}, optional
        Degrees of freedom. 4: a turn about z and a shift, because both clouds are levelled with z up. 6: any
        rotation and a shift. 7: a scale as well, because one of the clouds has no known scale; it is sought
        within ``scale_bounds`` of the configuration. Where not given, what `config` says, else 6.
    prior : PosePrior, optional
        A pose that is known roughly. It settles what the clouds leave open, and a pose that contradicts it is
        not accepted.
    control_points : sequence of ControlPoint, optional
        Places measured in both clouds, to the same use.
    source_crop, target_crop : (2, 3) array_like, optional
        Lower and upper corner of a box, in the coordinates of the cloud as given: only points in it take part
        in finding the pose. Distances, overlap and fusion are of all points still.
    max_seconds : float, optional
        Time after which the search hands over the best pose so far, above 0; no limit where not given. The
        stages after it add a little. What is found then depends on the machine.
    config : Config, mapping or path of a TOML file, optional
        All other settings; see `Config` and `default_config`.
    progress : callable, optional
        Gets a `ProgressEvent` for everything that happens, on the calling thread; answers True to stop.

    Returns
    -------
    Registration
        With the pose and a verdict. A wrong pose is no error: read the verdict.

    Raises
    ------
    ReadError
        If a path cannot be read.
    InvalidCloudError
        If a cloud has too few points, or all of them on one point, line or plane.
    InvalidArgumentError
        Naming the argument or configuration key.
    NoSolutionError
        If the search ended without any pose.
    StoppedError
        If `progress` answered True. Its own exceptions come out unchanged, and Ctrl-C ends the call.

    Notes
    -----
    Ren, Zhao & Han (2023), Sections 4.1 to 4.5; the robust search and the verdict are additions of this
    package. Other Python threads run on during the call.

    Examples
    --------
    >>> x, y = np.meshgrid(np.arange(80.0), np.arange(80.0))
    >>> z = 4 * np.sin(0.13 * x) * np.cos(0.21 * y) + 3 * np.sin(0.002 * x * y)
    >>> target = np.column_stack([x.ravel(), y.ravel(), z.ravel()])
    >>> source = target[:, [1, 2, 0]] + [300.0, -20.0, 7.0]  # turned and shifted
    >>> found = register(source, target)
    >>> found.verdict, bool(np.abs(found.apply(source) - target).max() < 1e-3)
    ('accepted', True)
    """
    known = Observations(prior, control_points)
    settings = config_json(
        config,
        mode=mode,
        seed=seed,
        dof=dof,
        known__prior=known.prior,
        known__control_points=known.control_points,
        source_crop_m=_corners("source_crop", source_crop),
        target_crop_m=_corners("target_crop", target_crop),
        coarse__max_seconds=None if max_seconds is None else checked_number("max_seconds", max_seconds),
    )
    tell = listener(progress)
    source_cloud, target_cloud = open_cloud(source, "source"), open_cloud(target, "target")
    began = time.perf_counter()
    check_room(len(source_cloud) + len(target_cloud))
    with naming(source_cloud, target_cloud):
        found = _core.register(source_cloud.xyz, target_cloud.xyz, settings, tell)
    return Registration._from_core(
        found,
        seconds=time.perf_counter() - began,
        source_name=source_cloud.name,
        target_name=target_cloud.name,
    )


def fuse(
    source: CloudLike,
    target: CloudLike,
    transformation: Registration | ArrayLike,
    *,
    mode: Literal["merge", "dedup", "fill_holes"] | None = None,
    hole_radius: float | None = None,
) -> FusedCloud:
    """Make one cloud out of two, in which each fills the other's holes.

    Parameters
    ----------
    source, target : CloudLike
        At least one finite point each; see `register`.
    transformation : Registration or (4, 4) array_like
        Takes source to target coordinates; may contain a scale.
    mode : {'merge', 'dedup', 'fill_holes'}, optional
        Take all points of the source (``'merge'``, where not given); all but those that repeat a point of the
        target, which lies nearer than either cloud is dense there (``'dedup'``); or only those that fill a
        hole of the target (``'fill_holes'``). The target is always kept whole.
    hole_radius : float, optional
        A point farther than this from the other cloud fills a hole; above 0. Where not given, three times the
        spacing that nine points in ten of the sparser cloud keep to.

    Returns
    -------
    FusedCloud

    Raises
    ------
    ReadError, InvalidCloudError
        If a path cannot be read, or a cloud has no finite point.
    InvalidArgumentError
        Naming the argument.

    Notes
    -----
    Ren, Zhao & Han (2023), Section 5.3, Figure 18. The paper does not say what a hole is.

    Examples
    --------
    >>> target = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]]
    >>> source = [[1.5, 0.0, 0.0], [7.0, 0.0, 0.0]]
    >>> fused = fuse(source, target, np.eye(4), mode="fill_holes", hole_radius=2.0)
    >>> fused.points[:, 0], fused.origin
    (array([0., 1., 2., 7.]), array([0, 0, 0, 1], dtype=uint8))
    """
    matrix = pose_matrix(transformation)
    options: dict[str, Any] = {
        "mode": None if mode is None else checked_choice("mode", mode, ("merge", "dedup", "fill_holes")),
        "hole_radius_m": None if hole_radius is None else checked_number("hole_radius", hole_radius),
    }
    source_cloud, target_cloud = open_cloud(source, "source"), open_cloud(target, "target")
    check_room(len(source_cloud) + len(target_cloud))
    with naming(source_cloud, target_cloud):
        fused = _core.fuse(source_cloud.xyz, target_cloud.xyz, matrix, options_json(**options))
    return FusedCloud(**fused)


def _corners(name: str, corners: ArrayLike | None) -> NDArray[np.float64] | None:
    return None if corners is None else checked_array(name, corners, (2, 3))
