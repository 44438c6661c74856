//! The seven functions on which the paper compares optimisers.
//!
//! Source: Ren, Zhao & Han (2023), Table 1, used with D = 10 and 50.
//! To know: the lowest value of all seven is 0 and lies at the origin, in the middle of the range.
//! Harris hawks are drawn to the origin by their rules (see [`HawkOptions`](super::HawkOptions)),
//! so that these functions flatter them.

use std::f64::consts::{E, TAU};

use crate::error::{Error, Result};
use crate::vectorize::widest;

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
    let term = |_, x| x * x - 10.0 * cos_of_turns(x) + 10.0;
    fold_terms(x, term, 0.0, |sum, term| sum + term)
}

fn f6(x: &[f64]) -> f64 {
    let n = x.len() as f64;
    let mean_square = x.iter().map(|x| x * x).sum::<f64>() / n;
    let cosines = fold_terms(x, |_, x| cos_of_turns(x), 0.0, |sum, term| sum + term);
    -20.0 * (-0.2 * mean_square.sqrt()).exp() - (cosines / n).exp() + 20.0 + E
}

fn f7(x: &[f64]) -> f64 {
    let sum: f64 = x.iter().map(|x| x * x).sum();
    let factor = |i, x| cos_of_turns(x / (TAU * f64::from(i).sqrt()));
    let product = fold_terms(x, factor, 1.0, |product, factor| product * factor);
    sum / 4000.0 - product + 1.0
}

/// Joins the terms of all coordinates, from the first, i = 1, to the last. The terms are computed before
/// they are joined, because a loop that does both one after the other is not turned into vector
/// instructions.
fn fold_terms(
    x: &[f64],
    term: impl Fn(u32, f64) -> f64,
    mut joined: f64,
    join: impl Fn(f64, f64) -> f64,
) -> f64 {
    let mut terms = [0.0; 32];
    for (first, block) in (1..).step_by(terms.len()).zip(x.chunks(terms.len())) {
        widest(
            #[inline(always)]
            || {
                for (i, (value, x)) in (first..).zip(terms.iter_mut().zip(block)) {
                    *value = term(i, *x);
                }
            },
        );
        for value in &terms[..block.len()] {
            joined = join(joined, *value);
        }
    }
    joined
}

/// cos(2π x), within 5e-16.
///
/// Why: the cosine of the standard library takes most of the time of f5. This one has no branches, so
/// that several are computed at once, and multiplies by 2π only after half turns are gone.
/// Source: 1 + t q(t) with t the square of what is left, at most a quarter turn; q is the polynomial
/// of degree 7 that interpolates (cos(2π √t) − 1) / t at Chebyshev's nodes. It is off by 2e-17 at most.
#[inline(always)]
fn cos_of_turns(x: f64) -> f64 {
    const SERIES: [f64; 8] = [
        0.273_049_155_189_273_3,
        -1.713_485_638_586_627_7,
        7.903_488_624_557_531,
        -26.426_255_386_496_4,
        60.244_641_349_672_37,
        -85.456_817_206_520_34,
        64.939_394_022_667_77,
        -19.739_208_802_178_716,
    ];
    /// 1.5 · 2⁵²: a number to which it was added is a whole one when it is taken off again, and the
    /// last bit of the sum tells whether that is odd.
    const ROUND: f64 = 6_755_399_441_055_744.0;
    // Numbers so large are whole.
    let x = if x.abs() > 1e15 { 0.0 } else { x };
    let sum = 2.0 * x + ROUND;
    let part = x - 0.5 * (sum - ROUND);
    let square = part * part;
    let mut series = SERIES[0];
    for coefficient in &SERIES[1..] {
        series = series * square + coefficient;
    }
    // An odd number of half turns changes the sign.
    f64::from_bits((1.0 + series * square).to_bits() ^ (sum.to_bits() << 63))
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
