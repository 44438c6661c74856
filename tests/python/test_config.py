"""Settings: one set of keys and defaults, Rust's, whatever way they come."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import tmchho
from tmchho import Config, errors
from tmchho.config import config_json, options_json


def keys(value: Any) -> Any:
    """Return the tree of names of a nested dict or dataclass."""
    if dataclasses.is_dataclass(value):
        value = {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
    return {name: keys(item) for name, item in value.items()} if isinstance(value, dict) else None


def places(value: dict[str, Any], above: tuple[str, ...] = ()) -> list[tuple[str, ...]]:
    """Return the path of every section of a nested dict, its root included."""
    sections = (places(item, (*above, name)) for name, item in value.items() if isinstance(item, dict))
    return [above, *(place for section in sections for place in section)]


def nested(place: tuple[str, ...], value: dict[str, Any]) -> dict[str, Any]:
    for name in reversed(place):
        value = {name: value}
    return value


def test_the_fields_are_the_keys_of_the_core() -> None:
    assert keys(Config()) == keys(tmchho.default_config())


def test_defaults_given_explicitly_are_the_defaults() -> None:
    defaults = tmchho.default_config()
    assert config_json(Config.from_dict(defaults)) == config_json(None) == config_json(defaults)
    assert Config().to_dict() == {}


@pytest.mark.parametrize("place", places(tmchho.default_config()), ids=".".join)
def test_an_unknown_key_is_refused_at_every_level(place: tuple[str, ...]) -> None:
    settings = nested(place, {"no_such_key": 1})
    for use in (Config.from_dict, config_json):
        with pytest.raises(errors.InvalidArgumentError, match="no_such_key"):
            use(settings)


@pytest.mark.parametrize(
    ("settings", "name"),
    [
        ({"n_threads": 0}, "n_threads"),
        ({"voxel": {"voxel_size_m": -1}}, "voxel_size_m"),
        ({"outliers": {"radius_m": 0}}, "outliers.radius_m"),
        ({"icp": {"kept_share": 1.5}}, "icp.kept_share"),
        ({"icp": {"method": "point_to_cloud"}}, "point_to_cloud"),
        ({"coarse": {"rotations_per_round": []}}, "coarse.rotations_per_round"),
        ({"paper": {"hawks": {"n_hawks": 0}}}, "n_hawks"),
        ({"verdict": {"accept_inlier_share": 2}}, "verdict.accept_inlier_share"),
        ({"fuse": {"hole_radius_m": 0}}, "fuse.hole_radius_m"),
        ({"fuse": {"mode": "join"}}, "join"),
        ({"voxel": {"voxel_size_m": float("nan")}}, "voxel.voxel_size_m must be a finite number"),
        ({"voxel": {"voxel_size_m": {1, 2}}}, "the configuration"),
        ({"voxel": 3}, "the configuration"),
        ({"seed": -1}, "the configuration"),
    ],
)
def test_a_value_out_of_range_is_refused(settings: dict[str, Any], name: str) -> None:
    with pytest.raises(errors.InvalidArgumentError, match=name):
        config_json(settings)


def test_every_way_of_giving_settings_says_the_same(tmp_path: Path) -> None:
    path = tmp_path / "settings.toml"
    path.write_text(
        'mode = "paper"\nseed = 9\n[voxel]\nvoxel_size_m = 0.125\n'
        "[coarse]\nrotations_per_round = [10, 20]\n[paper.hawks]\nn_hawks = 12\n",
        encoding="utf-8",
    )
    as_class = Config(
        mode="paper",
        seed=9,
        voxel=tmchho.VoxelOptions(voxel_size_m=0.125),
        coarse=tmchho.RobustSearchOptions(rotations_per_round=(10, 20)),
        paper=tmchho.PaperSearchOptions(hawks=tmchho.HawkOptions(n_hawks=12)),
    )
    assert Config.from_toml(path) == as_class
    assert Config.from_dict(as_class.to_dict()) == as_class
    texts = {config_json(given) for given in (as_class, as_class.to_dict(), path, str(path))}
    assert len(texts) == 1
    of_numpy = {**as_class.to_dict(), "seed": np.int64(9), "voxel": {"voxel_size_m": np.float32(0.125)}}
    assert texts == {config_json(of_numpy)}


def test_arguments_win_over_the_configuration() -> None:
    given = {"mode": "paper", "seed": 9}
    assert '"mode":"paper"' in config_json(given)
    assert '"mode":"robust"' in config_json(given, mode="robust")
    assert '"seed":9' in config_json(given)
    assert '"seed":0' in config_json(given, seed=0)
    assert given == {"mode": "paper", "seed": 9}


@pytest.mark.parametrize(
    ("content", "error", "problem"),
    [
        (None, errors.ReadError, "cannot be read"),
        (b"mode = ", errors.InvalidArgumentError, "not valid TOML"),
        (b"\xff\xfe\x00", errors.InvalidArgumentError, "not valid TOML"),
        (b"mode = 'fast'", errors.InvalidArgumentError, "fast"),
        (b"[icp]\nspeed = 3", errors.InvalidArgumentError, "speed"),
        (b"seed = 1979-05-27", errors.InvalidArgumentError, "date"),
    ],
)
def test_a_bad_file_is_named(
    tmp_path: Path, content: bytes | None, error: type[Exception], problem: str
) -> None:
    path = tmp_path / "settings.toml"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(error, match=problem) as refused:
        config_json(path)
    assert str(refused.value).startswith(f"{path}: ")


@pytest.mark.parametrize("config", [3, [1], object()])
def test_another_kind_of_configuration_is_refused(config: Any) -> None:
    with pytest.raises(errors.InvalidArgumentError, match="config must be"):
        config_json(config)


def test_options_that_are_none_are_left_to_the_core() -> None:
    assert options_json(radius_m=None, min_neighbors=0) == '{"min_neighbors": 0}'
