//! From a start into the nearest basin: truncated ICP steps on grids that know nearest points.

use nalgebra::Matrix3;

use super::motion::Motion;
use crate::cloud::{Point, distance_sq};
use crate::distance_field::NearestGrid;
use crate::freedom::Freedom;
use crate::kabsch::PairSums;
use crate::near_field::NearField;
use crate::normals::Surface;
use crate::parallel;
use crate::point_to_plane::{PlaneSums, ScaledPlaneSums};
use crate::rigid::Rigid;
use crate::similarity::Similarity;

/// Truncation distances that shrink geometrically from `first` to `last` over the steps.
#[derive(Debug, Clone, Copy)]
pub(super) struct Shrinking {
    pub(super) first: f64,
    pub(super) last: f64,
    pub(super) n_steps: usize,
}

impl Shrinking {
    /// The same in a unit of that length.
    pub(super) fn times(&self, unit_m: f64) -> Self {
        Self {
            first: self.first * unit_m,
            last: self.last * unit_m,
            n_steps: self.n_steps,
        }
    }

    fn at(&self, step: usize) -> f64 {
        if self.n_steps < 2 {
            return self.last;
        }
        let progress = step as f64 / (self.n_steps - 1) as f64;
        self.first * (self.last / self.first).powf(progress)
    }
}

/// Where a step moves the points by less than this share of the truncation, the pose rests there, and the truncation
/// shrinks by as much as in so many steps.
const AT_REST: f64 = 0.01;
const STEPS_AT_REST: usize = 4;

/// Points that are looked up together.
const TOGETHER: usize = 64;

/// Point-to-point steps without a scale: pairs farther apart than the truncation do not pull.
pub(super) fn to_points(
    points: &[Point],
    grid: &NearestGrid,
    start: Rigid,
    motion: Motion,
    truncation: Shrinking,
) -> Rigid {
    let no_turn = Matrix3::identity();
    let mut pose = start;
    for step in 0..truncation.n_steps {
        let max_sq = truncation.at(step).powi(2);
        let mut sums = PairSums::default();
        for points in points.chunks(TOGETHER) {
            // First every cell, then every partner, and no branch: so many wait for memory at once.
            let mut found = [([0.0; 3], 0); TOGETHER];
            for (p, found) in points.iter().zip(&mut found) {
                let moved = pose.apply(p);
                *found = (moved, grid.index_of_nearest(&moved));
            }
            for (p, (moved, partner)) in points.iter().zip(&found) {
                let partner = &grid.points()[*partner as usize];
                let is_near = distance_sq(moved, partner) < max_sq;
                sums.add(p, partner, f64::from(u8::from(is_near)));
            }
        }
        let better = match motion {
            Motion::Free(Freedom::Levelled) => sums.solve_levelled(),
            Motion::Free(Freedom::Rigid | Freedom::Similarity) => sums.solve(),
            Motion::Upright(uprights) => {
                sums.solve_about(&uprights.up(), &uprights.rotation(&no_turn))
            }
        };
        match better {
            Some(better) => pose = better,
            None => break,
        }
    }
    pose
}

/// The fixed cloud as point-to-plane steps see it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Fixed<'a> {
    pub(super) surfaces: &'a [Surface],
    /// The whole box, coarsely.
    pub(super) grid: &'a NearestGrid,
    /// What lies close, finely; asked first where it is given.
    pub(super) field: Option<&'a NearField>,
}

impl Fixed<'_> {
    /// A point near `place` whose surface has about the slope of `normal`.
    #[inline]
    fn partner(&self, place: &Point, normal: &Point, max_sq: f64) -> Option<Point> {
        /// Within 53°: surfaces that cross do not pull at each other.
        const MIN_COSINE: f64 = 0.6;
        let near = self.field.and_then(|field| field.nearest(place));
        let (partner, distance_sq) = near.unwrap_or_else(|| self.grid.nearest(place));
        let other = &self.surfaces[partner].normal;
        let cosine = normal[0] * other[0] + normal[1] * other[1] + normal[2] * other[2];
        (distance_sq < max_sq && cosine.abs() > MIN_COSINE).then(|| self.grid.points()[partner])
    }
}

/// Point-to-plane steps along the moving cloud's own normals, and how many were made.
pub(super) fn to_planes(
    points: &[Point],
    surfaces: &[Surface],
    fixed: Fixed<'_>,
    start: Similarity,
    motion: Motion,
    truncation: Shrinking,
) -> (Similarity, usize) {
    let moving = (points, surfaces);
    let rigid = |step: Option<Rigid>| step.map(Similarity::from);
    match motion {
        Motion::Free(Freedom::Levelled) => {
            slide(moving, fixed, start, truncation, |s: &PlaneSums| {
                rigid(s.solve_levelled())
            })
        }
        Motion::Free(Freedom::Rigid) => slide(moving, fixed, start, truncation, |s: &PlaneSums| {
            rigid(s.solve())
        }),
        Motion::Free(Freedom::Similarity) => {
            slide(moving, fixed, start, truncation, |s: &ScaledPlaneSums| {
                s.solve(Freedom::Similarity)
            })
        }
        Motion::Upright(uprights) => slide(moving, fixed, start, truncation, |s: &PlaneSums| {
            rigid(s.solve_about(&uprights.up()))
        }),
    }
}

/// What a step is solved from, with a scale or without.
trait StepSums: Default + Send {
    fn add(&mut self, moved: &Point, partner: &Point, normal: &Point);
    fn merge(&mut self, other: &Self);
}

impl StepSums for PlaneSums {
    #[inline]
    fn add(&mut self, moved: &Point, partner: &Point, normal: &Point) {
        self.add(moved, partner, normal, 1.0);
    }

    fn merge(&mut self, other: &Self) {
        self.merge(other);
    }
}

impl StepSums for ScaledPlaneSums {
    #[inline]
    fn add(&mut self, moved: &Point, partner: &Point, normal: &Point) {
        self.add(moved, partner, normal, 1.0);
    }

    fn merge(&mut self, other: &Self) {
        self.merge(other);
    }
}

fn slide<S: StepSums>(
    (points, surfaces): (&[Point], &[Surface]),
    fixed: Fixed<'_>,
    start: Similarity,
    truncation: Shrinking,
    solve: impl Fn(&S) -> Option<Similarity>,
) -> (Similarity, usize) {
    let (mut pose, mut n_made) = (start, 0);
    let (mut step, last) = (0, truncation.n_steps - 1);
    let reach_m = root_mean_square(points);
    while step <= last {
        n_made += 1;
        let max_m = truncation.at(step);
        let max_sq = max_m * max_m;
        // The step turns about the middle of the moved cloud, where its linearisation is best.
        let middle: Point = pose.rigid.translation.into();
        let about = |v: &Point| std::array::from_fn(|axis| v[axis] - middle[axis]);
        let sums_of = |points: &[Point], surfaces: &[Surface]| {
            let mut sums = S::default();
            for (p, surface) in points.iter().zip(surfaces) {
                let moved = pose.apply(p);
                let normal = pose.rigid.rotate(&surface.normal);
                if let Some(partner) = fixed.partner(&moved, &normal, max_sq) {
                    sums.add(&about(&moved), &about(&partner), &normal);
                }
            }
            sums
        };
        // Where few poses are left, half of the threads would have nothing to do.
        let (first, second) = points.split_at(points.len() / 2);
        let (of_first, of_second) = surfaces.split_at(points.len() / 2);
        let (mut sums, others) =
            parallel::both(|| sums_of(first, of_first), || sums_of(second, of_second));
        sums.merge(&others);
        let Some(Similarity { scale, rigid }) = solve(&sums) else {
            break;
        };
        // pose ← shift(middle) · step · shift(−middle) · pose; the pose's translation is `middle`.
        pose = Similarity {
            scale: scale * pose.scale,
            rigid: Rigid {
                rotation: rigid.rotation * pose.rigid.rotation,
                translation: pose.rigid.translation + rigid.translation,
            },
        };
        let turned_or_grown = rigid.rotation_angle_rad() + (scale - 1.0).abs();
        let moved_m = rigid.translation.norm() + reach_m * turned_or_grown;
        let n_steps = match moved_m < AT_REST * max_m {
            true => STEPS_AT_REST,
            false => 1,
        };
        step = (step + n_steps).min(last.max(step + 1));
    }
    (pose, n_made)
}

fn root_mean_square(points: &[Point]) -> f64 {
    let sum_sq: f64 = points.iter().map(|p| distance_sq(p, &[0.0; 3])).sum();
    (sum_sq / points.len().max(1) as f64).sqrt()
}

/// Mean of min(d², τ²)/τ² over the points: 0 perfect, 1 nothing within τ.
pub(super) fn truncated_cost(points: &[Point], grid: &NearestGrid, pose: &Rigid, max: f64) -> f64 {
    let max_sq = max * max;
    let sum: f64 = points
        .iter()
        .map(|p| grid.nearest(&pose.apply(p)).1.min(max_sq))
        .sum();
    sum / (max_sq * points.len().max(1) as f64)
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::cloud::Cloud;
    use crate::progress::Progress;
    use crate::random::Stream;
    use crate::surface_cloud::SurfaceCloud;

    /// Waves over a square of edge 1.
    pub(in crate::coarse) fn waves(survey: u64) -> SurfaceCloud {
        let mut stream = Stream::new(survey, "waves", 0);
        let points: Vec<Point> = (0..4000)
            .map(|_| [stream.uniform(), stream.uniform()])
            .map(|[x, y]| [x, y, 0.1 * (9.0 * x).sin() * (7.0 * y + x).cos()])
            .collect();
        SurfaceCloud::new(&Cloud::new(&points).unwrap(), survey, &Progress::silent()).unwrap()
    }

    #[test]
    fn a_pose_at_rest_takes_few_steps_and_one_on_its_way_all_it_needs() {
        let (moving, fixed) = (waves(1), waves(2));
        let right = Rigid::identity().between_local_coordinates(moving.origin, fixed.origin);
        let grid = NearestGrid::new(fixed.points(), 0.01, 0.2, 1_000_000).unwrap();
        let fixed = Fixed {
            surfaces: &fixed.surfaces,
            grid: &grid,
            field: None,
        };
        let truncation = Shrinking {
            first: 0.07,
            last: 0.01,
            n_steps: 24,
        };
        let run = |start: Rigid| {
            let (points, surfaces) = (moving.points(), &moving.surfaces);
            to_planes(
                points,
                surfaces,
                fixed,
                start.into(),
                Motion::Free(Freedom::Rigid),
                truncation,
            )
        };
        let off = Rigid::from_euler([0.03, -0.02, 0.05], [0.03, -0.02, 0.02]) * right;
        let (from_right, n_from_right) = run(right);
        let (from_off, n_from_off) = run(off);
        // Both truncations and every fourth between them, and a few more on the way.
        assert!(
            n_from_right <= 8 && n_from_off > n_from_right,
            "{n_from_right} {n_from_off}"
        );
        for found in [from_right, from_off] {
            let (turn, shift) = (
                (found.rigid * right.inverse()).rotation_angle_rad(),
                (found.rigid.translation - right.translation).norm(),
            );
            assert!(turn < 0.003 && shift < 0.002, "{turn} {shift}");
        }
    }
}
