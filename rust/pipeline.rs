//! The route on one page: what happens to two clouds, in the order of the paper's flowchart.
//!
//! outliers → voxel → keypoints → coarse → icp → verdict → evaluate, and then fuse.

use crate::cloud::{Cloud, MIN_POINTS, Point};
use crate::coarse::{self, CoarseResult, StandingOut};
use crate::config::{Config, Mode};
use crate::error::{Error, Result};
use crate::evaluate::{DistanceStatistics, nearest_distances, share_within};
use crate::fitness::{Tolerance, Witnesses, agreement, support};
use crate::freedom::Freedom;
use crate::fuse::{FuseOptions, FusedCloud, fuse};
use crate::icp::{Clouds, IcpResult, IcpStop, icp};
use crate::keypoints::{self, RADIUS_IN_VOXELS};
use crate::neighbors::NeighborIndex;
use crate::observations::LocalObservations;
use crate::outlier::remove_outliers;
use crate::parallel;
use crate::progress::{Event, Progress, Stage};
use crate::registration::{Registration, StageLog};
use crate::rigid::Rigid;
use crate::surface_cloud::SurfaceCloud;
use crate::verdict::{Evidence, Strength, judge};
use crate::voxel::downsample;

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
    let mut config = config.clone();
    let mut log = StageLog::new(progress);

    log.begin(Stage::Outliers, source.len(), target.len())?;
    let source_index = NeighborIndex::new(source.points());
    let target_index = NeighborIndex::new(target.points());
    let source_cleaned = remove_outliers(source, &source_index, &config.outliers, progress)?;
    let target_cleaned = remove_outliers(target, &target_index, &config.outliers, progress)?;
    log.end(source_cleaned.cloud.len(), target_cleaned.cloud.len());

    log.begin(
        Stage::Voxel,
        source_cleaned.cloud.len(),
        target_cleaned.cloud.len(),
    )?;
    let unit_m = extent_of_smaller(&source_cleaned.cloud, &target_cleaned.cloud)?;
    let voxel_size_m = config
        .voxel
        .voxel_size_m
        .unwrap_or(unit_m / VOXELS_PER_EXTENT);
    let source_voxels = downsample(&source_cleaned.cloud, voxel_size_m, progress)?.cloud;
    let target_voxels = downsample(&target_cleaned.cloud, voxel_size_m, progress)?.cloud;
    let source_surface = SurfaceCloud::new(&source_voxels, config.seed, progress)?;
    let target_surface = SurfaceCloud::new(&target_voxels, config.seed, progress)?;
    let (n_source, n_target) = (source_voxels.len(), target_voxels.len());
    log.end(n_source, n_target);
    let max_distance_m = config
        .icp
        .max_distance_m
        .unwrap_or(SUPPORT_IN_VOXELS * voxel_size_m);
    config.resolve(voxel_size_m, max_distance_m);

    let [source_witnesses, target_witnesses] = Witnesses::of_both(
        [&source_surface, &target_surface],
        coarse::N_WITNESSES,
        coarse::WITNESS_RADIUS * unit_m,
        voxel_size_m,
        progress,
    )?;

    let found = match config.mode {
        Mode::Robust => {
            log.begin(Stage::Coarse, n_source, n_target)?;
            let (seed, options) = (config.seed, &config.coarse);
            let (source, target) = (&source_witnesses, &target_witnesses);
            let enough = StandingOut {
                inlier_share: config.verdict.accept_inlier_share,
                ambiguity_ratio: config.verdict.accept_ambiguity_ratio,
                share_times_ratio: config.verdict.accept_share_times_ratio,
            };
            coarse::search_robust(source, target, unit_m, options, enough, seed, progress)?
        }
        Mode::Paper => {
            log.begin(Stage::Keypoints, n_source, n_target)?;
            let keypoints = |cloud: &Cloud, about: Point| -> Result<Vec<Point>> {
                let radius_m = RADIUS_IN_VOXELS * voxel_size_m;
                let index = NeighborIndex::new(cloud.points());
                let found =
                    keypoints::detect(cloud, &index, &config.keypoints, radius_m, progress)?;
                let local = |i: &u32| {
                    let p = cloud.points()[*i as usize];
                    std::array::from_fn(|axis| p[axis] + (cloud.origin()[axis] - about[axis]))
                };
                Ok(found.indices.iter().map(local).collect())
            };
            let source_keypoints = keypoints(&source_voxels, source_surface.origin)?;
            let target_keypoints = keypoints(&target_voxels, target_surface.origin)?;
            log.end(source_keypoints.len(), target_keypoints.len());
            log.begin(
                Stage::Coarse,
                source_keypoints.len(),
                target_keypoints.len(),
            )?;
            let (seed, options) = (config.seed, &config.paper);
            coarse::search_paper(
                &source_keypoints,
                &target_keypoints,
                options,
                seed,
                progress,
            )?
        }
    };
    log.keep();

    log.begin(Stage::Icp, n_source, n_target)?;
    let coarse_pose = found.candidates[0].target_from_source;
    let fine = refine(
        &source_surface,
        &target_surface,
        &coarse_pose,
        &config,
        progress,
    )?;
    log.keep();

    log.begin(Stage::Verdict, n_source, n_target)?;
    let tolerance = Tolerance::within(max_distance_m);
    let agreed = |pose: &Rigid| agreement(&source_witnesses, &target_witnesses, pose, tolerance);
    let (before, after) = (agreed(&coarse_pose), agreed(&fine.target_from_source.rigid));
    // Robust mode keeps ICP's pose only where it is no worse; the paper always takes it.
    let (pose, agreed) = if config.mode == Mode::Paper || after.score >= before.score {
        (fine.target_from_source.rigid, after)
    } else {
        (coarse_pose, before)
    };
    let support = support(&source_surface, &target_surface, &pose, max_distance_m);
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
    let (source_pivot, target_pivot) = (source_surface.origin, target_surface.origin);
    let given = |pose: &Rigid| pose.between_given_coordinates(source_pivot, target_pivot);
    let local = given(&pose).between_local_coordinates(source.origin(), target.origin());
    let source_to_target = distances(source, &target_index, &local, progress)?;
    let target_to_source = distances(target, &source_index, &local.inverse(), progress)?;
    log.keep();

    let CoarseResult {
        candidates,
        n_evaluations,
        history,
        ambiguity_ratio,
        ..
    } = found;
    Ok(Registration {
        target_from_source: given(&pose),
        about_pivots: pose,
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
        ambiguity_ratio,
        strength,
        candidates: candidates
            .iter()
            .map(|c| (given(&c.target_from_source), c.score))
            .collect(),
        n_evaluations,
        history,
        icp_stop: fine.stop_reason,
        n_icp_iterations: fine.n_iterations,
        icp_history: fine.history,
        source_to_target: statistics(&source_to_target)?,
        target_to_source: statistics(&target_to_source)?,
        n_non_finite: (source.n_non_finite(), target.n_non_finite()),
        outlier_radius_m: (source_cleaned.radius_m, target_cleaned.radius_m),
        voxel_size_m,
        max_distance_m,
        stages: log.records,
        config,
    })
}

/// Brings the coarse pose to rest: the paper's ICP, or point-to-plane on the overlap.
fn refine(
    source: &SurfaceCloud,
    target: &SurfaceCloud,
    coarse_pose: &Rigid,
    config: &Config,
    progress: &Progress<'_>,
) -> Result<IcpResult> {
    let clouds = Clouds {
        source: source.points(),
        source_surfaces: &source.surfaces,
        target: &target.index,
        target_surfaces: &target.surfaces,
    };
    let (start, known) = ((*coarse_pose).into(), LocalObservations::default());
    icp(
        &clouds,
        &start,
        Freedom::Rigid,
        &known,
        &config.icp,
        progress,
    )
}

/// Cloud-to-cloud distances of two clouds at a pose: from every point to the nearest of the other.
#[derive(Debug, Clone, PartialEq)]
pub struct Evaluation {
    /// From each finite source point to the target.
    pub source_to_target_m: Vec<f64>,
    /// From each finite target point to the source.
    pub target_to_source_m: Vec<f64>,
}

/// Stage 7 alone: the distances at a pose that is already known.
///
/// # Errors
/// [`Error::TooFewPoints`] for a cloud without finite points; [`Error::Cancelled`].
pub fn evaluate(
    source: &[Point],
    target: &[Point],
    target_from_source: &Rigid,
    progress: &Progress<'_>,
) -> Result<Evaluation> {
    let source = some_points("source cloud", source)?;
    let target = some_points("target cloud", target)?;
    let local = target_from_source.between_local_coordinates(source.origin(), target.origin());
    let source_index = NeighborIndex::new(source.points());
    let target_index = NeighborIndex::new(target.points());
    Ok(Evaluation {
        source_to_target_m: distances(&source, &target_index, &local, progress)?,
        target_to_source_m: distances(&target, &source_index, &local.inverse(), progress)?,
    })
}

/// Stage 8 alone: one cloud from two, at a pose that is already known.
///
/// # Errors
/// [`Error::TooFewPoints`] for a cloud without finite points; [`Error::InvalidArgument`] for the
/// options; [`Error::Cancelled`].
pub fn fuse_clouds(
    source: &[Point],
    target: &[Point],
    target_from_source: &Rigid,
    options: &FuseOptions,
    progress: &Progress<'_>,
) -> Result<FusedCloud> {
    progress.emit(&Event::Started { stage: Stage::Fuse })?;
    let source = some_points("source cloud", source)?;
    let target = some_points("target cloud", target)?;
    let local = target_from_source.between_local_coordinates(source.origin(), target.origin());
    let source_index = NeighborIndex::new(source.points());
    let target_index = NeighborIndex::new(target.points());
    fuse(
        &target,
        &target_index,
        &source,
        &source_index,
        &local,
        options,
        progress,
    )
}

fn some_points(what: &str, points: &[Point]) -> Result<Cloud> {
    let cloud = Cloud::of_any_shape(what, points)?;
    if cloud.is_empty() {
        return Err(Error::TooFewPoints {
            what: what.into(),
            found: 0,
            needed: 1,
        });
    }
    Ok(cloud)
}

fn distances(
    from: &Cloud,
    to: &NeighborIndex,
    to_from: &Rigid,
    progress: &Progress<'_>,
) -> Result<Vec<f64>> {
    let moved = parallel::map_cheap(from.len(), progress, |i| to_from.apply(&from.points()[i]))?;
    nearest_distances(&moved, to, progress)
}

fn statistics(distances_m: &[f64]) -> Result<DistanceStatistics> {
    DistanceStatistics::from_distances(distances_m).ok_or_else(|| Error::NoSolution {
        reason: "there are no distances".into(),
    })
}

/// The extent of the smaller cloud, which every derived length is a share of.
fn extent_of_smaller(source: &Cloud, target: &Cloud) -> Result<f64> {
    for (what, cloud) in [("source cloud", source), ("target cloud", target)] {
        if cloud.len() < MIN_POINTS {
            return Err(Error::TooFewPoints {
                what: format!("{what}, after outlier removal,"),
                found: cloud.len(),
                needed: MIN_POINTS,
            });
        }
    }
    Ok(source.extent_m().min(target.extent_m()))
}
