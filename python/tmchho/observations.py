"""What is known of a pose beside the clouds: a prior pose, and control points seen in both."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from numpy.typing import ArrayLike

from tmchho.arguments import checked_array, checked_number
from tmchho.config import options_json
from tmchho.errors import InvalidArgumentError


@dataclass(frozen=True, eq=False)
class PosePrior:
    """A pose that is known with some uncertainty, such as that of a GNSS receiver on a levelled tripod.

    Either the standard deviations or the covariance; what is None is not known. A scale is never prior
    knowledge: control points give it.

    Parameters
    ----------
    target_from_source : (4, 4) array_like
        Takes source to target coordinates, without a scale.
    rotation_rad : (3,) array_like, optional
        Standard deviations of the rotation about the axes of the target, in radians, above 0.
    translation_m : (3,) array_like, optional
        Standard deviations of the position of `about` along the axes of the target, above 0.
    covariance : (6, 6) array_like, optional
        Of rotation and position, in rad² and m², positive definite.
    about : (3,) array_like, optional
        The place in the source whose position is known; the middle of the source where not given.
    """

    target_from_source: ArrayLike
    rotation_rad: ArrayLike | None = None
    translation_m: ArrayLike | None = None
    covariance: ArrayLike | None = None
    about: ArrayLike | None = None


@dataclass(frozen=True, eq=False)
class ControlPoint:
    """One place that was measured in both clouds.

    Parameters
    ----------
    source, target : (3,) array_like
        Its coordinates in either cloud.
    sigma_m : float
        Standard deviation of each coordinate of the difference, both measurements together, above 0.
    """

    source: ArrayLike
    target: ArrayLike
    sigma_m: float


_SHAPES: dict[str, tuple[int, ...]] = {
    "target_from_source": (4, 4),
    "rotation_rad": (3,),
    "translation_m": (3,),
    "covariance": (6, 6),
    "about": (3,),
}


def observations_json(prior: PosePrior | None, control_points: Sequence[ControlPoint] | None) -> str:
    """Return the observations in the form that the core reads.

    Raises
    ------
    InvalidArgumentError
        Naming what is not an observation or has the wrong shape.
    """
    if prior is not None and not isinstance(prior, PosePrior):
        raise InvalidArgumentError(f"prior must be a PosePrior, got {type(prior).__name__}")
    points: list[dict[str, Any]] = []
    for i, point in enumerate(control_points or ()):
        name = f"control_points[{i}]"
        if not isinstance(point, ControlPoint):
            raise InvalidArgumentError(f"{name} must be a ControlPoint, got {type(point).__name__}")
        points.append(
            {
                "source": checked_array(f"{name}.source", point.source, (3,)),
                "target": checked_array(f"{name}.target", point.target, (3,)),
                "sigma_m": checked_number(f"{name}.sigma_m", point.sigma_m),
            }
        )
    known = {} if prior is None else {"prior": _prior(prior)}
    return options_json(control_points=points, **known)


def _prior(prior: PosePrior) -> dict[str, Any]:
    given = {name: getattr(prior, name) for name in _SHAPES}
    return {
        name: checked_array(f"prior.{name}", value, _SHAPES[name])
        for name, value in given.items()
        if value is not None
    }
