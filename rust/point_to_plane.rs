//! The small rigid step that brings points onto the planes of their partners.
//!
//! Source: Chen & Medioni (1992); linearised rotation as in Low (2004). The step is applied as a
//! full rotation (exponential map), so that no error of linearisation stays in the pose.

use nalgebra::{Matrix6, Vector3, Vector6};

use crate::cloud::Point;
use crate::rigid::Rigid;

/// Running sums of the normal equations over (point, partner, normal, weight).
#[derive(Debug, Clone, Copy)]
pub struct PlaneSums {
    /// Σ w · J·Jᵀ with J = (p × n, n): rotation first, in radians, then translation.
    information: Matrix6<f64>,
    gradient: Vector6<f64>,
    weight: f64,
}

impl Default for PlaneSums {
    fn default() -> Self {
        Self {
            information: Matrix6::zeros(),
            gradient: Vector6::zeros(),
            weight: 0.0,
        }
    }
}

impl PlaneSums {
    /// Adds a moved source point, its partner in the target, and the unit normal of the plane.
    /// Coordinates should be small numbers about the cloud's middle: the step turns about 0.
    #[inline]
    pub fn add(&mut self, moved: &Point, partner: &Point, normal: &Point, weight: f64) {
        let (p, n) = (moved, normal);
        let j = [
            p[1] * n[2] - p[2] * n[1],
            p[2] * n[0] - p[0] * n[2],
            p[0] * n[1] - p[1] * n[0],
            n[0],
            n[1],
            n[2],
        ];
        let residual =
            (p[0] - partner[0]) * n[0] + (p[1] - partner[1]) * n[1] + (p[2] - partner[2]) * n[2];
        // Only the lower triangle; `information` mirrors it when it is asked for.
        for row in 0..6 {
            let scaled = weight * j[row];
            self.gradient[row] += scaled * residual;
            for column in 0..=row {
                self.information[(row, column)] += scaled * j[column];
            }
        }
        self.weight += weight;
    }

    /// Adds the sums of other points.
    pub fn merge(&mut self, other: &Self) {
        self.information += other.information;
        self.gradient += other.gradient;
        self.weight += other.weight;
    }

    /// Sum of the weights.
    pub fn weight(&self) -> f64 {
        self.weight
    }

    /// The 6×6 information matrix: rotation (radians) first, then translation.
    pub fn information(&self) -> Matrix6<f64> {
        let lower = self.information;
        Matrix6::from_fn(|r, c| if r >= c { lower[(r, c)] } else { lower[(c, r)] })
    }

    /// The step to apply on the left of the pose; `None` where there is no weight.
    ///
    /// Directions that the planes leave open (a flat floor slides) are damped to no motion
    /// instead of being thrown about.
    pub fn solve(&self) -> Option<Rigid> {
        const RELATIVE_DAMPING: f64 = 1e-9;
        let mut information = self.information();
        // Turning and shifting apart: their sizes differ by the square of the clouds' unit.
        for motion in [0..3, 3..6] {
            let mean = motion.clone().map(|i| information[(i, i)]).sum::<f64>() / 3.0;
            if !mean.is_finite() || mean <= 0.0 {
                return None;
            }
            for i in motion {
                information[(i, i)] += RELATIVE_DAMPING * mean;
            }
        }
        let step = -information.cholesky()?.solve(&self.gradient);
        step.iter().all(|v| v.is_finite()).then(|| {
            Rigid::from_rotation_vector(
                Vector3::new(step[0], step[1], step[2]),
                Vector3::new(step[3], step[4], step[5]),
            )
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_shift_along_z_is_undone_in_one_step() {
        // Points of three faces of a cube, moved by (0, 0, 0.1): the exact answer is −0.1 in z.
        let mut sums = PlaneSums::default();
        for (u, v) in [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)] {
            for axis in 0..3 {
                let mut partner = [0.0; 3];
                partner[(axis + 1) % 3] = u;
                partner[(axis + 2) % 3] = v;
                let mut normal = [0.0; 3];
                normal[axis] = 1.0;
                let moved = [partner[0], partner[1], partner[2] + 0.1];
                sums.add(&moved, &partner, &normal, 1.0);
            }
        }
        let step = sums.solve().unwrap();
        assert!((step.translation - Vector3::new(0.0, 0.0, -0.1)).amax() < 1e-8);
        assert!(step.rotation_angle_rad() < 1e-8);
    }

    #[test]
    fn a_single_plane_moves_only_along_its_normal() {
        let mut sums = PlaneSums::default();
        for (x, y) in [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0), (-1.0, 0.3)] {
            sums.add(&[x, y, 0.2], &[x, y, 0.0], &[0.0, 0.0, 1.0], 1.0);
        }
        let step = sums.solve().unwrap();
        assert!((step.translation - Vector3::new(0.0, 0.0, -0.2)).amax() < 1e-6);
        assert!(PlaneSums::default().solve().is_none());
    }
}
