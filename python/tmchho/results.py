"""What a registration leaves: plain frozen data, for people and for JSON.

Lengths are in the unit of the clouds, angles in radians; a pose takes source coordinates to target
coordinates. Arrays in here are read-only.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tmchho import _core
from tmchho.arguments import checked_array
from tmchho.inputs import CloudLike, open_points

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Verdict: TypeAlias = Literal["accepted", "review", "rejected"]


class ReadOnlyArrays:
    """Keeps the arrays of a dataclass read-only, also in copies and after pickling."""

    def __post_init__(self) -> None:
        for value in vars(self).values():
            if isinstance(value, np.ndarray):
                value.setflags(write=False)

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self.__post_init__()


@dataclass(frozen=True)
class DistanceStatistics:
    """Distances from the points of one cloud to the nearest of the other, summed up.

    Parameters
    ----------
    n_points : int
        How many distances.
    mean, best, worst, std : float
        Average, smallest, largest and population standard deviation: Avg, Best, Worst and Std of the
        article's Table 7.
    rms, median, percentile_95 : float
        Root of the mean square; half and 95 % of the distances lie below the other two.

    Notes
    -----
    Of signed distances, the mean and the median keep the sign; best, worst and the percentile are of the
    absolute values.
    """

    n_points: int
    mean: float
    best: float
    worst: float
    std: float
    rms: float
    median: float
    percentile_95: float

    @classmethod
    def of(cls, distances: ArrayLike) -> DistanceStatistics | None:
        """Sum up distances, which may be signed.

        Parameters
        ----------
        distances : (n,) array_like
            Finite numbers.

        Returns
        -------
        DistanceStatistics or None
            None where there are none, or one is not finite.

        Examples
        --------
        >>> DistanceStatistics.of([-4.0, 1.0, -2.0, 3.0]).worst
        4.0
        """
        found = _core.distance_statistics(checked_array("distances", distances, (-1,)))
        return None if found is None else cls(**found)


@dataclass(frozen=True)
class StageRecord:
    """What one stage did.

    Parameters
    ----------
    name : str
        ``outliers``, ``voxel``, ``keypoints``, ``coarse``, ``icp``, ``verdict`` or ``evaluate``.
    n_source_in, n_source_out, n_target_in, n_target_out : int
        Points that went in and came out.
    seconds : float
        Wall time.
    """

    name: str
    n_source_in: int
    n_source_out: int
    n_target_in: int
    n_target_out: int
    seconds: float


@dataclass(frozen=True, eq=False)
class Candidate(ReadOnlyArrays):
    """A pose that the search found.

    Parameters
    ----------
    transformation : (4, 4) float64 array
        Target from source.
    score : float
        Higher is better: in robust mode the curvature-weighted symmetric share of inliers, 0 to about 1; in
        paper mode minus the RMS of Eq. (1).
    """

    transformation: NDArray[np.float64]
    score: float


@dataclass(frozen=True, eq=False)
class Registration(ReadOnlyArrays):
    """A pose, and everything that tells how far to trust it.

    Parameters
    ----------
    transformation : (4, 4) float64 array
        Takes source coordinates to target coordinates, both as given: ``q = T[:3, :3] @ p + T[:3, 3]``. Its
        3 × 3 part is the rotation, times `scale` with ``dof=7``.
    scale : float
        Length in the target of what is one unit long in the source; 1 unless ``dof=7``.
    verdict : {'accepted', 'review', 'rejected'}
        The data support this pose and no other; a person has to look; the data do not support it.
    reasons : tuple of str
        Why, the weightiest first.
    fitness : float
        Source voxels with a partner within `max_distance`, by all source voxels.
    inlier_rmse : float
        Root mean squared distance of those pairs.
    inlier_rmse_back : float
        The same of the target voxels with a partner in the source.
    n_inliers : int
        Number of source voxels with a partner.
    overlap_of_source, overlap_of_target : float
        Share of the points of the one cloud, at full density, within `max_distance` of the other.
    inlier_share : float
        Surface of both clouds with a partner and an agreeing normal, by twice that of the smaller cloud,
        0 to 1.
    ambiguity_ratio : float
        Score of the best pose by that of its best rival; infinite without a rival, NaN in paper mode.
    least_ambiguity_ratio : float
        Above this ratio the pose is accepted: `verdict.accept_ambiguity_ratio`, or more where the clouds
        share little; infinite where they share nothing.
    strength : float
        How firmly the weakest direction is held: 0 (slides freely) to about 1/6.
    weakest_direction : str
        That direction in words.
    lead_over_chance : float
        Score of the best pose by the best that a few random poses reach; NaN in paper mode.
    held_out_ratio : float
        Root mean squared distance of pairs that were held out of the fit by that of others: near 1 unless the
        fit follows chance. NaN where there are too few.
    misfit : float
        How far the surfaces lie apart, by how rough they are themselves: below 1 for one surface measured
        twice, larger for places that resemble each other. NaN where there are too few pairs.
    conflict_share : float
        Surface of both clouds that lies above or below the other's, not beside it, by that and what has a
        partner, 0 to 1: near 0 at the right pose, more where surfaces cross, or where one sensor saw through
        or behind what the other saw.
    net_share : float
        The share of inliers, less what conflicts with it: times (1 - `conflict_share`)⁴.
    surface_offset : float
        How far even surfaces lie apart once their noise is averaged out: distances along the normal between
        patches of both clouds (those of M3C2), averaged over regions, less what noise adds to the average;
        what nine tenths of them stay below. NaN where hardly any surface is even, or points are too few.
    most_surface_offset : float
        Up to this offset the pose is accepted: `verdict.accept_surface_offset` times `extent`, or less where
        surfaces conflict, or lie about as far apart as they are rough.
    extent : float
        Extent of the smaller cloud, 2.4 times the radius that holds 99.5 % of its points. Lengths that are
        not given are derived from it.
    registration_error : float or None
        The 1σ displacement of a point by the errors of the pose, in the unit of the target: in all directions
        together, root mean square over the overlap. It is the term "reg" of the level of detection of M3C2,
        1.96·(√(σ₁²/n₁ + σ₂²/n₂) + reg); along one direction it is smaller, by 1/√3 where all are alike. About
        the radius of the overlap where the common surface leaves a direction open. None where the pairs are
        too few to tell, or ICP found nothing better than the coarse pose. Errors that both clouds share,
        such as a wrong scale bar, do not show.
    scale_standard_error : float or None
        Standard error of the scale, relative to it; None unless ``dof=7``.
    covariance : (7, 7) float64 array or None
        Of the rotation about the axes of the target (rad), the shift of `covariance_middle`, and the
        logarithm of the scale; rows of zeros for what was not free. None where `registration_error` is.
    covariance_middle : (3,) float64 array or None
        The place in the target, near the middle of the pairs, about which the covariance is stated.
    ended_early : bool
        Whether the time was up before the search was done.
    candidates : tuple of Candidate
        The best poses found, best first, before ICP.
    n_evaluations : int
        Poses for which the clouds were compared during the search.
    history : (n,) float64 array
        Best score of the search so far, step by step; in paper mode the RMS of Eq. (1).
    converged : bool
        Whether ICP came to rest.
    icp_stop_reason : {'converged', 'max_iterations', 'no_partners', 'scale_ran_away'}
        Why ICP ended.
    n_icp_iterations : int
        Iterations of ICP.
    icp_history : (n,) float64 array
        Mean squared distance after each of them, of points or to planes, as the method says.
    source_pivot, target_pivot : (3,) float64 array
        Centroids of the clouds.
    pivot_transformation : (4, 4) float64 array
        The same pose about the pivots: ``q = T[:3, :3] @ (p - source_pivot) + T[:3, 3] + target_pivot``.
        Small numbers, of which nothing is lost as text even at national-grid coordinates.
    source_to_target, target_to_source : DistanceStatistics
        Distances from every point of the one cloud to the other, at full density.
    n_non_finite : tuple of int
        Points of source and target that were left out because a coordinate is NaN or infinite.
    outlier_radius : tuple of float
        Radius of the outlier removal in source and target.
    voxel_size : float
        Edge of the voxels.
    max_distance : float
        Distance within which a partner supports the pose.
    stages : tuple of StageRecord
        What each stage did; with ``dof=7`` voxel and coarse come once for each scale that was tried, and
        voxel once more.
    seconds : float
        Wall time of the call, reading files not counted.
    mode : {'robust', 'paper'}
        The search that was run.
    seed : int
        Seed of all random numbers.
    config : dict
        All settings, with what was derived filled in.
    source_name, target_name : str
        How the clouds were called, usually their paths.
    version : str
        Version of this package.
    """

    transformation: NDArray[np.float64]
    scale: float
    verdict: Verdict
    reasons: tuple[str, ...]
    fitness: float
    inlier_rmse: float
    inlier_rmse_back: float
    n_inliers: int
    overlap_of_source: float
    overlap_of_target: float
    inlier_share: float
    ambiguity_ratio: float
    least_ambiguity_ratio: float
    strength: float
    weakest_direction: str
    lead_over_chance: float
    held_out_ratio: float
    misfit: float
    conflict_share: float
    net_share: float
    surface_offset: float
    most_surface_offset: float
    extent: float
    registration_error: float | None
    scale_standard_error: float | None
    covariance: NDArray[np.float64] | None
    covariance_middle: NDArray[np.float64] | None
    ended_early: bool
    candidates: tuple[Candidate, ...]
    n_evaluations: int
    history: NDArray[np.float64]
    converged: bool
    icp_stop_reason: str
    n_icp_iterations: int
    icp_history: NDArray[np.float64]
    source_pivot: NDArray[np.float64]
    target_pivot: NDArray[np.float64]
    pivot_transformation: NDArray[np.float64]
    source_to_target: DistanceStatistics
    target_to_source: DistanceStatistics
    n_non_finite: tuple[int, int]
    outlier_radius: tuple[float, float]
    voxel_size: float
    max_distance: float
    stages: tuple[StageRecord, ...]
    seconds: float
    mode: Literal["robust", "paper"]
    seed: int
    config: dict[str, Any]
    source_name: str
    target_name: str
    version: str

    @classmethod
    def _from_core(
        cls, found: dict[str, Any], *, seconds: float, source_name: str, target_name: str
    ) -> Registration:
        config = json.loads(found.pop("config_json"))
        found["reasons"] = tuple(found["reasons"])
        found["candidates"] = tuple(Candidate(*candidate) for candidate in found["candidates"])
        found["stages"] = tuple(StageRecord(**record) for record in found["stages"])
        for direction in ("source_to_target", "target_to_source"):
            found[direction] = DistanceStatistics(**found[direction])
        return cls(
            **found,
            converged=found["icp_stop_reason"] == "converged",
            seconds=seconds,
            mode=config["mode"],
            seed=config["seed"],
            config=config,
            source_name=source_name,
            target_name=target_name,
            version=_core.__version__,
        )

    def apply(self, points: CloudLike) -> NDArray[np.float64]:
        """Move points from source coordinates to target coordinates.

        Parameters
        ----------
        points : CloudLike
            (n, 3) in the coordinates in which the source was given.

        Returns
        -------
        (n, 3) float64 array
            Turned about the pivots, so that nothing is lost at national-grid size. Rows with NaN stay NaN.

        Raises
        ------
        ReadError, InvalidCloudError
            If `points` is a file that cannot be read, or not (n, 3) real numbers.
        """
        matrix = self.pivot_transformation
        local = open_points(points, "points") - self.source_pivot
        moved = local @ matrix[:3, :3].T + matrix[:3, 3]
        return np.asarray(moved + self.target_pivot)

    def to_dict(self) -> dict[str, Any]:
        """Return everything as what JSON knows.

        Arrays become lists, numbers that are not finite None. The same input and seed give the same values,
        except under keys called ``seconds``; the number of threads, which changes nothing, is left out.
        """
        values: dict[str, Any] = plain(self)
        values["config"].pop("n_threads")
        return values

    def summary(self) -> str:
        """Return the result in a few lines for people; angles are in degrees."""
        first = self.stages[0]
        turn_deg = math.degrees(_rotation_angle_rad(self.transformation))
        # Where the middle of the source goes; the matrix's own shift is that of a far-away origin.
        shift = np.linalg.norm(self.pivot_transformation[:3, 3] + self.target_pivot - self.source_pivot)
        n_voxels = [stage.n_source_out for stage in self.stages if stage.name == "voxel"][-1]
        forth, back = self.source_to_target, self.target_to_source
        lines = [
            f"{self.verdict}: " + "\n".join([self.reasons[0], *(f"    and {r}" for r in self.reasons[1:])]),
            f"source     {self.source_name} ({first.n_source_in:,} points)",
            f"target     {self.target_name} ({first.n_target_in:,} points)",
            f"pose       turned by {turn_deg:.4f}°, its middle moved by {shift:.4f}",
        ]
        if self.config["dof"] == 7:
            error = self.scale_standard_error
            doubt = "not known" if error is None else f"{error * self.scale:.2g}"
            lines.append(f"scale      {self.scale:.8g} (standard error {doubt})")
        error = self.registration_error
        accuracy = "1σ displacement of a point by the errors of the pose"
        accuracy = "not known" if error is None else f"{error:.2g} ({accuracy})"
        misfit = f"the surfaces lie {self.misfit:.2f} times as far apart as they are rough themselves"
        misfit = "not known" if math.isnan(self.misfit) else misfit
        offset = f"nine tenths of even surface lie within {self.surface_offset:.2g}, noise averaged out"
        offset = "not known" if math.isnan(self.surface_offset) else offset
        conflict = f"{self.conflict_share:.1%} of the surface near the other cloud lies above or below it"
        lines += [
            f"accuracy   {accuracy}",
            f"overlap    {self.overlap_of_source:.1%} of the source, {self.overlap_of_target:.1%} of the"
            f" target within {self.max_distance:.4g}",
            f"fit        {self.inlier_rmse:.4g} RMS of {self.n_inliers:,} of {n_voxels:,} voxels"
            f" of edge {self.voxel_size:.4g}",
            f"misfit     {misfit}",
            f"offset     {offset}",
            f"conflict   {conflict}",
            f"held       {self.strength:.3f} in the weakest direction, {self.weakest_direction}",
            f"distances  source to target: median {forth.median:.4g}, 95 % below"
            f" {forth.percentile_95:.4g};"
            f" target to source: median {back.median:.4g}, 95 % below {back.percentile_95:.4g}",
            f"took       {self.seconds:.1f} s, seed {self.seed}, {self.mode} mode"
            + (", ended before the search was done" if self.ended_early else ""),
        ]
        return "\n".join(lines)

    def plot(self, source: CloudLike | None = None, target: CloudLike | None = None) -> Figure:
        """Draw how the search went or, given the clouds, how they lay before and lie now.

        Parameters
        ----------
        source, target : CloudLike, optional
            The clouds that were registered.

        Returns
        -------
        matplotlib.figure.Figure
            It shows itself in a notebook; ``figure.savefig(path)`` keeps it.

        Raises
        ------
        InvalidArgumentError
            If matplotlib or jinja2 is missing: ``pip install 'tmchho[report]'``.
        """
        from tmchho.report.notebook import plot_registration

        return plot_registration(self, source, target)

    def _repr_html_(self) -> str:
        from tmchho.report.notebook import registration_html

        return registration_html(self)


def pose_matrix(transformation: Registration | ArrayLike | None) -> NDArray[np.float64]:
    """Return the (4, 4) matrix of a pose in whatever form a caller has it; the identity where not given."""
    if transformation is None:
        return np.eye(4)
    if isinstance(transformation, Registration):
        return transformation.transformation
    return checked_array("transformation", transformation, (4, 4))


def plain(value: Any) -> Any:
    """Return `value` as what JSON knows: dataclasses and arrays become dicts and lists, NaN and ±∞ None."""
    if is_dataclass(value) and not isinstance(value, type):
        return {field.name: plain(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, Mapping):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, (np.ndarray, np.generic)):
        return plain(value.tolist())
    if isinstance(value, (tuple, list)):
        return [plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def _rotation_angle_rad(matrix: NDArray[np.float64]) -> float:
    # Accurate near 0 and near π, where the arc cosine of the trace is not.
    axis = (matrix[2, 1] - matrix[1, 2], matrix[0, 2] - matrix[2, 0], matrix[1, 0] - matrix[0, 1])
    # A scale multiplies both, but for the 1, which is then the scale.
    scale = float(np.cbrt(np.linalg.det(matrix[:3, :3])))
    return math.atan2(math.hypot(*axis), float(np.trace(matrix[:3, :3])) - scale)
