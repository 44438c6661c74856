//! The seven functions on which the paper compares optimisers.
//!
//! Source: Ren, Zhao & Han (2023), Table 1, used with D = 10 and 50.
//! To know: the lowest value of all seven is 0 and lies at the origin, in the middle of the range.
//! Harris hawks are drawn to the origin by their rules (see [`HawkOptions`](super::HawkOptions)),
//! so that these functions flatter them.

use std::f64::consts::{E, TAU};

use crate::error::{Error, Result};

use super::Bounds;

/// One function of Table 1.
///
/// ```
/// use tmchho::optim::{HawkOptions, Optimizer, test_functions};
/// let rastrigin = test_functions::by_name("f5")?;
/// let found = HawkOptions::hho().minimize(&rastrigin.evaluate, &rastrigin.bounds(10)?, 1)?;
/// assert_eq!(found.fun, rastrigin.minimum);
/// # Ok::<(), tmchho::Error>(())
/// ```
#[derive(Debug, Clone, Copy)]
pub struct TestFunction {
    /// The paper's name: f1 to f7.
    pub name: &'static str,
    /// The name that others use.
    pub title: &'static str,
    /// The range of every coordinate is ± this.
    pub range: f64,
    /// The lowest value, taken at the origin alone.
    pub minimum: f64,
    /// The function, of any number of coordinates.
    pub evaluate: fn(&[f64]) -> f64,
}

impl TestFunction {
    /// The box of the paper with `dimension` coordinates.
    ///
    /// # Errors
    /// [`Error::InvalidArgument`] for no coordinate.
    pub fn bounds(&self, dimension: usize) -> Result<Bounds> {
        Bounds::cube(dimension, -self.range, self.range)
    }
}

/// Table 1, in its order.
pub const ALL: [TestFunction; 7] = [
    function("f1", "sphere", 100.0, f1),
    function("f2", "Schwefel 2.22", 10.0, f2),
    function("f3", "Schwefel 1.2", 100.0, f3),
    function("f4", "Schwefel 2.21", 100.0, f4),
    function("f5", "Rastrigin", 5.12, f5),
    function("f6", "Ackley", 32.0, f6),
    function("f7", "Griewank", 600.0, f7),
];

/// The function called `name` in the paper.
///
/// # Errors
/// [`Error::InvalidArgument`] for any other name.
pub fn by_name(name: &str) -> Result<&'static TestFunction> {
    const TABLE: &[TestFunction] = &ALL;
    TABLE
        .iter()
        .find(|f| f.name == name)
        .ok_or_else(|| Error::argument("test function", format!("must be f1 to f7, got {name}")))
}

const fn function(
    name: &'static str,
    title: &'static str,
    range: f64,
    evaluate: fn(&[f64]) -> f64,
) -> TestFunction {
    TestFunction {
        name,
        title,
        range,
        minimum: 0.0,
        evaluate,
    }
}

fn f1(x: &[f64]) -> f64 {
    x.iter().map(|x| x * x).sum()
}

fn f2(x: &[f64]) -> f64 {
    let sum: f64 = x.iter().map(|x| x.abs()).sum();
    let product: f64 = x.iter().map(|x| x.abs()).product();
    sum + product
}

fn f3(x: &[f64]) -> f64 {
    let mut running_sum = 0.0;
    x.iter()
        .map(|x| {
            running_sum += x;
            running_sum * running_sum
        })
        .sum()
}

fn f4(x: &[f64]) -> f64 {
    x.iter().map(|x| x.abs()).fold(0.0, f64::max)
}

fn f5(x: &[f64]) -> f64 {
    x.iter()
        .map(|x| x * x - 10.0 * (TAU * x).cos() + 10.0)
        .sum()
}

fn f6(x: &[f64]) -> f64 {
    let n = x.len() as f64;
    let mean_square = x.iter().map(|x| x * x).sum::<f64>() / n;
    let mean_cosine = x.iter().map(|x| (TAU * x).cos()).sum::<f64>() / n;
    -20.0 * (-0.2 * mean_square.sqrt()).exp() - mean_cosine.exp() + 20.0 + E
}

fn f7(x: &[f64]) -> f64 {
    let sum: f64 = x.iter().map(|x| x * x).sum();
    let product: f64 = (x.iter().zip(1_u32..))
        .map(|(x, i)| (x / f64::from(i).sqrt()).cos())
        .product();
    sum / 4000.0 - product + 1.0
}

#[cfg(test)]
mod tests {
    use super::*;

    fn near(name: &str, x: &[f64], expected: f64) {
        let value = (by_name(name).unwrap().evaluate)(x);
        assert!(
            (value - expected).abs() < 1e-12,
            "{name}{x:?} = {value}, expected {expected}"
        );
    }

    #[test]
    fn each_function_worked_out_by_hand() {
        near("f1", &[3.0, -4.0], 25.0); // 9 + 16
        near("f2", &[3.0, -4.0], 19.0); // (3 + 4) + 3 * 4
        near("f3", &[3.0, -4.0], 10.0); // 3² + (3 - 4)²
        near("f4", &[3.0, -4.0], 4.0);
        near("f5", &[0.5, -1.0], 21.25); // (0.25 + 10 + 10) + (1 - 10 + 10)
        // mean square 1, cos(±2π) = 1: -20 e^-0.2 - e + 20 + e
        near("f6", &[1.0, -1.0], 20.0 * (1.0 - (-0.2_f64).exp()));
        // cos(π) cos(√2 π / √2) = 1: (π² + 2 π²) / 4000 - 1 + 1
        let pi = std::f64::consts::PI;
        near("f7", &[pi, 2.0_f64.sqrt() * pi], 3.0 * pi * pi / 4000.0);
    }

    #[test]
    fn the_lowest_value_is_at_the_origin() {
        for f in ALL {
            for dimension in [10, 50] {
                let at_origin = (f.evaluate)(&vec![0.0; dimension]);
                // The four terms of f6 do not cancel to the last bit.
                assert!((at_origin - f.minimum).abs() < 1e-15, "{}", f.name);
                assert!((f.evaluate)(&vec![0.3; dimension]) > 1e-3, "{}", f.name);
                assert_eq!(f.bounds(dimension).unwrap().dimension(), dimension);
            }
        }
    }

    #[test]
    fn an_unknown_name_is_refused() {
        let error = by_name("f8").unwrap_err();
        assert_eq!(error.to_string(), "test function must be f1 to f7, got f8");
    }
}
