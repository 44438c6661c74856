//! The Python extension module `tmchho._core`: the only room that has Python in it.
//!
//! Why: there is one pipeline, in Rust; Python gets it as functions of arrays, and the package round
//! them (python/tmchho/) adds types, files and words. Nothing is computed here.
//! Reads: (n, 3) float64 C-contiguous arrays, options as JSON. Leaves: arrays and plain values.
//! Absent on purpose: defaults, and checks that the crate makes anyway.

mod arrays;
mod config;
mod distances;
mod errors;
mod optim;
mod registration;
mod run;
mod stages;
mod streams;

use pyo3::prelude::*;

/// The Rust core of `tmchho`; use the functions of the package instead.
#[pymodule(gil_used = false)]
fn _core(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add_function(wrap_pyfunction!(config::default_config, module)?)?;
    module.add_function(wrap_pyfunction!(config::complete_config, module)?)?;
    module.add_function(wrap_pyfunction!(registration::register, module)?)?;
    module.add_function(wrap_pyfunction!(distances::evaluate, module)?)?;
    module.add_function(wrap_pyfunction!(distances::m3c2, module)?)?;
    module.add_function(wrap_pyfunction!(registration::fuse, module)?)?;
    module.add_function(wrap_pyfunction!(stages::remove_outliers, module)?)?;
    module.add_function(wrap_pyfunction!(stages::voxel_downsample, module)?)?;
    module.add_function(wrap_pyfunction!(stages::iss_keypoints, module)?)?;
    module.add_function(wrap_pyfunction!(stages::estimate_normals, module)?)?;
    module.add_function(wrap_pyfunction!(stages::icp, module)?)?;
    module.add_function(wrap_pyfunction!(stages::kabsch, module)?)?;
    module.add_function(wrap_pyfunction!(stages::rms_fitness, module)?)?;
    module.add_function(wrap_pyfunction!(stages::nearest_distances, module)?)?;
    module.add_function(wrap_pyfunction!(stages::median_spacing, module)?)?;
    module.add_function(wrap_pyfunction!(stages::euler_to_matrix, module)?)?;
    module.add_function(wrap_pyfunction!(stages::matrix_to_euler, module)?)?;
    module.add_function(wrap_pyfunction!(distances::distance_statistics, module)?)?;
    module.add_function(wrap_pyfunction!(optim::minimize, module)?)?;
    module.add_function(wrap_pyfunction!(optim::benchmark_functions, module)?)?;
    module.add_function(wrap_pyfunction!(optim::methods, module)?)?;
    module.add_function(wrap_pyfunction!(optim::chaotic_sequence, module)?)?;
    module.add_function(wrap_pyfunction!(optim::levy_steps, module)?)?;
    module.add_function(wrap_pyfunction!(streams::distances_within, module)?)?;
    module.add_function(wrap_pyfunction!(streams::spacing_sample, module)?)?;
    module.add_function(wrap_pyfunction!(streams::tile_of, module)?)?;
    module.add_function(wrap_pyfunction!(streams::hole_radius_rule, module)?)?;
    module.add_function(wrap_pyfunction!(streams::surface_within, module)?)?;
    module.add_function(wrap_pyfunction!(streams::plane_points, module)?)?;
    module.add_function(wrap_pyfunction!(streams::surface_of_rounds, module)?)?;
    module.add_function(wrap_pyfunction!(streams::m3c2_scales, module)?)?;
    module.add_class::<streams::RunningVoxels>()?;
    module.add_class::<streams::PointIndex>()?;
    module.add_class::<streams::SurfaceArea>()?;
    module.add_class::<optim::Problem>()?;
    module.add_class::<optim::Search>()?;
    Ok(())
}
