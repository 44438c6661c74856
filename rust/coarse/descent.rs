//! From a start into the nearest basin: truncated ICP steps on the nearest-point grid.

use crate::cloud::Point;
use crate::distance_field::NearestGrid;
use crate::kabsch::PairSums;
use crate::near_field::NearField;
use crate::normals::Surface;
use crate::point_to_plane::PlaneSums;
use crate::rigid::Rigid;

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

/// Point-to-point steps: pairs farther apart than the truncation distance do not pull.
pub(super) fn to_points(
    points: &[Point],
    grid: &NearestGrid,
    start: Rigid,
    truncation: Shrinking,
) -> Rigid {
    let mut pose = start;
    for step in 0..truncation.n_steps {
        let max_sq = truncation.at(step).powi(2);
        let mut sums = PairSums::default();
        for p in points {
            let (partner, distance_sq) = grid.nearest(&pose.apply(p));
            if distance_sq < max_sq {
                sums.add(p, &grid.points()[partner], 1.0);
            }
        }
        match sums.solve() {
            Some(better) => pose = better,
            None => break,
        }
    }
    pose
}

/// Point-to-plane steps along the moving cloud's own normals, partners from the grid.
pub(super) fn to_planes_on_grid(
    points: &[Point],
    surfaces: &[Surface],
    grid: &NearestGrid,
    start: Rigid,
    truncation: Shrinking,
) -> Rigid {
    to_planes(points, surfaces, start, truncation, |moved, max_sq| {
        let (partner, distance_sq) = grid.nearest(moved);
        (distance_sq < max_sq).then(|| grid.points()[partner])
    })
}

/// The same with partners from the near field, and from the grid where there is nobody near.
pub(super) fn to_planes_nearby(
    points: &[Point],
    surfaces: &[Surface],
    field: &NearField,
    grid: &NearestGrid,
    start: Rigid,
    truncation: Shrinking,
) -> Rigid {
    to_planes(points, surfaces, start, truncation, |moved, max_sq| {
        let (partner, distance_sq) = field.nearest(moved).unwrap_or_else(|| grid.nearest(moved));
        (distance_sq < max_sq).then(|| grid.points()[partner])
    })
}

fn to_planes(
    points: &[Point],
    surfaces: &[Surface],
    start: Rigid,
    truncation: Shrinking,
    partner_of: impl Fn(&Point, f64) -> Option<Point>,
) -> Rigid {
    let mut pose = start;
    for step in 0..truncation.n_steps {
        let max_sq = truncation.at(step).powi(2);
        // The step turns about the middle of the moved points, where its linearisation is best.
        let middle: Point = pose.translation.into();
        let mut sums = PlaneSums::default();
        for (p, surface) in points.iter().zip(surfaces) {
            let moved = pose.apply(p);
            if let Some(partner) = partner_of(&moved, max_sq) {
                let about = |v: &Point| std::array::from_fn(|axis| v[axis] - middle[axis]);
                sums.add(
                    &about(&moved),
                    &about(&partner),
                    &pose.rotate(&surface.normal),
                    1.0,
                );
            }
        }
        let Some(step) = sums.solve() else { break };
        // pose ← shift(middle) · step · shift(−middle) · pose, and the pose's translation is `middle`.
        pose = Rigid {
            rotation: step.rotation * pose.rotation,
            translation: pose.translation + step.translation,
        };
    }
    pose
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
