//! How far a pose brings two clouds into agreement: shares of inliers of both, their misfit, what conflicts.
//!
//! Source: ours; measured in docs/robust_search.md.

use super::conflicts::conflicts;
use super::{FindsPartner, Witnesses, median};
use crate::cloud::{Point, difference, dot};
use crate::neighbors::WIDTH;
use crate::parallel;
use crate::similarity::Similarity;

/// How far two clouds agree at a pose, counted in both directions.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Agreement {
    /// What the witnesses of both clouds with a partner within the distance and with an agreeing normal
    /// stand for, by twice the smaller cloud, 0 to 1.
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
    let ((forth, misfit), back) = parallel::both(
        || {
            let mut apart = Misfit::default();
            let count = counted(moving.0, fixed, pose, tolerance, |pair| {
                let own = pose.scale * moving.0.cloud.surfaces[pair.from].roughness_m;
                let theirs = fixed.0.cloud.surfaces[pair.to].roughness_m;
                apart.add(pair.off_plane, own * own + theirs * theirs);
            });
            (count, apart.ratio(LEAST_ROUGHNESS * tolerance.distance_m))
        },
        || counted(fixed.0, moving, &pose.inverse(), tolerance, |_| ()),
    );
    let clouds = [moving.0, fixed.0];
    let area = |of: fn(&Count) -> f64| {
        of(&forth) * clouds[0].size_of_each() + of(&back) * clouds[1].size_of_each()
    };
    let inliers = area(|count| count.n_inliers);
    let conflicts = area(|count| count.n_conflicts);
    Agreement {
        // Where one cloud is rougher it shows more area of the same surface, and both together too much.
        inlier_share: by_smaller(clouds, inliers, |cloud| cloud.len() as f64).min(1.0),
        weighted_share: by_smaller(
            clouds,
            area(|count| count.inlier_weight),
            Witnesses::total_weight,
        ),
        misfit,
        conflict_share: share(conflicts, conflicts + inliers),
    }
}

/// [`Agreement::weighted_share`] alone.
pub fn weighted_share<P: FindsPartner + Sync>(
    moving: (&Witnesses, &P),
    fixed: (&Witnesses, &P),
    pose: &Similarity,
    tolerance: Tolerance,
) -> f64 {
    let weight = |from: &Witnesses, to: (&Witnesses, &P), to_from: &Similarity| {
        let mut weight = 0.0;
        each_pair(from, to, to_from, tolerance, |pair| weight += pair.weight);
        weight * from.size_of_each()
    };
    let (forth, back) = parallel::both(
        || weight(moving.0, fixed, pose),
        || weight(fixed.0, moving, &pose.inverse()),
    );
    by_smaller([moving.0, fixed.0], forth + back, Witnesses::total_weight)
}

/// What was found of both clouds, by twice all that there is `of_all` witnesses of the smaller one.
fn by_smaller(
    [moving, fixed]: [&Witnesses; 2],
    found: f64,
    of_all: impl Fn(&Witnesses) -> f64,
) -> f64 {
    let smaller = if moving.size <= fixed.size {
        moving
    } else {
        fixed
    };
    share(found, 2.0 * of_all(smaller) * smaller.size_of_each())
}

fn share(part: f64, whole: f64) -> f64 {
    if whole > 0.0 { part / whole } else { 0.0 }
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
    each_pair(moving, fixed, pose, tolerance, |pair| {
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

/// Counts the witnesses of `from` that have a partner, of whom each pair is shown to `visit`, and those that conflict.
fn counted<P: FindsPartner>(
    from: &Witnesses,
    to: (&Witnesses, &P),
    to_from: &Similarity,
    tolerance: Tolerance,
    mut visit: impl FnMut(&Pair),
) -> Count {
    let mut count = Count::default();
    let look = |i: usize, moved: &Point, near: Option<usize>| match near {
        Some(near) => {
            if let Some(pair) = Pair::at(to_from, (from, i, moved), (to.0, near), tolerance) {
                count.n_inliers += 1.0;
                count.inlier_weight += pair.weight;
                visit(&pair);
            }
        }
        None if conflicts(moved, to, tolerance.distance_m) => count.n_conflicts += 1.0,
        None => (),
    };
    each_witness(from, to.1, to_from, tolerance.distance_m, look);
    count
}

/// A witness and its partner, how far it lies from the partner's plane, and what both weigh together.
struct Pair {
    from: usize,
    to: usize,
    off_plane: f64,
    weight: f64,
}

impl Pair {
    /// Witness `i`, where it was moved to, and the point `near` it; `None` where the surfaces there are not the same.
    #[inline]
    fn at(
        to_from: &Similarity,
        (from, i, moved): (&Witnesses, usize, &Point),
        (to, near): (&Witnesses, usize),
        tolerance: Tolerance,
    ) -> Option<Self> {
        /// Normals agree within 37°, whichever way they point.
        const MIN_COSINE: f64 = 0.8;
        let own = to_from.rigid.rotate(&from.cloud.surfaces[i].normal);
        let normal = &to.cloud.surfaces[near].normal;
        let cosine = dot(&own, normal);
        let off_plane = dot(&difference(moved, &to.cloud.points()[near]), normal).abs();
        (cosine.abs() > MIN_COSINE && off_plane <= tolerance.off_plane_m).then(|| Self {
            from: i,
            to: near,
            off_plane,
            weight: from.weights[i].min(to.weights[near]),
        })
    }
}

/// Calls `visit` with every witness of `from` that has a partner with an agreeing normal in the other cloud.
fn each_pair<P: FindsPartner>(
    from: &Witnesses,
    to: (&Witnesses, &P),
    to_from: &Similarity,
    tolerance: Tolerance,
    mut visit: impl FnMut(&Pair),
) {
    let look = |i: usize, moved: &Point, near: Option<usize>| {
        let pair =
            near.and_then(|near| Pair::at(to_from, (from, i, moved), (to.0, near), tolerance));
        pair.iter().for_each(&mut visit);
    };
    each_witness(from, to.1, to_from, tolerance.distance_m, look);
}

/// Calls `visit` with every witness of `from`, where it was moved to, and a point of the other cloud, that of `finder`,
/// within the distance from there.
fn each_witness<P: FindsPartner>(
    from: &Witnesses,
    finder: &P,
    to_from: &Similarity,
    distance_m: f64,
    mut visit: impl FnMut(usize, &Point, Option<usize>),
) {
    let max_sq = distance_m * distance_m;
    for some in from.numbers().chunks(WIDTH) {
        let mut moved = [[f64::NAN; 3]; WIDTH];
        for (moved, i) in moved.iter_mut().zip(some) {
            *moved = to_from.apply(&from.cloud.points()[*i as usize]);
        }
        let found = finder.partners(&moved, max_sq);
        for ((i, moved), near) in some.iter().zip(&moved).zip(found) {
            visit(*i as usize, moved, near);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::Grids;
    use super::*;
    use crate::cloud::Cloud;
    use crate::distance_field::NearestGrid;
    use crate::near_field::NearField;
    use crate::progress::Progress;
    use crate::random::Stream;
    use crate::rigid::Rigid;
    use crate::surface_cloud::SurfaceCloud;

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

    fn witnesses(clouds: [SurfaceCloud; 2], n: usize, radius: f64, spacing: f64) -> [Witnesses; 2] {
        Witnesses::of_both(clouds, n, radius, spacing, &Progress::silent()).unwrap()
    }

    fn agree(a: &Witnesses, b: &Witnesses, pose: &Rigid, tolerance: Tolerance) -> Agreement {
        let (a, b) = ((a, &*a.cloud.index), (b, &*b.cloud.index));
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
        assert!((0.85..=1.0).contains(&forth.inlier_share), "{forth:?}");
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
        let noise_m = off_plane_noise_m(&a, (&b, &*b.cloud.index), &pose.into(), 0.05);
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
        let (a_tree, b_tree) = ((&a, &*a.cloud.index), (&b, &*b.cloud.index));
        let alone = weighted_share(a_tree, b_tree, &lifted.into(), tolerance);
        assert_eq!(alone, there.weighted_share);
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
                let numbers = witnesses.numbers().iter().map(|i| *i as usize);
                let chosen: Vec<f64> = numbers
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
