//! One search, step by step: it asks for values at points and is told them.
//!
//! Why: the same search serves a closure, a function in Rust on all cores, a vectorised function in
//! Python, and people who evaluate somewhere else and come back tomorrow. Counting, limits and
//! the history are here, once for all methods.

use std::ops::ControlFlow;

use crate::deadline::Deadline;
use crate::error::{Error, Result};

use super::budget::Budget;
use super::evaluator::Evaluator;
use super::{IterationListener, IterationReport, Minimum, Objective, StopReason};

/// What a method wants next.
pub(super) enum Wish {
    /// The values at these points, which are inside the box. Values that are not below `limit` may
    /// be replaced by any number that is not.
    Values {
        points: Vec<Vec<f64>>,
        limit: f64,
        contest: Option<Contest>,
    },
    /// Nothing: an iteration is over, and the best point is up to date.
    EndOfIteration,
}

/// What the search does next depends on whether a single value is below that of a rival.
#[derive(Debug, Clone, Copy)]
pub(super) struct Contest {
    pub(super) rival: f64,
    /// Contests of one kind, a number below [`Contest::N_KINDS`], tend to end alike.
    pub(super) kind: usize,
}

impl Contest {
    /// The most kinds that a method tells apart.
    pub(super) const N_KINDS: usize = 6;
}

impl Wish {
    /// Values that are wanted whatever they are.
    pub(super) fn values(points: Vec<Vec<f64>>) -> Self {
        Self::Values {
            points,
            limit: f64::INFINITY,
            contest: None,
        }
    }
}

/// A method at work: what differs from method to method.
pub(super) trait Swarm: Send + Sync {
    /// What it wants now; called again only when that was told.
    fn wish(&mut self) -> Wish;

    /// The values it wished for, with the points. Fewer than it wished for, or none: there will be
    /// no more, and the iteration is to be brought to its end.
    fn tell(&mut self, points: Vec<Vec<f64>>, values: &[f64]);

    /// The best point at the end of the last iteration, and its value.
    fn best(&self) -> (&[f64], f64);

    /// The population, inside the box, and the values as far as they are known.
    fn population(&self) -> (Vec<Vec<f64>>, Vec<f64>);

    /// A copy that goes its own way.
    fn fork(&self) -> Box<dyn Swarm>;
}

/// A search that is under way; [`Optimizer::search`](super::Optimizer::search) begins one.
///
/// ```
/// use tmchho::optim::{Bounds, HawkOptions, Optimizer};
/// let bounds = Bounds::cube(3, -1.0, 1.0)?;
/// let mut search = HawkOptions::tmchho().search(&bounds, 7, &[])?;
/// while !search.is_over() {
///     let values: Vec<f64> = search.ask().iter().map(|x| x[0].abs() + x[1] * x[2]).collect();
///     search.tell(&values)?;
/// }
/// assert!(search.minimum().fun < -0.99);
/// # Ok::<(), tmchho::Error>(())
/// ```
pub struct Search {
    swarm: Box<dyn Swarm>,
    max_iterations: usize,
    max_evaluations: usize,
    deadline: Deadline,
    asked: Vec<Vec<f64>>,
    limit: f64,
    contest: Option<Contest>,
    n_evaluations: usize,
    n_nan: usize,
    history: Vec<f64>,
    stop_reason: StopReason,
}

impl Search {
    pub(super) fn new(swarm: Box<dyn Swarm>, budget: &Budget) -> Self {
        let mut search = Self {
            swarm,
            max_iterations: budget.n_iterations,
            max_evaluations: budget.max_evaluations.unwrap_or(usize::MAX),
            deadline: Deadline::after(budget.max_seconds),
            asked: Vec::new(),
            limit: f64::INFINITY,
            contest: None,
            n_evaluations: 0,
            n_nan: 0,
            history: Vec::new(),
            stop_reason: StopReason::NotOver,
        };
        search.advance(&mut |_| ControlFlow::Continue(()));
        search
    }

    /// The points whose values are wanted, all inside the box; none once the search is over.
    ///
    /// They stay the same until they are told. A batch may be the whole population or a single
    /// point: as many as the method can name without knowing a further value.
    pub fn ask(&self) -> &[Vec<f64>] {
        &self.asked
    }

    /// Takes the values at the points of [`Search::ask`], in their order. What is not a number
    /// counts as +∞, and is counted.
    ///
    /// # Errors
    /// [`Error::InvalidArgument`] for another number of values.
    pub fn tell(&mut self, values: &[f64]) -> Result<()> {
        self.tell_and_hear(values, &mut |_| ControlFlow::Continue(()))
    }

    /// Like [`Search::tell`]; `on_iteration` hears of every iteration that is completed by it, and
    /// ends the search by answering `Break`.
    ///
    /// # Errors
    /// As [`Search::tell`].
    pub fn tell_and_hear(
        &mut self,
        values: &[f64],
        on_iteration: &mut IterationListener<'_>,
    ) -> Result<()> {
        if values.len() != self.asked.len() {
            return Err(Error::argument(
                "values",
                format!(
                    "must be one for each of the {} points asked for, got {}",
                    self.asked.len(),
                    values.len()
                ),
            ));
        }
        if self.is_over() {
            return Ok(());
        }
        let n_nan = values.iter().filter(|value| value.is_nan()).count();
        self.n_nan += n_nan;
        self.n_evaluations += values.len();
        let points = std::mem::take(&mut self.asked);
        if n_nan == 0 {
            self.swarm.tell(points, values);
        } else {
            let without_nan = |value: &f64| {
                if value.is_nan() {
                    f64::INFINITY
                } else {
                    *value
                }
            };
            let values: Vec<f64> = values.iter().map(without_nan).collect();
            self.swarm.tell(points, &values);
        }
        self.advance(on_iteration);
        Ok(())
    }

    /// Whether nothing is asked any more.
    pub fn is_over(&self) -> bool {
        self.stop_reason != StopReason::NotOver
    }

    /// What was found so far: what [`Minimum`] says holds for the last completed iteration.
    pub fn minimum(&self) -> Minimum {
        let (x, fun) = self.swarm.best();
        let (population, population_fitness) = self.swarm.population();
        Minimum {
            x: x.to_vec(),
            fun,
            n_evaluations: self.n_evaluations,
            n_iterations: self.history.len(),
            n_nan: self.n_nan,
            history: self.history.clone(),
            stop_reason: self.stop_reason,
            population,
            population_fitness,
        }
    }

    /// Evaluates and tells until the search is over.
    pub(super) fn run(
        &mut self,
        objective: &dyn Objective,
        on_iteration: &mut IterationListener<'_>,
    ) -> Result<()> {
        let mut evaluator = Evaluator::new(objective);
        while !self.is_over() {
            self.tell_and_hear(evaluator.values(self), on_iteration)?;
        }
        Ok(())
    }

    /// Values that are not below this may be replaced by any number that is not.
    pub(super) fn limit(&self) -> f64 {
        self.limit
    }

    /// What comes next depends on this alone, where a single value is asked for.
    pub(super) fn contest(&self) -> Option<Contest> {
        self.contest
    }

    /// A copy that goes its own way.
    pub(super) fn fork(&self) -> Self {
        Self {
            swarm: self.swarm.fork(),
            asked: self.asked.clone(),
            history: self.history.clone(),
            ..*self
        }
    }

    /// Goes on until values are wanted that may be asked for, or the search is over.
    fn advance(&mut self, on_iteration: &mut IterationListener<'_>) {
        loop {
            match self.swarm.wish() {
                Wish::Values {
                    mut points,
                    limit,
                    contest,
                } => {
                    let n_left = if self.is_late() {
                        0
                    } else {
                        self.max_evaluations - self.n_evaluations
                    };
                    if n_left == 0 {
                        self.swarm.tell(points, &[]);
                        continue;
                    }
                    points.truncate(n_left);
                    (self.asked, self.limit, self.contest) = (points, limit, contest);
                    return;
                }
                Wish::EndOfIteration => {
                    let (x, fun) = self.swarm.best();
                    self.history.push(fun);
                    let report = IterationReport {
                        n_iterations: self.history.len(),
                        max_iterations: self.max_iterations,
                        n_evaluations: self.n_evaluations,
                        x,
                        fun,
                    };
                    self.stop_reason = if on_iteration(&report).is_break() {
                        StopReason::Callback
                    } else if self.history.len() == self.max_iterations {
                        StopReason::MaxIterations
                    } else if self.n_evaluations >= self.max_evaluations {
                        StopReason::MaxEvaluations
                    } else if self.is_late() {
                        StopReason::MaxSeconds
                    } else {
                        StopReason::NotOver
                    };
                    if self.is_over() {
                        return;
                    }
                }
            }
        }
    }

    /// Whether time is up; the first batch is always asked for.
    fn is_late(&self) -> bool {
        self.n_evaluations > 0 && self.deadline.is_over()
    }
}
