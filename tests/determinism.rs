//! The same input gives the same bits, at any number of threads.

#![allow(clippy::unwrap_used)]

mod common;

use common::{Pair, Scene, farthest_m};
use rayon::ThreadPoolBuilder;
use tmchho::config::{Config, Mode};
use tmchho::fuse::{FuseOptions, FusedCloud};
use tmchho::pipeline::fuse_clouds;
use tmchho::progress::Progress;
use tmchho::{Registration, Rigid};

fn paper() -> Config {
    let mut config = Config {
        mode: Mode::Paper,
        ..Config::default()
    };
    config.voxel.voxel_size_m = Some(3.0);
    config.paper.hawks.n_iterations = 20;
    config
}

/// All that a registration says but for the wall time and the threads that were asked for: written
/// out, because every digit counts and no number (NaN) is equal to itself.
fn words(mut found: Registration) -> String {
    for record in &mut found.stages {
        record.seconds = 0.0;
    }
    found.config.n_threads = None;
    format!("{found:#?}")
}

#[test]
fn threads_change_no_bit_of_a_registration() {
    let pair = Pair::new(Scene::Field, 9000, 1).cut(0.9, 0.1);
    for config in [Config::default(), paper()] {
        let run = |n_threads| {
            let n_threads = Some(n_threads);
            let found = pair.register(&Config {
                n_threads,
                ..config.clone()
            });
            assert_eq!(found.config.n_threads, n_threads);
            words(found)
        };
        let alone = run(1);
        for n_threads in [2, 4] {
            assert_eq!(run(n_threads), alone, "{n_threads} threads");
        }
    }
}

#[test]
fn threads_change_no_bit_of_a_fused_cloud() {
    let pair = Pair::new(Scene::Field, 9000, 2).cut(0.8, 0.2);
    let fused = |pose: &Rigid| -> FusedCloud {
        let options = FuseOptions::default();
        fuse_clouds(
            &pair.source,
            &pair.target,
            pose,
            &options,
            &Progress::silent(),
        )
        .unwrap()
    };
    let run = |n_threads| {
        let pool = ThreadPoolBuilder::new().num_threads(n_threads).build();
        pool.unwrap().install(|| fused(&pair.target_from_source))
    };
    let alone = run(1);
    assert!(alone.n_filled_by_source > 0 && alone.n_filled_by_target > 0);
    for n_threads in [2, 4] {
        assert_eq!(run(n_threads), alone, "{n_threads} threads");
    }
}

#[test]
fn a_seed_repeats_itself_and_another_one_takes_another_way_to_the_same_pose() {
    let pair = Pair::new(Scene::Body, 5000, 3);
    let run = |seed| {
        pair.register(&Config {
            seed,
            ..Config::default()
        })
    };
    let (first, other) = (run(1), run(2));
    assert_eq!(words(run(1)), words(first.clone()));
    assert_ne!(first.history, other.history);
    let apart_m = farthest_m(
        &pair.source,
        first.target_from_source,
        other.target_from_source,
    );
    assert!(apart_m < 0.25 * first.voxel_size_m, "{apart_m}");
    assert_eq!(first.verdict, other.verdict);
}

#[test]
fn a_seed_of_the_paper_search_repeats_itself() {
    let pair = Pair::new(Scene::Body, 5000, 4);
    let run = |seed| pair.register(&Config { seed, ..paper() });
    let first = run(1);
    assert_eq!(words(run(1)), words(first.clone()));
    assert_ne!(first.history, run(2).history);
}
