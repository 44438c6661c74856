//! The fine stage of the route: the pose brought to rest by ICP, and how the clouds agree there.

use super::prepare::Prepared;
use super::search::{may_have_strays, without_strays};
use crate::config::{Config, Mode};
use crate::error::Result;
use crate::fitness::{self, Agreement, Support, Tolerance, agreement};
use crate::icp::{Clouds, IcpResult, icp};
use crate::observations::LocalObservations;
use crate::parallel;
use crate::progress::{Progress, Stage};
use crate::registration::StageLog;
use crate::similarity::Similarity;
use crate::surface_cloud::SurfaceCloud;
use crate::uncertainty::PoseUncertainty;

/// The fine pose is kept unless the clouds agree by less than this share of what they did before: where noise is
/// as large as a voxel, the score changes by a twentieth by chance.
const LEAST_KEPT: f64 = 0.9;

/// A pose at rest, and how the clouds agree there.
pub(super) struct Fine {
    pub(super) pose: Similarity,
    pub(super) icp: IcpResult,
    /// Of `pose`; `None` also where that is the coarse one.
    pub(super) uncertainty: Option<PoseUncertainty>,
    pub(super) agreed: Agreement,
    /// What of the source lies on the target, and of the target on the source.
    pub(super) supports: [Support; 2],
    pub(super) surface_offset_m: f64,
    /// Root mean squared distance of the pairs of points that were held out of the fit, by that of the others.
    pub(super) held_out_ratio: f64,
}

impl Fine {
    /// Whether even surfaces lie farther apart than the verdict accepts.
    pub(super) fn lies_apart(&self, prepared: &Prepared, config: &Config) -> bool {
        let agreed = &self.agreed;
        let most = (config.verdict).most_surface_offset(agreed.conflict_share, agreed.misfit);
        self.surface_offset_m > prepared.thinned.unit_m * most
    }
}

/// The coarse pose after ICP, unless that made it worse.
pub(super) fn brought_to_rest(
    prepared: &Prepared,
    coarse_pose: &Similarity,
    max_distance_m: f64,
    config: &Config,
    log: &mut StageLog<'_>,
    progress: &Progress<'_>,
) -> Result<Fine> {
    let (source, target) = (&prepared.source.cloud, &prepared.target.cloud);
    log.begin(Stage::Icp, source.len(), target.len())?;
    let known = prepared.known(&config.known)?;
    let mut icp = refine(prepared, coarse_pose, &known, config, progress)?;
    log.keep();

    log.begin(Stage::Verdict, source.len(), target.len())?;
    let tolerance = Tolerance::within(max_distance_m);
    let agreed = |pose: &Similarity| {
        agreement(
            (&prepared.source, &*source.index),
            (&prepared.target, &*target.index),
            pose,
            tolerance,
        )
    };
    let (before, after) =
        parallel::both(|| agreed(coarse_pose), || agreed(&icp.target_from_source));
    // Robust mode keeps ICP's pose only where it is no worse, or where it heeds what is known; the
    // paper always takes it.
    let takes_icp = config.mode == Mode::Paper
        || !known.is_empty()
        || after.score() >= LEAST_KEPT * before.score();
    let (pose, agreed, uncertainty) = match takes_icp {
        true => (icp.target_from_source, after, icp.uncertainty.take()),
        false => (*coarse_pose, before, None),
    };
    let offset_m =
        || fitness::surface_offset_m(source, target, &pose, prepared.thinned.unit_m, progress);
    let ((forth, back), (surface_offset_m, held_out_ratio)) = parallel::both(
        || supports([source, target], &pose, max_distance_m, progress),
        || parallel::both(offset_m, || held_out_ratio(prepared, &pose, max_distance_m)),
    );
    Ok(Fine {
        pose,
        icp,
        uncertainty,
        agreed,
        supports: [forth?, back?],
        surface_offset_m: surface_offset_m?,
        held_out_ratio,
    })
}

/// The same between the clouds without their strays, where there are many and it was these that drew surfaces apart;
/// else `None`. With these clouds.
pub(super) fn brought_to_rest_without_strays(
    prepared: &Prepared,
    fine: &Fine,
    max_distance_m: f64,
    config: &Config,
    log: &mut StageLog<'_>,
    progress: &Progress<'_>,
) -> Result<Option<(Prepared, Fine)>> {
    /// A part of the noise goes with the strays, so a little less proves nothing.
    const LEFT: f64 = 0.5;
    if !may_have_strays(config) || !prepared.thinned.is_strewn(progress)? {
        return Ok(None);
    }
    log.keep();
    let Some(cleaned) = without_strays(&prepared.thinned, config, log, progress)? else {
        let (n_source, n_target) = (prepared.source.cloud.len(), prepared.target.cloud.len());
        log.begin(Stage::Verdict, n_source, n_target)?;
        return Ok(None);
    };
    let pose = cleaned.pose_from_given(&prepared.pose_to_given(&fine.pose));
    let again = brought_to_rest(&cleaned, &pose, max_distance_m, config, log, progress)?;
    let lies_closer = again.surface_offset_m < LEFT * fine.surface_offset_m;
    Ok(lies_closer.then_some((cleaned, again)))
}

/// Whether the pose rests on strays alone: no surface is even enough to vouch for it, there are some strays, and
/// surfaces do not lie on surfaces.
pub(super) fn rests_on_strays(
    prepared: &Prepared,
    fine: &Fine,
    max_distance_m: f64,
    config: &Config,
    progress: &Progress<'_>,
) -> Result<bool> {
    Ok(fine.surface_offset_m.is_nan()
        && may_have_strays(config)
        && prepared.thinned.has_some_strays(progress)?
        && prepared.lies_on_strays(&fine.pose, max_distance_m, progress)?)
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
            let margin_m = reach_m + MOST_MOVED * prepared.thinned.unit_m;
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
