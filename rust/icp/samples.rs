//! Samples of both clouds, with which the refinement begins.
//!
//! Why: far from rest every step changes every partner, and a search among few points costs a fraction
//! of one among all. A sample comes to rest within its own accuracy, from where all points need a few steps.
//! Both clouds are thinned alike: few places far apart in a dense cloud would be searched one by one.

use crate::cloud::Point;
use crate::neighbors::Places;
use crate::normals::Surface;
use crate::random::Stream;

/// Samples with which the refinement begins: one of every so many points, ever denser.
pub(super) fn strides(n: usize) -> Vec<usize> {
    /// Each has so many times the points of the one before, so that all together cost little beside
    /// all points.
    const GROWTH: usize = 8;
    /// A smaller sample is no longer spread over what holds the pose.
    const LEAST: usize = 2000;
    let strides = std::iter::successors(Some(GROWTH), |stride| Some(stride * GROWTH));
    let mut strides: Vec<usize> = strides.take_while(|stride| n / stride >= LEAST).collect();
    strides.reverse();
    strides
}

/// Points of a cloud, with their surfaces where they have some.
pub(super) struct Sample {
    pub(super) points: Vec<Point>,
    pub(super) surfaces: Vec<Surface>,
}

impl Sample {
    /// One of every `stride` points that follow each other, drawn at random: clouds that come in rows
    /// would show the same columns again and again.
    pub(super) fn of(order: &Places, surfaces: &[Surface], stride: usize) -> Self {
        let mut stream = Stream::new(0, "samples of icp", stride as u64);
        let mut draw = |first: usize| {
            let n = stride.min(order.len() - first);
            match n {
                1 => first,
                _ => first + (stream.uniform() * n as f64) as usize,
            }
        };
        let drawn: Vec<usize> = (0..order.len()).step_by(stride).map(&mut draw).collect();
        Self {
            points: drawn.iter().map(|at| *order.point(*at)).collect(),
            surfaces: match surfaces {
                [] => Vec::new(),
                surfaces => drawn.iter().map(|at| surfaces[order.given(*at)]).collect(),
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_grow_up_to_an_eighth_of_the_points() {
        assert_eq!(strides(300_000), [64, 8]);
        assert_eq!(strides(16_000), [8]);
        assert_eq!(strides(15_999), [0; 0]);
    }

    #[test]
    fn a_sample_has_one_of_every_so_many_and_all_columns_of_rows() {
        let points: Vec<Point> = (0..1003)
            .map(|i| [f64::from(i % 8), f64::from(i / 8), 0.0])
            .collect();
        let order = Places::as_given(&points);
        let sample = Sample::of(&order, &[], 8);
        assert_eq!(sample.points.len(), 126);
        for (row, p) in sample.points.iter().enumerate() {
            assert_eq!(p[1], row as f64);
        }
        assert!((0..8).all(|column| sample.points.iter().any(|p| p[0] == f64::from(column))));
        assert_eq!(Sample::of(&order, &[], 1).points, points);
    }
}
