//! Single stages on arrays, for those who build a route of their own.
//!
//! Where a result has a value for each row, rows with a coordinate that is not finite get NaN. Where
//! it has not, such rows are left out and counted, or the package has refused them.

use pyo3::prelude::*;
use pyo3::types::PyDict;

use super::arrays::{
    ReadArray, dict, for_given_rows, from_points, from_pose, from_rows, from_vec, points, pose,
    rigid_pose,
};
use super::config::{options, word};
use super::errors::as_argument;
use super::run::{briefly, with_progress};
use crate::cloud::{Cloud, Point};
use crate::error::{Error, Result};
use crate::freedom::Freedom;
use crate::icp::{self as fine, IcpMethod, IcpOptions};
use crate::keypoints::{self, IssOptions};
use crate::neighbors::NeighborIndex;
use crate::normals::{self, Surface};
use crate::observations::Observations;
use crate::outlier::{self, OutlierOptions};
use crate::rigid::Rigid;
use crate::surface_cloud::N_NORMAL_NEIGHBORS;
use crate::voxel::{self, VoxelOptions};
use crate::{evaluate, fitness, kabsch as closed_form, spacing};

/// Indices of the points that have enough neighbours.
#[pyfunction]
pub(super) fn remove_outliers<'py>(
    py: Python<'py>,
    array: ReadArray<'py>,
    options_json: &str,
) -> PyResult<Bound<'py, PyDict>> {
    let given = points(&array)?;
    let options: OutlierOptions = briefly(|| Ok(options(options_json)?))?;
    let (kept, radius_m, n_non_finite) = with_progress(py, None, |progress| {
        let cloud = Cloud::of_any_shape("cloud", given)?;
        let index = NeighborIndex::new(cloud.points());
        let cleaned =
            outlier::remove_outliers(&cloud, &index, &options, progress).map_err(as_argument)?;
        let kept = given_indices(&cloud, &cleaned.kept);
        Ok((kept, cleaned.radius_m, cloud.n_non_finite()))
    })?;
    briefly(|| {
        Ok(dict! { py,
            "indices": from_vec(py, kept),
            "radius": radius_m,
            "n_non_finite": n_non_finite,
        })
    })
}

/// One centroid per occupied voxel.
#[pyfunction]
pub(super) fn voxel_downsample<'py>(
    py: Python<'py>,
    array: ReadArray<'py>,
    voxel_size: f64,
) -> PyResult<Bound<'py, PyDict>> {
    let given = points(&array)?;
    let (centroids, counts, n_non_finite) = with_progress(py, None, |progress| {
        let cloud = Cloud::of_any_shape("cloud", given)?;
        let options = VoxelOptions {
            voxel_size_m: Some(voxel_size),
        };
        options.check().map_err(as_argument)?;
        let thinned = voxel::downsample(&cloud, voxel_size, progress)?;
        let centroids = thinned.cloud.to_given_coordinates();
        Ok((centroids, thinned.n_points, cloud.n_non_finite()))
    })?;
    briefly(|| {
        Ok(dict! { py,
            "points": from_points(py, centroids)?,
            "counts": from_vec(py, counts),
            "n_non_finite": n_non_finite,
        })
    })
}

/// Indices of the ISS keypoints; the options must name a radius.
#[pyfunction]
pub(super) fn iss_keypoints<'py>(
    py: Python<'py>,
    array: ReadArray<'py>,
    options_json: &str,
) -> PyResult<Bound<'py, PyAny>> {
    let given = points(&array)?;
    let options: IssOptions = briefly(|| Ok(options(options_json)?))?;
    let found = with_progress(py, None, |progress| {
        let cloud = Cloud::of_any_shape("cloud", given)?;
        let index = NeighborIndex::new(cloud.points());
        let found =
            keypoints::detect(&cloud, &index, &options, f64::NAN, progress).map_err(as_argument)?;
        Ok(given_indices(&cloud, &found.indices))
    })?;
    briefly(|| Ok(from_vec(py, found)))
}

/// Normals (n, 3) and curvatures (n,).
#[pyfunction]
pub(super) fn estimate_normals<'py>(
    py: Python<'py>,
    array: ReadArray<'py>,
    n_neighbors: Option<usize>,
) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyAny>)> {
    let given = points(&array)?;
    let surfaces = with_progress(py, None, |progress| {
        let cloud = Cloud::of_any_shape("cloud", given)?;
        let index = NeighborIndex::new(cloud.points());
        let n_neighbors = n_neighbors.unwrap_or(N_NORMAL_NEIGHBORS);
        let surfaces = normals::estimate(index.points(), &index, n_neighbors, progress)
            .map_err(as_argument)?;
        let unknown = Surface {
            normal: [f64::NAN; 3],
            curvature: f64::NAN,
            roughness_m: f64::NAN,
        };
        Ok(for_given_rows(given, surfaces, unknown))
    })?;
    briefly(|| {
        let normals = surfaces.iter().map(|surface| surface.normal).collect();
        let curvatures = surfaces.iter().map(|surface| surface.curvature).collect();
        Ok((from_points(py, normals)?, from_vec(py, curvatures)))
    })
}

/// Brings `source` onto `target` from the pose `start`.
#[pyfunction]
pub(super) fn icp<'py>(
    py: Python<'py>,
    source: ReadArray<'py>,
    target: ReadArray<'py>,
    start: ReadArray<'py>,
    dof: u8,
    observations_json: &str,
    options_json: &str,
) -> PyResult<Bound<'py, PyDict>> {
    let (source, target) = (points(&source)?, points(&target)?);
    let start = briefly(|| pose(&start))?;
    let freedom = briefly(|| Ok(Freedom::from_dof(dof)?))?;
    let observations: Observations = briefly(|| Ok(options(observations_json)?))?;
    let options: IcpOptions = briefly(|| Ok(options(options_json)?))?;
    let found = with_progress(py, None, |progress| {
        let (source, target) = both(source, target)?;
        let known = observations.about(source.origin(), target.origin())?;
        let index = NeighborIndex::new(target.points());
        let (mut source_surfaces, mut target_surfaces) = (Vec::new(), Vec::new());
        let (k, method) = (
            N_NORMAL_NEIGHBORS,
            options.method.unwrap_or(IcpMethod::PointToPoint),
        );
        if method != IcpMethod::PointToPoint {
            target_surfaces = normals::estimate(index.points(), &index, k, progress)?;
        }
        if method == IcpMethod::PlaneToPlane {
            let of_source = NeighborIndex::new(source.points());
            source_surfaces = normals::estimate(of_source.points(), &of_source, k, progress)?;
        }
        let clouds = fine::Clouds {
            source: source.points(),
            source_surfaces: &source_surfaces,
            target: &index,
            target_surfaces: &target_surfaces,
        };
        let start = start.between_local_coordinates(source.origin(), target.origin());
        let mut found =
            fine::icp(&clouds, &start, freedom, &known, &options, progress).map_err(as_argument)?;
        let pose = found.target_from_source;
        found.target_from_source = pose.between_given_coordinates(source.origin(), target.origin());
        if let Some(uncertainty) = &mut found.uncertainty {
            let origin = target.origin();
            (0..3).for_each(|axis| uncertainty.middle[axis] += origin[axis]);
        }
        Ok(found)
    })?;
    briefly(|| {
        let uncertainty = found.uncertainty.as_ref();
        let covariance = uncertainty.map(|u| from_rows(py, &u.covariance.transpose().data.0));
        Ok(dict! { py,
            "transformation": from_rows(py, &found.target_from_source.to_matrix4()),
            "scale": found.target_from_source.scale,
            "stop_reason": word(found.stop_reason),
            "n_iterations": found.n_iterations,
            "n_inliers": found.n_inliers,
            "inlier_rmse": found.inlier_rmse_m,
            "history": from_vec(py, found.history),
            "registration_error": uncertainty.map(|u| u.registration_error_m),
            "scale_standard_error": uncertainty.and_then(|u| u.scale_standard_error),
            "covariance": covariance,
            "middle": uncertainty.map(|u| from_vec(py, u.middle.to_vec())),
        })
    })
}

/// The best pose of paired points, in closed form.
#[pyfunction]
pub(super) fn kabsch<'py>(
    py: Python<'py>,
    source: ReadArray<'py>,
    target: ReadArray<'py>,
) -> PyResult<Bound<'py, PyAny>> {
    let (source, target) = (points(&source)?, points(&target)?);
    let found = with_progress(py, None, |_| {
        if source.len() != target.len() {
            return Err(Error::argument(
                "target",
                format!(
                    "must have a row for each of the {} rows of source, got {}",
                    source.len(),
                    target.len()
                ),
            ));
        }
        let (source, target) = both(source, target)?;
        let local = closed_form::fit(source.points(), target.points());
        let given = |pose: Rigid| pose.between_given_coordinates(source.origin(), target.origin());
        local.map(given).ok_or_else(|| Error::TooFewPoints {
            what: "source cloud".into(),
            found: 0,
            needed: 1,
        })
    })?;
    briefly(|| Ok(from_pose(py, found)))
}

/// The RMS of Eq. (1) at the six parameters.
#[pyfunction]
pub(super) fn rms_fitness<'py>(
    py: Python<'py>,
    source: ReadArray<'py>,
    target: ReadArray<'py>,
    parameters: [f64; 6],
) -> PyResult<f64> {
    let (source, target) = (points(&source)?, points(&target)?);
    with_progress(py, None, |_| {
        let (source, target) = both(source, target)?;
        let pose = pose_of(parameters).between_local_coordinates(source.origin(), target.origin());
        let index = NeighborIndex::new(target.points());
        Ok(fitness::rms(source.points(), &index, &pose))
    })
}

/// From each row of `source` to the nearest of `target`.
#[pyfunction]
pub(super) fn nearest_distances<'py>(
    py: Python<'py>,
    source: ReadArray<'py>,
    target: ReadArray<'py>,
) -> PyResult<Bound<'py, PyAny>> {
    let (given, target) = (points(&source)?, points(&target)?);
    let distances = with_progress(py, None, |progress| {
        let (source, target) = both(given, target)?;
        let local = Rigid::identity().between_local_coordinates(source.origin(), target.origin());
        let places: Vec<Point> = source.points().iter().map(|p| local.apply(p)).collect();
        let index = NeighborIndex::new(target.points());
        let distances = evaluate::nearest_distances(&places, &index, progress)?;
        Ok(for_given_rows(given, distances, f64::NAN))
    })?;
    briefly(|| Ok(from_vec(py, distances)))
}

/// The median distance from a point to the nearest one elsewhere.
#[pyfunction]
pub(super) fn median_spacing<'py>(py: Python<'py>, array: ReadArray<'py>) -> PyResult<f64> {
    let given = points(&array)?;
    with_progress(py, None, |progress| {
        let cloud = Cloud::of_any_shape("cloud", given)?;
        spacing::median_spacing_m(&NeighborIndex::new(cloud.points()), progress)
    })
}

/// The (4, 4) matrix of Eq. (1).
#[pyfunction]
pub(super) fn euler_to_matrix(py: Python<'_>, parameters: [f64; 6]) -> PyResult<Bound<'_, PyAny>> {
    briefly(|| Ok(from_pose(py, pose_of(parameters))))
}

/// The six parameters of Eq. (1) of a (4, 4) matrix.
#[pyfunction]
pub(super) fn matrix_to_euler<'py>(
    py: Python<'py>,
    matrix: ReadArray<'py>,
) -> PyResult<Bound<'py, PyAny>> {
    briefly(|| {
        let pose = rigid_pose(&matrix)?;
        let [a, b, c] = pose.euler_rad();
        let t = pose.translation;
        Ok(from_vec(py, vec![a, b, c, t.x, t.y, t.z]))
    })
}

fn pose_of([a, b, c, x, y, z]: [f64; 6]) -> Rigid {
    Rigid::from_euler([a, b, c], [x, y, z])
}

fn both(source: &[Point], target: &[Point]) -> Result<(Cloud, Cloud)> {
    Ok((
        Cloud::of_any_shape("source cloud", source)?,
        Cloud::of_any_shape("target cloud", target)?,
    ))
}

fn given_indices(cloud: &Cloud, indices: &[u32]) -> Vec<u32> {
    let given = |i: &u32| cloud.given_index(*i as usize) as u32;
    indices.iter().map(given).collect()
}
