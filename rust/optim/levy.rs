//! The Lévy flight: many short steps and, now and then, a very long one.
//!
//! Source: Heidari et al. (2019), Eq. (9); Ren, Zhao & Han (2023), Eq. (5), with the exponent of
//! their Table 2.
//! Deviates: nowhere. Many programs multiply by 0.01; the authors' published one does not, and
//! neither do the defaults here.

/// The exponent β.
pub const BETA: f64 = 1.5;

/// σ = ( Γ(1+β)·sin(πβ/2) / (Γ((1+β)/2)·β·2^((β−1)/2)) )^(1/β) for [`BETA`].
pub const SIGMA: f64 = 0.696_574_502_557_696_8;

/// The length of one step along one coordinate, from two numbers drawn from N(0, 1).
///
/// ```
/// use tmchho::optim::levy::{SIGMA, step};
/// // |-8|^(1/1.5) = 4
/// assert!((step(2.0, -8.0, 1.0) - 2.0 * SIGMA / 4.0).abs() < 1e-15);
/// ```
pub fn step(u: f64, v: f64, factor: f64) -> f64 {
    // Eq. (5): LF = c u σ / |v|^(1/β)
    // 1/β = 2/3, and a cube root costs a third of a power.
    factor * u * SIGMA / (v * v).cbrt()
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
    fn a_step_worked_out_by_hand() {
        // 0.01 * -3 * 0.6965745025576968 / |0.125|^(2/3) = -0.03 * 0.69657… / 0.25
        assert!((step(-3.0, 0.125, 0.01) - -0.083_588_940_306_923_62).abs() < 1e-15);
        // |1|^(2/3) = 1
        assert_eq!(step(1.0, -1.0, 1.0), SIGMA);
    }
}
