//! A cloud with everything that comparing it to another one needs, built once and shared.

use crate::cloud::{Point, bounds};
use crate::error::Result;
use crate::neighbors::NeighborIndex;
use crate::normals::{self, Surface};
use crate::progress::Progress;

/// Neighbours from which a normal is estimated: enough to average noise over a few voxels, few
/// enough not to round off the edges on which registration rests.
pub const N_NORMAL_NEIGHBORS: usize = 16;

/// Points, the surface at each of them, and their neighbour index.
#[derive(Debug)]
pub struct SurfaceCloud {
    /// Normal and curvature at each point.
    pub surfaces: Vec<Surface>,
    /// Neighbours; also holds the points.
    pub index: NeighborIndex,
    low: Point,
    high: Point,
}

impl SurfaceCloud {
    /// Indexes `points` and estimates their surfaces.
    ///
    /// # Errors
    /// [`crate::Error::Cancelled`].
    pub fn new(points: &[Point], progress: &Progress<'_>) -> Result<Self> {
        let index = NeighborIndex::new(points);
        let surfaces = normals::estimate(points, &index, N_NORMAL_NEIGHBORS, progress)?;
        let (low, high) = bounds(points);
        Ok(Self {
            surfaces,
            index,
            low,
            high,
        })
    }

    /// The points.
    pub fn points(&self) -> &[Point] {
        self.index.points()
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        self.points().len()
    }

    /// Whether there are no points.
    pub fn is_empty(&self) -> bool {
        self.points().is_empty()
    }

    /// Whether `p` lies within `margin` of the box of the points.
    #[inline]
    pub fn is_near_box(&self, p: &Point, margin: f64) -> bool {
        (0..3).all(|axis| p[axis] >= self.low[axis] - margin && p[axis] <= self.high[axis] + margin)
    }
}
