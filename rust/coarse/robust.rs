//! The robust search: many starts, quick descents, few verifications.
//!
//! Every length is a share of the extent of the smaller cloud, which is the one that moves: it is
//! the cloud that has to find its place. Starts are rotations × places; each runs down into its
//! basin on a nearest-point grid; the best distinct basins are refined and ranked by how far both
//! clouds agree. Where the best pose does not stand out, the round is repeated with more starts.
//! Source: ours; measured in docs/robust_search.md.

use serde::{Deserialize, Serialize};

use super::descent::{self, Shrinking};
use super::starts;
use super::{Candidate, CoarseResult, differ};
use crate::cloud::Point;
use crate::distance_field::NearestGrid;
use crate::error::{Error, Result, require_count, require_positive};
use crate::fitness::{Agreement, Tolerance, Witnesses, agreement, off_plane_noise_m};
use crate::near_field::NearField;
use crate::parallel;
use crate::progress::{Event, Progress, Stage};
use crate::random::Stream;
use crate::rigid::Rigid;
use crate::surface_cloud::SurfaceCloud;

/// How hard the robust search tries.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RobustSearchOptions {
    /// Rotations of each round; the next round is only begun while the best pose does not stand
    /// out. At least one round of at least one rotation.
    pub rotations_per_round: Vec<usize>,
    /// Poses of each round that are refined and verified; at least 1.
    pub n_verified: usize,
}

impl Default for RobustSearchOptions {
    fn default() -> Self {
        Self {
            rotations_per_round: vec![240, 960],
            n_verified: 32,
        }
    }
}

impl RobustSearchOptions {
    pub(crate) fn check(&self) -> Result<()> {
        let rounds = &self.rotations_per_round;
        require_count(
            "the length of coarse.rotations_per_round",
            rounds.len(),
            1,
            1000,
        )?;
        for n in rounds {
            require_count("coarse.rotations_per_round", *n, 1, 100_000)?;
        }
        require_count("coarse.n_verified", self.n_verified, 1, 10_000)?;
        Ok(())
    }
}

const CELL: f64 = 1.0 / 64.0;
const GRID_MARGIN: f64 = 0.15;
const MAX_CELLS: usize = 2_000_000;
/// The near field: as fine as the voxels, and far enough for verification.
const FINE_CELL: f64 = 1.0 / 250.0;
const REACH_OF_FIELD: f64 = 0.0125;
const MAX_BLOCKS: usize = 4_000_000;

/// Points of the moving cloud that take part in the first descent, the second, the refinement on
/// the grid and the last one.
const N_FIRST: usize = 64;
const N_SECOND: usize = 256;
const N_REFINED: usize = 1500;
const N_FINISHED: usize = 1500;
/// Witnesses of the cloud with fewer points, and how far, as a share of the unit, each looks round.
pub(crate) const N_WITNESSES: usize = 4000;
pub(crate) const WITNESS_RADIUS: f64 = 0.035;

/// Poses that go on to the second descent.
const N_SHORTLIST: usize = 300;
/// Poses refined with exact partners at the end of a round.
const N_FINALISTS: usize = 4;
const MAX_FINISHING_TURNS: usize = 10;

const FIRST: Shrinking = Shrinking {
    first: 0.2,
    last: 0.06,
    n_steps: 6,
};
const SECOND: Shrinking = Shrinking {
    first: 0.1,
    last: 0.04,
    n_steps: 9,
};
const REFINE_POINTS: Shrinking = Shrinking {
    first: 0.06,
    last: 0.03,
    n_steps: 10,
};
const REFINE_PLANES: Shrinking = Shrinking {
    first: 0.03,
    last: 0.015,
    n_steps: 7,
};
const REFINE_EXACTLY: Shrinking = Shrinking {
    first: 0.05,
    last: 0.006,
    n_steps: 24,
};

/// Truncation of the cost that ranks the first descents, and the second ones.
const FIRST_TRUNCATION: f64 = 0.06;
const SECOND_TRUNCATION: f64 = 0.02;
/// A partner farther away than this does not verify a pose.
const VERIFY_DISTANCE: f64 = 0.01;

/// Clouds that match exactly are still not compared more closely than this.
const LEAST_OFF_PLANE: f64 = 0.0005;
/// Rivals that are compared with the best pose; the next ones scored less in the first count.
const N_RIVALS: usize = 8;

/// Poses closer than this to a better one are the same basin.
const SAME_BASIN_RAD: f64 = 8.0 * std::f64::consts::PI / 180.0;
const SAME_BASIN: f64 = 0.03;
/// Poses closer than this to the best one are the best one, not its rival.
const SAME_POSE_RAD: f64 = 5.0 * std::f64::consts::PI / 180.0;
const SAME_POSE: f64 = 0.02;

const PITCH: [f64; 2] = [0.2, 0.15];
const REACH: f64 = 0.4;
const JITTER: f64 = 0.05;
/// Points of the fixed cloud from which places are derived.
const N_PLACES_FROM: usize = 4000;

/// When a pose stands out, so that the search may end.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StandingOut {
    /// Above this share of inliers.
    pub inlier_share: f64,
    /// And above this score by that of the best rival.
    pub ambiguity_ratio: f64,
    /// And above this product of both.
    pub share_times_ratio: f64,
}

/// Finds the pose of `source` in `target`. Both should be voxel-uniform, with the same voxel;
/// `unit_m` is the length that all lengths of the search are shares of: the extent of the smaller
/// cloud. Rounds are added until the best pose is `enough`.
///
/// # Errors
/// [`Error::InvalidArgument`] for options out of range; [`Error::NoSolution`] where no start led
/// anywhere; [`Error::Cancelled`].
pub fn search_robust(
    source: &Witnesses<'_>,
    target: &Witnesses<'_>,
    unit_m: f64,
    options: &RobustSearchOptions,
    enough: StandingOut,
    seed: u64,
    progress: &Progress<'_>,
) -> Result<CoarseResult> {
    options.check()?;
    require_positive("unit_m", unit_m)?;
    let source_moves = source.cloud.len() <= target.cloud.len();
    let (moving, fixed) = if source_moves {
        (source, target)
    } else {
        (target, source)
    };
    let mut search = Search::new(moving, fixed, unit_m, seed)?;
    // The pose that the files already have is always among the candidates.
    let as_given =
        Rigid::identity().between_local_coordinates(moving.cloud.origin, fixed.cloud.origin);
    let mut given = vec![as_given, Rigid::identity()];
    for (round, n_rotations) in options.rotations_per_round.iter().enumerate() {
        let mut poses = search.descend(round, *n_rotations, progress)?;
        poses.truncate(options.n_verified);
        poses.append(&mut given);
        search.verify(&poses, progress)?;
        if search.stands_out(enough) {
            break;
        }
    }
    search.finish(source_moves)
}

struct Verified {
    pose: Rigid,
    agreement: Agreement,
    /// Whether it was refined with exact partners.
    is_final: bool,
}

struct Search<'a> {
    moving: &'a SurfaceCloud,
    fixed: &'a SurfaceCloud,
    witnesses: [&'a Witnesses<'a>; 2],
    moving_grid: NearestGrid,
    fixed_grid: NearestGrid,
    /// Close to the moving cloud and close to the fixed one.
    fields: [NearField; 2],
    unit_m: f64,
    seed: u64,
    verified: Vec<Verified>,
    history: Vec<f64>,
    n_evaluations: usize,
    n_rounds: usize,
}

impl<'a> Search<'a> {
    fn new(
        moving: &'a Witnesses<'a>,
        fixed: &'a Witnesses<'a>,
        unit_m: f64,
        seed: u64,
    ) -> Result<Self> {
        let witnesses = [moving, fixed];
        let [moving, fixed] = witnesses.map(|w| w.cloud);
        let grid = |cloud: &SurfaceCloud| {
            NearestGrid::new(
                cloud.points(),
                CELL * unit_m,
                GRID_MARGIN * unit_m,
                MAX_CELLS,
            )
            .ok_or_else(|| Error::NoSolution {
                reason: "a cloud without points has no pose".into(),
            })
        };
        let field = |cloud: &SurfaceCloud| {
            NearField::new(
                cloud.points(),
                FINE_CELL * unit_m,
                REACH_OF_FIELD * unit_m,
                MAX_BLOCKS,
            )
            .ok_or_else(|| Error::NoSolution {
                reason: "a cloud without points has no pose".into(),
            })
        };
        Ok(Self {
            moving,
            fixed,
            witnesses,
            moving_grid: grid(moving)?,
            fixed_grid: grid(fixed)?,
            fields: [field(moving)?, field(fixed)?],
            unit_m,
            seed,
            verified: Vec::new(),
            history: Vec::new(),
            n_evaluations: 0,
            n_rounds: 0,
        })
    }

    /// One round of starts, down to distinct basins, best first.
    fn descend(
        &mut self,
        round: usize,
        n_rotations: usize,
        progress: &Progress<'_>,
    ) -> Result<Vec<Rigid>> {
        self.n_rounds = round + 1;
        let (seed, unit_m) = (self.seed, self.unit_m);
        let round_index = round as u64;
        let rotations = starts::rotations(
            n_rotations,
            &mut Stream::new(seed, "rotations", round_index),
        );
        let pitch = PITCH[round.min(PITCH.len() - 1)];
        let places = starts::anchors(
            self.fixed.sample(N_PLACES_FROM),
            pitch * unit_m,
            REACH * unit_m,
        );
        let n_starts = rotations.len() * places.len();
        let points = self.moving.points();
        let n_first = N_FIRST.min(points.len());
        let n_samples = points.len() / n_first;
        let first = parallel::map_cheap(n_starts, progress, |i| {
            let mut stream = Stream::new(seed, "jitter", (round_index << 32) + i as u64);
            // Every start looks at other points, so that no unlucky sample spoils them all.
            let few = &points[i % n_samples * n_first..][..n_first];
            let place = places[i / rotations.len()];
            let start = Rigid {
                rotation: rotations[i % rotations.len()],
                translation: place.map(|v| v + JITTER * unit_m * stream.normal()).into(),
            };
            let pose = descent::to_points(few, &self.fixed_grid, start, FIRST.times(unit_m));
            Scored {
                cost: descent::truncated_cost(
                    few,
                    &self.fixed_grid,
                    &pose,
                    FIRST_TRUNCATION * unit_m,
                ),
                pose,
            }
        })?;
        let shortlist = distinct(first, N_SHORTLIST, SAME_BASIN * unit_m);
        // Both clouds at the density at which the second sample shows the moving one.
        let some_moving = self.moving.sample(N_SECOND);
        let share = some_moving.len() as f64 / self.moving.len() as f64;
        let some_fixed = self
            .fixed
            .sample((self.fixed.len() as f64 * share).ceil() as usize);
        let second = parallel::map(shortlist.len(), |i| {
            let pose = descent::to_points(
                some_moving,
                &self.fixed_grid,
                shortlist[i].pose,
                SECOND.times(unit_m),
            );
            let forth = descent::truncated_cost(
                some_moving,
                &self.fixed_grid,
                &pose,
                SECOND_TRUNCATION * unit_m,
            );
            let back = self.missed_share(some_fixed, &pose, some_moving.len());
            Scored {
                cost: forth + back,
                pose,
            }
        });
        self.n_evaluations += n_starts * (FIRST.n_steps + 1) + second.len() * (SECOND.n_steps + 2);
        Ok(distinct(second, usize::MAX, SAME_BASIN * unit_m)
            .into_iter()
            .map(|s| s.pose)
            .collect())
    }

    /// The way back of the symmetric cost: how much of the moving cloud's size in fixed points
    /// finds no partner. A fixed cloud larger than the moving one is not blamed for the rest.
    fn missed_share(&self, fixed: &[Point], pose: &Rigid, n_moving: usize) -> f64 {
        let back = pose.inverse();
        let max_sq = (SECOND_TRUNCATION * self.unit_m).powi(2);
        let grid = &self.moving_grid;
        let found: f64 = fixed
            .iter()
            .map(|p| back.apply(p))
            .filter(|p| grid.covers(p))
            .map(|p| 1.0 - grid.nearest(&p).1.min(max_sq) / max_sq)
            .sum();
        1.0 - found / n_moving as f64
    }

    /// Refines `poses`, counts the agreement at each, and refines the best of all rounds further.
    fn verify(&mut self, poses: &[Rigid], progress: &Progress<'_>) -> Result<()> {
        let points = self.moving.sample(N_REFINED);
        let (surfaces, grid, unit_m) = (&self.moving.surfaces, &self.fixed_grid, self.unit_m);
        let refined = parallel::map(poses.len(), |i| {
            progress.check()?;
            let pose = descent::to_points(points, grid, poses[i], REFINE_POINTS.times(unit_m));
            let pose = descent::to_planes_on_grid(
                points,
                surfaces,
                grid,
                pose,
                REFINE_PLANES.times(unit_m),
            );
            Ok(self.verified(pose, false))
        });
        // Somebody may have said stop meanwhile: then nothing more is told.
        let refined = refined.into_iter().collect::<Result<Vec<_>>>()?;
        let n_refined = refined.len();
        for (i, verified) in refined.into_iter().enumerate() {
            let best = self
                .history
                .last()
                .copied()
                .unwrap_or(0.0)
                .max(verified.agreement.score);
            self.history.push(best);
            self.verified.push(verified);
            progress.emit(&Event::Advanced {
                stage: Stage::Coarse,
                done: i + 1,
                total: n_refined,
                best: Some(best),
            })?;
        }
        self.n_evaluations += poses.len() * (REFINE_POINTS.n_steps + REFINE_PLANES.n_steps + 1);
        self.rank();
        self.finish_leaders(progress)?;
        let best = self.best().map_or(0.0, |v| v.agreement.score);
        let before = self.history.last().copied().unwrap_or(0.0);
        self.history.push(best.max(before));
        Ok(())
    }

    /// Refines the leading poses with exact partners until the best one and its best rival are
    /// refined: a pose that slides into the best one was no rival.
    fn finish_leaders(&mut self, progress: &Progress<'_>) -> Result<()> {
        for _ in 0..MAX_FINISHING_TURNS {
            let leaders: Vec<Rigid> = self
                .distinct_verified()
                .take(N_FINALISTS)
                .filter(|v| !v.is_final)
                .map(|v| v.pose)
                .collect();
            if leaders.is_empty() {
                break;
            }
            let points = self.moving.sample(N_FINISHED);
            let finished = parallel::map(leaders.len(), |i| {
                progress.check()?;
                let pose = descent::to_planes_nearby(
                    points,
                    &self.moving.surfaces,
                    &self.fields[1],
                    &self.fixed_grid,
                    leaders[i],
                    REFINE_EXACTLY.times(self.unit_m),
                );
                Ok(self.verified(pose, true))
            });
            self.n_evaluations += leaders.len() * (REFINE_EXACTLY.n_steps + 1);
            // What was refined replaces what it was refined from.
            self.verified.retain(|v| !leaders.contains(&v.pose));
            for verified in finished {
                self.verified.push(verified?);
            }
            self.rank();
        }
        Ok(())
    }

    fn verified(&self, pose: Rigid, is_final: bool) -> Verified {
        let agreement = self.agreement(&pose, Tolerance::within(VERIFY_DISTANCE * self.unit_m));
        Verified {
            pose,
            agreement,
            is_final,
        }
    }

    fn rank(&mut self) {
        self.verified
            .sort_by(|a, b| b.agreement.score.total_cmp(&a.agreement.score));
    }

    fn best(&self) -> Option<&Verified> {
        self.verified.first()
    }

    /// Verified poses, best first, each clearly different from every better one.
    fn distinct_verified(&self) -> impl Iterator<Item = &Verified> {
        let mut kept: Vec<&Verified> = Vec::new();
        for verified in &self.verified {
            if kept.iter().all(|k| {
                differ(
                    &k.pose,
                    &verified.pose,
                    SAME_POSE_RAD,
                    SAME_POSE * self.unit_m,
                )
            }) {
                kept.push(verified);
            }
        }
        kept.into_iter()
    }

    fn agreement(&self, pose: &Rigid, tolerance: Tolerance) -> Agreement {
        agreement(
            (self.witnesses[0], &self.fields[0]),
            (self.witnesses[1], &self.fields[1]),
            pose,
            tolerance,
        )
    }

    /// Score of the best pose by that of its best rival, both at the accuracy that the clouds show
    /// at the best pose: at a wrong pose they lie off each other's planes and leave room for rivals.
    fn ambiguity_ratio(&self) -> f64 {
        let Some(best) = self.best() else {
            return f64::NAN;
        };
        let distance_m = VERIFY_DISTANCE * self.unit_m;
        let [moving, fixed] = self.witnesses;
        let noise_m = off_plane_noise_m(moving, (fixed, &self.fields[1]), &best.pose, distance_m);
        let off_plane_m = noise_m.clamp(LEAST_OFF_PLANE * self.unit_m, distance_m);
        let tolerance = Tolerance {
            distance_m,
            off_plane_m,
        };
        let poses: Vec<Rigid> = self
            .distinct_verified()
            .take(N_RIVALS + 1)
            .map(|v| v.pose)
            .collect();
        let scores = parallel::map(poses.len(), |i| self.agreement(&poses[i], tolerance).score);
        let rival = scores[1..].iter().copied().fold(0.0, f64::max);
        if rival > 0.0 {
            scores[0] / rival
        } else {
            f64::INFINITY
        }
    }

    fn stands_out(&self, enough: StandingOut) -> bool {
        let share = self.best().map_or(0.0, |v| v.agreement.inlier_share);
        if share <= enough.inlier_share {
            return false;
        }
        let ratio = self.ambiguity_ratio();
        ratio > enough.ambiguity_ratio && share * ratio > enough.share_times_ratio
    }

    fn finish(self, source_moves: bool) -> Result<CoarseResult> {
        const MAX_CANDIDATES: usize = 8;
        let candidates: Vec<Candidate> = self
            .distinct_verified()
            .filter(|v| v.agreement.score > 0.0)
            .take(MAX_CANDIDATES)
            .map(|v| Candidate {
                target_from_source: if source_moves {
                    v.pose
                } else {
                    v.pose.inverse()
                },
                score: v.agreement.score,
                inlier_share: v.agreement.inlier_share,
            })
            .collect();
        if candidates.is_empty() {
            return Err(Error::NoSolution {
                reason: format!(
                    "at none of {} poses did any point of one cloud find a partner in the other: \
                     do both files show the same place, in the same unit?",
                    self.n_evaluations
                ),
            });
        }
        Ok(CoarseResult {
            ambiguity_ratio: self.ambiguity_ratio(),
            candidates,
            n_evaluations: self.n_evaluations,
            history: self.history,
            n_rounds: self.n_rounds,
            unit_m: self.unit_m,
        })
    }
}

struct Scored {
    cost: f64,
    pose: Rigid,
}

/// The best of each basin, best first, at most `max`; basins are a distance or an angle apart.
fn distinct(mut scored: Vec<Scored>, max: usize, distance: f64) -> Vec<Scored> {
    // A stable sort: of equals the first one wins, whatever the number of threads.
    scored.sort_by(|a, b| a.cost.total_cmp(&b.cost));
    let mut kept: Vec<Scored> = Vec::new();
    for candidate in scored {
        if kept.len() == max {
            break;
        }
        if kept
            .iter()
            .all(|k| differ(&k.pose, &candidate.pose, SAME_BASIN_RAD, distance))
        {
            kept.push(candidate);
        }
    }
    kept
}
