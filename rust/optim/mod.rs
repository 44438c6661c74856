//! Minimisers of a function over a box. Nothing here has ever heard of a point cloud.
//!
//! Why: the search for a pose is a search for the lowest value of a function of six numbers; it is
//! read, tested and compared with its rivals on functions whose lowest value is known.
//!
//! Read in this order: [`Bounds`] and [`Objective`] say what is asked, [`moves`], [`chaos`] and
//! [`levy`] are the equations, [`HawkOptions`] is the search that uses them, [`Search`] asks and is
//! told, [`Minimum`] is the answer. The rivals are [`PsoOptions`], [`WoaOptions`], [`BoaOptions`] and
//! [`DoaOptions`]; [`Method`] knows all by name. [`test_functions`] are the paper's seven examples.

pub mod boa;
mod bounds;
mod budget;
pub mod chaos;
mod crowd;
pub mod doa;
mod evaluator;
mod hawks;
mod hunt;
pub mod levy;
mod method;
pub mod moves;
mod problem;
pub mod pso;
mod search;
mod start;
pub mod test_functions;
pub mod woa;

use std::ops::ControlFlow;

use crate::error::Result;

pub use boa::BoaOptions;
pub use bounds::Bounds;
pub use budget::Budget;
pub use doa::DoaOptions;
pub use hawks::{HawkOptions, MutationReading};
pub use method::{Method, SwarmOptions};
pub use problem::Problem;
pub use pso::PsoOptions;
pub use search::Search;
pub use woa::WoaOptions;

/// The function to be minimised.
///
/// A value that is not a number counts as +∞ (and is counted). Every closure of the right shape is
/// an objective; a type of its own pays off where [`Objective::evaluate_below`] can give up early.
///
/// ```
/// use tmchho::optim::Objective;
/// let sphere = |x: &[f64]| x.iter().map(|v| v * v).sum::<f64>();
/// assert_eq!(sphere.evaluate(&[3.0, 4.0]), 25.0);
/// ```
pub trait Objective: Sync {
    /// The value at `x`. Must depend on `x` alone; it is called from several threads at once.
    fn evaluate(&self, x: &[f64]) -> f64;

    /// The value at `x` where it is below `limit`; otherwise any value that is not below `limit`.
    ///
    /// Why: trial points count only if they are better than the hawk, so that a sum of growing
    /// terms may be abandoned once it reaches `limit`, and the search stays the same to the bit.
    fn evaluate_below(&self, x: &[f64], limit: f64) -> f64 {
        let _ = limit;
        self.evaluate(x)
    }
}

impl<F: Fn(&[f64]) -> f64 + Sync> Objective for F {
    fn evaluate(&self, x: &[f64]) -> f64 {
        self(x)
    }
}

/// A way of searching, with its settings: what all minimisers can do.
///
/// ```
/// use tmchho::optim::{Bounds, HawkOptions, Optimizer};
/// let sphere = |x: &[f64]| x.iter().map(|v| v * v).sum::<f64>();
/// let bounds = Bounds::cube(10, -100.0, 100.0)?;
/// let found = HawkOptions::tmchho().minimize(&sphere, &bounds, 7)?;
/// assert!(found.fun < 1e-60 && bounds.contains(&found.x));
/// # Ok::<(), tmchho::Error>(())
/// ```
pub trait Optimizer {
    /// Searches `bounds` for the lowest value of `objective`: the same seed gives the same answer,
    /// bit for bit, at any number of threads.
    ///
    /// # Errors
    /// As [`Optimizer::minimize_from`].
    fn minimize(&self, objective: &dyn Objective, bounds: &Bounds, seed: u64) -> Result<Minimum> {
        self.minimize_from(objective, bounds, seed, &[], &mut |_| {
            ControlFlow::Continue(())
        })
    }

    /// Like [`Optimizer::minimize`], with points to start from and somebody who listens.
    ///
    /// `on_iteration` hears of every iteration and ends the search by answering `Break`.
    ///
    /// # Errors
    /// As [`Optimizer::search`].
    fn minimize_from(
        &self,
        objective: &dyn Objective,
        bounds: &Bounds,
        seed: u64,
        start: &[Vec<f64>],
        on_iteration: &mut IterationListener<'_>,
    ) -> Result<Minimum> {
        let mut search = self.search(bounds, seed, start)?;
        search.run(objective, on_iteration)?;
        Ok(search.minimum())
    }

    /// Begins a search whose values are found by the caller: see [`Search`].
    ///
    /// The points of `start` (clipped to the box) replace the last ones of the start population.
    ///
    /// # Errors
    /// [`InvalidArgument`](crate::Error::InvalidArgument) for a setting out of its range, more
    /// start points than the population has members, or a start point that does not fit the box.
    fn search(&self, bounds: &Bounds, seed: u64, start: &[Vec<f64>]) -> Result<Search>;
}

/// Hears of every iteration; `Break` ends the search.
pub type IterationListener<'a> = dyn FnMut(&IterationReport<'_>) -> ControlFlow<()> + 'a;

/// How far a search has come.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct IterationReport<'a> {
    /// Iterations done, this one included.
    pub n_iterations: usize,
    /// Iterations there will be if nothing ends the search earlier.
    pub max_iterations: usize,
    /// Calls of the objective so far.
    pub n_evaluations: usize,
    /// Best point so far.
    pub x: &'a [f64],
    /// Its value.
    pub fun: f64,
}

/// Why a search ended. None of these claims that the minimum was found.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum StopReason {
    /// All iterations are done.
    MaxIterations,
    /// The calls of the objective that were allowed are used up.
    MaxEvaluations,
    /// The listener answered "stop".
    Callback,
    /// Time was up.
    MaxSeconds,
    /// It has not: values are still asked for.
    NotOver,
}

/// What a search found.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Minimum {
    /// Best point; always inside the box.
    pub x: Vec<f64>,
    /// Its value; +∞ where the objective never gave a number.
    pub fun: f64,
    /// Values the search asked for, abandoned ones included. Where the objective is dear and there are
    /// several threads, they look ahead, and may call it at points that are then not asked for: those
    /// calls depend on the machine and are not counted.
    pub n_evaluations: usize,
    /// Iterations done: how often the best point was brought up to date.
    pub n_iterations: usize,
    /// Calls whose value was not a number; they count as +∞.
    pub n_nan: usize,
    /// Best value after each iteration.
    pub history: Vec<f64>,
    /// Why the search ended.
    pub stop_reason: StopReason,
    /// The population at the end; always inside the box.
    pub population: Vec<Vec<f64>>,
    /// Its values, in the same order; +∞ where the last one was never asked for, because
    /// the calls were used up.
    pub population_fitness: Vec<f64>,
}
