//! Arrays in and out, without copies where that is possible.
//!
//! The package hands over (n, 3) float64 C-contiguous arrays and nothing else, so that a wrong shape
//! can be explained where the names of files and arguments are known.

use numpy::{
    PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2, PyUntypedArrayMethods,
};
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;

use crate::cloud::Point;
use crate::error::Error;
use crate::rigid::Rigid;
use crate::similarity::Similarity;

/// An array that is read only while the function runs.
pub(super) type ReadArray<'py> = PyReadonlyArray2<'py, f64>;
/// A vector that is read only while the function runs.
pub(super) type ReadVector<'py> = PyReadonlyArray1<'py, f64>;

/// The points of an (n, 3) array, in place.
pub(super) fn points<'a>(array: &'a ReadArray<'_>) -> PyResult<&'a [Point]> {
    rows(array)
}

/// The pose of a (4, 4) array, with a scale or without.
pub(super) fn pose(array: &ReadArray<'_>) -> PyResult<Similarity> {
    Ok(Similarity::from_matrix4(matrix4(array)?)?)
}

/// The pose of a (4, 4) array, which must have no scale.
pub(super) fn rigid_pose(array: &ReadArray<'_>) -> PyResult<Rigid> {
    Ok(Rigid::from_matrix4(matrix4(array)?)?)
}

fn matrix4<'a>(array: &'a ReadArray<'_>) -> PyResult<&'a [[f64; 4]; 4]> {
    let rows: &[[f64; 4]] = rows(array)?;
    let matrix = rows.try_into().map_err(|_| {
        Error::argument(
            "the 4×4 transformation",
            format!("has {} rows of four numbers", rows.len()),
        )
    })?;
    Ok(matrix)
}

fn rows<'a, const N: usize>(array: &'a ReadArray<'_>) -> PyResult<&'a [[f64; N]]> {
    // A slice is given of columns one after another, too.
    if array.shape()[1] != N || !array.is_c_contiguous() {
        let problem = format!("the core takes C-contiguous arrays of shape (n, {N})");
        return Err(PyTypeError::new_err(problem));
    }
    Ok(array.as_slice()?.as_chunks().0)
}

/// An (n, 3) array.
pub(super) fn from_points(py: Python<'_>, points: Vec<Point>) -> PyResult<Bound<'_, PyAny>> {
    let n_points = points.len();
    let array = PyArray1::from_vec(py, points.into_flattened()).reshape([n_points, 3])?;
    Ok(array.into_any())
}

/// A (4, 4) array.
pub(super) fn from_pose<'py>(py: Python<'py>, pose: impl Into<Similarity>) -> Bound<'py, PyAny> {
    from_rows(py, &pose.into().to_matrix4())
}

/// An array of two dimensions.
pub(super) fn from_rows<'py, const N: usize>(
    py: Python<'py>,
    rows: &[[f64; N]],
) -> Bound<'py, PyAny> {
    PyArray2::from_owned_array(py, numpy::ndarray::arr2(rows)).into_any()
}

/// An array of one dimension.
pub(super) fn from_vec<T: numpy::Element>(py: Python<'_>, values: Vec<T>) -> Bound<'_, PyAny> {
    PyArray1::from_vec(py, values).into_any()
}

/// One value for each of the rows given: those of the finite points in their order, and `nothing`
/// where a coordinate is not finite.
pub(super) fn for_given_rows<T: Copy>(given: &[Point], values: Vec<T>, nothing: T) -> Vec<T> {
    let mut values = values.into_iter();
    let value_of = |p: &Point| {
        let is_finite = p.iter().all(|v| v.is_finite());
        is_finite
            .then(|| values.next())
            .flatten()
            .unwrap_or(nothing)
    };
    given.iter().map(value_of).collect()
}

/// A dictionary from names to values of all kinds.
macro_rules! dict {
    ($py:expr, $($name:literal: $value:expr),+ $(,)?) => {{
        let dict = pyo3::types::PyDict::new($py);
        $(dict.set_item($name, $value)?;)+
        dict
    }};
}
pub(super) use dict;
