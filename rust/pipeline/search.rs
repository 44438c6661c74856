//! Stage 4 of the route: the search that the mode asks for, at one scale or at several.

use std::ops::ControlFlow;

use super::prepare::Prepared;
use super::thin::Thinned;
use crate::cloud::{Cloud, Point};
use crate::coarse::{self, CoarseResult, Problem, StandingOut};
use crate::config::{Config, Mode};
use crate::deadline::Deadline;
use crate::error::{Error, Result};
use crate::fitness::Witnesses;
use crate::freedom::Freedom;
use crate::keypoints::{self, RADIUS_IN_VOXELS};
use crate::neighbors::NeighborIndex;
use crate::observations::Observations;
use crate::progress::{Progress, Stage};
use crate::registration::StageLog;

/// Scales that are searched lie at most so many times apart: the refinement of poses bridges half.
const SCALE_STEP: f64 = 1.2;
const ROUNDS_AT_EACH_SCALE: usize = 2;
/// Beyond this a lead over the rivals says nothing more about which scale is right.
const FULL_LEAD: f64 = 3.0;

/// How far a pose from the search may lie off the best one, in radians and as a share of the unit.
const SLACK_RAD: f64 = 0.02;
const SLACK: f64 = 0.01;

/// When a pose stands out so that the search may end: the verdict would accept it.
pub(super) fn enough(config: &Config) -> StandingOut {
    StandingOut {
        inlier_share: config.verdict.accept_inlier_share,
        ambiguity_ratio: config.verdict.accept_ambiguity_ratio,
        share_times_ratio: config.verdict.accept_share_times_ratio,
        misfit: config.verdict.accept_misfit,
        conflict_share: config.verdict.accept_conflict_share,
    }
}

/// Finds the pose between the prepared clouds; `log` is told of the stages.
pub(super) fn search(
    prepared: &Prepared,
    config: &Config,
    deadline: Deadline,
    log: &mut StageLog<'_>,
    progress: &Progress<'_>,
) -> Result<CoarseResult> {
    let (n_source, n_target) = (prepared.source.cloud.len(), prepared.target.cloud.len());
    if config.mode == Mode::Paper {
        log.begin(Stage::Keypoints, n_source, n_target)?;
        let of_source = (&prepared.thinned.source.cloud, prepared.source.cloud.origin);
        let of_target = (&prepared.thinned.target.cloud, prepared.target.cloud.origin);
        let voxel_size_m = prepared.thinned.voxel_size_m;
        let source = keypoints(of_source.0, of_source.1, voxel_size_m, config, progress)?;
        let target = keypoints(of_target.0, of_target.1, voxel_size_m, config, progress)?;
        log.end(source.len(), target.len());
        log.begin(Stage::Coarse, source.len(), target.len())?;
        return coarse::search_paper(&source, &target, &config.paper, config.seed, progress);
    }
    log.begin(Stage::Coarse, n_source, n_target)?;
    let goes_on = || Ok(ControlFlow::Continue(()));
    search_asking(prepared, config, deadline, goes_on, progress)
}

/// The same, and between these clouds without strays: before their surfaces are looked at where the search is long and
/// either is full of strays, else after a few rounds where there are many, else where nothing stands out after all.
/// With the clouds of the better answer.
pub(super) fn search_also_without_strays(
    thinned: Thinned,
    config: &Config,
    deadline: Deadline,
    log: &mut StageLog<'_>,
    progress: &Progress<'_>,
) -> Result<(Prepared, CoarseResult)> {
    if !may_have_strays(config) {
        let prepared = prepared(thinned, config, log, progress)?;
        let found = search(&prepared, config, deadline, log, progress)?;
        return Ok((prepared, found));
    }
    let enough = enough(config);
    // Noise of one sensor alone may look like strays: that only a few rounds can tell.
    let are_asked_first = config.known.is_empty()
        && thinned.has_many_places()
        && thinned.are_both_strewn(progress)?;
    let mut without = None;
    if are_asked_first {
        log.end(thinned.source.len(), thinned.target.len());
        match search_without_strays(&thinned, config, deadline, log, progress)? {
            Some((cleaned, found)) if found.stands_out(enough) => return Ok((cleaned, found)),
            other => without = Some(other),
        }
        log.begin(Stage::Voxel, thinned.source.len(), thinned.target.len())?;
    }
    let prepared = prepared(thinned, config, log, progress)?;
    let (n_source, n_target) = (prepared.source.cloud.len(), prepared.target.cloud.len());
    log.begin(Stage::Coarse, n_source, n_target)?;
    let look_without = || {
        if without.is_some() || !prepared.thinned.is_strewn(progress)? {
            return Ok(ControlFlow::Continue(()));
        }
        let other = search_without_strays(&prepared.thinned, config, deadline, log, progress)?;
        let stands_out = matches!(&other, Some((_, found)) if found.stands_out(enough));
        without = Some(other);
        if stands_out {
            return Ok(ControlFlow::Break(()));
        }
        log.begin(Stage::Coarse, n_source, n_target)?;
        Ok(ControlFlow::Continue(()))
    };
    let found = match search_asking(&prepared, config, deadline, look_without, progress) {
        Err(Error::NoSolution { reason }) => Err(reason),
        found => Ok(found?),
    };
    let is_enough = |found: &CoarseResult| found.stands_out(enough) || found.ended_early;
    let without = match without {
        Some(other) => other,
        None if found.as_ref().is_ok_and(is_enough) => None,
        None => search_without_strays(&prepared.thinned, config, deadline, log, progress)?,
    };
    match (found, without) {
        (Ok(found), Some(other)) if merit(&other.1) > merit(&found) => Ok(other),
        (Ok(found), _) => Ok((prepared, found)),
        (Err(_), Some(other)) => Ok(other),
        (Err(reason), None) => Err(Error::NoSolution { reason }),
    }
}

/// The search between the clouds without strays; `None` where that changes nothing, or where no start led
/// anywhere.
pub(super) fn search_without_strays(
    thinned: &Thinned,
    config: &Config,
    deadline: Deadline,
    log: &mut StageLog<'_>,
    progress: &Progress<'_>,
) -> Result<Option<(Prepared, CoarseResult)>> {
    log.keep();
    let Some(cleaned) = without_strays(thinned, config, log, progress)? else {
        return Ok(None);
    };
    let found = match search(&cleaned, config, deadline, log, progress) {
        Ok(found) => Some((cleaned, found)),
        Err(Error::NoSolution { .. }) => None,
        Err(other) => return Err(other),
    };
    log.keep();
    Ok(found)
}

/// The clouds without strays; `None` where that changes nothing. `log` is told of the stage.
pub(super) fn without_strays(
    thinned: &Thinned,
    config: &Config,
    log: &mut StageLog<'_>,
    progress: &Progress<'_>,
) -> Result<Option<Prepared>> {
    let (n_source, n_target) = (thinned.source.len(), thinned.target.len());
    log.begin(Stage::Voxel, n_source, n_target)?;
    match thinned.without_strays(progress)? {
        Some(cleaned) => prepared(cleaned, config, log, progress).map(Some),
        None => {
            log.end(n_source, n_target);
            Ok(None)
        }
    }
}

/// The thinned clouds with their surfaces, which ends the stage of voxels.
fn prepared(
    thinned: Thinned,
    config: &Config,
    log: &mut StageLog<'_>,
    progress: &Progress<'_>,
) -> Result<Prepared> {
    let prepared = Prepared::of(thinned, config, progress)?;
    log.end(prepared.source.cloud.len(), prepared.target.cloud.len());
    Ok(prepared)
}

/// The robust search, which asks after a few rounds whether to go on.
fn search_asking(
    prepared: &Prepared,
    config: &Config,
    deadline: Deadline,
    goes_on: impl FnMut() -> Result<ControlFlow<()>>,
    progress: &Progress<'_>,
) -> Result<CoarseResult> {
    let (angle_rad, shift_m) = (SLACK_RAD, SLACK * prepared.thinned.unit_m);
    let known = prepared.known(&config.known.loosened(angle_rad, shift_m))?;
    let problem = Problem {
        source: &prepared.source,
        target: &prepared.target,
        unit_m: prepared.thinned.unit_m,
        freedom: config.dof,
        known: &known,
    };
    coarse::search_asking(
        &problem,
        &config.coarse,
        enough(config),
        deadline,
        config.seed,
        goes_on,
        progress,
    )
}

/// The robust search of a source in a target, where nothing is known of the pose.
pub(super) fn search_from_nothing(
    [source, target]: [&Witnesses; 2],
    unit_m: f64,
    config: &Config,
    deadline: Deadline,
    progress: &Progress<'_>,
) -> Result<CoarseResult> {
    let known = Observations::default().about([0.0; 3], [0.0; 3])?;
    let problem = Problem {
        source,
        target,
        unit_m,
        freedom: config.dof,
        known: &known,
    };
    let options = &config.coarse;
    coarse::search_robust(
        &problem,
        options,
        enough(config),
        deadline,
        config.seed,
        progress,
    )
}

fn keypoints(
    cloud: &Cloud,
    about: Point,
    voxel_size_m: f64,
    config: &Config,
    progress: &Progress<'_>,
) -> Result<Vec<Point>> {
    let radius_m = RADIUS_IN_VOXELS * voxel_size_m;
    let index = NeighborIndex::new(cloud.points());
    let found = keypoints::detect(cloud, &index, &config.keypoints, radius_m, progress)?;
    let local = |i: &u32| {
        let p = cloud.points()[*i as usize];
        std::array::from_fn(|axis| p[axis] + (cloud.origin()[axis] - about[axis]))
    };
    Ok(found.indices.iter().map(local).collect())
}

/// Whether strays may be why nothing stands out: not where somebody said what a stray is.
pub(super) fn may_have_strays(config: &Config) -> bool {
    config.mode == Mode::Robust
        && config.dof != Freedom::Similarity
        && config.outliers.radius_m.is_none()
}

/// The scales at which the search is begun: 1, what control points say, or evenly spaced over the
/// bounds, and then between these.
pub(super) fn scales(config: &Config) -> Result<Vec<f64>> {
    if config.dof != Freedom::Similarity {
        return Ok(vec![1.0]);
    }
    let [low, high] = config.scale_bounds;
    let known = config.known.about([0.0; 3], [0.0; 3])?;
    if let Some(measured) = known.pose_from_control_points(config.dof) {
        return Ok(vec![measured.target_from_source.scale]);
    }
    if low == high {
        return Ok(vec![low]);
    }
    let n = ((high / low).ln() / SCALE_STEP.ln()).ceil().max(1.0);
    let at = |step: f64| low * (high / low).powf(step / n);
    let likeliest_first = |mut scales: Vec<f64>| {
        scales.sort_by(|a, b| a.ln().abs().total_cmp(&b.ln().abs()));
        scales
    };
    let all_over = (0..n as usize).map(|i| at(i as f64 + 0.5)).collect();
    // Where little overlaps, a scale half a step off may lead nowhere: then one of these is close.
    let between = (0..=n as usize).map(|i| at(i as f64)).collect();
    Ok([likeliest_first(all_over), likeliest_first(between)].concat())
}

/// The settings for one of several scales: whether a pose stands out shows in the first rounds at the
/// right one.
pub(super) fn at_each_scale(config: &Config) -> Config {
    let mut config = config.clone();
    config
        .coarse
        .rotations_per_round
        .truncate(ROUNDS_AT_EACH_SCALE);
    config
}

/// How well a search at one scale went, to be compared with others.
pub(super) fn merit(found: &CoarseResult) -> f64 {
    let lead = found.ambiguity_ratio;
    found.inlier_share()
        * if lead.is_nan() {
            1.0
        } else {
            lead.min(FULL_LEAD)
        }
}
