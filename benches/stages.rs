//! How long the point-wise stages take: from ten thousand points to a million, points per second.
//!
//! `cargo bench --bench stages -- --quick` for a first look, `-- voxel` for one stage. With
//! `TMCHHO_BENCH_LARGE=1` ten million points as well, which takes gigabytes and many minutes.

use std::hint::black_box;

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use tmchho::neighbors::NeighborIndex;
use tmchho::progress::Progress;
use tmchho::random::Stream;
use tmchho::{Cloud, Point, Rigid};
use tmchho::{evaluate, fuse, keypoints, normals, outlier, spacing, voxel};

const SIZES: [usize; 3] = [10_000, 100_000, 1_000_000];
const LARGE: usize = 10_000_000;
const LARGE_VARIABLE: &str = "TMCHHO_BENCH_LARGE";

fn sizes() -> Vec<usize> {
    let large = std::env::var_os(LARGE_VARIABLE).map(|_| LARGE);
    SIZES.into_iter().chain(large).collect()
}

/// A cloud of rolling ground, with its index and its spacing.
struct Scene {
    cloud: Cloud,
    index: NeighborIndex,
    spacing_m: f64,
}

impl Scene {
    /// `n` points in random order, at one density whatever their number.
    fn new(n: usize, survey: u64) -> Self {
        let mut stream = Stream::new(1, "bench", survey);
        let side_m = 0.1 * (n as f64).sqrt();
        let points: Vec<Point> = (0..n)
            .map(|_| {
                let (x, y) = (side_m * stream.uniform(), side_m * stream.uniform());
                let height_m = 2.0 * (0.3 * x).sin() * (0.2 * y).cos();
                [x, y, height_m + 0.02 * stream.normal()]
            })
            .collect();
        let cloud = Cloud::new(&points).expect("the ground is no plane");
        let index = NeighborIndex::new(cloud.points());
        let spacing_m = spacing::median_spacing_m(&index, &Progress::silent());
        let spacing_m = spacing_m.expect("nobody says stop");
        Self {
            cloud,
            index,
            spacing_m,
        }
    }
}

/// The points laid into one level plane.
fn flat(points: &[Point]) -> Vec<Point> {
    points.iter().map(|[x, y, _]| [*x, *y, 0.0]).collect()
}

/// The points with copies of others in the place of three in ten.
fn with_duplicates(points: &[Point]) -> Vec<Point> {
    let place = |i: usize| if i % 10 < 3 { i * 7 + 3 } else { i };
    (0..points.len())
        .map(|i| points[place(i) % points.len()])
        .collect()
}

fn stages(criterion: &mut Criterion) {
    let silent = Progress::silent();
    for n in sizes() {
        let scene = Scene::new(n, 0);
        let other = Scene::new(n, 1);
        let (points, others) = (scene.cloud.points(), other.cloud.points());
        let edge_m = 4.0 * scene.spacing_m;
        let mut bench = |name: &str, work: &mut dyn FnMut()| {
            let mut group = criterion.benchmark_group(name);
            group
                .sample_size(10)
                .throughput(Throughput::Elements(n as u64));
            group.bench_function(BenchmarkId::from_parameter(n), |b| b.iter(&mut *work));
            group.finish();
        };
        bench("index", &mut || {
            black_box(NeighborIndex::new(points));
        });
        bench("spacing", &mut || {
            black_box(spacing::median_spacing_m(&scene.index, &silent).is_ok());
        });
        bench("normals", &mut || {
            black_box(normals::estimate(points, &scene.index, 20, &silent).is_ok());
        });
        bench("outlier", &mut || {
            let options = outlier::OutlierOptions::default();
            let kept = outlier::remove_outliers(&scene.cloud, &scene.index, &options, &silent);
            black_box(kept.is_ok());
        });
        bench("voxel", &mut || {
            black_box(voxel::downsample(&scene.cloud, edge_m, &silent).is_ok());
        });
        bench("keypoints", &mut || {
            let options = keypoints::IssOptions::default();
            let found = keypoints::detect(&scene.cloud, &scene.index, &options, edge_m, &silent);
            black_box(found.is_ok());
        });
        bench("evaluate", &mut || {
            black_box(evaluate::nearest_distances(others, &scene.index, &silent).is_ok());
        });
        let shapes = [
            ("nearest", points.to_vec(), others.to_vec()),
            ("nearest_flat", flat(points), flat(others)),
            (
                "nearest_duplicates",
                with_duplicates(points),
                with_duplicates(others),
            ),
        ];
        for (name, target, source) in shapes {
            bench(name, &mut || {
                let index = NeighborIndex::new(&target);
                black_box(evaluate::nearest_distances(&source, &index, &silent).is_ok());
            });
        }
        bench("both_ways", &mut || {
            for (source, target) in [(points, others), (others, points)] {
                let index = NeighborIndex::new(target);
                black_box(evaluate::nearest_distances(source, &index, &silent).is_ok());
            }
        });
        bench("fuse", &mut || {
            let fused = fuse::fuse(
                &scene.cloud,
                &scene.index,
                &other.cloud,
                &other.index,
                Rigid::identity(),
                &fuse::FuseOptions::default(),
                &silent,
            );
            black_box(fused.is_ok());
        });
    }
}

criterion_group!(benches, stages);
criterion_main!(benches);
