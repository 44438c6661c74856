//! All methods by name, with the settings that they share.

use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};

use super::{
    BoaOptions, Bounds, Budget, DoaOptions, HawkOptions, MutationReading, Optimizer, PsoOptions,
    Search, WoaOptions,
};

/// A way of searching.
///
/// ```
/// use tmchho::optim::Method;
/// assert_eq!(Method::by_name("tmchho_free")?, Method::TmchhoFree);
/// assert_eq!(Method::ALL.map(Method::name)[0], "tmchho");
/// # Ok::<(), tmchho::Error>(())
/// ```
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Method {
    /// Trigonometric mutation chaotic Harris hawks: the paper's.
    #[default]
    Tmchho,
    /// The same without the pull towards the origin: ours.
    TmchhoFree,
    /// Harris hawks.
    Hho,
    /// Particle swarm.
    Pso,
    /// Whales.
    Woa,
    /// Butterflies.
    Boa,
    /// Dingoes.
    Doa,
}

impl Method {
    /// All of them.
    pub const ALL: [Self; 7] = [
        Self::Tmchho,
        Self::TmchhoFree,
        Self::Hho,
        Self::Pso,
        Self::Woa,
        Self::Boa,
        Self::Doa,
    ];

    /// Its name in configurations and in Python.
    pub fn name(self) -> &'static str {
        match self {
            Self::Tmchho => "tmchho",
            Self::TmchhoFree => "tmchho_free",
            Self::Hho => "hho",
            Self::Pso => "pso",
            Self::Woa => "woa",
            Self::Boa => "boa",
            Self::Doa => "doa",
        }
    }

    /// The method called so.
    ///
    /// # Errors
    /// [`Error::InvalidArgument`] for any other name.
    pub fn by_name(name: &str) -> Result<Self> {
        Self::ALL
            .into_iter()
            .find(|method| method.name() == name)
            .ok_or_else(|| {
                let names = Self::ALL.map(Self::name).join(", ");
                Error::argument("method", format!("must be one of {names}, got {name}"))
            })
    }

    /// With the settings given for hawks; the methods without hawks take size and limits alone.
    ///
    /// # Errors
    /// [`Error::InvalidArgument`] for a setting that is not the default and that the method has not.
    pub(crate) fn with_hawks(self, hawks: &HawkOptions) -> Result<Box<dyn Optimizer>> {
        let other = match self.with_budget(hawks.budget()) {
            Known::Other(other) => other,
            Known::Hawks(own) => {
                return Ok(Box::new(HawkOptions {
                    chaotic_start: own.chaotic_start && hawks.chaotic_start,
                    trigonometric_mutation: own.trigonometric_mutation
                        && hawks.trigonometric_mutation,
                    translation_invariant: own.translation_invariant || hawks.translation_invariant,
                    ..hawks.clone()
                }));
            }
        };
        let default = HawkOptions::default();
        for (name, is_default) in [
            ("levy_factor", hawks.levy_factor == default.levy_factor),
            (
                "mutation_variance",
                hawks.mutation_variance == default.mutation_variance,
            ),
            (
                "chaotic_start",
                hawks.chaotic_start == default.chaotic_start,
            ),
            (
                "trigonometric_mutation",
                hawks.trigonometric_mutation == default.trigonometric_mutation,
            ),
            (
                "mutation_reading",
                hawks.mutation_reading == default.mutation_reading,
            ),
            (
                "translation_invariant",
                hawks.translation_invariant == default.translation_invariant,
            ),
        ] {
            if !is_default {
                return Err(not_of(name, self));
            }
        }
        Ok(other)
    }

    /// With its own settings.
    fn with_budget(self, budget: Budget) -> Known {
        match self {
            Self::Tmchho => Known::Hawks(HawkOptions::tmchho().within(budget)),
            Self::TmchhoFree => Known::Hawks(HawkOptions::tmchho_free().within(budget)),
            Self::Hho => Known::Hawks(HawkOptions::hho().within(budget)),
            Self::Pso => Known::Other(Box::new(PsoOptions {
                budget,
                ..PsoOptions::default()
            })),
            Self::Woa => Known::Other(Box::new(WoaOptions {
                budget,
                ..WoaOptions::default()
            })),
            Self::Boa => Known::Other(Box::new(BoaOptions {
                budget,
                ..BoaOptions::default()
            })),
            Self::Doa => Known::Other(Box::new(DoaOptions {
                budget,
                ..DoaOptions::default()
            })),
        }
    }
}

/// A method with its settings; those of hawks can be changed.
enum Known {
    Hawks(HawkOptions),
    Other(Box<dyn Optimizer>),
}

/// Settings of whatever method; `None` stands for the method's own.
///
/// ```
/// use tmchho::optim::{Method, Optimizer, Problem, SwarmOptions};
/// let rastrigin = Problem::new("f5", 10)?;
/// for method in Method::ALL {
///     let options = SwarmOptions { n_iterations: Some(50), ..SwarmOptions::new(method) };
///     let found = options.minimize(&rastrigin, &rastrigin.bounds()?, 1)?;
///     assert_eq!(found.n_iterations, 50);
/// }
/// # Ok::<(), tmchho::Error>(())
/// ```
#[derive(Debug, Clone, Default, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SwarmOptions {
    /// Which method.
    pub method: Method,
    /// As in [`Budget`].
    pub population_size: Option<usize>,
    /// As in [`Budget`].
    pub n_iterations: Option<usize>,
    /// As in [`Budget`].
    pub max_evaluations: Option<usize>,
    /// As in [`Budget`].
    pub max_seconds: Option<f64>,
    /// As in [`HawkOptions`], and for its methods only, like all that follow.
    pub levy_factor: Option<f64>,
    /// As in [`HawkOptions`].
    pub mutation_variance: Option<f64>,
    /// As in [`HawkOptions`].
    pub chaotic_start: Option<bool>,
    /// As in [`HawkOptions`].
    pub trigonometric_mutation: Option<bool>,
    /// As in [`HawkOptions`].
    pub mutation_reading: Option<MutationReading>,
}

impl SwarmOptions {
    /// The method with its own settings.
    pub fn new(method: Method) -> Self {
        Self {
            method,
            ..Self::default()
        }
    }

    fn optimizer(&self) -> Result<Box<dyn Optimizer>> {
        let default = Budget::default();
        let budget = Budget {
            population_size: self.population_size.unwrap_or(default.population_size),
            n_iterations: self.n_iterations.unwrap_or(default.n_iterations),
            max_evaluations: self.max_evaluations,
            max_seconds: self.max_seconds,
        };
        budget.check("population_size")?;
        let hawks = match self.method.with_budget(budget) {
            Known::Hawks(hawks) => hawks,
            Known::Other(other) => {
                for (name, is_given) in [
                    ("levy_factor", self.levy_factor.is_some()),
                    ("mutation_variance", self.mutation_variance.is_some()),
                    ("chaotic_start", self.chaotic_start.is_some()),
                    (
                        "trigonometric_mutation",
                        self.trigonometric_mutation.is_some(),
                    ),
                    ("mutation_reading", self.mutation_reading.is_some()),
                ] {
                    if is_given {
                        return Err(not_of(name, self.method));
                    }
                }
                return Ok(other);
            }
        };
        Ok(Box::new(HawkOptions {
            levy_factor: self.levy_factor.unwrap_or(hawks.levy_factor),
            mutation_variance: self.mutation_variance.unwrap_or(hawks.mutation_variance),
            chaotic_start: self.chaotic_start.unwrap_or(hawks.chaotic_start),
            trigonometric_mutation: (self.trigonometric_mutation)
                .unwrap_or(hawks.trigonometric_mutation),
            mutation_reading: self.mutation_reading.unwrap_or(hawks.mutation_reading),
            ..hawks
        }))
    }
}

impl Optimizer for SwarmOptions {
    fn search(&self, bounds: &Bounds, seed: u64, start: &[Vec<f64>]) -> Result<Search> {
        self.optimizer()?.search(bounds, seed, start)
    }
}

/// A setting given to a method that has none of it.
fn not_of(setting: &str, method: Method) -> Error {
    Error::argument(
        setting,
        format!(
            "is a setting of hho, tmchho and tmchho_free; {} has none: leave it out",
            method.name()
        ),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_those_of_configurations() {
        for method in Method::ALL {
            assert_eq!(Method::by_name(method.name()).unwrap(), method);
            let json = format!("\"{}\"", method.name());
            assert_eq!(serde_json::to_string(&method).unwrap(), json);
        }
        let error = Method::by_name("gwo").unwrap_err().to_string();
        assert!(error.starts_with("method must be one of tmchho, ") && error.ends_with("got gwo"));
    }

    #[test]
    fn a_setting_of_hawks_is_refused_by_the_others() {
        let bounds = Bounds::cube(2, -1.0, 1.0).unwrap();
        for method in [Method::Pso, Method::Woa, Method::Boa, Method::Doa] {
            let options = SwarmOptions {
                chaotic_start: Some(false),
                ..SwarmOptions::new(method)
            };
            let error = options.search(&bounds, 0, &[]).err().unwrap().to_string();
            assert!(
                error.starts_with("chaotic_start is a setting of hho"),
                "{error}"
            );
        }
        for method in Method::ALL {
            let options = SwarmOptions {
                population_size: Some(3),
                ..SwarmOptions::new(method)
            };
            let error = options.search(&bounds, 0, &[]).err().unwrap().to_string();
            assert_eq!(error, "population_size must be at least 4, got 3");
        }
    }
}
