//! The route on one page: what happens to two clouds, in the order of the paper's flowchart.
//!
//! outliers → voxel → keypoints → coarse → icp → verdict → evaluate, and then fuse.

mod apart;
mod prepare;
mod search;

use prepare::{Prepared, cropped};

pub use apart::{Evaluation, evaluate, fuse_clouds};

use crate::cloud::{Cloud, Point};
use crate::coarse::{CoarseResult, Deadline};
use crate::config::{Config, Mode};
use crate::error::{Error, Result};
use crate::evaluate::{DistanceStatistics, nearest_distances, share_within};
use crate::fitness::{Tolerance, agreement, support};
use crate::icp::{Clouds, IcpResult, IcpStop, icp};
use crate::neighbors::NeighborIndex;
use crate::outlier::remove_outliers;
use crate::parallel;
use crate::progress::{Progress, Stage};
use crate::registration::{Registration, StageLog};
use crate::similarity::Similarity;
use crate::verdict::{Evidence, Strength, judge};

/// Voxels along the extent of the smaller cloud, where no edge is asked for.
pub const VOXELS_PER_EXTENT: f64 = 250.0;
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
    let source = Cloud::named("source cloud", source)?;
    let target = Cloud::named("target cloud", target)?;
    parallel::with_threads(config.n_threads, || {
        route(&source, &target, config, progress)
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
    let source_cleaned = remove_outliers(source, &source_index, &config.outliers, progress)?;
    let target_cleaned = remove_outliers(target, &target_index, &config.outliers, progress)?;
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
    for scale in search::scales(&config) {
        log.begin(Stage::Voxel, source_cleaned.len(), target_cleaned.len())?;
        let prepared = Prepared::new(&source_cleaned, &target_cleaned, scale, &config, progress)?;
        log.end(prepared.source.cloud.len(), prepared.target.cloud.len());
        let found = search::search(&prepared, &config, deadline, &mut log, progress)?;
        log.keep();
        if best
            .as_ref()
            .is_none_or(|(_, b)| search::merit(&found) > search::merit(b))
        {
            best = Some((prepared, found));
        }
    }
    let Some((prepared, found)) = best else {
        return Err(Error::NoSolution {
            reason: "no scale was asked for".into(),
        });
    };
    let voxel_size_m = prepared.voxel_size_m;
    let max_distance_m = config
        .icp
        .max_distance_m
        .unwrap_or(SUPPORT_IN_VOXELS * voxel_size_m);
    config.resolve(voxel_size_m, max_distance_m);

    let (source_surface, target_surface) = (&prepared.source.cloud, &prepared.target.cloud);
    log.begin(Stage::Icp, source_surface.len(), target_surface.len())?;
    let coarse_pose = found.candidates[0].target_from_source;
    let fine = refine(&prepared, &coarse_pose, &config, progress)?;
    let fine_pose = fine.target_from_source;
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
    let (before, after) = (agreed(&coarse_pose), agreed(&fine_pose));
    // Robust mode keeps ICP's pose only where it is no worse; the paper always takes it.
    let (pose, agreed) = if config.mode == Mode::Paper || after.score >= before.score {
        (fine_pose, after)
    } else {
        (coarse_pose, before)
    };
    let support = support(source_surface, target_surface, &pose, max_distance_m);
    let strength = Strength::new(
        &support.planes.information(),
        support.planes.weight(),
        support.radius_m,
    );
    let judgement = judge(
        &Evidence {
            inlier_share: agreed.inlier_share,
            ambiguity_ratio: found.ambiguity_ratio,
            strength,
            converged: fine.stop_reason == IcpStop::Converged,
        },
        &config.verdict,
    );
    log.keep();

    log.begin(Stage::Evaluate, source.len(), target.len())?;
    let (source_pivot, target_pivot) = (prepared.source_pivot(), prepared.target_pivot());
    let about_pivots = prepared.about_pivots(&pose);
    let given = |pose: &Similarity| {
        prepared
            .about_pivots(pose)
            .between_given_coordinates(source_pivot, target_pivot)
    };
    let target_from_source = given(&pose);
    let (source_to_target, target_to_source) = distances(
        (source, &source_index),
        (target, &target_index),
        &target_from_source.between_local_coordinates(source.origin(), target.origin()),
        progress,
    )?;
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
        n_inliers: support.n_inliers,
        overlap_of_source: share_within(&source_to_target, max_distance_m),
        overlap_of_target: share_within(&target_to_source, max_distance_m),
        inlier_share: agreed.inlier_share,
        ambiguity_ratio: found.ambiguity_ratio,
        strength,
        candidates: found
            .candidates
            .iter()
            .map(|c| (given(&c.target_from_source), c.score))
            .collect(),
        n_evaluations: found.n_evaluations,
        history: found.history,
        icp_stop: fine.stop_reason,
        n_icp_iterations: fine.n_iterations,
        icp_history: fine.history,
        source_to_target: statistics(&source_to_target)?,
        target_to_source: statistics(&target_to_source)?,
        n_non_finite: (source.n_non_finite(), target.n_non_finite()),
        outlier_radius_m,
        voxel_size_m,
        max_distance_m,
        stages: log.records,
        config,
    })
}

/// Brings the coarse pose to rest: the paper's ICP, or point-to-plane on the overlap.
fn refine(
    prepared: &Prepared,
    coarse_pose: &Similarity,
    config: &Config,
    progress: &Progress<'_>,
) -> Result<IcpResult> {
    let (source, target) = (&prepared.source.cloud, &prepared.target.cloud);
    let clouds = Clouds {
        source: source.points(),
        source_surfaces: &source.surfaces,
        target: &target.index,
        target_surfaces: &target.surfaces,
    };
    let known = Default::default();
    icp(
        &clouds,
        coarse_pose,
        config.dof,
        &known,
        &config.icp,
        progress,
    )
}

/// From every point of each cloud to the nearest of the other: source to target, and back.
fn distances(
    (source, source_index): (&Cloud, &NeighborIndex),
    (target, target_index): (&Cloud, &NeighborIndex),
    target_from_source: &Similarity,
    progress: &Progress<'_>,
) -> Result<(Vec<f64>, Vec<f64>)> {
    let moved = |cloud: &Cloud, pose: &Similarity| {
        parallel::map_cheap(cloud.len(), progress, |i| pose.apply(&cloud.points()[i]))
    };
    let forth = nearest_distances(&moved(source, target_from_source)?, target_index, progress)?;
    let back = target_from_source.inverse();
    let back = nearest_distances(&moved(target, &back)?, source_index, progress)?;
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
