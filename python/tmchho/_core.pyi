"""The Rust core; the functions of the package say what these take and return.

Clouds are (n, 3) float64 C-contiguous arrays, poses (4, 4) ones, options JSON.
"""

from collections.abc import Callable
from typing import Any, Final, final

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "PointIndex",
    "Problem",
    "RunningVoxels",
    "Search",
    "SurfaceArea",
    "__version__",
    "benchmark_functions",
    "chaotic_sequence",
    "complete_config",
    "default_config",
    "distance_statistics",
    "distances_within",
    "estimate_normals",
    "euler_to_matrix",
    "evaluate",
    "fuse",
    "hole_radius_rule",
    "icp",
    "iss_keypoints",
    "kabsch",
    "levy_steps",
    "m3c2",
    "m3c2_scales",
    "matrix_to_euler",
    "median_spacing",
    "methods",
    "minimize",
    "nearest_distances",
    "plane_points",
    "register",
    "remove_outliers",
    "rms_fitness",
    "spacing_sample",
    "surface_of_rounds",
    "surface_within",
    "tile_of",
    "voxel_downsample",
]

__version__: Final[str]

_Floats = NDArray[np.float64]

def default_config() -> str: ...
def complete_config(json: str) -> str: ...
def register(
    source: _Floats,
    target: _Floats,
    config_json: str,
    progress: Callable[[str, int, int, float | None, bool], object] | None,
) -> dict[str, Any]: ...
def evaluate(
    source: _Floats, target: _Floats, transformation: _Floats, options_json: str
) -> dict[str, Any]: ...
def m3c2(
    source: _Floats, target: _Floats, transformation: _Floats, cores: _Floats | None, options_json: str
) -> dict[str, Any]: ...
def distance_statistics(distances: _Floats) -> dict[str, Any] | None: ...
def fuse(source: _Floats, target: _Floats, transformation: _Floats, options_json: str) -> dict[str, Any]: ...
def remove_outliers(array: _Floats, options_json: str) -> dict[str, Any]: ...
def voxel_downsample(array: _Floats, voxel_size: float) -> dict[str, Any]: ...
def iss_keypoints(array: _Floats, options_json: str) -> NDArray[np.uint32]: ...
def estimate_normals(array: _Floats, n_neighbors: int | None) -> tuple[_Floats, _Floats]: ...
def icp(
    source: _Floats, target: _Floats, start: _Floats, dof: int, observations_json: str, options_json: str
) -> dict[str, Any]: ...
def kabsch(source: _Floats, target: _Floats) -> _Floats: ...
def rms_fitness(source: _Floats, target: _Floats, parameters: list[float]) -> float: ...
def nearest_distances(source: _Floats, target: _Floats) -> _Floats: ...
def distances_within(
    places: _Floats, n_own: int, others: _Floats, max_distance: float, repeated: bool
) -> tuple[NDArray[np.float32], NDArray[np.bool_] | None]: ...
def spacing_sample(array: _Floats, n_sampled: int) -> _Floats: ...
def tile_of(array: _Floats, axes: list[int], places: list[float]) -> NDArray[np.uint16]: ...
def surface_within(
    places: _Floats,
    others: _Floats,
    low: tuple[float, float, float] | _Floats,
    high: tuple[float, float, float] | _Floats,
    options_json: str,
) -> tuple[_Floats, NDArray[np.bool_]]: ...
def plane_points(options_json: str) -> int: ...
def surface_of_rounds(places: _Floats, rounds: _Floats, options_json: str) -> _Floats: ...
def m3c2_scales(
    places: tuple[_Floats, _Floats], reference: _Floats, compared: _Floats, options_json: str
) -> tuple[list[float], float, float, int]: ...
def hole_radius_rule() -> tuple[float, float]: ...
def median_spacing(array: _Floats) -> float: ...
def euler_to_matrix(parameters: list[float]) -> _Floats: ...
def matrix_to_euler(matrix: _Floats) -> _Floats: ...

@final
class Search:
    def __new__(
        cls,
        bounds: tuple[list[float], list[float]],
        options_json: str,
        seed: int,
        start: list[list[float]],
    ) -> Search: ...
    def ask(self) -> _Floats: ...
    def tell(self, values: _Floats, callback: Callable[[_Floats, float], bool] | None) -> None: ...
    def is_over(self) -> bool: ...
    def minimum(self) -> dict[str, Any]: ...

@final
class PointIndex:
    def __new__(cls, array: _Floats) -> PointIndex: ...
    def distances(self, array: _Floats) -> _Floats: ...
    def k_nearest(self, array: _Floats, k: int) -> tuple[_Floats, NDArray[np.uint32]]: ...
    def nearest_elsewhere(self, array: _Floats) -> _Floats: ...

@final
class SurfaceArea:
    def __new__(cls, edge: float) -> SurfaceArea: ...
    def add(self, array: _Floats) -> None: ...
    def total(self) -> float: ...

@final
class RunningVoxels:
    def __new__(
        cls,
        low: tuple[float, float, float] | NDArray[np.float64],
        high: tuple[float, float, float] | NDArray[np.float64],
        voxel_size: float,
        max_voxels: int,
    ) -> RunningVoxels: ...
    def add(self, array: _Floats) -> None: ...
    def finish(self) -> dict[str, Any]: ...

@final
class Problem:
    def __new__(
        cls, name: str, dimension: int, shift: list[float] | None, rotation_seed: int | None
    ) -> Problem: ...
    def values(self, points: _Floats) -> _Floats: ...

def minimize(
    problem: Problem,
    bounds: tuple[list[float], list[float]],
    options_json: str,
    seed: int,
    start: list[list[float]],
    callback: Callable[[_Floats, float], bool] | None,
    n_threads: int | None,
) -> dict[str, Any]: ...
def methods() -> list[str]: ...
def benchmark_functions() -> list[tuple[str, str, float, float]]: ...
def chaotic_sequence(n: int, seed: int) -> _Floats: ...
def levy_steps(n: int, seed: int, factor: float | None) -> _Floats: ...
