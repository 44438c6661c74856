//! All points in a ball or in a cylinder, one after another, in no order that matters.
//!
//! Why: sums over thousands of points need neither a list nor an order; and a cylinder that is long
//! and thin would need many balls.
//! Source: the tree of `neighbors/blocks.rs`; a box is passed by where the plane across the shortest way
//! from the axis to its middle stands between (Gottschalk, Lin & Manocha 1996, separating axes).
//! Deviates: nowhere; points of the boxes that are left are tested one by one.

use super::{Block, Blocks, Node, WIDTH, greater, sum_of_squares};
use crate::cloud::{Point, dot};
use crate::neighbors::NeighborIndex;

/// A part of space.
trait Region {
    /// A bit for each child that may hold a point inside; none for the empty ones, at infinity.
    fn lanes_that_may_meet(&self, node: &Node) -> u32;
    /// Takes note of the points of a block that lie inside; those at infinity do not.
    fn take(&mut self, block: &Block);
}

struct Ball<'a, F> {
    centre: &'a Point,
    radius_sq: f64,
    found: F,
}

impl<F: FnMut(Point, f64)> Region for Ball<'_, F> {
    #[inline]
    fn lanes_that_may_meet(&self, node: &Node) -> u32 {
        let mut gaps = [[0.0; WIDTH]; 3];
        for axis in 0..3 {
            for lane in 0..WIDTH {
                let below = node.low[axis][lane] - self.centre[axis];
                let above = self.centre[axis] - node.high[axis][lane];
                gaps[axis][lane] = greater(greater(below, above), 0.0);
            }
        }
        let gaps_sq = sum_of_squares(&gaps);
        bits(|lane| gaps_sq[lane] <= self.radius_sq)
    }

    #[inline]
    fn take(&mut self, block: &Block) {
        let offsets = block.offsets(self.centre);
        let distances_sq = sum_of_squares(&offsets);
        for_each_bit(bits(|lane| distances_sq[lane] <= self.radius_sq), |lane| {
            (self.found)(offsets.map(|along| along[lane]), distances_sq[lane]);
        });
    }
}

struct Cylinder<'a, F> {
    centre: &'a Point,
    axis: &'a Point,
    radius_m: f64,
    half_length_m: f64,
    found: F,
}

impl<F: FnMut(f64, Point)> Region for Cylinder<'_, F> {
    #[inline]
    fn lanes_that_may_meet(&self, node: &Node) -> u32 {
        let n = self.axis;
        let (mut half, mut middle) = ([[0.0; WIDTH]; 3], [[0.0; WIDTH]; 3]);
        for axis in 0..3 {
            for lane in 0..WIDTH {
                half[axis][lane] = 0.5 * (node.high[axis][lane] - node.low[axis][lane]);
                middle[axis][lane] = node.low[axis][lane] + half[axis][lane] - self.centre[axis];
            }
        }
        // Rounding must not lose a box that only touches.
        let radius_sq = self.radius_m * self.radius_m * (1.0 + 1e-9);
        bits(|lane| {
            let (h, m): (Point, Point) = (half.map(|v| v[lane]), middle.map(|v| v[lane]));
            let along = dot(&m, n);
            let reach = h[0] * n[0].abs() + h[1] * n[1].abs() + h[2] * n[2].abs();
            // Seen from the axis the box begins `gap` along the way to its middle, `across` away.
            let across: Point = std::array::from_fn(|axis| m[axis] - along * n[axis]);
            let across_sq = dot(&across, &across);
            let gap_times_across = across_sq
                - h[0] * across[0].abs()
                - h[1] * across[1].abs()
                - h[2] * across[2].abs();
            // No comparison holds for the NaN of an empty box.
            let is_near = gap_times_across <= 0.0
                || gap_times_across * gap_times_across <= radius_sq * across_sq;
            is_near & (along.abs() <= self.half_length_m + reach)
        })
    }

    #[inline]
    fn take(&mut self, block: &Block) {
        let offsets = block.offsets(self.centre);
        let distances_sq = sum_of_squares(&offsets);
        let mut along = [0.0; WIDTH];
        for lane in 0..WIDTH {
            along[lane] = offsets[0][lane] * self.axis[0]
                + offsets[1][lane] * self.axis[1]
                + offsets[2][lane] * self.axis[2];
        }
        let radius_sq = self.radius_m * self.radius_m;
        let lanes = bits(|lane| {
            (along[lane].abs() <= self.half_length_m)
                & (distances_sq[lane] - along[lane] * along[lane] <= radius_sq)
        });
        for_each_bit(lanes, |lane| {
            (self.found)(along[lane], offsets.map(|v| v[lane]));
        });
    }
}

#[inline(always)]
fn bits(is_set: impl Fn(usize) -> bool) -> u32 {
    (0..WIDTH).fold(0, |bits, lane| bits | u32::from(is_set(lane)) << lane)
}

#[inline(always)]
fn for_each_bit(mut bits: u32, mut f: impl FnMut(usize)) {
    while bits != 0 {
        f(bits.trailing_zeros() as usize);
        bits &= bits - 1;
    }
}

impl NeighborIndex {
    /// Calls `found` with the offset from `centre`, and its square, of every point at most `radius_m`
    /// away; never for a place that is not finite.
    pub(crate) fn each_in_ball(
        &self,
        centre: &Point,
        radius_m: f64,
        found: impl FnMut(Point, f64),
    ) {
        // Empty lanes stand at infinity, which no radius reaches.
        let radius_sq = (radius_m * radius_m).min(f64::MAX);
        self.tree.visit(
            centre,
            &mut Ball {
                centre,
                radius_sq,
                found,
            },
        );
    }

    /// Calls `found` with the place along `axis` (a unit vector) and the offset, both seen from
    /// `centre`, of every point of a cylinder round it: at most `radius_m` from the axis, at most
    /// `half_length_m` to either side.
    pub(crate) fn each_in_cylinder(
        &self,
        centre: &Point,
        axis: &Point,
        radius_m: f64,
        half_length_m: f64,
        found: impl FnMut(f64, Point),
    ) {
        self.tree.visit(
            centre,
            &mut Cylinder {
                centre,
                axis,
                radius_m,
                half_length_m,
                found,
            },
        );
    }
}

impl Blocks {
    fn visit(&self, centre: &Point, region: &mut impl Region) {
        if !self.blocks.is_empty() && centre.iter().all(|v| v.is_finite()) {
            self.enter(0, region);
        }
    }

    fn enter(&self, number: usize, region: &mut impl Region) {
        let node = &self.nodes[number];
        let first = node.first_child as usize;
        for_each_bit(region.lanes_that_may_meet(node), |lane| {
            match (first + lane).checked_sub(self.nodes.len()) {
                None => self.enter(first + lane, region),
                Some(block) => region.take(&self.blocks[block]),
            }
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Stream;

    fn minus(a: &Point, b: &Point) -> Point {
        std::array::from_fn(|axis| a[axis] - b[axis])
    }

    #[test]
    fn a_ball_larger_than_any_square_holds_the_points_and_no_empty_place() {
        for n in [1, 9] {
            let points: Vec<Point> = (0..n).map(|i| [f64::from(i), 0.0, 1.0]).collect();
            let index = NeighborIndex::new(&points);
            for radius_m in [1e154, 1e200, f64::INFINITY] {
                let mut found = 0;
                index.each_in_ball(&[0.0; 3], radius_m, |_, _| found += 1);
                assert_eq!(found, n, "{radius_m}");
            }
        }
    }

    #[test]
    fn balls_and_cylinders_hold_what_they_hold_in_a_list() {
        let mut stream = Stream::new(1, "region", 0);
        let mut points: Vec<Point> = (0..3000).map(|_| [0; 3].map(|_| stream.normal())).collect();
        for i in 0..300 {
            points[i] = points[i % 3];
            points[300 + i][2] = 0.25;
        }
        let index = NeighborIndex::new(&points);
        for n in 0..200 {
            let centre = [0; 3].map(|_| 1.5 * stream.normal());
            let mut axis = [0; 3].map(|_| stream.normal());
            if n % 4 == 0 {
                axis = [0.0, 0.0, -1.0];
            }
            let length = dot(&axis, &axis).sqrt();
            axis = axis.map(|v| v / length);
            let (radius, half) = (stream.uniform(), 3.0 * stream.uniform());
            let offsets = || points.iter().map(|p| minus(p, &centre));

            let (mut got, mut sum) = (0, 0.0);
            index.each_in_ball(&centre, radius, |_, distance_sq| {
                got += 1;
                sum += distance_sq;
            });
            let wanted = offsets()
                .map(|d| dot(&d, &d))
                .filter(|sq| *sq <= radius * radius);
            assert_eq!(got, wanted.clone().count());
            assert!((sum - wanted.sum::<f64>()).abs() < 1e-9);

            let (mut got, mut sum) = (0, 0.0);
            index.each_in_cylinder(&centre, &axis, radius, half, |along, _| {
                got += 1;
                sum += along;
            });
            let wanted = offsets().filter_map(|d| {
                let along = dot(&d, &axis);
                let inside = along.abs() <= half && dot(&d, &d) - along * along <= radius * radius;
                inside.then_some(along)
            });
            assert_eq!(got, wanted.clone().count());
            assert!((sum - wanted.sum::<f64>()).abs() < 1e-9);
        }
        NeighborIndex::new(&[]).each_in_ball(&[0.0; 3], 1.0, |_, _| unreachable!());
    }
}
