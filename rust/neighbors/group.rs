//! Places close together that go down the tree at once, each with a search of its own.
//!
//! Why: eight neighbours would open nearly the same boxes one after the other. Together they open each
//! box once, and those of them that it does not concern are told by one vector of distances.

use std::sync::atomic::{AtomicU32, Ordering};

use super::blocks::{
    Block, Blocks, Node, Search, WIDTH, greater, lanes_within, mean_of_some, smaller,
    sum_of_squares,
};
use super::collect::Collector;
use super::sort::{Entry, into_blocks};
use crate::cloud::{Point, distance_sq};
use crate::error::Result;
use crate::parallel;
use crate::progress::Progress;

/// `K` places with a collector each.
struct Group<'a, C, const K: usize> {
    places: &'a [Point; K],
    /// The same, axis by axis.
    coordinates: [[f64; K]; 3],
    collectors: &'a mut [C; K],
    reach_sq: [f64; K],
    farthest_reach_sq: f64,
}

impl<'a, C: Collector, const K: usize> Group<'a, C, K> {
    fn new(places: &'a [Point; K], collectors: &'a mut [C; K]) -> Self {
        let mut group = Self {
            places,
            coordinates: std::array::from_fn(|axis| places.map(|place| place[axis])),
            reach_sq: std::array::from_fn(|lane| {
                // Nothing is near a place that is not a number.
                let is_finite = places[lane].iter().all(|v| v.is_finite());
                if is_finite {
                    collectors[lane].reach_sq()
                } else {
                    -1.0
                }
            }),
            collectors,
            farthest_reach_sq: 0.0,
        };
        group.farthest_reach_sq = group.reach_sq.into_iter().fold(-1.0, greater);
        group
    }
}

impl<C: Collector, const K: usize> Search for Group<'_, C, K> {
    fn bounds(&self) -> (Point, Point) {
        let finite = |v: &f64| v.is_finite();
        let of_axis = |axis: usize| self.coordinates[axis].iter().copied().filter(finite);
        (
            std::array::from_fn(|axis| of_axis(axis).fold(f64::INFINITY, smaller)),
            std::array::from_fn(|axis| of_axis(axis).fold(f64::NEG_INFINITY, greater)),
        )
    }

    #[inline(always)]
    fn reach_sq(&self) -> f64 {
        self.farthest_reach_sq
    }

    #[inline(always)]
    fn index_at_reach(&self) -> u32 {
        let indices = self.collectors.iter().map(C::index_at_reach);
        indices.fold(0, u32::max)
    }

    #[inline(always)]
    fn takes_piles_for_one(&self) -> bool {
        C::TAKES_PILES_FOR_ONE
    }

    #[inline(always)]
    fn visit(&mut self, block: &Block, number: usize, node: &Node, lane: usize) {
        let (low, high) = node.child_box(lane);
        let mut gaps = [[0.0; K]; 3];
        for axis in 0..3 {
            for lane in 0..K {
                let place = self.coordinates[axis][lane];
                gaps[axis][lane] = greater(greater(low[axis] - place, place - high[axis]), 0.0);
            }
        }
        let mut lanes = lanes_within(&sum_of_squares(&gaps), &self.reach_sq);
        let mut changed = false;
        while lanes != 0 {
            let lane = lanes.trailing_zeros() as usize;
            lanes &= lanes - 1;
            let collector = &mut self.collectors[lane];
            if collector.take(&self.places[lane], block, number) {
                self.reach_sq[lane] = collector.reach_sq();
                changed = true;
            }
        }
        if changed {
            self.farthest_reach_sq = self.reach_sq.into_iter().fold(-1.0, greater);
        }
    }
}

impl Blocks {
    /// Shows `collector` what is near `place`.
    #[inline]
    pub(super) fn ask(&self, place: &Point, collector: &mut impl Collector) {
        let mut search = Group::new(std::array::from_ref(place), std::array::from_mut(collector));
        self.search(&mut search);
    }

    /// The same of a few places close together; nothing is shown of a place that is not a number.
    #[inline]
    pub(super) fn ask_group<C: Collector>(
        &self,
        places: &[Point; WIDTH],
        collectors: &mut [C; WIDTH],
    ) {
        self.search(&mut Group::new(places, collectors));
    }

    /// The same of every one of `places`, in groups: `begin` readies a collector for a place, `end`
    /// makes of it what comes back, in the order in which the places were given. Both are told the
    /// number of the place in `places`, and have a scratch of their own.
    pub(super) fn ask_all<C: Collector, S, T: Copy + Send + Sync>(
        &self,
        places: &Places,
        progress: &Progress<'_>,
        scratch: impl Fn() -> (S, [C; WIDTH]) + Sync + Send,
        begin: impl Fn(&mut S, &mut C, usize) + Sync + Send,
        end: impl Fn(&mut S, &mut C, usize) -> T + Sync + Send,
    ) -> Result<Vec<T>> {
        let end_each = |scratch: &mut S, some: &mut [C], first: usize, results: &mut Vec<T>| {
            for (collector, at) in some.iter_mut().zip(first..) {
                results.push(end(scratch, collector, at));
            }
        };
        self.ask_groups(places, progress, scratch, begin, end_each)
    }

    /// The same, but `end` is given the collectors of a group, the number of its first place, and where what comes
    /// back of each is put.
    pub(super) fn ask_groups<C: Collector, S, T: Copy + Send + Sync>(
        &self,
        places: &Places,
        progress: &Progress<'_>,
        scratch: impl Fn() -> (S, [C; WIDTH]) + Sync + Send,
        begin: impl Fn(&mut S, &mut C, usize) + Sync + Send,
        end: impl Fn(&mut S, &mut [C], usize, &mut Vec<T>) + Sync + Send,
    ) -> Result<Vec<T>> {
        let chunks = parallel::chunks(places.len(), progress, |range| {
            let (mut scratch, mut collectors) = scratch();
            let mut results = Vec::with_capacity(range.len());
            for first in range.clone().step_by(WIDTH) {
                let some = first..range.end.min(first + WIDTH);
                let mut group = [[f64::NAN; 3]; WIDTH];
                for (place, entry) in group.iter_mut().zip(&places.entries[some.clone()]) {
                    *place = entry.point;
                }
                for (collector, at) in collectors.iter_mut().zip(some.clone()) {
                    begin(&mut scratch, collector, at);
                }
                self.ask_group(&group, &mut collectors);
                end(
                    &mut scratch,
                    &mut collectors[..some.len()],
                    first,
                    &mut results,
                );
            }
            results
        })?;
        Ok(places.in_given_order(&chunks))
    }
}

/// `f` of every one of `places`, in their order, though computed neighbourhood by neighbourhood, so
/// that what one search reads is still in the cache for the next. `f` is given a scratch of its own,
/// made by `scratch`, and the index of the place.
pub(crate) fn map_places<S, T: Copy + Send + Sync>(
    places: &[Point],
    progress: &Progress<'_>,
    scratch: impl Fn() -> S + Sync + Send,
    f: impl Fn(&mut S, usize) -> T + Sync + Send,
) -> Result<Vec<T>> {
    let places = Places::new(places);
    let chunks = parallel::chunks(places.len(), progress, |range| {
        let mut scratch = scratch();
        range
            .map(|at| f(&mut scratch, places.given(at)))
            .collect::<Vec<T>>()
    })?;
    Ok(places.in_given_order(&chunks))
}

/// Places to ask about, in an order in which eight that follow each other lie close together.
#[derive(Debug, Clone)]
pub struct Places {
    entries: Vec<Entry>,
}

/// One in so many of what stands in the order of a tree makes about `n_wanted` of all `n`. Odd, as a tree is one of
/// powers of two: even strides meet the same children of all nodes, those above their siblings, say.
fn stride_through_tree(n: usize, n_wanted: usize) -> usize {
    n.div_ceil(n_wanted.max(1)) | 1
}

/// About `n_wanted` of points in the order of a tree, from everywhere.
pub(crate) fn some_through_tree(sorted: &[Point], n_wanted: usize) -> Vec<Point> {
    let stride = stride_through_tree(sorted.len(), n_wanted);
    sorted.iter().step_by(stride).copied().collect()
}

impl Places {
    /// Sorts a copy of `points`.
    pub fn new(points: &[Point]) -> Self {
        Self {
            entries: into_blocks(points),
        }
    }

    /// `points` in the order in which they come.
    pub(crate) fn as_given(points: &[Point]) -> Self {
        Self {
            entries: parallel::map(points.len(), |i| Entry {
                point: points[i],
                index: i as u32,
            }),
        }
    }

    /// How far the places of a group lie apart, on average over some groups of `points` as they come.
    pub(super) fn mean_width_of_groups(points: &[Point]) -> f64 {
        mean_of_some(points.len() / WIDTH, |group| {
            let group = &points[group * WIDTH..(group + 1) * WIDTH];
            let to_first = group.iter().map(|p| distance_sq(p, &group[0]));
            to_first.fold(0.0, f64::max).sqrt()
        })
    }

    /// The points of a tree, which are sorted already.
    pub(super) fn of(tree: &Blocks) -> Self {
        Self {
            entries: parallel::map(tree.len(), |at| tree.entry(at)),
        }
    }

    /// About `n_wanted` points in groups of eight that lie side by side in a tree, numbered anew.
    pub(super) fn of_some_groups(tree: &Blocks, n_wanted: usize) -> Self {
        let groups = (0..tree.len()).step_by(stride_through_tree(tree.len(), n_wanted) * WIDTH);
        let taken = groups.flat_map(|first| first..tree.len().min(first + WIDTH));
        let renumbered = taken.zip(0..).map(|(at, index)| Entry {
            index,
            ..tree.entry(at)
        });
        Self {
            entries: renumbered.collect(),
        }
    }

    /// The same places, moved.
    pub fn moved(mut self, to: impl Fn(&Point) -> Point + Sync + Send) -> Self {
        parallel::for_each_chunk(&mut self.entries, parallel::CHUNK, |_, entries| {
            entries
                .iter_mut()
                .for_each(|entry| entry.point = to(&entry.point));
        });
        self
    }

    /// Number of places.
    pub fn len(&self) -> usize {
        self.entries.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.entries.is_empty()
    }

    /// Place number `at` of the order here.
    #[inline]
    pub(crate) fn point(&self, at: usize) -> &Point {
        &self.entries[at].point
    }

    /// Where place number `at` was given.
    #[inline]
    pub(crate) fn given(&self, at: usize) -> usize {
        self.entries[at].index as usize
    }

    /// Results, in chunks, in the order in which the places were given.
    fn in_given_order<T: Copy + Send + Sync>(&self, chunks: &[Vec<T>]) -> Vec<T> {
        let rank = parallel::map(self.len(), |_| AtomicU32::new(0));
        parallel::for_each(self.len(), |at| {
            rank[self.given(at)].store(at as u32, Ordering::Relaxed);
        });
        parallel::map(rank.len(), |given| {
            let at = rank[given].load(Ordering::Relaxed) as usize;
            chunks[at / parallel::CHUNK][at % parallel::CHUNK]
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::collect::Nearest;
    use super::*;
    use crate::random::Stream;

    #[test]
    fn results_come_back_in_the_order_of_the_places() {
        let mut stream = Stream::new(1, "group", 0);
        let mut points: Vec<Point> = (0..9001).map(|_| [0; 3].map(|_| stream.normal())).collect();
        let tree = Blocks::new(&into_blocks(&points));
        points[17] = [f64::NAN; 3];
        let found = tree
            .ask_all(
                &Places::new(&points),
                &Progress::silent(),
                || ((), [Nearest::within(f64::INFINITY); WIDTH]),
                |(), nearest, _| *nearest = Nearest::within(f64::INFINITY),
                |(), nearest, _| nearest.found(),
            )
            .unwrap();
        for (i, found) in found.into_iter().enumerate() {
            assert_eq!(found.map(|n| n.index as usize), (i != 17).then_some(i));
        }
    }

    #[test]
    fn places_of_a_tree_and_places_sorted_are_the_same() {
        let points = [[3.0, 1.0, 0.0], [1.0, 1.0, 0.0], [2.0, 0.0, 5.0]];
        let tree = Blocks::new(&into_blocks(&points));
        let up = |p: &Point| [p[0], p[1], p[2] + 1.0];
        let (sorted, own) = (Places::new(&points).moved(up), Places::of(&tree).moved(up));
        for at in 0..points.len() {
            assert_eq!(
                (sorted.point(at), sorted.given(at)),
                (own.point(at), own.given(at))
            );
            assert_eq!(*sorted.point(at), up(&points[sorted.given(at)]));
        }
    }
}
