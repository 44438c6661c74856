//! The paper's optimiser and its rivals on a function with many hollows; and on the same function
//! moved, all with the same number of calls.
//!
//! Harris hawks are drawn to the origin by their rules. Where the lowest value lies there, as in
//! most test functions, that looks like strength; moved elsewhere, the function shows the rest.
//!
//! `cargo run --release --example minimize`

#![allow(clippy::print_stdout)] // the crate never prints, its examples do

use tmchho::optim::{Method, Optimizer, Problem, SwarmOptions};

pub(crate) fn main() -> tmchho::Result<()> {
    // By another amount along each axis.
    let shift: Vec<f64> = (0..10).map(|i| -3.1 + 0.64 * f64::from(i)).collect();
    let functions = [
        ("at the origin", Problem::new("f5", 10)?),
        ("elsewhere", Problem::new("f5", 10)?.shifted(shift)?),
    ];
    for (place, function) in &functions {
        for method in Method::ALL {
            let options = SwarmOptions {
                max_evaluations: Some(10_000),
                ..SwarmOptions::new(method)
            };
            let found = options.minimize(function, &function.bounds()?, 1)?;
            println!("{:12} {place:13}: {:8.4}", method.name(), found.fun);
        }
    }
    Ok(())
}
