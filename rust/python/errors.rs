//! From the crate's errors to the classes of python/tmchho/errors.py, in one table.

use std::any::Any;

use pyo3::PyErr;

use crate::error::Error;

pyo3::import_exception!(tmchho.errors, TmchhoError);
pyo3::import_exception!(tmchho.errors, InvalidArgumentError);
pyo3::import_exception!(tmchho.errors, InvalidCloudError);
pyo3::import_exception!(tmchho.errors, NoSolutionError);
pyo3::import_exception!(tmchho.errors, StoppedError);

impl From<Error> for PyErr {
    fn from(error: Error) -> Self {
        let message = error.to_string();
        match error {
            Error::TooFewPoints { .. }
            | Error::Degenerate { .. }
            | Error::CoordinateTooLarge { .. } => InvalidCloudError::new_err(message),
            Error::InvalidArgument { .. } | Error::VoxelTooSmall { .. } => {
                InvalidArgumentError::new_err(message)
            }
            Error::NoSolution { .. } => NoSolutionError::new_err(message),
            Error::Cancelled => StoppedError::new_err(message),
        }
    }
}

/// A stage called alone has arguments, not configuration keys: "icp.kept_share" is its `kept_share`,
/// "radius_m" its `radius`.
pub(super) fn as_argument(error: Error) -> Error {
    match error {
        Error::InvalidArgument { name, problem } => {
            let name = name.rsplit('.').next().unwrap_or_default();
            let name = match name.trim_end_matches("_m") {
                "k" => "n_neighbors",
                other => other,
            };
            Error::argument(name, problem)
        }
        other => other,
    }
}

/// What a panic becomes: a mistake of ours, and no reason to end the interpreter's day.
pub(super) fn of_panic(payload: &(dyn Any + Send)) -> PyErr {
    let text = payload
        .downcast_ref::<&str>()
        .copied()
        .or_else(|| payload.downcast_ref::<String>().map(String::as_str))
        .unwrap_or("no message");
    TmchhoError::new_err(format!(
        "internal error: {text}; please report it together with the call that led to it"
    ))
}
