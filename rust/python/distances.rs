//! What is made of distances, and the spacing that limits them.

use pyo3::prelude::*;
use pyo3::types::PyDict;

use super::arrays::{ReadArray, ReadVector, points};
use super::registration::statistics;
use super::run::{briefly, with_progress};
use crate::cloud::Cloud;
use crate::evaluate::DistanceStatistics;
use crate::neighbors::NeighborIndex;
use crate::spacing;

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

/// The distance from a point to the nearest one elsewhere that the share `quantile` of points keep
/// to.
#[pyfunction]
pub(super) fn spacing_quantile<'py>(
    py: Python<'py>,
    array: ReadArray<'py>,
    quantile: f64,
) -> PyResult<f64> {
    let given = points(&array)?;
    with_progress(py, None, |_| {
        let cloud = Cloud::of_any_shape("cloud", given)?;
        let index = NeighborIndex::new(cloud.points());
        Ok(spacing::nearest_spacing_quantile_m(&index, quantile))
    })
}
