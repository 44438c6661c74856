//! The minimisers, on functions written in Python or in Rust, and what they are made of.
//!
//! A function in Python is evaluated by Python, which asks a [`Search`] and tells it; a function in
//! Rust is searched wholly in Rust, on another thread.

use std::ops::ControlFlow;
use std::sync::mpsc::{self, Sender};

use numpy::{PyArray1, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};

use super::arrays::{ReadArray, ReadVector, dict, from_vec};
use super::config::{options, word};
use super::run::{briefly, with_messages};
use crate::optim::chaos::ChaoticSequence;
use crate::optim::test_functions::{self, TestFunction};
use crate::optim::{
    self, Bounds, HawkOptions, Method, Minimum, Objective, Optimizer, SwarmOptions, levy,
};
use crate::parallel;
use crate::random::Stream;

type Box64 = (Vec<f64>, Vec<f64>);

/// A search that asks for values and is told them.
#[pyclass(module = "tmchho._core")]
pub(super) struct Search {
    search: optim::Search,
    dimension: usize,
}

#[pymethods]
impl Search {
    #[new]
    fn new(bounds: Box64, options_json: &str, seed: u64, start: Vec<Vec<f64>>) -> PyResult<Self> {
        briefly(|| {
            let options: SwarmOptions = options(options_json)?;
            let bounds = Bounds::new(bounds.0, bounds.1)?;
            Ok(Self {
                search: options.search(&bounds, seed, &start)?,
                dimension: bounds.dimension(),
            })
        })
    }

    /// The points whose values are wanted, an (n, d) array.
    fn ask<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        briefly(|| {
            let points = self.search.ask();
            let array = PyArray1::from_vec(py, points.concat());
            Ok(array.reshape([points.len(), self.dimension])?.into_any())
        })
    }

    /// Takes their values. `callback` gets the best point and its value after each iteration that is
    /// completed, and returns whether to stop.
    fn tell(
        &mut self,
        py: Python<'_>,
        values: ReadVector<'_>,
        callback: Option<Py<PyAny>>,
    ) -> PyResult<()> {
        briefly(|| {
            let mut failure = None;
            let mut listen = |report: &optim::IterationReport<'_>| {
                let Some(callback) = &callback else {
                    return ControlFlow::Continue(());
                };
                let best = (from_vec(py, report.x.to_vec()), report.fun);
                let answer = (callback.call1(py, best)).and_then(|answer| answer.extract(py));
                match answer {
                    Ok(false) => ControlFlow::Continue(()),
                    Ok(true) => ControlFlow::Break(()),
                    Err(error) => {
                        failure = Some(error);
                        ControlFlow::Break(())
                    }
                }
            };
            self.search.tell_and_hear(values.as_slice()?, &mut listen)?;
            failure.map_or(Ok(()), Err)
        })
    }

    /// Whether nothing is asked any more.
    fn is_over(&self) -> bool {
        self.search.is_over()
    }

    /// What was found so far.
    fn minimum<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        briefly(|| minimum(py, self.search.minimum()))
    }
}

/// A function of Table 1, moved and turned if wanted.
#[pyclass(frozen, module = "tmchho._core")]
pub(super) struct Problem(optim::Problem);

#[pymethods]
impl Problem {
    #[new]
    fn new(
        name: &str,
        dimension: usize,
        shift: Option<Vec<f64>>,
        rotation_seed: Option<u64>,
    ) -> PyResult<Self> {
        briefly(|| {
            let mut problem = optim::Problem::new(name, dimension)?;
            if let Some(shift) = shift {
                problem = problem.shifted(shift)?;
            }
            if let Some(seed) = rotation_seed {
                problem = problem.rotated(seed);
            }
            Ok(Self(problem))
        })
    }

    /// The values at the rows of an (n, d) array.
    fn values<'py>(&self, py: Python<'py>, points: ReadArray<'_>) -> PyResult<Bound<'py, PyAny>> {
        briefly(|| {
            let dimension = self.0.dimension();
            let rows = points.as_slice()?.chunks_exact(dimension);
            let values: Vec<f64> = rows.map(|x| self.0.evaluate(x)).collect();
            Ok(from_vec(py, values))
        })
    }
}

/// What the search wants of the thread that called it: whether to stop, at the best point and value.
struct AskToStop(Vec<f64>, f64, Sender<bool>);

/// Searches the box from `low` to `high` for the lowest value of a function in Rust. `callback` takes
/// the best point and its value after each iteration and returns whether to stop.
#[pyfunction]
#[allow(clippy::too_many_arguments)] // one doorway for all
pub(super) fn minimize<'py>(
    py: Python<'py>,
    problem: Py<Problem>,
    bounds: Box64,
    options_json: &str,
    seed: u64,
    start: Vec<Vec<f64>>,
    callback: Option<Py<PyAny>>,
    n_threads: Option<usize>,
) -> PyResult<Bound<'py, PyDict>> {
    let (bounds, options) = briefly(|| {
        let options: SwarmOptions = options(options_json)?;
        Ok((Bounds::new(bounds.0, bounds.1)?, options))
    })?;
    let problem = &problem.get().0;
    let has_callback = callback.is_some();
    let answer = move |py: Python<'_>, AskToStop(x, value, reply): AskToStop| -> PyResult<()> {
        let stop = match &callback {
            Some(callback) => callback.call1(py, (from_vec(py, x), value))?.extract(py)?,
            None => false,
        };
        // The search waits for the answer, unless it has given up meanwhile.
        reply.send(stop).ok();
        Ok(())
    };
    let found = with_messages(py, answer, |caller| {
        parallel::with_threads(n_threads, || {
            options.minimize_from(problem, &bounds, seed, &start, &mut |report| {
                let is_told_to_stop = || {
                    let (reply, answer) = mpsc::channel();
                    caller.tell(AskToStop(report.x.to_vec(), report.fun, reply));
                    answer.recv().unwrap_or(true)
                };
                if caller.wants_to_stop() || (has_callback && is_told_to_stop()) {
                    ControlFlow::Break(())
                } else {
                    ControlFlow::Continue(())
                }
            })
        })
    })?;
    briefly(|| minimum(py, found))
}

fn minimum(py: Python<'_>, found: Minimum) -> PyResult<Bound<'_, PyDict>> {
    Ok(dict! { py,
        "x": from_vec(py, found.x),
        "fun": found.fun,
        "nfev": found.n_evaluations,
        "nit": found.n_iterations,
        "n_nan": found.n_nan,
        "history": from_vec(py, found.history),
        "stop_reason": word(found.stop_reason),
    })
}

/// The names of the methods.
#[pyfunction]
pub(super) fn methods() -> [&'static str; 7] {
    Method::ALL.map(Method::name)
}

/// The seven functions of Table 1.
#[pyfunction]
pub(super) fn benchmark_functions(py: Python<'_>) -> PyResult<Bound<'_, PyList>> {
    briefly(|| {
        let functions = PyList::empty(py);
        for TestFunction {
            name,
            title,
            range,
            minimum,
            ..
        } in &test_functions::ALL
        {
            functions.append((name, title, range, minimum))?;
        }
        Ok(functions)
    })
}

/// `n` values of the chaotic map of Eq. (6).
#[pyfunction]
pub(super) fn chaotic_sequence(py: Python<'_>, n: usize, seed: u64) -> PyResult<Bound<'_, PyAny>> {
    briefly(|| Ok(from_vec(py, ChaoticSequence::new(seed).take(n).collect())))
}

/// `n` steps of the Lévy flight of Eq. (5).
#[pyfunction]
pub(super) fn levy_steps(
    py: Python<'_>,
    n: usize,
    seed: u64,
    factor: Option<f64>,
) -> PyResult<Bound<'_, PyAny>> {
    briefly(|| {
        let mut stream = Stream::new(seed, "levy steps", 0);
        let factor = factor.unwrap_or(HawkOptions::default().levy_factor);
        let step = || levy::step(stream.normal(), stream.normal(), factor);
        Ok(from_vec(py, std::iter::repeat_with(step).take(n).collect()))
    })
}
