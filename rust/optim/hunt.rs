//! One search by hawks: who is where, what is known of it, and who moves how.
//!
//! Why: the loop in [`HawkOptions`] reads like the paper's flowchart; its steps are here, the
//! equations they use in [`moves`].
//! Source and deviations: as in `hawks.rs`.

use crate::random::Stream;

use super::evaluator::Evaluator;
use super::{Bounds, HawkOptions, Minimum, Objective, StopReason, levy, moves};

/// The hawks, the prey and the random streams of one search.
pub(super) struct Hunt<'a> {
    options: &'a HawkOptions,
    bounds: &'a Bounds,
    pub(super) evaluator: Evaluator<'a>,
    hawks: Vec<Vec<f64>>,
    /// The value of every hawk where it is; `None` after a move whose value is not known yet. A
    /// hawk whose value is known is inside the box.
    fitness: Vec<Option<f64>>,
    pub(super) prey: Vec<f64>,
    pub(super) prey_fitness: f64,
    /// Two streams, so that the mutation does not reshuffle the moves.
    move_stream: Stream,
    mutation_stream: Stream,
}

impl<'a> Hunt<'a> {
    pub(super) fn new(
        options: &'a HawkOptions,
        objective: &'a dyn Objective,
        bounds: &'a Bounds,
        seed: u64,
        hawks: Vec<Vec<f64>>,
    ) -> Self {
        Self {
            options,
            bounds,
            evaluator: Evaluator::new(objective, options.max_evaluations),
            fitness: vec![None; hawks.len()],
            prey: hawks[0].clone(),
            prey_fitness: f64::INFINITY,
            hawks,
            move_stream: Stream::new(seed, "hawk moves", 0),
            mutation_stream: Stream::new(seed, "hawk mutation", 0),
        }
    }

    /// Clips and evaluates every hawk whose value is not known.
    pub(super) fn evaluate_hawks(&mut self) {
        let unknown: Vec<usize> = (0..self.hawks.len())
            .filter(|&i| self.fitness[i].is_none())
            .collect();
        for &i in &unknown {
            self.bounds.clip(&mut self.hawks[i]);
        }
        let points: Vec<&[f64]> = unknown.iter().map(|&i| self.hawks[i].as_slice()).collect();
        let values = self.evaluator.many(&points);
        for (i, value) in unknown.into_iter().zip(values) {
            self.fitness[i] = Some(value);
        }
    }

    /// The prey is the best so far; among equals, the first.
    pub(super) fn update_prey(&mut self) {
        for (hawk, fitness) in self.hawks.iter().zip(&self.fitness) {
            if let Some(fitness) = *fitness
                && fitness < self.prey_fitness
            {
                self.prey.clone_from(hawk);
                self.prey_fitness = fitness;
            }
        }
    }

    /// Moves the hawks one after another, in place: a hawk sees the new positions of those before
    /// it. Ends early where the calls of the objective are used up.
    pub(super) fn move_hawks(&mut self, iteration: usize) {
        for i in 0..self.hawks.len() {
            if self.move_hawk(i, iteration).is_none() {
                return;
            }
        }
    }

    /// `None` once the calls of the objective are used up, as in all that follow.
    fn move_hawk(&mut self, i: usize, iteration: usize) -> Option<()> {
        let e0 = self.move_stream.uniform_between(-1.0, 1.0);
        let energy = moves::escape_energy(e0, iteration, self.options.n_iterations);
        if energy.abs() >= 1.0 {
            return self.explore(i);
        }
        let before = self.known_fitness(i)?;
        if self.move_stream.uniform() >= 0.5 {
            self.besiege(i, energy)?;
        } else {
            self.dive(i, energy)?;
        }
        if self.options.trigonometric_mutation && self.known_fitness(i)? >= before {
            self.mutate(i)?;
        }
        Some(())
    }

    fn explore(&mut self, i: usize) -> Option<()> {
        let stream = &mut self.move_stream;
        let position = if stream.uniform() >= 0.5 {
            let random_hawk = stream.below(self.hawks.len());
            let (e1, e2) = (stream.uniform(), stream.uniform());
            moves::explore_from_hawk(&self.hawks[i], &self.hawks[random_hawk], e1, e2)
        } else {
            let (e3, e4) = (stream.uniform(), stream.uniform());
            let mean = moves::mean(&self.hawks);
            moves::explore_from_mean(&self.prey, &mean, self.bounds, e3, e4)
        };
        self.settle(i, position)
    }

    fn besiege(&mut self, i: usize, energy: f64) -> Option<()> {
        let position = if energy.abs() >= 0.5 {
            let jump = self.draw_jump();
            moves::soft_besiege(&self.hawks[i], &self.prey, energy, jump)
        } else {
            moves::hard_besiege(&self.hawks[i], &self.prey, energy)
        };
        self.settle(i, position)
    }

    /// Greedy: the hawk takes the first of two trial points that is better, or stays.
    fn dive(&mut self, i: usize, energy: f64) -> Option<()> {
        let jump = self.draw_jump();
        let first = if energy.abs() >= 0.5 {
            moves::dive(&self.hawks[i], &self.prey, energy, jump)
        } else {
            moves::dive(&moves::mean(&self.hawks), &self.prey, energy, jump)
        };
        if self.settle_if_better(i, first.clone())? {
            return Some(());
        }
        let stream = &mut self.move_stream;
        let s: Vec<f64> = first.iter().map(|_| stream.uniform()).collect();
        let flight: Vec<f64> = (first.iter())
            .map(|_| levy::step(stream.normal(), stream.normal(), self.options.levy_factor))
            .collect();
        self.settle_if_better(i, moves::fly_on(&first, &s, &flight))?;
        Some(())
    }

    /// Tries the mutation of three different hawks in place of a hawk that did not improve; of
    /// others than itself where there are enough.
    fn mutate(&mut self, i: usize) -> Option<()> {
        let n = self.hawks.len();
        if n < 3 {
            return Some(());
        }
        let stream = &mut self.mutation_stream;
        let chosen = if n == 3 {
            stream.sample_indices(n, 3)
        } else {
            let others = stream.sample_indices(n - 1, 3);
            others
                .into_iter()
                .map(|j| j + usize::from(j >= i))
                .collect()
        };
        let [a, b, c] = [chosen[0], chosen[1], chosen[2]];
        let o = stream.normal() * self.options.mutation_variance.sqrt();
        let fitness = [
            self.known_fitness(a)?,
            self.known_fitness(b)?,
            self.known_fitness(c)?,
        ];
        let position = moves::mutate([&self.hawks[a], &self.hawks[b], &self.hawks[c]], fitness, o);
        self.settle_if_better(i, position)?;
        Some(())
    }

    /// J, the strength of the prey's jump.
    fn draw_jump(&mut self) -> f64 {
        2.0 * (1.0 - self.move_stream.uniform())
    }

    /// Puts hawk `i` at `position`, better or not.
    fn settle(&mut self, i: usize, mut position: Vec<f64>) -> Option<()> {
        if self.options.trigonometric_mutation {
            self.bounds.clip(&mut position);
        }
        let is_unmoved =
            (position.iter().zip(&self.hawks[i])).all(|(a, b)| a.to_bits() == b.to_bits());
        if !is_unmoved {
            self.hawks[i] = position;
            self.fitness[i] = None;
        }
        if self.options.trigonometric_mutation {
            self.known_fitness(i)?;
        }
        Some(())
    }

    /// Puts hawk `i` at `position`, clipped, if it is better there, and says whether it was.
    fn settle_if_better(&mut self, i: usize, mut position: Vec<f64>) -> Option<bool> {
        let limit = self.known_fitness(i)?;
        self.bounds.clip(&mut position);
        let value = self.evaluator.one_below(&position, limit)?;
        let is_better = value < limit;
        if is_better {
            self.hawks[i] = position;
            self.fitness[i] = Some(value);
        }
        Some(is_better)
    }

    /// The value of hawk `i`, asked for only where it is not known.
    fn known_fitness(&mut self, i: usize) -> Option<f64> {
        if self.fitness[i].is_none() {
            self.fitness[i] = Some(self.evaluator.one(&self.hawks[i])?);
        }
        self.fitness[i]
    }

    pub(super) fn finish(self, history: Vec<f64>, stop_reason: StopReason) -> Minimum {
        Minimum {
            x: self.prey,
            fun: self.prey_fitness,
            n_evaluations: self.evaluator.n_evaluations,
            n_iterations: history.len(),
            n_nan: self.evaluator.n_nan,
            history,
            stop_reason,
            population: self.hawks,
            population_fitness: (self.fitness.into_iter())
                .map(|fitness| fitness.unwrap_or(f64::INFINITY))
                .collect(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hawk_on_the_prey_is_not_evaluated_again() {
        // Hard besiege by a hawk that is the prey: O_prey - E |0| is where it is already.
        let sphere = |x: &[f64]| x[0] * x[0];
        let bounds = Bounds::cube(1, -1.0, 1.0).unwrap();
        let options = HawkOptions::hho();
        let mut hunt = Hunt::new(&options, &sphere, &bounds, 0, vec![vec![0.5]]);
        hunt.evaluate_hawks();
        hunt.update_prey();
        hunt.besiege(0, 0.25).unwrap();
        hunt.evaluate_hawks();
        assert_eq!(hunt.hawks, [[0.5]]);
        assert_eq!(hunt.evaluator.n_evaluations, 1);
    }

    #[test]
    fn two_hawks_are_not_mutated_three_are() {
        let sphere = |x: &[f64]| x[0] * x[0];
        let bounds = Bounds::cube(1, -10.0, 10.0).unwrap();
        let options = HawkOptions {
            mutation_variance: 0.0,
            ..HawkOptions::tmchho()
        };
        let mutated = |hawks: &[f64]| {
            let hawks = hawks.iter().map(|x| vec![*x]).collect();
            let mut hunt = Hunt::new(&options, &sphere, &bounds, 0, hawks);
            hunt.evaluate_hawks();
            hunt.mutate(0).unwrap();
            hunt.hawks[0][0]
        };
        assert_eq!(mutated(&[5.0, 1.0]), 5.0);
        assert_eq!(mutated(&[5.0, 1.0, 0.0]), 2.0); // (5 + 1 + 0) / 3
        assert_eq!(mutated(&[5.0, 1.0, 0.0, 2.0]), 1.0); // the three others
        assert_eq!(mutated(&[0.5, 1.0, 0.0, 2.0]), 0.5); // no better, so it stays
    }
}
