//! The rigid transform, and its six parameters of Eq. (1).
//!
//! Source: Ren, Zhao & Han (2023), Eq. (1). Deviates: nowhere; the rotation is the transpose of
//! Rz(θz)·Ry(θy)·Rx(θx), as printed.

use std::ops::Mul;

use nalgebra::{Matrix3, Matrix4, Rotation3, Vector3};

use crate::cloud::Point;
use crate::error::{Error, Result};

/// q = R·p + t. Named by its direction: `target_from_source * p_source` lies in the target frame.
///
/// ```
/// use tmchho::Rigid;
/// let quarter_turn = Rigid::from_euler([0.0, 0.0, std::f64::consts::FRAC_PI_2], [1.0, 0.0, 0.0]);
/// let q = quarter_turn.apply(&[0.0, 1.0, 0.0]);
/// assert!((q[0] - 2.0).abs() < 1e-15 && q[1].abs() < 1e-15);
/// let back = quarter_turn.inverse().apply(&q);
/// assert!((back[1] - 1.0).abs() < 1e-15);
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rigid {
    /// Rotation, determinant +1.
    pub rotation: Matrix3<f64>,
    /// Translation, in the clouds' unit.
    pub translation: Vector3<f64>,
}

impl Rigid {
    /// Leaves every point where it is.
    pub fn identity() -> Self {
        Self {
            rotation: Matrix3::identity(),
            translation: Vector3::zeros(),
        }
    }

    /// The transform of Eq. (1) from the angles θx, θy, θz in radians and the shifts Vx, Vy, Vz.
    pub fn from_euler(angles_rad: [f64; 3], translation: [f64; 3]) -> Self {
        let [(sx, cx), (sy, cy), (sz, cz)] = angles_rad.map(f64::sin_cos);
        // Eq. (1)
        #[rustfmt::skip]
        let rotation = Matrix3::new(
            cy * cz,                cy * sz,                -sy,
            sx * sy * cz - cx * sz, sx * sy * sz + cx * cz, sx * cy,
            cx * sy * cz + sx * sz, cx * sy * sz - sx * cz, cx * cy,
        );
        Self {
            rotation,
            translation: Vector3::from(translation),
        }
    }

    /// The angles θx, θy, θz of Eq. (1), in radians, θy in [−π/2, π/2].
    pub fn euler_rad(&self) -> [f64; 3] {
        let r = &self.rotation;
        let theta_y = (-r[(0, 2)]).clamp(-1.0, 1.0).asin();
        if r[(0, 2)].abs() < 1.0 - 1e-12 {
            [
                r[(1, 2)].atan2(r[(2, 2)]),
                theta_y,
                r[(0, 1)].atan2(r[(0, 0)]),
            ]
        } else {
            // Gimbal lock: θx and θz turn about one axis; the whole turn is put into θx.
            let sign = theta_y.signum();
            [(sign * r[(1, 0)]).atan2(r[(1, 1)]), theta_y, 0.0]
        }
    }

    /// A rotation by `vector`'s length about its direction, then a translation.
    pub fn from_rotation_vector(vector_rad: Vector3<f64>, translation: Vector3<f64>) -> Self {
        Self {
            rotation: Rotation3::new(vector_rad).into_inner(),
            translation,
        }
    }

    /// Reads a 4×4 matrix.
    ///
    /// # Errors
    /// [`Error::InvalidArgument`] unless the matrix is finite, its last row is 0 0 0 1 and its
    /// rotation part is orthonormal to 1e-6 with determinant +1.
    pub fn from_matrix4(matrix: &[[f64; 4]; 4]) -> Result<Self> {
        let refuse = |problem: &str| Err(Error::argument("the 4×4 transformation", problem));
        if matrix.iter().flatten().any(|v| !v.is_finite()) {
            return refuse("has entries that are not finite numbers");
        }
        if matrix[3] != [0.0, 0.0, 0.0, 1.0] {
            return refuse("must end with the row 0 0 0 1");
        }
        let rotation = Matrix3::from_fn(|row, column| matrix[row][column]);
        if (rotation * rotation.transpose() - Matrix3::identity()).amax() > 1e-6 {
            return refuse("must hold a rotation: its 3×3 part is not orthonormal (scaled?)");
        }
        if rotation.determinant() < 0.0 {
            return refuse("must hold a rotation: its 3×3 part mirrors (determinant −1)");
        }
        Ok(Self {
            rotation,
            translation: Vector3::new(matrix[0][3], matrix[1][3], matrix[2][3]),
        })
    }

    /// The 4×4 matrix, row by row.
    pub fn to_matrix4(&self) -> [[f64; 4]; 4] {
        let mut matrix = Matrix4::identity();
        matrix
            .fixed_view_mut::<3, 3>(0, 0)
            .copy_from(&self.rotation);
        matrix
            .fixed_view_mut::<3, 1>(0, 3)
            .copy_from(&self.translation);
        std::array::from_fn(|row| std::array::from_fn(|column| matrix[(row, column)]))
    }

    /// The transform back.
    pub fn inverse(&self) -> Self {
        let rotation = self.rotation.transpose();
        Self {
            rotation,
            translation: -(rotation * self.translation),
        }
    }

    /// Moves a point.
    #[inline]
    pub fn apply(&self, p: &Point) -> Point {
        let (r, t) = (&self.rotation, &self.translation);
        std::array::from_fn(|i| r[(i, 0)] * p[0] + r[(i, 1)] * p[1] + r[(i, 2)] * p[2] + t[i])
    }

    /// Turns a direction.
    #[inline]
    pub fn rotate(&self, v: &Point) -> Point {
        let r = &self.rotation;
        std::array::from_fn(|i| r[(i, 0)] * v[0] + r[(i, 1)] * v[1] + r[(i, 2)] * v[2])
    }

    /// Angle of the rotation, 0 to π.
    pub fn rotation_angle_rad(&self) -> f64 {
        // Accurate near 0 and near π, where the arc cosine of the trace is not.
        let r = &self.rotation;
        let axis = Vector3::new(
            r[(2, 1)] - r[(1, 2)],
            r[(0, 2)] - r[(2, 0)],
            r[(1, 0)] - r[(0, 1)],
        );
        axis.norm().atan2(r.trace() - 1.0)
    }

    /// The same motion between frames whose origins lie elsewhere: takes a pose between local
    /// coordinates (about the two origins) to the pose between the coordinates given.
    pub fn between_given_coordinates(&self, source_origin: Point, target_origin: Point) -> Self {
        let turned = self.rotate(&source_origin);
        Self {
            rotation: self.rotation,
            translation: Vector3::from_fn(|i, _| {
                self.translation[i] + (target_origin[i] - turned[i])
            }),
        }
    }

    /// The inverse of [`Rigid::between_given_coordinates`].
    pub fn between_local_coordinates(&self, source_origin: Point, target_origin: Point) -> Self {
        let turned = self.rotate(&source_origin);
        Self {
            rotation: self.rotation,
            translation: Vector3::from_fn(|i, _| {
                self.translation[i] + (turned[i] - target_origin[i])
            }),
        }
    }
}

/// `a * b` applies `b` first.
impl Mul for Rigid {
    type Output = Self;

    fn mul(self, other: Self) -> Self {
        Self {
            rotation: self.rotation * other.rotation,
            translation: self.rotation * other.translation + self.translation,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::{FRAC_PI_2, PI};

    #[test]
    fn eq_1_by_hand() {
        // θx = 90°: rows (1 0 0), (0 0 1), (0 −1 0), which is the clockwise turn of the paper.
        let r = Rigid::from_euler([FRAC_PI_2, 0.0, 0.0], [0.0; 3]);
        let q = r.apply(&[1.0, 2.0, 3.0]);
        for (got, wanted) in q.iter().zip([1.0, 3.0, -2.0]) {
            assert!((got - wanted).abs() < 1e-15);
        }
    }

    #[test]
    fn angles_come_back_also_at_gimbal_lock() {
        for angles in [
            [0.3, -0.7, 2.9],
            [-3.0, 1.5, 0.1],
            [0.4, FRAC_PI_2, 0.9],
            [0.4, -FRAC_PI_2, 0.9],
        ] {
            let pose = Rigid::from_euler(angles, [0.0; 3]);
            let again = Rigid::from_euler(pose.euler_rad(), [0.0; 3]);
            assert!((pose.rotation - again.rotation).amax() < 1e-8, "{angles:?}");
        }
    }

    #[test]
    fn the_angle_is_exact_near_zero_and_pi() {
        for angle in [0.0, 1e-9, 0.5, PI - 1e-9, PI] {
            let pose = Rigid::from_rotation_vector(Vector3::z() * angle, Vector3::zeros());
            assert!((pose.rotation_angle_rad() - angle).abs() < 1e-12);
        }
    }

    #[test]
    fn matrices_that_are_no_pose_are_refused() {
        let good = Rigid::from_euler([0.1, 0.2, 0.3], [4.0, 5.0, 6.0]).to_matrix4();
        assert!(Rigid::from_matrix4(&good).is_ok());
        let refused = |change: fn(&mut [[f64; 4]; 4])| {
            let mut matrix = good;
            change(&mut matrix);
            Rigid::from_matrix4(&matrix).unwrap_err().to_string()
        };
        assert!(refused(|m| m[0][0] *= 2.0).contains("orthonormal"));
        assert!(refused(|m| m[3][0] = 1.0).contains("0 0 0 1"));
        assert!(refused(|m| m[1][3] = f64::NAN).contains("finite"));
        assert!(refused(|m| m[0] = m[0].map(|v| -v)).contains("mirrors"));
    }

    #[test]
    fn a_change_of_origins_and_back_is_the_same_pose() {
        let pose = Rigid::from_euler([0.4, -1.0, 2.0], [1.0, 2.0, 3.0]);
        let (s, t) = ([500_000.0, 4e6, 200.0], [-3.0, 7.0, 11.0]);
        let given = pose.between_given_coordinates(s, t);
        let p_given = [500_010.0, 4_000_020.0, 230.0];
        let local = pose.apply(&[10.0, 20.0, 30.0]);
        let moved = given.apply(&p_given);
        for i in 0..3 {
            assert!((moved[i] - (local[i] + t[i])).abs() < 1e-8);
        }
        let again = given.between_local_coordinates(s, t);
        assert!((again.translation - pose.translation).amax() < 1e-8);
    }
}
