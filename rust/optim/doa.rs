//! Dingo optimisation (DOA): dingoes attack in a group, pursue alone, or scavenge, and the weak ones
//! are replaced.
//!
//! Source: Peraza-Vázquez et al. (2021), Eqs. (2) to (6), and their published program; Ren, Zhao &
//! Han (2023), Table 2, for the two probabilities.
//! Deviates: a random dingo is each equally likely; in the program the first and the last are half
//! as likely as the others. As there, β₁, β₂ and the size of the attacking group are drawn once per
//! run, which is why the results of one function spread over a hundred decades.
//! To know: β₁ times the group's mean way, minus the best position, is not translation-invariant; the
//! dingoes, too, are drawn to the origin.

use crate::error::{Result, require_between};
use crate::random::Stream;

use super::crowd::{Crowd, InTurn, MovesInTurn};
use super::search::Search;
use super::start::{self, Spread};
use super::{Bounds, Budget, Optimizer};

/// A dingo whose survival rate is no higher is replaced.
const LOWEST_SURVIVAL: f64 = 0.3;

/// Settings of the dingoes.
#[derive(Debug, Clone, PartialEq)]
pub struct DoaOptions {
    /// Size of the pack and limits of the search.
    pub budget: Budget,
    /// P, the probability to hunt and not to scavenge; 0 to 1.
    pub hunt_probability: f64,
    /// Q, the probability that a hunt is a group attack and not a persecution; 0 to 1.
    pub group_probability: f64,
}

impl Default for DoaOptions {
    fn default() -> Self {
        Self {
            budget: Budget::default(),
            hunt_probability: 0.5,
            group_probability: 0.7,
        }
    }
}

/// Group attack, Eq. (2): β₁ Σ (attacker − x) / n − best.
///
/// ```
/// use tmchho::optim::doa::group_attack;
/// // 2 * ((4 - 1) + (2 - 1)) / 2 - 3
/// assert_eq!(group_attack(&[1.0], &[3.0], &[&[4.0], &[2.0]], 2.0), [1.0]);
/// ```
pub fn group_attack(x: &[f64], best: &[f64], attackers: &[&[f64]], beta1: f64) -> Vec<f64> {
    (0..x.len())
        .map(|d| {
            let sum: f64 = attackers.iter().map(|attacker| attacker[d] - x[d]).sum();
            beta1 * (sum / attackers.len() as f64) - best[d]
        })
        .collect()
}

/// Persecution, Eq. (3): best + β₁ e^β₂ (other − x).
///
/// ```
/// use tmchho::optim::doa::persecute;
/// assert_eq!(persecute(&[1.0], &[3.0], &[2.0], -0.5, 0.0), [2.5]); // 3 - 0.5 * (2 - 1)
/// ```
pub fn persecute(x: &[f64], best: &[f64], other: &[f64], beta1: f64, beta2: f64) -> Vec<f64> {
    let factor = beta1 * beta2.exp();
    (x.iter().zip(best.iter().zip(other)))
        .map(|(x, (best, other))| best + factor * (other - x))
        .collect()
}

/// Scavenging, Eq. (4): (e^β₂ other − sign · x) / 2.
///
/// ```
/// use tmchho::optim::doa::scavenge;
/// assert_eq!(scavenge(&[1.0], &[4.0], 0.0, -1.0), [2.5]); // (4 + 1) / 2
/// ```
pub fn scavenge(x: &[f64], other: &[f64], beta2: f64, sign: f64) -> Vec<f64> {
    let factor = beta2.exp();
    (x.iter().zip(other))
        .map(|(x, other)| (factor * other - sign * x) / 2.0)
        .collect()
}

/// Where a weak dingo is replaced, Eq. (6): best + (one − sign · another) / 2.
///
/// ```
/// use tmchho::optim::doa::replace;
/// assert_eq!(replace(&[1.0], &[4.0], &[2.0], 1.0), [2.0]); // 1 + (4 - 2) / 2
/// ```
pub fn replace(best: &[f64], one: &[f64], another: &[f64], sign: f64) -> Vec<f64> {
    (best.iter().zip(one.iter().zip(another)))
        .map(|(best, (one, another))| best + (one - sign * another) / 2.0)
        .collect()
}

/// The survival rate of every dingo, Eq. (5): 1 for the best, 0 for the worst; not a number where
/// all are the same.
///
/// ```
/// use tmchho::optim::doa::survival;
/// assert_eq!(survival(&[1.0, 5.0, 2.0], 1.0), [1.0, 0.0, 0.75]);
/// ```
pub fn survival(fitness: &[f64], best: f64) -> Vec<f64> {
    let worst = fitness.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    (fitness.iter())
        .map(|fitness| (worst - fitness) / (worst - best))
        .collect()
}

impl Optimizer for DoaOptions {
    fn search(&self, bounds: &Bounds, seed: u64, start: &[Vec<f64>]) -> Result<Search> {
        self.budget.check("population_size")?;
        require_between("hunt_probability", self.hunt_probability, 0.0, 1.0)?;
        require_between("group_probability", self.group_probability, 0.0, 1.0)?;
        let n = self.budget.population_size;
        let places = start::population(Spread::Uniform, n, bounds, seed, start)?;
        let mut stream = Stream::new(seed, "dingo moves", 0);
        let beta1 = stream.uniform_between(-2.0, 2.0);
        let beta2 = stream.uniform_between(-1.0, 1.0);
        let group = stream.uniform_between(2.0, n as f64 / 2.0).round() as usize;
        let pack = Pack {
            options: self.clone(),
            beta1,
            beta2,
            group,
            survival: Vec::new(),
            stream,
        };
        let search = InTurn::new(places, bounds, pack);
        Ok(Search::new(Box::new(search), &self.budget))
    }
}

/// What the dingoes have besides their places.
#[derive(Clone)]
struct Pack {
    options: DoaOptions,
    beta1: f64,
    beta2: f64,
    group: usize,
    survival: Vec<f64>,
    stream: Stream,
}

impl MovesInTurn for Pack {
    fn begin_round(&mut self, crowd: &Crowd) {
        self.survival = survival(&crowd.fitness, crowd.best_fitness);
    }

    fn trial(&mut self, crowd: &Crowd, i: usize) -> Vec<f64> {
        let (places, n) = (&crowd.places, crowd.places.len());
        let (x, stream) = (&places[i], &mut self.stream);
        let sign = |stream: &mut Stream| if stream.uniform() < 0.5 { 1.0 } else { -1.0 };
        let hunted = if stream.uniform() < self.options.hunt_probability {
            let attackers: Vec<&[f64]> = (stream.sample_indices(n, self.group).into_iter())
                .map(|j| places[j].as_slice())
                .collect();
            if stream.uniform() < self.options.group_probability {
                group_attack(x, &crowd.best, &attackers, self.beta1)
            } else {
                let other = &places[stream.below(n)];
                persecute(x, &crowd.best, other, self.beta1, self.beta2)
            }
        } else {
            let other = &places[stream.below(n)];
            scavenge(x, other, self.beta2, sign(stream))
        };
        if self.survival[i] <= LOWEST_SURVIVAL {
            let two = stream.sample_indices(n, 2);
            let (one, another) = (&places[two[0]], &places[two[1]]);
            replace(&crowd.best, one, another, sign(stream))
        } else {
            hunted
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn moves_by_hand() {
        let two: [&[f64]; 2] = [&[3.0, 0.0], &[5.0, 4.0]];
        // 0.5 * ([2, -1] + [4, 3]) / 2 - [1, 2]
        assert_eq!(
            group_attack(&[1.0, 1.0], &[1.0, 2.0], &two, 0.5),
            [0.5, -1.5]
        );
        let near = |found: Vec<f64>, expected: f64| {
            assert!((found[0] - expected).abs() < 1e-14, "{found:?} {expected}");
        };
        let ln2 = 2.0_f64.ln();
        near(persecute(&[1.0], &[3.0], &[4.0], -0.5, ln2), 0.0); // 3 - 0.5 * 2 * (4 - 1)
        near(scavenge(&[1.0], &[4.0], ln2, 1.0), 3.5); // (2 * 4 - 1) / 2
        assert_eq!(replace(&[1.0], &[4.0], &[2.0], -1.0), [4.0]); // 1 + (4 + 2) / 2
        assert_eq!(survival(&[2.0, 4.0, 10.0], 0.0), [0.8, 0.6, 0.0]);
        assert!(survival(&[1.0, 1.0], 1.0).iter().all(|rate| rate.is_nan()));
    }
}
