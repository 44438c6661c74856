//! Cost of the optimisers themselves, on functions that cost next to nothing.

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use std::hint::black_box;

use tmchho::optim::chaos::ChaoticSequence;
use tmchho::optim::{Method, Optimizer, Problem, SwarmOptions};

/// Whole searches of 100 iterations by 30 members; throughput in calls of the objective.
fn searches(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("optim");
    for method in Method::ALL {
        let options = SwarmOptions {
            n_iterations: Some(100),
            ..SwarmOptions::new(method)
        };
        for dimension in [6, 10, 50] {
            let rastrigin = Problem::new("f5", dimension).expect("f5 is in Table 1");
            let bounds = rastrigin.bounds().expect("a cube is a box");
            let search = || {
                options
                    .minimize(&rastrigin, &bounds, black_box(1))
                    .expect("the settings are in their ranges")
            };
            group.throughput(Throughput::Elements(search().n_evaluations as u64));
            group.bench_function(format!("{}/{dimension}", method.name()), |bencher| {
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
