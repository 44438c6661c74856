//! A start population from a chaotic map.
//!
//! Why: the paper spreads the hawks by the piecewise linear chaotic map (PWLCM) in place of
//! uniform random numbers.
//! Source: Ren, Zhao & Han (2023), Sec. 4.4, Eq. (6).
//! Deviates: nowhere; where the paper is silent, one sequence runs through the whole population,
//! hawk by hawk, coordinate by coordinate, and a value from which the map cannot go on is replaced.
//! To know: the map spreads single numbers evenly, but each is a function of the one before. The
//! coordinates of a hawk lie on a broken line, and the start is no better spread than a uniform one.

use crate::random::Stream;

use super::Bounds;

/// The control parameter of the map.
pub const T_CR: f64 = 0.4;

/// Nearer than this to 0, ½ or 1 no sequence is started: these values end in the fixed point 0.
const START_MARGIN: f64 = 1e-9;

/// A value that differs from its predecessor by no more is a fixed point of the map.
const REPEAT_TOLERANCE: f64 = 1e-15;

/// One step of the map, for `r` from 0 to 1.
///
/// ```
/// use tmchho::optim::chaos::pwlcm;
/// assert_eq!(pwlcm(0.2), 0.5); // 0.2 / 0.4
/// ```
pub fn pwlcm(r: f64) -> f64 {
    // Eq. (6)
    if r < T_CR {
        r / T_CR
    } else if r <= 0.5 {
        (r - T_CR) / (0.5 - T_CR)
    } else if r <= 1.0 - T_CR {
        (1.0 - T_CR - r) / (0.5 - T_CR)
    } else {
        (1.0 - r) / T_CR
    }
}

/// The map's values, one after another, all strictly between 0 and 1.
///
/// A value that reaches 0 or 1, or repeats its predecessor, is replaced by a fresh random draw: 0
/// is a fixed point, 0.4, ½, 0.6 and 1 lead to it, and three more fixed points lie between.
///
/// ```
/// use tmchho::optim::chaos::{ChaoticSequence, pwlcm};
/// let values: Vec<f64> = ChaoticSequence::new(7).take(3).collect();
/// assert_eq!(values[1], pwlcm(values[0]));
/// assert_eq!(values[2], pwlcm(values[1]));
/// ```
#[derive(Debug, Clone)]
pub struct ChaoticSequence {
    stream: Stream,
    next: f64,
    n_redraws: usize,
}

impl ChaoticSequence {
    /// The sequence of `seed`.
    pub fn new(seed: u64) -> Self {
        let mut stream = Stream::new(seed, "chaotic sequence", 0);
        let next = draw_start(&mut stream);
        Self {
            stream,
            next,
            n_redraws: 0,
        }
    }

    /// How many values were replaced so far.
    pub fn n_redraws(&self) -> usize {
        self.n_redraws
    }

    fn value_after(&mut self, value: f64) -> f64 {
        let next = pwlcm(value);
        let is_stuck = (next - value).abs() <= REPEAT_TOLERANCE;
        if next <= 0.0 || next >= 1.0 || is_stuck {
            self.n_redraws += 1;
            return draw_start(&mut self.stream);
        }
        next
    }
}

/// The sequence never ends.
impl Iterator for ChaoticSequence {
    type Item = f64;

    fn next(&mut self) -> Option<f64> {
        let value = self.next;
        self.next = self.value_after(value);
        Some(value)
    }
}

fn draw_start(stream: &mut Stream) -> f64 {
    loop {
        let r = stream.uniform();
        if [0.0, 0.5, 1.0]
            .iter()
            .all(|bad: &f64| (r - bad).abs() > START_MARGIN)
        {
            return r;
        }
    }
}

/// `n` points of the box: coordinate j of point i is value i·D + j of the sequence, carried from
/// (0, 1) to the interval of coordinate j.
///
/// ```
/// use tmchho::optim::{Bounds, chaos};
/// let bounds = Bounds::cube(6, -50.0, 50.0)?;
/// let population = chaos::population(&bounds, 30, 7);
/// assert_eq!(population.len(), 30);
/// assert!(population.iter().all(|x| bounds.contains(x)));
/// # Ok::<(), tmchho::Error>(())
/// ```
pub fn population(bounds: &Bounds, n: usize, seed: u64) -> Vec<Vec<f64>> {
    let mut sequence = ChaoticSequence::new(seed);
    (0..n).map(|_| bounds.at(&mut sequence)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_branch_of_the_map_worked_out_by_hand() {
        let near = |r: f64, expected: f64| assert!((pwlcm(r) - expected).abs() < 1e-14, "{r}");
        near(0.1, 0.25); // 0.1 / 0.4
        near(0.43, 0.3); // (0.43 - 0.4) / 0.1
        near(0.57, 0.3); // (0.6 - 0.57) / 0.1
        near(0.9, 0.25); // (1 - 0.9) / 0.4
        // The ends of the branches: 0, 0 / 0.1, 0.1 / 0.1, 0 / 0.1, 0 / 0.4.
        assert_eq!(
            [0.0, 0.4, 0.5, 0.6, 1.0].map(pwlcm),
            [0.0, 0.0, 1.0, 0.0, 0.0]
        );
    }

    #[test]
    fn a_million_values_stay_inside_and_are_evenly_spread() {
        let n = 1_000_000;
        let mut values: Vec<f64> = ChaoticSequence::new(3).take(n).collect();
        assert!(values.iter().all(|v| *v > 0.0 && *v < 1.0));
        values.sort_unstable_by(f64::total_cmp);
        // Kolmogorov and Smirnov's largest gap between the two distributions; independent numbers
        // stay below 0.0016 in 99 of 100 cases.
        let gap = values
            .iter()
            .enumerate()
            .map(|(i, v)| ((i as f64 + 0.5) / n as f64 - v).abs())
            .fold(0.0, f64::max);
        assert!(gap < 0.004, "{gap}");
    }

    #[test]
    fn values_from_which_the_map_cannot_go_on_are_replaced_and_counted() {
        // 0.4 goes to 0, ½ to 1, and r = 1/1.4, (1 - 0.4)/(1.5 - 0.4) and 0.4/0.9 to themselves.
        for stuck in [0.4, 0.5, 1.0 / 1.4, 0.6 / 1.1, 0.4 / 0.9] {
            let mut sequence = ChaoticSequence::new(11);
            let after = sequence.value_after(stuck);
            assert_eq!(sequence.n_redraws(), 1, "{stuck}");
            assert!(after > 0.0 && after < 1.0 && (after - stuck).abs() > 1e-6);
        }
        let mut sequence = ChaoticSequence::new(11);
        sequence.value_after(0.3);
        assert_eq!(sequence.n_redraws(), 0);
    }

    #[test]
    fn the_population_is_filled_hawk_by_hawk_coordinate_by_coordinate() {
        let bounds = Bounds::new(vec![0.0, 10.0], vec![1.0, 30.0]).unwrap();
        let values: Vec<f64> = ChaoticSequence::new(9).take(6).collect();
        let expected: Vec<Vec<f64>> = values
            .chunks(2)
            .map(|c| vec![c[0], 10.0 + 20.0 * c[1]])
            .collect();
        assert_eq!(population(&bounds, 3, 9), expected);
    }
}
