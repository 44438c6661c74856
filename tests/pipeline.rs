//! The whole route on scenes whose pose is known.

#![allow(clippy::unwrap_used)]

mod common;

use std::ops::ControlFlow;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use common::{Pair, SCENES, SIDE_M, Scene, any_pose, diagonal_m, distance_m, farthest_m, moved};
use tmchho::config::{Config, Mode};
use tmchho::evaluate::{DistanceStatistics, share_within};
use tmchho::fuse::{FuseMode, FuseOptions, Origin};
use tmchho::icp::IcpMethod;
use tmchho::neighbors::NeighborIndex;
use tmchho::pipeline::{evaluate, fuse_clouds, register};
use tmchho::progress::{Event, Progress, Stage};
use tmchho::random::Stream;
use tmchho::similarity::Similarity;
use tmchho::verdict::Verdict;
use tmchho::{Cloud, Error, Point, Registration, Rigid};
use tmchho::{fitness, keypoints, outlier, voxel};

/// No point may end farther from its true place than this share of a voxel (measured: 0.02 to 0.1).
const TOLERANCE_IN_VOXELS: f64 = 0.25;

fn assert_true_pose(what: &str, pair: &Pair, found: &Registration) {
    let error_in_voxels = pair.error_m(found.target_from_source) / found.voxel_size_m;
    assert!(
        error_in_voxels < TOLERANCE_IN_VOXELS,
        "{what}: off by {error_in_voxels} voxels, {:?}",
        found.reasons
    );
    assert_eq!(
        found.verdict,
        Verdict::Accepted,
        "{what}: {:?}",
        found.reasons
    );
}

#[test]
fn the_pose_is_found_wherever_the_source_was() {
    for scene in SCENES {
        for seed in 0..3 {
            let pair = Pair::new(scene, 5000, seed);
            let found = pair.register(&Config::default());
            assert_true_pose(&format!("{scene:?} {seed}"), &pair, &found);
            assert!(found.overlap_of_source > 0.6 && found.overlap_of_target > 0.6);
        }
    }
}

#[test]
fn three_fifths_in_common_are_enough() {
    for (scene, seed, source_below, target_above) in [
        (Scene::Field, 5, 0.67, 0.32),
        (Scene::Field, 6, 0.67, 0.32),
        (Scene::Body, 7, 0.15, -0.15),
    ] {
        let pair = Pair::new(scene, 10_000, seed).cut(source_below, target_above);
        let in_target = |p: &Point| pair.target_from_source.apply(p)[0] > target_above * SIDE_M;
        let n_common = pair.source.iter().filter(|p| in_target(p)).count();
        let common = n_common as f64 / pair.source.len() as f64;
        assert!((0.55..0.65).contains(&common), "{scene:?}: {common}");
        let found = pair.register(&Config::default());
        assert_true_pose(&format!("{scene:?}"), &pair, &found);
        assert!((found.inlier_share - common).abs() < 0.15, "{found:?}");
    }
}

#[test]
fn either_cloud_may_be_the_larger_one() {
    let whole = |n, survey| Scene::Field.survey(n, 0.03, survey);
    let part = |n, survey| -> Vec<Point> {
        let mut points = whole(n, survey);
        points.retain(|p| p[0] > 0.4 * SIDE_M && p[1] > 0.4 * SIDE_M);
        points
    };
    for (what, source, target) in [
        ("large on small", whole(9000, 1), part(9000, 2)),
        ("small on large", part(9000, 3), whole(9000, 4)),
        ("dense on sparse", whole(12_000, 5), whole(4000, 6)),
        ("sparse on dense", whole(4000, 7), whole(12_000, 8)),
    ] {
        let pair = Pair::of(&source, target, any_pose(11));
        let found = pair.register(&Config::default());
        assert_true_pose(what, &pair, &found);
    }
}

#[test]
fn clouds_that_change_places_give_the_pose_back() {
    let pair = Pair::new(Scene::Yard, 5000, 21);
    let forth = pair.register(&Config::default());
    let swapped = Pair {
        source: pair.target.clone(),
        target: pair.source.clone(),
        target_from_source: pair.target_from_source.inverse(),
    };
    let back = swapped.register(&Config::default());
    assert_true_pose("swapped", &swapped, &back);
    let round = back.target_from_source * forth.target_from_source;
    let off_m = farthest_m(&pair.source, round, Rigid::identity());
    assert!(
        off_m < TOLERANCE_IN_VOXELS * forth.voxel_size_m,
        "{off_m} m"
    );
}

#[test]
fn a_cloud_lies_on_itself() {
    for scene in SCENES {
        let points = scene.survey(5000, 0.03, 31);
        let still = Pair::of(&points, points.clone(), Rigid::identity());
        let found = still.register(&Config::default());
        let tolerance_m = 1e-9 * diagonal_m(&points);
        assert!(still.error_m(found.target_from_source) < tolerance_m);
        assert_eq!(found.verdict, Verdict::Accepted, "{:?}", found.reasons);
        assert_eq!((found.fitness, found.overlap_of_source), (1.0, 1.0));
        assert!(found.source_to_target.worst_m < tolerance_m);
        assert!(found.target_to_source.worst_m < tolerance_m);
    }
}

#[test]
fn the_pose_that_the_files_have_is_never_made_worse() {
    // A search with one start finds nothing: what it returns, it owes to the pose as given.
    let blind = {
        let mut config = Config::default();
        config.coarse.rotations_per_round = vec![1];
        config.coarse.n_verified = 1;
        config
    };
    let field = Scene::Field.survey(5000, 0.03, 41);
    let other = Scene::Field.survey(5000, 0.03, 42);
    for (angle_rad, shift_m) in [(0.0, 0.0), (0.004, 0.3), (-0.01, -1.0)] {
        let nearly = Rigid::from_euler([angle_rad; 3], [shift_m; 3]);
        let pair = Pair::of(&field, other.clone(), nearly);
        for config in [&blind, &Config::default()] {
            let found = pair.register(config);
            assert_true_pose(&format!("given off by {shift_m} m"), &pair, &found);
            let within = |pose: Similarity| {
                let lie = evaluate(&pair.source, &pair.target, pose, &Progress::silent()).unwrap();
                share_within(&lie.source_to_target_m, found.max_distance_m)
            };
            let (before, after) = (
                within(Rigid::identity().into()),
                within(found.target_from_source),
            );
            assert!(after > before - 0.002, "{before} {after}");
        }
    }
}

#[test]
fn the_result_is_of_one_piece() {
    let mut pair = Pair::new(Scene::Field, 5000, 51);
    pair.source.insert(7, [f64::NAN, 0.0, 0.0]);
    pair.target.push([0.0, f64::INFINITY, 0.0]);
    pair.target.push([f64::NAN; 3]);
    let found = pair.register(&Config::default());
    pair.source.remove(7);
    assert_true_pose("with points that are none", &pair, &found);
    assert_eq!(found.n_non_finite, (1, 2));

    // One pose, two ways of writing it.
    let p = pair.source[100];
    let about: Point = std::array::from_fn(|i| p[i] - found.source_pivot[i]);
    let moved = found.about_pivots.apply(&about);
    let q: Point = std::array::from_fn(|i| moved[i] + found.target_pivot[i]);
    assert!(distance_m(&q, &found.target_from_source.apply(&p)) < 1e-9 * SIDE_M);

    // The distances are those of the stage alone.
    let lie = evaluate(
        &pair.source,
        &pair.target,
        found.target_from_source,
        &Progress::silent(),
    )
    .unwrap();
    for (distances_m, statistics, overlap) in [
        (
            &lie.source_to_target_m,
            &found.source_to_target,
            found.overlap_of_source,
        ),
        (
            &lie.target_to_source_m,
            &found.target_to_source,
            found.overlap_of_target,
        ),
    ] {
        let alone = DistanceStatistics::from_distances(distances_m).unwrap();
        assert_eq!(alone.n_points, statistics.n_points);
        assert!((alone.rms_m - statistics.rms_m).abs() < 1e-9);
        assert!((alone.worst_m - statistics.worst_m).abs() < 1e-9);
        assert!((share_within(distances_m, found.max_distance_m) - overlap).abs() < 1e-3);
    }

    // The best candidate is the pose before its last refinement.
    assert!(
        found
            .candidates
            .windows(2)
            .all(|pair| pair[0].1 >= pair[1].1)
    );
    let (best, score) = found.candidates[0];
    assert!(pair.error_m(best) < 2.0 * found.voxel_size_m);
    // A pose at rest may score a trifle less than the best that was ever seen.
    let last = *found.history.last().unwrap();
    assert!(last >= score && last < 1.05 * score, "{last} {score}");
    assert!(found.history.is_sorted());
    assert!(found.inlier_rmse_m <= found.max_distance_m);
    assert!(found.n_icp_iterations == found.icp_history.len() && found.n_evaluations > 1000);
}

/// Voxels wide enough that few keypoints are left, hawks few enough that a second is enough.
fn quick_paper() -> Config {
    let mut config = Config {
        mode: Mode::Paper,
        ..Config::default()
    };
    config.voxel.voxel_size_m = Some(3.0);
    config.paper.hawks.n_hawks = 12;
    config.paper.hawks.n_iterations = 25;
    config
}

/// What goes into the paper's search, stage by stage, in the coordinates given.
fn keypoints_of(points: &[Point], config: &Config) -> (usize, usize, Vec<Point>) {
    let silent = Progress::silent();
    let cloud = Cloud::new(points).unwrap();
    let index = NeighborIndex::new(cloud.points());
    let cleaned = outlier::remove_outliers(&cloud, &index, &config.outliers, &silent).unwrap();
    let edge_m = config.voxel.voxel_size_m.unwrap();
    let voxels = voxel::downsample(&cleaned.cloud, edge_m, &silent)
        .unwrap()
        .cloud;
    let index = NeighborIndex::new(voxels.points());
    let radius_m = keypoints::RADIUS_IN_VOXELS * edge_m;
    let found = keypoints::detect(&voxels, &index, &config.keypoints, radius_m, &silent).unwrap();
    let given = voxels.to_given_coordinates();
    let chosen = found.indices.iter().map(|i| given[*i as usize]).collect();
    (cleaned.cloud.len(), voxels.len(), chosen)
}

#[test]
fn paper_mode_runs_end_to_end_and_never_accepts_itself() {
    for (scene, given_near) in [(Scene::Field, false), (Scene::Yard, true)] {
        let mut pair = Pair::new(scene, 6000, 61);
        if given_near {
            // Even with its own copy in place: another pose may fit as well, nobody has looked.
            pair = Pair::of(&pair.target, pair.target.clone(), Rigid::identity());
        }
        let config = quick_paper();
        let found = pair.register(&config);
        assert_ne!(found.verdict, Verdict::Accepted);
        assert!(found.ambiguity_ratio.is_nan());
        assert!(found.reasons.iter().any(|why| why.contains("paper mode")));
        assert_eq!(found.history.len(), 25);
        assert!(found.history.windows(2).all(|pair| pair[1] <= pair[0]));

        // The stages alone lead to the same numbers.
        let (n_cleaned, n_voxels, source) = keypoints_of(&pair.source, &config);
        let (_, _, target) = keypoints_of(&pair.target, &config);
        let counts: Vec<(usize, usize)> = found.stages[..3].iter().map(|s| s.n_source).collect();
        assert_eq!(
            counts,
            [
                (6000, n_cleaned),
                (n_cleaned, n_voxels),
                (n_voxels, source.len())
            ]
        );
        let (pose, score) = found.candidates[0];
        let rms = fitness::rms(&source, &NeighborIndex::new(&target), &pose.rigid);
        assert!((rms + score).abs() < 1e-6 * rms, "{rms} {score}");
        assert_eq!(found.history.last(), Some(&-score));

        // Point-to-point with all pairs: no iteration makes the distances larger.
        assert_eq!(found.config.icp.method, Some(IcpMethod::PointToPoint));
        assert_eq!(found.config.icp.max_distance_m, None);
        assert!(
            found
                .icp_history
                .windows(2)
                .all(|pair| pair[1] <= pair[0] * (1.0 + 1e-12))
        );
    }
}

#[test]
fn stages_are_recorded_in_order_and_their_counts_add_up() {
    use Stage::{Coarse, Evaluate, Icp, Keypoints, Outliers, Verdict, Voxel};
    let pair = Pair::new(Scene::Field, 5000, 71).cut(0.8, 0.0);
    let robust = [Outliers, Voxel, Coarse, Icp, Verdict, Evaluate];
    let paper = [Outliers, Voxel, Keypoints, Coarse, Icp, Verdict, Evaluate];
    for (config, wanted) in [
        (Config::default(), &robust[..]),
        (quick_paper(), &paper[..]),
    ] {
        let found = pair.register(&config);
        let stages: Vec<Stage> = found.stages.iter().map(|record| record.stage).collect();
        assert_eq!(stages, wanted);
        let (mut n_source, mut n_target) = (pair.source.len(), pair.target.len());
        let given = (n_source, n_target);
        let mut voxels = given;
        for record in &found.stages {
            // ICP goes back to the voxels, the distances to all points.
            match record.stage {
                Icp => (n_source, n_target) = voxels,
                Evaluate => (n_source, n_target) = given,
                _ => {}
            }
            assert_eq!((record.n_source.0, record.n_target.0), (n_source, n_target));
            (n_source, n_target) = (record.n_source.1, record.n_target.1);
            if record.stage == Voxel {
                voxels = (n_source, n_target);
            }
        }
        for record in &found.stages {
            assert!(record.n_source.1 <= record.n_source.0 && record.n_source.1 > 0);
            assert!(record.n_target.1 <= record.n_target.0 && record.n_target.1 > 0);
            assert!(record.seconds >= 0.0);
        }
    }
}

#[test]
fn the_resolved_configuration_leads_to_the_same_pose_again() {
    let pair = Pair::new(Scene::Body, 5000, 81);
    for config in [Config::default(), quick_paper()] {
        let first = pair.register(&config);
        let resolved = &first.config;
        assert_eq!(resolved.voxel.voxel_size_m, Some(first.voxel_size_m));
        assert!(resolved.icp.method.is_some());
        assert_ne!(resolved, &config);
        let saved = Config::from_json(&resolved.to_json()).unwrap();
        assert_eq!(&saved, resolved, "what was saved is what was used");
        let again = pair.register(&saved);
        assert_eq!(again.config, first.config);
        assert_eq!(again.target_from_source, first.target_from_source);
        assert_eq!(again.max_distance_m, first.max_distance_m);
    }
}

#[test]
fn no_digit_of_a_configuration_is_lost_in_json() {
    let mut stream = Stream::new(1, "json", 0);
    for _ in 0..2000 {
        let mut config = Config {
            seed: stream.bits(),
            n_threads: Some(3),
            ..Config::default()
        };
        let mut positive = || 10_f64.powf(stream.uniform_between(-6.0, 6.0));
        config.voxel.voxel_size_m = Some(positive());
        config.icp.max_distance_m = Some(positive());
        config.keypoints.radius_m = Some(positive());
        config.fuse.hole_radius_m = Some(positive());
        config.outliers.radius_m = Some(positive());
        assert_eq!(Config::from_json(&config.to_json()).unwrap(), config);
    }
}

#[test]
fn events_come_in_the_order_of_the_route() {
    let pair = Pair::new(Scene::Field, 4000, 91);
    for config in [Config::default(), quick_paper()] {
        let heard = Mutex::new(Vec::new());
        let listener = |event: &Event| {
            heard.lock().unwrap().push(event.clone());
            ControlFlow::Continue(())
        };
        let progress = Progress::new(&listener);
        let found = register(&pair.source, &pair.target, &config, &progress).unwrap();
        let heard = heard.into_inner().unwrap();

        let started: Vec<Stage> = heard
            .iter()
            .filter_map(|event| match event {
                Event::Started { stage } => Some(*stage),
                _ => None,
            })
            .collect();
        let recorded: Vec<Stage> = found.stages.iter().map(|record| record.stage).collect();
        assert_eq!(started, recorded);

        // Whoever advances has started and not yet been followed; steps count up to their total.
        let (mut now, mut last_done) = (None, 0);
        let mut scores = Vec::new();
        for event in &heard {
            match event {
                Event::Started { stage } => (now, last_done) = (Some(*stage), 0),
                Event::Advanced {
                    stage,
                    done,
                    total,
                    best,
                } => {
                    assert_eq!(Some(*stage), now);
                    assert!(done <= total, "{done} of {total}");
                    assert!(*done == last_done + 1 || *done == 1, "{last_done} {done}");
                    last_done = *done;
                    if *stage == Stage::Coarse {
                        scores.push(best.unwrap());
                    }
                }
                _ => {}
            }
        }
        assert!(scores.iter().all(|score| found.history.contains(score)));
        let rising = scores.is_sorted();
        let falling = scores.iter().rev().is_sorted();
        assert!(
            scores.len() >= 10
                && if config.mode == Mode::Paper {
                    falling
                } else {
                    rising
                }
        );
        assert!(heard.contains(&Event::Tick));
    }
}

/// A moment at which a caller may want to stop.
type Moment = fn(&Event) -> bool;

const MOMENTS: [(&str, Moment); 6] = [
    ("at once", |_| true),
    ("voxel", |event| {
        *event
            == Event::Started {
                stage: Stage::Voxel,
            }
    }),
    ("coarse", |event| {
        *event
            == Event::Started {
                stage: Stage::Coarse,
            }
    }),
    ("in the middle of coarse", |event| {
        matches!(
            event,
            Event::Advanced {
                stage: Stage::Coarse,
                done: 3,
                ..
            }
        )
    }),
    ("in the middle of icp", |event| {
        matches!(
            event,
            Event::Advanced {
                stage: Stage::Icp,
                done: 1,
                ..
            }
        )
    }),
    ("evaluate", |event| {
        *event
            == Event::Started {
                stage: Stage::Evaluate,
            }
    }),
];

/// Stops at a moment, for good or only once; tells the outcome and what else was begun after it.
fn stop_at(
    pair: &Pair,
    config: &Config,
    is_moment: impl Fn(usize, &Event) -> bool + Sync,
    for_good: bool,
) -> (tmchho::Result<Registration>, Vec<Event>) {
    let (n_heard, stopped) = (AtomicUsize::new(0), AtomicBool::new(false));
    let news_after = Mutex::new(Vec::new());
    let listener = |event: &Event| {
        // Others that run at the same time may still ask whether to go on: that is no news.
        if stopped.load(Ordering::SeqCst) && *event != Event::Tick {
            news_after.lock().unwrap().push(event.clone());
        }
        let is_now = is_moment(n_heard.fetch_add(1, Ordering::SeqCst), event);
        let before = stopped.fetch_or(is_now, Ordering::SeqCst);
        if (is_now && !before) || (before && for_good) {
            ControlFlow::Break(())
        } else {
            ControlFlow::Continue(())
        }
    };
    let progress = Progress::new(&listener);
    let outcome = register(&pair.source, &pair.target, config, &progress);
    assert!(stopped.into_inner(), "the moment came");
    (outcome, news_after.into_inner().unwrap())
}

#[test]
fn whoever_says_stop_is_obeyed_at_once() {
    let pair = Pair::new(Scene::Field, 4000, 101);
    for config in [Config::default(), quick_paper()] {
        for (when, is_moment) in MOMENTS {
            let (outcome, news) = stop_at(&pair, &config, |_, event| is_moment(event), true);
            assert_eq!(outcome.err(), Some(Error::Cancelled), "{when}");
            assert_eq!(news, [], "{when}");
        }
        for nth in [1, 2, 5, 10, 20, 40] {
            let (outcome, news) = stop_at(&pair, &config, |n, _| n == nth, true);
            assert_eq!(outcome.err(), Some(Error::Cancelled), "event {nth}");
            assert_eq!(news, [], "event {nth}");
        }
    }
}

#[test]
fn saying_stop_once_is_enough() {
    let pair = Pair::new(Scene::Field, 4000, 111);
    for config in [Config::default(), quick_paper()] {
        for (when, is_moment) in MOMENTS {
            let once = |_, event: &Event| is_moment(event);
            let (outcome, _) = stop_at(&pair, &config, once, false);
            let mode = config.mode;
            assert_eq!(outcome.err(), Some(Error::Cancelled), "{mode:?} {when}");
        }
    }
}

#[test]
fn the_stages_after_the_route_stop_too() {
    let pair = Pair::new(Scene::Field, 4000, 121);
    let stop = |_: &Event| ControlFlow::Break(());
    let (pose, progress) = (&pair.target_from_source, Progress::new(&stop));
    let measured = evaluate(&pair.source, &pair.target, pose, &progress);
    assert_eq!(measured.err(), Some(Error::Cancelled));
    let options = FuseOptions::default();
    let fused = fuse_clouds(&pair.source, &pair.target, pose, &options, &progress);
    assert_eq!(fused.err(), Some(Error::Cancelled));
}

#[test]
fn fused_clouds_carry_the_distances_that_were_evaluated() {
    let pair = Pair::new(Scene::Field, 6000, 131).cut(0.7, 0.3);
    let (pose, silent) = (&pair.target_from_source, Progress::silent());
    let lie = evaluate(&pair.source, &pair.target, pose, &silent).unwrap();
    let distances_m = |origin| match origin {
        Origin::Source => &lie.source_to_target_m,
        Origin::Target => &lie.target_to_source_m,
    };
    let moved_source = moved(&pair.source, pose);
    for mode in [FuseMode::Merge, FuseMode::Dedup, FuseMode::FillHoles] {
        let options = FuseOptions {
            mode,
            ..FuseOptions::default()
        };
        let fused = fuse_clouds(&pair.source, &pair.target, pose, &options, &silent).unwrap();
        for (i, p) in fused.points.iter().enumerate() {
            let (origin, index) = (fused.origin[i], fused.given_index[i] as usize);
            assert!((fused.distance_m[i] - distances_m(origin)[index]).abs() < 1e-9);
            assert_eq!(
                fused.fills_hole[i],
                fused.distance_m[i] > fused.hole_radius_m
            );
            let given = match origin {
                Origin::Source => &moved_source[index],
                Origin::Target => &pair.target[index],
            };
            assert!(distance_m(p, given) < 1e-9 * SIDE_M);
        }
        let beyond = |distances_m: &[f64]| {
            let filling = distances_m.iter().filter(|d| **d > fused.hole_radius_m);
            filling.count()
        };
        assert_eq!(fused.n_filled_by_source, beyond(&lie.source_to_target_m));
        assert_eq!(fused.n_filled_by_target, beyond(&lie.target_to_source_m));
        let n_from_source = match mode {
            FuseMode::Merge => pair.source.len(),
            FuseMode::FillHoles => fused.n_filled_by_source,
            FuseMode::Dedup => pair.source.len() - fused.n_repeated,
        };
        assert_eq!(fused.points.len(), pair.target.len() + n_from_source);
        // The source alone saw a third of the place.
        assert!(fused.n_filled_by_source > pair.source.len() / 5);
    }
}
