//! How well a pose brings two clouds together: the paper's RMS, and a symmetric share of inliers.
//!
//! Why two: the RMS of Eq. (1) is what the paper minimises. Under partial overlap it is not even
//! smallest at the true pose, so it cannot choose between poses. The share of points of *both*
//! clouds that find a partner nearby, with agreeing surfaces, can.
//! Source: Ren, Zhao & Han (2023), Eq. (1). Deviates: N_s is all source points, because the shared
//! region is unknown before registration; the symmetric share is ours.
//! Absent on purpose: any search.

mod agreement;
mod conflicts;
mod finder;
mod offset;
mod witnesses;

pub(crate) use conflicts::lies_off;

use crate::cloud::{Point, distance_sq};
use crate::error::Result;
use crate::neighbors::{Neighbor, NeighborIndex};
use crate::point_to_plane::PlaneSums;
use crate::progress::Progress;
use crate::rigid::Rigid;
use crate::similarity::Similarity;
use crate::surface_cloud::SurfaceCloud;

pub use agreement::{Agreement, Tolerance, agreement, off_plane_noise_m, weighted_share};
pub use finder::{FindsPartner, Grids};
pub use offset::surface_offset_m;
pub use witnesses::Witnesses;

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
    rms_below(source, target, pose, f64::INFINITY).0
}

/// The same, or infinity as soon as it is certain that the value would not be below `limit`: exact
/// for a caller who only takes better values, and cheaper for him. Also how many nearest points were
/// sought.
pub fn rms_below(
    source: &[Point],
    target: &NeighborIndex,
    pose: &Rigid,
    limit: f64,
) -> (f64, usize) {
    let n = source.len() as f64;
    let sum_limit = limit * limit * n;
    let mut sum = 0.0;
    for (i, p) in source.iter().enumerate() {
        sum += target
            .nearest(&pose.apply(p))
            .map_or(f64::INFINITY, |neighbor| neighbor.distance_sq);
        if sum >= sum_limit {
            return (f64::INFINITY, i + 1);
        }
    }
    ((sum / n).sqrt(), source.len())
}

/// What of the moving cloud lies on the fixed one at a pose, and how firmly that holds the pose.
#[derive(Debug, Clone, Copy)]
pub struct Support {
    /// Moving points with a partner.
    pub n_inliers: usize,
    /// Root mean squared distance of those pairs; 0 where there are none.
    pub inlier_rmse_m: f64,
    /// The point-to-plane normal equations of those pairs about their middle.
    pub planes: PlaneSums,
    /// Root mean squared distance of those points from their middle.
    pub radius_m: f64,
}

/// Looks at all points of `moving` that have a partner within `max_distance_m` at `pose`.
///
/// # Errors
/// [`crate::Error::Cancelled`].
pub fn support(
    moving: &SurfaceCloud,
    fixed: &SurfaceCloud,
    pose: &Similarity,
    max_distance_m: f64,
    progress: &Progress<'_>,
) -> Result<Support> {
    let max_sq = max_distance_m * max_distance_m;
    let places = moving.index.places().moved(|p| pose.apply(p));
    let partners = fixed.index.nearest_all_within(&places, max_sq, progress)?;
    let pairs: Vec<(Point, Neighbor)> = (moving.points().iter().zip(partners))
        .filter_map(|(p, partner)| Some((pose.apply(p), partner?)))
        .collect();
    let n = pairs.len().max(1) as f64;
    let mut middle = [0.0; 3];
    for (p, _) in &pairs {
        (0..3).for_each(|axis| middle[axis] += p[axis] / n);
    }
    let mut support = Support {
        n_inliers: pairs.len(),
        inlier_rmse_m: (pairs.iter().map(|(_, q)| q.distance_sq).sum::<f64>() / n).sqrt(),
        planes: PlaneSums::default(),
        radius_m: 0.0,
    };
    for (p, partner) in &pairs {
        let about = std::array::from_fn(|axis| p[axis] - middle[axis]);
        let normal = &fixed.surfaces[partner.index as usize].normal;
        support.planes.add(&about, &about, normal, 1.0);
        support.radius_m += distance_sq(p, &middle) / n;
    }
    support.radius_m = support.radius_m.sqrt();
    Ok(support)
}

fn median(values: &mut [f64]) -> f64 {
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
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
        let below = |limit| rms_below(&source, &target, &pose, limit);
        assert_eq!(below(exact * 1.01), (exact, 200));
        let (abandoned, n_searches) = below(exact * 0.5);
        assert_eq!(abandoned, f64::INFINITY);
        // The terms are in random order: a quarter of the sum is reached by about a quarter of them.
        assert!((20..100).contains(&n_searches), "{n_searches}");
    }
    #[test]
    fn a_cloud_supports_itself_and_not_itself_far_away() {
        let (a, b) = (surfaces(&bumpy(800, 3)), surfaces(&bumpy(800, 3)));
        let supported =
            |pose: Rigid| support(&a, &b, &pose.into(), 0.01, &Progress::silent()).unwrap();
        let here = supported(Rigid::identity());
        assert_eq!((here.n_inliers, here.inlier_rmse_m), (800, 0.0));
        let away = Rigid::from_euler([0.0; 3], [10.0, 0.0, 0.0]);
        assert_eq!(supported(away).n_inliers, 0);
    }
}
