//! Calls of the objective: on all cores where that pays.
//!
//! Why: a whole population is shared by all threads at once. But hawks move one after another, and a
//! search that wants a single value leaves all threads but one idle. Where the objective is dear, the
//! others therefore look ahead: a copy of the search is told what became of most points of that kind
//! lately, better or not, and what it asks next is evaluated, too. If that was right, the next value is
//! there when it is wanted; if not, it is kept for a while. The search itself sees the same values in the
//! same order.
//! What to expect: with two threads seven to nine in ten of the values found ahead are used.
//! To know: values thrown away are not counted as evaluations of the search, because they depend on
//! the machine. With one thread there are none.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use crate::parallel;

use super::search::Contest;
use super::{Objective, Search};

/// Waking other threads costs some microseconds; work below this stays on one.
const WORTH_SHARING: Duration = Duration::from_micros(100);

/// One call in so many is timed, as long as the objective is not known to be dear.
const TIMED_CALL: usize = 32;

/// So many timed calls must all be worth sharing before threads look ahead: one of them may have been
/// interrupted.
const N_TIMED: usize = 4;

/// So many values found ahead are remembered for each thread: a point that was not asked for next may be
/// asked for soon, because the next hawk's way seldom depends on how this one fared.
const REMEMBERED: usize = 8;

/// Finds the values that a search asks for.
pub(super) struct Evaluator<'a> {
    objective: &'a dyn Objective,
    values: Vec<f64>,
    /// What the search may ask, the oldest first.
    foreseen: VecDeque<Foreseen>,
    n_calls: usize,
    /// How many calls on end were worth sharing.
    n_dear: usize,
    habits: Habits,
}

/// The share of points that were better lately, for each kind of contest.
#[derive(Debug, Clone, Copy, Default)]
struct Habits([f64; Contest::N_KINDS]);

impl Habits {
    /// Takes in how a contest ended.
    fn learn(&mut self, value: f64, contest: Contest) {
        let habit = &mut self.0[contest.kind];
        *habit += 0.1 * (f64::from(u8::from(value < contest.rival)) - *habit);
    }

    /// Values as they would be by habit at the points that `search` asks for: just better than the
    /// rival, or not better than anything.
    fn guess(&self, search: &Search) -> Vec<f64> {
        let value = match search.contest() {
            Some(contest) if self.0[contest.kind] > 0.5 => contest.rival.next_down(),
            _ => f64::INFINITY,
        };
        vec![value; search.ask().len()]
    }
}

/// A point that the search may ask for.
struct Foreseen {
    point: Vec<f64>,
    limit: f64,
    value: f64,
}

impl Foreseen {
    fn is(&self, point: &[f64], limit: f64) -> bool {
        let same = |(a, b): (&f64, &f64)| a.to_bits() == b.to_bits();
        self.point.iter().zip(point).all(same) && same((&self.limit, &limit))
    }
}

impl<'a> Evaluator<'a> {
    pub(super) fn new(objective: &'a dyn Objective) -> Self {
        Self {
            objective,
            values: Vec::new(),
            foreseen: VecDeque::new(),
            n_calls: 0,
            n_dear: 0,
            habits: Habits::default(),
        }
    }

    /// The values at the points that `search` asks for, in their order.
    pub(super) fn values(&mut self, search: &Search) -> &[f64] {
        self.values.clear();
        if self.n_dear >= N_TIMED && parallel::n_threads() > 1 {
            self.evaluate_and_look_ahead(search);
        } else {
            self.foreseen.clear();
            self.evaluate(search.ask(), search.limit());
        }
        if let (Some(contest), [value]) = (search.contest(), self.values.as_slice()) {
            self.habits.learn(*value, contest);
        }
        &self.values
    }

    /// A value that was found ahead.
    fn recall(&mut self, point: &[f64], limit: f64) -> Option<f64> {
        let at = self.foreseen.iter().position(|it| it.is(point, limit))?;
        self.foreseen.remove(at).map(|it| it.value)
    }

    /// Finds the values; several threads share many of them.
    fn evaluate(&mut self, points: &[Vec<f64>], limit: f64) {
        let Some((first, others)) = points.split_first() else {
            return;
        };
        let (value, duration) = self.first_value(first, limit, !others.is_empty());
        self.values.push(value);
        let value = |x: &Vec<f64>| value_at(self.objective, x, limit);
        if duration * others.len() as u32 > WORTH_SHARING {
            let shared = parallel::map(others.len(), |i| value(&others[i]));
            self.values.extend(shared);
        } else {
            self.values.extend(others.iter().map(value));
        }
    }

    /// A value, and how long it took, if it is worth the time to look at the clock.
    fn first_value(&mut self, point: &[f64], limit: f64, one_of_many: bool) -> (f64, Duration) {
        self.n_calls += 1;
        if !(one_of_many || self.n_dear > 0 || self.n_calls.is_multiple_of(TIMED_CALL)) {
            return (value_at(self.objective, point, limit), Duration::ZERO);
        }
        let begun = Instant::now();
        let value = value_at(self.objective, point, limit);
        let duration = begun.elapsed();
        self.n_dear = if duration > WORTH_SHARING {
            self.n_dear + 1
        } else {
            0
        };
        (value, duration)
    }

    /// Finds the values that were not found ahead and, by the threads that this would leave idle, those
    /// at the points that the search would ask for next if it went on as it has by habit.
    fn evaluate_and_look_ahead(&mut self, search: &Search) {
        let (points, limit) = (search.ask(), search.limit());
        let mut known: Vec<Option<f64>> = points.iter().map(|x| self.recall(x, limit)).collect();
        let missing: Vec<usize> = (0..points.len()).filter(|i| known[*i].is_none()).collect();
        if !missing.is_empty() {
            let n_threads = parallel::n_threads();
            let wanted = missing.iter().map(|i| (points[*i].clone(), limit));
            let mut wanted: Vec<(Vec<f64>, f64)> = wanted.collect();
            let mut guesses = self.habits.guess(search);
            for (guess, known) in guesses.iter_mut().zip(&known) {
                *guess = known.unwrap_or(*guess);
            }
            let n = wanted.len().next_multiple_of(n_threads);
            self.look_ahead(search, &guesses, n, &mut wanted);
            let objective = self.objective;
            let values = parallel::map(wanted.len(), |i| {
                value_at(objective, &wanted[i].0, wanted[i].1)
            });
            for (i, value) in missing.iter().zip(&values) {
                known[*i] = Some(*value);
            }
            let ahead = wanted.into_iter().zip(values).skip(missing.len());
            let ahead = ahead.map(|((point, limit), value)| Foreseen {
                point,
                limit,
                value,
            });
            self.foreseen.extend(ahead);
            let n_too_many = (self.foreseen.len()).saturating_sub(REMEMBERED * n_threads);
            self.foreseen.drain(..n_too_many);
        }
        self.values.extend(known.into_iter().flatten());
    }

    /// Adds to `wanted`, until it has `n` points, what `search` would ask for next, with the limits, if
    /// the values at the points that it asks for now were `guesses`, and all others as they are by
    /// habit, where they are not known already.
    fn look_ahead(
        &self,
        search: &Search,
        guesses: &[f64],
        n: usize,
        wanted: &mut Vec<(Vec<f64>, f64)>,
    ) {
        if wanted.len() >= n {
            return;
        }
        let mut fork = search.fork();
        let mut told = fork.tell(guesses);
        while told.is_ok() && !fork.is_over() && wanted.len() < n {
            let limit = fork.limit();
            let mut values = self.habits.guess(&fork);
            for (point, value) in fork.ask().iter().zip(&mut values) {
                match self.foreseen.iter().find(|it| it.is(point, limit)) {
                    Some(foreseen) => *value = foreseen.value,
                    None if wanted.len() < n => wanted.push((point.clone(), limit)),
                    None => {}
                }
            }
            told = fork.tell(&values);
        }
    }
}

fn value_at(objective: &dyn Objective, x: &[f64], limit: f64) -> f64 {
    if limit == f64::INFINITY {
        objective.evaluate(x)
    } else {
        objective.evaluate_below(x, limit)
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicUsize, Ordering};

    use super::*;
    use crate::optim::{Bounds, Method, Optimizer, Problem, SwarmOptions};
    use crate::parallel::with_threads;

    #[test]
    fn looking_ahead_changes_nothing_that_is_found() {
        let bounds = Bounds::cube(3, -4.0, 7.0).unwrap();
        let value = |x: &[f64]| x.iter().map(|x| (x - 1.0).abs()).sum::<f64>();
        let dear = |x: &[f64]| {
            std::thread::sleep(2 * WORTH_SHARING);
            value(x)
        };
        for method in Method::ALL {
            let options = SwarmOptions {
                population_size: Some(6),
                n_iterations: Some(8),
                ..SwarmOptions::new(method)
            };
            let expected = options.minimize(&value, &bounds, 3).unwrap();
            for n_threads in [1, 2, 4] {
                let found =
                    with_threads(Some(n_threads), || options.minimize(&dear, &bounds, 3)).unwrap();
                assert_eq!(found, expected, "{method:?} {n_threads}");
            }
        }
    }

    #[test]
    fn two_threads_need_little_more_than_half_as_many_rounds_of_calls() {
        for method in Method::ALL {
            for name in ["f1", "f5"] {
                let place = (0..10_i32).map(|i| f64::from(i % 4) - 1.5).collect();
                let problem = Problem::new(name, 10).unwrap().shifted(place).unwrap();
                let (n_called, mut n_rounds) = (AtomicUsize::new(0), 0);
                let counted = |x: &[f64]| {
                    n_called.fetch_add(1, Ordering::Relaxed);
                    problem.evaluate(x)
                };
                let options = SwarmOptions {
                    n_iterations: Some(100),
                    ..SwarmOptions::new(method)
                };
                let found = with_threads(Some(2), || {
                    let mut search = options.search(&problem.bounds()?, 4, &[])?;
                    let mut evaluator = Evaluator {
                        n_dear: N_TIMED,
                        ..Evaluator::new(&counted)
                    };
                    while !search.is_over() {
                        let n_before = n_called.load(Ordering::Relaxed);
                        search.tell(evaluator.values(&search))?;
                        n_rounds += (n_called.load(Ordering::Relaxed) - n_before).div_ceil(2);
                    }
                    Ok(search.minimum())
                })
                .unwrap();
                let serially = options.minimize(&problem, &problem.bounds().unwrap(), 4);
                assert_eq!(found, serially.unwrap());
                let gain = found.n_evaluations as f64 / n_rounds as f64;
                assert!(gain > 1.8, "{method:?} {name}: {gain}");
            }
        }
    }

    #[test]
    fn what_is_foreseen_is_what_is_asked_where_the_guess_is_right() {
        let bounds = Bounds::cube(2, -1.0, 1.0).unwrap();
        for method in [Method::Tmchho, Method::Hho, Method::Doa] {
            let options = SwarmOptions::new(method);
            for share in [0.0, 1.0] {
                let evaluator = Evaluator {
                    habits: Habits([share; Contest::N_KINDS]),
                    ..Evaluator::new(&|_: &[f64]| 0.0)
                };
                let guess = |search: &Search| evaluator.habits.guess(search);
                let mut search = options.search(&bounds, 5, &[]).unwrap();
                search.tell(&[1.0; 30]).unwrap();
                let mut ahead = Vec::new();
                evaluator.look_ahead(&search, &guess(&search), 70, &mut ahead);
                assert_eq!(ahead.len(), 70);
                let mut ahead = ahead.into_iter();
                while ahead.len() > 0 {
                    search.tell(&guess(&search)).unwrap();
                    for (asked, foreseen) in search.ask().iter().zip(&mut ahead) {
                        assert_eq!((asked, search.limit()), (&foreseen.0, foreseen.1));
                    }
                }
            }
        }
    }

    #[test]
    fn habits_follow_what_happens_in_contests_of_a_kind() {
        let contest = |kind| Contest { rival: 1.0, kind };
        let mut habits = Habits::default();
        for _ in 0..10 {
            habits.learn(0.5, contest(1));
            habits.learn(1.0, contest(2));
        }
        assert!(habits.0[1] > 0.6 && habits.0[2] == 0.0 && habits.0[0] == 0.0);
        for _ in 0..10 {
            habits.learn(1.0, contest(1));
        }
        assert!(habits.0[1] < 0.3);
    }
}
