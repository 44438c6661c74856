//! A cloud with everything that comparing it to another one needs, built once and shared.

use std::sync::Arc;

use crate::cloud::{Cloud, Point, bounds, centroid};
use crate::error::Result;
use crate::neighbors::NeighborIndex;
use crate::normals::{self, Surface};
use crate::parallel;
use crate::progress::Progress;
use crate::random::Stream;

/// Neighbours from which a normal is estimated: enough to average noise over a few voxels, few
/// enough not to round off the edges on which registration rests.
pub(crate) const N_NORMAL_NEIGHBORS: usize = 16;

/// Points about their centroid, and their neighbours.
///
/// The points are numbered so that those that follow each other lie side by side: whoever goes through them
/// finds in the cache what he needs.
#[derive(Debug, Clone)]
pub struct IndexedCloud {
    /// The centroid, in the coordinates given.
    pub origin: Point,
    /// Neighbours; also holds the points.
    pub index: Arc<NeighborIndex>,
}

impl IndexedCloud {
    /// Indexes the points of `cloud`. With the number that each of them had there.
    pub fn new(cloud: &Cloud) -> (Self, Vec<u32>) {
        let middle = centroid(cloud.points());
        let about = |p: &Point| std::array::from_fn(|axis| p[axis] - middle[axis]);
        let points: Vec<Point> = cloud.points().iter().map(about).collect();
        let (index, numbers) = NeighborIndex::renumbered(&points);
        let indexed = Self {
            origin: std::array::from_fn(|axis| cloud.origin()[axis] + middle[axis]),
            index: Arc::new(index),
        };
        (indexed, numbers)
    }
}

/// The same with the surface at each point. Samples are drawn in an order of their own.
#[derive(Debug)]
pub struct SurfaceCloud {
    /// The centroid, in the coordinates given.
    pub origin: Point,
    /// Normal and curvature at each point.
    pub surfaces: Vec<Surface>,
    /// Neighbours; also holds the points.
    pub index: Arc<NeighborIndex>,
    /// The numbers of all points at random.
    drawn: Vec<u32>,
    /// When each point was drawn.
    turns: Vec<u32>,
    low: Point,
    high: Point,
}

impl SurfaceCloud {
    /// Indexes the points of `cloud`, estimates their surfaces, and draws all of them in an order fixed by `seed`.
    ///
    /// # Errors
    /// [`crate::Error::Cancelled`].
    pub fn new(cloud: &Cloud, seed: u64, progress: &Progress<'_>) -> Result<Self> {
        Self::of(IndexedCloud::new(cloud).0, seed, progress)
    }

    /// The same of points that are indexed.
    ///
    /// # Errors
    /// [`crate::Error::Cancelled`].
    pub fn of(indexed: IndexedCloud, seed: u64, progress: &Progress<'_>) -> Result<Self> {
        let IndexedCloud { origin, index } = indexed;
        let surfaces = normals::estimate_at_all(&index, N_NORMAL_NEIGHBORS, progress)?;
        let (low, high) = bounds(index.points());
        let mut order = Stream::new(seed, "order of points", 0);
        let drawn = order.sample_indices(index.len(), index.len());
        let drawn: Vec<u32> = drawn.into_iter().map(|i| i as u32).collect();
        let mut turns = vec![0; drawn.len()];
        for (i, turn) in drawn.iter().zip(0..) {
            turns[*i as usize] = turn;
        }
        Ok(Self {
            origin,
            surfaces,
            index,
            drawn,
            turns,
            low,
            high,
        })
    }

    /// The same in a mirror across x through the origin, where it stays.
    pub fn mirrored(&self) -> Self {
        let mirror = |p: &Point| [-p[0], p[1], p[2]];
        let points: Vec<Point> = self.points().iter().map(mirror).collect();
        let (low, high) = bounds(&points);
        Self {
            origin: self.origin,
            surfaces: self.surfaces.iter().map(Surface::mirrored).collect(),
            index: Arc::new(NeighborIndex::new(&points)),
            drawn: self.drawn.clone(),
            turns: self.turns.clone(),
            low,
            high,
        }
    }

    /// The points, relative to the origin.
    pub fn points(&self) -> &[Point] {
        self.index.points()
    }

    /// The numbers of `n` points (or all) at random, as they were drawn; fewer are always the first ones of more.
    pub fn drawn(&self, n: usize) -> &[u32] {
        &self.drawn[..n.min(self.len())]
    }

    /// The same by rising number: neighbours follow each other.
    pub fn drawn_in_order(&self, n: usize) -> Vec<u32> {
        /// Of one point in so many, reading all of them costs less than sorting those.
        const MANY: usize = 16;
        if n > self.len() / MANY {
            let numbers = 0..self.len() as u32;
            return numbers
                .filter(|i| (self.turns[*i as usize] as usize) < n)
                .collect();
        }
        let mut drawn = self.drawn(n).to_vec();
        drawn.sort_unstable();
        drawn
    }

    /// Where the points of these numbers stand.
    pub fn points_of(&self, numbers: &[u32]) -> Vec<Point> {
        let points = self.points();
        numbers.iter().map(|i| points[*i as usize]).collect()
    }

    /// A random point in each occupied cell of a grid of edge `cell_m` (above 0), by cell. Beyond 2³¹ cells from the
    /// origin cells are not told apart.
    pub fn one_for_each_cell(&self, cell_m: f64) -> Vec<Point> {
        let points = self.points();
        let parts = parallel::map(points.len().div_ceil(parallel::CHUNK), |part| {
            // What follows each other lies side by side, mostly in one cell: fewer are left to be sorted.
            let mut first_drawn: Vec<([i32; 3], u32)> = Vec::new();
            let range = part * parallel::CHUNK..points.len().min((part + 1) * parallel::CHUNK);
            for (p, turn) in points[range.clone()].iter().zip(&self.turns[range]) {
                let cell = p.map(|v| (v / cell_m).floor() as i32);
                match first_drawn.last_mut() {
                    Some((last, first)) if *last == cell => *first = (*first).min(*turn),
                    _ => first_drawn.push((cell, *turn)),
                }
            }
            first_drawn
        });
        let mut by_cell = parts.concat();
        parallel::sort_unstable(&mut by_cell);
        by_cell.dedup_by_key(|(cell, _)| *cell);
        let drawn = |turn: u32| self.drawn[turn as usize] as usize;
        by_cell
            .iter()
            .map(|(_, turn)| points[drawn(*turn)])
            .collect()
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        self.points().len()
    }

    /// Whether there are no points.
    pub fn is_empty(&self) -> bool {
        self.points().is_empty()
    }

    /// Whether `p` lies within `margin_m` of the box of the points.
    #[inline]
    pub fn is_near_box(&self, p: &Point, margin_m: f64) -> bool {
        (0..3).all(|axis| {
            p[axis] >= self.low[axis] - margin_m && p[axis] <= self.high[axis] + margin_m
        })
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;
    use crate::cloud::{distance_sq, dot};

    fn some_points(n: usize, seed: u64) -> Vec<Point> {
        let mut stream = Stream::new(seed, "surface cloud", 0);
        (0..n)
            .map(|_| [stream.uniform(), stream.uniform()])
            .map(|[x, y]| [40.0 + x, y, 0.3 * (9.0 * x).sin() * (7.0 * y).cos()])
            .collect()
    }

    fn of(points: &[Point]) -> SurfaceCloud {
        let cloud = Cloud::new(points).unwrap();
        SurfaceCloud::new(&cloud, 7, &Progress::silent()).unwrap()
    }

    #[test]
    fn neighbours_follow_each_other_and_samples_are_spread_over_the_cloud() {
        let cloud = of(&some_points(4000, 2));
        let mean_step = |points: &[Point]| {
            let steps = points
                .windows(2)
                .map(|two| distance_sq(&two[0], &two[1]).sqrt());
            steps.sum::<f64>() / (points.len() - 1) as f64
        };
        // Points lie 1/63 apart; two of the unit square half of it.
        assert!(mean_step(cloud.points()) < 0.05);
        let drawn = cloud.drawn(100);
        assert!(mean_step(&cloud.points_of(drawn)) > 0.4);
        assert_eq!(cloud.drawn(60), &drawn[..60]);
        let in_order = cloud.drawn_in_order(100);
        assert!(in_order.is_sorted() && in_order.iter().all(|i| drawn.contains(i)));
        assert_eq!(cloud.drawn_in_order(5000), (0..4000).collect::<Vec<u32>>());
        let cells_of = |points: &[Point]| -> BTreeSet<[i64; 3]> {
            let cells = points.iter().map(|p| p.map(|v| (v / 0.25).floor() as i64));
            cells.collect()
        };
        let chosen = cloud.one_for_each_cell(0.25);
        assert_eq!(chosen.len(), cells_of(&chosen).len());
        assert_eq!(cells_of(&chosen), cells_of(cloud.points()));
        // Of each cell what was drawn first.
        let in_turn = cloud.points_of(cloud.drawn(4000));
        assert!(chosen.iter().all(|p| {
            let cell = cells_of(&[*p]);
            in_turn.iter().find(|q| cells_of(&[**q]) == cell) == Some(p)
        }));
    }

    #[test]
    fn a_mirrored_cloud_is_the_cloud_of_mirrored_points() {
        let points = some_points(500, 1);
        let mirrored = of(&points).mirrored();
        let points: Vec<Point> = points.iter().map(|p| [-p[0], p[1], p[2]]).collect();
        let expected = of(&points);
        for (p, a) in mirrored.points().iter().zip(&mirrored.surfaces) {
            let same = expected.index.nearest(p).unwrap();
            assert!(same.distance_sq < 1e-24);
            let b = &expected.surfaces[same.index as usize];
            assert!(dot(&a.normal, &b.normal) > 1.0 - 1e-9);
            assert!((a.curvature - b.curvature).abs() < 1e-9);
        }
        let corner = expected.points()[3];
        assert!(mirrored.is_near_box(&corner, 1e-9) && !mirrored.is_near_box(&[2.0; 3], 0.1));
    }
}
