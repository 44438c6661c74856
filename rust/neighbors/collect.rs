//! What a search of the tree is for: the nearest, the k nearest, all within a radius, or a count.

use std::cmp::Ordering;

use super::Neighbor;
use super::blocks::{Block, WIDTH, lanes_within, smaller};
use crate::cloud::Point;

/// What a search from one place is for.
pub(crate) trait Collector {
    /// Whether one point of a pile of coincident ones says all.
    const TAKES_PILES_FOR_ONE: bool = false;
    /// Squared distance beyond which nothing is of interest any more.
    fn reach_sq(&self) -> f64;
    /// At the reach itself only points of lower indices are of interest.
    fn index_at_reach(&self) -> u32 {
        u32::MAX
    }
    /// Takes note of the points of block number `number`; whether the reach has changed.
    fn take(&mut self, place: &Point, block: &Block, number: usize) -> bool;
}

/// A point that was found, and where in the tree it stands.
#[derive(Debug, Clone, Copy)]
pub(super) struct Held {
    pub(super) distance_sq: f64,
    pub(super) index: u32,
    pub(super) slot: u32,
}

impl Held {
    /// Nobody yet, out to a squared distance.
    #[inline(always)]
    fn nobody(distance_sq: f64) -> Self {
        Self {
            distance_sq,
            index: u32::MAX,
            slot: u32::MAX,
        }
    }

    /// Lane `lane` of block number `number`.
    #[inline(always)]
    fn new(distance_sq: f64, block: &Block, number: usize, lane: usize) -> Self {
        Self {
            distance_sq,
            index: block.indices[lane],
            slot: (number * WIDTH + lane) as u32,
        }
    }

    /// The order of answers: by rising distance, then index.
    #[inline(always)]
    fn comes_before(&self, other: &Self) -> bool {
        let is_tied = self.distance_sq == other.distance_sq;
        self.distance_sq < other.distance_sq || (is_tied && self.index < other.index)
    }

    fn order(&self, other: &Self) -> Ordering {
        let by_distance = self.distance_sq.total_cmp(&other.distance_sq);
        by_distance.then(self.index.cmp(&other.index))
    }
}

impl From<Held> for Neighbor {
    #[inline(always)]
    fn from(held: Held) -> Self {
        Self {
            index: held.index,
            distance_sq: held.distance_sq,
        }
    }
}

/// The least of eight.
#[inline(always)]
fn least(d: &[f64; WIDTH]) -> f64 {
    smaller(
        smaller(smaller(d[0], d[1]), smaller(d[2], d[3])),
        smaller(smaller(d[4], d[5]), smaller(d[6], d[7])),
    )
}

/// The nearest point; of several the one with the lowest index.
#[derive(Clone, Copy)]
pub(super) struct Nearest {
    best: Held,
}

impl Nearest {
    /// Among the points whose squared distance is at most `most_sq`.
    #[inline]
    pub(super) fn within(most_sq: f64) -> Self {
        Self {
            best: Held::nobody(most_sq),
        }
    }

    /// What was found.
    #[inline]
    pub(super) fn found(&self) -> Option<Held> {
        (self.best.index != u32::MAX).then_some(self.best)
    }
}

impl Collector for Nearest {
    #[inline(always)]
    fn reach_sq(&self) -> f64 {
        self.best.distance_sq
    }

    #[inline(always)]
    fn index_at_reach(&self) -> u32 {
        self.best.index
    }

    #[inline(always)]
    fn take(&mut self, place: &Point, block: &Block, number: usize) -> bool {
        let distances_sq = block.distances_sq(place);
        let least = least(&distances_sq);
        if least > self.best.distance_sq {
            return false;
        }
        // The first of those as near, which has the lowest index of the block.
        let mut lane = 0;
        for other in (0..WIDTH).rev() {
            if distances_sq[other] == least {
                lane = other;
            }
        }
        let found = Held::new(least, block, number, lane);
        let is_nearer = found.comes_before(&self.best);
        if is_nearer {
            self.best = found;
        }
        is_nearer
    }
}

/// The nearest point, and if wanted how far the second nearest is.
#[derive(Clone, Copy)]
pub(super) struct NearestTwo {
    best: Held,
    second_sq: f64,
    wants_second: bool,
}

impl NearestTwo {
    /// Among the points whose squared distance is at most `most_sq`; none where that is negative.
    #[inline]
    pub(super) fn within(most_sq: f64) -> Self {
        Self {
            best: Held::nobody(most_sq),
            second_sq: most_sq,
            wants_second: true,
        }
    }

    /// The nearest alone.
    #[inline]
    pub(super) fn alone_within(most_sq: f64) -> Self {
        Self {
            wants_second: false,
            ..Self::within(most_sq)
        }
    }

    /// The nearest, and a squared distance below which there is no other.
    #[inline]
    pub(super) fn found(&self) -> (Option<Held>, f64) {
        let found = (self.best.index != u32::MAX).then_some(self.best);
        (
            found,
            if self.wants_second {
                self.second_sq
            } else {
                self.best.distance_sq
            },
        )
    }
}

impl Collector for NearestTwo {
    #[inline(always)]
    fn reach_sq(&self) -> f64 {
        if self.wants_second {
            self.second_sq
        } else {
            self.best.distance_sq
        }
    }

    #[inline(always)]
    fn index_at_reach(&self) -> u32 {
        if self.best.distance_sq == self.reach_sq() {
            self.best.index
        } else {
            0
        }
    }

    #[inline(always)]
    fn take(&mut self, place: &Point, block: &Block, number: usize) -> bool {
        let distances_sq = block.distances_sq(place);
        let before = self.reach_sq();
        if least(&distances_sq) > before {
            return false;
        }
        for lane in 0..WIDTH {
            let found = Held::new(distances_sq[lane], block, number, lane);
            if found.comes_before(&self.best) {
                self.second_sq = self.best.distance_sq;
                self.best = found;
            } else if found.distance_sq < self.second_sq {
                self.second_sq = found.distance_sq;
            }
        }
        self.reach_sq() < before
    }
}

/// The nearest point that does not coincide with the place.
#[derive(Clone, Copy)]
pub(super) struct NearestElsewhere(pub(super) Nearest);

impl Collector for NearestElsewhere {
    const TAKES_PILES_FOR_ONE: bool = true;

    #[inline]
    fn reach_sq(&self) -> f64 {
        self.0.reach_sq()
    }

    #[inline]
    fn index_at_reach(&self) -> u32 {
        self.0.index_at_reach()
    }

    #[inline]
    fn take(&mut self, place: &Point, block: &Block, number: usize) -> bool {
        let before = self.0.best.index;
        for (lane, distance_sq) in block.distances_sq(place).into_iter().enumerate() {
            let found = Held::new(distance_sq, block, number, lane);
            if distance_sq > 0.0 && found.comes_before(&self.0.best) {
                self.0.best = found;
            }
        }
        self.0.best.index != before
    }
}

/// The k nearest points, in no particular order; of several as far as the k-th those with the lowest
/// indices.
#[derive(Default)]
pub(super) struct KNearest {
    k: usize,
    reach_sq: f64,
    index_at_reach: u32,
    /// The k nearest so far, and others seen since the reach was last drawn in.
    pub(super) found: Vec<Held>,
}

impl KNearest {
    /// Begins anew, in the same memory, among the points whose squared distance is at most `most_sq`.
    #[inline]
    pub(super) fn restart(&mut self, k: usize, most_sq: f64) {
        self.k = k;
        self.reach_sq = if k == 0 { -1.0 } else { most_sq.min(f64::MAX) };
        self.index_at_reach = u32::MAX;
        self.found.clear();
    }

    /// Drops all but the k nearest.
    fn draw_in(&mut self) {
        if self.found.len() > self.k {
            self.found.select_nth_unstable_by(self.k - 1, Held::order);
            self.found.truncate(self.k);
        }
        if self.found.len() == self.k {
            let last = self.found.iter().max_by(|a, b| a.order(b));
            (self.reach_sq, self.index_at_reach) =
                last.map_or((-1.0, 0), |last| (last.distance_sq, last.index));
        }
    }

    /// Whether there were as many as asked for.
    #[inline]
    pub(super) fn is_complete(&self) -> bool {
        self.found.len() >= self.k
    }

    /// Leaves no more than was asked for.
    #[inline]
    pub(super) fn finish(&mut self) {
        if self.k > 0 {
            self.draw_in();
        }
    }

    /// What was found, by rising distance, then index.
    pub(super) fn finish_in_order(&mut self) -> &[Held] {
        self.finish();
        self.found.sort_unstable_by(Held::order);
        &self.found
    }
}

impl Collector for KNearest {
    #[inline(always)]
    fn reach_sq(&self) -> f64 {
        self.reach_sq
    }

    #[inline(always)]
    fn index_at_reach(&self) -> u32 {
        self.index_at_reach
    }

    #[inline(always)]
    fn take(&mut self, place: &Point, block: &Block, number: usize) -> bool {
        let distances_sq = block.distances_sq(place);
        let mut lanes = lanes_within(&distances_sq, &[self.reach_sq; WIDTH]);
        while lanes != 0 {
            let lane = lanes.trailing_zeros() as usize;
            lanes &= lanes - 1;
            let held = Held::new(distances_sq[lane], block, number, lane);
            self.found.push(held);
        }
        // Not for every point: drawing in costs as much as looking at two or three blocks.
        let most = if self.reach_sq == f64::MAX {
            self.k
        } else {
            2 * self.k
        };
        let is_full = self.found.len() >= most;
        if is_full {
            self.draw_in();
        }
        is_full
    }
}

/// The points within a radius, in the order of the blocks.
#[derive(Default)]
pub(super) struct Within {
    radius_sq: f64,
    pub(super) found: Vec<Held>,
}

impl Within {
    /// Begins anew, in the same memory.
    #[inline]
    pub(super) fn restart(&mut self, radius_m: f64) {
        self.radius_sq = reach_of(radius_m);
        self.found.clear();
    }
}

/// The square of a radius; a negative one reaches nothing, an infinite one not what is no point.
#[inline]
pub(crate) fn reach_of(radius_m: f64) -> f64 {
    (radius_m * radius_m.abs()).min(f64::MAX)
}

impl Collector for Within {
    #[inline(always)]
    fn reach_sq(&self) -> f64 {
        self.radius_sq
    }

    #[inline(always)]
    fn take(&mut self, place: &Point, block: &Block, number: usize) -> bool {
        let distances_sq = block.distances_sq(place);
        let mut lanes = lanes_within(&distances_sq, &[self.radius_sq; WIDTH]);
        while lanes != 0 {
            let lane = lanes.trailing_zeros() as usize;
            lanes &= lanes - 1;
            let held = Held::new(distances_sq[lane], block, number, lane);
            self.found.push(held);
        }
        false
    }
}

/// How many points lie within a radius, counted up to a limit.
#[derive(Clone, Copy)]
pub(super) struct Count {
    radius_sq: f64,
    n_left: usize,
}

impl Count {
    /// Up to `at_most`.
    #[inline]
    pub(super) fn within(radius_m: f64, at_most: usize) -> Self {
        Self {
            radius_sq: reach_of(radius_m),
            n_left: at_most,
        }
    }

    /// How many of the limit were not found.
    #[inline]
    pub(super) fn n_left(&self) -> usize {
        self.n_left
    }
}

impl Collector for Count {
    #[inline(always)]
    fn reach_sq(&self) -> f64 {
        if self.n_left > 0 {
            self.radius_sq
        } else {
            -1.0
        }
    }

    #[inline(always)]
    fn take(&mut self, place: &Point, block: &Block, _: usize) -> bool {
        let mut n_within = 0;
        for distance_sq in block.distances_sq(place) {
            n_within += usize::from(distance_sq <= self.radius_sq);
        }
        self.n_left = self.n_left.saturating_sub(n_within);
        self.n_left == 0
    }
}
