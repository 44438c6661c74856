"""Every setting of a registration.

The keys, their meaning and their defaults are those of the Rust core (rust/config.rs), which also checks
them: a key that it does not know is refused at every level. Here a setting that is None is not given, and so
keeps the default of the core; `default_config` tells what that is.
"""

from __future__ import annotations

import json
import math
import os
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import Any, Literal, TypeAlias, TypeVar, get_args

import numpy as np

from tmchho import _core
from tmchho.arguments import checked_choice, checked_seed
from tmchho.errors import InvalidArgumentError, ReadError
from tmchho.observations import Observations, as_tuples

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

Mode: TypeAlias = Literal["robust", "paper"]
DegreesOfFreedom: TypeAlias = Literal[4, 6, 7]
Corners: TypeAlias = tuple[tuple[float, float, float], tuple[float, float, float]]
Method: TypeAlias = Literal["tmchho", "tmchho_free", "hho", "pso", "woa", "boa", "doa"]
MutationReading: TypeAlias = Literal["stagnant", "every_hawk", "after_dives", "after_besieges"]
_Section = TypeVar("_Section")
_NOTHING_KNOWN = Observations()


@dataclass(frozen=True)
class OutlierOptions:
    """Stage 1, removal of points that stand alone.

    Parameters
    ----------
    radius_m : float, optional
        Radius of the neighbourhood, above 0. Derived from the spacing of the cloud where not given.
    min_neighbors : int, optional
        Fewest neighbours, the point itself not counted, that keep a point.
    """

    radius_m: float | None = None
    min_neighbors: int | None = None


@dataclass(frozen=True)
class VoxelOptions:
    """Stage 2, one centroid per voxel.

    Parameters
    ----------
    voxel_size_m : float, optional
        Edge of a voxel in the clouds' unit, above 0. Derived from the clouds where not given.
    """

    voxel_size_m: float | None = None


@dataclass(frozen=True)
class IssOptions:
    """Stage 3, ISS keypoints (paper mode).

    Parameters
    ----------
    radius_m : float, optional
        Radius of the neighbourhood, above 0. Three voxels where not given.
    min_neighbors : int, optional
        Fewest neighbours of a keypoint.
    max_ratio_second_to_first, max_ratio_third_to_second : float, optional
        ε1 and ε2 of Eq. (4), above 0.
    non_max_radius_m : float, optional
        Keep only the most salient keypoint within this radius; all are kept where not given.
    """

    radius_m: float | None = None
    min_neighbors: int | None = None
    max_ratio_second_to_first: float | None = None
    max_ratio_third_to_second: float | None = None
    non_max_radius_m: float | None = None


@dataclass(frozen=True)
class RobustSearchOptions:
    """Stage 4 in robust mode.

    Parameters
    ----------
    rotations_per_round : tuple of int, optional
        Rotations tried in each round; a further round is begun only while no pose stands out. Before several
        rounds there is a brief one, of the first one's rotations at a quarter of its places, and between them
        are those of yaws alone, as dense as the second one's rotations, with both clouds upright or level.
    n_verified : int, optional
        Poses of each round that are refined and verified, at least 1.
    descriptors : bool, optional
        Propose poses by descriptors of the surface as well, in a round of its own: the first where one cloud
        is much larger than the other, else before the last.
    max_seconds : float, optional
        Seconds from the beginning of the registration, above 0, after which the search hands over the best
        pose so far. No limit where not given. What is found then depends on the machine.
    """

    rotations_per_round: tuple[int, ...] | None = None
    n_verified: int | None = None
    descriptors: bool | None = None
    max_seconds: float | None = None


@dataclass(frozen=True)
class HawkOptions:
    """The search by hawks (Section 4.3 and 4.4).

    Parameters
    ----------
    n_hawks : int, optional
        Size of the population, at least 4.
    n_iterations : int, optional
        How often the population is evaluated, at least 1.
    max_evaluations : int, optional
        Calls of the objective after which the search ends; no limit where not given.
    levy_factor : float, optional
        Factor of the Lévy flight, at least 0.
    mutation_variance : float, optional
        Variance of the factor o of Eq. (7), at least 0.
    chaotic_start : bool, optional
        Start from the chaotic map of Eq. (6) instead of uniform random numbers.
    trigonometric_mutation : bool, optional
        Mutate hawks by Eq. (7), and keep the mutation where it is better.
    mutation_reading : {'stagnant', 'every_hawk', 'after_dives', 'after_besieges'}, optional
        Which hawks are mutated: those that did not improve while they besieged or dived, all that did either,
        or those that did not improve while they did the one or the other.
    translation_invariant : bool, optional
        Apply the rules in coordinates whose origin is the best point so far. Not in the paper.
    """

    n_hawks: int | None = None
    n_iterations: int | None = None
    max_evaluations: int | None = None
    levy_factor: float | None = None
    mutation_variance: float | None = None
    chaotic_start: bool | None = None
    trigonometric_mutation: bool | None = None
    mutation_reading: MutationReading | None = None
    translation_invariant: bool | None = None


@dataclass(frozen=True)
class PaperSearchOptions:
    """Stage 4 in paper mode.

    Parameters
    ----------
    search_box : {'centred', 'literal'}, optional
        Angles in [-π, π] and shifts within half a diagonal of where the centroids meet, or all six
        parameters in [-50, 50] as printed.
    method : {'tmchho', 'tmchho_free', 'hho', 'pso', 'woa', 'boa', 'doa'}, optional
        The optimiser.
    hawks : HawkOptions
        How the search runs. Method 'hho' has neither of the two improvements, whatever is said here; the
        methods without hawks take the size of the population and the limits alone.
    """

    search_box: Literal["centred", "literal"] | None = None
    method: Method | None = None
    hawks: HawkOptions = HawkOptions()


@dataclass(frozen=True)
class IcpOptions:
    """Stage 5, ICP.

    Parameters
    ----------
    method : {'point_to_point', 'point_to_plane', 'plane_to_plane'}, optional
        Where not given, point-to-plane in robust mode and point-to-point in paper mode.
    kernel : {'least_squares', 'tukey'}, optional
        What large residuals count: their square, or less and less and then nothing. Where not given,
        Tukey's for the methods with planes.
    max_distance_m : float, optional
        Partners farther away do not count. Derived from the voxel in robust mode, no limit in paper mode
        where not given.
    kept_share : float, optional
        Share of the pairs that count, closest first, in (0, 1]. Where not given, estimated from their
        distances for the methods with planes, all for point-to-point.
    coarse_to_fine : bool, optional
        Whether samples of the source, each eight times as large as the one before, come to rest before all
        its points do. Where not given, yes in robust mode and no in paper mode.
    max_iterations : int, optional
        At least 1; of every sample as well.
    relative_tolerance : float, optional
        Stop when the mean squared distance changes by less than this share of itself.
    """

    method: Literal["point_to_point", "point_to_plane", "plane_to_plane"] | None = None
    kernel: Literal["least_squares", "tukey"] | None = None
    max_distance_m: float | None = None
    kept_share: float | None = None
    coarse_to_fine: bool | None = None
    max_iterations: int | None = None
    relative_tolerance: float | None = None


@dataclass(frozen=True)
class VerdictOptions:
    """Stage 6, where the lines between accepted, review and rejected are drawn.

    Parameters
    ----------
    accept_inlier_share, reject_inlier_share : float, optional
        Shares of inliers, 0 to 1: accept only above the one, reject below the other.
    accept_ambiguity_ratio, reject_ambiguity_ratio : float, optional
        Score of the best pose by that of its best rival, at least 1.
    accept_share_times_ratio : float, optional
        Accept only where that ratio times the net share, that of inliers less what conflicts with it, is
        above this, at least 0.
    accept_strength : float, optional
        Accept only where the weakest direction is held by this share, 0 to 1.
    accept_lead_over_chance : float, optional
        Accept only where the pose scores so many times what a few random poses reach, at least 1.
    accept_held_out_ratio : float, optional
        Accept only where points held out of the fit lie at most so many times as far away as those in it, at
        least 1.
    accept_misfit : float, optional
        Accept only where the surfaces lie at most so many times as far apart as they are rough themselves,
        above 0.
    accept_conflict_share : float, optional
        Accept only where at most this share of what lies near the other cloud lies above or below its
        surface, 0 to 1.
    accept_surface_offset : float, optional
        Accept only where even surfaces lie at most so far apart once their noise is averaged out, as a share
        of the extent of the smaller cloud, times (1 - conflict share), and times 0.75 by the misfit where
        that is above 0.75. Above 0.
    accept_deviation_from_known : float, optional
        Accept only up to so many standard deviations from the prior and the control points, above 0.
    """

    accept_inlier_share: float | None = None
    accept_ambiguity_ratio: float | None = None
    accept_share_times_ratio: float | None = None
    accept_strength: float | None = None
    accept_lead_over_chance: float | None = None
    accept_held_out_ratio: float | None = None
    accept_misfit: float | None = None
    accept_conflict_share: float | None = None
    accept_surface_offset: float | None = None
    accept_deviation_from_known: float | None = None
    reject_inlier_share: float | None = None
    reject_ambiguity_ratio: float | None = None


@dataclass(frozen=True)
class FuseOptions:
    """Stage 8, fusion.

    Parameters
    ----------
    mode : {'merge', 'dedup', 'fill_holes'}, optional
        Take all points of the source, all but those that repeat a point of the target, or only those that
        fill a hole of the target.
    hole_radius_m : float, optional
        A point farther than this from the other cloud fills a hole. Derived from the spacing where not given.
    """

    mode: Literal["merge", "dedup", "fill_holes"] | None = None
    hole_radius_m: float | None = None


@dataclass(frozen=True)
class Config:
    """All settings of `register`; what is None keeps the default of the core.

    Parameters
    ----------
    mode : {'robust', 'paper'}, optional
        Which search is run: many starts verified in both directions, or the paper's method.
    seed : int, optional
        Seed of all random numbers, 0 to 2⁶⁴ - 1.
    n_threads : int, optional
        At least 1; the machine's where not given. Never changes the result.
    dof : {4, 6, 7}, optional
        Degrees of freedom: a turn about z and a shift, both clouds being levelled; any rotation and a shift;
        a scale as well. Paper mode knows 6 only.
    known : Observations
        What is known of the pose beforehand (robust mode).
    scale_bounds : (float, float), optional
        By what the source may have to be multiplied with ``dof=7``, least and most, above 0.
    source_crop_m, target_crop_m : ((float, float, float), (float, float, float)), optional
        Lower and upper corner of the box whose points take part in finding the pose; all where not given.
    outliers, voxel, keypoints, coarse, paper, icp, verdict, fuse
        The options of the stages.

    Examples
    --------
    >>> config = Config(mode="paper", voxel=VoxelOptions(voxel_size_m=0.1))
    >>> config.to_dict()
    {'mode': 'paper', 'voxel': {'voxel_size_m': 0.1}}
    >>> Config.from_dict(config.to_dict()) == config
    True
    """

    mode: Mode | None = None
    seed: int | None = None
    n_threads: int | None = None
    dof: DegreesOfFreedom | None = None
    known: Observations = _NOTHING_KNOWN
    scale_bounds: tuple[float, float] | None = None
    source_crop_m: Corners | None = None
    target_crop_m: Corners | None = None
    outliers: OutlierOptions = OutlierOptions()
    voxel: VoxelOptions = VoxelOptions()
    keypoints: IssOptions = IssOptions()
    coarse: RobustSearchOptions = RobustSearchOptions()
    paper: PaperSearchOptions = PaperSearchOptions()
    icp: IcpOptions = IcpOptions()
    verdict: VerdictOptions = VerdictOptions()
    fuse: FuseOptions = FuseOptions()

    def to_dict(self) -> dict[str, Any]:
        """Return the settings that are given, nested as in a configuration file."""
        return _given(self)

    @classmethod
    def from_dict(cls, settings: Mapping[str, Any]) -> Config:
        """Read settings that are nested as in a configuration file.

        Raises
        ------
        InvalidArgumentError
            Naming a key that is not known, or a value of the wrong kind or out of its range.
        """
        _core.complete_config(_to_json(settings))
        return _filled(cls, settings)

    @classmethod
    def from_toml(cls, path: str | os.PathLike[str]) -> Config:
        """Read a configuration file.

        Raises
        ------
        ReadError
            If the file cannot be read.
        InvalidArgumentError
            If it is not TOML, or as `from_dict`; the message names the file.
        """
        path = Path(path)
        try:
            settings = tomllib.loads(path.read_text(encoding="utf-8-sig"))
            return cls.from_dict(settings)
        except OSError as error:
            raise ReadError(
                f"{path}: cannot be read ({error.strerror}); check the name and the rights"
            ) from error
        except InvalidArgumentError as error:
            raise InvalidArgumentError(f"{path}: {error}") from None
        except ValueError as error:  # not TOML, or not text
            raise InvalidArgumentError(f"{path}: is not valid TOML: {error}") from error


ConfigLike: TypeAlias = Config | Mapping[str, Any] | str | os.PathLike[str]
"""A `Config`, a mapping nested like one, or the path of a TOML file."""


def default_config() -> dict[str, Any]:
    """Return all settings with the defaults of the core; None means "derived from the clouds".

    Examples
    --------
    >>> default_config()["mode"], default_config()["icp"]["max_distance_m"]
    ('robust', None)
    """
    settings: dict[str, Any] = json.loads(_core.default_config())
    return settings


def config_json(config: ConfigLike | None, **given: Any) -> str:
    """Return checked settings as JSON; those of `given` that are not None win.

    Parameters
    ----------
    config : ConfigLike, optional
        Settings of all kinds.
    **given
        By key, a key within a section as ``coarse__max_seconds``.

    Raises
    ------
    ReadError, InvalidArgumentError
        As `Config.from_toml`.
    """
    if config is None:
        settings: dict[str, Any] = {}
    elif isinstance(config, Config):
        settings = config.to_dict()
    elif isinstance(config, Mapping):
        settings = dict(config)
    elif isinstance(config, (str, os.PathLike)):
        settings = Config.from_toml(config).to_dict()
    else:
        raise InvalidArgumentError(
            f"config must be a Config, a mapping or the path of a TOML file, got {type(config).__name__}"
        )
    if given.get("mode") is not None:
        checked_choice("mode", given["mode"], get_args(Mode))
    if given.get("seed") is not None:
        given["seed"] = checked_seed(given["seed"])
    for place, value in given.items():
        if value is None:
            continue
        section, _, key = place.rpartition("__")
        if not section:
            settings[key] = value
        elif isinstance(settings.get(section, {}), Mapping):  # the core refuses anything else
            settings[section] = {**settings.get(section, {}), key: value}
    return _core.complete_config(_to_json(settings))


def options_json(**options: Any) -> str:
    """Return the options of one stage as JSON, without those that are None."""
    return _to_json({key: value for key, value in options.items() if value is not None})


def _to_json(settings: Mapping[str, Any]) -> str:
    def plain(value: Any) -> Any:
        if isinstance(value, (np.generic, np.ndarray)):
            return value.tolist()
        if isinstance(value, Mapping):
            return dict(value)
        if is_dataclass(value) and not isinstance(value, type):
            return _given(value)
        raise TypeError(f"a setting cannot be of type {type(value).__name__}")

    try:
        return json.dumps(settings, default=plain, allow_nan=False)
    except (TypeError, ValueError) as error:
        for place, value in _without_value(settings):
            raise InvalidArgumentError(f"{place} must be a finite number, got {value}") from error
        raise InvalidArgumentError(f"the configuration is not valid: {error}") from error


def _without_value(settings: Any, place: str = "") -> Iterator[tuple[str, float]]:
    """Give the path of every setting that is NaN or infinite."""
    if is_dataclass(settings) and not isinstance(settings, type):
        settings = _given(settings)
    if isinstance(settings, Mapping):
        for key, value in settings.items():
            yield from _without_value(value, f"{place}.{key}" if place else str(key))
    elif isinstance(settings, (list, tuple)):
        for value in settings:
            yield from _without_value(value, place)
    elif isinstance(settings, (float, np.floating)) and not math.isfinite(settings):
        yield place, float(settings)


def _given(options: Any) -> dict[str, Any]:
    settings: dict[str, Any] = {}
    for field in fields(options):
        value = getattr(options, field.name)
        if is_dataclass(value):
            value = _given(value) or None
        if value is not None:
            settings[field.name] = _as_lists(value)
    return settings


def _as_lists(value: Any) -> Any:
    if isinstance(value, tuple):
        return [_given(item) if is_dataclass(item) else _as_lists(item) for item in value]
    return value


def _filled(section: type[_Section], settings: Mapping[str, Any]) -> _Section:
    values: dict[str, Any] = {}
    for field in fields(section):  # type: ignore[arg-type]
        value = settings.get(field.name)
        if isinstance(field.default, Observations):
            value = Observations.from_dict(value or {})
        elif isinstance(value, Mapping):
            value = _filled(type(field.default), value)
        if value is not None:
            values[field.name] = as_tuples(value)
    return section(**values)
