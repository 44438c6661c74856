//! One search by hawks: who is where, what is known of it, and who moves how.
//!
//! Why: hawks move one after another, and where a move depends on a value the search has to ask and
//! wait. What it waits for is written down here; the equations are in [`moves`].
//! Source and deviations: as in `hawks.rs`.

use crate::random::Stream;

use super::search::{Contest, Swarm, Wish};
use super::{Bounds, HawkOptions, MutationReading, levy, moves};

/// The hawks, the prey and the random streams of one search.
#[derive(Debug, Clone)]
pub(super) struct Hunt {
    options: HawkOptions,
    bounds: Bounds,
    hawks: Vec<Vec<f64>>,
    /// The value of every hawk where it is; `None` after a move whose value is not known yet. A
    /// hawk whose value is known is inside the box.
    fitness: Vec<Option<f64>>,
    prey: Vec<f64>,
    prey_fitness: f64,
    /// Two streams, so that the mutation does not reshuffle the moves.
    move_stream: Stream,
    mutation_stream: Stream,
    n_iterations_done: usize,
    task: Task,
    question: Question,
}

/// What is to be done next.
#[derive(Debug, Clone)]
enum Task {
    /// Look at every hawk whose value is not known.
    Look,
    /// Bring the prey up to date: the iteration is over.
    Update,
    /// Move this hawk, and those after it.
    Move(usize),
    /// Fly on from the first trial point of a dive that was no better.
    FlyOn {
        hawk: usize,
        attack: Attack,
        first: Vec<f64>,
    },
    /// See whether a hawk that besieged or dived, and had this value before, is to be mutated.
    Judge { hawk: usize, attack: Attack },
}

/// A hawk's move in the development stage, and its value before.
#[derive(Debug, Clone, Copy)]
struct Attack {
    is_dive: bool,
    is_soft: bool,
    fitness_before: f64,
}

impl Attack {
    /// Whether it betters the hawk.
    fn contest(self) -> Contest {
        self.contest_of_kind(2 * usize::from(self.is_dive) + usize::from(self.is_soft))
    }

    /// Whether the second trial point of a dive does.
    fn second_contest(self) -> Contest {
        self.contest_of_kind(4)
    }

    fn contest_of_kind(self, kind: usize) -> Contest {
        Contest {
            rival: self.fitness_before,
            kind,
        }
    }
}

/// Whose value was asked for.
#[derive(Debug, Clone)]
enum Question {
    /// Of these hawks, all at once.
    Hawks(Vec<usize>),
    /// Of a hawk that has moved, better or not.
    Moved { hawk: usize, attack: Option<Attack> },
    /// Of the first trial point of a dive, here before it was clipped.
    FirstTrial {
        hawk: usize,
        attack: Attack,
        first: Vec<f64>,
    },
    /// Of the second one.
    SecondTrial { hawk: usize, attack: Attack },
    /// Of a mutation.
    Mutation { hawk: usize },
}

impl Hunt {
    pub(super) fn new(
        options: &HawkOptions,
        bounds: &Bounds,
        seed: u64,
        hawks: Vec<Vec<f64>>,
    ) -> Self {
        Self {
            options: options.clone(),
            bounds: bounds.clone(),
            fitness: vec![None; hawks.len()],
            prey: hawks[0].clone(),
            prey_fitness: f64::INFINITY,
            hawks,
            move_stream: Stream::new(seed, "hawk moves", 0),
            mutation_stream: Stream::new(seed, "hawk mutation", 0),
            n_iterations_done: 0,
            task: Task::Look,
            question: Question::Hawks(Vec::new()),
        }
    }

    /// Clips every hawk whose value is not known, and asks for it.
    fn look(&mut self) -> Option<Wish> {
        self.task = Task::Update;
        let unknown: Vec<usize> = (0..self.hawks.len())
            .filter(|&i| self.fitness[i].is_none())
            .collect();
        for &i in &unknown {
            self.bounds.clip(&mut self.hawks[i]);
        }
        let points: Vec<Vec<f64>> = unknown.iter().map(|&i| self.hawks[i].clone()).collect();
        self.question = Question::Hawks(unknown);
        (!points.is_empty()).then_some(Wish::values(points))
    }

    /// The prey is the best so far; among equals, the first.
    fn update_prey(&mut self) {
        for (hawk, fitness) in self.hawks.iter().zip(&self.fitness) {
            if let Some(fitness) = *fitness
                && fitness < self.prey_fitness
            {
                self.prey.clone_from(hawk);
                self.prey_fitness = fitness;
            }
        }
    }

    /// Moves hawk `i`, which sees the new positions of those before it.
    fn move_hawk(&mut self, i: usize) -> Option<Wish> {
        let Some(fitness_before) = self.fitness.get(i).copied().flatten() else {
            // All have moved, or the calls of the objective are used up.
            self.task = Task::Look;
            return None;
        };
        self.task = Task::Move(i + 1);
        let e0 = self.move_stream.uniform_between(-1.0, 1.0);
        let iteration = self.n_iterations_done - 1;
        let energy = moves::escape_energy(e0, iteration, self.options.n_iterations);
        if energy.abs() >= 1.0 {
            let position = self.explore(i);
            return self.settle(i, position, None);
        }
        let attack = Attack {
            is_dive: self.move_stream.uniform() < 0.5,
            is_soft: energy.abs() >= 0.5,
            fitness_before,
        };
        if !attack.is_dive {
            let position = self.besiege(i, energy);
            return self.settle(i, position, Some(attack));
        }
        let first = self.dive(i, energy);
        let wish = self.wish_for_better(first.clone(), attack.contest());
        self.question = Question::FirstTrial {
            hawk: i,
            attack,
            first,
        };
        Some(wish)
    }

    fn explore(&mut self, i: usize) -> Vec<f64> {
        let stream = &mut self.move_stream;
        if stream.uniform() >= 0.5 {
            let random_hawk = stream.below(self.hawks.len());
            let (e1, e2) = (stream.uniform(), stream.uniform());
            let of = [self.hawks[i].as_slice(), &self.hawks[random_hawk]];
            self.in_frame(of, |[hawk, random_hawk]| {
                moves::explore_from_hawk(hawk, random_hawk, e1, e2)
            })
        } else {
            let (e3, e4) = (stream.uniform(), stream.uniform());
            let mean = moves::mean(&self.hawks);
            let of = [&self.prey, &mean, self.bounds.low(), self.bounds.high()];
            self.in_frame(of, |[prey, mean, low, high]| {
                moves::explore_from_mean(prey, mean, low, high, e3, e4)
            })
        }
    }

    fn besiege(&mut self, i: usize, energy: f64) -> Vec<f64> {
        if energy.abs() >= 0.5 {
            let jump = self.draw_jump();
            self.in_frame([&self.hawks[i], &self.prey], |[hawk, prey]| {
                moves::soft_besiege(hawk, prey, energy, jump)
            })
        } else {
            moves::hard_besiege(&self.hawks[i], &self.prey, energy)
        }
    }

    /// The first trial point; greedy: the hawk will take the first of two that is better, or stay.
    fn dive(&mut self, i: usize, energy: f64) -> Vec<f64> {
        let jump = self.draw_jump();
        let rule = |[centre, prey]: [&[f64]; 2]| moves::dive(centre, prey, energy, jump);
        if energy.abs() >= 0.5 {
            self.in_frame([&self.hawks[i], &self.prey], rule)
        } else {
            self.in_frame([&moves::mean(&self.hawks), &self.prey], rule)
        }
    }

    fn fly_on(&mut self, i: usize, attack: Attack, first: &[f64]) -> Wish {
        let stream = &mut self.move_stream;
        let s: Vec<f64> = first.iter().map(|_| stream.uniform()).collect();
        let normals: Vec<[f64; 2]> = (first.iter())
            .map(|_| [stream.normal(), stream.normal()])
            .collect();
        let flight = levy::flight(&normals, self.options.levy_factor);
        self.question = Question::SecondTrial { hawk: i, attack };
        self.wish_for_better(moves::fly_on(first, &s, &flight), attack.second_contest())
    }

    /// Asks for the mutation of three hawks other than this one, if it is this one's turn.
    fn judge(&mut self, i: usize, attack: Attack) -> Option<Wish> {
        self.task = Task::Move(i + 1);
        let fitness = self.fitness[i]?;
        let is_stagnant = fitness >= attack.fitness_before;
        let is_mutated = self.options.trigonometric_mutation
            && match self.options.mutation_reading {
                MutationReading::Stagnant => is_stagnant,
                MutationReading::EveryHawk => true,
                MutationReading::AfterDives => is_stagnant && attack.is_dive,
                MutationReading::AfterBesieges => is_stagnant && !attack.is_dive,
            };
        if !is_mutated {
            return None;
        }
        let others = self
            .mutation_stream
            .sample_indices(self.hawks.len() - 1, 3)
            .into_iter()
            .map(|j| j + usize::from(j >= i))
            .collect::<Vec<_>>();
        let [a, b, c] = [others[0], others[1], others[2]];
        let o = self.draw_mutation_factor();
        let fitness_of = [self.fitness[a]?, self.fitness[b]?, self.fitness[c]?];
        let position = moves::mutate(
            [&self.hawks[a], &self.hawks[b], &self.hawks[c]],
            fitness_of,
            o,
        );
        self.question = Question::Mutation { hawk: i };
        let contest = Contest {
            rival: fitness,
            kind: 5,
        };
        Some(self.wish_for_better(position, contest))
    }

    /// J, the strength of the prey's jump.
    fn draw_jump(&mut self) -> f64 {
        2.0 * (1.0 - self.move_stream.uniform())
    }

    /// o of Eq. (7), from N(0, variance).
    fn draw_mutation_factor(&mut self) -> f64 {
        self.options.mutation_variance.sqrt() * self.mutation_stream.normal()
    }

    /// What `rule` makes of these positions; where the search is to be translation-invariant, in
    /// coordinates whose origin is the prey.
    fn in_frame<const N: usize>(
        &self,
        of: [&[f64]; N],
        rule: impl FnOnce([&[f64]; N]) -> Vec<f64>,
    ) -> Vec<f64> {
        if !self.options.translation_invariant {
            return rule(of);
        }
        let relative = of.map(|x| -> Vec<f64> {
            (x.iter().zip(&self.prey))
                .map(|(x, prey)| x - prey)
                .collect()
        });
        let mut position = rule(std::array::from_fn(|i| relative[i].as_slice()));
        for (x, prey) in position.iter_mut().zip(&self.prey) {
            *x += prey;
        }
        position
    }

    /// Puts hawk `i` at `position`, better or not; its value is asked for at once only where the
    /// mutation is on, which needs the values of all.
    fn settle(&mut self, i: usize, mut position: Vec<f64>, attack: Option<Attack>) -> Option<Wish> {
        if self.options.trigonometric_mutation {
            self.bounds.clip(&mut position);
        }
        let is_unmoved =
            (position.iter().zip(&self.hawks[i])).all(|(a, b)| a.to_bits() == b.to_bits());
        if is_unmoved {
            if let Some(attack) = attack {
                self.task = Task::Judge { hawk: i, attack };
            }
            return None;
        }
        self.hawks[i] = position;
        self.fitness[i] = None;
        if !self.options.trigonometric_mutation {
            return None;
        }
        self.question = Question::Moved { hawk: i, attack };
        Some(Wish::Values {
            points: vec![self.hawks[i].clone()],
            limit: f64::INFINITY,
            contest: attack.map(Attack::contest),
        })
    }

    fn wish_for_better(&self, mut position: Vec<f64>, contest: Contest) -> Wish {
        self.bounds.clip(&mut position);
        Wish::Values {
            points: vec![position],
            limit: contest.rival,
            contest: Some(contest),
        }
    }

    /// Puts hawk `i` at the only one of `points` if it is better there, and says whether it was.
    fn settle_if_better(&mut self, i: usize, points: Vec<Vec<f64>>, value: f64) -> bool {
        let is_better = self.fitness[i].is_some_and(|fitness| value < fitness);
        if is_better {
            self.hawks[i] = points.into_iter().next().unwrap_or_default();
            self.fitness[i] = Some(value);
        }
        is_better
    }
}

impl Swarm for Hunt {
    fn wish(&mut self) -> Wish {
        loop {
            let wish = match std::mem::replace(&mut self.task, Task::Look) {
                Task::Look => self.look(),
                Task::Update => {
                    self.update_prey();
                    self.n_iterations_done += 1;
                    self.task = Task::Move(0);
                    return Wish::EndOfIteration;
                }
                Task::Move(hawk) => self.move_hawk(hawk),
                Task::FlyOn {
                    hawk,
                    attack,
                    first,
                } => Some(self.fly_on(hawk, attack, &first)),
                Task::Judge { hawk, attack } => self.judge(hawk, attack),
            };
            if let Some(wish) = wish {
                return wish;
            }
        }
    }

    fn tell(&mut self, points: Vec<Vec<f64>>, values: &[f64]) {
        let question = std::mem::replace(&mut self.question, Question::Hawks(Vec::new()));
        if let Question::Hawks(hawks) = question {
            for (i, value) in hawks.into_iter().zip(values) {
                self.fitness[i] = Some(*value);
            }
            return;
        }
        let Some(&value) = values.first() else {
            self.task = Task::Look;
            return;
        };
        match question {
            Question::Hawks(_) => {}
            Question::Moved { hawk, attack } => {
                self.fitness[hawk] = Some(value);
                self.task =
                    attack.map_or(Task::Move(hawk + 1), |attack| Task::Judge { hawk, attack });
            }
            Question::FirstTrial {
                hawk,
                attack,
                first,
            } => {
                self.task = if self.settle_if_better(hawk, points, value) {
                    Task::Judge { hawk, attack }
                } else {
                    Task::FlyOn {
                        hawk,
                        attack,
                        first,
                    }
                };
            }
            Question::SecondTrial { hawk, attack } => {
                self.settle_if_better(hawk, points, value);
                self.task = Task::Judge { hawk, attack };
            }
            Question::Mutation { hawk } => {
                self.settle_if_better(hawk, points, value);
                self.task = Task::Move(hawk + 1);
            }
        }
    }

    fn best(&self) -> (&[f64], f64) {
        (&self.prey, self.prey_fitness)
    }

    fn population(&self) -> (Vec<Vec<f64>>, Vec<f64>) {
        let mut hawks = self.hawks.clone();
        for hawk in &mut hawks {
            self.bounds.clip(hawk);
        }
        let fitness = (self.fitness.iter())
            .map(|fitness| fitness.unwrap_or(f64::INFINITY))
            .collect();
        (hawks, fitness)
    }

    fn fork(&self) -> Box<dyn Swarm> {
        Box::new(self.clone())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sphere(x: &[f64]) -> f64 {
        x.iter().map(|x| x * x).sum()
    }

    /// Hawks at `positions` on a line, whose values are known, before their first move.
    fn hunt(options: &HawkOptions, f: fn(&[f64]) -> f64, positions: &[f64]) -> Hunt {
        let bounds = Bounds::cube(1, -10.0, 10.0).unwrap();
        let hawks = positions.iter().map(|x| vec![*x]).collect();
        let mut hunt = Hunt::new(options, &bounds, 0, hawks);
        answer(&mut hunt, f);
        hunt
    }

    /// Tells what is asked until the iteration is over, and how many values that took.
    fn answer(hunt: &mut Hunt, f: fn(&[f64]) -> f64) -> usize {
        let mut n_values = 0;
        while let Wish::Values { points, .. } = hunt.wish() {
            let values: Vec<f64> = points.iter().map(|x| f(x)).collect();
            n_values += values.len();
            hunt.tell(points, &values);
        }
        n_values
    }

    /// Judges hawk `i`, which has not improved, and tells what is asked.
    fn mutate(hunt: &mut Hunt, i: usize, f: fn(&[f64]) -> f64) {
        let attack = Attack {
            is_dive: false,
            is_soft: false,
            fitness_before: f64::NEG_INFINITY,
        };
        if let Some(Wish::Values { points, .. }) = hunt.judge(i, attack) {
            let value = f(&points[0]);
            hunt.tell(points, &[value]);
        }
    }

    #[test]
    fn a_hawk_on_the_prey_is_not_evaluated_again() {
        let mut hunt = hunt(&HawkOptions::hho(), sphere, &[0.5]);
        // O_prey - E |O_prey - O| is where it is already.
        let position = hunt.besiege(0, 0.25);
        assert!(hunt.settle(0, position, None).is_none());
        assert_eq!(
            (&hunt.hawks[0][..], hunt.fitness[0]),
            (&[0.5][..], Some(0.25))
        );
    }

    #[test]
    fn besieges_move_a_hawk_for_better_or_worse_and_dives_only_for_better() {
        let mut hunt = hunt(&HawkOptions::hho(), |_| 1.0, &[0.0, 4.0]);
        let attack = Attack {
            is_dive: true,
            is_soft: false,
            fitness_before: 1.0,
        };
        let first = hunt.dive(1, 0.25);
        hunt.question = Question::FirstTrial {
            hawk: 1,
            attack,
            first: first.clone(),
        };
        hunt.tell(vec![first], &[1.0]);
        let Wish::Values { points, limit, .. } = hunt.wish() else {
            panic!("the second trial point is tried as well");
        };
        assert_eq!(limit, 1.0);
        hunt.tell(points, &[1.0]);
        assert_eq!(hunt.hawks[1], [4.0], "neither was better");

        let position = hunt.besiege(1, 0.25);
        assert!(hunt.settle(1, position, None).is_none(), "asked for later");
        assert_eq!(hunt.hawks[1], [-1.0]); // 0 - 0.25 * |0 - 4|
        assert_eq!(hunt.fitness[1], None);
    }

    #[test]
    fn the_prey_stays_until_all_hawks_have_moved() {
        let mut hunt = hunt(&HawkOptions::tmchho(), sphere, &[3.0; 30]);
        hunt.n_iterations_done = 400;
        let mut n_told = 0;
        while let Wish::Values { points, .. } = hunt.wish() {
            assert_eq!((hunt.prey[0], hunt.prey_fitness), (3.0, 9.0));
            let values: Vec<f64> = points.iter().map(|x| sphere(x)).collect();
            n_told += values.len();
            hunt.tell(points, &values);
        }
        let best = (hunt.fitness.iter().flatten()).fold(f64::INFINITY, |a, b| a.min(*b));
        assert!(n_told > 30 && best < 9.0);
        assert_eq!(hunt.prey_fitness, best);
    }

    #[test]
    fn a_stagnant_hawk_takes_the_mutation_of_three_others_if_it_is_better() {
        let options = HawkOptions {
            mutation_variance: 0.0,
            ..HawkOptions::tmchho()
        };
        let mutated = |positions: &[f64]| {
            let mut hunt = hunt(&options, sphere, positions);
            mutate(&mut hunt, 0, sphere);
            hunt.hawks[0][0]
        };
        assert_eq!(mutated(&[5.0, 1.0, 0.0, 2.0]), 1.0); // (1 + 0 + 2) / 3
        assert_eq!(mutated(&[0.5, 1.0, 0.0, 2.0]), 0.5); // no better, so it stays
    }

    #[test]
    fn the_reading_says_who_is_mutated() {
        use MutationReading::{AfterBesieges, AfterDives, EveryHawk, Stagnant};
        let is_mutated = |mutation_reading, is_dive, fitness_before| {
            let options = HawkOptions {
                mutation_reading,
                ..HawkOptions::tmchho()
            };
            let mut hunt = hunt(&options, sphere, &[2.0, 1.0, 0.0, 3.0]);
            let attack = Attack {
                is_dive,
                is_soft: false,
                fitness_before,
            };
            hunt.judge(0, attack).is_some()
        };
        // Hawk 0 has the value 4: it improved on 5, not on 4.
        for (reading, expected) in [
            (Stagnant, [true, true, false, false]),
            (EveryHawk, [true, true, true, true]),
            (AfterDives, [true, false, false, false]),
            (AfterBesieges, [false, true, false, false]),
        ] {
            let found = [(true, 4.0), (false, 4.0), (true, 5.0), (false, 5.0)]
                .map(|(is_dive, before)| is_mutated(reading, is_dive, before));
            assert_eq!(found, expected, "{reading:?}");
        }
    }

    #[test]
    fn without_further_values_the_iteration_ends() {
        let mut hunt = hunt(&HawkOptions::tmchho(), sphere, &[3.0, 4.0, 5.0, 6.0]);
        while let Wish::Values { points, .. } = hunt.wish() {
            hunt.tell(points, &[]);
        }
        assert_eq!((hunt.prey[0], hunt.n_iterations_done), (3.0, 2));
    }

    #[test]
    fn random_factors_have_the_moments_of_the_paper() {
        let mut hunt = hunt(&HawkOptions::tmchho(), sphere, &[1.0]);
        let n = 100_000;
        let squares: f64 = (0..n).map(|_| hunt.draw_mutation_factor().powi(2)).sum();
        assert!((squares / f64::from(n) - 0.1).abs() < 0.003, "{squares}");
        let jumps: f64 = (0..n).map(|_| hunt.draw_jump()).sum();
        assert!((jumps / f64::from(n) - 1.0).abs() < 0.01, "{jumps}");
    }
}
