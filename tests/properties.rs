//! What must not matter to a pose does not: units, the place on Earth, the order of points, the
//! pose that the files had, which cloud is moved, points that are there twice.

#![allow(clippy::unwrap_used)]

mod common;

use common::{Pair, SIDE_M, Scene, any_pose, farthest_m, moved, scaled};
use proptest::prelude::*;
use tmchho::config::Config;
use tmchho::random::Stream;
use tmchho::{Point, Registration, Rigid};

const N_POINTS: usize = 3000;

fn scenes() -> impl Strategy<Value = Pair> {
    (
        prop_oneof![Just(Scene::Field), Just(Scene::Body), Just(Scene::Yard)],
        0..1000_u64,
    )
        .prop_map(|(scene, seed)| Pair::new(scene, N_POINTS, seed))
}

fn found(pair: &Pair) -> Registration {
    pair.register(&Config::default())
}

/// Registers both clouds in other coordinates; the truth goes with them.
fn found_at(pair: &Pair, source: &Rigid, target: &Rigid) -> (Pair, Registration) {
    let pair = Pair {
        source: moved(&pair.source, source),
        target: moved(&pair.target, target),
        target_from_source: *target * pair.target_from_source * source.inverse(),
    };
    let registration = found(&pair);
    (pair, registration)
}

fn shuffled(points: &[Point], seed: u64) -> Vec<Point> {
    let order = Stream::new(seed, "shuffle", 0).sample_indices(points.len(), points.len());
    order.into_iter().map(|i| points[i]).collect()
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 3,
        failure_persistence: None,
        ..ProptestConfig::default()
    })]

    #[test]
    fn another_unit_gives_the_same_pose(pair in scenes()) {
        let metres = found(&pair);
        for factor in [1000.0, 0.001, 1024.0] {
            let pose = pair.target_from_source;
            let other = found(&Pair {
                source: scaled(&pair.source, factor),
                target: scaled(&pair.target, factor),
                target_from_source: Rigid { translation: pose.translation * factor, ..pose },
            });
            prop_assert_eq!(other.verdict, metres.verdict);
            let (a, b) = (metres.target_from_source, other.target_from_source);
            // 1000 is no power of two: every coordinate is rounded anew.
            let turned = (a.rigid.rotation - b.rigid.rotation).amax();
            let shifted = (a.rigid.translation * factor - b.rigid.translation).amax()
                / (a.rigid.translation.amax() * factor);
            prop_assert!(turned < 1e-9 && shifted < 1e-9, "{factor}: {turned} {shifted}");
        }
    }

    #[test]
    fn the_place_on_earth_does_not_matter(pair in scenes()) {
        let here = found(&pair);
        let grid = Rigid::from_euler([0.0; 3], [500_000.0, 4_000_000.0, 250.0]);
        let (there, far) = found_at(&pair, &grid, &grid);
        prop_assert_eq!(far.verdict, here.verdict);
        let expected = grid * here.target_from_source.rigid * grid.inverse();
        let apart_m = farthest_m(&there.source, expected, far.target_from_source);
        prop_assert!(apart_m < 1e-6, "{apart_m}");
    }

    #[test]
    fn the_order_of_points_does_not_matter(pair in scenes(), seed in 0..1000_u64) {
        let before = found(&pair);
        let mixed = Pair {
            source: shuffled(&pair.source, seed),
            target: shuffled(&pair.target, seed + 1),
            ..pair.clone()
        };
        let after = found(&mixed);
        let apart_m =
            farthest_m(&pair.source, after.target_from_source, before.target_from_source);
        prop_assert!(apart_m < 0.5 * before.voxel_size_m, "{apart_m}");
        prop_assert_eq!(after.verdict, before.verdict);
        prop_assert!((after.voxel_size_m - before.voxel_size_m).abs() < 1e-12 * SIDE_M);
    }

    #[test]
    fn a_motion_of_either_cloud_goes_into_the_pose(pair in scenes(), seed in 0..1000_u64) {
        for (source, target) in [
            (any_pose(seed), Rigid::identity()),
            (Rigid::identity(), any_pose(seed)),
        ] {
            let (there, registration) = found_at(&pair, &source, &target);
            let off_m = there.error_m(registration.target_from_source);
            prop_assert!(off_m < 0.5 * registration.voxel_size_m, "{off_m}");
        }
    }

    #[test]
    fn clouds_that_change_places_give_the_inverse(pair in scenes()) {
        let forth = found(&pair);
        let back = found(&Pair {
            source: pair.target.clone(),
            target: pair.source.clone(),
            target_from_source: pair.target_from_source.inverse(),
        });
        let round = back.target_from_source * forth.target_from_source;
        let off_m = farthest_m(&pair.source, round, Rigid::identity());
        prop_assert!(off_m < 0.5 * forth.voxel_size_m, "{off_m}");
        prop_assert_eq!(back.verdict, forth.verdict);
    }

    #[test]
    fn points_that_are_there_again_do_not_matter(pair in scenes(), seed in 0..1000_u64) {
        let once = found(&pair);
        let again = |points: &[Point], n: usize, stream: u64| {
            let which = Stream::new(seed, "again", stream).sample_indices(points.len(), n);
            let copies: Vec<Point> = which.into_iter().map(|i| points[i]).collect();
            [points, &copies[..], &copies[..]].concat()
        };
        for share in [3, 1] {
            let repeated = Pair {
                source: again(&pair.source, pair.source.len() / share, 0),
                target: again(&pair.target, pair.target.len() / share, 1),
                ..pair.clone()
            };
            let more = found(&repeated);
            let apart_m =
                farthest_m(&pair.source, more.target_from_source, once.target_from_source);
            prop_assert!(apart_m < 0.5 * once.voxel_size_m, "{apart_m}");
            prop_assert_eq!(more.verdict, once.verdict);
        }
    }
}
