//! Settings cross as JSON, which the crate checks key by key.

use pyo3::prelude::*;
use serde::Serialize;
use serde::de::DeserializeOwned;

use super::run::briefly;
use crate::config::Config;
use crate::error::{Error, Result};

/// All settings with their defaults, as JSON.
#[pyfunction]
pub(super) fn default_config() -> PyResult<String> {
    briefly(|| Ok(Config::default().to_json()))
}

/// Checks settings given as JSON and adds the defaults of those left out.
#[pyfunction]
pub(super) fn complete_config(json: &str) -> PyResult<String> {
    briefly(|| {
        let config = Config::from_json(json)?;
        config.check()?;
        Ok(config.to_json())
    })
}

/// The options of one stage from JSON; those left out keep their defaults.
pub(super) fn options<T: DeserializeOwned>(json: &str) -> Result<T> {
    serde_json::from_str(json).map_err(|error| {
        let problem = error.to_string();
        let problem = problem.split(" at line ").next().unwrap_or_default();
        Error::argument("the options", format!("are not valid: {problem}"))
    })
}

/// The word for one of several, as in the configuration: "point_to_plane".
pub(super) fn word(value: impl Serialize) -> String {
    serde_json::to_value(value)
        .ok()
        .and_then(|value| value.as_str().map(str::to_owned))
        .unwrap_or_default()
}
