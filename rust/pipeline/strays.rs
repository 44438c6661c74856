//! Voxels of strays: of wrong matches and wrong returns that stand together, so that stage 1 keeps them.
//!
//! Why: stage 1 takes away what stands almost alone, and spares the thin end of a scan. Where a third of
//! all points are strays, they stand as close together as the points of that end. In a thinned cloud each of
//! them counts as much as a surface; what tells them apart is how many points stand round about.
//! Source: ours; measured in docs/robust_search.md.

use crate::cloud::Cloud;
use crate::neighbors::NeighborIndex;
use crate::parallel;
use crate::voxel::VoxelResult;

/// Points are counted within so many voxels.
const RADIUS_IN_VOXELS: f64 = 2.0;
/// A stray has less than this share of the points round about that half of all points have.
const LEAST_SHARE: f64 = 0.25;

/// The voxels without those of strays, in their order.
pub(super) fn without_strays(voxels: &VoxelResult, voxel_size_m: f64) -> Cloud {
    let (cloud, n_points) = (&voxels.cloud, &voxels.n_points);
    let index = NeighborIndex::new(cloud.points());
    let n_near: Vec<u64> = parallel::map(cloud.len(), |i| {
        let mut near = Vec::new();
        index.within(
            &cloud.points()[i],
            RADIUS_IN_VOXELS * voxel_size_m,
            &mut near,
        );
        let n = |voxel: u32| u64::from(n_points[voxel as usize]);
        near.iter().map(|neighbor| n(neighbor.index)).sum()
    });
    let least = LEAST_SHARE * half_of_all_have(&n_near, n_points) as f64;
    let kept = (0..cloud.len())
        .filter(|i| n_near[*i] as f64 >= least)
        .map(|i| cloud.points()[i])
        .collect();
    Cloud::from_local(cloud.origin(), kept)
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
    use crate::cloud::Point;
    use crate::progress::Progress;
    use crate::random::Stream;
    use crate::voxel::downsample;

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
        let voxels = downsample(&cloud, 1.0, &Progress::silent()).unwrap();
        let cleaned = without_strays(&voxels, 1.0).to_given_coordinates();
        let count = |points: &[Point], low: f64, high: f64| {
            let is_there = |p: &&Point| (low..high).contains(&p[2]);
            points.iter().filter(is_there).count()
        };
        let before = voxels.cloud.to_given_coordinates();
        // A few strays stand together by chance.
        let n_strays = count(&before, 3.0, 11.0);
        assert!(n_strays > 1500 && count(&cleaned, 3.0, 11.0) < n_strays / 50);
        let n_ground = count(&before, -1.0, 0.3);
        assert!(count(&cleaned, -1.0, 0.3) as f64 > 0.98 * n_ground as f64);
    }

    #[test]
    fn the_median_is_over_points() {
        assert_eq!(half_of_all_have(&[5, 1, 9], &[1, 1, 3]), 9);
        assert_eq!(half_of_all_have(&[5, 1, 9], &[2, 3, 1]), 1);
        assert_eq!(half_of_all_have(&[], &[]), 0);
    }
}
