//! The rules by which hawks move, one function each.
//!
//! Why: every rule takes its random numbers as arguments, so that it can be worked out by hand.
//! Nothing here draws, clips, evaluates or chooses.
//! Source: Heidari et al. (2019); Ren, Zhao & Han (2023), Eq. (5) and (7), whose letters the
//! comments use: O a hawk, O_prey the best point so far, O_avg the mean of all hawks, E the escape
//! energy, J the strength of the prey's jump.
//! Deviates: the numbers e, E, J and o are scalars, S and LF have one entry per coordinate ("two
//! dimensional" in the paper is a slip); the shares k use absolute values of the fitness.

use crate::vectorize::widest;

/// E, which fades from ±2 to 0 and decides what a hawk does.
///
/// `e0` is drawn from U(−1, 1) for each hawk and iteration; `iteration` counts from 0.
///
/// ```
/// use tmchho::optim::moves::escape_energy;
/// assert_eq!(escape_energy(-0.5, 25, 100), -0.75); // 2 * -0.5 * (1 - 1/4)
/// ```
pub fn escape_energy(e0: f64, iteration: usize, n_iterations: usize) -> f64 {
    // E = 2 E0 (1 − t / Tmax)
    2.0 * e0 * (1.0 - iteration as f64 / n_iterations as f64)
}

/// Exploration from the place of a random hawk: |E| ≥ 1, q ≥ ½.
pub fn explore_from_hawk(hawk: &[f64], random_hawk: &[f64], e1: f64, e2: f64) -> Vec<f64> {
    // Eq. (5): O_r − e1 |O_r − 2 e2 O|
    (hawk.iter().zip(random_hawk))
        .map(|(o, o_r)| o_r - e1 * (o_r - 2.0 * e2 * o).abs())
        .collect()
}

/// Exploration from the mean of all hawks: |E| ≥ 1, q < ½.
pub fn explore_from_mean(
    prey: &[f64],
    mean: &[f64],
    low: &[f64],
    high: &[f64],
    e3: f64,
    e4: f64,
) -> Vec<f64> {
    // Eq. (5): (O_prey − O_avg) − e3 (Lmin + e4 (Lmax − Lmin))
    (prey.iter().zip(mean))
        .zip(low.iter().zip(high))
        .map(|((o_prey, o_avg), (low, high))| (o_prey - o_avg) - e3 * (low + e4 * (high - low)))
        .collect()
}

/// Soft besiege: c ≥ ½, |E| ≥ ½.
pub fn soft_besiege(hawk: &[f64], prey: &[f64], energy: f64, jump: f64) -> Vec<f64> {
    // Eq. (5): (O_prey − O) − E |J O_prey − O|
    (hawk.iter().zip(prey))
        .map(|(o, o_prey)| (o_prey - o) - energy * (jump * o_prey - o).abs())
        .collect()
}

/// Hard besiege: c ≥ ½, |E| < ½.
pub fn hard_besiege(hawk: &[f64], prey: &[f64], energy: f64) -> Vec<f64> {
    // Eq. (5): O_prey − E |O_prey − O|
    (hawk.iter().zip(prey))
        .map(|(o, o_prey)| o_prey - energy * (o_prey - o).abs())
        .collect()
}

/// The first trial point P of a rapid dive: c < ½.
///
/// `centre` is the hawk itself for the soft besiege, |E| ≥ ½, and the mean of all hawks for the
/// hard besiege, |E| < ½.
pub fn dive(centre: &[f64], prey: &[f64], energy: f64, jump: f64) -> Vec<f64> {
    // Eq. (5): P = O_prey − E |J O_prey − O|, or with O_avg in place of O
    (centre.iter().zip(prey))
        .map(|(o, o_prey)| o_prey - energy * (jump * o_prey - o).abs())
        .collect()
}

/// The second trial point Q of a rapid dive: the first one and a Lévy flight.
pub fn fly_on(first: &[f64], s: &[f64], flight: &[f64]) -> Vec<f64> {
    // Eq. (5): Q = P + S ∘ LF(D)
    (first.iter().zip(s.iter().zip(flight)))
        .map(|(p, (s, lf))| p + s * lf)
        .collect()
}

/// The trigonometric mutation of three hawks: their centroid, moved along their differences in
/// proportion to the differences of their shares of the fitness.
///
/// Where the shares are not defined, because all three values are 0 or one is not finite, they are
/// equal and the centroid is the answer.
///
/// ```
/// use tmchho::optim::moves::mutate;
/// let hawks: [&[f64]; 3] = [&[0.0, 0.0], &[3.0, 0.0], &[0.0, 6.0]];
/// assert_eq!(mutate(hawks, [0.0; 3], 0.5), [1.0, 2.0]);
/// ```
pub fn mutate(hawks: [&[f64]; 3], fitness: [f64; 3], o: f64) -> Vec<f64> {
    let total: f64 = fitness.iter().map(|f| f.abs()).sum();
    let [k1, k2, k3] = if total > 0.0 && total.is_finite() {
        fitness.map(|f| f.abs() / total)
    } else {
        [1.0 / 3.0; 3]
    };
    // Eq. (7): v = (Z1 + Z2 + Z3)/3 + o [(k2 − k1)(Z1 − Z2) + (k3 − k2)(Z2 − Z3) + (k1 − k3)(Z3 − Z1)]
    let [z1, z2, z3] = hawks;
    (z1.iter().zip(z2.iter().zip(z3)))
        .map(|(z1, (z2, z3))| {
            (z1 + z2 + z3) / 3.0
                + o * ((k2 - k1) * (z1 - z2) + (k3 - k2) * (z2 - z3) + (k1 - k3) * (z3 - z1))
        })
        .collect()
}

/// O_avg, coordinate by coordinate.
///
/// ```
/// use tmchho::optim::moves::mean;
/// assert_eq!(mean(&[vec![1.0, 2.0], vec![3.0, 6.0]]), [2.0, 4.0]);
/// ```
///
/// # Panics
/// Where there are no hawks.
pub fn mean(hawks: &[Vec<f64>]) -> Vec<f64> {
    let mut mean = vec![0.0; hawks[0].len()];
    // Five at a time, so that a sum is fetched and put back once for five hawks.
    let (fives, rest) = hawks.as_chunks::<5>();
    widest(
        #[inline(always)]
        || {
            for [a, b, c, d, e] in fives {
                let others = a.iter().zip(b).zip(c).zip(d).zip(e);
                for (sum, ((((a, b), c), d), e)) in mean.iter_mut().zip(others) {
                    *sum = *sum + a + b + c + d + e;
                }
            }
        },
    );
    for hawk in rest {
        mean.iter_mut().zip(hawk).for_each(|(sum, o)| *sum += o);
    }
    let n = hawks.len() as f64;
    mean.iter_mut().for_each(|sum| *sum /= n);
    mean
}

#[cfg(test)]
mod tests {
    use super::*;

    // All numbers are sums of powers of two, so that the results are exact.
    const HAWK: [f64; 2] = [1.0, 2.0];
    const PREY: [f64; 2] = [3.0, -1.0];
    const MEAN: [f64; 2] = [3.0, -1.0];

    #[test]
    fn energy_fades_from_two_to_zero() {
        assert_eq!(escape_energy(1.0, 0, 100), 2.0);
        assert_eq!(escape_energy(-1.0, 50, 100), -1.0);
        assert_eq!(escape_energy(0.75, 75, 100), 0.375); // 2 * 0.75 * 0.25
        assert_eq!(escape_energy(1.0, 100, 100), 0.0);
    }

    #[test]
    fn exploration_from_a_random_hawk() {
        // 2 * 0.25 * O = [0.5, 1]; |[4, -2] - [0.5, 1]| = [3.5, 3]; [4, -2] - 0.5 * [3.5, 3]
        assert_eq!(
            explore_from_hawk(&HAWK, &[4.0, -2.0], 0.5, 0.25),
            [2.25, -3.5]
        );
    }

    #[test]
    fn exploration_from_the_mean() {
        // Lmin + e4 (Lmax - Lmin) = [-10 + 0.25 * 20, 0 + 0.25 * 8] = [-5, 2];
        // ([1, 2] - [3, -1]) - 0.5 * [-5, 2] = [-2, 3] + [2.5, -1]
        assert_eq!(
            explore_from_mean(&[1.0, 2.0], &MEAN, &[-10.0, 0.0], &[10.0, 8.0], 0.5, 0.25),
            [0.5, 2.0]
        );
    }

    #[test]
    fn soft_besiege_by_hand() {
        // |1.5 * [3, -1] - [1, 2]| = [3.5, 3.5]; ([3, -1] - [1, 2]) + 0.75 * [3.5, 3.5]
        assert_eq!(soft_besiege(&HAWK, &PREY, -0.75, 1.5), [4.625, -0.375]);
    }

    #[test]
    fn hard_besiege_by_hand() {
        // |[3, -1] - [1, 2]| = [2, 3]; [3, -1] - 0.25 * [2, 3]
        assert_eq!(hard_besiege(&HAWK, &PREY, 0.25), [2.5, -1.75]);
    }

    #[test]
    fn dives_by_hand() {
        // Soft: [3, -1] + 0.75 * |1.5 * [3, -1] - [1, 2]| = [3, -1] + 0.75 * [3.5, 3.5]
        assert_eq!(dive(&HAWK, &PREY, -0.75, 1.5), [5.625, 1.625]);
        // Hard: [3, -1] - 0.25 * |1.5 * [3, -1] - [3, -1]| = [3, -1] - 0.25 * [1.5, 0.5]
        assert_eq!(dive(&MEAN, &PREY, 0.25, 1.5), [2.625, -1.125]);
        // [2.625, -1.125] + [0.5 * -2, 1 * 0.25]
        assert_eq!(
            fly_on(&[2.625, -1.125], &[0.5, 1.0], &[-2.0, 0.25]),
            [1.625, -0.875]
        );
    }

    const TRIANGLE: [&[f64]; 3] = [&[0.0, 0.0], &[3.0, 0.0], &[0.0, 6.0]];

    #[test]
    fn mutation_by_hand() {
        // k = [1/4, 1/4, 1/2]; centroid [1, 2];
        // 0 * (Z1 - Z2) + 0.25 * [3, -6] - 0.25 * [0, 6] = [0.75, -3]; [1, 2] + 0.5 * [0.75, -3]
        assert_eq!(mutate(TRIANGLE, [1.0, 1.0, 2.0], 0.5), [1.375, 0.5]);
        // Shares are of absolute values.
        assert_eq!(mutate(TRIANGLE, [-1.0, 1.0, -2.0], 0.5), [1.375, 0.5]);
    }

    #[test]
    fn mutation_without_shares_is_the_centroid() {
        for fitness in [
            [0.0; 3],
            [f64::INFINITY, 1.0, 1.0],
            [f64::NAN, 1.0, 1.0],
            [f64::MAX; 3],
        ] {
            assert_eq!(mutate(TRIANGLE, fitness, 0.5), [1.0, 2.0], "{fitness:?}");
        }
    }
}
