//! How well a pose brings two clouds together: the paper's RMS, and a symmetric share of inliers.
//!
//! Why two: the RMS of Eq. (1) is what the paper minimises. Under partial overlap it is not even
//! smallest at the true pose, so it cannot choose between poses. The share of points of *both*
//! clouds that find a partner nearby, with agreeing surfaces, can.
//! Source: Ren, Zhao & Han (2023), Eq. (1). Deviates: N_s is all source points, because the shared
//! region is unknown before registration; the symmetric share is ours.
//! Absent on purpose: any search.

mod conflicts;
mod finder;
mod offset;
mod witnesses;

pub(crate) use conflicts::lies_off;
use conflicts::n_conflicts;

use crate::cloud::{Point, difference, distance_sq, dot};
use crate::error::Result;
use crate::neighbors::{Neighbor, NeighborIndex};
use crate::parallel;
use crate::point_to_plane::PlaneSums;
use crate::progress::Progress;
use crate::rigid::Rigid;
use crate::similarity::Similarity;
use crate::surface_cloud::SurfaceCloud;

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

/// How far two clouds agree at a pose, counted in both directions.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Agreement {
    /// What the witnesses of both clouds with a partner within the distance and with an agreeing normal
    /// stand for, by twice the smaller cloud; 0 to about 1.
    pub inlier_share: f64,
    /// The same by weight: of each pair, the lesser one of its two.
    pub weighted_share: f64,
    /// How far the surfaces lie apart, by how rough they are themselves: the median distance of
    /// partners from each other's planes, by the median of what the roughness of both explains. About
    /// 0.2 to 1.1 where both show the same place, more where they only resemble each other; NaN where
    /// too few witnesses find a partner.
    pub misfit: f64,
    /// What the witnesses that lie above or below the other cloud's surface, not beside it, stand for, by
    /// these and those with a partner, 0 to 1. At the right pose it is what one sensor saw through, behind
    /// or since the other; at a wrong one surfaces cross each other. 0 where there are neither.
    pub conflict_share: f64,
}

impl Agreement {
    /// What poses of one pair of clouds are ranked by: the weighted share, less what conflicts with it,
    /// divided by the misfit where that is above 1.
    pub fn score(&self) -> f64 {
        // The larger of 1 and NaN is 1.
        self.weighted_share * self.concord() / self.misfit.max(1.0)
    }

    /// What conflicts leave of a share: 1 where there are none. A conflict weighs as much as several pairs:
    /// where two surfaces cross, few points conflict and many find a partner. Not too many: two scanners that
    /// see a wall from both sides also conflict.
    pub fn concord(&self) -> f64 {
        const WEIGHT: i32 = 4;
        (1.0 - self.conflict_share).powi(WEIGHT)
    }

    /// The share of inliers, less what conflicts with it.
    pub fn net_share(&self) -> f64 {
        self.inlier_share * self.concord()
    }
}

/// Who counts as a partner.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tolerance {
    /// Greatest distance between the points.
    pub distance_m: f64,
    /// Greatest distance of the point from the partner's plane. Points of two samplings never
    /// coincide, but they lie in each other's planes as closely as the sensors are good.
    pub off_plane_m: f64,
}

impl Tolerance {
    /// Any point within the distance, wherever its plane lies.
    pub fn within(distance_m: f64) -> Self {
        Self {
            distance_m,
            off_plane_m: distance_m,
        }
    }
}

/// Counts partners at `pose` (fixed from moving).
pub fn agreement<P: FindsPartner + Sync>(
    moving: (&Witnesses, &P),
    fixed: (&Witnesses, &P),
    pose: &Similarity,
    tolerance: Tolerance,
) -> Agreement {
    let inverse = pose.inverse();
    let ((forth, misfit), back) = parallel::both(
        || {
            let (mut count, mut apart) = (Count::default(), Misfit::default());
            each_partner(moving.0, fixed, pose, tolerance, |pair| {
                count.add(pair.weight);
                let own = pose.scale * moving.0.cloud.surfaces[pair.from].roughness_m;
                let theirs = fixed.0.cloud.surfaces[pair.to].roughness_m;
                apart.add(pair.off_plane, own * own + theirs * theirs);
            });
            count.n_conflicts = n_conflicts(moving.0, fixed, pose, tolerance.distance_m);
            let misfit = apart.ratio(LEAST_ROUGHNESS * tolerance.distance_m);
            (count, misfit)
        },
        || {
            let mut count = Count::default();
            each_partner(fixed.0, moving, &inverse, tolerance, |pair| {
                count.add(pair.weight);
            });
            count.n_conflicts = n_conflicts(fixed.0, moving, &inverse, tolerance.distance_m);
            count
        },
    );
    let (moving, fixed) = (moving.0, fixed.0);
    let smaller = if moving.size <= fixed.size {
        moving
    } else {
        fixed
    };
    let sum = |of_moving: f64, of_fixed: f64| {
        of_moving * moving.size_of_each() + of_fixed * fixed.size_of_each()
    };
    let by = |part: f64, whole: f64| if whole > 0.0 { part / whole } else { 0.0 };
    let by_size = |of_moving: f64, of_fixed: f64, of_smaller: f64| {
        let whole = 2.0 * of_smaller * smaller.size_of_each();
        by(sum(of_moving, of_fixed), whole)
    };
    let inliers = sum(forth.n_inliers, back.n_inliers);
    let conflicts = sum(forth.n_conflicts, back.n_conflicts);
    Agreement {
        inlier_share: by_size(forth.n_inliers, back.n_inliers, smaller.len() as f64),
        weighted_share: by_size(
            forth.inlier_weight,
            back.inlier_weight,
            smaller.total_weight(),
        ),
        misfit,
        conflict_share: by(conflicts, conflicts + inliers),
    }
}

/// Clouds smoother than this share of the tolerance count as that rough.
const LEAST_ROUGHNESS: f64 = 0.004;

/// Distances between surfaces, and what their roughness explains of them.
#[derive(Default)]
struct Misfit {
    apart: Vec<f64>,
    /// Squared.
    rough_sq: Vec<f64>,
}

impl Misfit {
    fn add(&mut self, apart: f64, rough_sq: f64) {
        self.apart.push(apart);
        self.rough_sq.push(rough_sq);
    }

    /// Median by median.
    fn ratio(&mut self, least_roughness: f64) -> f64 {
        /// Fewer pairs tell nothing.
        const LEAST_PAIRS: usize = 30;
        if self.apart.len() < LEAST_PAIRS {
            return f64::NAN;
        }
        median(&mut self.apart) / median(&mut self.rough_sq).sqrt().max(least_roughness)
    }
}

fn median(values: &mut [f64]) -> f64 {
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}

/// Distance from the partners' planes that the clouds keep at `pose`: three times its robust
/// standard deviation over the witnesses of `moving` that find a partner; 0 where none does.
pub fn off_plane_noise_m<P: FindsPartner>(
    moving: &Witnesses,
    fixed: (&Witnesses, &P),
    pose: &Similarity,
    max_distance_m: f64,
) -> f64 {
    /// From the median of absolute deviations to the standard deviation of a normal law.
    const MEDIAN_TO_DEVIATION: f64 = 1.4826;
    let mut found = Vec::new();
    let tolerance = Tolerance::within(max_distance_m);
    each_partner(moving, fixed, pose, tolerance, |pair| {
        found.push(pair.off_plane)
    });
    if found.is_empty() {
        return 0.0;
    }
    3.0 * MEDIAN_TO_DEVIATION * median(&mut found)
}

#[derive(Default)]
struct Count {
    n_inliers: f64,
    inlier_weight: f64,
    n_conflicts: f64,
}

impl Count {
    fn add(&mut self, weight: f64) {
        self.n_inliers += 1.0;
        self.inlier_weight += weight;
    }
}

/// A witness and its partner, how far it lies from the partner's plane, and what both weigh together.
struct Partners {
    from: usize,
    to: usize,
    off_plane: f64,
    weight: f64,
}

/// Calls `visit` with every witness of `from` that has a partner with an agreeing normal in the other cloud.
fn each_partner<P: FindsPartner>(
    from: &Witnesses,
    (witnesses, finder): (&Witnesses, &P),
    to_from: &Similarity,
    tolerance: Tolerance,
    mut visit: impl FnMut(Partners),
) {
    /// Normals agree within 37°, whichever way they point.
    const MIN_COSINE: f64 = 0.8;
    let max_sq = tolerance.distance_m * tolerance.distance_m;
    let to = &witnesses.cloud;
    for i in from.numbers() {
        let moved = to_from.apply(&from.cloud.points()[i]);
        if !to.is_near_box(&moved, tolerance.distance_m) {
            continue;
        }
        let Some(partner) = finder.partner(&moved, max_sq) else {
            continue;
        };
        let own = to_from.rigid.rotate(&from.cloud.surfaces[i].normal);
        let normal = &to.surfaces[partner].normal;
        let cosine = dot(&own, normal);
        let off_plane = dot(&difference(&moved, &to.points()[partner]), normal);
        if cosine.abs() > MIN_COSINE && off_plane.abs() <= tolerance.off_plane_m {
            visit(Partners {
                from: i,
                to: partner,
                off_plane: off_plane.abs(),
                weight: from.weights[i].min(witnesses.weights[partner]),
            });
        }
    }
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cloud::Cloud;
    use crate::distance_field::NearestGrid;
    use crate::near_field::NearField;
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

    fn witnesses(clouds: [SurfaceCloud; 2], n: usize, radius: f64, spacing: f64) -> [Witnesses; 2] {
        Witnesses::of_both(clouds, n, radius, spacing, &Progress::silent()).unwrap()
    }

    fn agree(a: &Witnesses, b: &Witnesses, pose: &Rigid, tolerance: Tolerance) -> Agreement {
        let (a, b) = ((a, &a.cloud.index), (b, &b.cloud.index));
        agreement(a, b, &pose.into(), tolerance)
    }

    #[test]
    fn a_cloud_agrees_with_itself_and_not_with_itself_far_away() {
        let cloud = || surfaces(&bumpy(800, 3));
        let [a, b] = witnesses([cloud(), cloud()], 400, 0.1, 0.03);
        let tolerance = Tolerance::within(0.01);
        let here = agree(&a, &b, &Rigid::identity(), tolerance);
        assert_eq!(
            (here.inlier_share, here.score(), here.misfit),
            (1.0, 1.0, 0.0)
        );
        let away = Rigid::from_euler([0.0; 3], [10.0, 0.0, 0.0]);
        let there = agree(&a, &b, &away, tolerance);
        assert_eq!((there.inlier_share, there.score()), (0.0, 0.0));
        assert!(there.misfit.is_nan());
        let supported = |pose: Rigid| {
            support(&a.cloud, &b.cloud, &pose.into(), 0.01, &Progress::silent()).unwrap()
        };
        let here = supported(Rigid::identity());
        assert_eq!((here.n_inliers, here.inlier_rmse_m), (800, 0.0));
        assert_eq!(supported(away).n_inliers, 0);
    }

    #[test]
    fn half_a_cloud_on_the_whole_is_no_worse_than_the_whole_on_the_half() {
        let whole = bumpy(1000, 4);
        let half: Vec<Point> = whole.iter().copied().filter(|p| p[0] < 0.5).collect();
        let (moving, fixed) = (surfaces(&half), surfaces(&whole));
        let as_given = Rigid::identity().between_local_coordinates(moving.origin, fixed.origin);
        let [a, b] = witnesses([moving, fixed], 400, 0.1, 0.03);
        let tolerance = Tolerance::within(0.01);
        let forth = agree(&a, &b, &as_given, tolerance);
        let back = agree(&b, &a, &as_given.inverse(), tolerance);
        assert!(
            forth.inlier_share > 0.85 && forth.inlier_share < 1.15,
            "{forth:?}"
        );
        assert!((forth.weighted_share - back.weighted_share).abs() < 1e-12);
    }

    #[test]
    fn surfaces_that_cross_conflict_and_those_that_end_do_not() {
        let whole = bumpy(4000, 5);
        let part = |low: f64, high: f64| -> SurfaceCloud {
            let within = |p: &&Point| (low..high).contains(&p[0]);
            surfaces(&whole.iter().filter(within).copied().collect::<Vec<_>>())
        };
        // Two thirds each, a third in common.
        let (left, right) = (part(0.0, 0.66), part(0.33, 1.0));
        let as_given = Rigid::identity().between_local_coordinates(left.origin, right.origin);
        let [a, b] = witnesses([left, right], 3000, 0.1, 0.016);
        let tolerance = Tolerance::within(0.02);
        let here = agree(&a, &b, &as_given, tolerance);
        assert!(
            here.inlier_share > 0.4 && here.conflict_share < 0.02,
            "{here:?}"
        );
        let tilted = Rigid::from_euler([0.0, 0.2, 0.0], [0.0; 3]) * as_given;
        let there = agree(&a, &b, &tilted, tolerance);
        assert!(there.conflict_share > 0.2, "{there:?}");
        assert!(there.score() < 0.2 * there.weighted_share);
        // The share is of both clouds, whichever is said to move.
        let back = agree(&b, &a, &tilted.inverse(), tolerance);
        assert!((back.conflict_share - there.conflict_share).abs() < 1e-12);
    }

    fn floor(lift: f64, seed: u64) -> SurfaceCloud {
        let mut stream = Stream::new(seed, "floor", 0);
        let points: Vec<Point> = (0..4000)
            .map(|_| [stream.uniform(), stream.uniform(), stream.normal()])
            .map(|[x, y, e]| [x, y, lift + 0.002 * e + if x > 0.5 { 0.3 } else { 0.0 }])
            .collect();
        surfaces(&points)
    }

    #[test]
    fn noise_is_measured_off_the_planes_and_told_from_a_shift() {
        let (low, high) = (floor(0.0, 1), floor(0.0, 2));
        let pose = Rigid::identity().between_local_coordinates(high.origin, low.origin);
        let [a, b] = witnesses([high, low], 4000, 0.05, 0.016);
        let noise_m = off_plane_noise_m(&a, (&b, &b.cloud.index), &pose.into(), 0.05);
        // Two samplings of 2 mm each, and the noise of the normals over the step to the partner.
        assert!((0.006..0.015).contains(&noise_m), "{noise_m}");
        let tolerance = Tolerance {
            distance_m: 0.05,
            off_plane_m: noise_m,
        };
        let lifted = Rigid {
            translation: pose.translation.add_scalar(0.02),
            ..pose
        };
        let here = agree(&a, &b, &pose, tolerance);
        let there = agree(&a, &b, &lifted, tolerance);
        assert!(
            here.inlier_share > 0.9 && there.inlier_share < 0.1,
            "{here:?} {there:?}"
        );
        let lax = agree(&a, &b, &lifted, Tolerance::within(0.05));
        assert!(lax.inlier_share > 0.9);
    }

    #[test]
    fn the_misfit_tells_a_place_from_one_a_little_higher() {
        let (low, high) = (floor(0.0, 1), floor(0.0, 2));
        let pose = Rigid::identity().between_local_coordinates(high.origin, low.origin);
        let [a, b] = witnesses([high, low], 4000, 0.05, 0.016);
        // 2 cm between surfaces of 2 mm of noise each: 20 / (2·√2) sigmas, by a median of 0.67.
        for (lift, misfit) in [(0.0, 0.4..1.1), (0.02, 6.0..9.0)] {
            let lifted = Rigid::from_euler([0.0; 3], [0.0, 0.0, lift]) * pose;
            let found = agree(&a, &b, &lifted, Tolerance::within(0.04));
            assert!(misfit.contains(&found.misfit), "{lift}: {found:?}");
            assert!(found.inlier_share > 0.9);
            assert!(found.score() <= found.weighted_share / misfit.start.max(1.0));
        }
    }

    #[test]
    fn the_grids_count_like_the_index() {
        let (low, high) = (floor(0.0, 1), floor(0.0, 2));
        let pose = Rigid::identity().between_local_coordinates(high.origin, low.origin);
        let [a, b] = witnesses([high, low], 4000, 0.05, 0.016);
        let field = |w: &Witnesses| NearField::new(w.cloud.points(), 0.008, 0.04, 100_000).unwrap();
        let grid =
            |w: &Witnesses| NearestGrid::new(w.cloud.points(), 0.02, 0.3, 1_000_000).unwrap();
        let (near_a, near_b) = (field(&a), field(&b));
        let (far_a, far_b) = (grid(&a), grid(&b));
        let grids = |fine, coarse| Grids { fine, coarse };
        let (grids_a, grids_b) = (grids(&near_a, &far_a), grids(&near_b, &far_b));
        let tolerance = Tolerance::within(0.04);
        for shift in [0.0, 0.01, 0.1] {
            let moved = Rigid::from_euler([0.0; 3], [shift, 0.0, shift]) * pose;
            let exact = agree(&a, &b, &moved, tolerance);
            let quick = agreement((&a, &grids_a), (&b, &grids_b), &moved.into(), tolerance);
            let off = (exact.inlier_share - quick.inlier_share).abs();
            let conflicts_off = (exact.conflict_share - quick.conflict_share).abs();
            assert!(
                off < 0.03 && conflicts_off < 0.03,
                "{shift}: {exact:?} {quick:?}"
            );
        }
    }

    /// A floor, from `low` to `high` along x, with a ridge across it at 0.5.
    fn ridge(low: f64, high: f64, noise: f64, seed: u64) -> SurfaceCloud {
        let n_along = (50.0 * (high - low)).round() as usize;
        let mut stream = Stream::new(seed, "ridge", 0);
        let points: Vec<Point> = (0..50 * n_along)
            .map(|i| {
                [
                    low + (i % n_along) as f64 / 50.0,
                    (i / n_along) as f64 / 50.0,
                ]
            })
            .map(|[x, y]| {
                [
                    x,
                    y,
                    (0.1 - (x - 0.5).abs()).max(0.0) + noise * stream.normal(),
                ]
            })
            .collect();
        surfaces(&points)
    }

    #[test]
    fn a_ridge_weighs_more_than_a_floor_however_thick_with_noise() {
        for noise in [0.0, 0.01] {
            let clouds = [ridge(0.0, 1.0, noise, 1), ridge(0.0, 1.0, noise, 2)];
            let [witnesses, _] = witnesses(clouds, 2500, 0.08, 0.02);
            let cloud = &witnesses.cloud;
            let x = |i: usize| cloud.points()[i][0] + cloud.origin[0];
            let mean = |near: fn(f64) -> bool| {
                let chosen: Vec<f64> = (witnesses.numbers())
                    .filter(|i| near(x(*i)))
                    .map(|i| witnesses.weights[i])
                    .collect();
                chosen.iter().sum::<f64>() / chosen.len() as f64
            };
            let (on_ridge, on_floor) = (mean(|x| (x - 0.5).abs() < 0.02), mean(|x| x < 0.3));
            assert!(on_ridge > 8.0 * on_floor, "{noise}: {on_ridge} {on_floor}");
        }
    }

    #[test]
    fn a_ridge_on_its_like_is_worth_more_than_a_floor_on_any_noisy_floor() {
        let in_place_and_beside = |low: f64| {
            let (sharp, noisy) = (ridge(0.0, 1.0, 0.0, 1), ridge(low, 3.0, 0.02, 2));
            let right = Rigid::identity().between_local_coordinates(sharp.origin, noisy.origin);
            let [a, b] = witnesses([sharp, noisy], 2500, 0.08, 0.02);
            let beside = Rigid::from_euler([0.0; 3], [1.5, 0.0, 0.0]) * right;
            [right, beside].map(|pose| agree(&a, &b, &pose, Tolerance::within(0.05)))
        };
        let [here, there] = in_place_and_beside(0.4);
        assert!(
            here.inlier_share < 0.7 * there.inlier_share,
            "{here:?} {there:?}"
        );
        assert!(
            here.weighted_share > 1.2 * there.weighted_share,
            "{here:?} {there:?}"
        );
        // Where the border runs along the foot of the ridge, the floor outside counts as off its slope.
        let [here, there] = in_place_and_beside(0.2);
        assert!(here.score() > 1.2 * there.score(), "{here:?} {there:?}");
    }
}
