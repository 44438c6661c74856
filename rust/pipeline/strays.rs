//! Voxels of strays: of wrong matches and wrong returns that stand together, so that stage 1 keeps them.
//!
//! Why: stage 1 takes away what stands almost alone, and spares the thin end of a scan. Where a third of
//! all points are strays, they stand as close together as the points of that end. In a thinned cloud each of
//! them counts as much as a surface; what tells them apart is how many points stand round about, and that they
//! do not lie on the surface that most of what stands there lies on.
//! Source: ours; planes by iteratively reweighted least squares; measured in docs/robust_search.md.

use std::array;

use crate::cloud::{Point, distance_sq, dot};
use crate::error::Result;
use crate::neighbors::{Block, Collector, NeighborIndex, Places, WIDTH, some_through_tree};
use crate::normals::Symmetric;
use crate::progress::Progress;
use crate::similarity::Similarity;
use crate::surface_cloud::SurfaceCloud;
use crate::vectorize::widest;

/// Points are counted within so many voxels.
const RADIUS_IN_VOXELS: f64 = 2.0;
/// A stray has less than this share of the points round about that half of all points have.
const LEAST_SHARE: f64 = 0.25;

/// Voxels round about that tell what surface there is, the voxel itself among them. All lengths below are
/// shares of the distance of the farthest.
const N_NEAR: usize = 16;
/// How far off the plane a voxel still pulls at it, step by step.
const PULLS: [f64; 6] = [1.0, 0.5, 0.25, 0.125, 0.125, 0.125];
/// What lies within this of the plane is the surface, of which there has to be so much,
const IN_SURFACE: f64 = 0.19;
const LEAST_IN_SURFACE: f64 = 0.5;
/// and a voxel that is no stray lies within this.
const ON_SURFACE: f64 = 0.1;

/// The numbers of the voxels that are not those of strays, rising; each voxel stands for so many points.
///
/// # Errors
/// [`crate::Error::Cancelled`].
pub(super) fn without_strays(
    voxels: &NeighborIndex,
    n_points: &[u32],
    voxel_size_m: f64,
    progress: &Progress<'_>,
) -> Result<Vec<u32>> {
    let dense = where_many_stand(voxels, n_points, voxel_size_m, progress)?;
    let points: Vec<Point> = (dense.iter())
        .map(|i| voxels.points()[*i as usize])
        .collect();
    let index = NeighborIndex::new(&points);
    let is_kept = index.map_k_nearest(&index.places(), N_NEAR, progress, is_on_surface)?;
    let kept = dense.into_iter().zip(is_kept);
    Ok(kept
        .filter_map(|(i, is_kept)| is_kept.then_some(i))
        .collect())
}

/// How many points of a cloud lie off the surface that most of what stands round them lies on, of one, by a
/// sample.
///
/// # Errors
/// [`crate::Error::Cancelled`].
pub(super) fn share_of_strays(index: &NeighborIndex, progress: &Progress<'_>) -> Result<f64> {
    const N_ASKED: usize = 2000;
    let asked = some_through_tree(index.points(), N_ASKED);
    let is_kept = lie_on_surface(index, &asked, progress)?;
    let n_strays = is_kept.iter().filter(|is_kept| !**is_kept).count();
    Ok(n_strays as f64 / is_kept.len().max(1) as f64)
}

/// Which of some points of a cloud lie on the surface that most of what stands round them lies on.
fn lie_on_surface(
    index: &NeighborIndex,
    points: &[Point],
    progress: &Progress<'_>,
) -> Result<Vec<bool>> {
    index.map_k_nearest(&Places::new(points), N_NEAR, progress, is_on_surface)
}

/// How often the partner of a point on a surface of `from`, its nearest of `to` and at most so far away, lies on a
/// surface as well, by how often any point of `to` does, of which that share are strays, by samples: above 1 where surfaces lie on surfaces, below where
/// they lie on strays. NaN where no point on a surface has a partner, or no point of `to` lies on a surface.
///
/// # Errors
/// [`crate::Error::Cancelled`].
pub(super) fn surfaces_on_surfaces(
    from: &SurfaceCloud,
    (to, share_of_strays): (&SurfaceCloud, f64),
    to_from: &Similarity,
    max_distance_m: f64,
    progress: &Progress<'_>,
) -> Result<f64> {
    const N_PAIRS: usize = 2000;
    let max_sq = max_distance_m * max_distance_m;
    let pair = |i: &u32| {
        let own = from.points()[*i as usize];
        let moved = to_from.apply(&own);
        let is_near = to.is_near_box(&moved, max_distance_m);
        let near = is_near.then(|| to.index.nearest_within(&moved, max_sq))??;
        Some((own, to.points()[near.index as usize]))
    };
    let pairs = from.drawn(from.len()).iter().filter_map(pair);
    let (own, theirs): (Vec<Point>, Vec<Point>) = pairs.take(N_PAIRS).unzip();
    let own = lie_on_surface(&from.index, &own, progress)?;
    let theirs = lie_on_surface(&to.index, &theirs, progress)?;
    let of_surfaces = own.iter().zip(&theirs).filter(|(own, _)| **own);
    let n_surfaces = of_surfaces.clone().count();
    let n_on_surfaces = of_surfaces.filter(|(_, theirs)| **theirs).count();
    Ok(n_on_surfaces as f64 / n_surfaces as f64 / (1.0 - share_of_strays))
}

/// The numbers of the voxels round which many points stand, rising.
fn where_many_stand(
    voxels: &NeighborIndex,
    n_points: &[u32],
    voxel_size_m: f64,
    progress: &Progress<'_>,
) -> Result<Vec<u32>> {
    let fresh = || PointsWithin {
        radius_sq: (RADIUS_IN_VOXELS * voxel_size_m).powi(2),
        n_points,
        sum: 0,
    };
    let n_near = voxels.map_collected(&voxels.places(), fresh, progress, |near| near.sum)?;
    let least = LEAST_SHARE * half_of_all_have(&n_near, n_points) as f64;
    let numbers = (0..).zip(&n_near);
    Ok(numbers
        .filter_map(|(i, n)| (*n as f64 >= least).then_some(i))
        .collect())
}

/// How many points the voxels within a radius hold.
#[derive(Clone)]
struct PointsWithin<'a> {
    radius_sq: f64,
    n_points: &'a [u32],
    sum: u64,
}

impl Collector for PointsWithin<'_> {
    #[inline(always)]
    fn reach_sq(&self) -> f64 {
        self.radius_sq
    }

    #[inline(always)]
    fn take(&mut self, place: &Point, block: &Block, _: usize) -> bool {
        let distances_sq = block.distances_sq(place);
        for lane in (0..WIDTH).filter(|lane| distances_sq[*lane] <= self.radius_sq) {
            self.sum += u64::from(self.n_points[block.indices[lane] as usize]);
        }
        false
    }
}

/// Whether `own`, one of the points that stand `near`, lies on the plane that most of them lie on; true where
/// they tell no plane.
fn is_on_surface(own: &Point, near: &[Point]) -> bool {
    let reach_m = (near.iter().map(|p| distance_sq(own, p)).fold(0.0, f64::max)).sqrt();
    if reach_m == 0.0 {
        return true;
    }
    widest(
        #[inline(always)]
        || Neighborhood::new(own, near, reach_m).is_middle_on_plane(),
    )
}

/// One number for each of the points round about.
type Lanes = [f64; N_NEAR];

/// Points about one of them, in shares of the distance of the farthest. Where there are fewer than lanes, those left
/// over weigh nothing.
struct Neighborhood {
    axes: [Lanes; 3],
    n: usize,
}

impl Neighborhood {
    #[inline(always)]
    fn new(own: &Point, near: &[Point], reach_m: f64) -> Self {
        let mut axes = [[0.0; N_NEAR]; 3];
        for (lane, p) in near.iter().enumerate() {
            for axis in 0..3 {
                axes[axis][lane] = (p[axis] - own[axis]) / reach_m;
            }
        }
        let n = near.len();
        Self { axes, n }
    }

    #[inline(always)]
    fn is_middle_on_plane(&self) -> bool {
        let is_there: Lanes = array::from_fn(|lane| f64::from(u8::from(lane < self.n)));
        let (mut weights, mut off, mut own_off) = (is_there, [0.0; N_NEAR], 0.0);
        for pull in PULLS {
            let (middle, scatter) = self.moments(&weights);
            let Some((normal, _)) = scatter.least() else {
                return true;
            };
            let [x, y, z] = &self.axes;
            let of_middle = dot(&normal, &middle);
            for lane in 0..N_NEAR {
                let along = normal[0] * x[lane] + normal[1] * y[lane] + normal[2] * z[lane];
                off[lane] = (along - of_middle).abs();
            }
            own_off = of_middle.abs();
            if off.iter().all(|off| *off < ON_SURFACE) {
                // Where nobody stands off it, there is no other plane to be drawn to.
                return true;
            }
            for lane in 0..N_NEAR {
                weights[lane] = is_there[lane] * bell(off[lane] / pull);
            }
        }
        let n_in = off[..self.n].iter().filter(|off| **off < IN_SURFACE);
        own_off < ON_SURFACE && n_in.count() as f64 > LEAST_IN_SURFACE * self.n as f64
    }

    /// The middle of the points, each counting by its weight, and their scatter about it.
    #[inline(always)]
    fn moments(&self, weights: &Lanes) -> (Point, Symmetric) {
        let [x, y, z] = &self.axes;
        let weighed = |of: &Lanes| -> Lanes { array::from_fn(|lane| weights[lane] * of[lane]) };
        let [by_x, by_y, by_z] = [weighed(x), weighed(y), weighed(z)];
        let total = sum(weights);
        let middle = [&by_x, &by_y, &by_z].map(|of| sum(of) / total);
        let about_middle = |by: &Lanes, of: &Lanes, a: usize, b: usize| {
            sum(&array::from_fn(|lane| by[lane] * of[lane])) - total * middle[a] * middle[b]
        };
        let diagonal = [
            about_middle(&by_x, x, 0, 0),
            about_middle(&by_y, y, 1, 1),
            about_middle(&by_z, z, 2, 2),
        ];
        let off_diagonal = [
            about_middle(&by_y, z, 1, 2),
            about_middle(&by_x, z, 0, 2),
            about_middle(&by_x, y, 0, 1),
        ];
        (middle, Symmetric::new(diagonal, off_diagonal))
    }
}

/// exp(−x²/2) for |x| up to 16, to 2·10⁻⁵ of it where it is above a tenth: by multiplications alone, which lanes
/// do side by side.
#[inline(always)]
fn bell(x: f64) -> f64 {
    const DOUBLINGS: i32 = 8;
    let part = 0.5 * x * x / f64::from(1 << DOUBLINGS);
    let mut power = 1.0 - part + 0.5 * part * part;
    for _ in 0..DOUBLINGS {
        power *= power;
    }
    power
}

/// Four sums side by side, then theirs.
#[inline(always)]
fn sum(of: &Lanes) -> f64 {
    let mut sums = [0.0; 4];
    for four in of.chunks_exact(4) {
        for (sum, v) in sums.iter_mut().zip(four) {
            *sum += v;
        }
    }
    (sums[0] + sums[1]) + (sums[2] + sums[3])
}

/// The median over the points of the cloud of how many stand round about; 0 for no voxels.
fn half_of_all_have(n_near: &[u64], n_points: &[u32]) -> u64 {
    let mut by_count: Vec<(u64, u32)> = n_near
        .iter()
        .copied()
        .zip(n_points.iter().copied())
        .collect();
    by_count.sort_unstable();
    let half = n_points
        .iter()
        .copied()
        .map(u64::from)
        .sum::<u64>()
        .div_ceil(2);
    let mut n_so_far = 0;
    for (near, n) in by_count {
        n_so_far += u64::from(n);
        if n_so_far >= half {
            return near;
        }
    }
    0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cloud::Cloud;
    use crate::random::Stream;
    use crate::rigid::Rigid;
    use crate::surface_cloud::IndexedCloud;
    use crate::voxel::downsample;

    /// The voxels of a cloud, and those without strays, in its coordinates.
    fn before_and_without_strays(cloud: &Cloud, voxel_size_m: f64) -> (Vec<Point>, Vec<Point>) {
        let silent = Progress::silent();
        let voxels = downsample(cloud, voxel_size_m, &silent).unwrap();
        let index = NeighborIndex::new(voxels.cloud.points());
        let kept = without_strays(&index, &voxels.n_points, voxel_size_m, &silent).unwrap();
        let before = voxels.cloud.to_given_coordinates();
        let after = kept.iter().map(|i| before[*i as usize]).collect();
        (before, after)
    }

    #[test]
    fn ground_stays_also_where_it_is_thin_and_what_hovers_over_it_goes() {
        // Ground of 40 × 20, eight points a unit on one half and three on the other, strays up to 10 above.
        let mut stream = Stream::new(1, "strays", 0);
        let mut points: Vec<Point> = (0..8000)
            .map(|i| {
                let x = 20.0 * stream.uniform() + if i % 11 < 3 { 20.0 } else { 0.0 };
                [x, 20.0 * stream.uniform(), 0.0]
            })
            .collect();
        points.extend((0..3500).map(|_| [40.0, 20.0, 10.0].map(|side| side * stream.uniform())));
        let cloud = Cloud::named("cloud", &points).unwrap();
        let (before, cleaned) = before_and_without_strays(&cloud, 1.0);
        let count = |points: &[Point], low: f64, high: f64| {
            let is_there = |p: &&Point| (low..high).contains(&p[2]);
            points.iter().filter(is_there).count()
        };
        // A few strays stand together by chance.
        let n_strays = count(&before, 3.0, 11.0);
        assert!(n_strays > 1500 && count(&cleaned, 3.0, 11.0) < n_strays / 50);
        let n_ground = count(&before, -1.0, 0.3);
        assert!(count(&cleaned, -1.0, 0.3) as f64 > 0.95 * n_ground as f64);
    }

    #[test]
    fn a_sparse_surface_stays_and_what_is_off_it_goes() {
        // A hill of 60 × 60, a point a square, and half as many up to 3 above or below it.
        let mut stream = Stream::new(2, "strays", 0);
        let height = |x: f64, y: f64| 8.0 * (x / 15.0).sin() * (y / 20.0).cos();
        let mut place = |off: f64| {
            let (x, y) = (60.0 * stream.uniform(), 60.0 * stream.uniform());
            let off = off * stream.uniform_between(-1.0, 1.0);
            ([x, y, height(x, y) + off], off.abs())
        };
        let placed: Vec<(Point, f64)> = (0..5400)
            .map(|i| place(if i < 3600 { 0.05 } else { 3.0 }))
            .collect();
        let points: Vec<Point> = placed.iter().map(|(p, _)| *p).collect();
        let cloud = Cloud::named("cloud", &points).unwrap();
        let (before, after) = before_and_without_strays(&cloud, 0.5);
        let share = |of: &Cloud| {
            let index = IndexedCloud::new(of).0.index;
            share_of_strays(&index, &Progress::silent()).unwrap()
        };
        let hill = Cloud::named("hill", &points[..3600]).unwrap();
        assert!((0.25..0.4).contains(&share(&cloud)) && share(&hill) < 0.01);
        let count = |points: &[Point], low: f64, high: f64| {
            let off = |p: &Point| (p[2] - height(p[0], p[1])).abs();
            (points.iter().filter(|p| (low..high).contains(&off(p)))).count() as f64
        };
        assert!(count(&after, 0.0, 0.1) > 0.95 * count(&before, 0.0, 0.1));
        assert!(count(&before, 1.0, 3.0) > 1000.0);
        assert!(count(&after, 1.0, 3.0) < 0.15 * count(&before, 1.0, 3.0));
    }

    #[test]
    fn surfaces_lie_on_surfaces_at_the_right_pose_and_on_strays_where_strays_lie_on_strays() {
        // A hill of 60 × 60 twice, a third of the points up to 5 above it, or below it.
        let hill = |seed: u64, depth: f64| {
            let mut stream = Stream::new(seed, "hill", 0);
            let points: Vec<Point> = (0..6000)
                .map(|i| {
                    let (x, y) = (60.0 * stream.uniform(), 60.0 * stream.uniform());
                    let off = if i % 3 == 0 {
                        depth * stream.uniform()
                    } else {
                        0.0
                    };
                    [x, y, 8.0 * (x / 15.0).sin() * (y / 20.0).cos() + off]
                })
                .collect();
            SurfaceCloud::new(&Cloud::new(&points).unwrap(), seed, &Progress::silent()).unwrap()
        };
        let (from, to) = (hill(1, 5.0), hill(2, -5.0));
        let silent = Progress::silent();
        let to = (&to, share_of_strays(&to.index, &silent).unwrap());
        let at = |height: f64| {
            let pose = Rigid::from_euler([0.0; 3], [0.0, 0.0, height]);
            let pose = pose.between_local_coordinates(from.origin, to.0.origin);
            surfaces_on_surfaces(&from, to, &pose.into(), 1.0, &silent).unwrap()
        };
        assert!(at(0.0) > 1.1, "{}", at(0.0));
        // There the hills lie 4 apart, and all strays but the outermost on strays.
        assert!(at(-4.0) < 0.9, "{}", at(-4.0));
        assert!(at(1000.0).is_nan());
    }

    #[test]
    fn the_bell_is_that_of_the_exponential_function() {
        for i in 0..160 {
            let x = 0.1 * f64::from(i);
            let expected = (-0.5 * x * x).exp();
            assert!((bell(x) - expected).abs() < 2e-5 * expected.max(0.2), "{x}");
            assert_eq!(bell(x), bell(-x));
        }
    }

    #[test]
    fn the_median_is_over_points() {
        assert_eq!(half_of_all_have(&[5, 1, 9], &[1, 1, 3]), 9);
        assert_eq!(half_of_all_have(&[5, 1, 9], &[2, 3, 1]), 1);
        assert_eq!(half_of_all_have(&[], &[]), 0);
    }
}
