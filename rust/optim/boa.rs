//! Butterfly optimisation (BOA): butterflies follow a fragrance whose strength depends on their values.
//!
//! Source: Arora & Singh (2019) and their published program; Ren, Zhao & Han (2023), Table 2, for the
//! stimulus intensity and the exponent.
//! Deviates: the program evaluates each new place twice, once to judge it and once for the fragrance
//! of the next move; here the value is remembered: the same search with half the calls. The
//! fragrance is that of the absolute value, because a negative one has no such power.
//! To know: r² times the best position is not translation-invariant; the butterflies, too, are drawn
//! to the origin.

use crate::error::{Result, require_between};
use crate::random::Stream;

use super::crowd::{Crowd, InTurn, MovesInTurn};
use super::search::Search;
use super::start::{self, Spread};
use super::{Bounds, Budget, Optimizer};

/// Settings of the butterflies.
#[derive(Debug, Clone, PartialEq)]
pub struct BoaOptions {
    /// Size of the population and limits of the search.
    pub budget: Budget,
    /// p, the probability of a flight towards the best; 0 to 1.
    pub switch_probability: f64,
    /// c, the stimulus intensity at the beginning; ≥ 0.
    pub stimulus: f64,
    /// a, the exponent of the value in the fragrance; ≥ 0.
    pub exponent: f64,
}

impl Default for BoaOptions {
    fn default() -> Self {
        Self {
            budget: Budget::default(),
            switch_probability: 0.8,
            stimulus: 0.01,
            exponent: 0.1,
        }
    }
}

/// c |f|^a, the fragrance of a butterfly.
///
/// ```
/// use tmchho::optim::boa::fragrance;
/// assert_eq!(fragrance(-16.0, 0.01, 0.5), 0.04);
/// ```
pub fn fragrance(fitness: f64, stimulus: f64, exponent: f64) -> f64 {
    stimulus * fitness.abs().powf(exponent)
}

/// The stimulus of the next iteration: c + 0.025 / (c T).
///
/// ```
/// use tmchho::optim::boa::next_stimulus;
/// assert_eq!(next_stimulus(0.5, 10), 0.505);
/// ```
pub fn next_stimulus(stimulus: f64, n_iterations: usize) -> f64 {
    stimulus + 0.025 / (stimulus * n_iterations as f64)
}

/// A butterfly's trial point: X + (weight · X₁ − X₂) · fragrance.
///
/// Towards the best: weight r₁ r₂, X₁ the best, X₂ the butterfly itself. At random: weight ε², X₁
/// and X₂ two different butterflies.
///
/// ```
/// use tmchho::optim::boa::fly;
/// assert_eq!(fly(&[1.0], &[4.0], &[1.0], 0.5, 0.25), [1.25]); // 1 + (0.5 * 4 - 1) * 0.25
/// ```
pub fn fly(x: &[f64], first: &[f64], second: &[f64], weight: f64, fragrance: f64) -> Vec<f64> {
    (x.iter().zip(first.iter().zip(second)))
        .map(|(x, (first, second))| x + (weight * first - second) * fragrance)
        .collect()
}

impl Optimizer for BoaOptions {
    fn search(&self, bounds: &Bounds, seed: u64, start: &[Vec<f64>]) -> Result<Search> {
        self.budget.check("population_size")?;
        require_between("switch_probability", self.switch_probability, 0.0, 1.0)?;
        require_between("stimulus", self.stimulus, 0.0, f64::MAX)?;
        require_between("exponent", self.exponent, 0.0, f64::MAX)?;
        let n = self.budget.population_size;
        let places = start::population(Spread::Uniform, n, bounds, seed, start)?;
        let butterflies = Butterflies {
            options: self.clone(),
            stimulus: self.stimulus,
            smelled: vec![f64::INFINITY; n],
            stream: Stream::new(seed, "butterfly moves", 0),
        };
        let search = InTurn::new(places, bounds, butterflies);
        Ok(Search::new(Box::new(search), &self.budget))
    }
}

/// What the butterflies have besides their places.
#[derive(Clone)]
struct Butterflies {
    options: BoaOptions,
    stimulus: f64,
    /// The value at each butterfly's last trial point, taken or not: it makes the fragrance.
    smelled: Vec<f64>,
    stream: Stream,
}

impl MovesInTurn for Butterflies {
    fn trial(&mut self, crowd: &Crowd, i: usize) -> Vec<f64> {
        let (places, stream) = (&crowd.places, &mut self.stream);
        let fragrance = fragrance(self.smelled[i], self.stimulus, self.options.exponent);
        if stream.uniform() < self.options.switch_probability {
            let weight = stream.uniform() * stream.uniform();
            fly(&places[i], &crowd.best, &places[i], weight, fragrance)
        } else {
            let epsilon = stream.uniform();
            let two = stream.sample_indices(places.len(), 2);
            let (first, second) = (&places[two[0]], &places[two[1]]);
            fly(&places[i], first, second, epsilon * epsilon, fragrance)
        }
    }

    fn learn(&mut self, i: usize, value: f64) {
        self.smelled[i] = value;
    }

    fn end_round(&mut self) {
        self.stimulus = next_stimulus(self.stimulus, self.options.budget.n_iterations);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn moves_by_hand() {
        assert_eq!(fragrance(32.0, 0.5, 0.2), 0.5 * 2.0);
        assert_eq!(next_stimulus(0.01, 100), 0.01 + 0.025); // 0.025 / (0.01 * 100)
        // [1, 2] + (0.25 * [8, -4] - [3, 1]) * 0.5
        assert_eq!(
            fly(&[1.0, 2.0], &[8.0, -4.0], &[3.0, 1.0], 0.25, 0.5),
            [0.5, 1.0]
        );
    }
}
