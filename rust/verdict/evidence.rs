//! The figures that the verdict rests on, and the limits that depend on them.

use super::{Rival, Strength, VerdictOptions};

/// What the verdict rests on.
#[derive(Debug, Clone, PartialEq)]
pub struct Evidence {
    /// Surface of both clouds with a partner and an agreeing normal, by twice that of the smaller
    /// cloud.
    pub inlier_share: f64,
    /// Score of the pose by the score of its best rival; NaN where no rival was looked for.
    pub ambiguity_ratio: f64,
    /// Where that rival lies; `None` where there is none.
    pub rival: Option<Rival>,
    /// How firmly the common surface holds the pose.
    pub strength: Strength,
    /// Standard error of its weakest motion, in radians for a turn and in the clouds' unit for a
    /// shift; NaN where it is not known.
    pub weakest_error: f64,
    /// Score of the pose by the best that chance reaches; NaN where it was not tried.
    pub lead_over_chance: f64,
    /// Root mean squared distance of the pairs that were held out of the fit, by that of those in it;
    /// NaN where none were.
    pub held_out_ratio: f64,
    /// How far the surfaces lie apart, by how rough they are themselves; NaN where it is not known.
    pub misfit: f64,
    /// Surface of both clouds that lies above or below the other's, by that and what has a partner; NaN where it
    /// is not known.
    pub conflict_share: f64,
    /// The share of inliers, less what conflicts with it.
    pub net_share: f64,
    /// How far even surfaces lie apart once their noise is averaged out; NaN where it is not known.
    pub surface_offset_m: f64,
    /// Extent of the smaller cloud.
    pub extent_m: f64,
    /// How far the pose is from what was known of it, in standard deviations per number; NaN where
    /// nothing was.
    pub deviation_from_known: f64,
    /// Whether the scale lies at an end of its bounds.
    pub scale_at_bound: bool,
    /// Whether the time was up before the search was done.
    pub ended_early: bool,
    /// Whether the fine stage came to rest.
    pub converged: bool,
}

impl Evidence {
    /// The ambiguity ratio above which the pose is accepted: the less the clouds share, and the more of that
    /// conflicts, the clearer the lead must be. Infinite where they share nothing.
    pub fn least_ambiguity_ratio(&self, options: &VerdictOptions) -> f64 {
        let product = options.accept_share_times_ratio / counted(self.net_share);
        options.accept_ambiguity_ratio.max(product)
    }

    /// The surface offset up to which the pose is accepted: less where surfaces conflict, or do not lie close.
    pub fn most_surface_offset_m(&self, options: &VerdictOptions) -> f64 {
        self.extent_m * options.most_surface_offset(self.conflict_share, self.misfit)
    }
}

/// What could not be counted counts as nothing.
pub(super) fn counted(value: f64) -> f64 {
    if value.is_nan() { 0.0 } else { value }
}
