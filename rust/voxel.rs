//! Stage 2: one centroid per occupied voxel.
//!
//! Why: both sensors are brought to one point density before keypoints are sought.
//! Reads: a checked cloud.  Leaves: centroids, sorted by voxel: by z, then y, then x.
//! Source: Ren, Zhao & Han (2023), Sec. 4.2.  Deviates: nowhere; the grid stands on the lower
//! corner of the cloud's box.
//! Absent on purpose: hash maps, whose order and memory nobody can foretell; colours and other
//! attributes, which belong to the caller.

use crate::cloud::{Cloud, Point};
use crate::error::{Error, Result, require_positive};
use crate::parallel;
use crate::progress::Progress;

/// Bits of a voxel's number along one axis: three of them fit a word.
const AXIS_BITS: u32 = 20;

/// How finely a cloud is thinned.
#[derive(Debug, Clone, PartialEq, Default, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct VoxelOptions {
    /// Edge of a voxel, in the clouds' unit; above 0. `None`: derived from the data, one edge for
    /// both clouds.
    pub voxel_size_m: Option<f64>,
}

impl VoxelOptions {
    pub(crate) fn check(&self) -> Result<()> {
        self.voxel_size_m.map_or(Ok(()), |size_m| {
            require_positive("voxel.voxel_size_m", size_m).map(drop)
        })
    }
}

/// What the stage left.
#[derive(Debug, Clone, PartialEq)]
pub struct VoxelResult {
    /// The centroids, about the origin of the cloud that went in.
    pub cloud: Cloud,
    /// How many points each of them stands for.
    pub n_points: Vec<u32>,
}

/// Replaces the points in each voxel of edge `voxel_size_m` by their centroid.
///
/// ```
/// use tmchho::{Cloud, progress::Progress, voxel::downsample};
/// let points = [[0.0, 0.0, 0.0], [0.5, 0.0, 0.0], [3.0, 0.0, 0.0], [0.0, 0.0, 9.0]];
/// let cloud = Cloud::of_any_shape("cloud", &points)?;
/// let thinned = downsample(&cloud, 1.0, &Progress::silent())?;
/// assert_eq!(
///     thinned.cloud.to_given_coordinates(),
///     [[0.25, 0.0, 0.0], [3.0, 0.0, 0.0], [0.0, 0.0, 9.0]]
/// );
/// assert_eq!(thinned.n_points, [2, 1, 1]);
/// # Ok::<(), tmchho::Error>(())
/// ```
///
/// # Errors
/// [`Error::InvalidArgument`] where `voxel_size_m` is not above 0, [`Error::VoxelTooSmall`] where
/// the box would hold 2²⁰ voxels or more along an axis, [`Error::Cancelled`].
pub fn downsample(
    cloud: &Cloud,
    voxel_size_m: f64,
    progress: &Progress<'_>,
) -> Result<VoxelResult> {
    require_positive("voxel_size_m", voxel_size_m)?;
    let grid = Grid::of(cloud, voxel_size_m)?;
    // A number and an index in one word where they fit: half the memory to sort.
    if grid.n_voxels() <= 1 << u32::BITS {
        centroids::<u64>(cloud, &grid, progress)
    } else {
        centroids::<u128>(cloud, &grid, progress)
    }
}

fn centroids<M: Member>(
    cloud: &Cloud,
    grid: &Grid,
    progress: &Progress<'_>,
) -> Result<VoxelResult> {
    let points = cloud.points();
    // The index second: points of one voxel keep the order in which they came.
    let mut members: Vec<M> =
        parallel::map(points.len(), |i| M::new(grid.number(&points[i]), i as u32));
    progress.check()?;
    parallel::sort_unstable(&mut members);
    let voxels: Vec<&[M]> = members.chunk_by(|a, b| a.voxel() == b.voxel()).collect();
    let centroids = parallel::map_cheap(voxels.len(), progress, |i| centroid(points, voxels[i]))?;
    Ok(VoxelResult {
        cloud: Cloud::from_local(cloud.origin(), centroids),
        n_points: voxels.iter().map(|voxel| voxel.len() as u32).collect(),
    })
}

/// A point as a member of its voxel; sorted by voxel, then index.
trait Member: Ord + Copy + Send + Sync {
    fn new(voxel: u64, index: u32) -> Self;
    fn voxel(self) -> u64;
    fn index(self) -> usize;
}

/// For voxels whose numbers have 32 bits.
impl Member for u64 {
    fn new(voxel: u64, index: u32) -> Self {
        (voxel << u32::BITS) | Self::from(index)
    }
    fn voxel(self) -> u64 {
        self >> u32::BITS
    }
    fn index(self) -> usize {
        self as u32 as usize
    }
}

impl Member for u128 {
    fn new(voxel: u64, index: u32) -> Self {
        (Self::from(voxel) << u32::BITS) | Self::from(index)
    }
    fn voxel(self) -> u64 {
        (self >> u32::BITS) as u64
    }
    fn index(self) -> usize {
        self as u32 as usize
    }
}

/// Voxels that stand on the lower corner of a cloud's box.
struct Grid {
    low: Point,
    voxel_size_m: f64,
    /// How many voxels along each axis.
    n_along: [u64; 3],
}

impl Grid {
    fn of(cloud: &Cloud, voxel_size_m: f64) -> Result<Self> {
        let (low, high) = cloud.bounds();
        let side = |axis: usize| high[axis] - low[axis];
        let extent_m = side(0).max(side(1)).max(side(2));
        let max_voxels = f64::from(1 << AXIS_BITS);
        if extent_m / voxel_size_m >= max_voxels {
            return Err(Error::VoxelTooSmall {
                voxel_size_m,
                extent_m,
                smallest_m: extent_m / (max_voxels - 1.0),
            });
        }
        Ok(Self {
            low,
            voxel_size_m,
            n_along: std::array::from_fn(|axis| (side(axis) / voxel_size_m) as u64 + 1),
        })
    }

    fn n_voxels(&self) -> u64 {
        self.n_along.iter().product()
    }

    /// The number of the voxel round `p`: x counts fastest, z slowest.
    #[inline]
    fn number(&self, p: &Point) -> u64 {
        (0..3).rev().fold(0, |number, axis| {
            let cell = ((p[axis] - self.low[axis]) / self.voxel_size_m) as u64;
            number * self.n_along[axis] + cell
        })
    }
}

/// Mean of the points of one voxel, summed in the order in which they came.
fn centroid(points: &[Point], voxel: &[impl Member]) -> Point {
    let mut sum = [0.0; 3];
    for member in voxel {
        let p = &points[member.index()];
        for axis in 0..3 {
            sum[axis] += p[axis];
        }
    }
    sum.map(|v| v / voxel.len() as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Stream;
    use std::collections::BTreeMap;

    fn cloud(points: &[Point]) -> Cloud {
        Cloud::of_any_shape("cloud", points).unwrap()
    }

    fn thin(points: &[Point], voxel_size_m: f64) -> Result<VoxelResult> {
        downsample(&cloud(points), voxel_size_m, &Progress::silent())
    }

    fn random_points(n: usize) -> Vec<Point> {
        let mut stream = Stream::new(1, "voxel", 0);
        (0..n)
            .map(|_| [3.0, 50.0, 8.0].map(|width| width * stream.normal()))
            .collect()
    }

    #[test]
    fn by_hand() {
        // Edge 2, grid on (−1, −1, 0): cells (0 0 0), (1 0 0), (0 1 0) and (0 0 1).
        let points = [
            [-1.0, 1.0, 0.0],
            [1.0, -1.0, 1.0],
            [2.0, 0.0, 1.5],
            [-1.0, -1.0, 3.0],
            [0.5, -0.5, 0.5],
            [1.5, 0.5, 0.5],
        ];
        let thinned = thin(&points, 2.0).unwrap();
        assert_eq!(
            thinned.cloud.to_given_coordinates(),
            [
                [0.5, -0.5, 0.5],
                [1.5, -0.5 / 3.0, 1.0],
                [-1.0, 1.0, 0.0],
                [-1.0, -1.0, 3.0]
            ]
        );
        assert_eq!(thinned.n_points, [1, 3, 1, 1]);
    }

    #[test]
    fn agrees_with_an_ordered_map() {
        let cloud = cloud(&random_points(20_000));
        let (low, edge) = (cloud.bounds().0, 1.7);
        let mut twin: BTreeMap<[i64; 3], (usize, Point)> = BTreeMap::new();
        for p in cloud.points() {
            let cell = |axis: usize| ((p[axis] - low[axis]) / edge).floor() as i64;
            let (n, sum) = twin.entry([cell(2), cell(1), cell(0)]).or_default();
            *n += 1;
            *sum = [sum[0] + p[0], sum[1] + p[1], sum[2] + p[2]];
        }
        let thinned = downsample(&cloud, edge, &Progress::silent()).unwrap();
        let wanted: Vec<Point> = twin
            .values()
            .map(|(n, sum)| sum.map(|v| v / *n as f64))
            .collect();
        assert_eq!(thinned.cloud.points(), wanted);
        assert_eq!(thinned.cloud.origin(), cloud.origin());
        let n_points: usize = thinned.n_points.iter().map(|n| *n as usize).sum();
        assert_eq!(n_points, 20_000);
    }

    #[test]
    fn the_same_bits_at_any_number_of_threads() {
        let points = random_points(30_000);
        let run = |n| parallel::with_threads(Some(n), || thin(&points, 0.9)).unwrap();
        assert_eq!(run(1), run(4));
    }

    #[test]
    fn one_voxel_over_all_is_the_mean_and_tiny_voxels_are_the_points() {
        let points = random_points(100);
        let all = thin(&points, 1e4).unwrap();
        assert_eq!(all.n_points, [100]);
        assert_eq!(all.cloud.points()[0], cloud(&points).centroid());
        assert_eq!(thin(&points, 1e-3).unwrap().cloud.len(), 100);
    }

    #[test]
    fn an_edge_that_makes_no_grid_is_refused_by_name() {
        let points = [[0.0; 3], [1000.0, 3.0, 2.0]];
        for edge in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert!(
                thin(&points, edge)
                    .unwrap_err()
                    .to_string()
                    .contains("voxel_size_m")
            );
        }
        let Err(Error::VoxelTooSmall {
            extent_m,
            smallest_m,
            ..
        }) = thin(&points, 1e-6)
        else {
            panic!("accepted");
        };
        assert_eq!(extent_m, 1000.0);
        assert_eq!(thin(&points, smallest_m).unwrap().cloud.len(), 2);
        assert!(thin(&points, 0.999 * smallest_m).is_err());
    }

    #[test]
    fn nothing_in_nothing_out() {
        assert!(thin(&[], 1.0).unwrap().cloud.is_empty());
        assert_eq!(thin(&[[7.0; 3]; 5], 1e-300).unwrap().n_points, [5]);
    }
}
