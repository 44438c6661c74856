//! The route on one page: what happens to two clouds, in the order of the paper's flowchart.
//!
//! outliers → voxel → keypoints → coarse → icp → verdict → evaluate, and then fuse.

mod apart;
mod doubts;
mod prepare;
mod search;
mod strays;

use prepare::{Prepared, cropped};

pub use apart::{Evaluation, evaluate, fuse_clouds};

use crate::cloud::{Cloud, Point};
use crate::coarse::CoarseResult;
use crate::config::{Config, Mode};
use crate::deadline::Deadline;
use crate::error::{Error, Result};
use crate::evaluate::{DistanceStatistics, share_within};
use crate::fitness::{self, Support, Tolerance, agreement};
use crate::freedom::Freedom;
use crate::icp::{Clouds, IcpResult, IcpStop, icp};
use crate::neighbors::NeighborIndex;
use crate::observations::LocalObservations;
use crate::outlier::remove_outliers;
use crate::parallel;
use crate::progress::{Progress, Stage};
use crate::registration::{Registration, StageLog};
use crate::similarity::Similarity;
use crate::surface_cloud::SurfaceCloud;
use crate::verdict::{Evidence, Rival, Strength, Verdict, judge};

/// Voxels along the extent of the smaller cloud, where no edge is asked for.
pub const VOXELS_PER_EXTENT: f64 = 250.0;
/// The fine pose is kept unless the clouds agree by less than this share of what they did before: where noise is
/// as large as a voxel, the score changes by a twentieth by chance.
const LEAST_KEPT: f64 = 0.9;
/// A pose that leads its rivals by more is not doubted: whether the source is mirrored is not tried.
const CLEAR_AMBIGUITY_RATIO: f64 = 5.0;
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
        let prepared = Prepared::new(&source_cleaned, &target_cleaned, scale, &config, progress)?;
        log.end(prepared.source.cloud.len(), prepared.target.cloud.len());
        let found = search::search_also_without_strays(
            prepared,
            [&source_cleaned, &target_cleaned],
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
    let (mut prepared, found) = best.ok_or_else(|| {
        let [least, most] = config.scale_bounds;
        Error::NoSolution {
            reason: format!(
                "at no scale between {least} and {most} did any point of one cloud find a partner in \
                 the other: widen scale_bounds if the unit of the source is another one"
            ),
        }
    })?;
    let mut coarse_pose = found.candidates[0].target_from_source;
    let candidates: Vec<(Similarity, f64)> = found
        .candidates
        .iter()
        .map(|c| (prepared.pose_to_given(&c.target_from_source), c.score))
        .collect();
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
    let voxel_size_m = prepared.voxel_size_m;
    let max_distance_m = config
        .icp
        .max_distance_m
        .unwrap_or(SUPPORT_IN_VOXELS * voxel_size_m);
    config.resolve(voxel_size_m, max_distance_m);

    let (source_surface, target_surface) = (&prepared.source.cloud, &prepared.target.cloud);
    log.begin(Stage::Icp, source_surface.len(), target_surface.len())?;
    let known = prepared.known(&config.known)?;
    let fine = refine(&prepared, &coarse_pose, &known, &config, progress)?;
    log.keep();

    log.begin(Stage::Verdict, source_surface.len(), target_surface.len())?;
    let tolerance = Tolerance::within(max_distance_m);
    let agreed = |pose: &Similarity| {
        agreement(
            (&prepared.source, &source_surface.index),
            (&prepared.target, &target_surface.index),
            pose,
            tolerance,
        )
    };
    let (before, after) =
        parallel::both(|| agreed(&coarse_pose), || agreed(&fine.target_from_source));
    // Robust mode keeps ICP's pose only where it is no worse, or where it heeds what is known; the
    // paper always takes it.
    let takes_fine = config.mode == Mode::Paper || !known.is_empty();
    let (pose, agreed, uncertainty) = if takes_fine || after.score() >= LEAST_KEPT * before.score()
    {
        (fine.target_from_source, after, fine.uncertainty)
    } else {
        (coarse_pose, before, None)
    };
    let clouds = [&source_cleaned, &target_cleaned];
    let most_offset_m = prepared.unit_m * config.verdict.most_surface_offset(agreed.conflict_share);
    let ((support, support_back), (surface_offset_m, held_out)) = parallel::both(
        || {
            let surfaces = [source_surface, target_surface];
            supports(surfaces, &pose, max_distance_m, progress)
        },
        || {
            parallel::both(
                || surface_offset_m(&prepared, &pose, clouds, most_offset_m, &config, progress),
                || held_out_ratio(&prepared, &pose, max_distance_m),
            )
        },
    );
    let (support, support_back, surface_offset_m) = (support?, support_back?, surface_offset_m?);
    let strength = Strength::new(
        &support.planes.information(),
        support.planes.weight(),
        support.radius_m,
    );
    let weakest_error = uncertainty.as_ref().map_or(f64::NAN, |uncertainty| {
        let rigid = uncertainty.covariance.fixed_view::<6, 6>(0, 0);
        strength.standard_error(&rigid.into_owned())
    });
    let lead_over_chance = found.candidates[0].score / found.chance_score;
    let target_from_source = prepared.pose_to_given(&pose);
    let mut judgement = judge(
        &Evidence {
            inlier_share: agreed.inlier_share,
            ambiguity_ratio: found.ambiguity_ratio,
            rival: candidates.get(1).map(|(rival, _)| {
                let middle = prepared.source_pivot();
                Rival::between(&target_from_source, rival, &middle)
            }),
            strength,
            weakest_error,
            lead_over_chance,
            held_out_ratio: held_out,
            misfit: agreed.misfit,
            conflict_share: agreed.conflict_share,
            net_share: agreed.net_share(),
            surface_offset_m,
            extent_m: prepared.unit_m,
            deviation_from_known: match known.n_observed() {
                0 => f64::NAN,
                n => (known.chi_squared(&pose) / n as f64).sqrt(),
            },
            scale_at_bound: config.dof == Freedom::Similarity
                && is_at_bound(target_from_source.scale, &config.scale_bounds),
            ended_early: found.ended_early,
            converged: fine.stop_reason == IcpStop::Converged,
        },
        &config.verdict,
    );
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
        fitness: support.n_inliers as f64 / source_surface.len() as f64,
        inlier_rmse_m: support.inlier_rmse_m,
        inlier_rmse_back_m: support_back.inlier_rmse_m,
        n_inliers: support.n_inliers,
        overlap_of_source: share_within(&source_to_target, max_distance_m),
        overlap_of_target: share_within(&target_to_source, max_distance_m),
        inlier_share: agreed.inlier_share,
        ambiguity_ratio: found.ambiguity_ratio,
        strength,
        candidates,
        lead_over_chance,
        held_out_ratio: held_out,
        misfit: agreed.misfit,
        conflict_share: agreed.conflict_share,
        net_share: agreed.net_share(),
        surface_offset_m,
        extent_m: prepared.unit_m,
        ended_early: found.ended_early,
        uncertainty,
        n_evaluations: found.n_evaluations,
        history: found.history,
        icp_stop: fine.stop_reason,
        n_icp_iterations: fine.n_iterations,
        icp_history: fine.history,
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

/// Brings the coarse pose to rest: the paper's ICP, or point-to-plane on the overlap. The points that were
/// drawn last are held out in robust mode.
fn refine(
    prepared: &Prepared,
    coarse_pose: &Similarity,
    known: &LocalObservations,
    config: &Config,
    progress: &Progress<'_>,
) -> Result<IcpResult> {
    /// The pose is right to less than this, in the unit: what stands farther beyond the box of the target than that and the
    /// reach finds no partner, as does most of a source of many times the area.
    const MOST_MOVED: f64 = 0.05;
    let (source, target) = (&prepared.source.cloud, &prepared.target.cloud);
    let fitted = match config.mode {
        Mode::Robust => {
            let mut fitted = source.drawn_in_order(n_fitted(source.len()));
            let reach_m = config.icp.max_distance_m.unwrap_or(f64::INFINITY);
            let margin_m = reach_m + MOST_MOVED * prepared.unit_m;
            let is_near = |i: &u32| {
                let moved = coarse_pose.apply(&source.points()[*i as usize]);
                target.is_near_box(&moved, margin_m)
            };
            fitted.retain(is_near);
            fitted
        }
        Mode::Paper => source.drawn_in_order(source.len()),
    };
    let surfaces: Vec<_> = fitted
        .iter()
        .map(|i| source.surfaces[*i as usize])
        .collect();
    let clouds = Clouds {
        source: &source.points_of(&fitted),
        source_surfaces: &surfaces,
        target: &target.index,
        target_surfaces: &target.surfaces,
    };
    icp(
        &clouds,
        coarse_pose,
        config.dof,
        known,
        &config.icp,
        progress,
    )
}

/// What of each cloud lies on the other.
fn supports(
    [source, target]: [&SurfaceCloud; 2],
    pose: &Similarity,
    max_distance_m: f64,
    progress: &Progress<'_>,
) -> (Result<Support>, Result<Support>) {
    let back = (pose.inverse(), max_distance_m / pose.scale);
    parallel::both(
        || fitness::support(source, target, pose, max_distance_m, progress),
        || fitness::support(target, source, &back.0, back.1, progress),
    )
}

/// How far even surfaces lie apart; where that is above `most_m`, and the clouds are strewn, without their strays if it was
/// these that shifted the means of surfaces.
fn surface_offset_m(
    prepared: &Prepared,
    pose: &Similarity,
    [source, target]: [&Cloud; 2],
    most_m: f64,
    config: &Config,
    progress: &Progress<'_>,
) -> Result<f64> {
    let of = |prepared: &Prepared, pose: &Similarity| {
        let (source, target) = (&prepared.source.cloud, &prepared.target.cloud);
        fitness::surface_offset_m(source, target, pose, prepared.unit_m, progress)
    };
    let offset_m = of(prepared, pose)?;
    if offset_m > most_m && prepared.is_strewn(progress)? {
        let cleaned = prepared.without_strays(source, target, config, progress)?;
        if let Some(cleaned) = cleaned {
            let pose = cleaned.pose_from_given(&prepared.pose_to_given(pose));
            let cleaned_m = of(&cleaned, &pose)?;
            // A part of the noise goes with the strays, so a little less proves nothing.
            if cleaned_m < 0.5 * offset_m {
                return Ok(cleaned_m);
            }
        }
    }
    Ok(offset_m)
}

/// One point in ten is held out.
fn n_fitted(n: usize) -> usize {
    n - n / 10
}

/// Root mean squared distance of the pairs of points that were held out, by that of the others.
fn held_out_ratio(prepared: &Prepared, pose: &Similarity, max_distance_m: f64) -> f64 {
    /// Fewer pairs tell nothing.
    const LEAST_PAIRS: usize = 30;
    let (source, index) = (&prepared.source.cloud, &prepared.target.cloud.index);
    let rms = |numbers: &[u32]| {
        let max_sq = max_distance_m * max_distance_m;
        let points = source.points_of(numbers);
        let found = parallel::map(points.len(), |i| {
            index.nearest_within(&pose.apply(&points[i]), max_sq)
        });
        let found = found.into_iter().flatten();
        let (n, sum) = found.fold((0, 0.0), |(n, sum), pair| (n + 1, sum + pair.distance_sq));
        (n >= LEAST_PAIRS).then(|| (sum / n as f64).sqrt())
    };
    let drawn = source.drawn(source.len());
    let (fitted, held_out) = drawn.split_at(n_fitted(drawn.len()));
    // As many of the others are looked at as were held out.
    match (
        rms(held_out),
        rms(&fitted[..held_out.len().min(fitted.len())]),
    ) {
        (Some(held_out), Some(fitted)) if fitted > 0.0 => held_out / fitted,
        _ => f64::NAN,
    }
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
