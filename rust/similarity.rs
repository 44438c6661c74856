//! The rigid transform with a scale.
//!
//! Source: Umeyama (1991), Eq. (1). Deviates: nowhere.

use std::ops::Mul;

use nalgebra::Matrix3;

use crate::cloud::Point;
use crate::error::{Error, Result};
use crate::rigid::Rigid;

/// A length of 1 comes out of a rotation with an error of a few roundings; that is no scale.
const ROUNDING: f64 = 1e-12;
/// How far the rotation of a matrix that somebody wrote may be from orthonormal.
const MAX_SHEAR: f64 = 1e-6;

/// q = R·(s·p) + t. Named by its direction, as [`Rigid`] is.
///
/// ```
/// use tmchho::{Rigid, similarity::Similarity};
/// let pose = Similarity { scale: 2.0, rigid: Rigid::from_euler([0.0; 3], [1.0, 0.0, 0.0]) };
/// assert_eq!(pose.apply(&[3.0, 4.0, 0.0]), [7.0, 8.0, 0.0]);
/// assert_eq!(pose.inverse().apply(&[7.0, 8.0, 0.0]), [3.0, 4.0, 0.0]);
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Similarity {
    /// Length in the target of what is one unit long in the source; above 0.
    pub scale: f64,
    /// The rotation and the translation.
    pub rigid: Rigid,
}

impl Similarity {
    /// Leaves every point where it is.
    pub fn identity() -> Self {
        Rigid::identity().into()
    }

    /// Moves a point.
    #[inline]
    pub fn apply(&self, p: &Point) -> Point {
        self.rigid.apply(&p.map(|v| self.scale * v))
    }

    /// The transform back.
    pub fn inverse(&self) -> Self {
        let back = self.rigid.inverse();
        Self {
            scale: 1.0 / self.scale,
            rigid: Rigid {
                rotation: back.rotation,
                translation: back.translation / self.scale,
            },
        }
    }

    /// Reads a 4×4 matrix. That of a rigid transform has the scale 1, exactly.
    ///
    /// # Errors
    /// [`Error::InvalidArgument`] unless the matrix is finite, its last row is 0 0 0 1 and its 3×3
    /// part is a rotation times a scale: orthogonal to 1e-6 of it, determinant above 0.
    ///
    /// ```
    /// use tmchho::similarity::Similarity;
    /// let mut matrix = [[0.0, -2.0, 0.0, 5.0], [2.0, 0.0, 0.0, 6.0], [0.0, 0.0, 2.0, 7.0], [0.0; 4]];
    /// matrix[3][3] = 1.0;
    /// let pose = Similarity::from_matrix4(&matrix)?;
    /// assert_eq!(pose.apply(&[1.0, 0.0, 0.0]), [5.0, 8.0, 7.0]);
    /// matrix[2][2] = 1.0;
    /// assert!(Similarity::from_matrix4(&matrix).unwrap_err().to_string().contains("one scale"));
    /// # Ok::<(), tmchho::Error>(())
    /// ```
    pub fn from_matrix4(matrix: &[[f64; 4]; 4]) -> Result<Self> {
        let part = Matrix3::from_fn(|row, column| matrix[row][column]);
        let length = part.norm() / 3_f64.sqrt();
        let scale = if (length - 1.0).abs() < ROUNDING {
            1.0
        } else {
            length
        };
        let rotation = part / scale;
        let shear = (rotation * rotation.transpose() - Matrix3::identity()).amax();
        let is_finite = matrix.iter().flatten().all(|v| v.is_finite());
        // NaN is what becomes of a matrix of zeros.
        if is_finite && (shear.is_nan() || shear > MAX_SHEAR) {
            return Err(Error::argument(
                "the 4×4 transformation",
                "must hold a rotation and one scale: its 3×3 part shears, flattens, or stretches one \
                 axis more than another",
            ));
        }
        let mut unscaled = *matrix;
        for row in unscaled.iter_mut().take(3) {
            row.iter_mut().take(3).for_each(|v| *v /= scale);
        }
        Rigid::from_matrix4(&unscaled).map(|rigid| Self { scale, rigid })
    }

    /// The 4×4 matrix, row by row; its 3×3 part is s·R.
    pub fn to_matrix4(&self) -> [[f64; 4]; 4] {
        let mut matrix = self.rigid.to_matrix4();
        for row in matrix.iter_mut().take(3) {
            row.iter_mut().take(3).for_each(|v| *v *= self.scale);
        }
        matrix
    }

    /// The same motion between frames whose origins lie elsewhere: takes a pose between local
    /// coordinates (about the two origins) to the pose between the coordinates given.
    pub fn between_given_coordinates(&self, source_origin: Point, target_origin: Point) -> Self {
        let scaled = source_origin.map(|v| self.scale * v);
        Self {
            scale: self.scale,
            rigid: self.rigid.between_given_coordinates(scaled, target_origin),
        }
    }

    /// The inverse of [`Similarity::between_given_coordinates`].
    pub fn between_local_coordinates(&self, source_origin: Point, target_origin: Point) -> Self {
        let scaled = source_origin.map(|v| self.scale * v);
        Self {
            scale: self.scale,
            rigid: self.rigid.between_local_coordinates(scaled, target_origin),
        }
    }
}

/// Whether a scale, by the one that a refinement began with, is more than it may bridge: a cloud that shrinks to nothing finds
/// partners for all of it, step by step.
pub(crate) fn has_run_away(scale: f64) -> bool {
    // Also true for NaN.
    !(0.8..=1.25).contains(&scale)
}

impl From<Rigid> for Similarity {
    fn from(rigid: Rigid) -> Self {
        Self { scale: 1.0, rigid }
    }
}

impl From<&Rigid> for Similarity {
    fn from(rigid: &Rigid) -> Self {
        (*rigid).into()
    }
}

impl From<&Similarity> for Similarity {
    fn from(pose: &Similarity) -> Self {
        *pose
    }
}

impl Mul for Similarity {
    type Output = Self;

    /// First `other`, then `self`.
    fn mul(self, other: Self) -> Self {
        let moved = self.rigid.rotation * (self.scale * other.rigid.translation);
        Self {
            scale: self.scale * other.scale,
            rigid: Rigid {
                rotation: self.rigid.rotation * other.rigid.rotation,
                translation: moved + self.rigid.translation,
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pose(scale: f64, angle_rad: f64) -> Similarity {
        Similarity {
            scale,
            rigid: Rigid::from_euler([angle_rad, -0.3, 1.0], [5.0, -2.0, angle_rad]),
        }
    }

    fn assert_same(a: &Point, b: &Point) {
        for axis in 0..3 {
            assert!((a[axis] - b[axis]).abs() < 1e-12, "{a:?} {b:?}");
        }
    }

    #[test]
    fn products_inverses_and_matrices_do_to_a_point_what_their_parts_do() {
        let (first, second, p) = (pose(0.5, 0.2), pose(3.0, -1.1), [0.3, -4.0, 7.0]);
        let there = first.apply(&p);
        assert_same(&(second * first).apply(&p), &second.apply(&there));
        assert_same(&first.inverse().apply(&there), &p);
        assert_same(&(first.inverse() * first).apply(&p), &p);
        let m = second.to_matrix4();
        let by_matrix =
            [0, 1, 2].map(|r| m[r][0] * p[0] + m[r][1] * p[1] + m[r][2] * p[2] + m[r][3]);
        assert_same(&by_matrix, &second.apply(&p));
        assert_eq!(m[3], [0.0, 0.0, 0.0, 1.0]);
    }

    #[test]
    fn a_matrix_is_read_as_what_wrote_it() {
        for scale in [1e-3, 0.3048, 1.0, 1.0 + 1e-7, 1000.0] {
            let (wrote, p) = (pose(scale, 0.7), [0.3, -4.0, 7.0]);
            let read = Similarity::from_matrix4(&wrote.to_matrix4()).unwrap();
            assert!((read.scale / scale - 1.0).abs() < 1e-14);
            let (wanted, got) = (wrote.apply(&p), read.apply(&p));
            assert!((0..3).all(|axis| (got[axis] - wanted[axis]).abs() < 1e-11 * scale.max(1.0)));
        }
        let rigid = Rigid::from_euler([0.1, 0.2, 0.3], [1.0, 2.0, 3.0]);
        let read = Similarity::from_matrix4(&rigid.to_matrix4()).unwrap();
        assert_eq!(read, rigid.into());
    }

    #[test]
    fn a_matrix_that_is_no_similarity_is_refused() {
        let refused = |change: &dyn Fn(&mut [[f64; 4]; 4])| {
            let mut matrix = pose(2.0, 0.4).to_matrix4();
            change(&mut matrix);
            Similarity::from_matrix4(&matrix).unwrap_err().to_string()
        };
        assert!(refused(&|m| m[0][1] += 1e-3).contains("one scale"));
        assert!(
            refused(&|m| m.iter_mut().take(3).for_each(|r| *r = [0.0; 4])).contains("one scale")
        );
        assert!(refused(&|m| m[1].iter_mut().for_each(|v| *v = -*v)).contains("mirrors"));
        assert!(refused(&|m| m[3][0] = 0.1).contains("0 0 0 1"));
        assert!(refused(&|m| m[2][2] = f64::NAN).contains("finite"));
    }

    #[test]
    fn a_rigid_pose_is_one_of_scale_one() {
        let rigid = Rigid::from_euler([0.1, 0.2, 0.3], [1.0, 2.0, 3.0]);
        let p = [3.0, 2.0, -1.0];
        assert_eq!(Similarity::from(rigid).apply(&p), rigid.apply(&p));
        assert_eq!(Similarity::identity().apply(&p), p);
    }

    #[test]
    fn a_change_of_origins_and_back_is_the_same_pose() {
        let (local, s, t) = (pose(1.7, 0.4), [500_000.0, 4e6, 200.0], [-3.0, 7.0, 11.0]);
        let given = local.between_given_coordinates(s, t);
        let q = given.apply(&[s[0] + 1.0, s[1] + 2.0, s[2] + 3.0]);
        let wanted = local.apply(&[1.0, 2.0, 3.0]);
        for axis in 0..3 {
            assert!((q[axis] - t[axis] - wanted[axis]).abs() < 1e-8);
        }
        let again = given.between_local_coordinates(s, t);
        assert!((again.rigid.translation - local.rigid.translation).amax() < 1e-8);
    }
}
