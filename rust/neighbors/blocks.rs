//! The tree behind the neighbour index: points in blocks of eight, boxes round eight of them at a time.
//!
//! Why: eight boxes, or eight points, are measured by the same few vector instructions; eight places
//! close together go down the tree once (`group.rs`).
//! Memory: 28 bytes a point in blocks, 8 in boxes.
//! Source: Wald, Benthin & Boulos (2008), trees of many branches searched by packets; Friedman,
//! Bentley & Finkel (1977), whose median splits (`sort.rs`) make the blocks. Deviates: nowhere.

mod region;

use super::sort::Entry;
use crate::cloud::{Point, distance_sq};
use crate::parallel;

/// Points in a block, and children of a node.
pub(crate) const WIDTH: usize = 8;

/// More than any search has waiting: seven siblings at each of eleven levels, and the last ones.
const MOST_WAITING: usize = 96;

/// Eight points. The last block is filled up with points at infinity, of index `u32::MAX`.
#[derive(Debug, Clone)]
pub(crate) struct Block {
    coordinates: [[f64; WIDTH]; 3],
    /// Rising.
    pub(crate) indices: [u32; WIDTH],
}

impl Block {
    fn new(entries: &[Entry]) -> Self {
        let mut block = Self {
            coordinates: [[f64::INFINITY; WIDTH]; 3],
            indices: [u32::MAX; WIDTH],
        };
        for (lane, entry) in entries.iter().enumerate() {
            block.indices[lane] = entry.index;
            for axis in 0..3 {
                block.coordinates[axis][lane] = entry.point[axis];
            }
        }
        block
    }

    /// From `place` to each of the points, along the axes.
    #[inline(always)]
    pub(crate) fn offsets(&self, place: &Point) -> [[f64; WIDTH]; 3] {
        let mut offsets = self.coordinates;
        for axis in 0..3 {
            for lane in 0..WIDTH {
                offsets[axis][lane] -= place[axis];
            }
        }
        offsets
    }

    /// Squared distances from `place`.
    #[inline(always)]
    pub(crate) fn distances_sq(&self, place: &Point) -> [f64; WIDTH] {
        sum_of_squares(&self.offsets(place))
    }

    fn n_points(&self) -> usize {
        self.indices.iter().filter(|i| **i != u32::MAX).count()
    }
}

/// In the order of [`crate::cloud::distance_sq`]: rounding is monotone, so a box is never held to be
/// farther than a point in it.
#[inline(always)]
pub(crate) fn sum_of_squares<const N: usize>(v: &[[f64; N]; 3]) -> [f64; N] {
    std::array::from_fn(|i| v[0][i] * v[0][i] + v[1][i] * v[1][i] + v[2][i] * v[2][i])
}

/// The greater of two; not a NaN of `a`. One instruction, which `f64::max` is not.
#[inline(always)]
pub(super) fn greater(a: f64, b: f64) -> f64 {
    if a > b { a } else { b }
}

/// The smaller of two; not a NaN of `a`.
#[inline(always)]
pub(super) fn smaller(a: f64, b: f64) -> f64 {
    if a < b { a } else { b }
}

/// A bit for each lane whose distance is within its reach. No branch: which lanes these are, a
/// processor cannot guess.
#[inline(always)]
pub(super) fn lanes_within<const N: usize>(gaps_sq: &[f64; N], reach_sq: &[f64; N]) -> u32 {
    let mut lanes = 0;
    for lane in 0..N {
        lanes |= u32::from(gaps_sq[lane] <= reach_sq[lane]) << lane;
    }
    lanes
}

/// Boxes round eight blocks or nodes. Where there are fewer, the others are empty, at infinity.
#[derive(Debug, Clone)]
pub(super) struct Node {
    low: [[f64; WIDTH]; 3],
    high: [[f64; WIDTH]; 3],
    /// The lowest index of a point in each.
    least_index: [u32; WIDTH],
    /// Number of the first child, counting nodes before blocks.
    first_child: u32,
    /// All points below stand at one place.
    is_pile: bool,
}

impl Node {
    fn new(children: &[Bounds], first_child: usize) -> Self {
        let mut node = Self {
            low: [[f64::INFINITY; WIDTH]; 3],
            high: [[f64::NEG_INFINITY; WIDTH]; 3],
            least_index: [u32::MAX; WIDTH],
            first_child: first_child as u32,
            is_pile: false,
        };
        for (lane, child) in children.iter().enumerate() {
            for axis in 0..3 {
                node.low[axis][lane] = child.low[axis];
                node.high[axis][lane] = child.high[axis];
            }
            node.least_index[lane] = child.least_index;
        }
        let bounds = node.bounds();
        node.is_pile = bounds.low == bounds.high;
        node
    }

    fn bounds(&self) -> Bounds {
        Bounds {
            low: self
                .low
                .map(|low| low.into_iter().fold(f64::INFINITY, f64::min)),
            high: self
                .high
                .map(|high| high.into_iter().fold(f64::NEG_INFINITY, f64::max)),
            least_index: self.least_index.into_iter().fold(u32::MAX, u32::min),
        }
    }

    /// The lower and the upper corner of the box round one child.
    #[inline(always)]
    pub(super) fn child_box(&self, lane: usize) -> (Point, Point) {
        (
            self.low.map(|low| low[lane]),
            self.high.map(|high| high[lane]),
        )
    }

    /// Squared distances from the box of a search to those of the children.
    #[inline(always)]
    fn gaps_sq(&self, low: &Point, high: &Point) -> [f64; WIDTH] {
        let mut gaps = [[0.0; WIDTH]; 3];
        for axis in 0..3 {
            for lane in 0..WIDTH {
                let below = self.low[axis][lane] - high[axis];
                let above = low[axis] - self.high[axis][lane];
                gaps[axis][lane] = greater(greater(below, above), 0.0);
            }
        }
        sum_of_squares(&gaps)
    }
}

#[derive(Clone, Copy)]
struct Bounds {
    low: Point,
    high: Point,
    least_index: u32,
}

impl Bounds {
    fn of(block: &Block) -> Self {
        let n = block.n_points();
        let of_axis = |axis: usize| block.coordinates[axis][..n].iter().copied();
        Self {
            low: std::array::from_fn(|axis| of_axis(axis).fold(f64::INFINITY, smaller)),
            high: std::array::from_fn(|axis| of_axis(axis).fold(f64::NEG_INFINITY, greater)),
            least_index: block.indices[0],
        }
    }
}

/// What goes down the tree.
pub(super) trait Search {
    /// The box of the places asked about.
    fn bounds(&self) -> (Point, Point);
    /// Squared distance beyond which nothing is of interest any more.
    fn reach_sq(&self) -> f64;
    /// At the reach itself only points of lower indices are of interest.
    fn index_at_reach(&self) -> u32;
    /// Whether one point of a pile of coincident ones says all.
    fn takes_piles_for_one(&self) -> bool;
    /// Looks at block number `number`, child number `lane` of `node`.
    fn visit(&mut self, block: &Block, number: usize, node: &Node, lane: usize);
}

/// A child that a search has yet to look at.
#[derive(Clone, Copy, Default)]
struct Waiting {
    gap_sq: f64,
    child: u32,
    least_index: u32,
    parent: u32,
}

/// Points sorted into nested boxes.
#[derive(Debug, Clone)]
pub(super) struct Blocks {
    /// From the root down, level by level.
    nodes: Vec<Node>,
    blocks: Vec<Block>,
    n_points: usize,
}

impl Blocks {
    /// Of entries in blocks.
    pub(super) fn new(entries: &[Entry]) -> Self {
        let blocks = parallel::map(entries.len().div_ceil(WIDTH), |i| {
            Block::new(&entries[i * WIDTH..entries.len().min((i + 1) * WIDTH)])
        });
        let mut bounds = parallel::map(blocks.len(), |i| Bounds::of(&blocks[i]));
        // From the blocks up; children are numbered once the number of nodes is known.
        let mut levels: Vec<Vec<Node>> = Vec::new();
        while levels.is_empty() || bounds.len() > 1 {
            let level: Vec<Node> = bounds.chunks(WIDTH).map(|c| Node::new(c, 0)).collect();
            bounds = level.iter().map(Node::bounds).collect();
            levels.push(level);
        }
        let mut nodes: Vec<Node> = Vec::new();
        for level in levels.into_iter().rev() {
            let children = nodes.len() + level.len();
            nodes.extend(level.into_iter().enumerate().map(|(i, node)| Node {
                first_child: (children + i * WIDTH) as u32,
                ..node
            }));
        }
        Self {
            nodes,
            blocks,
            n_points: entries.len(),
        }
    }

    /// The point at `slot`: lane `slot` modulo [`WIDTH`] of block `slot` by [`WIDTH`].
    #[inline]
    pub(super) fn point(&self, slot: u32) -> Point {
        let (block, lane) = (slot as usize / WIDTH, slot as usize % WIDTH);
        self.blocks[block].coordinates.map(|along| along[lane])
    }

    /// Number of points.
    pub(super) fn len(&self) -> usize {
        self.n_points
    }

    /// The points by rising index.
    pub(super) fn points(&self) -> Vec<Point> {
        let mut points = vec![[0.0; 3]; self.n_points];
        for entry in (0..self.n_points).map(|at| self.entry(at)) {
            points[entry.index as usize] = entry.point;
        }
        points
    }

    /// Block number `at`.
    #[inline]
    pub(super) fn block(&self, at: usize) -> &Block {
        &self.blocks[at]
    }

    /// The diagonal of the box round a block, on average over some of them; 0 where there are none.
    pub(super) fn mean_width_of_blocks(&self) -> f64 {
        mean_of_some(self.blocks.len(), |i| {
            let bounds = Bounds::of(&self.blocks[i]);
            distance_sq(&bounds.low, &bounds.high).sqrt()
        })
    }

    /// Whether more than two blocks in a row hold nothing but copies of one point.
    pub(super) fn has_piles(&self) -> bool {
        let is_pile = |node: &Node| node.is_pile && node.least_index[2] != u32::MAX;
        self.nodes.iter().any(is_pile)
    }

    /// Point number `at` in the order of the blocks, with its index.
    #[inline]
    pub(super) fn entry(&self, at: usize) -> Entry {
        let (block, lane) = (&self.blocks[at / WIDTH], at % WIDTH);
        Entry {
            point: block.coordinates.map(|along| along[lane]),
            index: block.indices[lane],
        }
    }

    /// Shows `search` every block within its reach, near ones first.
    #[inline]
    pub(super) fn search(&self, search: &mut impl Search) {
        if self.blocks.is_empty() {
            return;
        }
        let (low, high) = search.bounds();
        let n_nodes = self.nodes.len() as u32;
        let mut waiting = [Waiting::default(); MOST_WAITING];
        let mut n_waiting = 1;
        while n_waiting > 0 {
            n_waiting -= 1;
            let Waiting {
                gap_sq,
                child,
                least_index,
                parent,
            } = waiting[n_waiting];
            let reach_sq = search.reach_sq();
            // The empty children of a last node are infinitely far, and of the highest index.
            if gap_sq > reach_sq || (gap_sq == reach_sq && least_index >= search.index_at_reach()) {
                continue;
            }
            if child >= n_nodes {
                let parent = &self.nodes[parent as usize];
                let lane = (child - parent.first_child) as usize;
                let number = (child - n_nodes) as usize;
                search.visit(&self.blocks[number], number, parent, lane);
                continue;
            }
            let node = &self.nodes[child as usize];
            let gaps_sq = node.gaps_sq(&low, &high);
            let mut lanes = lanes_within(&gaps_sq, &[reach_sq; WIDTH]);
            if node.is_pile && search.takes_piles_for_one() {
                lanes &= 1;
            }
            let first = n_waiting;
            let mut nearest = (f64::INFINITY, first);
            while lanes != 0 {
                let lane = lanes.trailing_zeros() as usize;
                lanes &= lanes - 1;
                let gap_sq = gaps_sq[lane];
                if gap_sq < nearest.0 {
                    nearest = (gap_sq, n_waiting);
                }
                waiting[n_waiting] = Waiting {
                    gap_sq,
                    child: node.first_child + lane as u32,
                    least_index: node.least_index[lane],
                    parent: child,
                };
                n_waiting += 1;
            }
            if n_waiting > first {
                waiting.swap(nearest.1, n_waiting - 1);
            }
        }
    }
}

/// The mean of `f` over evenly spread indices below `n`.
pub(super) fn mean_of_some(n: usize, f: impl Fn(usize) -> f64) -> f64 {
    const SOME: usize = 1000;
    let step = n.div_ceil(SOME).max(1);
    let n_looked_at = n.div_ceil(step).max(1);
    (0..n).step_by(step).map(f).sum::<f64>() / n_looked_at as f64
}

#[cfg(test)]
mod tests {
    use super::super::sort::into_blocks;
    use super::*;
    use crate::random::Stream;

    #[test]
    fn every_box_holds_what_is_below_it() {
        let mut stream = Stream::new(1, "blocks", 0);
        let points: Vec<Point> = (0..5003).map(|_| [0; 3].map(|_| stream.normal())).collect();
        let tree = Blocks::new(&into_blocks(&points));
        assert_eq!(tree.len(), points.len());
        for entry in (0..tree.len()).map(|at| tree.entry(at)) {
            assert_eq!(entry.point, points[entry.index as usize]);
        }
        assert_eq!(tree.points(), points);
        for node in &tree.nodes {
            for lane in (0..WIDTH).filter(|lane| node.least_index[*lane] != u32::MAX) {
                let child = node.first_child as usize + lane;
                let below = match child.checked_sub(tree.nodes.len()) {
                    None => tree.nodes[child].bounds(),
                    Some(block) => Bounds::of(&tree.blocks[block]),
                };
                assert_eq!(node.child_box(lane), (below.low, below.high));
                assert_eq!(node.least_index[lane], below.least_index);
            }
        }
    }

    #[test]
    fn a_pile_is_known_as_one() {
        let mut points = vec![[1.0, 2.0, 3.0]; 1000];
        points.push([5.0, 2.0, 3.0]);
        let tree = Blocks::new(&into_blocks(&points));
        let n_piles = tree.nodes.iter().filter(|node| node.is_pile).count();
        assert_eq!(n_piles, tree.nodes.len() - 3); // all but those above the stray
    }
}
