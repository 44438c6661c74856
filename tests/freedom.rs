//! What may differ between two clouds, what is known of it, and how long it may take.

#![allow(clippy::unwrap_used)] // a test that fails may do so at once

mod common;

use common::{Pair, Scene, any_pose, distance_m, moved, scaled};
use tmchho::config::Config;
use tmchho::freedom::Freedom;
use tmchho::observations::{ControlPoint, Observations, PosePrior};
use tmchho::pipeline::register;
use tmchho::progress::Progress;
use tmchho::verdict::Verdict;
use tmchho::{Point, Registration, Rigid};

fn of_dof(dof: u8) -> Config {
    Config {
        dof: Freedom::from_dof(dof).unwrap(),
        ..Config::default()
    }
}

fn found(source: &[Point], target: &[Point], config: &Config) -> Registration {
    register(source, target, config, &Progress::silent()).unwrap()
}

#[test]
fn a_levelled_cloud_only_turns_about_the_vertical() {
    let target = Scene::Field.survey(6000, 0.03, 1);
    let turned = Rigid::from_euler([0.0, 0.0, 2.2], [400.0, -30.0, 12.0]);
    let pair = Pair::of(&target, Scene::Field.survey(6000, 0.03, 2), turned);
    let registration = found(&pair.source, &pair.target, &of_dof(4));
    assert_eq!(registration.verdict, Verdict::Accepted);
    assert!(pair.error_m(registration.target_from_source) < registration.voxel_size_m);
    assert_eq!(registration.target_from_source.rigid.rotation[(2, 2)], 1.0);
}

#[test]
fn a_model_without_a_scale_gets_one() {
    let target = Scene::Body.survey(6000, 0.03, 3);
    for (factor, seed) in [(0.6, 1), (1.7, 2)] {
        let source = scaled(
            &moved(&Scene::Body.survey(6000, 0.03, 4), &any_pose(seed)),
            factor,
        );
        let registration = found(&source, &target, &of_dof(7));
        assert_eq!(
            registration.verdict,
            Verdict::Accepted,
            "{:?}",
            registration.reasons
        );
        let scale = registration.target_from_source.scale * factor;
        assert!((scale - 1.0).abs() < 0.005, "{scale}");
        let error = registration
            .uncertainty
            .unwrap()
            .scale_standard_error
            .unwrap();
        assert!((1e-6..5e-3).contains(&error), "{error}");
    }
}

/// A wall with a grid of equal windows, from the window `first` to the sixth after it.
fn windows(first: f64, n: usize, survey: u64) -> Vec<Point> {
    const PITCH_M: [f64; 2] = [2.268, 3.45];
    let mut stream = tmchho::random::Stream::new(survey, "windows", 0);
    (0..n)
        .map(|_| {
            let x = PITCH_M[0] * (first + 6.0 * stream.uniform());
            let z = PITCH_M[1] * 4.0 * stream.uniform();
            let off = |v: f64, pitch: f64| (v.rem_euclid(pitch) - pitch / 2.0).abs();
            let is_window = off(x, PITCH_M[0]) < 0.5 && off(z, PITCH_M[1]) < 0.8;
            [x, if is_window { 0.129 } else { 0.0 }, z].map(|v| v + 0.005 * stream.normal())
        })
        .collect()
}

#[test]
fn a_levelled_row_of_windows_is_never_accepted_at_a_wrong_window() {
    let target = windows(0.0, 18_000, 1);
    for seed in 0..8 {
        let turn = Rigid::from_euler([0.0, 0.0, 0.6 * seed as f64], [30.0, -12.0, 4.0]);
        let pair = Pair::of(&target, windows(3.0, 18_000, 2 + seed), turn);
        let config = Config { seed, ..of_dof(4) };
        let registration = found(&pair.source, &pair.target, &config);
        let is_right = pair.error_m(registration.target_from_source) < registration.voxel_size_m;
        assert!(
            is_right || registration.verdict != Verdict::Accepted,
            "seed {seed}: {:?}",
            registration.reasons
        );
    }
}

/// A box without features: turned by half a turn about the vertical it is itself.
fn its_own_twin(n: usize, survey: u64) -> Vec<Point> {
    let mut stream = tmchho::random::Stream::new(survey, "twin", 0);
    (0..n)
        .map(|i| {
            let [u, v] = [stream.uniform(), stream.uniform()];
            let exact = match i % 5 {
                0 => [40.0 * u, 0.0, 10.0 * v],
                1 => [40.0 * u, 25.0, 10.0 * v],
                2 => [0.0, 25.0 * u, 10.0 * v],
                3 => [40.0, 25.0 * u, 10.0 * v],
                _ => [40.0 * u, 25.0 * v, 10.0],
            };
            exact.map(|v| v + 0.02 * stream.normal())
        })
        .collect()
}

#[test]
fn a_prior_or_control_points_tell_twins_apart() {
    let (target, other) = (its_own_twin(8000, 1), its_own_twin(8000, 2));
    let moved_by = Rigid::from_euler([0.3, -0.2, 2.0], [90.0, 10.0, -5.0]);
    let pair = Pair::of(&target, other, moved_by);
    let truth = pair.target_from_source;
    assert_ne!(
        found(&pair.source, &pair.target, &Config::default()).verdict,
        Verdict::Accepted
    );
    let nearly = Rigid::from_euler([0.05, -0.05, 0.1], [0.5, -0.5, 0.3]) * truth;
    let prior = Observations {
        prior: Some(PosePrior {
            target_from_source: nearly.to_matrix4(),
            rotation_rad: Some([0.2; 3]),
            translation_m: Some([3.0; 3]),
            covariance: None,
            about: None,
        }),
        ..Observations::default()
    };
    let corners = [[0.0, 0.0, 0.0], [40.0, 0.0, 0.0], [0.0, 25.0, 10.0]];
    let control_points = Observations {
        control_points: corners
            .iter()
            .map(|corner| ControlPoint {
                source: truth.inverse().apply(corner),
                target: *corner,
                sigma_m: 0.5,
            })
            .collect(),
        ..Observations::default()
    };
    for known in [prior, control_points] {
        let config = Config {
            known,
            ..Config::default()
        };
        let registration = found(&pair.source, &pair.target, &config);
        let error_m = pair.error_m(registration.target_from_source);
        assert!(error_m < 0.5, "{error_m}");
        assert_eq!(
            registration.verdict,
            Verdict::Accepted,
            "{:?}",
            registration.reasons
        );
    }
}

#[test]
fn when_the_time_is_up_the_best_so_far_comes_and_is_not_accepted() {
    let pair = Pair::new(Scene::Body, 5000, 7);
    let mut config = Config::default();
    config.coarse.max_seconds = Some(1e-9);
    let registration = found(&pair.source, &pair.target, &config);
    assert!(registration.ended_early);
    assert_ne!(registration.verdict, Verdict::Accepted);
    assert!(registration.reasons.join(" ").contains("time was up"));
}

#[test]
fn a_crop_limits_what_takes_part() {
    let pair = Pair::new(Scene::Field, 8000, 9);
    let low = [f64::MIN, f64::MIN, f64::MIN];
    let middle = [50.0, f64::MAX, f64::MAX];
    let config = Config {
        target_crop_m: Some([low, middle]),
        ..Config::default()
    };
    let registration = found(&pair.source, &pair.target, &config);
    let whole = found(&pair.source, &pair.target, &Config::default());
    let n_voxels = |r: &Registration| r.stages[1].n_target.1;
    assert!(n_voxels(&registration) < 2 * n_voxels(&whole) / 3);
    let at = |r: &Registration| r.target_from_source.apply(&pair.source[0]);
    assert!(distance_m(&at(&registration), &at(&whole)) < whole.voxel_size_m);
}

#[test]
fn a_mirrored_source_is_named() {
    let pair = Pair::new(Scene::Body, 6000, 11);
    let mirrored: Vec<Point> = pair.source.iter().map(|p| [p[1], p[0], p[2]]).collect();
    let registration = found(&mirrored, &pair.target, &Config::default());
    assert_ne!(registration.verdict, Verdict::Accepted);
    let reasons = registration.reasons.join("; ");
    assert!(reasons.contains("mirrored"), "{reasons}");
}
