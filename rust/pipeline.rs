//! The route on one page: what happens to two clouds, in the order of the paper's flowchart.
//!
//! outliers → voxel → keypoints → coarse → icp → verdict → evaluate, and then fuse.

mod apart;
mod doubts;
mod fine;
mod prepare;
mod search;
mod strays;
mod thin;

use fine::{Fine, brought_to_rest, brought_to_rest_without_strays, rests_on_strays};
use prepare::{Prepared, cropped};
use thin::Thinned;

pub use apart::{Evaluation, evaluate, fuse_clouds};

use crate::cloud::{Cloud, Point};
use crate::coarse::CoarseResult;
use crate::config::{Config, Mode};
use crate::deadline::Deadline;
use crate::error::{Error, Result};
use crate::evaluate::{DistanceStatistics, share_within};
use crate::freedom::Freedom;
use crate::icp::IcpStop;
use crate::neighbors::NeighborIndex;
use crate::outlier::remove_outliers;
use crate::parallel;
use crate::progress::{Progress, Stage};
use crate::registration::{Registration, StageLog};
use crate::similarity::Similarity;
use crate::verdict::{Evidence, Rival, Strength, Verdict, judge};

/// Voxels along the extent of the smaller cloud, where no edge is asked for.
pub const VOXELS_PER_EXTENT: f64 = 250.0;
/// A pose that leads its rivals by more is not doubted: whether the source is mirrored is not tried.
const CLEAR_AMBIGUITY_RATIO: f64 = 5.0;
const ON_STRAYS: &str = "strays of the one cloud lie on strays of the other, and surfaces do not lie on surfaces: remove \
    the points that belong to no surface from both files, or give a prior";
/// A partner within so many voxels supports the pose, where no distance is asked for.
pub const SUPPORT_IN_VOXELS: f64 = 2.5;

/// Registers `source` onto `target`: no targets, no initial guess, no numbers needed.
///
/// # Errors
/// [`Error::TooFewPoints`], [`Error::Degenerate`], [`Error::CoordinateTooLarge`] for clouds
/// without a pose; [`Error::InvalidArgument`], [`Error::VoxelTooSmall`] for settings;
/// [`Error::NoSolution`]; [`Error::Cancelled`]. A wrong pose is no error: read the verdict.
///
/// ```
/// use tmchho::{Rigid, config::Config, pipeline::register, progress::Progress, verdict::Verdict};
/// // A bumpy field, and the same field elsewhere.
/// let target: Vec<[f64; 3]> = (0..6400)
///     .map(|i| (f64::from(i % 80), f64::from(i / 80)))
///     .map(|(x, y)| [x, y, 4.0 * (0.13 * x).sin() * (0.21 * y).cos() + 3.0 * (0.002 * x * y).sin()])
///     .collect();
/// let away = Rigid::from_euler([0.5, -2.0, 1.0], [300.0, -20.0, 7.0]);
/// let source: Vec<[f64; 3]> = target.iter().map(|p| away.apply(p)).collect();
/// let found = register(&source, &target, &Config::default(), &Progress::silent())?;
/// let back = found.target_from_source.apply(&source[0]);
/// assert!(back.iter().zip(&target[0]).all(|(a, b)| (a - b).abs() < 1e-3));
/// assert_eq!(found.verdict, Verdict::Accepted);
/// # Ok::<(), tmchho::Error>(())
/// ```
pub fn register(
    source: &[Point],
    target: &[Point],
    config: &Config,
    progress: &Progress<'_>,
) -> Result<Registration> {
    config.check()?;
    parallel::with_threads(config.n_threads, || {
        let (source, target) = parallel::both(
            || Cloud::named("source cloud", source),
            || Cloud::named("target cloud", target),
        );
        route(&source?, &target?, config, progress)
    })
}

fn route(
    source: &Cloud,
    target: &Cloud,
    config: &Config,
    progress: &Progress<'_>,
) -> Result<Registration> {
    let deadline = Deadline::after(config.coarse.max_seconds);
    let mut config = config.clone();
    let mut log = StageLog::new(progress);

    log.begin(Stage::Outliers, source.len(), target.len())?;
    let (source_index, target_index) = parallel::both(
        || NeighborIndex::new(source.points()),
        || NeighborIndex::new(target.points()),
    );
    let (source_cleaned, target_cleaned) = parallel::both(
        || remove_outliers(source, &source_index, &config.outliers, progress),
        || remove_outliers(target, &target_index, &config.outliers, progress),
    );
    let (source_cleaned, target_cleaned) = (source_cleaned?, target_cleaned?);
    let outlier_radius_m = (source_cleaned.radius_m, target_cleaned.radius_m);
    let mut source_cleaned = source_cleaned.cloud;
    let mut target_cleaned = target_cleaned.cloud;
    if let Some(corners) = &config.source_crop_m {
        source_cleaned = cropped("source cloud", &source_cleaned, corners)?;
    }
    if let Some(corners) = &config.target_crop_m {
        target_cleaned = cropped("target cloud", &target_cleaned, corners)?;
    }
    log.end(source_cleaned.len(), target_cleaned.len());

    let mut best: Option<(Prepared, CoarseResult)> = None;
    let scales = search::scales(&config)?;
    let enough = search::enough(&config).early();
    let search_config = match scales.len() {
        1 => config.clone(),
        _ => search::at_each_scale(&config),
    };
    for scale in scales {
        log.begin(Stage::Voxel, source_cleaned.len(), target_cleaned.len())?;
        let thinned = Thinned::new(&source_cleaned, &target_cleaned, scale, &config, progress)?;
        let found = search::search_also_without_strays(
            thinned,
            &search_config,
            deadline,
            &mut log,
            progress,
        );
        let (prepared, found) = match found {
            // At another scale there may be a pose.
            Err(Error::NoSolution { .. }) if config.dof == Freedom::Similarity => continue,
            Err(Error::NoSolution { reason }) if config.mode == Mode::Robust => {
                let clouds = [&source_cleaned, &target_cleaned];
                let quiet = progress.quietly();
                let prepared = Prepared::new(clouds[0], clouds[1], scale, &config, &quiet)?;
                let doubts = doubts::doubts(&prepared, clouds, 0.0, &config, deadline, progress)?;
                let reason = [vec![reason], doubts].concat().join("; ");
                return Err(Error::NoSolution { reason });
            }
            other => other?,
        };
        log.keep();
        let stands_out = found.stands_out(enough);
        let merit = search::merit(&found);
        if best.as_ref().is_none_or(|(_, b)| merit > search::merit(b)) {
            best = Some((prepared, found));
        }
        if stands_out {
            break;
        }
    }
    let (mut prepared, mut found) = best.ok_or_else(|| {
        let [least, most] = config.scale_bounds;
        Error::NoSolution {
            reason: format!(
                "at no scale between {least} and {most} did any point of one cloud find a partner in \
                 the other: widen scale_bounds if the unit of the source is another one"
            ),
        }
    })?;
    let mut coarse_pose = found.candidates[0].target_from_source;
    let mut candidates = candidates_of(&prepared, &found);
    if config.dof == Freedom::Similarity {
        // The same voxel for both clouds, now that their scale is known.
        let (pose, _) = candidates[0];
        log.begin(Stage::Voxel, source_cleaned.len(), target_cleaned.len())?;
        prepared = Prepared::new(
            &source_cleaned,
            &target_cleaned,
            pose.scale,
            &config,
            progress,
        )?;
        log.end(prepared.source.cloud.len(), prepared.target.cloud.len());
        coarse_pose = prepared.pose_from_given(&pose);
    }
    let voxel_size_m = prepared.thinned.voxel_size_m;
    let max_distance_m = config
        .icp
        .max_distance_m
        .unwrap_or(SUPPORT_IN_VOXELS * voxel_size_m);
    config.resolve(voxel_size_m, max_distance_m);

    let clouds = [&source_cleaned, &target_cleaned];
    let mut fine = brought_to_rest(
        &prepared,
        &coarse_pose,
        max_distance_m,
        &config,
        &mut log,
        progress,
    )?;
    if fine.lies_apart(&prepared, &config) {
        let without = brought_to_rest_without_strays(
            &prepared,
            &fine,
            max_distance_m,
            &config,
            &mut log,
            progress,
        )?;
        if let Some((cleaned, again)) = without {
            (prepared, fine) = (cleaned, again);
        }
    }
    let on_strays = |prepared: &Prepared, fine: &Fine| {
        rests_on_strays(prepared, fine, max_distance_m, &config, progress)
    };
    let mut rests_on_strays = on_strays(&prepared, &fine)?;
    if rests_on_strays {
        let (n_source, n_target) = (prepared.source.cloud.len(), prepared.target.cloud.len());
        match search::search_without_strays(
            &prepared.thinned,
            &config,
            deadline,
            &mut log,
            progress,
        )? {
            Some((cleaned, again)) => {
                (prepared, found) = (cleaned, again);
                candidates = candidates_of(&prepared, &found);
                let pose = found.candidates[0].target_from_source;
                fine = brought_to_rest(
                    &prepared,
                    &pose,
                    max_distance_m,
                    &config,
                    &mut log,
                    progress,
                )?;
                rests_on_strays = on_strays(&prepared, &fine)?;
            }
            None => log.begin(Stage::Verdict, n_source, n_target)?,
        }
    }
    let (pose, agreed, known) = (fine.pose, fine.agreed, prepared.known(&config.known)?);
    let [support, support_back] = &fine.supports;
    let strength = Strength::new(
        &support.planes.information(),
        support.planes.weight(),
        support.radius_m,
    );
    let weakest_error = fine.uncertainty.as_ref().map_or(f64::NAN, |uncertainty| {
        let rigid = uncertainty.covariance.fixed_view::<6, 6>(0, 0);
        strength.standard_error(&rigid.into_owned())
    });
    let lead_over_chance = found.candidates[0].score / found.chance_score;
    let target_from_source = prepared.pose_to_given(&pose);
    let evidence = Evidence {
        inlier_share: agreed.inlier_share,
        ambiguity_ratio: found.ambiguity_ratio,
        rival: candidates.get(1).map(|(rival, _)| {
            let middle = prepared.source_pivot();
            Rival::between(&target_from_source, rival, &middle)
        }),
        strength,
        weakest_error,
        lead_over_chance,
        held_out_ratio: fine.held_out_ratio,
        misfit: agreed.misfit,
        conflict_share: agreed.conflict_share,
        net_share: agreed.net_share(),
        surface_offset_m: fine.surface_offset_m,
        extent_m: prepared.thinned.unit_m,
        deviation_from_known: match known.n_observed() {
            0 => f64::NAN,
            n => (known.chi_squared(&pose) / n as f64).sqrt(),
        },
        scale_at_bound: config.dof == Freedom::Similarity
            && is_at_bound(target_from_source.scale, &config.scale_bounds),
        ended_early: found.ended_early,
        converged: fine.icp.stop_reason == IcpStop::Converged,
    };
    let mut judgement = judge(&evidence, &config.verdict);
    if rests_on_strays {
        judgement.doubt(vec![ON_STRAYS.into()]);
    }
    let is_clear =
        judgement.verdict == Verdict::Accepted && found.ambiguity_ratio > CLEAR_AMBIGUITY_RATIO;
    if !is_clear && config.mode == Mode::Robust {
        let doubts = doubts::doubts(
            &prepared,
            clouds,
            search::merit(&found),
            &config,
            deadline,
            progress,
        )?;
        judgement.doubt(doubts);
    }
    log.keep();

    // Room for the distances: the clouds that the verdict was about are not read again.
    drop((source_cleaned, target_cleaned));
    log.begin(Stage::Evaluate, source.len(), target.len())?;
    let (source_pivot, target_pivot) = (prepared.source_pivot(), prepared.target_pivot());
    let about_pivots = prepared.about_pivots(&pose);
    let (source_to_target, target_to_source) = distances(
        &source_index,
        &target_index,
        &target_from_source.between_local_coordinates(source.origin(), target.origin()),
        progress,
    )?;
    let (of_forth, of_back) = parallel::both(
        || statistics(&source_to_target),
        || statistics(&target_to_source),
    );
    log.keep();

    Ok(Registration {
        target_from_source,
        about_pivots,
        source_pivot,
        target_pivot,
        verdict: judgement.verdict,
        reasons: judgement.reasons,
        fitness: support.n_inliers as f64 / prepared.source.cloud.len() as f64,
        inlier_rmse_m: support.inlier_rmse_m,
        inlier_rmse_back_m: support_back.inlier_rmse_m,
        n_inliers: support.n_inliers,
        overlap_of_source: share_within(&source_to_target, max_distance_m),
        overlap_of_target: share_within(&target_to_source, max_distance_m),
        inlier_share: agreed.inlier_share,
        ambiguity_ratio: found.ambiguity_ratio,
        least_ambiguity_ratio: evidence.least_ambiguity_ratio(&config.verdict),
        strength,
        candidates,
        lead_over_chance,
        held_out_ratio: fine.held_out_ratio,
        misfit: agreed.misfit,
        conflict_share: agreed.conflict_share,
        net_share: agreed.net_share(),
        surface_offset_m: fine.surface_offset_m,
        most_surface_offset_m: evidence.most_surface_offset_m(&config.verdict),
        extent_m: prepared.thinned.unit_m,
        ended_early: found.ended_early,
        uncertainty: fine.uncertainty,
        n_evaluations: found.n_evaluations,
        history: found.history,
        icp_stop: fine.icp.stop_reason,
        n_icp_iterations: fine.icp.n_iterations,
        icp_history: fine.icp.history,
        source_to_target: of_forth?,
        target_to_source: of_back?,
        n_non_finite: (source.n_non_finite(), target.n_non_finite()),
        outlier_radius_m,
        voxel_size_m,
        max_distance_m,
        stages: log.records,
        config,
    })
}

/// The poses that the search found, between the clouds that were given, and their scores.
fn candidates_of(prepared: &Prepared, found: &CoarseResult) -> Vec<(Similarity, f64)> {
    let candidates = found.candidates.iter();
    candidates
        .map(|c| (prepared.pose_to_given(&c.target_from_source), c.score))
        .collect()
}

fn is_at_bound(scale: f64, [low, high]: &[f64; 2]) -> bool {
    const NEAR: f64 = 0.005;
    scale < low * (1.0 + NEAR) || scale > high * (1.0 - NEAR)
}

/// From every point of each cloud to the nearest of the other: source to target, and back.
fn distances(
    source: &NeighborIndex,
    target: &NeighborIndex,
    target_from_source: &Similarity,
    progress: &Progress<'_>,
) -> Result<(Vec<f64>, Vec<f64>)> {
    let source_from_target = target_from_source.inverse();
    let forth = source.places().moved(|p| target_from_source.apply(p));
    let forth = target.distances_to(&forth, progress)?;
    let back = target.places().moved(|p| source_from_target.apply(p));
    let back = source.distances_to(&back, progress)?;
    // Both are told in the target's unit.
    let scale = target_from_source.scale;
    let back = match scale {
        1.0 => back,
        _ => back.into_iter().map(|distance| scale * distance).collect(),
    };
    Ok((forth, back))
}

fn statistics(distances_m: &[f64]) -> Result<DistanceStatistics> {
    DistanceStatistics::from_distances(distances_m).ok_or_else(|| Error::NoSolution {
        reason: "there are no distances".into(),
    })
}
