//! How many members a swarm has, and how long it may search.

use crate::error::{Result, require_at_least, require_between, require_count};

/// Size of the population and the limits of a search; the defaults are those of the paper's
/// Section 5.2.
///
/// ```
/// use tmchho::optim::{Bounds, Budget, Optimizer, WoaOptions};
/// let budget = Budget { max_evaluations: Some(1000), ..Budget::default() };
/// let options = WoaOptions { budget, ..WoaOptions::default() };
/// let found = options.minimize(&|x: &[f64]| x[0] * x[0], &Bounds::cube(1, -1.0, 1.0)?, 1)?;
/// assert_eq!(found.n_evaluations, 1000);
/// # Ok::<(), tmchho::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Budget {
    /// Members of the population; ≥ 4.
    pub population_size: usize,
    /// How often the whole population is evaluated, its start included; ≥ 1. The rules of most
    /// methods change with the share of it that is done.
    pub n_iterations: usize,
    /// Calls of the objective after which the search ends; ≥ 1, `None` for no limit.
    pub max_evaluations: Option<usize>,
    /// Seconds after which the search ends; ≥ 0, `None` for no limit. A search that ends by the
    /// clock cannot be repeated.
    pub max_seconds: Option<f64>,
}

impl Default for Budget {
    fn default() -> Self {
        Self {
            population_size: 30,
            n_iterations: 500,
            max_evaluations: None,
            max_seconds: None,
        }
    }
}

impl Budget {
    /// `size_name` is what the population's size is called where the budget was given.
    pub(super) fn check(&self, size_name: &str) -> Result<()> {
        require_count(size_name, self.population_size, 4, 1_000_000)?;
        require_count("n_iterations", self.n_iterations, 1, 10_000_000)?;
        if let Some(max_evaluations) = self.max_evaluations {
            require_at_least("max_evaluations", max_evaluations, 1)?;
        }
        if let Some(max_seconds) = self.max_seconds {
            require_between("max_seconds", max_seconds, 0.0, f64::MAX)?;
        }
        Ok(())
    }
}
