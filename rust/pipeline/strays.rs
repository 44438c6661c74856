//! Voxels of strays: of wrong matches and wrong returns that stand together, so that stage 1 keeps them.
//!
//! Why: stage 1 takes away what stands almost alone, and spares the thin end of a scan. Where a third of
//! all points are strays, they stand as close together as the points of that end. In a thinned cloud each of
//! them counts as much as a surface; what tells them apart is how many points stand round about, and that they
//! do not lie on the surface that most of what stands there lies on.
//! Source: ours; planes by iteratively reweighted least squares; measured in docs/robust_search.md.

mod plane;

use plane::lie_on_planes;

use crate::cloud::Point;
use crate::error::Result;
use crate::neighbors::{Block, Collector, NeighborIndex, Places, WIDTH, some_through_tree};
use crate::progress::Progress;
use crate::similarity::Similarity;
use crate::surface_cloud::SurfaceCloud;

/// Points are counted within so many voxels.
const RADIUS_IN_VOXELS: f64 = 2.0;
/// A stray has less than this share of the points round about that half of all points have.
const LEAST_SHARE: f64 = 0.25;

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
    let is_kept = lie_on_planes(&index, &index.places(), progress)?;
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
    let is_kept = lie_on_planes(index, &Places::new(&asked), progress)?;
    let n_strays = is_kept.iter().filter(|is_kept| !**is_kept).count();
    Ok(n_strays as f64 / is_kept.len().max(1) as f64)
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
    let own = lie_on_planes(&from.index, &Places::new(&own), progress)?;
    let theirs = lie_on_planes(&to.index, &Places::new(&theirs), progress)?;
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
    let places = voxels.places();
    let mut in_blocks = vec![[0; WIDTH]; places.len().div_ceil(WIDTH)];
    for at in 0..places.len() {
        in_blocks[at / WIDTH][at % WIDTH] = n_points[places.given(at)];
    }
    let fresh = || PointsWithin {
        radius_sq: (RADIUS_IN_VOXELS * voxel_size_m).powi(2),
        in_blocks: &in_blocks,
        sum: 0,
    };
    let n_near = voxels.map_collected(&places, fresh, progress, |near| near.sum)?;
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
    /// Of each voxel, in the blocks of the tree.
    in_blocks: &'a [[u32; WIDTH]],
    sum: u64,
}

impl Collector for PointsWithin<'_> {
    #[inline(always)]
    fn reach_sq(&self) -> f64 {
        self.radius_sq
    }

    #[inline(always)]
    fn take(&mut self, place: &Point, block: &Block, number: usize) -> bool {
        let distances_sq = block.distances_sq(place);
        // No branch: which voxels are near, a processor cannot guess.
        for (distance_sq, n) in distances_sq.iter().zip(&self.in_blocks[number]) {
            self.sum += u64::from(*distance_sq <= self.radius_sq) * u64::from(*n);
        }
        false
    }
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
    fn the_median_is_over_points() {
        assert_eq!(half_of_all_have(&[5, 1, 9], &[1, 1, 3]), 9);
        assert_eq!(half_of_all_have(&[5, 1, 9], &[2, 3, 1]), 1);
        assert_eq!(half_of_all_have(&[], &[]), 0);
    }
}
