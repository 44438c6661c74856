//! A function of Table 1 to be minimised: of so many coordinates, moved and turned if wanted.
//!
//! Why: all seven functions have their minimum at the origin and most treat each coordinate alone. A
//! method that is drawn to the origin, or that works along the axes, looks better there than it is.
//! Source: f(R (x − s)), as in the test suites of the CEC competitions; R is uniformly distributed
//! among the orthogonal matrices (Stewart 1980).

use crate::error::{Error, Result};
use crate::random::Stream;

use super::test_functions::{self, TestFunction};
use super::{Bounds, Objective};

/// f(R (x − s)) with one of the seven functions.
///
/// ```
/// use tmchho::optim::{Objective, Problem};
/// let problem = Problem::new("f1", 2)?.shifted(vec![3.0, -1.0])?;
/// assert_eq!(problem.evaluate(&[3.0, 1.0]), 4.0);
/// let turned = problem.rotated(7);
/// assert!((turned.evaluate(&[3.0, 1.0]) - 4.0).abs() < 1e-14); // a sphere stays a sphere
/// # Ok::<(), tmchho::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct Problem {
    function: &'static TestFunction,
    dimension: usize,
    shift: Option<Vec<f64>>,
    /// R, row by row.
    rotation: Option<Vec<Vec<f64>>>,
}

impl Problem {
    /// The function called `name` in the paper, of `dimension` coordinates.
    ///
    /// # Errors
    /// [`Error::InvalidArgument`] for an unknown name or no coordinate.
    pub fn new(name: &str, dimension: usize) -> Result<Self> {
        let function = test_functions::by_name(name)?;
        function.bounds(dimension)?;
        Ok(Self {
            function,
            dimension,
            shift: None,
            rotation: None,
        })
    }

    /// The same with the minimum at `place` instead.
    ///
    /// # Errors
    /// [`Error::InvalidArgument`] for another number of coordinates, or one that is not finite.
    pub fn shifted(self, place: Vec<f64>) -> Result<Self> {
        if place.len() != self.dimension || !place.iter().all(|x| x.is_finite()) {
            return Err(Error::argument(
                "shift",
                format!(
                    "must have {} finite coordinates, got {place:?}",
                    self.dimension
                ),
            ));
        }
        Ok(Self {
            shift: Some(place),
            ..self
        })
    }

    /// The same, turned about its minimum by the rotation (or reflection) of `seed`.
    pub fn rotated(self, seed: u64) -> Self {
        Self {
            rotation: Some(random_rotation(self.dimension, seed)),
            ..self
        }
    }

    /// Number of coordinates.
    pub fn dimension(&self) -> usize {
        self.dimension
    }

    /// The function's box, which neither shift nor rotation moves.
    ///
    /// # Errors
    /// None: it was made with at least one coordinate.
    pub fn bounds(&self) -> Result<Bounds> {
        self.function.bounds(self.dimension)
    }
}

impl Objective for Problem {
    fn evaluate(&self, x: &[f64]) -> f64 {
        if self.shift.is_none() && self.rotation.is_none() {
            return (self.function.evaluate)(x);
        }
        let mut moved = x.to_vec();
        if let Some(shift) = &self.shift {
            for (x, shift) in moved.iter_mut().zip(shift) {
                *x -= shift;
            }
        }
        if let Some(rotation) = &self.rotation {
            moved = rotation.iter().map(|row| dot(row, &moved)).collect();
        }
        (self.function.evaluate)(&moved)
    }
}

/// An orthogonal matrix, row by row: normal deviates, made orthonormal one after another.
fn random_rotation(dimension: usize, seed: u64) -> Vec<Vec<f64>> {
    let mut stream = Stream::new(seed, "rotation of a test function", 0);
    let mut rows: Vec<Vec<f64>> = Vec::with_capacity(dimension);
    while rows.len() < dimension {
        let mut row: Vec<f64> = (0..dimension).map(|_| stream.normal()).collect();
        let before = dot(&row, &row);
        // Once more, because the first time leaves rounding errors.
        for _ in 0..2 {
            for earlier in &rows {
                let along = dot(&row, earlier);
                for (x, e) in row.iter_mut().zip(earlier) {
                    *x -= along * e;
                }
            }
        }
        let length = dot(&row, &row);
        // A row that lies all but in the span of the others would be noise: another is drawn.
        if length > 1e-20 * before {
            let length = length.sqrt();
            row.iter_mut().for_each(|x| *x /= length);
            rows.push(row);
        }
    }
    rows
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rotation_keeps_lengths_and_angles_and_mixes_coordinates() {
        for dimension in [1, 2, 10, 50] {
            let rows = random_rotation(dimension, 3);
            for (i, a) in rows.iter().enumerate() {
                for (j, b) in rows.iter().enumerate() {
                    let expected = f64::from(u8::from(i == j));
                    assert!((dot(a, b) - expected).abs() < 1e-13);
                }
            }
        }
        let rows = random_rotation(10, 3);
        assert!(rows.iter().flatten().all(|x| x.abs() < 0.95));
        assert_ne!(rows, random_rotation(10, 4));
    }

    #[test]
    fn the_minimum_is_where_it_was_put() {
        for f in &test_functions::ALL {
            let place: Vec<f64> = (0..6).map(|i| 0.1 * f.range * f64::from(i - 3)).collect();
            let problem = Problem::new(f.name, 6).unwrap();
            let moved = problem.clone().shifted(place.clone()).unwrap();
            let both = moved.clone().rotated(1);
            for problem in [&moved, &both] {
                assert!(problem.evaluate(&place).abs() < 1e-14, "{}", f.name);
                assert!(problem.evaluate(&[0.0; 6]) > 0.1, "{}", f.name);
                assert!(problem.bounds().unwrap().contains(&place));
            }
            let x = [0.5, -0.25, 1.0, 0.0, -1.5, 2.0];
            let there: Vec<f64> = x.iter().zip(&place).map(|(x, p)| x + p).collect();
            let (plain, moved) = (problem.evaluate(&x), moved.evaluate(&there));
            assert!((plain - moved).abs() <= 1e-11 * plain, "{}", f.name);
        }
        assert!(Problem::new("f1", 0).is_err() && Problem::new("f8", 2).is_err());
        let f1 = || Problem::new("f1", 2).unwrap();
        assert!(f1().shifted(vec![1.0]).is_err() && f1().shifted(vec![1.0, f64::NAN]).is_err());
    }
}
