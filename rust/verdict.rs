//! Stage 6: how far the pose can be trusted.
//!
//! Why: every method gives a pose with a good-looking figure, also where it is wrong. A small
//! residual or a large overlap proves nothing (ground lies well on ground anywhere); what tells
//! right from wrong is how clearly the pose beats every other one, on enough common surface, with
//! every direction held.
//! Reads: figures that other stages counted.  Leaves: one word, and the reasons for it.
//! Source: ours; thresholds measured in docs/robust_search.md.
//! Absent on purpose: points; nothing is measured here.

use nalgebra::{Matrix6, SymmetricEigen};
use serde::{Deserialize, Serialize};

use crate::error::{Result, require_between};

/// The verdict.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// The data support this pose and no other.
    Accepted,
    /// Probably right, but something is missing: a person has to look.
    Review,
    /// The data do not support this pose.
    Rejected,
}

impl Verdict {
    /// The word used in results: "accepted", "review", "rejected".
    pub fn name(self) -> &'static str {
        match self {
            Self::Accepted => "accepted",
            Self::Review => "review",
            Self::Rejected => "rejected",
        }
    }
}

/// Where the lines are drawn.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct VerdictOptions {
    /// Accept only above this share of inliers, in 0 to 1.
    pub accept_inlier_share: f64,
    /// Accept only where the best pose scores so many times its best rival; at least 1.
    pub accept_ambiguity_ratio: f64,
    /// Accept only where the share of inliers times the ambiguity ratio is above this: the less the
    /// clouds share, the clearer the lead must be. At least 0.
    pub accept_share_times_ratio: f64,
    /// Accept only where the least constrained direction is held by this share of what all points
    /// together could hold, in 0 to 1.
    pub accept_strength: f64,
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
            accept_ambiguity_ratio: 1.75,
            accept_share_times_ratio: 1.0,
            accept_strength: 0.003,
            reject_inlier_share: 0.20,
            reject_ambiguity_ratio: 1.10,
        }
    }
}

impl VerdictOptions {
    pub(crate) fn check(&self) -> Result<()> {
        require_between(
            "verdict.accept_inlier_share",
            self.accept_inlier_share,
            0.0,
            1.0,
        )?;
        require_between("verdict.accept_strength", self.accept_strength, 0.0, 1.0)?;
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
        require_between(
            "verdict.reject_ambiguity_ratio",
            self.reject_ambiguity_ratio,
            1.0,
            ratio,
        )?;
        Ok(())
    }
}

/// What the verdict rests on.
#[derive(Debug, Clone, PartialEq)]
pub struct Evidence {
    /// Points of both clouds with a partner and an agreeing normal, by twice the points of the
    /// smaller cloud.
    pub inlier_share: f64,
    /// Score of the pose by the score of its best rival; NaN where no rival was looked for.
    pub ambiguity_ratio: f64,
    /// How firmly the common surface holds the pose.
    pub strength: Strength,
    /// Whether the fine stage came to rest.
    pub converged: bool,
}

/// How firmly a pose is held in its least constrained direction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Strength {
    /// 0 (slides or turns freely) to about 1/6 (held alike in all six directions).
    pub weakest: f64,
    /// The direction of that motion: turning (in units of the cloud's mean radius), then shifting.
    pub direction: [f64; 6],
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
            };
        }
        let scale = |axis: usize| if axis < 3 { 1.0 / radius_m } else { 1.0 };
        let scaled = Matrix6::from_fn(|r, c| information[(r, c)] * scale(r) * scale(c) / weight);
        let eigen = SymmetricEigen::new(scaled);
        let weakest = eigen.eigenvalues.imin();
        Self {
            weakest: eigen.eigenvalues[weakest].max(0.0),
            direction: std::array::from_fn(|i| eigen.eigenvectors[(i, weakest)]),
        }
    }

    /// The weak direction in words: "shifting along (0.00, 1.00, 0.00)".
    pub fn words(&self) -> String {
        let (turn, shift) = self.direction.split_at(3);
        let norm = |v: &[f64]| v.iter().map(|x| x * x).sum::<f64>().sqrt();
        let (motion, axis) = if norm(turn) > norm(shift) {
            ("turning about", turn)
        } else {
            ("shifting along", shift)
        };
        let length = norm(axis).max(f64::MIN_POSITIVE);
        let unit: Vec<f64> = axis.iter().map(|v| v / length).collect();
        format!("{motion} ({:.2}, {:.2}, {:.2})", unit[0], unit[1], unit[2])
    }
}

/// The verdict with its reasons, the weightiest first.
#[derive(Debug, Clone, PartialEq)]
pub struct Judgement {
    /// The verdict.
    pub verdict: Verdict,
    /// Sentences for the person who signs.
    pub reasons: Vec<String>,
}

/// Judges.
///
/// ```
/// use tmchho::verdict::{Evidence, Strength, Verdict, VerdictOptions, judge};
/// let evidence = Evidence {
///     inlier_share: 0.8,
///     ambiguity_ratio: 3.0,
///     strength: Strength { weakest: 0.05, direction: [0.0, 0.0, 0.0, 1.0, 0.0, 0.0] },
///     converged: true,
/// };
/// let options = VerdictOptions::default();
/// assert_eq!(judge(&evidence, &options).verdict, Verdict::Accepted);
/// let twin_found = Evidence { ambiguity_ratio: 1.02, ..evidence };
/// assert_eq!(judge(&twin_found, &options).verdict, Verdict::Review);
/// ```
pub fn judge(evidence: &Evidence, options: &VerdictOptions) -> Judgement {
    let mut verdict = Verdict::Accepted;
    let mut reasons = Vec::new();
    let mut lower = |to: Verdict, reason: String| {
        if to == Verdict::Rejected || verdict == Verdict::Accepted {
            verdict = to;
        }
        reasons.push(reason);
    };
    // What could not be counted counts as nothing.
    let counted = |value: f64| if value.is_nan() { 0.0 } else { value };
    let share = counted(evidence.inlier_share);
    let ratio = evidence.ambiguity_ratio;
    let needed_ratio = options
        .accept_ambiguity_ratio
        .max(options.accept_share_times_ratio / share);
    if share < options.reject_inlier_share {
        lower(
            Verdict::Rejected,
            format!(
                "only {:.0} % of the smaller cloud finds matching surface in the other; wrong poses \
                 reach as much",
                100.0 * share
            ),
        );
    } else if share <= options.accept_inlier_share {
        lower(
            Verdict::Review,
            format!(
                "{:.0} % of the smaller cloud finds matching surface in the other, {:.0} % are \
                 asked for",
                100.0 * share,
                100.0 * options.accept_inlier_share
            ),
        );
    }
    if ratio.is_nan() {
        lower(
            Verdict::Review,
            "paper mode looks at one pose only: whether another one fits as well is not known"
                .into(),
        );
    } else if ratio < options.reject_ambiguity_ratio {
        // Much common surface at two poses is a repeated shape, for a person to settle; little
        // common surface at two poses is chance.
        let chance = share <= options.accept_inlier_share;
        lower(
            if chance {
                Verdict::Rejected
            } else {
                Verdict::Review
            },
            format!(
                "another pose fits almost as well (the best scores {ratio:.2} times the next): \
                 repeated shapes, too little overlap, or clouds of different places"
            ),
        );
    } else if ratio <= needed_ratio {
        lower(
            Verdict::Review,
            format!(
                "the best pose scores {ratio:.2} times the next one, {needed_ratio:.2} times are asked \
                 for where {:.0} % of the smaller cloud match",
                100.0 * share
            ),
        );
    }
    if counted(evidence.strength.weakest) < options.accept_strength {
        lower(
            Verdict::Review,
            format!(
                "the common surface hardly holds the pose against {}",
                evidence.strength.words()
            ),
        );
    }
    if !evidence.converged {
        lower(
            Verdict::Review,
            "the fine registration did not come to rest".into(),
        );
    }
    if reasons.is_empty() {
        let lead = if ratio.is_finite() {
            format!("scores {ratio:.1} times the next one")
        } else {
            "has no rival".into()
        };
        reasons.push(format!(
            "{:.0} % of the smaller cloud finds matching surface, and the pose {lead}",
            100.0 * share.min(1.0)
        ));
    }
    Judgement { verdict, reasons }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::point_to_plane::PlaneSums;

    fn good() -> Evidence {
        Evidence {
            inlier_share: 0.5,
            ambiguity_ratio: 2.5,
            strength: Strength {
                weakest: 0.02,
                direction: [1.0, 0.0, 0.0, 0.0, 0.0, 0.0],
            },
            converged: true,
        }
    }

    #[test]
    fn each_lack_lowers_the_verdict_and_is_said() {
        let options = VerdictOptions::default();
        let judged = |evidence: Evidence| {
            let judgement = judge(&evidence, &options);
            (judgement.verdict, judgement.reasons.join("; "))
        };
        assert_eq!(judged(good()).0, Verdict::Accepted);
        let cases = [
            (
                Evidence {
                    inlier_share: 0.25,
                    ..good()
                },
                Verdict::Review,
                "25 %",
            ),
            (
                Evidence {
                    inlier_share: 0.05,
                    ..good()
                },
                Verdict::Rejected,
                "5 %",
            ),
            (
                Evidence {
                    inlier_share: f64::NAN,
                    ..good()
                },
                Verdict::Rejected,
                "%",
            ),
            (
                Evidence {
                    ambiguity_ratio: 1.4,
                    ..good()
                },
                Verdict::Review,
                "1.40 times",
            ),
            (
                Evidence {
                    ambiguity_ratio: 1.0,
                    ..good()
                },
                Verdict::Review,
                "almost as well",
            ),
            (
                Evidence {
                    ambiguity_ratio: 1.0,
                    inlier_share: 0.25,
                    ..good()
                },
                Verdict::Rejected,
                "almost as well",
            ),
            (
                Evidence {
                    ambiguity_ratio: f64::NAN,
                    ..good()
                },
                Verdict::Review,
                "paper mode",
            ),
            (
                Evidence {
                    converged: false,
                    ..good()
                },
                Verdict::Review,
                "come to rest",
            ),
            (
                Evidence {
                    strength: Strength {
                        weakest: 0.0,
                        ..good().strength
                    },
                    ..good()
                },
                Verdict::Review,
                "turning about (1.00, 0.00, 0.00)",
            ),
        ];
        for (evidence, verdict, words) in cases {
            let (found, reasons) = judged(evidence);
            assert_eq!(found, verdict, "{reasons}");
            assert!(reasons.contains(words), "{reasons}");
        }
        // A rejection stays one whatever else is wrong.
        let both = Evidence {
            inlier_share: 0.05,
            converged: false,
            ..good()
        };
        assert_eq!(judged(both).0, Verdict::Rejected);
    }

    #[test]
    fn a_flat_floor_slides_and_a_cube_does_not() {
        let strength = |axes: usize| {
            let (mut sums, mut squared, mut n) = (PlaneSums::default(), 0.0, 0.0);
            for axis in 0..axes {
                for (side, i) in [-1.0, 1.0]
                    .into_iter()
                    .flat_map(|s| (0..100).map(move |i| (s, i)))
                {
                    let mut p = [0.0; 3];
                    p[axis] = if axes == 1 { 0.0 } else { side };
                    p[(axis + 1) % 3] = f64::from(i % 10) / 4.5 - 1.0;
                    p[(axis + 2) % 3] = f64::from(i / 10) / 4.5 - 1.0;
                    let mut normal = [0.0; 3];
                    normal[axis] = 1.0;
                    sums.add(&p, &p, &normal, 1.0);
                    squared += p.iter().map(|v| v * v).sum::<f64>();
                    n += 1.0;
                }
            }
            Strength::new(&sums.information(), n, (squared / n).sqrt())
        };
        assert!(strength(1).weakest < 1e-12);
        assert!(strength(3).weakest > 0.1, "{:?}", strength(3));
    }

    #[test]
    fn thresholds_that_contradict_each_other_are_refused() {
        let options = VerdictOptions {
            reject_inlier_share: 0.5,
            ..VerdictOptions::default()
        };
        assert!(
            options
                .check()
                .unwrap_err()
                .to_string()
                .contains("reject_inlier_share")
        );
    }
}
