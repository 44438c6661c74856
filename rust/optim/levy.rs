//! The Lévy flight: many short steps and, now and then, a very long one.
//!
//! Source: Heidari et al. (2019), Eq. (9); Ren, Zhao & Han (2023), Eq. (5), with the exponent of
//! their Table 2.
//! Deviates: nowhere. Many programs multiply by 0.01; the authors' published one does not, and
//! neither do the defaults here.

use crate::vectorize::widest;

/// The exponent β.
pub const BETA: f64 = 1.5;

/// σ = ( Γ(1+β)·sin(πβ/2) / (Γ((1+β)/2)·β·2^((β−1)/2)) )^(1/β) for [`BETA`].
pub const SIGMA: f64 = 0.696_574_502_557_696_8;

/// The length of one step along one coordinate, from two numbers drawn from N(0, 1).
///
/// ```
/// use tmchho::optim::levy::{SIGMA, step};
/// // |-8|^(1/1.5) = 4
/// assert!((step(2.0, -8.0, 1.0) - 2.0 * SIGMA / 4.0).abs() < 1e-14);
/// ```
pub fn step(u: f64, v: f64, factor: f64) -> f64 {
    step_by_guess(u, v, factor, guess(v * v))
}

/// A [`step`] along each coordinate, from the two numbers drawn for it.
///
/// ```
/// use tmchho::optim::levy::{flight, step};
/// assert_eq!(flight(&[[2.0, -8.0], [1.0, 0.5]], 1.0), [step(2.0, -8.0, 1.0), step(1.0, 0.5, 1.0)]);
/// ```
pub fn flight(normals: &[[f64; 2]], factor: f64) -> Vec<f64> {
    // First the guesses, then the rest, because only the rest is turned into vector instructions.
    let mut flight: Vec<f64> = normals.iter().map(|[_, v]| guess(v * v)).collect();
    widest(
        #[inline(always)]
        || {
            for (step, [u, v]) in flight.iter_mut().zip(normals) {
                *step = step_by_guess(*u, *v, factor, *step);
            }
        },
    );
    flight
}

#[inline(always)]
fn step_by_guess(u: f64, v: f64, factor: f64, guess: f64) -> f64 {
    // Eq. (5): LF = c u σ / |v|^(1/β), and 1/β = 2/3.
    factor * u * SIGMA * inverse_cube_root(v * v, guess)
}

/// About x^(−1/3), for a positive number.
fn guess(x: f64) -> f64 {
    /// 4/3 of the bits of 1, less what brings the error below 4 %.
    const GUESS: u64 = 0x553e_f0ff_289d_d796;
    f64::from_bits(GUESS - x.to_bits() / 3)
}

/// x^(−1/3) to the last digits, by multiplications alone: in a search by hawks the roots of the
/// standard library took a quarter of the time. Large but finite for 0.
#[inline(always)]
fn inverse_cube_root(x: f64, guess: f64) -> f64 {
    let mut y = guess;
    // Newton's iteration squares the relative error each time, and doubles it.
    for _ in 0..4 {
        y *= (4.0 - x * y * y * y) * (1.0 / 3.0);
    }
    y
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sigma_follows_from_its_formula() {
        // Γ(2.5) = 3√π/4, and Γ(1.25) from Abramowitz & Stegun, Table 6.1.
        let gamma_2_5 = 0.75 * std::f64::consts::PI.sqrt();
        let gamma_1_25 = 0.906_402_477_055_477;
        let sigma = (gamma_2_5 * (std::f64::consts::PI * 0.75).sin()
            / (gamma_1_25 * 1.5 * 2.0_f64.powf(0.25)))
        .powf(1.0 / 1.5);
        assert!((sigma - SIGMA).abs() < 1e-15, "{sigma}");
    }

    #[test]
    fn the_root_is_that_of_the_standard_library() {
        let mut x = 1e-40;
        while x < 1e40 {
            let wanted = 1.0 / f64::cbrt(x);
            let found = inverse_cube_root(x, guess(x));
            assert!((found / wanted - 1.0).abs() < 1e-14, "{x}");
            x *= 1.37;
        }
        assert!(inverse_cube_root(0.0, guess(0.0)).is_finite());
    }

    #[test]
    fn a_step_worked_out_by_hand() {
        // 0.01 * -3 * 0.6965745025576968 / |0.125|^(2/3) = -0.03 * 0.69657… / 0.25
        assert!((step(-3.0, 0.125, 0.01) - -0.083_588_940_306_923_62).abs() < 1e-14);
        // |1|^(2/3) = 1
        assert!((step(1.0, -1.0, 1.0) - SIGMA).abs() < 1e-15);
    }
}
