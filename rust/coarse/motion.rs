//! What a descent may change of a pose.

use nalgebra::{Matrix3, Vector3};

use crate::cloud::{Point, cross, dot};
use crate::freedom::Freedom;

/// What a descent may change of a pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Motion {
    /// All that is free.
    Free(Freedom),
    /// A shift, and a turn that leaves up up.
    Upright(Uprights),
}

/// Frames whose third axis is up, in the moving and in the fixed cloud.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Uprights {
    moving: Matrix3<f64>,
    fixed: Matrix3<f64>,
}

impl Uprights {
    /// Up as z is in both clouds.
    pub(super) fn as_given() -> Self {
        Self {
            moving: Matrix3::identity(),
            fixed: Matrix3::identity(),
        }
    }

    /// Up in each cloud, as a unit vector.
    pub(super) fn new(moving: &Point, fixed: &Point) -> Self {
        Self {
            moving: frame_of(moving),
            fixed: frame_of(fixed),
        }
    }

    /// Up in the fixed cloud.
    pub(super) fn up(&self) -> Vector3<f64> {
        self.fixed.column(2).into_owned()
    }

    /// A turn about the third axis, as a rotation from the moving cloud to the fixed one.
    pub(super) fn rotation(&self, turn: &Matrix3<f64>) -> Matrix3<f64> {
        self.fixed * turn * self.moving.transpose()
    }
}

/// A rotation that takes z to `up`.
fn frame_of(up: &Point) -> Matrix3<f64> {
    // Across up and the axis that it is farthest from.
    let axis = (0..3).fold(0, |axis, other| match up[other].abs() < up[axis].abs() {
        true => other,
        false => axis,
    });
    let mut other = [0.0; 3];
    other[axis] = 1.0;
    let first = cross(&other, up);
    let length = dot(&first, &first).sqrt();
    let first = first.map(|v| v / length);
    let second = cross(up, &first);
    Matrix3::from_columns(&[first.into(), second.into(), Vector3::from(*up)])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rigid::Rigid;

    #[test]
    fn a_turn_brings_up_to_up_whatever_the_turn() {
        let ups = [
            [0.0, 0.0, 1.0],
            [0.0, 0.0, -1.0],
            [0.6, 0.0, -0.8],
            [0.48, 0.64, 0.6],
            [-1.0, 0.0, 0.0],
        ];
        for moving in ups {
            for fixed in ups {
                let uprights = Uprights::new(&moving, &fixed);
                for yaw in [0.0, 1.0, 4.0] {
                    let turn = Rigid::from_euler([0.0, 0.0, yaw], [0.0; 3]).rotation;
                    let rotation = uprights.rotation(&turn);
                    assert!((rotation.determinant() - 1.0).abs() < 1e-12);
                    assert!((rotation * rotation.transpose() - Matrix3::identity()).amax() < 1e-12);
                    let up = rotation * Vector3::from(moving);
                    assert!((up - Vector3::from(fixed)).amax() < 1e-12);
                    assert_eq!(uprights.up(), Vector3::from(fixed));
                }
            }
        }
    }
}
