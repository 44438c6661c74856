//! The route, and fusion.

use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};

use super::arrays::{ReadArray, dict, from_points, from_pose, from_rows, from_vec, points, pose};
use super::config::{options, word};
use super::errors::as_argument;
use super::run::{briefly, with_progress};
use crate::config::Config;
use crate::evaluate::DistanceStatistics;
use crate::pipeline;
use crate::registration::Registration;

/// Registers `source` onto `target`.
#[pyfunction]
pub(super) fn register<'py>(
    py: Python<'py>,
    source: ReadArray<'py>,
    target: ReadArray<'py>,
    config_json: &str,
    progress: Option<Py<PyAny>>,
) -> PyResult<Bound<'py, PyDict>> {
    let config = briefly(|| Ok(Config::from_json(config_json)?))?;
    let (source, target) = (points(&source)?, points(&target)?);
    let found = with_progress(py, progress, |progress| {
        pipeline::register(source, target, &config, progress)
    })?;
    briefly(|| registration(py, found))
}

fn registration(py: Python<'_>, found: Registration) -> PyResult<Bound<'_, PyDict>> {
    let candidates = PyList::empty(py);
    for (pose, score) in &found.candidates {
        candidates.append((from_pose(py, pose), score))?;
    }
    let stages = PyList::empty(py);
    for record in &found.stages {
        stages.append(dict! { py,
            "name": record.stage.name(),
            "n_source_in": record.n_source.0,
            "n_source_out": record.n_source.1,
            "n_target_in": record.n_target.0,
            "n_target_out": record.n_target.1,
            "seconds": record.seconds,
        })?;
    }
    let uncertainty = found.uncertainty.as_ref();
    Ok(dict! { py,
        "transformation": from_pose(py, found.target_from_source),
        "pivot_transformation": from_pose(py, found.about_pivots),
        "source_pivot": from_vec(py, found.source_pivot.to_vec()),
        "target_pivot": from_vec(py, found.target_pivot.to_vec()),
        "verdict": found.verdict.name(),
        "reasons": found.reasons,
        "fitness": found.fitness,
        "inlier_rmse": found.inlier_rmse_m,
        "inlier_rmse_back": found.inlier_rmse_back_m,
        "n_inliers": found.n_inliers,
        "overlap_of_source": found.overlap_of_source,
        "overlap_of_target": found.overlap_of_target,
        "inlier_share": found.inlier_share,
        "ambiguity_ratio": found.ambiguity_ratio,
        "least_ambiguity_ratio": found.least_ambiguity_ratio,
        "strength": found.strength.weakest,
        "weakest_direction": found.strength.words(),
        "lead_over_chance": found.lead_over_chance,
        "held_out_ratio": found.held_out_ratio,
        "misfit": found.misfit,
        "conflict_share": found.conflict_share,
        "net_share": found.net_share,
        "surface_offset": found.surface_offset_m,
        "most_surface_offset": found.most_surface_offset_m,
        "extent": found.extent_m,
        "ended_early": found.ended_early,
        "scale": found.target_from_source.scale,
        "scale_standard_error": uncertainty.and_then(|u| u.scale_standard_error),
        "registration_error": uncertainty.map(|u| u.registration_error_m),
        "covariance": uncertainty.map(|u| from_rows(py, &u.covariance.transpose().data.0)),
        "covariance_middle": uncertainty.map(|u| {
            let about = |axis: usize| u.middle[axis] + found.target_pivot[axis];
            from_vec(py, vec![about(0), about(1), about(2)])
        }),
        "candidates": candidates,
        "n_evaluations": found.n_evaluations,
        "history": from_vec(py, found.history),
        "icp_stop_reason": word(found.icp_stop),
        "n_icp_iterations": found.n_icp_iterations,
        "icp_history": from_vec(py, found.icp_history),
        "source_to_target": statistics(py, &found.source_to_target)?,
        "target_to_source": statistics(py, &found.target_to_source)?,
        "n_non_finite": found.n_non_finite,
        "outlier_radius": found.outlier_radius_m,
        "voxel_size": found.voxel_size_m,
        "max_distance": found.max_distance_m,
        "stages": stages,
        "config_json": found.config.to_json(),
    })
}

pub(super) fn statistics<'py>(
    py: Python<'py>,
    statistics: &DistanceStatistics,
) -> PyResult<Bound<'py, PyDict>> {
    Ok(dict! { py,
        "n_points": statistics.n_points,
        "mean": statistics.mean_m,
        "best": statistics.best_m,
        "worst": statistics.worst_m,
        "std": statistics.std_m,
        "rms": statistics.rms_m,
        "median": statistics.median_m,
        "percentile_95": statistics.percentile_95_m,
    })
}

/// One cloud from two, at a pose.
#[pyfunction]
pub(super) fn fuse<'py>(
    py: Python<'py>,
    source: ReadArray<'py>,
    target: ReadArray<'py>,
    transformation: ReadArray<'py>,
    options_json: &str,
) -> PyResult<Bound<'py, PyDict>> {
    let (source, target) = (points(&source)?, points(&target)?);
    let target_from_source = briefly(|| pose(&transformation))?;
    let options = briefly(|| Ok(options(options_json)?))?;
    let fused = with_progress(py, None, |progress| {
        pipeline::fuse_clouds(source, target, target_from_source, &options, progress)
            .map_err(as_argument)
    })?;
    briefly(|| {
        let origin: Vec<u8> = fused.origin.iter().map(|origin| *origin as u8).collect();
        Ok(dict! { py,
            "points": from_points(py, fused.points)?,
            "origin": from_vec(py, origin),
            "index": from_vec(py, fused.given_index),
            "fills_hole": from_vec(py, fused.fills_hole),
            "distance": from_vec(py, fused.distance_m),
            "hole_radius": fused.hole_radius_m,
            "n_filled_by_source": fused.n_filled_by_source,
            "n_filled_by_target": fused.n_filled_by_target,
            "area_filled_by_source": fused.area_filled_by_source_m2,
            "area_filled_by_target": fused.area_filled_by_target_m2,
            "n_repeated": fused.n_repeated,
        })
    })
}
