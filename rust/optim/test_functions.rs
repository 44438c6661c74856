//! The seven functions on which the paper compares optimisers.
//!
//! Source: Ren, Zhao & Han (2023), Table 1, used with D = 10 and 50.
//! To know: the lowest value of all seven is 0 and lies at the origin, in the middle of the range.
//! Harris hawks are drawn to the origin by their rules (see [`HawkOptions`](super::HawkOptions)),
//! so that these functions flatter them.

use std::f64::consts::E;

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
pub static ALL: [TestFunction; 7] = [
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
    ALL.iter()
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
    sum_of(x, |x| x * x - 10.0 * cos_of_turns(x) + 10.0)
}

fn f6(x: &[f64]) -> f64 {
    let n = x.len() as f64;
    let mean_square = x.iter().map(|x| x * x).sum::<f64>() / n;
    let mean_cosine = sum_of(x, cos_of_turns) / n;
    -20.0 * (-0.2 * mean_square.sqrt()).exp() - mean_cosine.exp() + 20.0 + E
}

fn f7(x: &[f64]) -> f64 {
    let sum: f64 = x.iter().map(|x| x * x).sum();
    let product: f64 = (x.iter().zip(1_u32..))
        .map(|(x, i)| (x / f64::from(i).sqrt()).cos())
        .product();
    sum / 4000.0 - product + 1.0
}

/// The sum over all coordinates, from the first to the last. The terms are computed before they are
/// added, because a loop that does both one after the other is not turned into vector instructions.
fn sum_of(x: &[f64], term: impl Fn(f64) -> f64) -> f64 {
    let mut sum = 0.0;
    let mut terms = [0.0; 32];
    for block in x.chunks(terms.len()) {
        for (value, x) in terms.iter_mut().zip(block) {
            *value = term(*x);
        }
        for value in &terms[..block.len()] {
            sum += value;
        }
    }
    sum
}

/// cos(2π x), within 5e-16.
///
/// Why: the cosine of the standard library takes most of the time of f5. This one has no branches, so
/// that several are computed at once, and multiplies by 2π only after whole turns are gone.
/// Source: the series of the cosine up to the 20th power, of an angle within a quarter turn.
fn cos_of_turns(x: f64) -> f64 {
    /// (−1)^k (2π)^(2k) / (2k)! for k from 10 down to 1.
    const SERIES: [f64; 10] = [
        0.0037798342006800396,
        -0.03638284114254567,
        0.28200596845579123,
        -1.714390711088672,
        7.903536371318469,
        -26.4262567833744,
        60.24464137187666,
        -85.45681720669373,
        64.9393940226683,
        -19.739208802178716,
    ];
    /// 1.5 · 2⁵²: a number to which it was added is a whole one when it is taken off again.
    const ROUND: f64 = 6_755_399_441_055_744.0;
    let turns = (x + ROUND) - ROUND;
    // Numbers so large are whole.
    let part = if x.abs() > 1e15 {
        0.0
    } else {
        (x - turns).abs()
    };
    // cos(π - α) = -cos(α)
    let (sign, part) = if part > 0.25 {
        (-1.0, 0.5 - part)
    } else {
        (1.0, part)
    };
    let square = part * part;
    let mut series = SERIES[0];
    for coefficient in &SERIES[1..] {
        series = series * square + coefficient;
    }
    sign * (1.0 + series * square)
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
        for f in &ALL {
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
    fn the_cosine_is_that_of_the_standard_library() {
        for i in -40_000..=40_000 {
            let x = f64::from(i) * 0.000_987;
            let expected = (std::f64::consts::TAU * (x - x.round())).cos();
            let found = cos_of_turns(x);
            assert!((found - expected).abs() < 5e-16, "{x}: {found} {expected}");
        }
        for (x, expected) in [
            (0.0, 1.0),
            (1e-9, 1.0),
            (0.5, -1.0),
            (-3.0, 1.0),
            (1e300, 1.0),
        ] {
            assert_eq!(cos_of_turns(x), expected);
        }
        assert!(cos_of_turns(f64::NAN).is_nan());
    }

    #[test]
    fn an_unknown_name_is_refused() {
        let error = by_name("f8").unwrap_err();
        assert_eq!(error.to_string(), "test function must be f1 to f7, got f8");
    }
}
