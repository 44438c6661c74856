//! Cost of the optimisers themselves, on functions that cost next to nothing.

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use std::hint::black_box;

use tmchho::optim::chaos::ChaoticSequence;
use tmchho::optim::{HawkOptions, Optimizer, test_functions};

/// Whole searches of 100 iterations by 30 hawks; throughput in calls of the objective.
fn searches(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("optim");
    let rastrigin = test_functions::by_name("f5").expect("f5 is in Table 1");
    for (name, options) in [
        ("hho", HawkOptions::hho()),
        ("tmchho", HawkOptions::tmchho()),
    ] {
        let options = HawkOptions {
            n_iterations: 100,
            ..options
        };
        for dimension in [6, 10, 50] {
            let bounds = rastrigin.bounds(dimension).expect("a cube is a box");
            let search = || {
                options
                    .minimize(&rastrigin.evaluate, &bounds, black_box(1))
                    .expect("the settings are in their ranges")
            };
            group.throughput(Throughput::Elements(search().n_evaluations as u64));
            group.bench_function(format!("{name}/{dimension}"), |bencher| {
                bencher.iter(search);
            });
        }
    }
    group.finish();
}

/// Values of the chaotic map.
fn chaotic_sequence(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("optim");
    let n = 100_000;
    group.throughput(Throughput::Elements(n as u64));
    group.bench_function("chaotic_sequence", |bencher| {
        bencher.iter(|| ChaoticSequence::new(black_box(1)).take(n).sum::<f64>());
    });
    group.finish();
}

criterion_group!(benches, searches, chaotic_sequence);
criterion_main!(benches);
