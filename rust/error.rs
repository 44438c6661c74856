//! Every way in which the crate can say no.
//!
//! Messages are lower case, carry the offending numbers and say what to do. The binding maps each
//! variant to a Python class in one table (`python/errors.rs`).

/// What went wrong.
///
/// ```
/// let error = tmchho::Cloud::new(&[]).unwrap_err();
/// assert!(matches!(error, tmchho::Error::TooFewPoints { found: 0, .. }));
/// ```
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A cloud has fewer finite points than a rigid pose needs.
    #[error(
        "the {what} has {found} usable points, at least {needed} are needed: give a larger cloud"
    )]
    TooFewPoints {
        /// Which cloud: "source cloud", "target cloud", "cloud".
        what: String,
        /// Finite points found.
        found: usize,
        /// Points needed.
        needed: usize,
    },
    /// All points of a cloud coincide, or lie on one line or in one plane: no pose is determined.
    #[error(
        "the {what} is degenerate: {shape}; a pose in space needs points that spread in three \
         directions"
    )]
    Degenerate {
        /// Which cloud.
        what: String,
        /// "all points are identical", "all points lie on one line", …
        shape: &'static str,
    },
    /// A coordinate is too large for squared distances to keep any meaning.
    #[error(
        "the {what} has a coordinate of {value:e}, beyond ±{limit:e}: the file is damaged or its \
         unit is wrong"
    )]
    CoordinateTooLarge {
        /// Which cloud.
        what: String,
        /// The offending coordinate.
        value: f64,
        /// Largest absolute coordinate accepted.
        limit: f64,
    },
    /// A voxel edge is so small that the grid over the cloud could not be numbered.
    #[error(
        "voxel size {voxel_size_m:e} is too small for a cloud of extent {extent_m}: the smallest \
         possible is {smallest_m:e}"
    )]
    VoxelTooSmall {
        /// The edge asked for.
        voxel_size_m: f64,
        /// Longest side of the cloud's box.
        extent_m: f64,
        /// Smallest edge that would be accepted.
        smallest_m: f64,
    },
    /// An argument or configuration value is out of its range.
    #[error("{name} {problem}")]
    InvalidArgument {
        /// The argument, or the path of the configuration key.
        name: String,
        /// What is wrong and what is allowed: "must be > 0, got -1".
        problem: String,
    },
    /// The search ended without any pose.
    #[error("no pose was found: {reason}")]
    NoSolution {
        /// Why, and what may help.
        reason: String,
    },
    /// The caller asked to stop.
    #[error("stopped by the caller")]
    Cancelled,
}

impl Error {
    pub(crate) fn argument(name: impl Into<String>, problem: impl Into<String>) -> Self {
        Self::InvalidArgument {
            name: name.into(),
            problem: problem.into(),
        }
    }
}

/// The crate's result type.
pub type Result<T> = std::result::Result<T, Error>;

/// Refuses a number that is not finite and above zero, by the name of its argument.
pub(crate) fn require_positive(name: &str, value: f64) -> Result<f64> {
    if value.is_finite() && value > 0.0 {
        Ok(value)
    } else {
        Err(Error::argument(
            name,
            format!("must be a number above 0, got {value}"),
        ))
    }
}

/// Refuses a number outside `[low, high]`, by the name of its argument; `f64::MAX` is no limit.
pub(crate) fn require_between(name: &str, value: f64, low: f64, high: f64) -> Result<f64> {
    if value >= low && value <= high {
        Ok(value)
    } else if high == f64::MAX {
        Err(Error::argument(
            name,
            format!("must be a number of at least {low}, got {value}"),
        ))
    } else {
        Err(Error::argument(
            name,
            format!("must lie between {low} and {high}, got {value}"),
        ))
    }
}

/// Refuses a count below `least`, by the name of its argument.
pub(crate) fn require_at_least(name: &str, value: usize, least: usize) -> Result<usize> {
    require_count(name, value, least, usize::MAX)
}

/// Refuses a count outside `least..=most`, by the name of its argument. The upper limits stand for
/// more memory or time than anybody has.
pub(crate) fn require_count(name: &str, value: usize, least: usize, most: usize) -> Result<usize> {
    if value < least {
        Err(Error::argument(
            name,
            format!("must be at least {least}, got {value}"),
        ))
    } else if value > most {
        Err(Error::argument(
            name,
            format!("must be at most {most}, got {value}"),
        ))
    } else {
        Ok(value)
    }
}
