//! Stage 4: the pose, without an initial guess.
//!
//! Why: two sensors that agree on nothing give no common frame to start ICP from.
//! Reads: two voxel-uniform clouds (robust) or their keypoints (paper).
//! Leaves: candidate poses, best first, with what was counted at each.
//! Source: robust is ours; paper is Ren, Zhao & Han (2023), Sections 4.3 and 4.4.
//! Absent on purpose: the verdict; this stage reports figures and judges nobody.

mod descent;
mod echoes;
mod explore;
mod facing;
mod hypotheses;
mod motion;
mod options;
mod paper;
mod robust;
mod starts;
mod verify;

pub use options::RobustSearchOptions;
pub use paper::{PaperBox, PaperSearchOptions, search_paper};
pub(crate) use robust::{N_WITNESSES, WITNESS_RADIUS, has_many_places, search_asking};
pub use robust::{Problem, StandingOut, search_robust};

use crate::error::Error;
use crate::fitness::Agreement;
use crate::rigid::Rigid;
use crate::similarity::Similarity;

/// A pose, and how far the clouds agree at it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Candidate {
    /// Takes local source coordinates to local target coordinates.
    pub target_from_source: Similarity,
    /// What candidates are ranked by, higher is better: in robust mode the curvature-weighted
    /// symmetric share of inliers, 0 to about 1, divided by the misfit where that is above 1; in paper mode minus the RMS of Eq. (1).
    pub score: f64,
    /// How far the clouds agree there; NaN throughout in paper mode.
    pub agreement: Agreement,
}

/// What the search found and what it cost.
#[derive(Debug, Clone, PartialEq)]
pub struct CoarseResult {
    /// Distinct poses, best first; never empty.
    pub candidates: Vec<Candidate>,
    /// Weighted share of inliers of the best pose, counted at the accuracy that the clouds show there,
    /// by that of the best clearly different pose; infinite where no other
    /// pose scored, 1 where two poses are equally good, NaN where no second pose was looked for.
    pub ambiguity_ratio: f64,
    /// The best score of a few random poses, refined like all others; NaN in paper mode.
    pub chance_score: f64,
    /// Poses for which the clouds were compared, every step of every descent counted.
    pub n_evaluations: usize,
    /// Best score so far, after each verified pose (robust) or iteration (paper).
    pub history: Vec<f64>,
    /// Rounds of starts that were needed (robust) or iterations made (paper).
    pub n_rounds: usize,
    /// Whether the deadline ended it.
    pub ended_early: bool,
    /// The length that distances of the search are shares of: the extent of the smaller cloud.
    pub unit_m: f64,
}

impl CoarseResult {
    /// Share of inliers of the best candidate.
    pub fn inlier_share(&self) -> f64 {
        self.candidates[0].agreement.inlier_share
    }

    /// Whether the best candidate stands out so that no more is to be searched.
    pub fn stands_out(&self, wanted: StandingOut) -> bool {
        wanted.is_met_by(&self.candidates[0].agreement, self.ambiguity_ratio)
    }
}

fn without_points() -> Error {
    Error::NoSolution {
        reason: "a cloud without points has no pose".into(),
    }
}

/// Whether two poses of a cloud about its middle differ by more than an angle or a distance.
fn differ_rigid(a: &Rigid, b: &Rigid, angle_rad: f64, distance: f64) -> bool {
    (a.translation - b.translation).norm() > distance
        || (a.rotation.transpose() * b.rotation).trace() < 1.0 + 2.0 * angle_rad.cos()
}

/// The same for poses with a scale, which differ also where the scale does.
fn differ(a: &Similarity, b: &Similarity, angle_rad: f64, distance: f64) -> bool {
    (a.scale / b.scale).ln().abs() > angle_rad
        || differ_rigid(&a.rigid, &b.rigid, angle_rad, distance)
}
