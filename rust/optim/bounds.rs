//! The checked box [low, high]^D in which a minimum is sought.

use crate::error::{Error, Result};

/// A box: one finite interval per coordinate.
///
/// ```
/// use tmchho::optim::Bounds;
/// let bounds = Bounds::new(vec![-1.0, 0.0], vec![1.0, 10.0])?;
/// let mut x = [-3.0, 4.0];
/// bounds.clip(&mut x);
/// assert_eq!(x, [-1.0, 4.0]);
/// assert!(Bounds::new(vec![1.0], vec![-1.0]).is_err());
/// # Ok::<(), tmchho::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Bounds {
    low: Vec<f64>,
    high: Vec<f64>,
}

impl Bounds {
    /// The box from `low` to `high`; a coordinate whose two ends are equal is held fixed.
    ///
    /// # Errors
    /// [`Error::InvalidArgument`] for no coordinate at all, ends of different number, an end or a
    /// width that is not finite, or a low end above its high end.
    pub fn new(low: Vec<f64>, high: Vec<f64>) -> Result<Self> {
        if low.is_empty() || low.len() != high.len() {
            return Err(Error::argument(
                "bounds",
                format!(
                    "must have as many low ends as high ends, and at least one, got {} and {}",
                    low.len(),
                    high.len()
                ),
            ));
        }
        for (coordinate, (low, high)) in low.iter().zip(&high).enumerate() {
            // An end that is not finite gives a width that is not finite.
            if !(low <= high && (high - low).is_finite()) {
                return Err(Error::argument(
                    "bounds",
                    format!(
                        "must be finite with low <= high, got [{low}, {high}] for coordinate \
                         {coordinate}"
                    ),
                ));
            }
        }
        Ok(Self { low, high })
    }

    /// The same interval for each of `dimension` coordinates.
    ///
    /// # Errors
    /// As [`Bounds::new`].
    pub fn cube(dimension: usize, low: f64, high: f64) -> Result<Self> {
        Self::new(vec![low; dimension], vec![high; dimension])
    }

    /// Number of coordinates, D.
    pub fn dimension(&self) -> usize {
        self.low.len()
    }

    /// The low ends.
    pub fn low(&self) -> &[f64] {
        &self.low
    }

    /// The high ends.
    pub fn high(&self) -> &[f64] {
        &self.high
    }

    /// Whether `x` has the right number of coordinates and none is outside.
    pub fn contains(&self, x: &[f64]) -> bool {
        x.len() == self.dimension()
            && (x.iter().zip(&self.low).zip(&self.high))
                .all(|((x, low), high)| low <= x && x <= high)
    }

    /// Moves every coordinate that is outside to the nearest end, and one that is not a number to
    /// the low end: whatever a move produced, the result is inside.
    pub fn clip(&self, x: &mut [f64]) {
        for ((x, low), high) in x.iter_mut().zip(&self.low).zip(&self.high) {
            *x = x.max(*low).min(*high);
        }
    }

    /// The point that lies at the next D of `fractions` of the way, 0 being the low end and 1 the
    /// high end.
    pub(crate) fn at(&self, fractions: impl Iterator<Item = f64>) -> Vec<f64> {
        let mut x: Vec<f64> = (self.low.iter().zip(&self.high).zip(fractions))
            .map(|((low, high), fraction)| low + (high - low) * fraction)
            .collect();
        // Rounding may carry a point over the high end.
        self.clip(&mut x);
        x
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn whatever_is_clipped_is_inside() {
        let bounds = Bounds::new(vec![-1.0, 2.0, 5.0], vec![1.0, 3.0, 5.0]).unwrap();
        let mut x = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY];
        assert!(!bounds.contains(&x));
        bounds.clip(&mut x);
        assert_eq!(x, [-1.0, 3.0, 5.0]);
        assert!(bounds.contains(&x) && !bounds.contains(&x[..2]));
        let mut x = [0.25, 2.5, 5.0];
        bounds.clip(&mut x);
        assert_eq!(x, [0.25, 2.5, 5.0]);
    }

    #[test]
    fn fractions_are_carried_into_the_box() {
        let bounds = Bounds::new(vec![-1.0, 10.0], vec![1.0, 20.0]).unwrap();
        let mut fractions = [0.25, 0.5, 0.75].into_iter();
        assert_eq!(bounds.at(&mut fractions), [-0.5, 15.0]);
        assert_eq!(fractions.next(), Some(0.75), "only D fractions are taken");
    }

    #[test]
    fn a_box_that_is_none_is_refused() {
        let refused = |low: &[f64], high: &[f64]| {
            let error = Bounds::new(low.to_vec(), high.to_vec()).unwrap_err();
            assert!(
                matches!(&error, Error::InvalidArgument { name, .. } if name == "bounds"),
                "{error}"
            );
        };
        refused(&[], &[]);
        refused(&[0.0], &[1.0, 2.0]);
        refused(&[1.0], &[0.0]);
        refused(&[f64::NAN], &[0.0]);
        refused(&[0.0], &[f64::INFINITY]);
        refused(&[-f64::MAX], &[f64::MAX]);
        assert!(Bounds::cube(3, 1.0, 1.0).is_ok());
    }
}
