//! When a pose has come to rest.

use super::IcpMethod;
use crate::cloud::{Point, distance_sq};
use crate::rigid::Rigid;
use crate::similarity::Similarity;

/// Knows when a pose has come to rest although the mean distance has not: where pairs come and go at
/// the rim of the overlap it never quite settles, and the pose may run round a small cycle.
pub(super) struct Rest {
    visited: Vec<Similarity>,
    reach_m: f64,
    /// Share of the residual that counts as rest.
    tolerance: f64,
}

impl Rest {
    pub(super) fn new(source: &[Point], start: &Similarity, method: IcpMethod) -> Self {
        let farthest_sq = source
            .iter()
            .map(|p| distance_sq(p, &[0.0; 3]))
            .fold(0.0, f64::max);
        Self {
            visited: vec![*start],
            reach_m: farthest_sq.sqrt() * start.scale,
            tolerance: match method {
                // The paper's ICP creeps; only its own rule ends it.
                IcpMethod::PointToPoint => 0.0,
                IcpMethod::PointToPlane | IcpMethod::PlaneToPlane => 5e-3,
            },
        }
    }

    /// Whether no point moves by more than the tolerance, or rounding, from where the pose has been.
    pub(super) fn is_reached(&mut self, pose: &Similarity, residual_m: f64) -> bool {
        /// Steps of this share of the cloud's size are rounding: clouds that match exactly.
        const ROUNDING: f64 = 1e-9;
        let tolerance_m = (self.tolerance * residual_m).max(ROUNDING * self.reach_m);
        let moved_by = |before: &Similarity| {
            let turn: Rigid = pose.rigid * before.rigid.inverse();
            let grown = (pose.scale / before.scale - 1.0).abs();
            (turn.rotation_angle_rad() + grown) * self.reach_m
                + (pose.rigid.translation - before.rigid.translation).norm()
        };
        let reached = self
            .visited
            .iter()
            .any(|before| moved_by(before) <= tolerance_m);
        self.visited.push(*pose);
        reached
    }
}
