//! Calls of the objective: on all cores where that pays.
//!
//! Why: a whole population is shared by all threads at once. But hawks move one after another, and a
//! search that wants a single value leaves all threads but one idle. Where the objective is dear, the
//! others therefore look ahead: a copy of the search is told what became of most points lately, better
//! or not, and what it asks next is evaluated, too. If that was right, the next value is there when it
//! is wanted; if not, it is thrown away. The search itself sees the same values in the same order.
//! To know: values thrown away are not counted as evaluations of the search, because they depend on
//! the machine. With one thread there are none.

use std::time::{Duration, Instant};

use crate::parallel;

use super::{Objective, Search};

/// Waking other threads costs some microseconds; work below this stays on one.
const WORTH_SHARING: Duration = Duration::from_micros(100);

/// One call in so many is timed, as long as the objective is not known to be dear.
const TIMED_CALL: usize = 32;

/// So many timed calls must all be worth sharing before threads look ahead: one of them may have been
/// interrupted.
const N_TIMED: usize = 4;

/// Finds the values that a search asks for.
pub(super) struct Evaluator<'a> {
    objective: &'a dyn Objective,
    values: Vec<f64>,
    /// What the search may ask next, in the order in which it would.
    foreseen: Vec<Foreseen>,
    n_calls: usize,
    /// How many calls on end were worth sharing.
    n_dear: usize,
    habits: Habits,
}

/// The share of points that were better lately: of those a member goes to in any case, and of those
/// it only goes to if they are better.
#[derive(Debug, Clone, Copy, Default)]
struct Habits {
    of_moves: f64,
    of_trials: f64,
}

impl Habits {
    fn of(&mut self, limit: f64) -> &mut f64 {
        if limit == f64::INFINITY {
            &mut self.of_moves
        } else {
            &mut self.of_trials
        }
    }

    /// Takes in whether the value was better than that of its rival, if it has one.
    fn learn(&mut self, value: f64, limit: f64, rival: f64) {
        if rival < f64::INFINITY {
            let habit = self.of(limit);
            *habit += 0.1 * (f64::from(u8::from(value < rival)) - *habit);
        }
    }

    /// A value that is better, or not, as most were.
    fn guess(&mut self, limit: f64) -> f64 {
        if *self.of(limit) > 0.5 {
            f64::NEG_INFINITY
        } else {
            f64::INFINITY
        }
    }
}

struct Foreseen {
    point: Vec<f64>,
    limit: f64,
    value: f64,
}

impl<'a> Evaluator<'a> {
    pub(super) fn new(objective: &'a dyn Objective) -> Self {
        Self {
            objective,
            values: Vec::new(),
            foreseen: Vec::new(),
            n_calls: 0,
            n_dear: 0,
            habits: Habits::default(),
        }
    }

    /// The values at the points that `search` asks for, in their order.
    pub(super) fn values(&mut self, search: &Search) -> &[f64] {
        self.values.clear();
        let (points, limit) = (search.ask(), search.limit());
        if let [point] = points {
            let value = self.single(search, point, limit);
            self.values.push(value);
        } else if let [first, others @ ..] = points {
            let (value, duration) = self.timed(first, limit);
            self.values.push(value);
            let value = |x: &Vec<f64>| value_at(self.objective, x, limit);
            if duration * others.len() as u32 > WORTH_SHARING {
                let shared = parallel::map(others.len(), |i| value(&others[i]));
                self.values.extend(shared);
            } else {
                self.values.extend(others.iter().map(value));
            }
        }
        &self.values
    }

    fn single(&mut self, search: &Search, point: &[f64], limit: f64) -> f64 {
        if !self.foreseen.is_empty() {
            let Foreseen {
                point: foreseen,
                limit: foreseen_limit,
                value,
            } = self.foreseen.remove(0);
            let same = |(a, b): (&f64, &f64)| a.to_bits() == b.to_bits();
            if foreseen.iter().zip(point).all(same) && same((&foreseen_limit, &limit)) {
                self.habits.learn(value, limit, search.rival());
                return value;
            }
            self.foreseen.clear();
        }
        self.n_calls += 1;
        if self.n_dear < N_TIMED {
            return if self.n_calls.is_multiple_of(TIMED_CALL) || self.n_dear > 0 {
                self.timed(point, limit).0
            } else {
                value_at(self.objective, point, limit)
            };
        }
        let n_threads = parallel::n_threads();
        if n_threads == 1 {
            return value_at(self.objective, point, limit);
        }
        let ahead = look_ahead(search, n_threads, self.habits);
        let values = parallel::map(ahead.len(), |i| {
            value_at(self.objective, &ahead[i].point, ahead[i].limit)
        });
        self.foreseen = ahead;
        for (foreseen, value) in self.foreseen.iter_mut().zip(values) {
            foreseen.value = value;
        }
        let value = self.foreseen.remove(0).value;
        self.habits.learn(value, limit, search.rival());
        value
    }

    fn timed(&mut self, point: &[f64], limit: f64) -> (f64, Duration) {
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
}

fn value_at(objective: &dyn Objective, x: &[f64], limit: f64) -> f64 {
    if limit == f64::INFINITY {
        objective.evaluate(x)
    } else {
        objective.evaluate_below(x, limit)
    }
}

/// The single point that `search` asks for, and those that it would ask for next if all points were
/// what they have been by habit; `n` at most. Their values are still to be found.
fn look_ahead(search: &Search, n: usize, mut habits: Habits) -> Vec<Foreseen> {
    let mut fork = search.fork();
    let mut ahead: Vec<Foreseen> = Vec::with_capacity(n);
    while let [point] = fork.ask()
        && ahead.len() < n
    {
        let limit = fork.limit();
        ahead.push(Foreseen {
            point: point.clone(),
            limit,
            value: f64::NAN,
        });
        if fork.tell(&[habits.guess(limit)]).is_err() {
            break;
        }
    }
    ahead
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optim::{Bounds, Method, Optimizer, SwarmOptions};
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
    fn what_is_foreseen_is_what_is_asked_where_the_guess_is_right() {
        let bounds = Bounds::cube(2, -1.0, 1.0).unwrap();
        let options = SwarmOptions::new(Method::Tmchho);
        for share in [0.0, 1.0] {
            let mut habits = Habits {
                of_moves: share,
                of_trials: share,
            };
            let mut search = options.search(&bounds, 5, &[]).unwrap();
            search.tell(&[1.0; 30]).unwrap();
            let ahead = look_ahead(&search, 4, habits);
            assert_eq!(ahead.len(), 4);
            for foreseen in ahead {
                assert_eq!(search.ask(), [foreseen.point]);
                assert_eq!(search.limit(), foreseen.limit);
                search.tell(&[habits.guess(foreseen.limit)]).unwrap();
            }
        }
    }

    #[test]
    fn habits_follow_what_happens() {
        let mut habits = Habits::default();
        let infinite = f64::INFINITY;
        assert_eq!(habits.guess(1.0), infinite);
        for _ in 0..10 {
            habits.learn(0.5, 1.0, 1.0);
            habits.learn(2.0, infinite, 1.0);
            habits.learn(2.0, infinite, infinite);
        }
        assert_eq!(habits.guess(1.0), -infinite);
        assert_eq!(habits.guess(infinite), infinite);
        for _ in 0..10 {
            habits.learn(1.0, 1.0, 1.0);
        }
        assert_eq!(habits.guess(1.0), infinite);
    }
}
