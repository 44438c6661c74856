//! Table 3 of the paper: 30 members, 100 iterations, 30 runs.
//!
//! The table gives means. These quantities spread over ten decades and more, so that a mean is the one
//! worst run: a printed mean is looked for from two decades below our median to two above our mean.
//! Where the medians of the published program are known, ours must be within one and a half decades.

#![allow(clippy::unwrap_used)] // a test that fails may do so at once

use tmchho::optim::{Method, Optimizer, Problem, SwarmOptions};

/// The printed means of HHO, TMCHHO, WOA and BOA, whose settings are known.
const PRINTED: [(&str, usize, [f64; 4]); 10] = [
    ("f1", 10, [2.34e-22, 3.46e-29, 1.65e-12, 1.09e-05]),
    ("f1", 50, [4.18e-22, 8.89e-26, 8.64e-11, 1.88e-05]),
    ("f2", 10, [3.9e-12, 2.31e-14, 1.83e-08, 0.000401]),
    ("f2", 50, [8.34e-12, 4.98e-13, 3.63e-07, 7.81e72]),
    ("f3", 10, [9.33e-20, 1.36e-19, 4.33e03, 1.18e-05]),
    ("f3", 50, [5.91e-13, 1.47e-13, 3.18e05, 1.73e-05]),
    ("f4", 10, [3.73e-13, 1.82e-14, 17.2, 0.000888]),
    ("f4", 50, [1.86e-12, 6.19e-14, 74.1, 0.00127]),
    ("f6", 10, [8.23e-13, 1.82e-14, 3.08e-07, 0.0009]),
    ("f6", 50, [1.91e-12, 1.24e-14, 5.86e-07, 0.000949]),
];
const METHODS: [Method; 4] = [Method::Hho, Method::Tmchho, Method::Woa, Method::Boa];

/// The values of 30 runs, lowest first.
fn thirty_runs(method: Method, name: &str, dimension: usize) -> Vec<f64> {
    let options = SwarmOptions {
        n_iterations: Some(100),
        ..SwarmOptions::new(method)
    };
    let problem = Problem::new(name, dimension).unwrap();
    let bounds = problem.bounds().unwrap();
    let run = |seed| options.minimize(&problem, &bounds, seed).unwrap().fun;
    let mut values: Vec<f64> = (0..30).map(run).collect();
    values.sort_by(f64::total_cmp);
    values
}

fn median_log10(values: &[f64]) -> f64 {
    0.5 * (values[14].log10() + values[15].log10())
}

#[test]
fn the_printed_means_lie_among_our_runs() {
    for (name, dimension, printed) in PRINTED {
        for (method, printed) in METHODS.into_iter().zip(printed) {
            let values = thirty_runs(method, name, dimension);
            let median = median_log10(&values);
            let mean = (values.iter().sum::<f64>() / 30.0).log10();
            let what = format!(
                "{method:?} {name} D{dimension}: printed {:.1}, median {median:.1}, mean {mean:.1}",
                printed.log10()
            );
            if printed > 1e50 {
                // No point of ±10 in 50 dimensions has a value above 500 + 10⁵⁰: a misprint, or
                // another box. Ours must be what the box allows.
                assert_eq!((method, name), (Method::Boa, "f2"), "{what}");
                assert!(median < 50.0, "{what}");
                continue;
            }
            assert!(
                median - 2.0 <= printed.log10() && printed.log10() <= mean.max(median) + 2.0,
                "{what}"
            );
        }
    }
}

#[test]
fn medians_are_those_of_the_published_program() {
    for (method, name, dimension, published) in [
        (Method::Hho, "f1", 10, 4e-26_f64),
        (Method::Tmchho, "f1", 10, 2.4e-30),
        (Method::Tmchho, "f1", 50, 6.7e-30),
        (Method::Hho, "f3", 50, 1.4e-17),
    ] {
        let found = median_log10(&thirty_runs(method, name, dimension));
        assert!(
            (found - published.log10()).abs() <= 1.5,
            "{method:?} {name} D{dimension}: {found}, {}",
            published.log10()
        );
    }
}

#[test]
fn the_improvements_help_where_the_minimum_is_the_origin() {
    for name in ["f1", "f2", "f4", "f6"] {
        for dimension in [10, 50] {
            let [hho, tmchho] = [Method::Hho, Method::Tmchho]
                .map(|method| median_log10(&thirty_runs(method, name, dimension)));
            assert!(tmchho < hho, "{name} D{dimension}: {tmchho} {hho}");
        }
    }
}

#[test]
fn rastrigin_and_griewank_are_solved_exactly() {
    for method in [Method::Hho, Method::Tmchho] {
        for name in ["f5", "f7"] {
            for dimension in [10, 50] {
                let values = thirty_runs(method, name, dimension);
                assert!(
                    values.iter().all(|value| *value == 0.0),
                    "{name} D{dimension}"
                );
            }
        }
    }
}

#[test]
fn particles_end_where_the_table_has_them_although_their_inertia_is_a_guess() {
    for (name, dimension, printed) in [
        ("f1", 10, 3.09e-2_f64),
        ("f1", 50, 1.41e4),
        ("f3", 10, 5.72e2),
        ("f3", 50, 1.09e5),
        ("f4", 10, 4.36),
        ("f4", 50, 9.21e1),
        ("f6", 50, 2.0e1),
    ] {
        let found = median_log10(&thirty_runs(Method::Pso, name, dimension));
        assert!(
            (found - printed.log10()).abs() <= 2.0,
            "{name} D{dimension}: {found}"
        );
    }
}

#[test]
fn dingoes_lie_between_the_printed_best_and_mean() {
    // Three numbers drawn once decide a run: the best is a hundred decades below the mean.
    for (name, dimension, best, mean) in [
        ("f1", 10, 3.27e-84_f64, 2.10e-8_f64),
        ("f1", 50, 1.90e-97, 6.75e-9),
        ("f4", 10, 4.11e-51, 7.68e-7),
        ("f4", 50, 4.21e-39, 3.15e-8),
    ] {
        let found = median_log10(&thirty_runs(Method::Doa, name, dimension));
        assert!(
            found > best.log10() && found < mean.log10(),
            "{name} D{dimension}: {found}"
        );
    }
}
