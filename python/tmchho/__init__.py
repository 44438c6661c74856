"""Register cross-source 3D point clouds without targets and without an initial guess.

Start with `register`; `read` and `write` know the usual file formats, and `simulate` makes a pair of clouds
to try it on.
"""

from tmchho import simulate
from tmchho._core import __version__
from tmchho.benchmarks import BenchmarkFunction, BenchmarkProblem, benchmark_functions, benchmark_value
from tmchho.cloud import PointCloud
from tmchho.config import (
    Config,
    FuseOptions,
    HawkOptions,
    IcpOptions,
    IssOptions,
    OutlierOptions,
    PaperSearchOptions,
    RobustSearchOptions,
    VerdictOptions,
    VoxelOptions,
    default_config,
)
from tmchho.equations import (
    chaotic_sequence,
    euler_to_matrix,
    kabsch,
    levy_steps,
    matrix_to_euler,
    rms_fitness,
)
from tmchho.errors import (
    BudgetError,
    InvalidArgumentError,
    InvalidCloudError,
    NoSolutionError,
    ReadError,
    StoppedError,
    TmchhoError,
    WriteError,
)
from tmchho.evaluation import Area, AreaStatistics, Change, Evaluation, evaluate, m3c2, read_areas
from tmchho.fused import FusedCloud
from tmchho.inputs import CloudLike
from tmchho.io import read, write
from tmchho.moving import apply_transform, moved
from tmchho.network import NetworkRegistration, Station, StationControl, register_network
from tmchho.observations import ControlPoint, Observations, PosePrior, read_control_points
from tmchho.optimize import minimize
from tmchho.optimizer import MinimizeResult, Optimizer
from tmchho.pipeline import fuse, register
from tmchho.progress import ProgressEvent
from tmchho.report import write_report, write_view
from tmchho.results import Candidate, DistanceStatistics, Registration, StageRecord
from tmchho.stages import (
    IcpResult,
    OutlierResult,
    VoxelResult,
    estimate_normals,
    icp,
    iss_keypoints,
    median_spacing,
    nearest_distances,
    remove_outliers,
    voxel_downsample,
)
from tmchho.transform import Transform, read_transform

__all__ = [
    "Area",
    "AreaStatistics",
    "BenchmarkFunction",
    "BenchmarkProblem",
    "BudgetError",
    "Candidate",
    "Change",
    "CloudLike",
    "Config",
    "ControlPoint",
    "DistanceStatistics",
    "Evaluation",
    "FuseOptions",
    "FusedCloud",
    "HawkOptions",
    "IcpOptions",
    "IcpResult",
    "InvalidArgumentError",
    "InvalidCloudError",
    "IssOptions",
    "MinimizeResult",
    "NetworkRegistration",
    "NoSolutionError",
    "Observations",
    "Optimizer",
    "OutlierOptions",
    "OutlierResult",
    "PaperSearchOptions",
    "PointCloud",
    "PosePrior",
    "ProgressEvent",
    "ReadError",
    "Registration",
    "RobustSearchOptions",
    "StageRecord",
    "Station",
    "StationControl",
    "StoppedError",
    "TmchhoError",
    "Transform",
    "VerdictOptions",
    "VoxelOptions",
    "VoxelResult",
    "WriteError",
    "__version__",
    "apply_transform",
    "benchmark_functions",
    "benchmark_value",
    "chaotic_sequence",
    "default_config",
    "estimate_normals",
    "euler_to_matrix",
    "evaluate",
    "fuse",
    "icp",
    "iss_keypoints",
    "kabsch",
    "levy_steps",
    "m3c2",
    "matrix_to_euler",
    "median_spacing",
    "minimize",
    "moved",
    "nearest_distances",
    "read",
    "read_areas",
    "read_control_points",
    "read_transform",
    "register",
    "register_network",
    "remove_outliers",
    "rms_fitness",
    "simulate",
    "voxel_downsample",
    "write",
    "write_report",
    "write_view",
]
