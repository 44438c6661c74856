//! Another pose that fits, and how it differs from the best one.

use crate::cloud::{Point, distance_sq};
use crate::similarity::Similarity;

/// How another pose differs from the best one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rival {
    /// By how much it is turned.
    pub turned_rad: f64,
    /// By how much it moves the middle of the source.
    pub shifted_m: f64,
}

impl Rival {
    /// How `rival` differs from `best` at the `middle` of the source.
    pub fn between(best: &Similarity, rival: &Similarity, middle: &Point) -> Self {
        Self {
            turned_rad: (rival.rigid * best.rigid.inverse()).rotation_angle_rad(),
            shifted_m: distance_sq(&rival.apply(middle), &best.apply(middle)).sqrt(),
        }
    }

    pub(super) fn words(rival: Option<&Self>) -> String {
        rival.map_or(String::new(), |rival| {
            format!(
                ", which is turned by {:.0}° and shifted by {:.3} m",
                rival.turned_rad.to_degrees(),
                rival.shifted_m
            )
        })
    }
}
