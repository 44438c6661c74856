//! The rigid transform with a scale.
//!
//! Source: Umeyama (1991), Eq. (1). Deviates: nowhere.

use std::ops::Mul;

use crate::cloud::Point;
use crate::rigid::Rigid;

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
