//! Harris hawks optimisation (HHO) and, with both improvements switched on, TMCHHO; and a variant
//! of our own that has no favourite place.
//!
//! Why: TMCHHO is HHO with a chaotic start population and a mutation for stagnant hawks; one search
//! with switches keeps them the same everywhere else, and each change can be judged alone.
//! Source: Heidari et al. (2019) and their published program; Ren, Zhao & Han (2023), Sec. 4.3
//! and 4.4, Eq. (5) to (7).
//! Deviates: trial points are clipped before they are evaluated, not after, so that the answer is
//! inside the box. A hawk whose value is known is not evaluated again, and the moves after the last
//! evaluation of the population, which nobody would look at, are not made: the answer is the same,
//! with fewer calls. With the mutation on, every new position is clipped and evaluated at once,
//! because the mutation needs the values of all hawks.

use crate::error::{Result, require_between};

use super::hunt::Hunt;
use super::search::Search;
use super::start::{self, Spread};
use super::{Bounds, Budget, Optimizer};

/// Which hawks Eq. (7) is for; the paper says "the stagnant population" and no more.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum MutationReading {
    /// A hawk that did not improve while it besieged or dived.
    #[default]
    Stagnant,
    /// Every hawk that besieged or dived.
    EveryHawk,
    /// A hawk that dived and did not improve.
    AfterDives,
    /// A hawk that besieged and did not improve.
    AfterBesieges,
}

/// Settings of the search by hawks; the default is TMCHHO.
///
/// What to expect: two of the rules (O_prey − O and O_prey − O_avg) pull the hawks towards the
/// origin of the coordinates. The sum of squares of ten coordinates falls to 10⁻²⁶ (HHO) or 10⁻³⁰
/// (TMCHHO) within 100 iterations where its minimum is the origin, and by both forms alike only to
/// about 10³ where the minimum lies elsewhere in ±100.
///
/// ```
/// use tmchho::optim::HawkOptions;
/// // HHO with the chaotic start alone:
/// let options = HawkOptions { chaotic_start: true, ..HawkOptions::hho() };
/// assert!(!options.trigonometric_mutation && options.n_hawks == 30);
/// ```
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct HawkOptions {
    /// Size of the population; ≥ 4.
    pub n_hawks: usize,
    /// How often the population is evaluated; ≥ 1.
    pub n_iterations: usize,
    /// Calls of the objective after which the search ends; ≥ 1, `None` for no limit.
    pub max_evaluations: Option<usize>,
    /// Factor of the Lévy flight; ≥ 0.
    pub levy_factor: f64,
    /// Variance of the mutation's factor o; ≥ 0.
    pub mutation_variance: f64,
    /// Start from the chaotic map of Eq. (6) instead of uniform random numbers.
    pub chaotic_start: bool,
    /// Mutate hawks by Eq. (7), and keep the mutation where it is better.
    pub trigonometric_mutation: bool,
    /// Which hawks are mutated.
    pub mutation_reading: MutationReading,
    /// Apply the rules in coordinates whose origin is the prey: no place is favoured, and J, which
    /// multiplies the place of the prey, has no effect. Not in the paper.
    pub translation_invariant: bool,
    /// Seconds after which the search ends; ≥ 0, `None` for no limit. No key of a configuration,
    /// because a search that ends by the clock cannot be repeated.
    #[serde(skip)]
    pub max_seconds: Option<f64>,
}

impl Default for HawkOptions {
    fn default() -> Self {
        Self {
            n_hawks: 30,
            n_iterations: 500,
            max_evaluations: None,
            levy_factor: 1.0,
            mutation_variance: 0.1,
            chaotic_start: true,
            trigonometric_mutation: true,
            mutation_reading: MutationReading::default(),
            translation_invariant: false,
            max_seconds: None,
        }
    }
}

impl HawkOptions {
    /// Trigonometric mutation chaotic Harris hawk optimisation: both improvements.
    pub fn tmchho() -> Self {
        Self::default()
    }

    /// Plain Harris hawk optimisation: neither improvement.
    pub fn hho() -> Self {
        Self {
            chaotic_start: false,
            trigonometric_mutation: false,
            ..Self::default()
        }
    }

    /// TMCHHO without the pull towards the origin: ours, not the paper's.
    pub fn tmchho_free() -> Self {
        Self {
            translation_invariant: true,
            ..Self::default()
        }
    }

    pub(crate) fn check(&self) -> Result<()> {
        self.budget().check("n_hawks")?;
        require_between("levy_factor", self.levy_factor, 0.0, f64::MAX)?;
        require_between("mutation_variance", self.mutation_variance, 0.0, f64::MAX)?;
        Ok(())
    }

    /// The same with another size and other limits.
    pub(super) fn within(self, budget: Budget) -> Self {
        Self {
            n_hawks: budget.population_size,
            n_iterations: budget.n_iterations,
            max_evaluations: budget.max_evaluations,
            max_seconds: budget.max_seconds,
            ..self
        }
    }

    /// The size and the limits alone.
    pub(crate) fn budget(&self) -> Budget {
        Budget {
            population_size: self.n_hawks,
            n_iterations: self.n_iterations,
            max_evaluations: self.max_evaluations,
            max_seconds: self.max_seconds,
        }
    }
}

impl Optimizer for HawkOptions {
    fn search(&self, bounds: &Bounds, seed: u64, start: &[Vec<f64>]) -> Result<Search> {
        self.check()?;
        let spread = if self.chaotic_start {
            Spread::Chaotic
        } else {
            Spread::Uniform
        };
        let hawks = start::population(spread, self.n_hawks, bounds, seed, start)?;
        let hunt = Hunt::new(self, bounds, seed, hawks);
        Ok(Search::new(Box::new(hunt), &self.budget()))
    }
}

#[cfg(test)]
mod tests {
    use std::ops::ControlFlow;

    use super::*;
    use crate::error::Error;
    use crate::optim::StopReason;
    use crate::optim::test_functions;
    use crate::parallel::with_threads;

    fn short(options: HawkOptions) -> HawkOptions {
        HawkOptions {
            n_iterations: 40,
            ..options
        }
    }

    #[test]
    fn the_same_bits_at_any_number_of_threads_and_other_ones_for_another_seed() {
        let ackley = test_functions::by_name("f6").unwrap();
        let bounds = ackley.bounds(10).unwrap();
        for options in [HawkOptions::hho(), HawkOptions::tmchho()].map(short) {
            let run = |n_threads, seed| {
                with_threads(Some(n_threads), || {
                    options.minimize(&ackley.evaluate, &bounds, seed)
                })
                .unwrap()
            };
            let one = run(1, 5);
            // Printed, because that tells any two numbers apart, and 0 from -0 as well.
            let one_printed = format!("{one:?}");
            for n_threads in [1, 2, 4] {
                assert_eq!(one_printed, format!("{:?}", run(n_threads, 5)));
            }
            assert_ne!(one.history, run(1, 6).history);
        }
    }

    #[test]
    fn the_default_is_the_method_of_the_paper_and_unknown_keys_are_refused() {
        let parsed: HawkOptions = serde_json::from_str("{}").unwrap();
        assert_eq!(parsed, HawkOptions::tmchho());
        assert!(serde_json::from_str::<HawkOptions>(r#"{"n_hawk": 3}"#).is_err());
    }

    #[test]
    fn a_setting_out_of_its_range_is_refused_by_name() {
        let refused = |name: &str, change: fn(&mut HawkOptions)| {
            let mut options = HawkOptions::default();
            change(&mut options);
            let bounds = Bounds::cube(2, -1.0, 1.0).unwrap();
            match options.minimize(&|_: &[f64]| 0.0, &bounds, 0) {
                Err(Error::InvalidArgument { name: found, .. }) => assert_eq!(found, name),
                other => panic!("{name}: {other:?}"),
            }
        };
        refused("n_hawks", |options| options.n_hawks = 3);
        refused("n_iterations", |options| options.n_iterations = 0);
        refused("max_evaluations", |options| {
            options.max_evaluations = Some(0)
        });
        refused("levy_factor", |options| options.levy_factor = -1.0);
        refused("mutation_variance", |options| {
            options.mutation_variance = f64::NAN
        });
    }

    #[test]
    fn a_listener_hears_every_iteration_and_can_stop() {
        let bounds = Bounds::cube(3, -1.0, 1.0).unwrap();
        let sphere = |x: &[f64]| x.iter().map(|v| v * v).sum::<f64>();
        let mut heard = Vec::new();
        let found = HawkOptions::tmchho()
            .minimize_from(&sphere, &bounds, 1, &[], &mut |report| {
                assert_eq!(sphere(report.x), report.fun);
                assert_eq!(report.max_iterations, 500);
                heard.push(report.fun);
                if report.n_iterations == 7 {
                    ControlFlow::Break(())
                } else {
                    ControlFlow::Continue(())
                }
            })
            .unwrap();
        assert_eq!(found.stop_reason, StopReason::Callback);
        assert_eq!(found.history, heard);
        assert_eq!(found.n_iterations, 7);
    }
}
