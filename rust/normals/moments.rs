//! Sums over the points near a place, from which the plane through them follows.
//!
//! Why: summed while the tree is searched, eight points by the same few vector instructions, they cost half of
//! holding the points and going through them afterwards.

use super::{LEAST_POINTS, Surface, Symmetric};
use crate::cloud::Point;
use crate::neighbors::{Block, Collector, WIDTH, reach_of, sum_of_squares};

/// Sums side by side, one vector of any processor.
const LANES: usize = 2;

/// How many points lie within a radius of a place, their offsets from it, and the products of these.
#[derive(Clone)]
pub(super) struct Moments {
    radius_sq: f64,
    n: [f64; LANES],
    /// x, y, z.
    offsets: [[f64; LANES]; 3],
    /// xx, yy, zz.
    squares: [[f64; LANES]; 3],
    /// yz, xz, xy: each beside the axis that it lacks.
    products: [[f64; LANES]; 3],
}

impl Moments {
    pub(super) fn within(radius_m: f64) -> Self {
        Self {
            radius_sq: reach_of(radius_m),
            n: [0.0; LANES],
            offsets: [[0.0; LANES]; 3],
            squares: [[0.0; LANES]; 3],
            products: [[0.0; LANES]; 3],
        }
    }

    /// Number of points.
    pub(super) fn n(&self) -> usize {
        total(&self.n) as usize
    }

    /// The plane of least squares through the points.
    pub(super) fn surface(&self) -> Surface {
        let n = total(&self.n);
        if self.n() < LEAST_POINTS {
            return Surface::NONE;
        }
        let about_place = Symmetric::new(
            self.squares.each_ref().map(total),
            self.products.each_ref().map(total),
        );
        let mut scatter = about_place;
        scatter.add(self.offsets.each_ref().map(|sum| total(sum) / n), -n);
        Surface::of(&scatter, n, about_place.trace())
    }
}

impl Collector for Moments {
    #[inline(always)]
    fn reach_sq(&self) -> f64 {
        self.radius_sq
    }

    #[inline(always)]
    fn take(&mut self, place: &Point, block: &Block, _: usize) -> bool {
        let mut offsets = block.offsets(place);
        let distances_sq = sum_of_squares(&offsets);
        let mut is_near = [0.0; WIDTH];
        for lane in 0..WIDTH {
            let near = distances_sq[lane] <= self.radius_sq;
            is_near[lane] = if near { 1.0 } else { 0.0 };
            for along in &mut offsets {
                along[lane] = if near { along[lane] } else { 0.0 };
            }
        }
        add(&mut self.n, &is_near);
        for axis in 0..3 {
            let (next, last) = (&offsets[(axis + 1) % 3], &offsets[(axis + 2) % 3]);
            add(&mut self.offsets[axis], &offsets[axis]);
            add(&mut self.squares[axis], &offsets[axis].map(|v| v * v));
            let products = std::array::from_fn(|lane| next[lane] * last[lane]);
            add(&mut self.products[axis], &products);
        }
        false
    }
}

#[inline(always)]
fn add(sums: &mut [f64; LANES], values: &[f64; WIDTH]) {
    for (i, value) in values.iter().enumerate() {
        sums[i % LANES] += value;
    }
}

fn total(sums: &[f64; LANES]) -> f64 {
    sums.iter().sum()
}
