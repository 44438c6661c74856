//! The voxel grid for a cloud that never is in memory as a whole.
//!
//! Why: fifty million points make a million centroids; the former come in parts, the latter stay.
//! Reads: the box of the cloud, then its points in any number of parts.  Leaves: what
//! `voxel::downsample` leaves of the cloud as a whole, to the bit.
//! Source: Ren, Zhao & Han (2023), Sec. 4.2.  Deviates: with a limit on the number of voxels, their
//! edge is doubled as often as is needed to keep to it.
//! Absent on purpose: loops over the table, whose order nobody can foretell; sums stand in a list in
//! the order in which their voxels were met.

use std::collections::HashMap;
use std::hash::{BuildHasherDefault, Hasher};

use crate::cloud::Point;
use crate::error::{Error, Result, require_positive};
use crate::parallel;

/// Bits of a voxel's number along one axis. Half of the numbers are below the lower corner, for
/// points outside the box that was told.
const AXIS_BITS: u32 = 21;
const FIRST: i64 = 1 << (AXIS_BITS - 1);

/// Sums up points by voxels, part by part.
///
/// ```
/// use tmchho::running_voxels::RunningVoxels;
/// let mut voxels = RunningVoxels::new([0.0; 3], [4.0, 0.0, 9.0], 1.0, usize::MAX)?;
/// voxels.add(&[[0.0, 0.0, 0.0], [3.0, 0.0, 0.0]])?;
/// voxels.add(&[[0.5, 0.0, 0.0], [0.0, 0.0, 9.0]])?;
/// let thinned = voxels.finish();
/// assert_eq!(thinned.points, [[0.25, 0.0, 0.0], [3.0, 0.0, 0.0], [0.0, 0.0, 9.0]]);
/// assert_eq!(thinned.n_points, [2, 1, 1]);
/// # Ok::<(), tmchho::Error>(())
/// ```
#[derive(Debug)]
pub struct RunningVoxels {
    origin: Point,
    low: Point,
    edge_m: f64,
    max_voxels: usize,
    numbers: HashMap<u64, u32, BuildHasherDefault<KeyHasher>>,
    voxels: Vec<Voxel>,
}

#[derive(Debug, Clone, Copy)]
struct Voxel {
    key: u64,
    sum: Point,
    n_points: u32,
}

/// The centroids, sorted by voxel: by z, then y, then x.
#[derive(Debug, Clone, PartialEq)]
pub struct Thinned {
    /// One for each occupied voxel, in the coordinates given.
    pub points: Vec<Point>,
    /// How many points each of them stands for.
    pub n_points: Vec<u32>,
    /// Edge of the voxels: the one asked for, or a power of two times it.
    pub voxel_size_m: f64,
}

impl RunningVoxels {
    /// A grid that stands on the corner `low` of the cloud's box.
    ///
    /// # Errors
    /// [`Error::InvalidArgument`] where the edge is not above 0, the box is none or no voxel is
    /// allowed.
    pub fn new(low: Point, high: Point, voxel_size_m: f64, max_voxels: usize) -> Result<Self> {
        require_positive("voxel_size_m", voxel_size_m)?;
        let is_box =
            (0..3).all(|axis| low[axis] <= high[axis] && (high[axis] - low[axis]).is_finite());
        if !is_box {
            return Err(Error::argument("box", "must be finite, low before high"));
        }
        if max_voxels == 0 {
            return Err(Error::argument("max_voxels", "must be at least 1"));
        }
        // As a cloud does it, so that the sums have the same bits.
        let origin: Point = std::array::from_fn(|axis| 0.5 * (low[axis] + high[axis]));
        Ok(Self {
            origin,
            low: std::array::from_fn(|axis| low[axis] - origin[axis]),
            edge_m: voxel_size_m,
            max_voxels,
            numbers: HashMap::default(),
            voxels: Vec::new(),
        })
    }

    /// Adds the next part of the cloud; points that are not finite are passed over.
    ///
    /// # Errors
    /// [`Error::InvalidArgument`] where a point lies so far outside the box that no grid reaches it.
    pub fn add(&mut self, points: &[Point]) -> Result<()> {
        for point in points {
            if !point.iter().all(|v| v.is_finite()) {
                continue;
            }
            let local: Point = std::array::from_fn(|axis| point[axis] - self.origin[axis]);
            let key = loop {
                match self.key(&local) {
                    Some(key) => break key,
                    None if self.edge_m < f64::MAX / 4.0 => self.coarsen(),
                    None => return Err(Error::argument("points", "lie too far outside the box")),
                }
            };
            let number = *self.numbers.entry(key).or_insert(self.voxels.len() as u32);
            if number as usize == self.voxels.len() {
                self.voxels.push(Voxel {
                    key,
                    sum: [0.0; 3],
                    n_points: 0,
                });
            }
            let voxel = &mut self.voxels[number as usize];
            for axis in 0..3 {
                voxel.sum[axis] += local[axis];
            }
            voxel.n_points += 1;
            while self.voxels.len() > self.max_voxels {
                self.coarsen();
            }
        }
        Ok(())
    }

    /// The centroids of all that was added.
    pub fn finish(mut self) -> Thinned {
        // No two voxels have the same key.
        let mut order: Vec<(u64, u32)> = (0..)
            .zip(&self.voxels)
            .map(|(i, voxel)| (voxel.key, i))
            .collect();
        parallel::sort_unstable(&mut order);
        let origin = self.origin;
        let sorted = || order.iter().map(|(_, i)| &self.voxels[*i as usize]);
        let centroid = |voxel: &Voxel| {
            std::array::from_fn(|axis| voxel.sum[axis] / f64::from(voxel.n_points) + origin[axis])
        };
        let thinned = Thinned {
            points: sorted().map(centroid).collect(),
            n_points: sorted().map(|voxel| voxel.n_points).collect(),
            voxel_size_m: self.edge_m,
        };
        self.voxels.clear();
        thinned
    }

    #[inline]
    fn key(&self, local: &Point) -> Option<u64> {
        let mut key = 0;
        for axis in (0..3).rev() {
            let cell = ((local[axis] - self.low[axis]) / self.edge_m).floor();
            if !(-(FIRST as f64)..FIRST as f64).contains(&cell) {
                return None;
            }
            key = (key << AXIS_BITS) | (cell as i64 + FIRST) as u64;
        }
        Some(key)
    }

    /// Doubles the edge: eight voxels become one.
    fn coarsen(&mut self) {
        self.edge_m *= 2.0;
        let old = std::mem::take(&mut self.voxels);
        self.numbers.clear();
        for voxel in old {
            let key = (0..3).rev().fold(0, |key, axis| {
                let bits = (voxel.key >> (axis * AXIS_BITS)) & ((1 << AXIS_BITS) - 1);
                let cell = (bits as i64 - FIRST).div_euclid(2);
                (key << AXIS_BITS) | (cell + FIRST) as u64
            });
            let number = *self.numbers.entry(key).or_insert(self.voxels.len() as u32);
            if number as usize == self.voxels.len() {
                self.voxels.push(Voxel { key, ..voxel });
                continue;
            }
            let into = &mut self.voxels[number as usize];
            for axis in 0..3 {
                into.sum[axis] += voxel.sum[axis];
            }
            into.n_points += voxel.n_points;
        }
    }
}

/// Spreads the numbers of voxels over a table: a multiplication, where the standard one takes a
/// hundred operations to withstand enemies.
#[derive(Debug, Default)]
struct KeyHasher(u64);

impl Hasher for KeyHasher {
    fn finish(&self) -> u64 {
        self.0
    }

    fn write(&mut self, bytes: &[u8]) {
        for byte in bytes {
            self.write_u64(u64::from(*byte) ^ self.0);
        }
    }

    fn write_u64(&mut self, key: u64) {
        // 2⁶⁴ divided by the golden ratio; the high bits, the best ones, are brought down.
        let spread = key.wrapping_mul(0x9E37_79B9_7F4A_7C15);
        self.0 = spread ^ (spread >> 32);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_outside_the_box_and_points_that_are_none() {
        let mut voxels = RunningVoxels::new([0.0; 3], [1.0; 3], 1.0, usize::MAX).unwrap();
        voxels
            .add(&[[-0.5, 0.5, 0.5], [0.5; 3], [f64::NAN, 0.0, 0.0]])
            .unwrap();
        let found = voxels.finish();
        assert_eq!(found.points, [[-0.5, 0.5, 0.5], [0.5; 3]]);

        // Too far for the numbers of voxels: the edge grows.
        let mut voxels = RunningVoxels::new([0.0; 3], [1.0; 3], 1e-6, usize::MAX).unwrap();
        voxels.add(&[[0.0; 3], [100.0; 3]]).unwrap();
        assert_eq!(voxels.finish().voxel_size_m, 128e-6);
    }

    #[test]
    fn what_makes_no_grid_is_refused_by_name() {
        let refused = |low, high, edge, most| {
            RunningVoxels::new(low, high, edge, most)
                .unwrap_err()
                .to_string()
        };
        assert!(refused([0.0; 3], [1.0; 3], 0.0, 9).contains("voxel_size_m"));
        assert!(refused([2.0; 3], [1.0; 3], 1.0, 9).contains("box"));
        assert!(refused([0.0; 3], [f64::INFINITY; 3], 1.0, 9).contains("box"));
        assert!(refused([0.0; 3], [1.0; 3], 1.0, 0).contains("max_voxels"));
        let empty = RunningVoxels::new([0.0; 3], [1.0; 3], 1.0, 9).unwrap();
        assert!(empty.finish().points.is_empty());
    }
}
