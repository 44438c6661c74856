//! The robust search: many starts, quick descents, few verifications.
//!
//! Every length is a share of the extent of the smaller cloud, which is the one that moves: it is
//! the cloud that has to find its place, however many points it has. Starts are rotations × places; each runs down into its
//! basin on a nearest-point grid; the best distinct basins are refined and ranked by how far both
//! clouds agree. Where the best pose does not stand out, another round tries more starts.
//! Source: ours; measured in docs/robust_search.md.

use std::ops::ControlFlow;

use super::explore::{Descents, Explorer};
use super::facing::most_faced;
use super::hypotheses;
use super::motion::{Motion, Uprights};
use super::starts::{self, Starts};
use super::verify::{Knowledge, Verifier};
use super::{Candidate, CoarseResult, RobustSearchOptions};
use crate::cloud::Point;
use crate::deadline::Deadline;
use crate::error::{Error, Result, require_positive};
use crate::fitness::{Agreement, Witnesses};
use crate::freedom::Freedom;
use crate::neighbors::some_through_tree;
use crate::observations::LocalObservations;
use crate::parallel;
use crate::progress::Progress;
use crate::random::Stream;
use crate::rigid::Rigid;
use crate::surface_cloud::SurfaceCloud;

/// Witnesses of the smaller cloud, and how far, as a share of the unit, each looks round.
pub(crate) const N_WITNESSES: usize = 3000;
pub(crate) const WITNESS_RADIUS: f64 = 0.035;

/// Starts round a pose that is known.
const N_NEAR_KNOWN: usize = 64;

/// Rounds that cost little, unless there are many places.
const FEW_ROUNDS: usize = 2;
/// From so many places on descriptors come first, and no round costs little.
const MANY_PLACES: usize = 200;
/// Early rounds look at this share of the poses of the others.
const EARLY: usize = 4;
/// After early rounds, which have met few rivals, the best pose must stand out by more, also from itself turned.
const EARLY_RATIO: f64 = 3.0;
const EARLY_SHARE_TIMES_RATIO: f64 = 2.0;

/// When a pose stands out, so that the search may end.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StandingOut {
    /// Above this share of inliers.
    pub inlier_share: f64,
    /// And above this score by that of the best rival.
    pub ambiguity_ratio: f64,
    /// And above this product of the net share and the ratio.
    pub share_times_ratio: f64,
    /// And not above this misfit; one that is NaN is none.
    pub misfit: f64,
    /// And not above this share of conflicts.
    pub conflict_share: f64,
}

impl StandingOut {
    /// The same for a search that has met few rivals yet.
    pub fn early(self) -> Self {
        Self {
            ambiguity_ratio: self.ambiguity_ratio.max(EARLY_RATIO),
            share_times_ratio: self.share_times_ratio.max(EARLY_SHARE_TIMES_RATIO),
            ..self
        }
    }

    /// Whether a pose where the clouds agree so far, and that leads its rivals by that ratio, stands out.
    pub fn is_met_by(&self, agreement: &Agreement, ratio: f64) -> bool {
        let share = agreement.inlier_share;
        let lies_apart = agreement.misfit > self.misfit;
        let conflicts = agreement.conflict_share > self.conflict_share;
        share > self.inlier_share
            && ratio > self.ambiguity_ratio
            && agreement.net_share() * ratio > self.share_times_ratio
            && !lies_apart
            && !conflicts
    }
}

/// Whether `source` is the cloud that has to find its place in `target`: it shows clearly less of the site, or about as
/// much with fewer points.
fn is_to_move(source: &Witnesses, target: &Witnesses) -> bool {
    /// A cloud of so many times the other's size shows more.
    const CLEARLY: usize = 2;
    let has_fewer_points = source.cloud.len() <= target.cloud.len();
    let shows_less = CLEARLY * source.size < target.size;
    let shows_more = CLEARLY * target.size < source.size;
    shows_less || (has_fewer_points && !shows_more)
}

/// Where the poses of a round come from.
#[derive(Debug, Clone, Copy)]
enum Round {
    /// So many rotations times a few of the places where the moving cloud may belong.
    Brief { n_rotations: usize },
    /// So many rotations times all of those places.
    Starts { index: usize, n_rotations: usize },
    /// Points whose surroundings look alike.
    Descriptors,
    /// As though up were up in both clouds, as it is in nearly all surveys: so many rotations would be as
    /// dense where more is free.
    Upright { n_rotations: usize },
    /// As though what most surface of each cloud faces were up, in one of them perhaps down.
    Level { n_rotations: usize },
}

impl Round {
    /// Whether it is wide enough to meet the rivals of the best pose.
    fn is_wide(&self) -> bool {
        matches!(self, Self::Starts { index: 1.., .. })
    }
}

/// Few starts find most poses. Where they do not, yaws cost less than descriptors, and these less than more
/// starts of all that is free; among many places they cost less than any starts.
fn rounds(options: &RobustSearchOptions, freedom: Freedom, n_places: usize) -> Vec<Round> {
    let counts = options.rotations_per_round.iter().enumerate();
    let mut rounds: Vec<Round> = counts
        .map(|(index, &n_rotations)| Round::Starts { index, n_rotations })
        .collect();
    let is_levelled = freedom == Freedom::Levelled;
    if let (Some(&n_rotations), false) = (options.rotations_per_round.get(1), is_levelled) {
        // No poses where that is up as given.
        rounds.insert(1, Round::Level { n_rotations });
        rounds.insert(2, Round::Upright { n_rotations });
    }
    // It may spare a long search, not a short one.
    if let [n_rotations, _, ..] = options.rotations_per_round[..] {
        rounds.insert(0, Round::Brief { n_rotations });
    }
    if options.descriptors {
        let (is_wide, last) = (Round::is_wide, rounds.len());
        let at = match is_levelled {
            true => last,
            false if n_places >= MANY_PLACES => 0,
            false => rounds.iter().position(is_wide).unwrap_or(last),
        };
        rounds.insert(at, Round::Descriptors);
    }
    rounds
}

/// Frames in which what most surface of each cloud faces is up, and those in which it is down in one of them. None
/// where that is up as given in both, or cannot be told.
fn level_ways(
    moving: &SurfaceCloud,
    fixed: &SurfaceCloud,
    unit_m: f64,
    progress: &Progress<'_>,
) -> Result<Vec<Uprights>> {
    /// Within 3° of z.
    const UP: f64 = 0.9986;
    let (of_moving, of_fixed) = parallel::both(
        || most_faced(moving, unit_m, progress),
        || most_faced(fixed, unit_m, progress),
    );
    let (Some(of_moving), Some(of_fixed)) = (of_moving?, of_fixed?) else {
        return Ok(Vec::new());
    };
    if of_moving[2].abs().min(of_fixed[2].abs()) > UP {
        return Ok(Vec::new());
    }
    let ways = [of_moving, of_moving.map(|v| -v)];
    Ok(ways.map(|up| Uprights::new(&up, &of_fixed)).to_vec())
}

/// Two clouds whose pose is sought. Both should be voxel-uniform, with the same voxel.
#[derive(Debug, Clone, Copy)]
pub struct Problem<'a> {
    /// The cloud that moves onto the other.
    pub source: &'a Witnesses,
    /// The cloud that stays.
    pub target: &'a Witnesses,
    /// The length that all lengths of the search are shares of: the extent of the smaller cloud.
    pub unit_m: f64,
    /// What may differ between the clouds.
    pub freedom: Freedom,
    /// What is known of the pose from source to target, as loosely as the search is coarse.
    pub known: &'a LocalObservations,
}

/// Finds the pose of the source in the target. Rounds are added until the best pose is `enough`,
/// or until the deadline.
///
/// # Errors
/// [`Error::InvalidArgument`] for options out of range; [`Error::NoSolution`] where no start led
/// anywhere; [`Error::Cancelled`].
pub fn search_robust(
    problem: &Problem<'_>,
    options: &RobustSearchOptions,
    enough: StandingOut,
    deadline: Deadline,
    seed: u64,
    progress: &Progress<'_>,
) -> Result<CoarseResult> {
    let goes_on = || Ok(ControlFlow::Continue(()));
    search_asking(problem, options, enough, deadline, seed, goes_on, progress)
}

/// Whether the search in a cloud of these points, sorted so that those that follow each other lie side by side, is long
/// from the first round on: there are many places where the other may belong.
pub(crate) fn has_many_places(sorted: &[Point], unit_m: f64) -> bool {
    let some = some_through_tree(sorted, starts::N_TO_TELL_PLACES);
    starts::n_places(&some, unit_m) >= MANY_PLACES
}

/// [`search_robust`], which asks after a few rounds whether to go on, as other clouds may be better searched.
/// On a break it ends there.
pub(crate) fn search_asking(
    problem: &Problem<'_>,
    options: &RobustSearchOptions,
    enough: StandingOut,
    deadline: Deadline,
    seed: u64,
    mut goes_on: impl FnMut() -> Result<ControlFlow<()>>,
    progress: &Progress<'_>,
) -> Result<CoarseResult> {
    options.check()?;
    let unit_m = require_positive("unit_m", problem.unit_m)?;
    let source_moves = is_to_move(problem.source, problem.target);
    let (moving, fixed) = if source_moves {
        (problem.source, problem.target)
    } else {
        (problem.target, problem.source)
    };
    let explorer = Explorer::new(&moving.cloud, &fixed.cloud, unit_m)?;
    let free = Motion::Free(problem.freedom);
    let (brief, few, many) = (
        Descents::of_fewest(free),
        Descents::of_few(free),
        Descents::of_many(free),
    );
    let mut verifier = Verifier::new(
        moving,
        fixed,
        [&explorer.moving_grid, &explorer.fixed_grid],
        Knowledge {
            known: problem.known,
            source_moves,
        },
        unit_m,
        problem.freedom,
    )?;
    let (mut n_explored, mut n_rounds) = (0, 0);
    let known = problem.known.starts(problem.freedom);
    let known: Vec<Rigid> = known
        .iter()
        .map(|pose| match source_moves {
            true => pose.rigid,
            false => pose.inverse().rigid,
        })
        .collect();
    let n_early = options.n_verified.div_ceil(EARLY);
    let mut stands_out = false;
    if !known.is_empty() {
        let start = |i: usize| {
            let mut stream = Stream::new(seed, "known", i as u64);
            starts::near(
                &known[i % known.len()],
                unit_m,
                problem.freedom,
                &mut stream,
            )
        };
        let n_starts = N_NEAR_KNOWN * known.len();
        let (mut basins, n_poses) = explorer.basins(n_starts, start, few, deadline, progress)?;
        n_explored += n_poses;
        basins.truncate(options.n_verified);
        let poses = [known.clone(), basins].concat();
        verifier.look_at(&poses, known.len(), free, deadline, progress)?;
        stands_out = verifier.stands_out(enough, n_early, deadline, progress)?;
    }
    let mut run_down = |starts: &Starts, descents: Descents, n_taken: usize| {
        let start = |i| starts.pose(i);
        let (mut basins, n_poses) =
            explorer.basins(starts.len(), start, descents, deadline, progress)?;
        n_explored += n_poses;
        basins.truncate(n_taken);
        Ok::<_, Error>(basins)
    };
    // The pose that the files already have is always among the candidates.
    let as_given =
        Rigid::identity().between_local_coordinates(moving.cloud.origin, fixed.cloud.origin);
    let mut given = vec![as_given, Rigid::identity()];
    let n_places = starts::n_places(&starts::sample(&fixed.cloud), unit_m);
    let rounds = rounds(options, problem.freedom, n_places);
    let mut has_met_rivals = false;
    for (i, round) in rounds.iter().enumerate() {
        if stands_out || (n_rounds > 0 && deadline.is_over()) {
            break;
        }
        if n_rounds == FEW_ROUNDS && goes_on()?.is_break() {
            break;
        }
        n_rounds += 1;
        has_met_rivals |= round.is_wide() || i + 1 == rounds.len();
        let mut upright = |uprights: &Uprights, n_rotations: usize, purpose: &'static str| {
            let starts =
                Starts::upright(&fixed.cloud, unit_m, uprights, n_rotations, purpose, seed);
            let motion = Motion::Upright(*uprights);
            let found = run_down(&starts, Descents::of_many(motion), options.n_verified)?;
            Ok::<_, Error>((motion, found))
        };
        let found = match *round {
            Round::Brief { n_rotations } => {
                let starts = Starts::few(&fixed.cloud, unit_m, problem.freedom, n_rotations, seed);
                vec![(free, run_down(&starts, brief, n_early.div_ceil(2))?)]
            }
            Round::Starts { index, n_rotations } => {
                let which = (index, n_rotations);
                let starts = Starts::new(&fixed.cloud, unit_m, problem.freedom, which, seed);
                let (descents, n_taken) = match round.is_wide() {
                    true => (many, options.n_verified),
                    false => (few, n_early),
                };
                vec![(free, run_down(&starts, descents, n_taken)?)]
            }
            Round::Upright { n_rotations } => {
                vec![upright(
                    &Uprights::as_given(),
                    n_rotations,
                    "jitter of upright",
                )?]
            }
            Round::Level { n_rotations } => {
                let ways = level_ways(&moving.cloud, &fixed.cloud, unit_m, progress)?;
                let purposes = ["jitter of level", "jitter of level upside down"];
                let both = ways.iter().zip(purposes);
                both.map(|(uprights, purpose)| upright(uprights, n_rotations, purpose))
                    .collect::<Result<_>>()?
            }
            Round::Descriptors => {
                let (moving, fixed) = (&moving.cloud, &fixed.cloud);
                let proposed =
                    hypotheses::propose(moving, fixed, unit_m, problem.freedom, progress)?;
                // Where nothing was looked at before, they are the rivals, too.
                let n_taken = match i {
                    0 => options.n_verified,
                    _ => 2 * n_early,
                };
                let poses = proposed.iter().take(n_taken).map(|h| h.pose);
                vec![(free, poses.collect())]
            }
        };
        for (motion, poses) in found {
            let n_certain = given.len();
            let poses = [std::mem::take(&mut given), poses].concat();
            verifier.look_at(&poses, n_certain, motion, deadline, progress)?;
        }
        if has_met_rivals {
            stands_out = verifier.stands_out(enough, n_early, deadline, progress)?;
            continue;
        }
        // A room or a box fits as well or nearly so turned about itself, which few starts have met yet.
        let wanted = enough.early();
        if let Some(best) = verifier.standing_out(wanted) {
            let starts = Starts::turned(&best, unit_m, problem.freedom, seed);
            let turned = run_down(&starts, brief, n_early)?;
            verifier.look_at(&turned, 0, free, deadline, progress)?;
            stands_out = verifier.stands_out(wanted, n_early, deadline, progress)?;
        }
    }
    const MAX_CANDIDATES: usize = 8;
    let n_evaluations = n_explored + verifier.n_evaluations;
    let candidates: Vec<Candidate> = verifier
        .distinct()
        .filter(|v| v.agreement.score() > 0.0)
        .take(MAX_CANDIDATES)
        .map(|v| Candidate {
            target_from_source: match source_moves {
                true => v.pose,
                false => v.pose.inverse(),
            },
            score: v.agreement.score(),
            agreement: v.agreement,
        })
        .collect();
    if candidates.is_empty() {
        return Err(Error::NoSolution {
            reason: format!(
                "at none of {n_evaluations} poses did any point of one cloud find a partner in the \
                 other{}: do both files show the same place, in the same unit?",
                match problem.known.is_empty() {
                    true => "",
                    false => " and the pose agree with what was said to be known of it",
                }
            ),
        });
    }
    Ok(CoarseResult {
        ambiguity_ratio: verifier.ambiguity_ratio,
        chance_score: verifier.chance_score(seed),
        candidates,
        n_evaluations,
        history: verifier.history,
        n_rounds,
        ended_early: !stands_out && deadline.is_over(),
        unit_m,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cloud::{Cloud, Point};

    /// A bumpy strip, 1 wide.
    fn strip(length: f64, n: usize) -> SurfaceCloud {
        let mut stream = Stream::new(1, "strip", n as u64);
        let points: Vec<Point> = (0..n)
            .map(|_| [length * stream.uniform(), stream.uniform()])
            .map(|[x, y]| [x, y, 0.1 * (9.0 * x).sin() * (7.0 * y).cos()])
            .collect();
        SurfaceCloud::new(&Cloud::new(&points).unwrap(), 0, &Progress::silent()).unwrap()
    }

    #[test]
    fn it_asks_once_after_a_few_rounds_and_keeps_what_it_found() {
        let silent = Progress::silent();
        let clouds = [1.0, 1.2].map(|length| strip(length, (4000.0 * length) as usize));
        let [source, target] = Witnesses::of_both(clouds, 500, 0.1, 0.01, &silent).unwrap();
        let known = LocalObservations::default();
        let problem = Problem {
            source: &source,
            target: &target,
            unit_m: 1.4,
            freedom: Freedom::Rigid,
            known: &known,
        };
        // Nothing would be enough.
        let enough = StandingOut {
            inlier_share: 9.0,
            ambiguity_ratio: 9.0,
            share_times_ratio: 9.0,
            misfit: 0.0,
            conflict_share: 0.0,
        };
        let options = RobustSearchOptions::default();
        let found = |answer: ControlFlow<()>| {
            let mut n_asked = 0;
            let goes_on = || {
                n_asked += 1;
                Ok(answer)
            };
            let never = Deadline::after(None);
            let found = search_asking(&problem, &options, enough, never, 1, goes_on, &silent);
            (n_asked, found.unwrap().n_evaluations)
        };
        let (n_of_few, few) = found(ControlFlow::Break(()));
        let (n_of_all, all) = found(ControlFlow::Continue(()));
        assert_eq!((n_of_few, n_of_all), (1, 1));
        assert!(few > 0 && 2 * few < all);
    }

    #[test]
    fn a_cloud_of_many_times_the_other_has_many_places() {
        let has_many = |length| has_many_places(strip(length, 20_000).points(), 1.4);
        assert!(!has_many(1.2) && has_many(16.0));
    }

    #[test]
    fn what_shows_clearly_less_moves_else_what_has_fewer_points() {
        let moves = |source: SurfaceCloud, target: SurfaceCloud| {
            let clouds = [source, target];
            let [a, b] = Witnesses::of_both(clouds, 500, 0.1, 0.01, &Progress::silent()).unwrap();
            (is_to_move(&a, &b), is_to_move(&b, &a))
        };
        // Eight times the area with half of the points, which are sparser than the voxels.
        assert_eq!(moves(strip(1.0, 8000), strip(8.0, 4000)), (true, false));
        assert_eq!(moves(strip(1.0, 8000), strip(1.2, 4000)), (false, true));
    }

    #[test]
    fn what_costs_more_is_tried_later() {
        let kinds = |freedom, n_places| -> Vec<&str> {
            rounds(&RobustSearchOptions::default(), freedom, n_places)
                .iter()
                .map(|round| match round {
                    Round::Brief { .. } => "brief",
                    Round::Starts { .. } if round.is_wide() => "wide",
                    Round::Starts { .. } => "starts",
                    Round::Upright { .. } => "upright",
                    Round::Level { .. } => "level",
                    Round::Descriptors => "descriptors",
                })
                .collect()
        };
        let of_all = ["brief", "starts", "level", "upright", "descriptors", "wide"];
        assert_eq!(kinds(Freedom::Rigid, 30), of_all);
        assert_eq!(kinds(Freedom::Similarity, 30), of_all);
        let among_many = ["descriptors", "brief", "starts", "level", "upright", "wide"];
        assert_eq!(kinds(Freedom::Rigid, 300), among_many);
        let levelled = ["brief", "starts", "wide", "descriptors"];
        assert_eq!(kinds(Freedom::Levelled, 30), levelled);
        assert_eq!(kinds(Freedom::Levelled, 300), levelled);
        let brief = RobustSearchOptions {
            rotations_per_round: vec![60],
            ..RobustSearchOptions::default()
        };
        assert_eq!(rounds(&brief, Freedom::Rigid, 30).len(), 2);
    }

    #[test]
    fn a_pose_stands_out_by_all_its_figures_and_early_by_more() {
        let wanted = StandingOut {
            inlier_share: 0.3,
            ambiguity_ratio: 1.6,
            share_times_ratio: 0.75,
            misfit: 1.3,
            conflict_share: 0.15,
        };
        let at = |inlier_share: f64, misfit: f64| Agreement {
            inlier_share,
            weighted_share: inlier_share,
            misfit,
            conflict_share: 0.0,
        };
        let is_met = |share, ratio, misfit| wanted.is_met_by(&at(share, misfit), ratio);
        assert!(is_met(0.5, 1.7, 0.9));
        assert!(!is_met(0.29, 9.0, 0.9));
        assert!(!is_met(0.9, 1.5, 0.9));
        assert!(!is_met(0.35, 1.7, 0.9));
        assert!(!is_met(0.5, 1.7, 1.4));
        // What was not measured is no reproach, a lead that was not is no lead.
        assert!(is_met(0.5, 1.7, f64::NAN));
        assert!(!is_met(0.5, f64::NAN, 0.9));
        let is_met_early = |share, ratio| wanted.early().is_met_by(&at(share, 0.9), ratio);
        assert!(is_met_early(0.8, 3.1) && is_met_early(0.4, 5.1));
        assert!(!is_met_early(0.4, 4.9) && !is_met_early(0.9, 2.9));
        let crossing = Agreement {
            conflict_share: 0.16,
            ..at(0.9, 0.9)
        };
        assert!(!wanted.is_met_by(&crossing, 9.0));
    }
}
