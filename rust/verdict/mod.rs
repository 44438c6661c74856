//! Stage 6: how far the pose can be trusted.
//!
//! Why: every method gives a pose with a good-looking figure, also where it is wrong. A small
//! residual or a large overlap proves nothing (ground lies well on ground anywhere); what tells
//! right from wrong is how clearly the pose beats every other one, on enough common surface, with
//! every direction held.
//! Reads: figures that other stages counted.  Leaves: one word, and the reasons for it.
//! Source: ours; thresholds measured in docs/robust_search.md.
//! Absent on purpose: points; nothing is measured here.

mod evidence;
mod options;
mod rival;
mod strength;

use serde::{Deserialize, Serialize};

pub use evidence::Evidence;
use evidence::counted;
pub use options::VerdictOptions;
pub use rival::Rival;
pub use strength::Strength;

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

/// The verdict with its reasons, the weightiest first.
#[derive(Debug, Clone, PartialEq)]
pub struct Judgement {
    /// The verdict.
    pub verdict: Verdict,
    /// Sentences for the person who signs.
    pub reasons: Vec<String>,
}

impl Judgement {
    /// Adds reasons to doubt the input. What is doubted is not accepted, and not all that was
    /// accepted is said of it any longer.
    pub(crate) fn doubt(&mut self, doubts: Vec<String>) {
        if doubts.is_empty() {
            return;
        }
        if self.verdict == Verdict::Accepted {
            self.verdict = Verdict::Review;
            self.reasons.clear();
        }
        self.reasons.extend(doubts);
    }
}

/// Judges.
///
/// ```
/// use tmchho::verdict::{Evidence, Strength, Verdict, VerdictOptions, judge};
/// let evidence = Evidence {
///     inlier_share: 0.8,
///     ambiguity_ratio: 3.0,
///     rival: None,
///     strength: Strength {
///         weakest: 0.05, direction: [0.0, 0.0, 0.0, 1.0, 0.0, 0.0], radius_m: 10.0
///     },
///     weakest_error: f64::NAN,
///     lead_over_chance: 9.0,
///     held_out_ratio: 1.0,
///     misfit: 0.6,
///     conflict_share: 0.02,
///     net_share: 0.7,
///     surface_offset_m: 0.002,
///     extent_m: 20.0,
///     deviation_from_known: f64::NAN,
///     scale_at_bound: false,
///     ended_early: false,
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
    let share = counted(evidence.inlier_share);
    let ratio = evidence.ambiguity_ratio;
    let least_ratio = evidence.least_ambiguity_ratio(options);
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
                "another pose fits almost as well (the best scores {ratio:.2} times the next{}): \
                 repeated shapes, too little overlap, or clouds of different places",
                Rival::words(evidence.rival.as_ref())
            ),
        );
    } else if ratio <= least_ratio && share >= options.reject_inlier_share {
        lower(
            Verdict::Review,
            format!(
                "the best pose scores {ratio:.2} times the next one{}; {least_ratio:.2} times are \
                 asked for where {:.0} % of the smaller cloud match",
                Rival::words(evidence.rival.as_ref()),
                100.0 * share
            ),
        );
    }
    if counted(evidence.strength.weakest) < options.accept_strength {
        lower(
            Verdict::Review,
            format!(
                "the common surface hardly holds the pose against {}{}",
                evidence.strength.words(),
                match evidence.weakest_error {
                    error if error.is_nan() => String::new(),
                    error if evidence.strength.is_turn() =>
                        format!(" (standard error {:.3}°)", error.to_degrees()),
                    error => format!(" (standard error {error:.3} m)"),
                }
            ),
        );
    }
    // Comparisons with NaN are false: what was not measured is no reproach.
    if evidence.lead_over_chance < options.accept_lead_over_chance {
        lower(
            Verdict::Review,
            format!(
                "the pose scores only {:.2} times what random poses reach, {:.2} times are asked for",
                evidence.lead_over_chance, options.accept_lead_over_chance
            ),
        );
    }
    if evidence.misfit > options.accept_misfit {
        lower(
            Verdict::Review,
            format!(
                "the surfaces lie {:.1} times as far apart as they are rough themselves: places that \
                 resemble each other, or one that has changed",
                evidence.misfit
            ),
        );
    }
    if evidence.conflict_share > options.accept_conflict_share {
        lower(
            Verdict::Review,
            format!(
                "{:.0} % of the surface near the other cloud lies above or below it instead of on it: surfaces \
                 that cross, or a place that has changed",
                100.0 * evidence.conflict_share
            ),
        );
    }
    let most_m = evidence.most_surface_offset_m(options);
    if evidence.surface_offset_m > most_m {
        lower(
            Verdict::Review,
            format!(
                "even surfaces lie {:.3} m apart, and not by their noise; up to {most_m:.3} m are accepted: \
                 places that resemble each other, one that has changed, or a model that is bent",
                evidence.surface_offset_m
            ),
        );
    }
    if evidence.held_out_ratio > options.accept_held_out_ratio {
        lower(
            Verdict::Review,
            format!(
                "points held out of the fit lie {:.1} times as far from the other cloud as those in it",
                evidence.held_out_ratio
            ),
        );
    }
    if evidence.deviation_from_known > options.accept_deviation_from_known {
        lower(
            Verdict::Review,
            format!(
                "the pose lies {:.1} standard deviations from the prior or the control points",
                evidence.deviation_from_known
            ),
        );
    }
    if evidence.scale_at_bound {
        lower(
            Verdict::Review,
            "the scale lies at an end of the bounds in which it was sought".into(),
        );
    }
    if evidence.ended_early {
        lower(
            Verdict::Review,
            "the time was up before the search had found a pose that stands out".into(),
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
            rival: None,
            strength: Strength {
                weakest: 0.02,
                direction: [1.0, 0.0, 0.0, 0.0, 0.0, 0.0],
                radius_m: 10.0,
            },
            weakest_error: 0.01,
            lead_over_chance: 5.0,
            held_out_ratio: 1.0,
            misfit: 0.6,
            conflict_share: 0.02,
            surface_offset_m: 0.002,
            extent_m: 20.0,
            net_share: 0.44,
            deviation_from_known: f64::NAN,
            scale_at_bound: false,
            ended_early: false,
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
                    net_share: 0.2,
                    ..good()
                },
                Verdict::Review,
                "4.50 times are asked for",
            ),
            (
                Evidence {
                    surface_offset_m: 0.05,
                    ..good()
                },
                Verdict::Review,
                "even surfaces lie 0.050 m apart, and not by their noise; up to 0.025 m are accepted",
            ),
            // As far apart as they are rough.
            (
                Evidence {
                    surface_offset_m: 0.024,
                    misfit: 1.0,
                    ..good()
                },
                Verdict::Review,
                "even surfaces lie 0.024 m apart, and not by their noise; up to 0.019 m are accepted",
            ),
            (
                Evidence {
                    conflict_share: 0.2,
                    ..good()
                },
                Verdict::Review,
                "20 % of the surface near the other cloud lies above or below it",
            ),
            (
                Evidence {
                    misfit: 4.0,
                    ..good()
                },
                Verdict::Review,
                "4.0 times as far apart",
            ),
            (
                Evidence {
                    lead_over_chance: 1.15,
                    ..good()
                },
                Verdict::Review,
                "1.15 times what random poses reach",
            ),
            (
                Evidence {
                    held_out_ratio: 2.0,
                    ..good()
                },
                Verdict::Review,
                "held out",
            ),
            (
                Evidence {
                    deviation_from_known: 4.0,
                    ..good()
                },
                Verdict::Review,
                "4.0 standard deviations",
            ),
            (
                Evidence {
                    scale_at_bound: true,
                    ..good()
                },
                Verdict::Review,
                "scale",
            ),
            (
                Evidence {
                    ended_early: true,
                    ..good()
                },
                Verdict::Review,
                "time was up",
            ),
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

    #[test]
    fn what_is_doubted_is_not_accepted() {
        let options = VerdictOptions::default();
        let doubted = |evidence: Evidence| {
            let mut judgement = judge(&evidence, &options);
            judgement.doubt(vec!["mirrored".into()]);
            judgement
        };
        let review = doubted(good());
        assert_eq!(review.verdict, Verdict::Review);
        // Not also that all is well.
        assert_eq!(review.reasons, ["mirrored"]);
        let rejected = doubted(Evidence {
            inlier_share: 0.05,
            ..good()
        });
        assert_eq!(rejected.verdict, Verdict::Rejected);
        assert_eq!(rejected.reasons.len(), 2);
        let mut accepted = judge(&good(), &options);
        accepted.doubt(Vec::new());
        assert_eq!(accepted, judge(&good(), &options));
    }
}
