//! How firmly the common surface holds a pose, and against what it does not.

use nalgebra::{Matrix6, SymmetricEigen, Vector6};

/// How firmly a pose is held in its least constrained direction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Strength {
    /// 0 (slides or turns freely) to about 1/6 (held alike in all six directions).
    pub weakest: f64,
    /// The direction of that motion: turning (in units of the cloud's mean radius), then shifting.
    pub direction: [f64; 6],
    /// That radius.
    pub radius_m: f64,
}

impl Strength {
    /// From the information matrix of a point-to-plane step about the middle of the pairs, their
    /// total weight and the root mean squared distance of the pairs from that middle.
    ///
    /// Angles are measured as arcs at that radius, so that turning and shifting compare; each pair
    /// then contributes at most about 2 to the trace.
    pub fn new(information: &Matrix6<f64>, weight: f64, radius_m: f64) -> Self {
        if weight.is_nan() || weight <= 0.0 || radius_m.is_nan() || radius_m <= 0.0 {
            return Self {
                weakest: 0.0,
                direction: [0.0; 6],
                radius_m: 0.0,
            };
        }
        let scale = |axis: usize| if axis < 3 { 1.0 / radius_m } else { 1.0 };
        let scaled = Matrix6::from_fn(|r, c| information[(r, c)] * scale(r) * scale(c) / weight);
        let eigen = SymmetricEigen::new(scaled);
        let weakest = eigen.eigenvalues.imin();
        Self {
            weakest: eigen.eigenvalues[weakest].max(0.0),
            direction: std::array::from_fn(|i| eigen.eigenvectors[(i, weakest)]),
            radius_m,
        }
    }

    /// Whether the weak motion is more of a turn than of a shift.
    pub fn is_turn(&self) -> bool {
        let norm = |v: &[f64]| v.iter().map(|x| x * x).sum::<f64>();
        norm(&self.direction[..3]) > norm(&self.direction[3..])
    }

    /// Standard error of the weak motion, from the covariance of turning (radians) and shifting:
    /// radians for a turn, the clouds' unit for a shift.
    pub fn standard_error(&self, covariance: &Matrix6<f64>) -> f64 {
        let arcs = |i: usize| if i < 3 { self.radius_m } else { 1.0 };
        let along = Vector6::from_fn(|i, _| self.direction[i] * arcs(i));
        let error_m = (along.transpose() * covariance * along)[(0, 0)].sqrt();
        match self.is_turn() {
            true => error_m / self.radius_m,
            false => error_m,
        }
    }

    /// The weak direction in words: "shifting along (0.00, 1.00, 0.00)".
    pub fn words(&self) -> String {
        let (turn, shift) = self.direction.split_at(3);
        let (motion, axis) = match self.is_turn() {
            true => ("turning about", turn),
            false => ("shifting along", shift),
        };
        let length = axis.iter().map(|v| v * v).sum::<f64>().sqrt();
        let unit = |i: usize| axis[i] / length.max(f64::MIN_POSITIVE);
        format!("{motion} ({:.2}, {:.2}, {:.2})", unit(0), unit(1), unit(2))
    }
}
