//! The tree behind the neighbour index.
//!
//! Source: Friedman, Bentley & Finkel (1977), median splits of the widest side; Arya & Mount
//! (1993), the distance to a box kept up to date axis by axis on the way down.
//! Deviates: coincident points stay together in one pile, whatever their number.

mod region;

use super::collect::Collector;
use crate::cloud::{Point, distance_sq};
use crate::parallel;

/// Most points in a leaf; a pile of coincident points may hold more.
const LEAF_POINTS: usize = 12;

/// Subtrees of at least so many points are built side by side.
const PARALLEL_POINTS: usize = 8192;

/// Points sorted into nested boxes.
#[derive(Debug, Clone)]
pub(super) struct Tree {
    /// The points in the order of the leaves.
    entries: Vec<Entry>,
    /// Every node is followed by its left subtree, then its right one.
    nodes: Vec<Node>,
    low: Point,
    high: Point,
}

#[derive(Debug, Clone, Copy)]
struct Entry {
    point: Point,
    index: u32,
}

#[derive(Debug, Clone, Copy)]
enum Node {
    Split {
        axis: u8,
        /// The right subtree starts so many nodes further on.
        right: u32,
        /// No point of the left subtree lies above this.
        left_high: f64,
        /// No point of the right subtree lies below this.
        right_low: f64,
    },
    /// A few entries.
    Leaf { start: u32, end: u32 },
    /// Entries at one and the same place, by rising index.
    Pile { start: u32, end: u32 },
}

impl Tree {
    pub(super) fn new(points: &[Point]) -> Self {
        let mut entries: Vec<Entry> = (0_u32..)
            .zip(points)
            .map(|(index, &point)| Entry { point, index })
            .collect();
        let (low, high) = bounds(&entries);
        let nodes = build(&mut entries, 0);
        Self {
            entries,
            nodes,
            low,
            high,
        }
    }

    /// Number of points in the largest pile; 0 where no points coincide.
    pub(super) fn largest_pile(&self) -> usize {
        let size = |node: &Node| match node {
            Node::Pile { start, end } => (end - start) as usize,
            _ => 0,
        };
        self.nodes.iter().map(size).max().unwrap_or(0)
    }

    /// Offers to `collector` every point within its reach.
    pub(super) fn search(&self, place: &Point, collector: &mut impl Collector) {
        if self.entries.is_empty() {
            return;
        }
        let gap = std::array::from_fn(|axis| {
            (self.low[axis] - place[axis])
                .max(place[axis] - self.high[axis])
                .max(0.0)
        });
        // False for a place that is not a number.
        if place.iter().all(|v| v.is_finite()) && norm_sq(&gap) <= collector.reach_sq() {
            self.descend(0, place, gap, collector);
        }
    }

    /// Visits the subtree at `node`, whose box is at least `gap` from `place` along each axis.
    fn descend(&self, node: usize, place: &Point, gap: Point, collector: &mut impl Collector) {
        match self.nodes[node] {
            Node::Leaf { start, end } => {
                for entry in &self.entries[start as usize..end as usize] {
                    collector.offer(distance_sq(place, &entry.point), entry.index);
                }
            }
            Node::Pile { start, end } => {
                let pile = &self.entries[start as usize..end as usize];
                let distance_sq = distance_sq(place, &pile[0].point);
                for entry in pile.iter().take(collector.most_of_a_pile()) {
                    collector.offer(distance_sq, entry.index);
                }
            }
            Node::Split {
                axis,
                right,
                left_high,
                right_low,
            } => {
                let axis = usize::from(axis);
                let (left, right) = (node + 1, node + right as usize);
                let (above_left, below_right) = (place[axis] - left_high, right_low - place[axis]);
                let ((near, near_gap), (far, far_gap)) = if above_left < below_right {
                    ((left, above_left), (right, below_right))
                } else {
                    ((right, below_right), (left, above_left))
                };
                for (child, child_gap) in [(near, near_gap), (far, far_gap)] {
                    let mut gap = gap;
                    gap[axis] = gap[axis].max(child_gap);
                    if norm_sq(&gap) <= collector.reach_sq() {
                        self.descend(child, place, gap, collector);
                    }
                }
            }
        }
    }
}

/// The nodes over `entries`, the first of which is entry number `start` of the whole index.
fn build(entries: &mut [Entry], start: usize) -> Vec<Node> {
    let mut nodes = Vec::with_capacity(2 * entries.len() / LEAF_POINTS + 1);
    grow(entries, start, &mut nodes);
    nodes
}

fn grow(entries: &mut [Entry], start: usize, nodes: &mut Vec<Node>) {
    let this = nodes.len();
    let (first, end) = (start as u32, (start + entries.len()) as u32);
    let (low, high) = bounds(entries);
    let side = |axis: usize| high[axis] - low[axis];
    let wider = |a, b| if side(b) > side(a) { b } else { a };
    let axis = wider(wider(0, 1), 2);
    if entries.len() > 1 && side(axis) == 0.0 {
        entries.sort_unstable_by_key(|entry| entry.index);
        nodes.push(Node::Pile { start: first, end });
        return;
    }
    nodes.push(Node::Leaf { start: first, end });
    if entries.len() <= LEAF_POINTS {
        return;
    }
    let middle = entries.len() / 2;
    let by_axis = |a: &Entry, b: &Entry| a.point[axis].total_cmp(&b.point[axis]);
    let (below, median, _) = entries.select_nth_unstable_by(middle, by_axis);
    let right_low = median.point[axis];
    let left_high = bounds(below).1[axis];
    let (left, right) = entries.split_at_mut(middle);
    let right_nodes = if left.len() < PARALLEL_POINTS {
        grow(left, start, nodes);
        None
    } else {
        let (left, right) = parallel::both(|| build(left, start), || build(right, start + middle));
        nodes.extend(left);
        Some(right)
    };
    nodes[this] = Node::Split {
        axis: axis as u8,
        right: (nodes.len() - this) as u32,
        left_high,
        right_low,
    };
    match right_nodes {
        None => grow(right, start + middle, nodes),
        Some(right_nodes) => nodes.extend(right_nodes),
    }
}

fn bounds(entries: &[Entry]) -> (Point, Point) {
    let mut low = [f64::INFINITY; 3];
    let mut high = [f64::NEG_INFINITY; 3];
    for entry in entries {
        for axis in 0..3 {
            low[axis] = low[axis].min(entry.point[axis]);
            high[axis] = high[axis].max(entry.point[axis]);
        }
    }
    (low, high)
}

/// Summed in the order of [`distance_sq`]: rounding is monotone, so a box is never held to be
/// farther than a point in it.
#[inline]
fn norm_sq(v: &Point) -> f64 {
    v[0] * v[0] + v[1] * v[1] + v[2] * v[2]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn coincident_points_are_one_pile_by_rising_index() {
        let mut points = vec![[1.0, 2.0, 3.0]; 1000];
        assert_eq!(Tree::new(&points).nodes.len(), 1);
        points.push([5.0, 2.0, 3.0]);
        let tree = Tree::new(&points);
        // The stray is split off in ten halvings, each of which leaves a pile behind.
        assert!(tree.nodes.len() < 25, "{}", tree.nodes.len());
        for node in &tree.nodes {
            if let Node::Pile { start, end } = *node {
                let pile = &tree.entries[start as usize..end as usize];
                assert!(pile.is_sorted_by_key(|entry| entry.index));
                assert!(pile.iter().all(|entry| entry.point == points[0]));
            }
        }
    }
}
