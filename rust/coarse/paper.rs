//! The paper's search: TMCHHO minimises the RMS of Eq. (1) over six degrees of freedom.
//!
//! Source: Ren, Zhao & Han (2023), Sections 4.3 and 4.4. Deviates: the box, because the printed
//! [−50, 50] holds hardly any solution when it is read literally; N_s is all source keypoints.

use std::f64::consts::PI;
use std::ops::ControlFlow;

use serde::{Deserialize, Serialize};

use super::{Candidate, CoarseResult};
use crate::cloud::{Point, bounds, centroid, distance_sq};
use crate::error::{Error, Result};
use crate::fitness::{Agreement, rms_below};
use crate::neighbors::NeighborIndex;
use crate::optim::{Bounds, HawkOptions, Method, Objective, StopReason};
use crate::progress::{Event, Progress, Stage};
use crate::random::Stream;
use crate::rigid::Rigid;

/// Where the six parameters may lie.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PaperBox {
    /// Angles in [−π, π]; shifts within half the target's diagonal of where the centroids meet.
    #[default]
    Centred,
    /// All six in [−50, 50], as printed: radians, and the clouds' unit.
    Literal,
}

/// How the paper's search runs.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PaperSearchOptions {
    /// The box.
    pub search_box: PaperBox,
    /// The optimiser; the paper's rivals are for its Tables 4 and 5.
    pub method: Method,
    /// The hawks; population 30 and 500 iterations by Section 5.2. Method "hho" has neither of the two
    /// improvements, whatever is said here; the methods without hawks take the size of the population
    /// and the limits alone, and refuse any other setting.
    pub hawks: HawkOptions,
}

impl PaperSearchOptions {
    pub(crate) fn check(&self) -> Result<()> {
        (self.hawks.check())
            .and_then(|()| self.method.with_hawks(&self.hawks).map(|_| ()))
            .map_err(|error| match error {
                Error::InvalidArgument { name, problem } => {
                    Error::argument(format!("paper.hawks.{name}"), problem)
                }
                other => other,
            })
    }
}

/// Finds the pose of the `source` keypoints in the `target` keypoints.
///
/// Both are turned and shifted about their centroids, so that the box does not depend on where the
/// coordinate systems have their origins.
///
/// # Errors
/// [`Error::InvalidArgument`] for options out of range; [`Error::NoSolution`] where a cloud has no
/// keypoints; [`Error::Cancelled`].
pub fn search_paper(
    source: &[Point],
    target: &[Point],
    options: &PaperSearchOptions,
    seed: u64,
    progress: &Progress<'_>,
) -> Result<CoarseResult> {
    if source.is_empty() || target.is_empty() {
        return Err(Error::NoSolution {
            reason: format!(
                "{} source and {} target keypoints were found: enlarge keypoints.radius_m",
                source.len(),
                target.len()
            ),
        });
    }
    let (source_middle, target_middle) = (centroid(source), centroid(target));
    let (low, high) = bounds(target);
    let unit_m = distance_sq(&low, &high).sqrt();
    let search_box = match options.search_box {
        PaperBox::Centred => {
            let shift = 0.5 * unit_m;
            let high = vec![PI, PI, PI, shift, shift, shift];
            Bounds::new(high.iter().map(|v| -v).collect(), high)?
        }
        PaperBox::Literal => Bounds::cube(6, -50.0, 50.0)?,
    };
    let about = |points: &[Point], middle: Point| -> Vec<Point> {
        let shifted = |p: &Point| std::array::from_fn(|axis| p[axis] - middle[axis]);
        points.iter().map(shifted).collect()
    };
    let centred = about(source, source_middle);
    let objective = RmsOfPose {
        // In random order a hopeless pose is abandoned soonest.
        source: Stream::new(seed, "order of keypoints", 0)
            .sample_indices(centred.len(), centred.len())
            .into_iter()
            .map(|i| centred[i])
            .collect(),
        target: NeighborIndex::new(&about(target, target_middle)),
    };
    let optimizer = options.method.with_hawks(&options.hawks)?;
    let found = optimizer.minimize_from(&objective, &search_box, seed, &[], &mut |report| {
        let event = Event::Advanced {
            stage: Stage::Coarse,
            done: report.n_iterations,
            total: report.max_iterations,
            best: Some(report.fun),
        };
        match progress.emit(&event) {
            Ok(()) => ControlFlow::Continue(()),
            Err(_) => ControlFlow::Break(()),
        }
    })?;
    if found.stop_reason == StopReason::Callback {
        return Err(Error::Cancelled);
    }
    Ok(CoarseResult {
        candidates: vec![Candidate {
            target_from_source: pose_of(&found.x)
                .between_given_coordinates(source_middle, target_middle)
                .into(),
            score: -found.fun,
            agreement: Agreement {
                inlier_share: f64::NAN,
                weighted_share: f64::NAN,
                misfit: f64::NAN,
                conflict_share: f64::NAN,
            },
        }],
        ambiguity_ratio: f64::NAN,
        chance_score: f64::NAN,
        n_evaluations: found.n_evaluations,
        history: found.history,
        n_rounds: found.n_iterations,
        ended_early: false,
        unit_m,
    })
}

/// Eq. (1) from the six parameters.
fn pose_of(x: &[f64]) -> Rigid {
    Rigid::from_euler([x[0], x[1], x[2]], [x[3], x[4], x[5]])
}

struct RmsOfPose {
    source: Vec<Point>,
    target: NeighborIndex,
}

impl Objective for RmsOfPose {
    fn evaluate(&self, x: &[f64]) -> f64 {
        self.evaluate_below(x, f64::INFINITY)
    }

    fn evaluate_below(&self, x: &[f64], limit: f64) -> f64 {
        rms_below(&self.source, &self.target, &pose_of(x), limit).0
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicUsize, Ordering};

    use super::*;
    use crate::parallel;

    #[test]
    fn the_reported_score_is_the_rms_at_the_reported_pose() {
        let target: Vec<Point> = (0..60)
            .map(f64::from)
            .map(|t| [(t * 0.7).sin() * 2.0, (t * 1.3).cos(), t * 0.02])
            .collect();
        let source: Vec<Point> = target
            .iter()
            .map(|p| [p[1] + 7.0, p[0], p[2] - 3.0])
            .collect();
        let mut options = PaperSearchOptions::default();
        options.hawks.n_iterations = 20;
        let mut scores = Vec::new();
        for method in Method::ALL {
            options.method = method;
            options.check().unwrap();
            let found = search_paper(&source, &target, &options, 1, &Progress::silent()).unwrap();
            let best = found.candidates[0];
            let again = crate::fitness::rms(
                &source,
                &NeighborIndex::new(&target),
                &best.target_from_source.rigid,
            );
            assert!((again + best.score).abs() < 1e-12);
            assert_eq!(found.history.len(), 20);
            scores.push(best.score);
        }
        scores.sort_by(f64::total_cmp);
        scores.dedup();
        assert_eq!(scores.len(), 7, "each method goes its own way");
        assert!(search_paper(&[], &target, &options, 1, &Progress::silent()).is_err());
    }

    /// Counts the nearest points that it seeks, abandoning poses early or not.
    struct Counted {
        rms: RmsOfPose,
        abandons: bool,
        n_searches: AtomicUsize,
    }

    impl Objective for Counted {
        fn evaluate(&self, x: &[f64]) -> f64 {
            self.evaluate_below(x, f64::INFINITY)
        }

        fn evaluate_below(&self, x: &[f64], limit: f64) -> f64 {
            let limit = if self.abandons { limit } else { f64::INFINITY };
            let (source, target) = (&self.rms.source, &self.rms.target);
            let (rms, n_searches) = rms_below(source, target, &pose_of(x), limit);
            self.n_searches.fetch_add(n_searches, Ordering::Relaxed);
            rms
        }
    }

    #[test]
    fn abandoning_poses_early_spares_searches_and_changes_nothing() {
        let mut stream = Stream::new(1, "hills", 0);
        let mut hills = |n: usize| -> Vec<Point> {
            let mut point = || [stream.uniform(), stream.uniform()].map(|v| 4.0 * v - 2.0);
            (0..n)
                .map(|_| point())
                .map(|[x, y]| [x, y, (2.0 * x).sin() * y.cos()])
                .collect()
        };
        let (source, target) = (hills(150), hills(300));
        let bounds = Bounds::cube(6, -2.0, 2.0).unwrap();
        let run = |abandons| {
            // On one thread nobody looks ahead: the count is that of the search.
            parallel::with_threads(Some(1), || {
                let objective = Counted {
                    rms: RmsOfPose {
                        source: source.clone(),
                        target: NeighborIndex::new(&target),
                    },
                    abandons,
                    n_searches: AtomicUsize::new(0),
                };
                let options = PaperSearchOptions::default();
                let optimizer = options.method.with_hawks(&options.hawks)?;
                let found = optimizer.minimize_from(&objective, &bounds, 3, &[], &mut |_| {
                    ControlFlow::Continue(())
                })?;
                Ok((found, objective.n_searches.into_inner()))
            })
            .unwrap()
        };
        let ((plain, n_all), (quick, n_sought)) = (run(false), run(true));
        assert_eq!(plain, quick);
        assert_eq!(n_all, plain.n_evaluations * source.len());
        let spared = 1.0 - n_sought as f64 / n_all as f64;
        assert!((0.1..0.9).contains(&spared), "{spared}");
    }

    #[test]
    fn what_a_method_has_not_is_refused() {
        let mut options = PaperSearchOptions {
            method: Method::Woa,
            ..PaperSearchOptions::default()
        };
        options.hawks.chaotic_start = false;
        let error = options.check().unwrap_err().to_string();
        assert!(
            error.starts_with("paper.hawks.chaotic_start is a setting of hho"),
            "{error}"
        );
        options.method = Method::Tmchho;
        options.check().unwrap();
    }
}
