//! Distances at a pose, change with its level of detection, and what is made of them.

use pyo3::prelude::*;
use pyo3::types::PyDict;

use super::arrays::{
    ReadArray, ReadVector, dict, for_given_rows, from_points, from_vec, points, pose,
};
use super::config::options;
use super::errors::as_argument;
use super::registration::statistics;
use super::run::{briefly, with_progress};
use crate::cloud::{Cloud, Point};
use crate::evaluate::{CompareOptions, DistanceStatistics, compare};
use crate::m3c2::{M3c2Change, M3c2Options, M3c2Scales, m3c2 as change_along_normals};
use crate::neighbors::NeighborIndex;
use crate::similarity::Similarity;
use crate::voxel;

/// Distances between two clouds at a pose, one for each row given, and the spacings.
#[pyfunction]
pub(super) fn evaluate<'py>(
    py: Python<'py>,
    source: ReadArray<'py>,
    target: ReadArray<'py>,
    transformation: ReadArray<'py>,
    options_json: &str,
) -> PyResult<Bound<'py, PyDict>> {
    let (source, target) = (points(&source)?, points(&target)?);
    let target_from_source = briefly(|| pose(&transformation))?;
    let options: CompareOptions = briefly(|| Ok(options(options_json)?))?;
    let found = with_progress(py, None, |progress| {
        let of_source = Cloud::of_some_points("source cloud", source)?;
        let of_target = Cloud::of_some_points("target cloud", target)?;
        let (from, to) = (of_source.origin(), of_target.origin());
        let local = target_from_source.between_local_coordinates(from, to);
        let found = compare(&of_source, &of_target, local, &options, progress);
        let mut found = found.map_err(as_argument)?;
        for (given, direction) in [
            (source, &mut found.source_to_target),
            (target, &mut found.target_to_source),
        ] {
            let distances_m = std::mem::take(&mut direction.distances_m);
            direction.distances_m = for_given_rows(given, distances_m, f64::NAN);
        }
        Ok(found)
    })?;
    briefly(|| {
        let (forth, back) = (found.source_to_target, found.target_to_source);
        Ok(dict! { py,
            "source_to_target": from_vec(py, forth.distances_m),
            "target_to_source": from_vec(py, back.distances_m),
            "spacing_of_source": back.spacing_there_m,
            "spacing_of_target": forth.spacing_there_m,
            "wide_spacing": found.wide_spacing_m,
        })
    })
}

/// The change from target to source at each row of `cores` (target coordinates); without cores at
/// centroids of the target, in voxels as large as the cylinder's radius.
#[pyfunction]
pub(super) fn m3c2<'py>(
    py: Python<'py>,
    source: ReadArray<'py>,
    target: ReadArray<'py>,
    transformation: ReadArray<'py>,
    cores: Option<ReadArray<'py>>,
    options_json: &str,
) -> PyResult<Bound<'py, PyDict>> {
    let (source, target) = (points(&source)?, points(&target)?);
    let given_cores = cores.as_ref().map(points).transpose()?;
    let target_from_source = briefly(|| pose(&transformation))?;
    let options: M3c2Options = briefly(|| Ok(options(options_json)?))?;
    let (cores, changes, scales) = with_progress(py, None, |progress| {
        let source = Cloud::of_some_points("source cloud", source)?;
        let target = Cloud::of_some_points("target cloud", target)?;
        let (from, to) = (source.origin(), target.origin());
        let local: Similarity = target_from_source.between_local_coordinates(from, to);
        let moved: Vec<Point> = source.points().iter().map(|p| local.apply(p)).collect();
        let (reference, compared) = (
            NeighborIndex::new(target.points()),
            NeighborIndex::new(&moved),
        );
        let scales =
            M3c2Scales::derive(&reference, &compared, &options, progress).map_err(as_argument)?;
        let cores: Vec<Point> = match given_cores {
            Some(given) => given
                .iter()
                .map(|p| std::array::from_fn(|axis| p[axis] - to[axis]))
                .collect(),
            None => voxel::downsample(&target, scales.cylinder_radius_m, progress)?
                .cloud
                .points()
                .to_vec(),
        };
        let changes =
            change_along_normals(&cores, &reference, &compared, &scales, &options, progress)?;
        let given = |p: &Point| std::array::from_fn(|axis| p[axis] + to[axis]);
        let cores: Vec<Point> = cores.iter().map(given).collect();
        Ok((cores, changes, scales))
    })?;
    briefly(|| {
        let each = |f: fn(&M3c2Change) -> f64| from_vec(py, changes.iter().map(f).collect());
        let count = |f: fn(&M3c2Change) -> u32| from_vec(py, changes.iter().map(f).collect());
        Ok(dict! { py,
            "cores": from_points(py, cores)?,
            "normals": from_points(py, changes.iter().map(|c| c.normal).collect())?,
            "normal_radius": each(|c| c.normal_radius_m),
            "distance": each(|c| c.distance_m),
            "level_of_detection": each(|c| c.level_of_detection_m),
            "significant_from": each(|c| c.significant_from_m),
            "target_spread": each(|c| c.spread_m.0),
            "source_spread": each(|c| c.spread_m.1),
            "n_target": count(|c| c.n_points.0),
            "n_source": count(|c| c.n_points.1),
            "is_significant":
                from_vec(py, changes.iter().map(|c| c.is_significant).collect::<Vec<bool>>()),
            "normal_radii": scales.normal_radii_m,
            "cylinder_radius": scales.cylinder_radius_m,
            "max_depth": scales.max_depth_m,
            "min_points": options.min_points,
        })
    })
}

/// Distances summed up; nothing where there are none.
#[pyfunction]
pub(super) fn distance_statistics<'py>(
    py: Python<'py>,
    distances: ReadVector<'py>,
) -> PyResult<Option<Bound<'py, PyDict>>> {
    let distances_m = distances.as_slice()?;
    let found = with_progress(py, None, |_| {
        Ok(DistanceStatistics::from_distances(distances_m))
    })?;
    briefly(|| found.map(|found| statistics(py, &found)).transpose())
}
