//! Stage 5: iterative closest point, from the coarse pose to the fine one.
//!
//! Why: the search ends in the right basin, not at its bottom.
//! Reads: two clouds about local origins and a pose that is right to a few voxels.
//! Leaves: the pose, how many points support it and how closely.
//! Source: Ren, Zhao & Han (2023), Section 4.5, Eq. (8) for point-to-point; Chen & Medioni (1992)
//! for point-to-plane; trimming after Chetverikov et al. (2002).
//! Deviates: point-to-plane and trimming are ours, for clouds that overlap in part.
//! Absent on purpose: any judgement of the result.

use serde::{Deserialize, Serialize};

use crate::cloud::{Point, distance_sq};
use crate::error::{Error, Result, require_between, require_count, require_positive};
use crate::kabsch::PairSums;
use crate::neighbors::NeighborIndex;
use crate::normals::Surface;
use crate::parallel;
use crate::point_to_plane::PlaneSums;
use crate::progress::{Event, Progress, Stage};
use crate::rigid::Rigid;

/// What is made small.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum IcpMethod {
    /// Distances between points: Eq. (8), the paper's.
    PointToPoint,
    /// Distances from points to the planes of their partners.
    PointToPlane,
}

/// How ICP runs. `None` means "derive this one from the data or the mode".
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct IcpOptions {
    /// `None`: point-to-plane in robust mode, point-to-point in paper mode.
    pub method: Option<IcpMethod>,
    /// Partners farther away do not count. `None`: two and a half voxels in robust mode, no limit in
    /// paper mode.
    pub max_distance_m: Option<f64>,
    /// Share of the pairs that count, closest first, in (0, 1].
    pub kept_share: f64,
    /// At most so many iterations, at least 1.
    pub max_iterations: usize,
    /// Stop when the mean squared distance changes by less than this share of itself.
    pub relative_tolerance: f64,
}

impl Default for IcpOptions {
    fn default() -> Self {
        Self {
            method: None,
            max_distance_m: None,
            kept_share: 1.0,
            max_iterations: 50,
            relative_tolerance: 1e-6,
        }
    }
}

impl IcpOptions {
    pub(crate) fn check(&self) -> Result<()> {
        if let Some(max_distance) = self.max_distance_m {
            require_positive("icp.max_distance_m", max_distance)?;
        }
        require_positive("icp.kept_share", self.kept_share)?;
        require_between("icp.kept_share", self.kept_share, 0.0, 1.0)?;
        require_count("icp.max_iterations", self.max_iterations, 1, 1_000_000)?;
        require_between("icp.relative_tolerance", self.relative_tolerance, 0.0, 1.0)?;
        Ok(())
    }
}

/// Why ICP ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum IcpStop {
    /// The mean squared distance no longer changes.
    Converged,
    /// The iterations were used up.
    MaxIterations,
    /// Hardly any point has a partner within the distance.
    NoPartners,
}

/// The fine pose and its support.
#[derive(Debug, Clone, PartialEq)]
pub struct IcpResult {
    /// The fine pose.
    pub target_from_source: Rigid,
    /// Why it ended.
    pub stop_reason: IcpStop,
    /// Iterations made.
    pub n_iterations: usize,
    /// Source points with a partner that counted, at the last iteration.
    pub n_inliers: usize,
    /// Root mean squared point distance of those pairs.
    pub inlier_rmse_m: f64,
    /// Mean squared distance after each iteration (of points or to planes, as the method says).
    pub history: Vec<f64>,
}

/// Brings `source` onto `target` from `start`.
///
/// `target_surfaces` are read by point-to-plane only; points without a normal then do not count.
/// The method defaults to point-to-point, the distance to no limit.
///
/// # Errors
/// [`Error::InvalidArgument`] for options out of range or too few surfaces; [`Error::Cancelled`].
///
/// ```
/// use tmchho::{Rigid, icp, neighbors::NeighborIndex, progress::Progress};
/// let target: Vec<[f64; 3]> = (0..300)
///     .map(|i| f64::from(i))
///     .map(|t| [t.sin() * t * 0.01, (1.7 * t).cos(), (0.3 * t).sin() * 2.0])
///     .collect();
/// let moved = Rigid::from_euler([0.01, 0.0, -0.01], [0.01, 0.0, 0.02]);
/// let source: Vec<[f64; 3]> = target.iter().map(|p| moved.inverse().apply(p)).collect();
/// let index = NeighborIndex::new(&target);
/// let options = icp::IcpOptions::default();
/// let found = icp::icp(&source, &index, &[], &Rigid::identity(), &options, &Progress::silent())?;
/// assert!((found.target_from_source.translation - moved.translation).norm() < 1e-6);
/// # Ok::<(), tmchho::Error>(())
/// ```
pub fn icp(
    source: &[Point],
    target: &NeighborIndex,
    target_surfaces: &[Surface],
    start: &Rigid,
    options: &IcpOptions,
    progress: &Progress<'_>,
) -> Result<IcpResult> {
    options.check()?;
    let method = options.method.unwrap_or(IcpMethod::PointToPoint);
    if method == IcpMethod::PointToPlane && target_surfaces.len() != target.len() {
        return Err(Error::argument(
            "target_surfaces",
            format!(
                "must be one for each of {} points, got {}",
                target.len(),
                target_surfaces.len()
            ),
        ));
    }
    let mut rest = Rest::new(source, start, method);
    let least_pairs = if method == IcpMethod::PointToPlane {
        6
    } else {
        3
    };
    let mut result = IcpResult {
        target_from_source: *start,
        stop_reason: IcpStop::MaxIterations,
        n_iterations: 0,
        n_inliers: 0,
        inlier_rmse_m: f64::NAN,
        history: Vec::new(),
    };
    for iteration in 0..options.max_iterations {
        let pose = result.target_from_source;
        let pairs = Pairs::find(source, target, &pose, options, progress)?;
        let Some(step) = (pairs.n_kept >= least_pairs)
            .then(|| match method {
                IcpMethod::PointToPoint => step_to_points(source, target, &pairs),
                IcpMethod::PointToPlane => {
                    step_to_planes(source, target, target_surfaces, &pose, &pairs)
                }
            })
            .flatten()
        else {
            result.stop_reason = IcpStop::NoPartners;
            break;
        };
        result.n_iterations = iteration + 1;
        result.n_inliers = pairs.n_kept;
        result.inlier_rmse_m = pairs.rmse();
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
    Ok(result)
}

/// Knows when a pose has come to rest although the mean distance has not: where pairs come and go at
/// the rim of the overlap it never quite settles, and the pose may run round a small cycle.
struct Rest {
    visited: Vec<Rigid>,
    reach_m: f64,
    /// Share of the residual that counts as rest.
    tolerance: f64,
}

impl Rest {
    fn new(source: &[Point], start: &Rigid, method: IcpMethod) -> Self {
        let farthest_sq = source
            .iter()
            .map(|p| distance_sq(p, &[0.0; 3]))
            .fold(0.0, f64::max);
        Self {
            visited: vec![*start],
            reach_m: farthest_sq.sqrt(),
            tolerance: match method {
                // The paper's ICP creeps; only its own rule ends it.
                IcpMethod::PointToPoint => 0.0,
                IcpMethod::PointToPlane => 5e-3,
            },
        }
    }

    /// Whether no point moves by more than the tolerance, or rounding, from where the pose has been.
    fn is_reached(&mut self, pose: &Rigid, residual_m: f64) -> bool {
        /// Steps of this share of the cloud's size are rounding: clouds that match exactly.
        const ROUNDING: f64 = 1e-9;
        let tolerance_m = (self.tolerance * residual_m).max(ROUNDING * self.reach_m);
        let moved_by = |before: &Rigid| {
            let turned_rad = (*pose * before.inverse()).rotation_angle_rad();
            turned_rad * self.reach_m + (pose.translation - before.translation).norm()
        };
        let reached = self
            .visited
            .iter()
            .any(|before| moved_by(before) <= tolerance_m);
        self.visited.push(*pose);
        reached
    }
}

/// The partner of every source point at a pose, and which pairs count.
struct Pairs {
    /// (target index, squared distance); an index of `u32::MAX` stands for "nobody near".
    partners: Vec<(u32, f64)>,
    /// Pairs with a squared distance up to this one count.
    max_sq: f64,
    n_kept: usize,
}

impl Pairs {
    fn find(
        source: &[Point],
        target: &NeighborIndex,
        pose: &Rigid,
        options: &IcpOptions,
        progress: &Progress<'_>,
    ) -> Result<Self> {
        const NOBODY: (u32, f64) = (u32::MAX, f64::INFINITY);
        let limit_sq = options.max_distance_m.map_or(f64::INFINITY, |m| m * m);
        let partners = parallel::map_cheap(source.len(), progress, |i| {
            let moved = pose.apply(&source[i]);
            let found = if limit_sq.is_finite() {
                target.nearest_within(&moved, limit_sq)
            } else {
                target.nearest(&moved)
            };
            found.map_or(NOBODY, |neighbor| (neighbor.index, neighbor.distance_sq))
        })?;
        let mut distances: Vec<f64> = partners
            .iter()
            .map(|pair| pair.1)
            .filter(|d| d.is_finite())
            .collect();
        let n_kept = (distances.len() as f64 * options.kept_share).ceil() as usize;
        let max_sq = match n_kept {
            0 => f64::NEG_INFINITY,
            n if n == distances.len() => f64::MAX,
            n => *distances.select_nth_unstable_by(n - 1, f64::total_cmp).1,
        };
        let n_kept = partners.iter().filter(|pair| pair.1 <= max_sq).count();
        Ok(Self {
            partners,
            max_sq,
            n_kept,
        })
    }

    fn kept(&self) -> impl Iterator<Item = (usize, usize)> {
        let counted = |(i, pair): (usize, &(u32, f64))| {
            (pair.1 <= self.max_sq).then_some((i, pair.0 as usize))
        };
        self.partners.iter().enumerate().filter_map(counted)
    }

    fn rmse(&self) -> f64 {
        let kept = self.partners.iter().filter(|pair| pair.1 <= self.max_sq);
        (kept.map(|pair| pair.1).sum::<f64>() / self.n_kept as f64).sqrt()
    }
}

struct Step {
    pose: Rigid,
    mean_squared: f64,
}

/// Eq. (8): the pose with the least mean squared distance between the pairs.
fn step_to_points(source: &[Point], target: &NeighborIndex, pairs: &Pairs) -> Option<Step> {
    let targets = target.points();
    let mut sums = PairSums::default();
    for (i, j) in pairs.kept() {
        sums.add(&source[i], &targets[j], 1.0);
    }
    let pose = sums.solve()?;
    let squared = pairs
        .kept()
        .map(|(i, j)| distance_sq(&pose.apply(&source[i]), &targets[j]))
        .sum::<f64>();
    Some(Step {
        pose,
        mean_squared: squared / pairs.n_kept as f64,
    })
}

fn step_to_planes(
    source: &[Point],
    target: &NeighborIndex,
    surfaces: &[Surface],
    pose: &Rigid,
    pairs: &Pairs,
) -> Option<Step> {
    let targets = target.points();
    // The step turns about the middle of the pairs, where its linearisation is best.
    let moved: Vec<(Point, usize)> = pairs
        .kept()
        .map(|(i, j)| (pose.apply(&source[i]), j))
        .collect();
    let mut middle = [0.0; 3];
    for (p, _) in &moved {
        (0..3).for_each(|axis| middle[axis] += p[axis] / moved.len() as f64);
    }
    let about = |v: &Point| -> Point { std::array::from_fn(|axis| v[axis] - middle[axis]) };
    let mut sums = PlaneSums::default();
    for (p, j) in &moved {
        sums.add(&about(p), &about(&targets[*j]), &surfaces[*j].normal, 1.0);
    }
    let step = sums.solve()?;
    let to_middle = Rigid::from_euler([0.0; 3], middle.map(|v| -v));
    let step = to_middle.inverse() * step * to_middle;
    let squared = moved
        .iter()
        .map(|(p, j)| {
            let (q, n) = (step.apply(p), &surfaces[*j].normal);
            let off: f64 = (0..3)
                .map(|axis| (q[axis] - targets[*j][axis]) * n[axis])
                .sum();
            off * off
        })
        .sum::<f64>();
    Some(Step {
        pose: step * *pose,
        mean_squared: squared / moved.len() as f64,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::normals;
    use crate::random::Stream;

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
        let surfaces = normals::estimate(target, &index, 16, &Progress::silent()).unwrap();
        let options = IcpOptions {
            method: Some(method),
            kept_share,
            max_distance_m: (kept_share < 1.0).then_some(0.1),
            ..IcpOptions::default()
        };
        icp(
            source,
            &index,
            &surfaces,
            &Rigid::identity(),
            &options,
            &Progress::silent(),
        )
        .unwrap()
    }

    #[test]
    fn both_methods_undo_a_known_motion_exactly() {
        let target = sheet(2000, 1);
        let pose = Rigid::from_euler([0.01, -0.015, 0.02], [0.004, -0.003, 0.005]);
        let source: Vec<Point> = target.iter().map(|p| pose.inverse().apply(p)).collect();
        for method in [IcpMethod::PointToPoint, IcpMethod::PointToPlane] {
            let found = run(&source, &target, method, 1.0);
            assert!(
                (found.target_from_source.rotation - pose.rotation).amax() < 1e-6,
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
    fn trimming_keeps_a_partial_overlap_in_place() {
        // Independent samples of one sheet; the source lacks what lies at y > 0.7 and has an
        // excrescence instead that the target does not know.
        let target: Vec<Point> = sheet(6000, 2).into_iter().filter(|p| p[1] < 0.7).collect();
        let mut source: Vec<Point> = sheet(6000, 3);
        source.extend((0..500).map(|i| [0.3, 0.9, 0.3 + 0.001 * f64::from(i)]));
        let trimmed = run(&source, &target, IcpMethod::PointToPlane, 0.9);
        assert!(trimmed.target_from_source.rotation_angle_rad() < 0.004);
        assert!(trimmed.target_from_source.translation.norm() < 0.004);
        let plain = run(&source, &target, IcpMethod::PointToPoint, 1.0);
        assert!(
            plain.target_from_source.translation.norm() > 0.01,
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

    #[test]
    fn options_out_of_range_are_named() {
        let options = IcpOptions {
            kept_share: 0.0,
            ..IcpOptions::default()
        };
        assert!(
            options
                .check()
                .unwrap_err()
                .to_string()
                .contains("icp.kept_share")
        );
        let options = IcpOptions {
            max_iterations: 0,
            ..IcpOptions::default()
        };
        assert!(
            options
                .check()
                .unwrap_err()
                .to_string()
                .contains("icp.max_iterations")
        );
    }
}
