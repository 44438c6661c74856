//! How long a registration takes, and the tools and stages that it spends its time on: from a
//! thousand points to a hundred thousand, points per second.
//!
//! `cargo bench --bench route -- --quick` for a first look, `-- icp` for one stage.

use std::hint::black_box;
use std::time::Duration;

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use tmchho::coarse::{Problem, RobustSearchOptions, StandingOut, search_robust};
use tmchho::deadline::Deadline;
use tmchho::distance_field::NearestGrid;
use tmchho::fitness::{self, Tolerance, Witnesses};
use tmchho::freedom::Freedom;
use tmchho::icp::{Clouds, IcpMethod, IcpOptions, icp};
use tmchho::observations::LocalObservations;
use tmchho::point_to_plane::PlaneSums;
use tmchho::progress::Progress;
use tmchho::random::Stream;
use tmchho::surface_cloud::SurfaceCloud;
use tmchho::{Cloud, Config, Point, Rigid, kabsch, register};

const SIZES: [usize; 3] = [1_000, 10_000, 100_000];
const SIDE_M: f64 = 100.0;
/// Distances within which points are partners, and from which a surface is looked at.
const REACH_M: f64 = 2.0;

/// Rolling ground with a wall on it.
fn survey(n: usize, sensor: u64) -> Vec<Point> {
    let mut stream = Stream::new(1, "bench", sensor);
    (0..n)
        .map(|i| {
            let (x, y) = (SIDE_M * stream.uniform(), SIDE_M * stream.uniform());
            let ground = 6.0 * (0.07 * x).sin() * (0.09 * y).cos() + 2.0 * (0.002 * x * y).sin();
            match i % 6 {
                0 => [x, 0.3 * SIDE_M + 0.2 * x, 9.0 * stream.uniform()],
                _ => [x, y, ground + 0.02 * stream.normal()],
            }
        })
        .collect()
}

/// Two surveys of one place, the source nearly where it belongs.
struct Scene {
    source: Vec<Point>,
    target: Vec<Point>,
    source_surface: SurfaceCloud,
    target_surface: SurfaceCloud,
    nearly: Rigid,
}

impl Scene {
    fn new(n: usize) -> Self {
        let (source, target) = (survey(n, 0), survey(n, 1));
        let surface = |points: &[Point]| {
            let cloud = Cloud::new(points).expect("the ground is no plane");
            SurfaceCloud::new(&cloud, 0, &Progress::silent()).expect("nobody says stop")
        };
        let (source_surface, target_surface) = (surface(&source), surface(&target));
        let nearly = Rigid::from_euler([0.004, -0.003, 0.006], [0.2, -0.3, 0.1]);
        Self {
            source,
            target,
            source_surface,
            target_surface,
            nearly,
        }
    }

    fn witnesses(&self) -> [Witnesses; 2] {
        let silent = Progress::silent();
        let surface = |points: &[Point]| {
            let cloud = Cloud::new(points).expect("the scene is a cloud");
            SurfaceCloud::new(&cloud, 0, &silent).expect("nobody says stop")
        };
        let surfaces = [surface(&self.source), surface(&self.target)];
        let spacing_m = SIDE_M / (self.target.len() as f64).sqrt();
        Witnesses::of_both(surfaces, 4000, 5.0, spacing_m, &Progress::silent())
            .expect("nobody says stop")
    }

    fn icp(&self, method: IcpMethod) -> usize {
        let (source, target) = (&self.source_surface, &self.target_surface);
        let options = IcpOptions {
            method: Some(method),
            max_distance_m: Some(REACH_M),
            ..IcpOptions::default()
        };
        let clouds = Clouds {
            source: source.points(),
            source_surfaces: &source.surfaces,
            target: &target.index,
            target_surfaces: &target.surfaces,
        };
        let (start, nothing, silent) = (
            self.nearly.into(),
            LocalObservations::default(),
            Progress::silent(),
        );
        icp(&clouds, &start, Freedom::Rigid, &nothing, &options, &silent)
            .expect("the settings are in their ranges")
            .n_iterations
    }
}

/// Benches that share a scene of every size; throughput in points of one cloud.
fn each_size(criterion: &mut Criterion, benches: fn(&Scene, &mut Bench<'_>)) {
    for n in SIZES {
        benches(&Scene::new(n), &mut |name, work| {
            let (group, name) = name.split_once('/').unwrap_or((name, "all"));
            let mut group = criterion.benchmark_group(group);
            group
                .sample_size(10)
                .warm_up_time(Duration::from_millis(200))
                .measurement_time(Duration::from_secs(1))
                .throughput(Throughput::Elements(n as u64));
            group.bench_function(BenchmarkId::new(name, n), |b| b.iter(&mut *work));
            group.finish();
        });
    }
}

type Bench<'a> = dyn FnMut(&str, &mut dyn FnMut()) + 'a;

fn tools(criterion: &mut Criterion) {
    each_size(criterion, |scene, bench| {
        let (source, target) = (&scene.source_surface, &scene.target_surface);
        let build = || NearestGrid::new(target.points(), REACH_M, 15.0, 2_000_000);
        let grid = build().expect("the target has points");
        bench("distance_field/build", &mut || {
            black_box(build());
        });
        bench("distance_field/nearest", &mut || {
            let far = |p: &Point| grid.nearest(&scene.nearly.apply(p)).1;
            black_box(source.points().iter().map(far).sum::<f64>());
        });
        bench("kabsch/fit", &mut || {
            black_box(kabsch::fit(&scene.source, &scene.target));
        });
        bench("point_to_plane/step", &mut || {
            let mut sums = PlaneSums::default();
            let pairs = source.points().iter().zip(target.points());
            for ((p, q), surface) in pairs.zip(&target.surfaces) {
                sums.add(p, q, &surface.normal, 1.0);
            }
            black_box(sums.solve());
        });
    });
}

fn fitness(criterion: &mut Criterion) {
    each_size(criterion, |scene, bench| {
        let (source, target) = (&scene.source_surface, &scene.target_surface);
        let [moving, fixed] = scene.witnesses();
        bench("fitness/rms", &mut || {
            black_box(fitness::rms(source.points(), &target.index, &scene.nearly));
        });
        bench("fitness/agreement", &mut || {
            let tolerance = Tolerance::within(REACH_M);
            black_box(fitness::agreement(
                (&moving, &*moving.cloud.index),
                (&fixed, &*fixed.cloud.index),
                &scene.nearly.into(),
                tolerance,
            ));
        });
    });
}

fn stages(criterion: &mut Criterion) {
    each_size(criterion, |scene, bench| {
        bench("icp/point_to_point", &mut || {
            black_box(scene.icp(IcpMethod::PointToPoint));
        });
        bench("icp/point_to_plane", &mut || {
            black_box(scene.icp(IcpMethod::PointToPlane));
        });
        bench("icp/plane_to_plane", &mut || {
            black_box(scene.icp(IcpMethod::PlaneToPlane));
        });
        let [moving, fixed] = scene.witnesses();
        bench("coarse/robust", &mut || {
            let (options, silent) = (RobustSearchOptions::default(), Progress::silent());
            let problem = Problem {
                source: &moving,
                target: &fixed,
                unit_m: 1.4 * SIDE_M,
                freedom: Freedom::Rigid,
                known: &LocalObservations::default(),
            };
            // One round, however clear its answer.
            let enough = StandingOut {
                inlier_share: 0.0,
                ambiguity_ratio: 0.0,
                share_times_ratio: 0.0,
                misfit: f64::INFINITY,
                conflict_share: 1.0,
            };
            let found = search_robust(&problem, &options, enough, Deadline::default(), 0, &silent);
            black_box(found.is_ok());
        });
        bench("route", &mut || {
            let (config, silent) = (Config::default(), Progress::silent());
            black_box(register(&scene.source, &scene.target, &config, &silent).is_ok());
        });
    });
}

criterion_group!(benches, tools, fitness, stages);
criterion_main!(benches);
