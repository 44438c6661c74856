//! Input from which no pose follows: refused by name, or judged and never accepted.

#![allow(clippy::unwrap_used)]

mod common;

use common::{Pair, SIDE_M, Scene, any_pose, direction, moved, scaled};
use tmchho::config::{Config, Mode};
use tmchho::fuse::FuseOptions;
use tmchho::pipeline::{evaluate, fuse_clouds, register};
use tmchho::progress::Progress;
use tmchho::random::Stream;
use tmchho::verdict::Verdict;
use tmchho::{Error, Point, Registration, Result, Rigid};

fn run(source: &[Point], target: &[Point], config: &Config) -> Result<Registration> {
    register(source, target, config, &Progress::silent())
}

fn draw(n: usize, survey: u64, sample: impl Fn(&mut Stream) -> Point) -> Vec<Point> {
    let mut stream = Stream::new(survey, "degenerate", 0);
    (0..n).map(|_| sample(&mut stream)).collect()
}

/// Straight rows, tilted planes, piles: at home and at national-grid coordinates.
fn clouds_without_a_pose() -> Vec<(&'static str, Vec<Point>)> {
    let tilt = Rigid::from_euler([0.4, -0.9, 2.0], [0.0; 3]);
    let grid = Rigid::from_euler([0.0; 3], [500_000.0, 4_000_000.0, 300.0]);
    let line = draw(200, 1, |s| [100.0 * s.uniform(), 0.0, 0.0]);
    let plane = draw(500, 2, |s| [100.0 * s.uniform(), 60.0 * s.uniform(), 0.0]);
    let tilted = |points: &[Point]| moved(points, &tilt);
    vec![
        ("0 usable points", vec![]),
        ("1 usable points", vec![[1.0, 2.0, 3.0]]),
        ("3 usable points", draw(3, 3, direction)),
        ("0 usable points", vec![[f64::NAN; 3]; 50]),
        ("3 usable points", {
            let mut points = vec![[0.0, f64::INFINITY, 0.0]; 50];
            points.extend(draw(3, 4, direction));
            points
        }),
        ("identical", vec![[7.0, 8.0, 9.0]; 100]),
        ("identical", vec![[500_000.1, 4_000_000.2, 30.3]; 100]),
        ("one line", line.clone()),
        ("one line", tilted(&line)),
        ("one line", moved(&tilted(&line), &grid)),
        ("one line", {
            let mut points = vec![[0.0; 3]; 100];
            points.extend(vec![[1.0; 3]; 100]);
            points
        }),
        ("one plane", plane.clone()),
        ("one plane", tilted(&plane)),
        ("one plane", moved(&plane, &grid)),
        ("one plane", moved(&tilted(&plane), &grid)),
        (
            "1e300",
            draw(50, 5, |s| direction(s).map(|v| 1e300 * v.signum())),
        ),
        ("beyond", draw(50, 6, |s| direction(s).map(|v| 1e15 * v))),
    ]
}

#[test]
fn clouds_without_a_pose_are_refused_by_name_and_shape() {
    let good = Scene::Field.survey(1000, 0.03, 1);
    for (words, bad) in clouds_without_a_pose() {
        for mode in [Mode::Robust, Mode::Paper] {
            let config = Config {
                mode,
                ..Config::default()
            };
            for (who, outcome) in [
                ("source cloud", run(&bad, &good, &config)),
                ("target cloud", run(&good, &bad, &config)),
            ] {
                let error = outcome.unwrap_err();
                let told = error.to_string();
                assert!(
                    told.contains(words) && told.contains(who),
                    "{words}: {told}"
                );
                assert!(matches!(
                    error,
                    Error::TooFewPoints { .. }
                        | Error::Degenerate { .. }
                        | Error::CoordinateTooLarge { .. }
                ));
            }
        }
    }
}

#[test]
fn stages_that_need_no_pose_take_any_shape_but_an_empty_one() {
    let silent = Progress::silent();
    let good = Scene::Field.survey(500, 0.03, 2);
    let still = Rigid::identity();
    for (words, bad) in clouds_without_a_pose() {
        let lie = evaluate(&bad, &good, still, &silent);
        let fused = fuse_clouds(&bad, &good, still, &FuseOptions::default(), &silent);
        if ["0 usable points", "1e300", "beyond"].contains(&words) {
            assert!(lie.is_err() && fused.is_err(), "{words}");
            assert!(lie.unwrap_err().to_string().contains("source cloud"));
        } else {
            let n_finite = bad.iter().filter(|p| p[1].is_finite()).count();
            let lie = lie.unwrap();
            assert_eq!(lie.source_to_target_m.len(), n_finite, "{words}");
            assert!(lie.source_to_target_m.iter().all(|d| d.is_finite()));
            assert_eq!(fused.unwrap().points.len(), n_finite + good.len());
        }
    }
}

#[test]
fn points_that_all_stand_alone_leave_too_few() {
    let field = Scene::Field.survey(1000, 0.03, 3);
    let mut config = Config::default();
    config.outliers.radius_m = Some(1e-6);
    let told = run(&field, &field, &config).unwrap_err().to_string();
    assert!(
        told.contains("source cloud, after outlier removal, has 0"),
        "{told}"
    );
}

#[test]
fn voxels_that_make_no_grid_are_refused() {
    let field = Scene::Field.survey(1000, 0.03, 4);
    let with = |voxel_size_m| {
        let mut config = Config::default();
        config.voxel.voxel_size_m = Some(voxel_size_m);
        run(&field, &field, &config).unwrap_err()
    };
    for voxel_size_m in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        let error = with(voxel_size_m);
        assert!(
            matches!(&error, Error::InvalidArgument { name, .. } if name.contains("voxel_size_m")),
            "{error}"
        );
    }
    let Error::VoxelTooSmall {
        voxel_size_m,
        smallest_m,
        ..
    } = with(1e-9)
    else {
        panic!("another error");
    };
    assert_eq!(voxel_size_m, 1e-9);
    assert!(smallest_m > 1e-5 && smallest_m < 1e-3);
}

#[test]
fn a_voxel_larger_than_a_cloud_is_refused_by_name() {
    let field = Scene::Field.survey(1000, 0.03, 4);
    let small: Vec<Point> = field.iter().map(|p| p.map(|v| 0.1 * v)).collect();
    let mut config = Config::default();
    config.voxel.voxel_size_m = Some(40.0);
    for mode in [Mode::Robust, Mode::Paper] {
        config.mode = mode;
        for (source, target) in [(&small, &field), (&field, &small)] {
            let error = run(source, target, &config).unwrap_err();
            assert!(
                matches!(&error, Error::InvalidArgument { name, problem }
                    if name == "voxel.voxel_size_m" && problem.contains("extent")),
                "{error}"
            );
        }
    }
}

#[test]
fn a_few_voxels_over_all_are_no_cloud() {
    let field = Scene::Field.survey(1000, 0.03, 4);
    let mut config = Config::default();
    config.voxel.voxel_size_m = Some(90.0);
    for mode in [Mode::Robust, Mode::Paper] {
        config.mode = mode;
        match run(&field, &field, &config) {
            Ok(found) => assert_ne!(found.verdict, Verdict::Accepted),
            Err(error) => assert!(
                error.to_string().contains("voxel") || matches!(error, Error::NoSolution { .. }),
                "{error}"
            ),
        }
    }
}

/// Every key that has a range, and a value outside it.
const OUT_OF_RANGE: [(&str, &str); 32] = [
    ("n_threads", r#"{"n_threads": 0}"#),
    ("outliers.radius_m", r#"{"outliers": {"radius_m": 0}}"#),
    ("outliers.radius_m", r#"{"outliers": {"radius_m": -1}}"#),
    ("voxel.voxel_size_m", r#"{"voxel": {"voxel_size_m": 0}}"#),
    ("voxel.voxel_size_m", r#"{"voxel": {"voxel_size_m": -0.1}}"#),
    ("keypoints.radius_m", r#"{"keypoints": {"radius_m": -1}}"#),
    (
        "keypoints.non_max_radius_m",
        r#"{"keypoints": {"non_max_radius_m": 0}}"#,
    ),
    (
        "keypoints.max_ratio_second_to_first",
        r#"{"keypoints": {"max_ratio_second_to_first": 0}}"#,
    ),
    (
        "keypoints.max_ratio_third_to_second",
        r#"{"keypoints": {"max_ratio_third_to_second": -1}}"#,
    ),
    (
        "coarse.rotations_per_round",
        r#"{"coarse": {"rotations_per_round": []}}"#,
    ),
    (
        "coarse.rotations_per_round",
        r#"{"coarse": {"rotations_per_round": [10, 0]}}"#,
    ),
    ("coarse.n_verified", r#"{"coarse": {"n_verified": 0}}"#),
    (
        "paper.hawks.n_hawks",
        r#"{"paper": {"hawks": {"n_hawks": 0}}}"#,
    ),
    (
        "paper.hawks.n_iterations",
        r#"{"paper": {"hawks": {"n_iterations": 0}}}"#,
    ),
    (
        "paper.hawks.max_evaluations",
        r#"{"paper": {"hawks": {"max_evaluations": 0}}}"#,
    ),
    (
        "paper.hawks.levy_factor",
        r#"{"paper": {"hawks": {"levy_factor": -1}}}"#,
    ),
    (
        "paper.hawks.mutation_variance",
        r#"{"paper": {"hawks": {"mutation_variance": -0.1}}}"#,
    ),
    ("icp.max_distance_m", r#"{"icp": {"max_distance_m": 0}}"#),
    ("icp.kept_share", r#"{"icp": {"kept_share": 0}}"#),
    ("icp.kept_share", r#"{"icp": {"kept_share": 1.5}}"#),
    ("icp.max_iterations", r#"{"icp": {"max_iterations": 0}}"#),
    (
        "icp.relative_tolerance",
        r#"{"icp": {"relative_tolerance": -1e-6}}"#,
    ),
    (
        "icp.relative_tolerance",
        r#"{"icp": {"relative_tolerance": 2}}"#,
    ),
    (
        "verdict.accept_inlier_share",
        r#"{"verdict": {"accept_inlier_share": 1.1}}"#,
    ),
    (
        "verdict.accept_inlier_share",
        r#"{"verdict": {"accept_inlier_share": -0.1}}"#,
    ),
    (
        "verdict.reject_inlier_share",
        r#"{"verdict": {"reject_inlier_share": 0.9}}"#,
    ),
    (
        "verdict.accept_strength",
        r#"{"verdict": {"accept_strength": 2}}"#,
    ),
    (
        "verdict.accept_ambiguity_ratio",
        r#"{"verdict": {"accept_ambiguity_ratio": 0.9}}"#,
    ),
    (
        "verdict.reject_ambiguity_ratio",
        r#"{"verdict": {"reject_ambiguity_ratio": 9}}"#,
    ),
    (
        "verdict.accept_share_times_ratio",
        r#"{"verdict": {"accept_share_times_ratio": -1}}"#,
    ),
    ("fuse.hole_radius_m", r#"{"fuse": {"hole_radius_m": 0}}"#),
    ("fuse.hole_radius_m", r#"{"fuse": {"hole_radius_m": -2}}"#),
];

/// Whether the setting is refused by `key`, and the words.
fn refused_by(json: &str, key: &str) -> (bool, String) {
    let tetrahedron = [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    let config = Config::from_json(json).unwrap();
    match run(&tetrahedron, &tetrahedron, &config) {
        Err(Error::InvalidArgument { name, problem }) => {
            (name.contains(key), format!("{json}: {name} {problem}"))
        }
        Err(error) => (false, format!("{json}: {error}")),
        Ok(_) => (false, format!("{json}: not refused")),
    }
}

#[test]
fn settings_out_of_range_are_refused_by_their_whole_path_before_anything_runs() {
    let unnamed: Vec<String> = OUT_OF_RANGE
        .iter()
        .map(|(key, json)| refused_by(json, key))
        .filter(|(named, _)| !named)
        .map(|(_, told)| told)
        .collect();
    assert!(unnamed.is_empty(), "{}", unnamed.join("\n"));
}

#[test]
fn numbers_that_are_none_are_refused_wherever_a_number_is_asked_for() {
    type Spoil = fn(&mut Config, f64);
    let spoil: [(&str, Spoil); 15] = [
        ("radius_m", |c, v| c.outliers.radius_m = Some(v)),
        ("voxel_size_m", |c, v| c.voxel.voxel_size_m = Some(v)),
        ("radius_m", |c, v| c.keypoints.radius_m = Some(v)),
        ("non_max_radius_m", |c, v| {
            c.keypoints.non_max_radius_m = Some(v)
        }),
        ("levy_factor", |c, v| c.paper.hawks.levy_factor = v),
        ("mutation_variance", |c, v| {
            c.paper.hawks.mutation_variance = v
        }),
        ("max_distance_m", |c, v| c.icp.max_distance_m = Some(v)),
        ("kept_share", |c, v| c.icp.kept_share = Some(v)),
        ("relative_tolerance", |c, v| c.icp.relative_tolerance = v),
        ("accept_inlier_share", |c, v| {
            c.verdict.accept_inlier_share = v
        }),
        ("accept_ambiguity_ratio", |c, v| {
            c.verdict.accept_ambiguity_ratio = v
        }),
        ("reject_ambiguity_ratio", |c, v| {
            c.verdict.reject_ambiguity_ratio = v
        }),
        ("accept_strength", |c, v| c.verdict.accept_strength = v),
        ("reject_inlier_share", |c, v| {
            c.verdict.reject_inlier_share = v
        }),
        ("hole_radius_m", |c, v| c.fuse.hole_radius_m = Some(v)),
    ];
    for (name, spoil) in spoil {
        for value in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            let mut config = Config::default();
            spoil(&mut config, value);
            let told = config.check().unwrap_err().to_string();
            assert!(told.contains(name), "{name} = {value}: {told}");
        }
    }
}

#[test]
fn a_misspelt_key_is_refused_at_every_level() {
    for json in [
        r#"{"misspelt": 1}"#,
        r#"{"outliers": {"misspelt": 1}}"#,
        r#"{"voxel": {"misspelt": 1}}"#,
        r#"{"keypoints": {"misspelt": 1}}"#,
        r#"{"coarse": {"misspelt": 1}}"#,
        r#"{"paper": {"misspelt": 1}}"#,
        r#"{"paper": {"hawks": {"misspelt": 1}}}"#,
        r#"{"icp": {"misspelt": 1}}"#,
        r#"{"verdict": {"misspelt": 1}}"#,
        r#"{"fuse": {"misspelt": 1}}"#,
    ] {
        let told = Config::from_json(json).unwrap_err().to_string();
        assert!(told.contains("misspelt"), "{json}: {told}");
    }
    for (json, words) in [
        (r#"{"mode": "fast"}"#, "fast"),
        (r#"{"paper": {"search_box": "wide"}}"#, "wide"),
        (r#"{"icp": {"method": "point_to_line"}}"#, "point_to_line"),
        (r#"{"seed": -1}"#, "-1"),
        (r#"{"coarse": {"n_verified": 1.5}}"#, "1.5"),
        (r#"{"voxel": {"voxel_size_m": "0.1"}}"#, "0.1"),
        (r#"{"mode": "#, "configuration"),
        ("", "configuration"),
    ] {
        let told = Config::from_json(json).unwrap_err().to_string();
        assert!(told.contains(words), "{json}: {told}");
    }
}

fn assert_not_accepted(what: &str, source: &[Point], target: &[Point]) {
    match run(source, target, &Config::default()) {
        Ok(found) => {
            assert_ne!(
                found.verdict,
                Verdict::Accepted,
                "{what}: share {}, ratio {}, {:?}",
                found.inlier_share,
                found.ambiguity_ratio,
                found.reasons
            );
            assert!(!found.reasons.is_empty());
        }
        Err(error) => assert!(matches!(error, Error::NoSolution { .. }), "{what}: {error}"),
    }
}

#[test]
fn clouds_of_different_places_are_not_accepted() {
    let field = Scene::Field.survey(4000, 0.03, 11);
    let noise = draw(4000, 12, |s| [0; 3].map(|_| 20.0 * s.normal()));
    let elsewhere = draw(4000, 13, |s| {
        let (x, y) = (SIDE_M * s.uniform(), SIDE_M * s.uniform());
        let rolling = 4.0 * (0.08 * x + 2.0).sin() * (0.06 * y + 1.0).sin();
        [x, y, rolling + 3.0 * (0.13 * x + 0.19 * y).cos()]
    });
    let away = any_pose(14);
    assert_not_accepted("noise on a field", &moved(&noise, &away), &field);
    assert_not_accepted("two fields", &moved(&elsewhere, &away), &field);
    let halves = Pair::new(Scene::Field, 8000, 16).cut(0.48, 0.52);
    assert_not_accepted("two halves of a field", &halves.source, &halves.target);
}

#[test]
fn shapes_that_fit_in_many_ways_are_not_accepted() {
    let noisy = |s: &mut Stream, p: Point| p.map(|v| v + 0.03 * s.normal());
    let sphere = |survey| {
        draw(4000, survey, |s| {
            let d = direction(s);
            noisy(s, d.map(|v| 30.0 * v))
        })
    };
    let cube = |survey| {
        draw(4000, survey, |s| {
            let mut p = [0; 3].map(|_| 50.0 * s.uniform());
            p[s.below(3)] = [0.0, 50.0][s.below(2)];
            noisy(s, p)
        })
    };
    let floor = |survey, begin: f64| {
        draw(4000, survey, |s| {
            let p = [begin + 100.0 * s.uniform(), 60.0 * s.uniform(), 0.0];
            noisy(s, p)
        })
    };
    for (what, source, target) in [
        ("spheres", sphere(21), sphere(22)),
        ("cubes", cube(23), cube(24)),
        ("floors", floor(25, 0.0), floor(26, 40.0)),
    ] {
        assert_not_accepted(what, &moved(&source, &any_pose(27)), &target);
    }
}

fn assert_mirror_image_not_accepted(scene: Scene, seed: u64) {
    let mut mirrored = scene.survey(5000, 0.03, seed + 900);
    mirrored.iter_mut().for_each(|p| p[0] = -p[0]);
    let (source, target) = (
        moved(&mirrored, &any_pose(seed)),
        scene.survey(5000, 0.03, seed),
    );
    assert_not_accepted(&format!("{scene:?} {seed}"), &source, &target);
}

#[test]
fn a_mirrored_site_is_not_accepted() {
    assert_mirror_image_not_accepted(Scene::Field, 0);
    assert_mirror_image_not_accepted(Scene::Yard, 0);
}

/// Half of the body is nearly its own mirror image, as with animals and statues.
#[test]
fn a_mirrored_body_is_not_accepted() {
    (0..4).for_each(|seed| assert_mirror_image_not_accepted(Scene::Body, seed));
}

/// What may be refused but must neither panic nor be off by a digit where it is not.
fn assert_safe(what: &str, pair: &Pair) -> Option<Registration> {
    match run(&pair.source, &pair.target, &Config::default()) {
        Ok(found) => {
            let off_m = pair.error_m(found.target_from_source);
            assert!(
                found.verdict != Verdict::Accepted || off_m < found.voxel_size_m,
                "{what}: accepted and off by {off_m}, voxel {}",
                found.voxel_size_m
            );
            Some(found)
        }
        Err(error) => {
            let named = ["source cloud", "target cloud", "voxel", "pose"];
            let told = error.to_string();
            assert!(
                named.iter().any(|name| told.contains(name)),
                "{what}: {told}"
            );
            None
        }
    }
}

#[test]
fn no_unit_is_so_small_or_large_that_it_panics() {
    let pair = Pair::new(Scene::Field, 3000, 31);
    for exponent in [-300, -170, -150, -60, -20, -6, 6, 9] {
        let factor = 10_f64.powi(exponent);
        let pose = pair.target_from_source;
        let tiny = Pair {
            source: scaled(&pair.source, factor),
            target: scaled(&pair.target, factor),
            target_from_source: Rigid {
                translation: pose.translation * factor,
                ..pose
            },
        };
        let found = assert_safe(&format!("1e{exponent}"), &tiny);
        // Squares of squares leave the range of numbers at 1e±77.
        assert!(found.is_some() || exponent < -50, "1e{exponent} is refused");
    }
}

#[test]
fn duplicates_change_nothing() {
    let mut pair = Pair::new(Scene::Field, 3000, 41);
    pair.source.extend(pair.source.clone());
    pair.target.extend(pair.target.clone());
    let found = assert_safe("every point twice", &pair).unwrap();
    assert_eq!(found.verdict, Verdict::Accepted, "{:?}", found.reasons);
    // One place takes half of all points.
    let pile = pair.source[0];
    pair.source.extend(vec![pile; pair.source.len()]);
    let found = assert_safe("half of all points in one place", &pair).unwrap();
    assert_eq!(found.verdict, Verdict::Accepted, "{:?}", found.reasons);
}

#[test]
fn a_stray_point_changes_nothing() {
    let field = Pair::new(Scene::Field, 4000, 51);
    for far_m in [1e4, 1e7] {
        let mut pair = field.clone();
        pair.target.push([far_m, -far_m, far_m]);
        pair.source.push([-far_m, far_m, far_m]);
        let found = run(&pair.source, &pair.target, &Config::default()).unwrap();
        assert!(field.error_m(found.target_from_source) < found.voxel_size_m);
        assert_eq!(found.verdict, Verdict::Accepted, "{:?}", found.reasons);
        assert!(found.voxel_size_m < 1.0, "{}", found.voxel_size_m);
    }
}

#[test]
fn a_stray_point_at_the_end_of_the_world_changes_nothing() {
    let mut pair = Pair::new(Scene::Field, 4000, 51);
    pair.target.push([1e9, -1e9, 1e9]);
    let found = assert_safe("a stray at 1e9", &pair).expect("is refused");
    assert_eq!(found.verdict, Verdict::Accepted, "{:?}", found.reasons);
}

#[test]
fn strays_that_keep_each_other_company_do_no_harm() {
    let mut pair = Pair::new(Scene::Field, 4000, 52);
    pair.target.extend(vec![[1e7, -1e7, 1e7]; 9]);
    assert_safe("a heap at 1e7", &pair);
}

#[test]
fn few_points_are_enough_or_said_to_be_too_few() {
    for n in 4..40 {
        let pair = Pair::of(
            &draw(n, n as u64, direction),
            draw(n, n as u64, direction),
            any_pose(n as u64),
        );
        assert_safe(&format!("{n} points"), &pair);
    }
}
