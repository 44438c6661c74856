//! From thousands of starts to a few hundred basins: quick descents of few points.

use super::descent::{self, Shrinking};
use super::{differ_rigid, without_points};
use crate::cloud::Point;
use crate::deadline::Deadline;
use crate::distance_field::NearestGrid;
use crate::error::Result;
use crate::freedom::Freedom;
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
/// Poses that go on to the second descent.
const N_SHORTLIST: usize = 300;

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

/// Poses closer than this to a better one are the same basin.
const SAME_BASIN_RAD: f64 = 8.0 * std::f64::consts::PI / 180.0;
const SAME_BASIN: f64 = 0.03;

/// Runs starts down into their basins.
#[derive(Debug)]
pub(super) struct Explorer<'a> {
    moving: &'a SurfaceCloud,
    fixed: &'a SurfaceCloud,
    moving_grid: NearestGrid,
    pub(super) fixed_grid: NearestGrid,
    unit_m: f64,
    freedom: Freedom,
}

impl<'a> Explorer<'a> {
    pub(super) fn new(
        moving: &'a SurfaceCloud,
        fixed: &'a SurfaceCloud,
        unit_m: f64,
        freedom: Freedom,
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
            unit_m,
            freedom,
        })
    }

    /// Runs `n_starts` starts down to distinct basins, best first, and says how many poses were
    /// compared on the way.
    pub(super) fn basins(
        &self,
        n_starts: usize,
        start: impl Fn(usize) -> Rigid + Sync + Send,
        deadline: Deadline,
        progress: &Progress<'_>,
    ) -> Result<(Vec<Rigid>, usize)> {
        let (unit_m, freedom, grid) = (self.unit_m, self.freedom, &self.fixed_grid);
        let points = self.moving.points();
        let n_first = N_FIRST.min(points.len());
        let n_samples = points.len() / n_first;
        let first = parallel::map_cheap(n_starts, progress, |i| {
            // Every start looks at other points, so that no unlucky sample spoils them all.
            let few = &points[i % n_samples * n_first..][..n_first];
            (!deadline.is_over()).then(|| {
                let pose = descent::to_points(few, grid, start(i), freedom, FIRST.times(unit_m));
                let cost = descent::truncated_cost(few, grid, &pose, FIRST_TRUNCATION * unit_m);
                Scored { cost, pose }
            })
        })?;
        let shortlist = distinct(first, N_SHORTLIST, SAME_BASIN * unit_m);
        // Both clouds at the density at which the second sample shows the moving one.
        let some_moving = self.moving.sample(N_SECOND);
        let share = some_moving.len() as f64 / self.moving.len() as f64;
        let some_fixed = self
            .fixed
            .sample((self.fixed.len() as f64 * share).ceil() as usize);
        let second = parallel::map(shortlist.len(), |i| {
            (!deadline.is_over()).then(|| {
                let (start, truncation) = (shortlist[i].pose, SECOND.times(unit_m));
                let pose = descent::to_points(some_moving, grid, start, freedom, truncation);
                let max_m = SECOND_TRUNCATION * unit_m;
                let forth = descent::truncated_cost(some_moving, grid, &pose, max_m);
                let back = self.missed_share(some_fixed, &pose, some_moving.len());
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

    /// The way back of the symmetric cost: how much of the moving cloud's size in fixed points
    /// finds no partner. A fixed cloud larger than the moving one is not blamed for the rest.
    fn missed_share(&self, fixed: &[Point], pose: &Rigid, n_moving: usize) -> f64 {
        let back = pose.inverse();
        let max_sq = (SECOND_TRUNCATION * self.unit_m).powi(2);
        let grid = &self.moving_grid;
        let found: f64 = fixed
            .iter()
            .map(|p| back.apply(p))
            .filter(|p| grid.covers(p))
            .map(|p| 1.0 - grid.nearest(&p).1.min(max_sq) / max_sq)
            .sum();
        1.0 - found / n_moving as f64
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
