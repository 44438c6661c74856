//! What every method of minimising promises, whichever it is.

#![allow(clippy::unwrap_used)] // a test that fails may do so at once

use std::sync::atomic::{AtomicUsize, Ordering};

use tmchho::optim::{
    Bounds, Method, Minimum, Objective, Optimizer, Problem, StopReason, SwarmOptions,
};

/// 30 members, 100 iterations.
fn table_3(method: Method) -> SwarmOptions {
    SwarmOptions {
        n_iterations: Some(100),
        ..SwarmOptions::new(method)
    }
}

#[test]
fn the_same_bits_again_and_others_with_another_seed() {
    let problem = Problem::new("f6", 7).unwrap();
    let bounds = problem.bounds().unwrap();
    for method in Method::ALL {
        let run = |seed| table_3(method).minimize(&problem, &bounds, seed).unwrap();
        assert_eq!(format!("{:?}", run(5)), format!("{:?}", run(5)));
        assert_ne!(run(5).history, run(6).history);
    }
}

#[test]
fn every_call_is_counted_and_every_point_is_inside() {
    let bounds = Bounds::new(vec![-1.0, 3.0, 5.0], vec![1.0, 3.5, 5.0]).unwrap();
    for method in Method::ALL {
        let n_calls = AtomicUsize::new(0);
        let objective = |x: &[f64]| {
            assert!(bounds.contains(x), "{method:?} {x:?}");
            n_calls.fetch_add(1, Ordering::Relaxed);
            (x[0] - 7.0).powi(2) + x[1] * x[1] + x[2]
        };
        let found = table_3(method).minimize(&objective, &bounds, 1).unwrap();
        assert_eq!(
            n_calls.load(Ordering::Relaxed),
            found.n_evaluations,
            "{method:?}"
        );
        if !matches!(method, Method::Tmchho | Method::TmchhoFree | Method::Hho) {
            assert_eq!(found.n_evaluations, 30 * 100);
        }
        assert!(found.fun < 50.0 + 1e-3, "{method:?}: the corner is found");
        assert!(bounds.contains(&found.x));
        assert_eq!((found.n_iterations, found.history.len()), (100, 100));
        assert!(found.history.windows(2).all(|pair| pair[1] <= pair[0]));
        assert_eq!(found.history.last(), Some(&found.fun));
        assert_eq!(objective.evaluate(&found.x), found.fun);
        for (x, fitness) in found.population.iter().zip(&found.population_fitness) {
            assert_eq!(objective.evaluate(x), *fitness, "{method:?}");
        }
    }
}

#[test]
fn no_limit_is_exceeded_and_no_value_forgotten() {
    let problem = Problem::new("f6", 4).unwrap();
    let bounds = problem.bounds().unwrap();
    for method in Method::ALL {
        for max_evaluations in [1, 29, 30, 31, 45, 777] {
            let best_seen = std::sync::Mutex::new(f64::INFINITY);
            let objective = |x: &[f64]| {
                let value = problem.evaluate(x);
                let mut best_seen = best_seen.lock().unwrap();
                *best_seen = best_seen.min(value);
                value
            };
            let options = SwarmOptions {
                max_evaluations: Some(max_evaluations),
                ..SwarmOptions::new(method)
            };
            let found = options.minimize(&objective, &bounds, 3).unwrap();
            assert_eq!(found.n_evaluations, max_evaluations, "{method:?}");
            assert_eq!(found.stop_reason, StopReason::MaxEvaluations);
            assert_eq!(found.fun, best_seen.into_inner().unwrap(), "{method:?}");
            assert_eq!(problem.evaluate(&found.x), found.fun);
            assert!(found.population.iter().all(|x| bounds.contains(x)));
        }
    }
}

#[test]
fn time_ends_a_search_that_would_go_on() {
    let bounds = Bounds::cube(2, -1.0, 1.0).unwrap();
    for method in Method::ALL {
        let options = SwarmOptions {
            n_iterations: Some(10_000_000),
            max_seconds: Some(0.01),
            ..SwarmOptions::new(method)
        };
        let found = options
            .minimize(&|x: &[f64]| x[0] * x[1], &bounds, 3)
            .unwrap();
        assert_eq!(found.stop_reason, StopReason::MaxSeconds, "{method:?}");
        assert!(found.fun < 0.0 && found.n_evaluations >= 30);
        let at_once = SwarmOptions {
            max_seconds: Some(0.0),
            ..options
        };
        let found = at_once.minimize(&|x: &[f64]| x[0], &bounds, 3).unwrap();
        assert_eq!((found.n_evaluations, found.n_iterations), (30, 1));
    }
}

#[test]
fn values_that_are_no_numbers_count_as_infinite() {
    let bounds = Bounds::cube(2, -1.0, 1.0).unwrap();
    let half_undefined = |x: &[f64]| if x[0] < 0.1 { f64::NAN } else { x[0] + x[1] };
    for method in Method::ALL {
        let options = table_3(method);
        let found = options.minimize(&half_undefined, &bounds, 4).unwrap();
        assert!(
            found.fun < -0.3 && found.x[0] >= 0.1,
            "{method:?} {found:?}"
        );
        assert!(found.n_nan > 0 && found.n_nan < found.n_evaluations);

        let found = options.minimize(&|_: &[f64]| f64::NAN, &bounds, 4).unwrap();
        assert_eq!(found.fun, f64::INFINITY);
        assert_eq!(found.n_nan, found.n_evaluations);
        assert!(bounds.contains(&found.x) && found.x.iter().all(|x| x.is_finite()));
    }
}

/// Runs a search by hand.
fn told(options: &SwarmOptions, bounds: &Bounds, f: impl Fn(&[f64]) -> f64) -> Minimum {
    let mut search = options.search(bounds, 9, &[]).unwrap();
    while !search.is_over() {
        assert_eq!(search.minimum().stop_reason, StopReason::NotOver);
        let values: Vec<f64> = search.ask().iter().map(|x| f(x)).collect();
        assert!(search.tell(&values[1..]).is_err(), "one value is missing");
        assert_eq!(values.len(), search.ask().len(), "nothing was taken");
        search.tell(&values).unwrap();
    }
    assert!(search.ask().is_empty() && search.tell(&[]).is_ok());
    search.minimum()
}

#[test]
fn asking_and_telling_is_the_same_search() {
    let problem = Problem::new("f5", 3).unwrap();
    let bounds = problem.bounds().unwrap();
    for method in Method::ALL {
        for max_evaluations in [None, Some(333)] {
            let options = SwarmOptions {
                max_evaluations,
                ..table_3(method)
            };
            let by_hand = told(&options, &bounds, |x| problem.evaluate(x));
            assert_eq!(by_hand, options.minimize(&problem, &bounds, 9).unwrap());
        }
    }
}

/// How far the search of a function and a box moved by `shift` differs from the unmoved one, at most
/// in any coordinate of the population, after `n_iterations`.
fn difference_of_moved(method: Method, shift: f64, n_iterations: usize) -> f64 {
    let options = SwarmOptions {
        n_iterations: Some(n_iterations),
        ..SwarmOptions::new(method)
    };
    let bowl = |x: &[f64]| -> f64 { x.iter().map(|x| (x - 1.25).powi(2)).sum() };
    let moved_bowl = |x: &[f64]| -> f64 { x.iter().map(|x| (x - shift - 1.25).powi(2)).sum() };
    let bounds = Bounds::cube(5, -8.0, 4.0).unwrap();
    let moved_bounds = Bounds::cube(5, shift - 8.0, shift + 4.0).unwrap();
    let here = options.minimize(&bowl, &bounds, 2).unwrap();
    let there = options.minimize(&moved_bowl, &moved_bounds, 2).unwrap();
    let differences = (here.population.iter().flatten())
        .zip(there.population.iter().flatten())
        .map(|(here, there)| (there - shift - here).abs());
    differences.fold(0.0, f64::max)
}

#[test]
fn the_free_variant_moves_with_the_function_and_the_paper_s_does_not() {
    for shift in [1.0, -3.7, 1000.0] {
        // Rounding errors grow from iteration to iteration until one decides a comparison.
        for n_iterations in [1, 5, 15] {
            let difference = difference_of_moved(Method::TmchhoFree, shift, n_iterations);
            assert!(difference < 1e-9, "{shift} {n_iterations} {difference}");
        }
        assert!(difference_of_moved(Method::Pso, shift, 15) < 1e-9);
        for method in [
            Method::Tmchho,
            Method::Hho,
            Method::Woa,
            Method::Boa,
            Method::Doa,
        ] {
            let difference = difference_of_moved(method, shift, 15);
            assert!(difference > 0.01, "{method:?} {shift} {difference}");
        }
    }
}

#[test]
fn away_from_the_origin_the_free_variant_is_the_better_one() {
    let median = |method, moved: bool| {
        let mut values: Vec<f64> = (0..30)
            .map(|seed| {
                let mut problem = Problem::new("f1", 10).unwrap();
                if moved {
                    let place = (0..10)
                        .map(|i| 80.0 - 16.0 * f64::from((i * 7) % 11))
                        .collect();
                    problem = problem.shifted(place).unwrap();
                }
                let bounds = problem.bounds().unwrap();
                let found = table_3(method).minimize(&problem, &bounds, seed).unwrap();
                found.fun.log10()
            })
            .collect();
        values.sort_by(f64::total_cmp);
        0.5 * (values[14] + values[15])
    };
    assert!(median(Method::Tmchho, false) < median(Method::TmchhoFree, false) - 20.0);
    assert!(median(Method::TmchhoFree, true) < median(Method::Tmchho, true) - 0.3);
}
