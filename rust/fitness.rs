//! How well a pose brings two clouds together: the paper's RMS, and a symmetric share of inliers.
//!
//! Why two: the RMS of Eq. (1) is what the paper minimises. Under partial overlap it is not even
//! smallest at the true pose, so it cannot choose between poses. The share of points of *both*
//! clouds that find a partner nearby, with agreeing surfaces, can.
//! Source: Ren, Zhao & Han (2023), Eq. (1). Deviates: N_s is all source points, because the shared
//! region is unknown before registration; the symmetric share is ours.
//! Absent on purpose: any search.

use crate::cloud::{Point, distance_sq};
use crate::neighbors::NeighborIndex;
use crate::point_to_plane::PlaneSums;
use crate::rigid::Rigid;
use crate::surface_cloud::SurfaceCloud;

/// The RMS of Eq. (1): root mean squared distance from the moved source points to their nearest
/// target points. NaN for an empty source, infinite for an empty target.
///
/// ```
/// use tmchho::{Rigid, fitness, neighbors::NeighborIndex};
/// let target = NeighborIndex::new(&[[0.0, 0.0, 0.0], [10.0, 0.0, 0.0]]);
/// let source = [[0.0, 3.0, 0.0], [10.0, 4.0, 0.0]];
/// let rms = fitness::rms(&source, &target, &Rigid::identity());
/// assert!((rms - 12.5_f64.sqrt()).abs() < 1e-12);
/// ```
pub fn rms(source: &[Point], target: &NeighborIndex, pose: &Rigid) -> f64 {
    rms_below(source, target, pose, f64::INFINITY)
}

/// The same, or infinity as soon as it is certain that the value would not be below `limit`: exact
/// for a caller who only takes better values, and cheaper for him.
pub fn rms_below(source: &[Point], target: &NeighborIndex, pose: &Rigid, limit: f64) -> f64 {
    let n = source.len() as f64;
    let sum_limit = limit * limit * n;
    let mut sum = 0.0;
    for p in source {
        sum += target
            .nearest(&pose.apply(p))
            .map_or(f64::INFINITY, |neighbor| neighbor.distance_sq);
        if sum >= sum_limit {
            return f64::INFINITY;
        }
    }
    (sum / n).sqrt()
}

/// How far two clouds agree at a pose, counted in both directions.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Agreement {
    /// Points of both clouds with a partner within the distance and with an agreeing normal, by
    /// twice the number of points of the smaller cloud; 0 to about 1.
    pub inlier_share: f64,
    /// The same with every point weighted by the curvature of its surface: planes, which agree
    /// anywhere along themselves, count little. Compares poses of one pair of clouds.
    pub score: f64,
    /// Share of the moving points with a partner, whatever its normal.
    pub overlap_of_moving: f64,
    /// Share of the fixed points with a partner, whatever its normal.
    pub overlap_of_fixed: f64,
    /// Number of moving points with a partner, whatever its normal.
    pub n_moving_with_partner: usize,
    /// Root mean squared distance of the moving points that have a partner; 0 where none has.
    pub inlier_rmse: f64,
}

/// Which part of the clouds is looked at: the first so many points of each. The order of the points
/// should be random, and both numbers the same share of their clouds.
#[derive(Debug, Clone, Copy)]
pub struct Sample {
    /// Points of the moving cloud.
    pub n_moving: usize,
    /// Points of the fixed cloud.
    pub n_fixed: usize,
}

/// Counts partners within `max_distance` at `pose` (fixed from moving).
pub fn agreement(
    moving: &SurfaceCloud,
    fixed: &SurfaceCloud,
    pose: &Rigid,
    max_distance: f64,
    sample: Sample,
) -> Agreement {
    let max_sq = max_distance * max_distance;
    let n_moving = sample.n_moving.min(moving.len());
    let n_fixed = sample.n_fixed.min(fixed.len());
    let forth = count(moving, fixed, pose, max_sq, max_distance, n_moving);
    let back = count(
        fixed,
        moving,
        &pose.inverse(),
        max_sq,
        max_distance,
        n_fixed,
    );
    let share = |part: f64, whole: f64| if whole > 0.0 { part / whole } else { 0.0 };
    let (n_smaller, weight_of_smaller) = if n_moving <= n_fixed {
        (n_moving, forth.weight)
    } else {
        (n_fixed, back.weight)
    };
    Agreement {
        inlier_share: share(forth.n_inliers + back.n_inliers, 2.0 * n_smaller as f64),
        score: share(
            forth.inlier_weight + back.inlier_weight,
            2.0 * weight_of_smaller,
        ),
        overlap_of_moving: share(forth.n_near, n_moving as f64),
        overlap_of_fixed: share(back.n_near, n_fixed as f64),
        n_moving_with_partner: forth.n_near as usize,
        inlier_rmse: share(forth.near_sq, forth.n_near).sqrt(),
    }
}

/// How firmly the common surface holds the pose: the point-to-plane information matrix about the
/// middle of the moving points that have a partner, and their mean distance from that middle.
#[derive(Debug, Clone, Copy)]
pub struct Hold {
    /// The normal equations.
    pub planes: PlaneSums,
    /// Root mean squared distance of the points from their middle.
    pub radius_m: f64,
}

/// Sums up what holds `moving` on `fixed` at `pose`, over partners within `max_distance`.
pub fn hold(moving: &SurfaceCloud, fixed: &SurfaceCloud, pose: &Rigid, max_distance: f64) -> Hold {
    let max_sq = max_distance * max_distance;
    let held: Vec<(Point, Point)> = moving
        .points()
        .iter()
        .map(|p| pose.apply(p))
        .filter_map(|p| {
            let partner = fixed.index.nearest_within(&p, max_sq)?;
            Some((p, fixed.surfaces[partner.index as usize].normal))
        })
        .collect();
    let n = held.len().max(1) as f64;
    let mut middle = [0.0; 3];
    for (p, _) in &held {
        (0..3).for_each(|axis| middle[axis] += p[axis] / n);
    }
    let mut planes = PlaneSums::default();
    let mut squared = 0.0;
    for (p, normal) in &held {
        let about = std::array::from_fn(|axis| p[axis] - middle[axis]);
        planes.add(&about, &about, normal, 1.0);
        squared += distance_sq(p, &middle);
    }
    Hold {
        planes,
        radius_m: (squared / n).sqrt(),
    }
}

#[derive(Default)]
struct Count {
    weight: f64,
    inlier_weight: f64,
    n_inliers: f64,
    n_near: f64,
    near_sq: f64,
}

fn count(
    from: &SurfaceCloud,
    to: &SurfaceCloud,
    to_from: &Rigid,
    max_sq: f64,
    max_distance: f64,
    n: usize,
) -> Count {
    /// Normals agree within 37°, whichever way they point.
    const MIN_COSINE: f64 = 0.8;
    let mut count = Count::default();
    for (p, surface) in from.points()[..n].iter().zip(&from.surfaces) {
        let weight = curvature_weight(surface.curvature);
        count.weight += weight;
        let moved = to_from.apply(p);
        if !to.is_near_box(&moved, max_distance) {
            continue;
        }
        let Some(partner) = to.index.nearest_within(&moved, max_sq) else {
            continue;
        };
        count.n_near += 1.0;
        count.near_sq += partner.distance_sq;
        let (a, b) = (
            to_from.rotate(&surface.normal),
            to.surfaces[partner.index as usize].normal,
        );
        if (a[0] * b[0] + a[1] * b[1] + a[2] * b[2]).abs() > MIN_COSINE {
            count.n_inliers += 1.0;
            count.inlier_weight += weight;
        }
    }
    count
}

/// Planes weigh little, but not nothing: a scene of planes alone can still be scored.
fn curvature_weight(curvature: f64) -> f64 {
    const FULL_WEIGHT_CURVATURE: f64 = 0.04;
    const LEAST_WEIGHT: f64 = 0.03;
    (curvature / FULL_WEIGHT_CURVATURE).min(1.0) + LEAST_WEIGHT
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cloud::Cloud;
    use crate::progress::Progress;
    use crate::random::Stream;

    fn bumpy(n: usize, seed: u64) -> Vec<Point> {
        let mut stream = Stream::new(seed, "bumpy", 0);
        (0..n)
            .map(|_| [stream.uniform(), stream.uniform()])
            .map(|[x, y]| [x, y, 0.2 * (9.0 * x).sin() * (7.0 * y).cos()])
            .collect()
    }

    fn surfaces(points: &[Point]) -> SurfaceCloud {
        SurfaceCloud::new(&Cloud::new(points).unwrap(), 0, &Progress::silent()).unwrap()
    }

    #[test]
    fn abandoning_early_changes_no_answer_that_counts() {
        let target = NeighborIndex::new(&bumpy(500, 1));
        let source = bumpy(200, 2);
        let pose = Rigid::from_euler([0.1, 0.2, 0.3], [0.1, 0.0, 0.0]);
        let exact = rms(&source, &target, &pose);
        assert_eq!(rms_below(&source, &target, &pose, exact * 1.01), exact);
        assert_eq!(
            rms_below(&source, &target, &pose, exact * 0.5),
            f64::INFINITY
        );
    }

    #[test]
    fn a_cloud_agrees_with_itself_and_not_with_itself_far_away() {
        let cloud = surfaces(&bumpy(800, 3));
        let sample = Sample {
            n_moving: 800,
            n_fixed: 800,
        };
        let here = agreement(&cloud, &cloud, &Rigid::identity(), 0.01, sample);
        assert_eq!((here.inlier_share, here.overlap_of_moving), (1.0, 1.0));
        assert_eq!(here.inlier_rmse, 0.0);
        let away = Rigid::from_euler([0.0; 3], [10.0, 0.0, 0.0]);
        let there = agreement(&cloud, &cloud, &away, 0.01, sample);
        assert_eq!(
            (there.inlier_share, there.score, there.overlap_of_fixed),
            (0.0, 0.0, 0.0)
        );
    }

    #[test]
    fn half_a_cloud_on_the_whole_counts_half_of_the_fixed_one() {
        let whole = bumpy(1000, 4);
        let half: Vec<Point> = whole.iter().copied().filter(|p| p[0] < 0.5).collect();
        let (n_moving, n_fixed) = (half.len(), whole.len());
        let (moving, fixed) = (surfaces(&half), surfaces(&whole));
        let as_given = Rigid::identity().between_local_coordinates(moving.origin, fixed.origin);
        let found = agreement(
            &moving,
            &fixed,
            &as_given,
            1e-9,
            Sample { n_moving, n_fixed },
        );
        assert_eq!(found.overlap_of_moving, 1.0);
        assert_eq!(found.overlap_of_fixed, n_moving as f64 / n_fixed as f64);
    }
}
