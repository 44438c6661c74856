//! The paper's optimiser alone, on a function with many hollows; and on the same function moved.
//!
//! Harris hawks are drawn to the origin by their rules. Where the lowest value lies there, as in
//! most test functions, that looks like strength; moved elsewhere, the function shows the rest.
//!
//! `cargo run --release --example minimize`

#![allow(clippy::print_stdout)] // the crate never prints, its examples do

use tmchho::optim::{HawkOptions, Objective, Optimizer, test_functions};

pub(crate) fn main() -> tmchho::Result<()> {
    let rastrigin = test_functions::by_name("f5")?;
    let bounds = rastrigin.bounds(10)?;
    // By another amount along each axis.
    let moved = |x: &[f64]| {
        let shift = |i: usize| -3.1 + 0.64 * i as f64;
        let from_minimum: Vec<f64> = x.iter().enumerate().map(|(i, v)| v - shift(i)).collect();
        (rastrigin.evaluate)(&from_minimum)
    };
    let functions: [(&str, &dyn Objective); 2] = [
        ("at the origin", &rastrigin.evaluate),
        ("elsewhere", &moved),
    ];
    for (place, function) in functions {
        for (name, options) in [
            ("HHO", HawkOptions::hho()),
            ("TMCHHO", HawkOptions::tmchho()),
        ] {
            let found = options.minimize(function, &bounds, 1)?;
            println!(
                "{name:6} {place:13}: {:8.4} after {} calls",
                found.fun, found.n_evaluations
            );
        }
    }
    Ok(())
}
