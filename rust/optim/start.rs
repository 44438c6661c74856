//! Where the members of a swarm start.

use crate::error::{Error, Result};
use crate::random::Stream;

use super::{Bounds, chaos};

/// How the population is spread over the box.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Spread {
    /// By uniform random numbers.
    Uniform,
    /// By the chaotic map of Eq. (6).
    Chaotic,
}

/// `n` points spread over the box, the last ones replaced by the points given.
pub(super) fn population(
    spread: Spread,
    n: usize,
    bounds: &Bounds,
    seed: u64,
    given: &[Vec<f64>],
) -> Result<Vec<Vec<f64>>> {
    if given.len() > n {
        return Err(Error::argument(
            "start",
            format!(
                "must have at most as many points as the population, {n}, got {}",
                given.len()
            ),
        ));
    }
    let mut population = match spread {
        Spread::Chaotic => chaos::population(bounds, n, seed),
        Spread::Uniform => {
            let mut stream = Stream::new(seed, "uniform start", 0);
            let mut fractions = std::iter::repeat_with(|| stream.uniform());
            (0..n).map(|_| bounds.at(&mut fractions)).collect()
        }
    };
    for (i, point) in given.iter().enumerate() {
        if point.len() != bounds.dimension() || !point.iter().all(|x| x.is_finite()) {
            return Err(Error::argument(
                "start",
                format!(
                    "must have points of {} finite coordinates, got {point:?} at index {i}",
                    bounds.dimension()
                ),
            ));
        }
        let member = &mut population[n - given.len() + i];
        member.clone_from(point);
        bounds.clip(member);
    }
    Ok(population)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn given_points_replace_the_last_ones() {
        let bounds = Bounds::cube(2, -1.0, 1.0).unwrap();
        for spread in [Spread::Uniform, Spread::Chaotic] {
            let start = |given: &[Vec<f64>]| population(spread, 30, &bounds, 3, given);
            let without = start(&[]).unwrap();
            let with = start(&[vec![0.5, 0.25], vec![9.0, 0.0]]).unwrap();
            assert_eq!(with[..28], without[..28]);
            assert_eq!(with[28..], [vec![0.5, 0.25], vec![1.0, 0.0]]);

            let refused = |given: &[Vec<f64>]| {
                let error = start(given).unwrap_err();
                assert!(error.to_string().starts_with("start must"), "{error}");
            };
            refused(&vec![vec![0.0, 0.0]; 31]);
            refused(&[vec![0.0]]);
            refused(&[vec![0.0, f64::NAN]]);
        }
    }
}
