//! Fine registration on simulated surveys whose truth is known: methods, degrees of freedom, what is
//! known beforehand, and whether the accuracy that is promised is the accuracy that is reached.

#![allow(clippy::unwrap_used)]

use tmchho::freedom::Freedom;
use tmchho::icp::{Clouds, IcpKernel, IcpMethod, IcpOptions, IcpResult, IcpStop, icp};
use tmchho::normals::Surface;
use tmchho::observations::{ControlPoint, LocalObservations, Observations, PosePrior};
use tmchho::progress::Progress;
use tmchho::random::Stream;
use tmchho::similarity::Similarity;
use tmchho::surface_cloud::SurfaceCloud;
use tmchho::{Cloud, Point, Rigid};

const PLANES: [IcpMethod; 2] = [IcpMethod::PointToPlane, IcpMethod::PlaneToPlane];

/// Rolling ground 40 m wide with a wall on it, or a flat floor.
#[derive(Clone, Copy)]
struct Survey {
    n: usize,
    from_m: f64,
    noise_m: f64,
    relief: f64,
}

const GROUND: Survey = Survey {
    n: 4000,
    from_m: 0.0,
    noise_m: 0.03,
    relief: 1.0,
};

impl Survey {
    fn points(&self, seed: u64) -> Vec<Point> {
        let mut stream = Stream::new(seed, "survey", 0);
        (0..self.n)
            .map(|i| {
                let x = self.from_m + 40.0 * stream.uniform();
                let y = 40.0 * stream.uniform();
                let hills = 3.0 * (0.17 * x).sin() * (0.13 * y).cos() + (0.5 * x + 0.3 * y).sin();
                let place = match i % 8 {
                    0 if self.relief > 0.0 => [x, 12.0 + 0.1 * x, 6.0 * stream.uniform()],
                    _ => [x, y, self.relief * hills],
                };
                place.map(|v| v + self.noise_m * stream.normal())
            })
            .collect()
    }

    fn cloud(&self, seed: u64) -> SurfaceCloud {
        surfaces(&self.points(seed))
    }
}

fn surfaces(points: &[Point]) -> SurfaceCloud {
    SurfaceCloud::new(&Cloud::new(points).unwrap(), 0, &Progress::silent()).unwrap()
}

/// Two clouds, and the pose between their local coordinates.
struct Pair {
    source: SurfaceCloud,
    target: SurfaceCloud,
    truth: Similarity,
}

impl Pair {
    fn new(source: SurfaceCloud, target: SurfaceCloud) -> Self {
        let shift = std::array::from_fn(|axis| source.origin[axis] - target.origin[axis]);
        Self {
            source,
            target,
            truth: Rigid::from_euler([0.0; 3], shift).into(),
        }
    }

    fn of(source: Survey, target: Survey, seed: u64) -> Self {
        Self::new(source.cloud(1000 + seed), target.cloud(2000 + seed))
    }

    /// Some way off the truth.
    fn start(&self, seed: u64, turn_rad: f64, shift_m: f64) -> Similarity {
        let mut stream = Stream::new(seed, "start", 0);
        let mut draw = |width: f64| [0; 3].map(|_| width * stream.normal());
        let away = Rigid::from_rotation_vector(draw(turn_rad).into(), draw(shift_m).into());
        Similarity::from(away) * self.truth
    }

    fn refine(
        &self,
        start: Similarity,
        freedom: Freedom,
        known: &LocalObservations,
        options: &IcpOptions,
    ) -> IcpResult {
        let clouds = Clouds {
            source: self.source.points(),
            source_surfaces: &self.source.surfaces,
            target: &self.target.index,
            target_surfaces: &self.target.surfaces,
        };
        icp(
            &clouds,
            &start,
            freedom,
            known,
            options,
            &Progress::silent(),
        )
        .unwrap()
    }

    /// Root mean squared displacement of the source points above `from_m`.
    fn error_m(&self, pose: &Similarity, from_m: f64) -> f64 {
        let is_shared = |p: &&Point| p[0] + self.source.origin[0] > from_m;
        let shared: Vec<&Point> = self.source.points().iter().filter(is_shared).collect();
        let off_sq = |p: &&Point| {
            let (a, b) = (pose.apply(p), self.truth.apply(p));
            (0..3).map(|axis| (a[axis] - b[axis]).powi(2)).sum::<f64>()
        };
        (shared.iter().map(off_sq).sum::<f64>() / shared.len() as f64).sqrt()
    }

    /// Control points round the source, measured with `sigma_m`.
    fn controls(&self, n: usize, sigma_m: f64, seed: u64) -> LocalObservations {
        let mut stream = Stream::new(seed, "controls", 0);
        let control = |_| {
            let source = [15.0, 15.0, 3.0].map(|width| width * stream.normal());
            let exact = self.truth.apply(&source);
            let target = exact.map(|v| v + sigma_m * stream.normal());
            ControlPoint {
                source,
                target,
                sigma_m,
            }
        };
        let control_points = (0..n).map(control).collect();
        let known = Observations {
            control_points,
            ..Observations::default()
        };
        known.about([0.0; 3], [0.0; 3]).unwrap()
    }
}

fn options(method: IcpMethod) -> IcpOptions {
    IcpOptions {
        method: Some(method),
        max_distance_m: Some(1.5),
        ..IcpOptions::default()
    }
}

fn nothing() -> LocalObservations {
    LocalObservations::default()
}

#[test]
fn every_method_finds_what_is_free_and_keeps_what_is_not() {
    let target = GROUND.points(1);
    let methods = [PLANES[0], PLANES[1], IcpMethod::PointToPoint];
    for (freedom, motion) in [
        (Freedom::Levelled, ([0.0, 0.0, 0.008], 1.0)),
        (Freedom::Rigid, ([0.006, -0.004, 0.005], 1.0)),
        (Freedom::Similarity, ([0.006, -0.004, 0.005], 1.006)),
    ] {
        let away = Similarity {
            scale: motion.1,
            rigid: Rigid::from_euler(motion.0, [0.1, -0.05, 0.08]),
        };
        let middle = Similarity::from(Rigid::from_euler([0.0; 3], [20.0, 20.0, 0.0]));
        let truth = middle * away * middle.inverse();
        let source: Vec<Point> = target.iter().map(|p| truth.inverse().apply(p)).collect();
        let mut pair = Pair::new(surfaces(&source), surfaces(&target));
        pair.truth = truth.between_local_coordinates(pair.source.origin, pair.target.origin);
        let shift = std::array::from_fn(|k| pair.source.origin[k] - pair.target.origin[k]);
        let as_given = Rigid::from_euler([0.0; 3], shift).into();
        for method in methods {
            let options = IcpOptions {
                relative_tolerance: 0.0,
                max_iterations: 200,
                ..options(method)
            };
            let found = pair.refine(as_given, freedom, &nothing(), &options);
            let pose = found.target_from_source;
            let what = format!("{freedom:?} {method:?} {:?}", found.stop_reason);
            assert!(
                pair.error_m(&pose, -1e9) < 1e-6,
                "{what} {}",
                pair.error_m(&pose, -1e9)
            );
            assert_eq!(found.stop_reason, IcpStop::Converged, "{what}");
            match freedom {
                Freedom::Levelled => assert_eq!(pose.rigid.rotation[(2, 2)], 1.0, "{what}"),
                Freedom::Rigid => assert_eq!(pose.scale, 1.0, "{what}"),
                Freedom::Similarity => assert!((pose.scale - 1.006).abs() < 1e-8, "{what}"),
            }
        }
    }
}

#[test]
fn the_accuracy_promised_is_the_accuracy_reached() {
    let noisy = Survey {
        noise_m: 0.1,
        ..GROUND
    };
    let sparse = Survey { n: 1200, ..GROUND };
    let half = Survey {
        from_m: 20.0,
        ..GROUND
    };
    for (name, source, target) in [
        ("alike", GROUND, GROUND),
        ("a noisy source", noisy, GROUND),
        ("a noisy target", GROUND, noisy),
        ("a sparse source", sparse, GROUND),
        ("a sparse target", GROUND, sparse),
        ("half an overlap", GROUND, half),
    ] {
        for method in PLANES {
            let n_trials = 12;
            let (mut errors, mut promised, mut n_within) = (0.0, 0.0, 0);
            for seed in 0..n_trials {
                let pair = Pair::of(source, target, seed);
                let start = pair.start(seed, 0.006, 0.15);
                let found = pair.refine(start, Freedom::Rigid, &nothing(), &options(method));
                let error_m = pair.error_m(&found.target_from_source, target.from_m);
                let error_promised_m = found.uncertainty.unwrap().registration_error_m;
                errors += error_m.powi(2);
                promised += error_promised_m.powi(2);
                n_within += u64::from(error_m < 3.0 * error_promised_m);
            }
            let ratio = (errors / promised).sqrt();
            assert!((0.4..1.5).contains(&ratio), "{name}, {method:?}: {ratio}");
            assert_eq!(n_within, n_trials, "{name}, {method:?}");
        }
    }
}

#[test]
fn what_one_sensor_alone_saw_has_no_say() {
    // A berm of a metre over a third of the source, within the reach of the partners.
    let mut source = GROUND.points(1);
    source.retain(|p| (p[1] - 12.0 - 0.1 * p[0]).abs() > 0.3);
    for p in source.iter_mut().filter(|p| p[0] > 26.0) {
        p[2] += 0.6;
    }
    let pair = Pair::new(surfaces(&source), GROUND.cloud(2));
    let error_m = |kernel, kept_share, method| {
        let options = IcpOptions {
            kernel,
            kept_share,
            ..options(method)
        };
        let found = pair.refine(pair.truth, Freedom::Rigid, &nothing(), &options);
        pair.error_m(&found.target_from_source, -1e9)
    };
    let plain = error_m(Some(IcpKernel::LeastSquares), Some(1.0), PLANES[0]);
    assert!(plain > 0.15, "{plain}");
    for method in PLANES {
        let robust = error_m(None, None, method);
        assert!(robust < 0.05, "{method:?} {robust}");
    }
}

#[test]
fn a_flat_floor_stays_where_it_is_and_says_so() {
    let floor = Survey {
        relief: 0.0,
        ..GROUND
    };
    for method in PLANES {
        let pair = Pair::of(floor, floor, 3);
        let start = Similarity::from(Rigid::from_euler([0.0; 3], [0.3, -0.2, 0.1])) * pair.truth;
        let found = pair.refine(start, Freedom::Rigid, &nothing(), &options(method));
        let slid = found.target_from_source.rigid.translation - start.rigid.translation;
        assert!(slid.xy().norm() < 0.02, "{method:?} {:?}", slid.as_slice());
        assert!((slid.z + 0.1).abs() < 0.01, "{method:?} {}", slid.z);
        assert!(found.uncertainty.unwrap().registration_error_m > 5.0);
        // Control points hold it, and the promise follows them.
        let known = pair.controls(6, 0.02, 1);
        let held = pair.refine(start, Freedom::Rigid, &known, &options(method));
        let promised = held.uncertainty.unwrap().registration_error_m;
        let error_m = pair.error_m(&held.target_from_source, -1e9);
        assert!((0.005..0.05).contains(&promised), "{method:?} {promised}");
        assert!(error_m < 3.0 * promised, "{method:?} {error_m} {promised}");
    }
}

#[test]
fn observations_count_by_their_accuracy() {
    let pair = Pair::of(GROUND, GROUND, 4);
    // A prior that is wrong by 0.2 along x.
    let wrong = (Rigid::from_euler([0.0; 3], [0.2, 0.0, 0.0]) * pair.truth.rigid).to_matrix4();
    let with = |sigma_m: f64, method: IcpMethod| {
        let prior = PosePrior {
            target_from_source: wrong,
            rotation_rad: Some([10.0 * sigma_m; 3]),
            translation_m: Some([sigma_m; 3]),
            covariance: None,
            about: None,
        };
        let known = Observations {
            prior: Some(prior),
            ..Observations::default()
        };
        let known = known.about([0.0; 3], [0.0; 3]).unwrap();
        let found = pair.refine(pair.truth, Freedom::Rigid, &known, &options(method));
        let pose = found.target_from_source.rigid.translation;
        (pose - pair.truth.rigid.translation).x
    };
    for method in [PLANES[0], PLANES[1], IcpMethod::PointToPoint] {
        let (sure, vague) = (with(1e-5, method), with(100.0, method));
        assert!((sure - 0.2).abs() < 0.01, "{method:?} {sure}");
        let alone = pair.refine(pair.truth, Freedom::Rigid, &nothing(), &options(method));
        let alone = alone.target_from_source.rigid.translation - pair.truth.rigid.translation;
        let nearly = if method == IcpMethod::PointToPoint {
            0.02
        } else {
            1e-4
        };
        assert!(
            (vague - alone.x).abs() < nearly,
            "{method:?} {vague} {}",
            alone.x
        );
    }
}

#[test]
fn the_scale_has_an_honest_standard_error() {
    let (mut sum_sq, n_trials) = (0.0, 12);
    for seed in 0..n_trials {
        let pair = Pair::of(GROUND, GROUND, 50 + seed);
        let start = Similarity {
            scale: 1.01,
            rigid: pair.truth.rigid,
        };
        let found = pair.refine(start, Freedom::Similarity, &nothing(), &options(PLANES[0]));
        let off = found.target_from_source.scale - 1.0;
        assert!(off.abs() < 1e-3, "{off}");
        sum_sq += (off / found.uncertainty.unwrap().scale_standard_error.unwrap()).powi(2);
    }
    let ratio = (sum_sq / n_trials as f64).sqrt();
    assert!((0.4..1.8).contains(&ratio), "{ratio}");
}

#[test]
fn a_scale_does_not_collapse() {
    // Clouds of different places: nothing holds the scale, and it must not go to nothing.
    let other = Survey {
        from_m: 400.0,
        ..GROUND
    };
    let pair = Pair::new(GROUND.cloud(1), other.cloud(2));
    let options = IcpOptions {
        max_iterations: 300,
        max_distance_m: Some(8.0),
        ..options(IcpMethod::PointToPlane)
    };
    let start = Similarity::identity();
    let found = pair.refine(start, Freedom::Similarity, &nothing(), &options);
    assert!((0.8..=1.25).contains(&found.target_from_source.scale));
}

#[test]
fn surfaces_that_are_missing_are_asked_for() {
    let pair = Pair::of(GROUND, GROUND, 1);
    let refused = |source: &[Surface], target: &[Surface], method: IcpMethod| {
        let clouds = Clouds {
            source: pair.source.points(),
            source_surfaces: source,
            target: &pair.target.index,
            target_surfaces: target,
        };
        let (silent, start) = (Progress::silent(), Similarity::identity());
        let found = icp(
            &clouds,
            &start,
            Freedom::Rigid,
            &nothing(),
            &options(method),
            &silent,
        );
        found.map_or_else(|error| error.to_string(), |_| "not refused".into())
    };
    let (source, target) = (&pair.source.surfaces, &pair.target.surfaces);
    assert!(refused(source, &[], PLANES[0]).contains("target_surfaces"));
    assert!(refused(&source[1..], target, PLANES[0]).contains("source_surfaces"));
    assert!(refused(&[], target, PLANES[1]).contains("source_surfaces"));
    assert_eq!(refused(&[], target, PLANES[0]), "not refused");
}
