//! Stage 5: iterative closest point, from the coarse pose to the fine one.
//!
//! Why: the search ends in the right basin, not at its bottom.
//! Reads: two clouds about local origins, a pose that is right to a few voxels, and what else is known
//! of it.
//! Leaves: the pose, how many points support it and how closely, and how accurate it is.
//! Source: Ren, Zhao & Han (2023), Section 4.5, Eq. (8) for point-to-point; Chen & Medioni (1992)
//! for point-to-plane; Segal, Haehnel & Thrun (2009) for plane-to-plane; trimming after Chetverikov
//! et al. (2002) and Phillips, Liu & Tomasi (2007).
//! Deviates: all but point-to-point is ours to add, for clouds that overlap in part; planes are those
//! of both clouds.
//! Absent on purpose: any judgement of the result.

mod gauss_newton;
mod misfit;
mod options;
mod pairs;
mod refinement;
mod rest;
mod samples;
mod sizes;

use crate::cloud::Point;
use crate::error::{Error, Result};
use crate::freedom::Freedom;
use crate::neighbors::NeighborIndex;
use crate::normals::Surface;
use crate::observations::LocalObservations;
use crate::progress::{Event, Progress, Stage};
use crate::similarity::{Similarity, has_run_away};
use crate::uncertainty::PoseUncertainty;

pub use options::{IcpKernel, IcpMethod, IcpOptions};
use pairs::Pairs;
use refinement::Refinement;
use rest::Rest;
use samples::{Sample, strides};
use serde::{Deserialize, Serialize};

/// What ICP reads of the two clouds.
#[derive(Debug, Clone, Copy)]
pub struct Clouds<'a> {
    /// Points of the cloud that moves, about a local origin.
    pub source: &'a [Point],
    /// Their surfaces, or nothing: point-to-plane then takes the planes of the target alone.
    pub source_surfaces: &'a [Surface],
    /// The cloud that stays, about a local origin.
    pub target: &'a NeighborIndex,
    /// Its surfaces; may be empty for point-to-point, which then has no uncertainty.
    pub target_surfaces: &'a [Surface],
}

impl Clouds<'_> {
    fn check(&self, method: IcpMethod) -> Result<()> {
        let of_planes = method != IcpMethod::PointToPoint;
        let of_both = method == IcpMethod::PlaneToPlane;
        for (name, n_surfaces, n, needed) in [
            (
                "target_surfaces",
                self.target_surfaces.len(),
                self.target.len(),
                of_planes,
            ),
            (
                "source_surfaces",
                self.source_surfaces.len(),
                self.source.len(),
                of_both,
            ),
        ] {
            if n_surfaces != n && (needed || n_surfaces > 0) {
                return Err(Error::argument(
                    name,
                    format!("must be one for each of {n} points, got {n_surfaces}"),
                ));
            }
        }
        Ok(())
    }
}

/// Why ICP ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum IcpStop {
    /// The mean squared distance, or the pose, no longer changes.
    Converged,
    /// The iterations were used up.
    MaxIterations,
    /// Hardly any point has a partner within the distance.
    NoPartners,
    /// The scale ran away from that of the start by more than a quarter.
    ScaleRanAway,
}

/// The fine pose and its support.
#[derive(Debug, Clone, PartialEq)]
pub struct IcpResult {
    /// The fine pose.
    pub target_from_source: Similarity,
    /// Why it ended.
    pub stop_reason: IcpStop,
    /// Iterations made over all points; those over samples, before, are not counted.
    pub n_iterations: usize,
    /// Source points with a partner that counted, at the last iteration.
    pub n_inliers: usize,
    /// Root mean squared point distance of those pairs.
    pub inlier_rmse_m: f64,
    /// Mean squared distance at each of them: of points, after its step, for point-to-point; as the
    /// method and the kernel weigh it, before its step, otherwise.
    pub history: Vec<f64>,
    /// How accurate the pose is; `None` without surfaces, or with too few pairs to tell.
    pub uncertainty: Option<PoseUncertainty>,
}

impl IcpResult {
    fn found_a_way(&self) -> bool {
        matches!(
            self.stop_reason,
            IcpStop::Converged | IcpStop::MaxIterations
        )
    }
}

/// Brings `source` onto `target` from `start`, which also holds what is not free: the tilt of a
/// levelled pose, the scale of a rigid one.
///
/// Points without a normal do not count where planes do. The method defaults to point-to-point, the
/// distance to no limit.
///
/// # Errors
/// [`Error::InvalidArgument`] for options out of range or the wrong number of surfaces;
/// [`Error::Cancelled`].
///
/// ```
/// use tmchho::{Rigid, freedom::Freedom, icp, neighbors::NeighborIndex, progress::Progress};
/// let target: Vec<[f64; 3]> = (0..300)
///     .map(|i| f64::from(i))
///     .map(|t| [t.sin() * t * 0.01, (1.7 * t).cos(), (0.3 * t).sin() * 2.0])
///     .collect();
/// let moved = Rigid::from_euler([0.01, 0.0, -0.01], [0.01, 0.0, 0.02]);
/// let source: Vec<[f64; 3]> = target.iter().map(|p| moved.inverse().apply(p)).collect();
/// let index = NeighborIndex::new(&target);
/// let clouds =
///     icp::Clouds { source: &source, source_surfaces: &[], target: &index, target_surfaces: &[] };
/// let (start, options) = (Rigid::identity().into(), icp::IcpOptions::default());
/// let (free, nothing, silent) = (Freedom::Rigid, Default::default(), Progress::silent());
/// let found = icp::icp(&clouds, &start, free, &nothing, &options, &silent)?;
/// let found = found.target_from_source.rigid;
/// assert!((found.translation - moved.translation).norm() < 1e-6);
/// # Ok::<(), tmchho::Error>(())
/// ```
pub fn icp(
    clouds: &Clouds<'_>,
    start: &Similarity,
    freedom: Freedom,
    known: &LocalObservations,
    options: &IcpOptions,
    progress: &Progress<'_>,
) -> Result<IcpResult> {
    options.check()?;
    let method = options.method.unwrap_or(IcpMethod::PointToPoint);
    clouds.check(method)?;
    // Neighbours one after the other find their partners together.
    let order = clouds.target.places_to_ask(clouds.source);
    let task = Task {
        start,
        freedom,
        known,
        options,
        method,
    };
    let mut pose = *start;
    if options.coarse_to_fine.unwrap_or(true) {
        let target_order = clouds.target.places();
        for stride in strides(order.len().min(target_order.len())) {
            let source = Sample::of(&order, clouds.source_surfaces, stride);
            let target = Sample::of(&target_order, clouds.target_surfaces, stride);
            let clouds = Clouds {
                source: &source.points,
                source_surfaces: &source.surfaces,
                target: &NeighborIndex::new(&target.points),
                target_surfaces: &target.surfaces,
            };
            let found = task.run(&clouds, &pose, false, progress)?;
            // A sample that found no way leaves it to the next one.
            if found.found_a_way() {
                pose = found.target_from_source;
            }
        }
    }
    let source = Sample::of(&order, clouds.source_surfaces, 1);
    let clouds = Clouds {
        source: &source.points,
        source_surfaces: &source.surfaces,
        ..*clouds
    };
    task.run(&clouds, &pose, true, progress)
}

/// What is asked of every level of the refinement.
struct Task<'a> {
    /// What is not free stays as it is here.
    start: &'a Similarity,
    freedom: Freedom,
    known: &'a LocalObservations,
    options: &'a IcpOptions,
    method: IcpMethod,
}

impl Task<'_> {
    /// Refines `pose` with the points of `clouds`; only the last level says how accurate it is.
    fn run(
        &self,
        clouds: &Clouds<'_>,
        pose: &Similarity,
        is_last: bool,
        progress: &Progress<'_>,
    ) -> Result<IcpResult> {
        let (options, method) = (self.options, self.method);
        let mut fine = Refinement {
            clouds,
            freedom: self.freedom,
            known: self.known,
            options,
            method,
            pairs: Pairs::of(clouds.source.len()),
            limit_sq: f64::INFINITY,
            middle: [0.0; 3],
            open: Vec::new(),
        };
        let least_pairs = if method == IcpMethod::PointToPoint {
            3
        } else {
            6
        };
        let mut rest = Rest::new(clouds.source, pose, method);
        let mut result = IcpResult {
            target_from_source: *pose,
            stop_reason: IcpStop::MaxIterations,
            n_iterations: 0,
            n_inliers: 0,
            inlier_rmse_m: f64::NAN,
            history: Vec::new(),
            uncertainty: None,
        };
        for iteration in 0..options.max_iterations {
            let pose = result.target_from_source;
            let kept_share = options.kept_share_of(method);
            let (source, target, reach_m) = (clouds.source, clouds.target, options.max_distance_m);
            fine.pairs
                .find(source, target, &pose, reach_m, kept_share, progress)?;
            if iteration == 0 {
                fine.settle(&pose);
            }
            let step = match fine.pairs.n_kept >= least_pairs {
                true => fine.step(&pose, progress)?,
                false => None,
            };
            let Some(step) = step else {
                result.stop_reason = IcpStop::NoPartners;
                break;
            };
            if has_run_away(step.pose.scale / self.start.scale) {
                result.stop_reason = IcpStop::ScaleRanAway;
                break;
            }
            result.n_iterations = iteration + 1;
            result.n_inliers = fine.pairs.n_kept;
            result.inlier_rmse_m = fine.pairs.rmse();
            result.target_from_source = step.pose;
            let last = result.history.last().copied();
            result.history.push(step.mean_squared);
            progress.emit(&Event::Advanced {
                stage: Stage::Icp,
                done: iteration + 1,
                total: options.max_iterations,
                best: Some(step.mean_squared.sqrt()),
            })?;
            let change = last.map_or(f64::INFINITY, |last| (last - step.mean_squared).abs());
            if step.mean_squared == 0.0
                || change <= options.relative_tolerance * step.mean_squared
                || rest.is_reached(&step.pose, result.inlier_rmse_m)
            {
                result.stop_reason = IcpStop::Converged;
                break;
            }
        }
        if result.n_iterations > 0 && is_last {
            result.uncertainty = fine.uncertainty(&result.target_from_source, result.inlier_rmse_m);
        }
        Ok(result)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::normals;
    use crate::random::Stream;
    use crate::rigid::Rigid;

    /// A wavy sheet with a step in it: enough shape for a unique pose.
    fn sheet(n: usize, seed: u64) -> Vec<Point> {
        let mut stream = Stream::new(seed, "sheet", 0);
        (0..n)
            .map(|_| [stream.uniform(), stream.uniform()])
            .map(|[x, y]| {
                let step = if x > 0.6 { 0.2 } else { 0.0 };
                [x, y, 0.1 * (7.0 * x).sin() * (9.0 * y + x).cos() + step]
            })
            .collect()
    }

    fn run(source: &[Point], target: &[Point], method: IcpMethod, kept_share: f64) -> IcpResult {
        let index = NeighborIndex::new(target);
        let silent = Progress::silent();
        let surfaces = |points: &[Point]| {
            normals::estimate(points, &NeighborIndex::new(points), 16, &silent).unwrap()
        };
        let options = IcpOptions {
            method: Some(method),
            kept_share: Some(kept_share),
            max_distance_m: (kept_share < 1.0).then_some(0.1),
            ..IcpOptions::default()
        };
        let clouds = Clouds {
            source,
            source_surfaces: &surfaces(source),
            target: &index,
            target_surfaces: &surfaces(target),
        };
        let (start, nothing) = (Similarity::identity(), LocalObservations::default());
        icp(&clouds, &start, Freedom::Rigid, &nothing, &options, &silent).unwrap()
    }

    #[test]
    fn both_methods_undo_a_known_motion_exactly() {
        let target = sheet(2000, 1);
        let pose = Rigid::from_euler([0.01, -0.015, 0.02], [0.004, -0.003, 0.005]);
        let source: Vec<Point> = target.iter().map(|p| pose.inverse().apply(p)).collect();
        for method in [IcpMethod::PointToPoint, IcpMethod::PointToPlane] {
            let found = run(&source, &target, method, 1.0);
            assert!(
                (found.target_from_source.rigid.rotation - pose.rotation).amax() < 1e-6,
                "{method:?}"
            );
            assert!(
                found.inlier_rmse_m < 1e-6,
                "{method:?} {}",
                found.inlier_rmse_m
            );
            assert_eq!(found.stop_reason, IcpStop::Converged);
            assert_eq!(found.n_inliers, 2000);
        }
    }

    #[test]
    fn samples_first_lead_to_the_same_pose_in_fewer_steps_of_all_points() {
        let (target, source) = (sheet(20_000, 4), sheet(20_000, 5));
        let away = Rigid::from_euler([0.02, -0.01, 0.03], [0.02, 0.01, -0.02]);
        let source: Vec<Point> = source.iter().map(|p| away.apply(p)).collect();
        let index = NeighborIndex::new(&target);
        let surfaces = |points: &[Point]| {
            let index = NeighborIndex::new(points);
            normals::estimate(points, &index, 16, &Progress::silent()).unwrap()
        };
        let (of_source, of_target) = (surfaces(&source), surfaces(&target));
        let clouds = Clouds {
            source: &source,
            source_surfaces: &of_source,
            target: &index,
            target_surfaces: &of_target,
        };
        for method in [
            IcpMethod::PointToPoint,
            IcpMethod::PointToPlane,
            IcpMethod::PlaneToPlane,
        ] {
            let run = |coarse_to_fine| {
                let options = IcpOptions {
                    method: Some(method),
                    coarse_to_fine: Some(coarse_to_fine),
                    max_iterations: 200,
                    relative_tolerance: 1e-9,
                    ..IcpOptions::default()
                };
                let (start, nothing) = (Similarity::identity(), LocalObservations::default());
                let silent = Progress::silent();
                icp(&clouds, &start, Freedom::Rigid, &nothing, &options, &silent).unwrap()
            };
            let (plain, quick) = (run(false), run(true));
            let rigid = |found: &IcpResult| found.target_from_source.rigid;
            let apart = rigid(&plain) * rigid(&quick).inverse();
            // A tenth of the distance of the points would be 0.0007.
            assert!(apart.rotation_angle_rad() < 1e-4, "{method:?}");
            assert!(apart.translation.norm() < 1e-4, "{method:?}");
            assert!(
                quick.n_iterations < plain.n_iterations,
                "{method:?}: {} {}",
                quick.n_iterations,
                plain.n_iterations
            );
            assert_eq!(quick.history.len(), quick.n_iterations);
        }
    }

    #[test]
    fn trimming_keeps_a_partial_overlap_in_place() {
        // Independent samples of one sheet; the source lacks what lies at y > 0.7 and has an
        // excrescence instead that the target does not know.
        let target: Vec<Point> = sheet(6000, 2).into_iter().filter(|p| p[1] < 0.7).collect();
        let mut source: Vec<Point> = sheet(6000, 3);
        source.extend((0..500).map(|i| [0.3, 0.9, 0.3 + 0.001 * f64::from(i)]));
        let trimmed = run(&source, &target, IcpMethod::PointToPlane, 0.9);
        assert!(trimmed.target_from_source.rigid.rotation_angle_rad() < 0.004);
        assert!(trimmed.target_from_source.rigid.translation.norm() < 0.004);
        let plain = run(&source, &target, IcpMethod::PointToPoint, 1.0);
        assert!(
            plain.target_from_source.rigid.translation.norm() > 0.01,
            "the paper's ICP drifts"
        );
    }

    #[test]
    fn clouds_that_do_not_meet_say_so() {
        let far: Vec<Point> = sheet(100, 1)
            .iter()
            .map(|p| [p[0] + 50.0, p[1], p[2]])
            .collect();
        let found = run(&far, &sheet(100, 2), IcpMethod::PointToPlane, 0.5);
        assert_eq!(
            (found.stop_reason, found.n_inliers),
            (IcpStop::NoPartners, 0)
        );
    }
}
