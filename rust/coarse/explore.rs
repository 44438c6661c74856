//! From thousands of starts to a few hundred basins: quick descents of few points.

use super::descent::{self, Shrinking};
use super::motion::Motion;
use super::{differ_rigid, without_points};
use crate::cloud::Point;
use crate::deadline::Deadline;
use crate::distance_field::NearestGrid;
use crate::error::Result;
use crate::fitness::lies_off;
use crate::parallel;
use crate::progress::Progress;
use crate::rigid::Rigid;
use crate::surface_cloud::SurfaceCloud;

const CELL: f64 = 1.0 / 64.0;
const GRID_MARGIN: f64 = 0.15;
const MAX_CELLS: usize = 2_000_000;

/// Points of the moving cloud that take part in the first descent and in the second.
const N_FIRST: usize = 64;
const N_SECOND: usize = 256;

const FIRST: Shrinking = Shrinking {
    first: 0.2,
    last: 0.06,
    n_steps: 6,
};
const SECOND: Shrinking = Shrinking {
    first: 0.1,
    last: 0.04,
    n_steps: 9,
};

/// Truncation of the cost that ranks the first descents, and the second ones.
const FIRST_TRUNCATION: f64 = 0.04;
const SECOND_TRUNCATION: f64 = 0.02;
/// Where a point lies above or below the other surface so far off after the second descent, it costs as much as
/// so many without a partner.
const CONFLICT: [f64; 2] = [0.03, 0.08];
const CONFLICT_COST: f64 = 4.0;

/// Poses closer than this to a better one are the same basin.
const SAME_BASIN_RAD: f64 = 8.0 * std::f64::consts::PI / 180.0;
const SAME_BASIN: f64 = 0.03;

/// How starts run down.
#[derive(Debug, Clone, Copy)]
pub(super) struct Descents {
    /// What the steps may change.
    pub(super) motion: Motion,
    /// Poses that go on to the second descent.
    n_shortlist: usize,
}

impl Descents {
    pub(super) fn of_fewest(motion: Motion) -> Self {
        Self {
            motion,
            n_shortlist: 75,
        }
    }

    pub(super) fn of_few(motion: Motion) -> Self {
        Self {
            motion,
            n_shortlist: 300,
        }
    }

    pub(super) fn of_many(motion: Motion) -> Self {
        Self {
            motion,
            n_shortlist: 1000,
        }
    }
}

/// Runs starts down into their basins.
#[derive(Debug)]
pub(super) struct Explorer<'a> {
    moving: &'a SurfaceCloud,
    fixed: &'a SurfaceCloud,
    pub(super) moving_grid: NearestGrid,
    pub(super) fixed_grid: NearestGrid,
    /// The points of the moving cloud at random, in one sample after the other.
    samples: Vec<Point>,
    unit_m: f64,
}

impl<'a> Explorer<'a> {
    pub(super) fn new(
        moving: &'a SurfaceCloud,
        fixed: &'a SurfaceCloud,
        unit_m: f64,
    ) -> Result<Self> {
        let grid = |cloud: &SurfaceCloud| {
            let (cell_m, margin_m) = (CELL * unit_m, GRID_MARGIN * unit_m);
            NearestGrid::new(cloud.points(), cell_m, margin_m, MAX_CELLS).ok_or_else(without_points)
        };
        let (moving_grid, fixed_grid) = parallel::both(|| grid(moving), || grid(fixed));
        Ok(Self {
            moving,
            fixed,
            moving_grid: moving_grid?,
            fixed_grid: fixed_grid?,
            samples: moving.points_of(moving.drawn(moving.len())),
            unit_m,
        })
    }

    /// Runs `n_starts` starts down to distinct basins, best first, and says how many poses were
    /// compared on the way.
    pub(super) fn basins(
        &self,
        n_starts: usize,
        start: impl Fn(usize) -> Rigid + Sync + Send,
        descents: Descents,
        deadline: Deadline,
        progress: &Progress<'_>,
    ) -> Result<(Vec<Rigid>, usize)> {
        let (unit_m, motion, grid) = (self.unit_m, descents.motion, &self.fixed_grid);
        let points = &self.samples;
        let n_first = N_FIRST.min(points.len());
        let n_samples = points.len() / n_first;
        let first = parallel::map(n_starts, |i| {
            progress.check()?;
            // Every start looks at other points, so that no unlucky sample spoils them all.
            let few = &points[i % n_samples * n_first..][..n_first];
            Ok((!deadline.is_over()).then(|| {
                let pose = descent::to_points(few, grid, start(i), motion, FIRST.times(unit_m));
                let cost = descent::truncated_cost(few, grid, &pose, FIRST_TRUNCATION * unit_m);
                Scored { cost, pose }
            }))
        });
        let first = first.into_iter().collect::<Result<Vec<_>>>()?;
        let shortlist = distinct(first, descents.n_shortlist, SAME_BASIN * unit_m);
        // Both clouds at the density at which the second sample shows the moving one.
        let some = |cloud: &SurfaceCloud, n: usize| cloud.points_of(&cloud.drawn_in_order(n));
        let some_moving = &some(self.moving, N_SECOND);
        let share = some_moving.len() as f64 / self.moving.len() as f64;
        let n_fixed = (self.fixed.len() as f64 * share).ceil() as usize;
        let some_fixed = &some(self.fixed, n_fixed);
        let second = parallel::map(shortlist.len(), |i| {
            (!deadline.is_over()).then(|| {
                let (start, truncation) = (shortlist[i].pose, SECOND.times(unit_m));
                let pose = descent::to_points(some_moving, grid, start, motion, truncation);
                let forth = 1.0 - self.found_share(some_moving, &pose, some_moving.len());
                let back = 1.0 - self.found_share_back(some_fixed, &pose, some_moving.len());
                Scored {
                    cost: forth + back,
                    pose,
                }
            })
        });
        progress.check()?;
        let n_evaluations = n_starts * (FIRST.n_steps + 1) + second.len() * (SECOND.n_steps + 2);
        let basins = distinct(second, usize::MAX, SAME_BASIN * unit_m);
        Ok((basins.into_iter().map(|s| s.pose).collect(), n_evaluations))
    }

    /// How much of the moving cloud's size in its own points finds a partner, less what conflicts.
    fn found_share(&self, moving: &[Point], pose: &Rigid, n_moving: usize) -> f64 {
        let places = moving.iter().map(|p| pose.apply(p));
        self.found(places, &self.fixed_grid, self.fixed) / n_moving as f64
    }

    /// The same in fixed points. A fixed cloud larger than the moving one is not blamed for the rest.
    fn found_share_back(&self, fixed: &[Point], pose: &Rigid, n_moving: usize) -> f64 {
        let back = pose.inverse();
        let places = fixed.iter().map(|p| back.apply(p));
        let covered = places.filter(|p| self.moving_grid.covers(p));
        self.found(covered, &self.moving_grid, self.moving) / n_moving as f64
    }

    fn found(
        &self,
        places: impl Iterator<Item = Point>,
        grid: &NearestGrid,
        cloud: &SurfaceCloud,
    ) -> f64 {
        let max_sq = (SECOND_TRUNCATION * self.unit_m).powi(2);
        let [from_sq, to_sq] = CONFLICT.map(|share| (share * self.unit_m).powi(2));
        let of_each = |place: Point| {
            let (nearest, distance_sq) = grid.nearest(&place);
            let conflicts = distance_sq > from_sq
                && distance_sq < to_sq
                && lies_off(
                    &place,
                    &grid.points()[nearest],
                    &cloud.surfaces[nearest].normal,
                );
            match conflicts {
                true => -CONFLICT_COST,
                false => 1.0 - distance_sq.min(max_sq) / max_sq,
            }
        };
        places.map(of_each).sum()
    }
}

struct Scored {
    cost: f64,
    pose: Rigid,
}

/// The best of each basin, best first, at most `max`; basins are a distance or an angle apart.
fn distinct(scored: Vec<Option<Scored>>, max: usize, distance: f64) -> Vec<Scored> {
    let mut scored: Vec<Scored> = scored.into_iter().flatten().collect();
    // A stable sort: of equals the first one wins, whatever the number of threads.
    scored.sort_by(|a, b| a.cost.total_cmp(&b.cost));
    let mut kept: Vec<Scored> = Vec::new();
    for candidate in scored {
        if kept.len() == max {
            break;
        }
        if kept
            .iter()
            .all(|k| differ_rigid(&k.pose, &candidate.pose, SAME_BASIN_RAD, distance))
        {
            kept.push(candidate);
        }
    }
    kept
}
