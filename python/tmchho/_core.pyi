"""The Rust core; the functions of the package say what these take and return.

Clouds are (n, 3) float64 C-contiguous arrays, poses (4, 4) ones, options JSON.
"""

from collections.abc import Callable
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "__version__",
    "benchmark_functions",
    "benchmark_value",
    "chaotic_sequence",
    "complete_config",
    "default_config",
    "estimate_normals",
    "euler_to_matrix",
    "evaluate",
    "fuse",
    "icp",
    "iss_keypoints",
    "kabsch",
    "levy_steps",
    "matrix_to_euler",
    "median_spacing",
    "minimize",
    "nearest_distances",
    "register",
    "remove_outliers",
    "rms_fitness",
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
    source: _Floats, target: _Floats, transformation: _Floats, tolerance: float | None
) -> dict[str, Any]: ...
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
def median_spacing(array: _Floats) -> float: ...
def euler_to_matrix(parameters: list[float]) -> _Floats: ...
def matrix_to_euler(matrix: _Floats) -> _Floats: ...
def minimize(
    fun: str | Callable[[_Floats], float],
    bounds: tuple[list[float], list[float]],
    options_json: str,
    seed: int,
    start: list[list[float]],
    callback: Callable[[_Floats, float], bool] | None,
) -> dict[str, Any]: ...
def benchmark_functions() -> list[tuple[str, str, float, float]]: ...
def benchmark_value(name: str, x: _Floats) -> float: ...
def chaotic_sequence(n: int, seed: int) -> _Floats: ...
def levy_steps(n: int, seed: int, factor: float | None) -> _Floats: ...
