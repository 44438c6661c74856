//! Where the lines between accepted, review and rejected are drawn.

use serde::{Deserialize, Serialize};

use crate::error::{Result, require_between};

/// Where the lines are drawn.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct VerdictOptions {
    /// Accept only above this share of inliers, in 0 to 1.
    pub accept_inlier_share: f64,
    /// Accept only where the best pose scores so many times its best rival; at least 1.
    pub accept_ambiguity_ratio: f64,
    /// Accept only where the net share times the ambiguity ratio is above this: the less the clouds share,
    /// the clearer the lead must be. At least 0.
    pub accept_share_times_ratio: f64,
    /// Accept only where the least constrained direction is held by this share of what all points
    /// together could hold, in 0 to 1.
    pub accept_strength: f64,
    /// Accept only where the pose scores so many times what chance reaches; at least 1.
    pub accept_lead_over_chance: f64,
    /// Accept only where points held out of the fit lie at most so many times as far away as the
    /// points in it; at least 1.
    pub accept_held_out_ratio: f64,
    /// Accept only where the surfaces lie at most so many times as far apart as they are rough
    /// themselves; above 0.
    pub accept_misfit: f64,
    /// Accept only where at most this share of what lies near the other cloud lies above or below its
    /// surface, in 0 to 1.
    pub accept_conflict_share: f64,
    /// Accept only where even surfaces lie at most so far apart once their noise is averaged out, as a share of
    /// the extent of the smaller cloud, times (1 − conflict share), and times 0.75 by the misfit where that is
    /// above 0.75. Above 0.
    pub accept_surface_offset: f64,
    /// Accept only up to so many standard deviations from what was known of the pose; above 0.
    pub accept_deviation_from_known: f64,
    /// Reject below this share of inliers, in 0 to 1.
    pub reject_inlier_share: f64,
    /// Below this lead over the best rival another pose is as good; reject then, unless the share of
    /// inliers would be accepted. At least 1.
    pub reject_ambiguity_ratio: f64,
}

impl Default for VerdictOptions {
    fn default() -> Self {
        Self {
            accept_inlier_share: 0.30,
            accept_ambiguity_ratio: 2.0,
            accept_share_times_ratio: 0.9,
            accept_strength: 0.003,
            accept_lead_over_chance: 1.2,
            accept_held_out_ratio: 1.5,
            accept_misfit: 1.3,
            accept_conflict_share: 0.15,
            accept_surface_offset: 0.00127,
            accept_deviation_from_known: 3.0,
            reject_inlier_share: 0.20,
            reject_ambiguity_ratio: 1.10,
        }
    }
}

impl VerdictOptions {
    /// How far apart even surfaces may lie, as a share of the extent. Patches too far apart to be compared count
    /// as conflicts: the more of these, the less of what is off is left among the others. Noise hides another place
    /// where surfaces lie about as far apart as they are rough; one that is bent a little lies much closer. Below
    /// 0.75 nothing more is granted: strays alone make a cloud rough.
    pub(crate) fn most_surface_offset(&self, conflict_share: f64, misfit: f64) -> f64 {
        const CLOSE: f64 = 0.75;
        // The larger of a number and NaN is the number.
        self.accept_surface_offset * (1.0 - conflict_share) * CLOSE / misfit.max(CLOSE)
    }

    pub(crate) fn check(&self) -> Result<()> {
        require_between(
            "verdict.accept_inlier_share",
            self.accept_inlier_share,
            0.0,
            1.0,
        )?;
        require_between("verdict.accept_strength", self.accept_strength, 0.0, 1.0)?;
        let conflicts = self.accept_conflict_share;
        require_between("verdict.accept_conflict_share", conflicts, 0.0, 1.0)?;
        require_between(
            "verdict.reject_inlier_share",
            self.reject_inlier_share,
            0.0,
            self.accept_inlier_share,
        )?;
        let ratio = self.accept_ambiguity_ratio;
        require_between("verdict.accept_ambiguity_ratio", ratio, 1.0, f64::MAX)?;
        let product = self.accept_share_times_ratio;
        require_between("verdict.accept_share_times_ratio", product, 0.0, f64::MAX)?;
        for (name, value, least) in [
            ("accept_lead_over_chance", self.accept_lead_over_chance, 1.0),
            ("accept_held_out_ratio", self.accept_held_out_ratio, 1.0),
            ("accept_misfit", self.accept_misfit, f64::MIN_POSITIVE),
            (
                "accept_surface_offset",
                self.accept_surface_offset,
                f64::MIN_POSITIVE,
            ),
            (
                "accept_deviation_from_known",
                self.accept_deviation_from_known,
                f64::MIN_POSITIVE,
            ),
        ] {
            require_between(&format!("verdict.{name}"), value, least, f64::MAX)?;
        }
        require_between(
            "verdict.reject_ambiguity_ratio",
            self.reject_ambiguity_ratio,
            1.0,
            ratio,
        )?;
        Ok(())
    }
}
