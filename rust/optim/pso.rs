//! Particle swarm optimisation (PSO): every particle is drawn to its own best place and to the best
//! of all.
//!
//! Source: Kennedy & Eberhart (1995), with the falling inertia of Shi & Eberhart (1998); Ren, Zhao &
//! Han (2023), Table 2, for the two factors.
//! Deviates: inertia, first velocity and speed limit are not in the paper; here the inertia falls
//! from 0.9 to 0.4, the particles start at rest, and there is no speed limit. A particle that would
//! leave the box stops at its edge and keeps its velocity.

use crate::error::{Result, require_between};
use crate::random::Stream;

use super::crowd::{AtOnce, Crowd, MovesAtOnce};
use super::search::Search;
use super::start::{self, Spread};
use super::{Bounds, Budget, Optimizer};

/// Settings of the particle swarm.
#[derive(Debug, Clone, PartialEq)]
pub struct PsoOptions {
    /// Size of the swarm and limits of the search.
    pub budget: Budget,
    /// Factor of the way to the particle's own best place; ≥ 0.
    pub local: f64,
    /// Factor of the way to the best place of all; ≥ 0.
    pub social: f64,
    /// Share of the velocity that is kept in the first iteration; ≥ 0.
    pub first_inertia: f64,
    /// The same in the last iteration, reached evenly; ≥ 0.
    pub last_inertia: f64,
}

impl Default for PsoOptions {
    fn default() -> Self {
        Self {
            budget: Budget::default(),
            local: 0.8,
            social: 1.0,
            first_inertia: 0.9,
            last_inertia: 0.4,
        }
    }
}

/// The new velocity of a particle; `r1` and `r2` are drawn from U(0, 1) for each coordinate.
///
/// ```
/// use tmchho::optim::{PsoOptions, pso};
/// let options = PsoOptions::default();
/// // 0.5 * 2 + 0.8 * 0.5 * (4 - 1) + 1 * 0.25 * (5 - 1)
/// let v = pso::velocity(&options, 0.5, &[2.0], &[1.0], &[4.0], &[5.0], &[0.5], &[0.25]);
/// assert!((v[0] - 3.2).abs() < 1e-15);
/// ```
#[allow(clippy::too_many_arguments)] // one for each letter of the equation
pub fn velocity(
    options: &PsoOptions,
    inertia: f64,
    velocity: &[f64],
    place: &[f64],
    own_best: &[f64],
    best: &[f64],
    r1: &[f64],
    r2: &[f64],
) -> Vec<f64> {
    (0..place.len())
        .map(|d| {
            inertia * velocity[d]
                + options.local * r1[d] * (own_best[d] - place[d])
                + options.social * r2[d] * (best[d] - place[d])
        })
        .collect()
}

/// The share of the velocity that is kept in the move after iteration `iteration`, counted from 0.
///
/// ```
/// use tmchho::optim::{PsoOptions, pso};
/// assert_eq!(pso::inertia(&PsoOptions::default(), 50, 101), 0.65);
/// ```
pub fn inertia(options: &PsoOptions, iteration: usize, n_iterations: usize) -> f64 {
    let last = n_iterations.saturating_sub(1).max(1);
    let share = iteration as f64 / last as f64;
    options.first_inertia + (options.last_inertia - options.first_inertia) * share
}

impl Optimizer for PsoOptions {
    fn search(&self, bounds: &Bounds, seed: u64, start: &[Vec<f64>]) -> Result<Search> {
        self.budget.check("population_size")?;
        for (name, value) in [
            ("local", self.local),
            ("social", self.social),
            ("first_inertia", self.first_inertia),
            ("last_inertia", self.last_inertia),
        ] {
            require_between(name, value, 0.0, f64::MAX)?;
        }
        let n = self.budget.population_size;
        let places = start::population(Spread::Uniform, n, bounds, seed, start)?;
        let flock = Flock {
            options: self.clone(),
            velocities: vec![vec![0.0; bounds.dimension()]; n],
            own_bests: places.clone(),
            own_best_fitness: vec![f64::INFINITY; n],
            stream: Stream::new(seed, "particle moves", 0),
        };
        let search = AtOnce::new(places, bounds, flock);
        Ok(Search::new(Box::new(search), &self.budget))
    }
}

/// What the particles have besides their places.
#[derive(Clone)]
struct Flock {
    options: PsoOptions,
    velocities: Vec<Vec<f64>>,
    own_bests: Vec<Vec<f64>>,
    own_best_fitness: Vec<f64>,
    stream: Stream,
}

impl MovesAtOnce for Flock {
    fn move_all(&mut self, crowd: &mut Crowd, iteration: usize) {
        let n_iterations = self.options.budget.n_iterations;
        let inertia = inertia(&self.options, iteration, n_iterations);
        for i in 0..crowd.places.len() {
            let mut draw =
                || -> Vec<f64> { (crowd.best.iter()).map(|_| self.stream.uniform()).collect() };
            let (r1, r2) = (draw(), draw());
            self.velocities[i] = velocity(
                &self.options,
                inertia,
                &self.velocities[i],
                &crowd.places[i],
                &self.own_bests[i],
                &crowd.best,
                &r1,
                &r2,
            );
            for (x, v) in crowd.places[i].iter_mut().zip(&self.velocities[i]) {
                *x += v;
            }
        }
    }

    fn learn(&mut self, crowd: &Crowd) {
        for (i, &value) in crowd.fitness.iter().enumerate() {
            if value < self.own_best_fitness[i] {
                self.own_best_fitness[i] = value;
                self.own_bests[i].clone_from(&crowd.places[i]);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn velocity_by_hand() {
        let options = PsoOptions {
            local: 2.0,
            social: 4.0,
            ..PsoOptions::default()
        };
        // 0.5 * [4, -2] + 2 * [0.5, 1] * ([3, 1] - [1, 0]) + 4 * [0.25, 0.5] * ([1, 2] - [1, 0])
        let v = velocity(
            &options,
            0.5,
            &[4.0, -2.0],
            &[1.0, 0.0],
            &[3.0, 1.0],
            &[1.0, 2.0],
            &[0.5, 1.0],
            &[0.25, 0.5],
        );
        assert_eq!(v, [4.0, 5.0]); // [2 + 2 + 0, -1 + 2 + 4]
    }

    #[test]
    fn inertia_falls_evenly() {
        let options = PsoOptions::default();
        assert_eq!(inertia(&options, 0, 100), 0.9);
        assert!((inertia(&options, 99, 100) - 0.4).abs() < 1e-15);
        assert_eq!(inertia(&options, 0, 1), 0.9);
    }
}
