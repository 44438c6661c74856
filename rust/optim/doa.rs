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

use super::search::{Contest, Search, Swarm, Wish};
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
            bounds: bounds.clone(),
            beta1,
            beta2,
            group,
            fitness: vec![f64::INFINITY; n],
            survival: Vec::new(),
            best: places[0].clone(),
            best_fitness: f64::INFINITY,
            places,
            stream,
            next: Next::Start,
        };
        Ok(Search::new(Box::new(pack), &self.budget))
    }
}

#[derive(Clone)]
struct Pack {
    options: DoaOptions,
    bounds: Bounds,
    beta1: f64,
    beta2: f64,
    group: usize,
    places: Vec<Vec<f64>>,
    fitness: Vec<f64>,
    survival: Vec<f64>,
    best: Vec<f64>,
    best_fitness: f64,
    stream: Stream,
    next: Next,
}

#[derive(Clone, Copy)]
enum Next {
    Start,
    Dingo(usize),
    End,
}

impl Pack {
    fn trial(&mut self, i: usize) -> Vec<f64> {
        let n = self.places.len();
        let (x, stream) = (&self.places[i], &mut self.stream);
        let sign = |stream: &mut Stream| if stream.uniform() < 0.5 { 1.0 } else { -1.0 };
        let mut place = if stream.uniform() < self.options.hunt_probability {
            let attackers: Vec<&[f64]> = (stream.sample_indices(n, self.group).into_iter())
                .map(|j| self.places[j].as_slice())
                .collect();
            if stream.uniform() < self.options.group_probability {
                group_attack(x, &self.best, &attackers, self.beta1)
            } else {
                let other = &self.places[stream.below(n)];
                persecute(x, &self.best, other, self.beta1, self.beta2)
            }
        } else {
            let other = &self.places[stream.below(n)];
            scavenge(x, other, self.beta2, sign(stream))
        };
        if self.survival[i] <= LOWEST_SURVIVAL {
            let two = stream.sample_indices(n, 2);
            let (one, another) = (&self.places[two[0]], &self.places[two[1]]);
            place = replace(&self.best, one, another, sign(stream));
        }
        self.bounds.clip(&mut place);
        place
    }
}

impl Swarm for Pack {
    fn wish(&mut self) -> Wish {
        match self.next {
            Next::Start => Wish::values(self.places.clone()),
            Next::Dingo(i) => Wish::Values {
                points: vec![self.trial(i)],
                limit: f64::INFINITY,
                contest: Some(Contest {
                    rival: self.fitness[i].next_up(), // an equal value is taken, too
                    kind: 0,
                }),
            },
            Next::End => {
                self.survival = survival(&self.fitness, self.best_fitness);
                self.next = Next::Dingo(0);
                Wish::EndOfIteration
            }
        }
    }

    fn tell(&mut self, points: Vec<Vec<f64>>, values: &[f64]) {
        let i = match self.next {
            Next::Dingo(i) if !values.is_empty() => i,
            _ => {
                for (i, (point, &value)) in points.into_iter().zip(values).enumerate() {
                    self.fitness[i] = value;
                    if value < self.best_fitness {
                        (self.best, self.best_fitness) = (point, value);
                    }
                }
                self.next = Next::End;
                return;
            }
        };
        for (point, &value) in points.into_iter().zip(values) {
            if value <= self.best_fitness {
                self.best.clone_from(&point);
                self.best_fitness = value;
            }
            if value <= self.fitness[i] {
                (self.places[i], self.fitness[i]) = (point, value);
            }
        }
        self.next = if i + 1 < self.places.len() {
            Next::Dingo(i + 1)
        } else {
            Next::End
        };
    }

    fn best(&self) -> (&[f64], f64) {
        (&self.best, self.best_fitness)
    }

    fn population(&self) -> (Vec<Vec<f64>>, Vec<f64>) {
        (self.places.clone(), self.fitness.clone())
    }

    fn fork(&self) -> Box<dyn Swarm> {
        Box::new(self.clone())
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
