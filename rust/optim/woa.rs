//! Whale optimisation (WOA): whales close in on the best one by shrinking steps or along a spiral.
//!
//! Source: Mirjalili & Lewis (2016) and their published program; Ren, Zhao & Han (2023), Table 2,
//! for the spiral's constant.
//! Deviates: nowhere. As in the program, the leader is brought up to date once per iteration, the
//! whales then move in place, one after another, and the random whale is drawn anew for each
//! coordinate. To know: C times a position is not translation-invariant; the whales, too, are drawn to
//! the origin.

use std::f64::consts::TAU;

use crate::error::{Error, Result};
use crate::random::Stream;

use super::crowd::{AtOnce, Crowd, MovesAtOnce};
use super::search::Search;
use super::start::{self, Spread};
use super::{Bounds, Budget, Optimizer};

/// Settings of the whales.
#[derive(Debug, Clone, PartialEq)]
pub struct WoaOptions {
    /// Size of the population and limits of the search.
    pub budget: Budget,
    /// b, the constant of the spiral; finite.
    pub spiral: f64,
}

impl Default for WoaOptions {
    fn default() -> Self {
        Self {
            budget: Budget::default(),
            spiral: 1.0,
        }
    }
}

/// One coordinate on the way to another whale, the leader or a random one: X' − A |C X' − X|.
///
/// ```
/// use tmchho::optim::woa::encircle;
/// assert_eq!(encircle(1.0, 3.0, 0.5, 2.0), 0.5); // 3 - 0.5 * |2 * 3 - 1|
/// ```
pub fn encircle(x: f64, other: f64, a: f64, c: f64) -> f64 {
    other - a * (c * other - x).abs()
}

/// One coordinate on the spiral round the leader: |X* − X| e^(b l) cos(2π l) + X*.
///
/// ```
/// use tmchho::optim::woa::spiral;
/// assert!((spiral(1.0, 3.0, 1.0, -1.0) - (3.0 + 2.0 / 1.0_f64.exp())).abs() < 1e-15);
/// ```
pub fn spiral(x: f64, leader: f64, b: f64, l: f64) -> f64 {
    (leader - x).abs() * (b * l).exp() * (TAU * l).cos() + leader
}

impl Optimizer for WoaOptions {
    fn search(&self, bounds: &Bounds, seed: u64, start: &[Vec<f64>]) -> Result<Search> {
        self.budget.check("population_size")?;
        if !self.spiral.is_finite() {
            return Err(Error::argument(
                "spiral",
                format!("must be a finite number, got {}", self.spiral),
            ));
        }
        let n = self.budget.population_size;
        let whales = start::population(Spread::Uniform, n, bounds, seed, start)?;
        let pod = Pod {
            options: self.clone(),
            stream: Stream::new(seed, "whale moves", 0),
        };
        let search = AtOnce::new(whales, bounds, pod);
        Ok(Search::new(Box::new(search), &self.budget))
    }
}

/// What moves the whales.
#[derive(Clone)]
struct Pod {
    options: WoaOptions,
    stream: Stream,
}

impl MovesAtOnce for Pod {
    fn move_all(&mut self, crowd: &mut Crowd, iteration: usize) {
        let (whales, leader) = (&mut crowd.places, &crowd.best);
        let share = iteration as f64 / self.options.budget.n_iterations as f64;
        // a falls from 2 to 0, the lower end of l from -1 to -2.
        let (shrink, lowest) = (2.0 - 2.0 * share, -1.0 - share);
        for i in 0..whales.len() {
            let stream = &mut self.stream;
            let a = 2.0 * shrink * stream.uniform() - shrink;
            let c = 2.0 * stream.uniform();
            let l = (lowest - 1.0) * stream.uniform() + 1.0;
            let is_encircling = stream.uniform() < 0.5;
            for d in 0..leader.len() {
                let x = whales[i][d];
                whales[i][d] = if !is_encircling {
                    spiral(x, leader[d], self.options.spiral, l)
                } else if a.abs() >= 1.0 {
                    let random_whale = stream.below(whales.len());
                    encircle(x, whales[random_whale][d], a, c)
                } else {
                    encircle(x, leader[d], a, c)
                };
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn moves_by_hand() {
        assert_eq!(encircle(-2.0, 4.0, -1.5, 0.25), 8.5); // 4 + 1.5 * |0.25 * 4 + 2|
        // cos(2π) = 1: |1 - 4| e^(0.5 * 2 * ln 4 / 2) + 1, with l = 1 and b = ln 2.
        let value = spiral(4.0, 1.0, 2.0_f64.ln(), 1.0);
        assert!((value - 7.0).abs() < 1e-14, "{value}"); // 3 * 2 + 1
        // cos(π) = -1
        let value = spiral(4.0, 1.0, 0.0, 0.5);
        assert!((value + 2.0).abs() < 1e-14, "{value}"); // -3 + 1
    }
}
