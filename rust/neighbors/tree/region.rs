//! All points in a ball or in a cylinder, one after another, in no order that matters.
//!
//! Why: sums over thousands of points need neither a list nor an order; and a cylinder that is long
//! and thin would need many balls.
//! Source: the tree of `neighbors/tree.rs`; a box is passed by where the plane across the shortest way
//! from the axis to its middle stands between (Gottschalk, Lin & Manocha 1996, separating axes).
//! Deviates: nowhere; points of the boxes that are left are tested one by one.

use super::{Node, Tree};
use crate::cloud::Point;
use crate::neighbors::NeighborIndex;

/// A part of space.
trait Region {
    /// False only where no point of the box lies inside.
    fn may_meet(&self, low: &Point, high: &Point) -> bool;
    /// Takes note of a point, if it lies inside.
    fn offer(&mut self, point: &Point);
}

struct Ball<'a, F> {
    centre: &'a Point,
    radius_sq: f64,
    found: F,
}

impl<F: FnMut(Point, f64)> Region for Ball<'_, F> {
    #[inline]
    fn may_meet(&self, low: &Point, high: &Point) -> bool {
        let mut distance_sq = 0.0;
        for axis in 0..3 {
            let gap = (low[axis] - self.centre[axis])
                .max(self.centre[axis] - high[axis])
                .max(0.0);
            distance_sq += gap * gap;
        }
        distance_sq <= self.radius_sq
    }

    #[inline]
    fn offer(&mut self, point: &Point) {
        let offset = minus(point, self.centre);
        let distance_sq = dot(&offset, &offset);
        if distance_sq <= self.radius_sq {
            (self.found)(offset, distance_sq);
        }
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
    fn may_meet(&self, low: &Point, high: &Point) -> bool {
        let half: Point = std::array::from_fn(|axis| 0.5 * (high[axis] - low[axis]));
        let middle: Point = std::array::from_fn(|axis| low[axis] + half[axis] - self.centre[axis]);
        let along = dot(&middle, self.axis);
        let reach = half[0] * self.axis[0].abs()
            + half[1] * self.axis[1].abs()
            + half[2] * self.axis[2].abs();
        if along.abs() > self.half_length_m + reach {
            return false;
        }
        // Seen from the axis the box begins `gap` along the way to its middle, `across` away.
        let across: Point = std::array::from_fn(|axis| middle[axis] - along * self.axis[axis]);
        let across_sq = dot(&across, &across);
        let gap_times_across = across_sq
            - half[0] * across[0].abs()
            - half[1] * across[1].abs()
            - half[2] * across[2].abs();
        // Rounding must not lose a box that only touches.
        gap_times_across <= 0.0
            || gap_times_across * gap_times_across
                <= self.radius_m * self.radius_m * across_sq * (1.0 + 1e-9)
    }

    #[inline]
    fn offer(&mut self, point: &Point) {
        let offset = minus(point, self.centre);
        let along = dot(&offset, self.axis);
        if along.abs() <= self.half_length_m
            && dot(&offset, &offset) - along * along <= self.radius_m * self.radius_m
        {
            (self.found)(along, offset);
        }
    }
}

impl NeighborIndex {
    /// Calls `found` with the offset from `centre`, and its square, of every point at most `radius_m`
    /// away.
    pub(crate) fn each_in_ball(
        &self,
        centre: &Point,
        radius_m: f64,
        found: impl FnMut(Point, f64),
    ) {
        let radius_sq = radius_m * radius_m;
        self.tree.visit(&mut Ball {
            centre,
            radius_sq,
            found,
        });
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
        self.tree.visit(&mut Cylinder {
            centre,
            axis,
            radius_m,
            half_length_m,
            found,
        });
    }
}

impl Tree {
    fn visit(&self, region: &mut impl Region) {
        if !self.entries.is_empty() && region.may_meet(&self.low, &self.high) {
            self.enter(0, self.low, self.high, region);
        }
    }

    /// Visits the subtree at `node`, all of which lies in the box.
    fn enter(&self, node: usize, low: Point, high: Point, region: &mut impl Region) {
        match self.nodes[node] {
            Node::Leaf { start, end } | Node::Pile { start, end } => {
                for entry in &self.entries[start as usize..end as usize] {
                    region.offer(&entry.point);
                }
            }
            Node::Split {
                axis,
                right,
                left_high,
                right_low,
            } => {
                let axis = usize::from(axis);
                let (mut below, mut above) = (high, low);
                (below[axis], above[axis]) = (left_high, right_low);
                if region.may_meet(&low, &below) {
                    self.enter(node + 1, low, below, region);
                }
                if region.may_meet(&above, &high) {
                    self.enter(node + right as usize, above, high, region);
                }
            }
        }
    }
}

#[inline]
fn minus(a: &Point, b: &Point) -> Point {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

#[inline]
fn dot(a: &Point, b: &Point) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Stream;

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
