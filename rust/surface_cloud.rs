//! A cloud with everything that comparing it to another one needs, built once and shared.

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

/// Points about their centroid in random order, the surface at each of them, their neighbours.
///
/// The first n points are a random sample of the cloud, whatever n is.
#[derive(Debug)]
pub struct SurfaceCloud {
    /// The centroid, in the coordinates given.
    pub origin: Point,
    /// Normal and curvature at each point.
    pub surfaces: Vec<Surface>,
    /// Neighbours; also holds the points.
    pub index: NeighborIndex,
    low: Point,
    high: Point,
}

impl SurfaceCloud {
    /// Indexes the points of `cloud`, in an order fixed by `seed`, and estimates their surfaces.
    ///
    /// # Errors
    /// [`crate::Error::Cancelled`].
    pub fn new(cloud: &Cloud, seed: u64, progress: &Progress<'_>) -> Result<Self> {
        let middle = centroid(cloud.points());
        let points: Vec<Point> = Stream::new(seed, "order of points", 0)
            .sample_indices(cloud.len(), cloud.len())
            .into_iter()
            .map(|i| std::array::from_fn(|axis| cloud.points()[i][axis] - middle[axis]))
            .collect();
        let index = NeighborIndex::new(&points);
        let surfaces = normals::estimate(index.points(), &index, N_NORMAL_NEIGHBORS, progress)?;
        let (low, high) = bounds(&points);
        Ok(Self {
            origin: std::array::from_fn(|axis| cloud.origin()[axis] + middle[axis]),
            surfaces,
            index,
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
            index: NeighborIndex::new(&points),
            low,
            high,
        }
    }

    /// The points, relative to the origin.
    pub fn points(&self) -> &[Point] {
        self.index.points()
    }

    /// The first `n` points, or all: a random sample.
    pub fn sample(&self, n: usize) -> &[Point] {
        &self.points()[..n.min(self.len())]
    }

    /// The first point in each occupied cell of a grid of edge `cell_m` (above 0), by cell.
    pub fn one_for_each_cell(&self, cell_m: f64) -> Vec<Point> {
        let cell_of = |p: &Point| p.map(|v| (v / cell_m).floor() as i64);
        let points = self.points().iter().enumerate();
        let mut by_cell: Vec<([i64; 3], usize)> = points.map(|(i, p)| (cell_of(p), i)).collect();
        parallel::sort_unstable(&mut by_cell);
        by_cell.dedup_by_key(|(cell, _)| *cell);
        by_cell.into_iter().map(|(_, i)| self.points()[i]).collect()
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
    use super::*;
    use crate::cloud::dot;

    #[test]
    fn a_mirrored_cloud_is_the_cloud_of_mirrored_points() {
        let mut stream = Stream::new(1, "mirror", 0);
        let points: Vec<Point> = (0..500)
            .map(|_| [stream.uniform(), stream.uniform()])
            .map(|[x, y]| [40.0 + x, y, 0.3 * (9.0 * x).sin() * (7.0 * y).cos()])
            .collect();
        let of = |points: &[Point]| {
            let cloud = Cloud::new(points).unwrap();
            SurfaceCloud::new(&cloud, 7, &Progress::silent()).unwrap()
        };
        let mirrored = of(&points).mirrored();
        let points: Vec<Point> = points.iter().map(|p| [-p[0], p[1], p[2]]).collect();
        let expected = of(&points);
        for i in 0..points.len() {
            let (p, q) = (&mirrored.points()[i], &expected.points()[i]);
            assert!((0..3).all(|axis| (p[axis] - q[axis]).abs() < 1e-12));
            let (a, b) = (&mirrored.surfaces[i], &expected.surfaces[i]);
            assert!(dot(&a.normal, &b.normal) > 1.0 - 1e-9);
            assert!((a.curvature - b.curvature).abs() < 1e-9);
        }
        let corner = expected.points()[3];
        assert!(mirrored.is_near_box(&corner, 1e-9) && !mirrored.is_near_box(&[2.0; 3], 0.1));
    }
}
