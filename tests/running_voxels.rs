//! The voxel grid of a cloud in parts is that of the cloud as a whole.

#![allow(clippy::unwrap_used)]

use tmchho::progress::Progress;
use tmchho::random::Stream;
use tmchho::running_voxels::RunningVoxels;
use tmchho::voxel::downsample;
use tmchho::{Cloud, Point};

fn points(n: usize) -> Vec<Point> {
    let mut stream = Stream::new(1, "running_voxels", 0);
    let grid = [500_000.0, 4_000_000.0, 200.0];
    let widths = [30.0, 50.0, 8.0];
    (0..n)
        .map(|_| std::array::from_fn(|axis| grid[axis] + widths[axis] * stream.normal()))
        .collect()
}

fn box_of(points: &[Point]) -> (Point, Point) {
    let corner = |better: fn(f64, f64) -> f64, start: f64| {
        std::array::from_fn(|axis| points.iter().fold(start, |best, p| better(best, p[axis])))
    };
    (
        corner(f64::min, f64::INFINITY),
        corner(f64::max, f64::NEG_INFINITY),
    )
}

#[test]
fn the_bits_are_those_of_the_cloud_as_a_whole() {
    let points = points(50_000);
    let (low, high) = box_of(&points);
    for edge in [0.7, 3.0, 1e4] {
        let cloud = Cloud::new(&points).unwrap();
        let wanted = downsample(&cloud, edge, &Progress::silent()).unwrap();
        for part in [1, 777, 50_000] {
            let mut voxels = RunningVoxels::new(low, high, edge, usize::MAX).unwrap();
            for part in points.chunks(part) {
                voxels.add(part).unwrap();
            }
            let found = voxels.finish();
            assert_eq!(found.points, wanted.cloud.to_given_coordinates());
            assert_eq!(found.n_points, wanted.n_points);
            assert_eq!(found.voxel_size_m, edge);
        }
    }
}

#[test]
fn a_limit_doubles_the_edge_and_loses_no_point() {
    let points = points(20_000);
    let (low, high) = box_of(&points);
    let mut voxels = RunningVoxels::new(low, high, 0.5, 3000).unwrap();
    voxels.add(&points).unwrap();
    let found = voxels.finish();
    let doublings = (found.voxel_size_m / 0.5).log2();
    assert!(doublings >= 1.0 && doublings.fract() == 0.0);
    assert!(found.points.len() <= 3000);
    let cloud = Cloud::new(&points).unwrap();
    let wanted = downsample(&cloud, found.voxel_size_m, &Progress::silent()).unwrap();
    assert_eq!(found.n_points, wanted.n_points);
    let twins = wanted.cloud.to_given_coordinates();
    for (p, q) in found.points.iter().zip(twins) {
        assert!((0..3).all(|axis| (p[axis] - q[axis]).abs() < 1e-8));
    }
    // An edge less would not have been enough.
    let finer = downsample(&cloud, found.voxel_size_m / 2.0, &Progress::silent()).unwrap();
    assert!(finer.n_points.len() > 3000);
}
