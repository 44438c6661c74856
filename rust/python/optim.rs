//! The minimisers, on functions written in Python or in Rust, and what they are made of.

use std::ops::ControlFlow;
use std::sync::mpsc::{self, Sender};

use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};

use super::arrays::{ReadVector, dict, from_vec};
use super::config::{options, word};
use super::run::{Caller, briefly, with_messages};
use crate::optim::chaos::ChaoticSequence;
use crate::optim::test_functions::{self, TestFunction};
use crate::optim::{Bounds, HawkOptions, Minimum, Objective, Optimizer, levy};
use crate::parallel;
use crate::random::Stream;

/// What the search wants of the thread that called it.
enum Question {
    /// The value at a point.
    Value(Vec<f64>, Sender<f64>),
    /// Whether to stop here: the best point and its value.
    Stop(Vec<f64>, f64, Sender<bool>),
}

/// Searches the box from `low` to `high` for the lowest value of `fun`: the name of a built-in
/// function, or a callable that takes an array and returns a float. `callback` takes the best
/// point and its value after each iteration and returns whether to stop.
#[pyfunction]
pub(super) fn minimize<'py>(
    py: Python<'py>,
    fun: Py<PyAny>,
    bounds: (Vec<f64>, Vec<f64>),
    options_json: &str,
    seed: u64,
    start: Vec<Vec<f64>>,
    callback: Option<Py<PyAny>>,
) -> PyResult<Bound<'py, PyDict>> {
    let (bounds, options) = briefly(|| {
        let options: HawkOptions = options(options_json)?;
        Ok((Bounds::new(bounds.0, bounds.1)?, options))
    })?;
    let built_in = match fun.extract::<String>(py) {
        Ok(name) => Some(briefly(|| Ok(test_functions::by_name(&name)?))?),
        Err(_) => None,
    };
    let has_callback = callback.is_some();
    let answer = move |py: Python<'_>, question: Question| -> PyResult<()> {
        // The search waits for the answer, unless it has given up meanwhile.
        match question {
            Question::Value(x, reply) => {
                let value = fun.call1(py, (from_vec(py, x),))?;
                reply.send(value.extract(py)?).ok();
            }
            Question::Stop(x, value, reply) => {
                let stop = match &callback {
                    Some(callback) => callback.call1(py, (from_vec(py, x), value))?.extract(py)?,
                    None => false,
                };
                reply.send(stop).ok();
            }
        }
        Ok(())
    };
    let found = with_messages(py, answer, |caller| {
        let search = |objective: &dyn Objective| {
            options.minimize_from(objective, &bounds, seed, &start, &mut |report| {
                let stop = caller.wants_to_stop()
                    || (has_callback
                        && ask(caller, |reply| {
                            Question::Stop(report.x.to_vec(), report.fun, reply)
                        })
                        .unwrap_or(true));
                if stop {
                    ControlFlow::Break(())
                } else {
                    ControlFlow::Continue(())
                }
            })
        };
        match built_in {
            Some(function) => search(&function.evaluate),
            // One thread, so that the questions come in the order of the hawks.
            None => parallel::with_threads(Some(1), || {
                search(&|x: &[f64]| {
                    ask(caller, |reply| Question::Value(x.to_vec(), reply)).unwrap_or(f64::NAN)
                })
            }),
        }
    })?;
    briefly(|| minimum(py, found))
}

/// The answer of the calling thread; `None` once it has stopped answering.
fn ask<T>(
    caller: &Caller<'_, Question>,
    question: impl FnOnce(Sender<T>) -> Question,
) -> Option<T> {
    if caller.wants_to_stop() {
        return None;
    }
    let (reply, answer) = mpsc::channel();
    caller.tell(question(reply));
    answer.recv().ok()
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

/// The value of one of them.
#[pyfunction]
pub(super) fn benchmark_value(name: &str, x: ReadVector<'_>) -> PyResult<f64> {
    briefly(|| {
        let function = test_functions::by_name(name)?;
        Ok((function.evaluate)(x.as_slice()?))
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
