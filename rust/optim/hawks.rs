//! Harris hawks optimisation (HHO) and, with both improvements switched on, TMCHHO.
//!
//! Why: TMCHHO is HHO with a chaotic start population and a mutation for stagnant hawks; one loop
//! with two switches keeps them the same everywhere else, and either improvement can be judged alone.
//! Source: Heidari et al. (2019) and their published program; Ren, Zhao & Han (2023), Sec. 4.3
//! and 4.4, Eq. (5) to (7).
//! Deviates: trial points are clipped before they are evaluated, not after, so that the answer is
//! inside the box. A hawk whose value is known is not evaluated again, and the moves after the last
//! evaluation of the population, which nobody would look at, are not made: the answer is the same,
//! with fewer calls. With the mutation on, every new position is clipped and evaluated at once,
//! because the mutation needs the values of all hawks.

use crate::error::{Error, Result, require_at_least, require_count};
use crate::random::Stream;

use super::hunt::Hunt;
use super::{
    Bounds, IterationListener, IterationReport, Minimum, Objective, Optimizer, StopReason, chaos,
};

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
    /// Size of the population; ≥ 1 (the mutation needs 3).
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
    /// Mutate stagnant hawks by Eq. (7).
    pub trigonometric_mutation: bool,
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

    pub(crate) fn check(&self) -> Result<()> {
        require_count("n_hawks", self.n_hawks, 1, 1_000_000)?;
        require_count("n_iterations", self.n_iterations, 1, 10_000_000)?;
        if let Some(max_evaluations) = self.max_evaluations {
            require_at_least("max_evaluations", max_evaluations, 1)?;
        }
        for (name, value) in [
            ("levy_factor", self.levy_factor),
            ("mutation_variance", self.mutation_variance),
        ] {
            if !(value.is_finite() && value >= 0.0) {
                return Err(Error::argument(
                    name,
                    format!("must be a number of at least 0, got {value}"),
                ));
            }
        }
        Ok(())
    }
}

impl Optimizer for HawkOptions {
    fn minimize_from(
        &self,
        objective: &dyn Objective,
        bounds: &Bounds,
        seed: u64,
        start: &[Vec<f64>],
        on_iteration: &mut IterationListener<'_>,
    ) -> Result<Minimum> {
        self.check()?;
        let population = start_population(self, bounds, seed, start)?;
        let mut hunt = Hunt::new(self, objective, bounds, seed, population);
        let mut history = Vec::with_capacity(self.n_iterations);
        let stop_reason = loop {
            hunt.evaluate_hawks();
            hunt.update_prey();
            history.push(hunt.prey_fitness);
            let report = IterationReport {
                n_iterations: history.len(),
                max_iterations: self.n_iterations,
                n_evaluations: hunt.evaluator.n_evaluations,
                x: &hunt.prey,
                fun: hunt.prey_fitness,
            };
            if on_iteration(&report).is_break() {
                break StopReason::Callback;
            }
            if history.len() == self.n_iterations {
                break StopReason::MaxIterations;
            }
            if hunt.evaluator.is_spent() {
                break StopReason::MaxEvaluations;
            }
            hunt.move_hawks(history.len() - 1);
        };
        Ok(hunt.finish(history, stop_reason))
    }
}

/// Where the hawks start: spread over the box, the last ones on the points given.
fn start_population(
    options: &HawkOptions,
    bounds: &Bounds,
    seed: u64,
    start: &[Vec<f64>],
) -> Result<Vec<Vec<f64>>> {
    let n = options.n_hawks;
    if start.len() > n {
        return Err(Error::argument(
            "start",
            format!(
                "must have at most n_hawks = {n} points, got {}",
                start.len()
            ),
        ));
    }
    let mut population = if options.chaotic_start {
        chaos::population(bounds, n, seed)
    } else {
        let mut stream = Stream::new(seed, "uniform start", 0);
        let mut fractions = std::iter::repeat_with(|| stream.uniform());
        (0..n).map(|_| bounds.at(&mut fractions)).collect()
    };
    for (i, point) in start.iter().enumerate() {
        if point.len() != bounds.dimension() || !point.iter().all(|x| x.is_finite()) {
            return Err(Error::argument(
                "start",
                format!(
                    "must have points of {} finite coordinates, got {point:?} at index {i}",
                    bounds.dimension()
                ),
            ));
        }
        let hawk = &mut population[n - start.len() + i];
        hawk.clone_from(point);
        bounds.clip(hawk);
    }
    Ok(population)
}

#[cfg(test)]
mod tests {
    use std::ops::ControlFlow;

    use super::*;
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
        refused("n_hawks", |options| options.n_hawks = 0);
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
    fn start_points_replace_the_last_hawks() {
        let bounds = Bounds::cube(2, -1.0, 1.0).unwrap();
        let options = HawkOptions::hho();
        let without = start_population(&options, &bounds, 3, &[]).unwrap();
        let given = [vec![0.5, 0.25], vec![9.0, 0.0]];
        let with = start_population(&options, &bounds, 3, &given).unwrap();
        assert_eq!(with[..28], without[..28]);
        assert_eq!(with[28..], [vec![0.5, 0.25], vec![1.0, 0.0]]);

        let refused = |start: &[Vec<f64>]| {
            let error = start_population(&options, &bounds, 3, start).unwrap_err();
            assert!(error.to_string().starts_with("start must"), "{error}");
        };
        refused(&vec![vec![0.0, 0.0]; 31]);
        refused(&[vec![0.0]]);
        refused(&[vec![0.0, f64::NAN]]);
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
