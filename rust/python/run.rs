//! The one doorway of calls from Python: whatever the crate does for Python is done in here.
//!
//! Why: a call of minutes must let other Python threads run, show its progress, stop on Ctrl-C and
//! hand on exceptions unchanged; a panic must end as an exception of ours; said once, for all.
//! How: the work runs on a thread of its own and sends messages; the calling thread, which has let
//! go of the interpreter, answers them. Python code therefore only ever runs on the thread that
//! called, with that thread's context (`numpy.errstate`, tracing, signals).
//! Deviates: arrays are borrowed, not copied, while the interpreter is released: as with numpy's own
//! functions, an array must not be written to during the call.

use std::ops::ControlFlow;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, RecvTimeoutError, Sender};
use std::time::Duration;

use pyo3::prelude::*;

use super::errors::{TmchhoError, of_panic};
use crate::error::Result;
use crate::progress::{Event, Progress};

/// Ctrl-C is noticed within this time.
const SIGNAL_INTERVAL: Duration = Duration::from_millis(50);

/// For what takes less time than starting a thread.
pub(super) fn briefly<T>(work: impl FnOnce() -> PyResult<T>) -> PyResult<T> {
    catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|panic| Err(of_panic(&*panic)))
}

/// For everything else that only reports its progress; `callback` is called with the name of the
/// stage, steps done, steps in all, best score and whether the stage has just begun.
pub(super) fn with_progress<T: Send>(
    py: Python<'_>,
    callback: Option<Py<PyAny>>,
    work: impl FnOnce(&Progress<'_>) -> Result<T> + Send,
) -> PyResult<T> {
    let is_listened_to = callback.is_some();
    let tell = move |py: Python<'_>, event: Event| {
        let Some(callback) = &callback else {
            return Ok(());
        };
        let (stage, done, total, best, started) = match event {
            Event::Started { stage } => (stage, 0, 0, None, true),
            Event::Advanced {
                stage,
                done,
                total,
                best,
            } => (stage, done, total, best, false),
            Event::Tick => return Ok(()),
        };
        callback.call1(py, (stage.name(), done, total, best, started))?;
        Ok(())
    };
    with_messages(py, tell, |caller| {
        let listener = |event: &Event| {
            if is_listened_to && *event != Event::Tick {
                caller.tell(event.clone());
            }
            if caller.wants_to_stop() {
                ControlFlow::Break(())
            } else {
                ControlFlow::Continue(())
            }
        };
        work(&Progress::new(&listener))
    })
}

/// The calling thread, as the work sees it.
pub(super) struct Caller<'a, M> {
    stop: &'a AtomicBool,
    messages: Sender<M>,
}

impl<M> Caller<'_, M> {
    pub(super) fn wants_to_stop(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    pub(super) fn tell(&self, message: M) {
        // Nobody listens any more only once the work is over.
        self.messages.send(message).ok();
    }
}

/// Runs `work` on another thread and `on_message` on this one, for every message and in their order.
///
/// An error of `on_message`, or of a signal's handler, asks the work to stop, drops all further
/// messages unread, and is what the caller gets.
pub(super) fn with_messages<T: Send, M: Send>(
    py: Python<'_>,
    mut on_message: impl FnMut(Python<'_>, M) -> PyResult<()> + Send,
    work: impl FnOnce(&Caller<'_, M>) -> Result<T> + Send,
) -> PyResult<T> {
    briefly(|| {
        refuse_after_fork()?;
        let stop = AtomicBool::new(false);
        let (sender, receiver) = mpsc::channel();
        let caller = Caller {
            stop: &stop,
            messages: sender,
        };
        let (failure, outcome) = std::thread::scope(|scope| {
            let worker = scope.spawn(move || work(&caller));
            let stop = &stop;
            py.detach(move || {
                let mut failure = None;
                loop {
                    let message = match receiver.recv_timeout(SIGNAL_INTERVAL) {
                        Ok(message) => Some(message),
                        Err(RecvTimeoutError::Timeout) => None,
                        Err(RecvTimeoutError::Disconnected) => break,
                    };
                    if failure.is_some() {
                        continue;
                    }
                    let answered = Python::attach(|py| {
                        py.check_signals()?;
                        message.map_or(Ok(()), |message| on_message(py, message))
                    });
                    if let Err(error) = answered {
                        stop.store(true, Ordering::Relaxed);
                        failure = Some(error);
                    }
                }
                (failure, worker.join())
            })
        });
        match (failure, outcome) {
            (Some(error), _) => Err(error),
            (None, Ok(result)) => Ok(result?),
            (None, Err(panic)) => Err(of_panic(&*panic)),
        }
    })
}

/// A forked child has the parent's thread pool in name only and would wait for it for ever.
fn refuse_after_fork() -> PyResult<()> {
    static FIRST_PROCESS: OnceLock<u32> = OnceLock::new();
    if *FIRST_PROCESS.get_or_init(std::process::id) == std::process::id() {
        return Ok(());
    }
    Err(TmchhoError::new_err(
        "this process was forked from one that had already used tmchho, and has none of its \
         threads: start processes with multiprocessing.get_context(\"spawn\") or \"forkserver\"",
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_on_either_thread_is_an_error_of_ours() {
        Python::initialize();
        Python::attach(|py| {
            // The class lives in the package, which a test of the crate alone lacks.
            let package = c"import sys, types
errors = types.ModuleType('tmchho.errors')
errors.TmchhoError = type('TmchhoError', (Exception,), {})
sys.modules.update({'tmchho': types.ModuleType('tmchho'), 'tmchho.errors': errors})";
            py.run(package, None, None).unwrap();
            let here: PyResult<()> = briefly(|| panic!("here"));
            let there: PyResult<()> = with_progress(py, None, |_| panic!("{}", "there"));
            for (found, text) in [(here, "here"), (there, "there")] {
                let message = found.unwrap_err().to_string();
                assert!(message.starts_with(&format!("TmchhoError: internal error: {text};")));
            }
        });
    }
}
