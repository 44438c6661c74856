//! What a pose is free to do: the degrees of freedom of a registration.
//!
//! Why: a levelled scanner and a levelled model differ by a turn about the vertical and a shift
//! only, and a model without a scale bar differs by a scale as well. What is known need not be
//! searched for, and cannot come out wrong.

use nalgebra::SMatrix;
use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};

/// Which motions are looked for. In JSON and in Python the number of them: 4, 6 or 7.
///
/// ```
/// use tmchho::freedom::Freedom;
/// assert_eq!(Freedom::default(), Freedom::from_dof(6)?);
/// assert_eq!(Freedom::Levelled.dof(), 4);
/// assert!(Freedom::from_dof(5).unwrap_err().to_string().contains("4, 6 or 7"));
/// # Ok::<(), tmchho::Error>(())
/// ```
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "u8", into = "u8")]
pub enum Freedom {
    /// A turn about z and a shift: both clouds are levelled, z is up in both.
    Levelled,
    /// A turn about any axis and a shift.
    #[default]
    Rigid,
    /// A turn about any axis, a shift and a scale: one of the clouds has no known scale.
    Similarity,
}

impl Freedom {
    /// From the number of degrees of freedom.
    ///
    /// # Errors
    /// [`Error::InvalidArgument`] for any number but 4, 6 and 7.
    pub fn from_dof(dof: u8) -> Result<Self> {
        match dof {
            4 => Ok(Self::Levelled),
            6 => Ok(Self::Rigid),
            7 => Ok(Self::Similarity),
            _ => Err(Error::argument(
                "dof",
                format!(
                    "must be 4, 6 or 7 (levelled: yaw and shift; rigid; rigid with a scale), got \
                     {dof}"
                ),
            )),
        }
    }

    /// The number of degrees of freedom.
    pub fn dof(self) -> u8 {
        match self {
            Self::Levelled => 4,
            Self::Rigid => 6,
            Self::Similarity => 7,
        }
    }

    /// The parameters of a step that are free, of rotation about x, y, z, translation and growth.
    pub(crate) fn free(self) -> std::ops::Range<usize> {
        match self {
            Self::Levelled => 2..6,
            Self::Rigid => 0..6,
            Self::Similarity => 0..7,
        }
    }

    /// The inverse of the part of a symmetric matrix that is free, zeros in the rest; `None` where
    /// there is no inverse.
    pub(crate) fn inverse_of_free(self, matrix: &SMatrix<f64, 7, 7>) -> Option<SMatrix<f64, 7, 7>> {
        let is_free = |i: usize| self.free().contains(&i);
        let filled =
            SMatrix::<f64, 7, 7>::from_fn(|r, c| match (is_free(r) && is_free(c), r == c) {
                (true, _) => matrix[(r, c)],
                (false, diagonal) => f64::from(u8::from(diagonal)),
            });
        let inverse = filled.cholesky()?.inverse();
        Some(SMatrix::from_fn(|r, c| {
            if is_free(r) && is_free(c) {
                inverse[(r, c)]
            } else {
                0.0
            }
        }))
    }
}

impl TryFrom<u8> for Freedom {
    type Error = Error;

    fn try_from(dof: u8) -> Result<Self> {
        Self::from_dof(dof)
    }
}

impl From<Freedom> for u8 {
    fn from(freedom: Freedom) -> Self {
        freedom.dof()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_a_number_in_json() {
        for (freedom, text) in [
            (Freedom::Levelled, "4"),
            (Freedom::Rigid, "6"),
            (Freedom::Similarity, "7"),
        ] {
            assert_eq!(serde_json::to_string(&freedom).unwrap(), text);
            assert_eq!(serde_json::from_str::<Freedom>(text).unwrap(), freedom);
        }
        let refused = serde_json::from_str::<Freedom>("5").unwrap_err();
        assert!(refused.to_string().contains("4, 6 or 7"), "{refused}");
    }
}
