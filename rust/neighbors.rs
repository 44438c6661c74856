//! Nearest neighbours: which points of a cloud lie near a place, exactly.
//!
//! Why: every stage asks this question, of every kind of cloud that surveys bring. Two engines
//! share the work: kiddo finds the point nearest to a single place in a cloud that fills space; our own
//! tree answers wherever kiddo was measured 2 to 70 times slower (many places at once, flat floors
//! and walls, piles of duplicates, places far outside, counting up to a limit, bounded searches).
//! Reads: points.  Leaves: indices into them, with squared distances.
//! Source: `neighbors/general.rs`, `neighbors/blocks.rs`.  Deviates: nowhere; both are exact.
//! Memory: 36 bytes a point, 24 more once the points themselves are asked for, and 32 a place while
//! many are asked about.
//! Absent on purpose: adding or removing points, other metrics, approximate answers.

mod blocks;
mod collect;
mod follow;
mod general;
mod group;
mod sort;

use std::sync::OnceLock;

pub(crate) use blocks::{Block, WIDTH, sum_of_squares};
use blocks::{Blocks, greater};
pub(crate) use collect::{Collector, reach_of};
use collect::{Count, KNearest, Nearest, NearestElsewhere, Within};
pub(crate) use follow::Follower;
use general::General;
pub use group::Places;
pub(crate) use group::{map_places, some_through_tree};

use crate::cloud::{Point, distance_sq};
use crate::error::{Error, Result};
use crate::parallel;
use crate::progress::Progress;

/// A point that was found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Neighbor {
    /// Index into the points of the [`NeighborIndex`].
    pub index: u32,
    /// Squared distance from the place asked about.
    pub distance_sq: f64,
}

/// Finds the points near a place. Answers `None` or nothing where it holds no points or the place
/// is not finite.
///
/// Many places are asked about together: in groups of eight neighbours that is two to four times as
/// quick as one by one.
///
/// ```
/// use tmchho::neighbors::NeighborIndex;
/// let index = NeighborIndex::new(&[[0.0, 0.0, 0.0], [3.0, 4.0, 0.0], [3.0, 4.0, 0.0]]);
/// let found = index.nearest(&[3.0, 3.0, 0.0]).unwrap();
/// assert_eq!((found.index, found.distance_sq), (1, 1.0));
/// assert_eq!(index.count_within(&[0.0, 0.0, 0.0], 5.0, usize::MAX), 3);
/// ```
#[derive(Debug)]
pub struct NeighborIndex {
    tree: Blocks,
    /// The points in the order given, for those who ask for them.
    points: OnceLock<Vec<Point>>,
    /// kiddo, where it serves this cloud well; built for the first search that it answers.
    general: OnceLock<Option<General>>,
}

impl NeighborIndex {
    /// Sorts a copy of `points`, which must be finite and at most 2³² − 1 in number.
    pub fn new(points: &[Point]) -> Self {
        Self {
            tree: Blocks::new(&sort::into_blocks(points)),
            points: OnceLock::new(),
            general: OnceLock::new(),
        }
    }

    /// The same, with the points numbered anew: in the order of the tree, in which those that follow each other lie
    /// side by side. And the numbers that they had.
    pub fn renumbered(points: &[Point]) -> (Self, Vec<u32>) {
        let mut entries = sort::into_blocks(points);
        let numbers = entries.iter().map(|entry| entry.index).collect();
        for (entry, index) in entries.iter_mut().zip(0..) {
            entry.index = index;
        }
        let index = Self {
            tree: Blocks::new(&entries),
            points: parallel::map(entries.len(), |i| entries[i].point).into(),
            general: OnceLock::new(),
        };
        (index, numbers)
    }

    /// The points, in the order given.
    pub fn points(&self) -> &[Point] {
        self.points.get_or_init(|| self.tree.points())
    }

    /// The points as places to ask about, here or in another index: they need no sorting any more.
    pub fn places(&self) -> Places {
        Places::of(&self.tree)
    }

    /// About `n_wanted` of [`NeighborIndex::places`], in groups of eight from everywhere, numbered anew.
    pub(crate) fn some_places(&self, n_wanted: usize) -> Places {
        Places::of_some_groups(&self.tree, n_wanted)
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        self.tree.len()
    }

    /// Whether there are no points.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The point nearest to `place`; of several at the same distance one, always the same.
    pub fn nearest(&self, place: &Point) -> Option<Neighbor> {
        self.general
            .get_or_init(|| General::new(self.points(), self.tree.has_piles()))
            .as_ref()
            .and_then(|general| general.nearest(self.points(), place))
            .or_else(|| self.nearest_within(place, f64::INFINITY))
    }

    /// The point nearest to `place`, unless its squared distance exceeds `max_distance_sq`; of
    /// several the one with the lowest index.
    pub fn nearest_within(&self, place: &Point, max_distance_sq: f64) -> Option<Neighbor> {
        let mut nearest = Nearest::within(max_distance_sq);
        self.tree.ask(place, &mut nearest);
        nearest.found().map(Neighbor::from)
    }

    /// The same of a few places close together.
    pub fn nearest_of_some_within(
        &self,
        places: &[Point; WIDTH],
        max_distance_sq: f64,
    ) -> [Option<Neighbor>; WIDTH] {
        let mut nearest = [Nearest::within(max_distance_sq); WIDTH];
        self.tree.ask_group(places, &mut nearest);
        nearest.map(|nearest| nearest.found().map(Neighbor::from))
    }

    /// The nearest point that does not coincide with `place`.
    pub fn nearest_elsewhere(&self, place: &Point) -> Option<Neighbor> {
        let mut nearest = NearestElsewhere(Nearest::within(f64::INFINITY));
        self.tree.ask(place, &mut nearest);
        nearest.0.found().map(Neighbor::from)
    }

    /// How far the nearest point that does not coincide with it lies from each of about `n_wanted` points, in groups
    /// of eight that lie side by side. Of points that all coincide nothing.
    ///
    /// # Errors
    /// [`Error::Cancelled`].
    pub fn spacings_m(&self, n_wanted: usize, progress: &Progress<'_>) -> Result<Vec<f64>> {
        let places = self.some_places(n_wanted);
        let fresh = || NearestElsewhere(Nearest::within(f64::INFINITY));
        let spacings = self.map_collected(&places, fresh, progress, |nearest| {
            nearest.0.found().map(|held| held.distance_sq.sqrt())
        })?;
        Ok(spacings.into_iter().flatten().collect())
    }

    /// Replaces `out` with the `k` points nearest to `place` (all of them if there are fewer),
    /// by rising distance, then index. A point at `place` itself is one of them.
    pub fn k_nearest(&self, place: &Point, k: usize, out: &mut Vec<Neighbor>) {
        let mut nearest = KNearest::default();
        nearest.restart(k, f64::MAX);
        self.tree.ask(place, &mut nearest);
        out.clear();
        out.extend(
            nearest
                .finish_in_order()
                .iter()
                .copied()
                .map(Neighbor::from),
        );
    }

    /// Replaces `out` with the points at most `radius_m` from `place`, by rising index.
    pub fn within(&self, place: &Point, radius_m: f64, out: &mut Vec<Neighbor>) {
        let mut within = Within::default();
        within.restart(radius_m);
        self.tree.ask(place, &mut within);
        out.clear();
        out.extend(within.found.into_iter().map(Neighbor::from));
        out.sort_unstable_by_key(|neighbor| neighbor.index);
    }

    /// Number of points at most `radius_m` from `place`; stops counting at `at_most`.
    pub fn count_within(&self, place: &Point, radius_m: f64, at_most: usize) -> usize {
        let mut count = Count::within(radius_m, at_most);
        self.tree.ask(place, &mut count);
        at_most - count.n_left()
    }

    /// [`NeighborIndex::nearest`] of every one of `places`, in their order; of several points at the
    /// same distance the one with the lowest index.
    ///
    /// # Errors
    /// [`Error::TooFewPoints`] where there are places but no points, [`Error::InvalidArgument`]
    /// where a place is not finite, [`Error::Cancelled`].
    pub fn nearest_all(&self, places: &[Point], progress: &Progress<'_>) -> Result<Vec<Neighbor>> {
        self.nearest_to(&self.places_to_ask(places), progress)
    }

    /// Places to ask about here: as they come where eight in a row are close together anyway, like
    /// the points of a scan line; otherwise sorted.
    pub fn places_to_ask(&self, places: &[Point]) -> Places {
        /// Groups so many times as wide as blocks of points still spare the sorting.
        const WIDER: f64 = 4.0;
        if Places::mean_width_of_groups(places) <= WIDER * self.tree.mean_width_of_blocks() {
            Places::as_given(places)
        } else {
            Places::new(places)
        }
    }

    /// [`NeighborIndex::nearest_all`] for places that are sorted already, in the order in which they
    /// were given.
    ///
    /// # Errors
    /// As [`NeighborIndex::nearest_all`].
    pub fn nearest_to(&self, places: &Places, progress: &Progress<'_>) -> Result<Vec<Neighbor>> {
        self.check_places(places)?;
        let found = self.nearest_all_within(places, f64::INFINITY, progress)?;
        Ok(found.into_iter().flatten().collect())
    }

    /// The distance to the nearest point from every one of `places`, in the order in which they were
    /// given.
    ///
    /// # Errors
    /// As [`NeighborIndex::nearest_all`].
    pub fn distances_to(&self, places: &Places, progress: &Progress<'_>) -> Result<Vec<f64>> {
        self.check_places(places)?;
        let nobody = f64::INFINITY;
        self.map_nearest(places, f64::INFINITY, progress, |found| {
            found.map_or(nobody, |neighbor| neighbor.distance_sq.sqrt())
        })
    }

    fn check_places(&self, places: &Places) -> Result<()> {
        if self.is_empty() && !places.is_empty() {
            return Err(Error::TooFewPoints {
                what: "cloud that distances are measured to".into(),
                found: 0,
                needed: 1,
            });
        }
        let is_finite = |at| places.point(at).iter().all(|v| v.is_finite());
        if !parallel::all(places.len(), is_finite) {
            return Err(Error::argument(
                "places",
                "hold a coordinate that is not finite",
            ));
        }
        Ok(())
    }

    /// [`NeighborIndex::nearest_within`] of every one of `places`, in the order in which they were
    /// given.
    ///
    /// # Errors
    /// [`Error::Cancelled`].
    pub fn nearest_all_within(
        &self,
        places: &Places,
        max_distance_sq: f64,
        progress: &Progress<'_>,
    ) -> Result<Vec<Option<Neighbor>>> {
        self.map_nearest(places, max_distance_sq, progress, |found| found)
    }

    fn map_nearest<T: Copy + Send + Sync>(
        &self,
        places: &Places,
        max_distance_sq: f64,
        progress: &Progress<'_>,
        answer: impl Fn(Option<Neighbor>) -> T + Sync + Send,
    ) -> Result<Vec<T>> {
        // What was found for the places before bounds the search for these: exact, and far from the
        // cloud many times as fast.
        let begin = |last: &mut Option<Point>, nearest: &mut Nearest, at: usize| {
            let to_last = |last| distance_sq(places.point(at), last);
            let known_sq = last.as_ref().map_or(f64::INFINITY, to_last);
            *nearest = Nearest::within(max_distance_sq.min(known_sq));
        };
        let end = |last: &mut Option<Point>, nearest: &mut Nearest, _| {
            let found = nearest.found();
            *last = found.map(|held| self.tree.point(held.slot));
            answer(found.map(Neighbor::from))
        };
        let scratch = || (None, [Nearest::within(max_distance_sq); WIDTH]);
        self.tree.ask_all(places, progress, scratch, begin, end)
    }

    /// [`NeighborIndex::count_within`] of every one of the points, in the order given.
    ///
    /// # Errors
    /// [`Error::Cancelled`].
    pub fn count_around_all(
        &self,
        radius_m: f64,
        at_most: usize,
        progress: &Progress<'_>,
    ) -> Result<Vec<usize>> {
        let (count, places) = (Count::within(radius_m, at_most), self.places());
        // The points of its own block are mostly enough: then nothing is sought any more.
        let begin = |(): &mut (), counted: &mut Count, at: usize| {
            *counted = count;
            if !counted.take(places.point(at), self.tree.block(at / WIDTH), at / WIDTH) {
                *counted = count;
            }
        };
        let scratch = || ((), [count; WIDTH]);
        let end = |(): &mut (), counted: &mut Count, _| at_most - counted.n_left();
        self.tree.ask_all(&places, progress, scratch, begin, end)
    }

    /// What `answer` makes of each of `places` and the `k` points nearest to it (in no particular order,
    /// though always the same); in the order in which the places were given.
    pub(crate) fn map_k_nearest<T: Copy + Send + Sync>(
        &self,
        places: &Places,
        k: usize,
        progress: &Progress<'_>,
        answer: impl Fn(&Point, &[Point]) -> T + Sync + Send,
    ) -> Result<Vec<T>> {
        self.map_groups_of_k_nearest(places, k, progress, |first, near, answers| {
            let numbered = (first..).zip(near);
            answers.extend(numbered.map(|(at, near)| answer(places.point(at), near)));
        })
    }

    /// The same of up to eight places at a time: `answer` is given the number of the first of them in `places`, the
    /// points nearest to each, and where to put the answers.
    pub(crate) fn map_groups_of_k_nearest<T: Copy + Send + Sync>(
        &self,
        places: &Places,
        k: usize,
        progress: &Progress<'_>,
        answer: impl Fn(usize, &[Vec<Point>], &mut Vec<T>) + Sync + Send,
    ) -> Result<Vec<T>> {
        /// How much farther, squared, the k-th point may be than those of the places before.
        const MARGIN: f64 = 1.3;
        struct Scratch {
            near: [Vec<Point>; WIDTH],
            /// Squared distance within which the k nearest are guessed to lie.
            guess_sq: f64,
            /// The farthest k-th point of this group.
            farthest_sq: f64,
        }
        let scratch = || {
            let scratch = Scratch {
                near: Default::default(),
                guess_sq: f64::MAX,
                farthest_sq: 0.0,
            };
            (scratch, std::array::from_fn(|_| KNearest::default()))
        };
        let begin = |scratch: &mut Scratch, nearest: &mut KNearest, at: usize| {
            if at.is_multiple_of(WIDTH) && scratch.farthest_sq > 0.0 {
                scratch.guess_sq = MARGIN * scratch.farthest_sq;
                scratch.farthest_sq = 0.0;
            }
            nearest.restart(k, scratch.guess_sq);
        };
        let end = |scratch: &mut Scratch, some: &mut [KNearest], first, answers: &mut Vec<T>| {
            for (lane, nearest) in some.iter_mut().enumerate() {
                let place = places.point(first + lane);
                if !nearest.is_complete() {
                    nearest.restart(k, f64::MAX);
                    self.tree.ask(place, nearest);
                }
                nearest.finish();
                scratch.farthest_sq = greater(nearest.reach_sq(), scratch.farthest_sq);
                // In the tree they lie side by side.
                scratch.near[lane].clear();
                let found = nearest.found.iter();
                scratch.near[lane].extend(found.map(|held| self.tree.point(held.slot)));
            }
            answer(first, &scratch.near[..some.len()], answers);
        };
        self.tree.ask_groups(places, progress, scratch, begin, end)
    }

    /// What `answer` makes of the indices of the points at most `radius_m` from each of `places`, told also which
    /// place it is; the indices in no particular order, though always the same, the results in the order in which
    /// the places were given.
    pub(crate) fn map_indices_within<T: Copy + Send + Sync>(
        &self,
        places: &Places,
        radius_m: f64,
        progress: &Progress<'_>,
        answer: impl Fn(usize, &[u32]) -> T + Sync + Send,
    ) -> Result<Vec<T>> {
        self.tree.ask_all(
            places,
            progress,
            || (Vec::new(), std::array::from_fn(|_| Within::default())),
            |_, within, _| within.restart(radius_m),
            |indices, within, at| {
                indices.clear();
                indices.extend(within.found.iter().map(|held| held.index));
                answer(places.given(at), indices)
            },
        )
    }

    /// What `answer` makes of a collector of the caller's that saw the blocks near each of `places`.
    pub(crate) fn map_collected<C: Collector + Clone, T: Copy + Send + Sync>(
        &self,
        places: &Places,
        fresh: impl Fn() -> C + Sync + Send,
        progress: &Progress<'_>,
        answer: impl Fn(&C) -> T + Sync + Send,
    ) -> Result<Vec<T>> {
        self.tree.ask_all(
            places,
            progress,
            || ((), std::array::from_fn(|_| fresh())),
            |(), collector, _| *collector = fresh(),
            |(), collector, _| answer(collector),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Stream;
    use proptest::prelude::*;

    /// Every point by rising distance, then index: the twin of all searches.
    fn by_distance(points: &[Point], place: &Point) -> Vec<Neighbor> {
        let mut all: Vec<Neighbor> = (0_u32..)
            .zip(points)
            .map(|(index, p)| Neighbor {
                index,
                distance_sq: distance_sq(place, p),
            })
            .collect();
        all.sort_by(|a, b| {
            a.distance_sq
                .total_cmp(&b.distance_sq)
                .then(a.index.cmp(&b.index))
        });
        all
    }

    fn agrees_with_brute_force(points: &[Point], places: &[Point]) {
        let index = NeighborIndex::new(points);
        let mut found = Vec::new();
        for place in places {
            let all = by_distance(points, place);
            let nearest = index.nearest(place);
            assert_eq!(
                nearest.map(|n| n.distance_sq),
                all.first().map(|n| n.distance_sq)
            );
            assert!(nearest.is_none_or(|n| all.contains(&n)));
            assert_eq!(
                index.nearest_within(place, f64::INFINITY),
                all.first().copied()
            );
            for k in [0, 1, 2, 7, 40, points.len() + 1] {
                index.k_nearest(place, k, &mut found);
                assert_eq!(found, all[..k.min(all.len())]);
            }
            // A radius through the 20th point: one on the rim counts.
            let radius_m = all.get(19).map_or(1.0, |n| n.distance_sq.sqrt());
            let radius_sq = radius_m * radius_m;
            let mut inside = all.clone();
            inside.retain(|n| n.distance_sq <= radius_sq);
            for at_most in [0, 1, 5, usize::MAX] {
                let wanted = inside.len().min(at_most);
                assert_eq!(index.count_within(place, radius_m, at_most), wanted);
            }
            assert_eq!(
                index.nearest_within(place, radius_sq),
                inside.first().copied()
            );
            let elsewhere = all.iter().find(|n| n.distance_sq > 0.0);
            assert_eq!(index.nearest_elsewhere(place).as_ref(), elsewhere);
            inside.sort_by_key(|n| n.index);
            index.within(place, radius_m, &mut found);
            assert_eq!(found, inside);
        }
    }

    fn places_round(points: &[Point], stream: &mut Stream) -> Vec<Point> {
        let mut places: Vec<Point> = points.iter().step_by(97).copied().collect();
        for far in [1.0, 1e3, 1e9] {
            places.extend((0..5).map(|_| [0; 3].map(|_| far * stream.normal())));
        }
        places
    }

    #[test]
    fn every_search_agrees_with_brute_force_on_clouds_of_every_shape() {
        let mut stream = Stream::new(1, "neighbors", 0);
        let uniform: Vec<Point> = (0..1500)
            .map(|_| [0; 3].map(|_| stream.uniform()))
            .collect();
        let flat: Vec<Point> = uniform.iter().map(|p| [p[0], 7.0, p[2]]).collect();
        let line: Vec<Point> = uniform.iter().map(|p| [p[0], -p[0], 2.0 * p[0]]).collect();
        let grid: Vec<Point> = (0..1331)
            .map(|i| [i % 11, i / 11 % 11, i / 121].map(f64::from))
            .collect();
        let mut piles = uniform.clone();
        for i in 0..piles.len() {
            if i % 2 == 0 {
                piles[i] = piles[i % 6];
            }
        }
        let shapes = [
            uniform,
            flat,
            line,
            grid,
            piles,
            vec![[4.0, 5.0, 6.0]; 600],
            vec![[1.0, 2.0, 3.0]],
            vec![],
        ];
        for points in &shapes {
            let places = places_round(points, &mut stream);
            agrees_with_brute_force(points, &places);
        }
    }

    #[test]
    fn by_hand() {
        let index = NeighborIndex::new(&[[1.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 3.0]]);
        let mut found = Vec::new();
        index.k_nearest(&[0.0; 3], 2, &mut found);
        let pairs: Vec<(u32, f64)> = found.iter().map(|n| (n.index, n.distance_sq)).collect();
        assert_eq!(pairs, [(0, 1.0), (1, 4.0)]);
        assert_eq!(index.nearest_within(&[0.0; 3], 0.99), None);
        assert_eq!(index.count_within(&[0.0; 3], -9.0, 5), 0);
    }

    #[test]
    fn a_million_copies_of_one_point_are_one_pile() {
        let index = NeighborIndex::new(&vec![[1.0, 2.0, 3.0]; 1_000_000]);
        let places = vec![[1.5, 2.0, 3.0]; 10_000];
        let found = index.nearest_all(&places, &Progress::silent()).unwrap();
        assert!(found.iter().all(|n| (n.index, n.distance_sq) == (0, 0.25)));
    }

    #[test]
    fn places_that_cannot_be_answered_are_refused() {
        let (some, none) = (NeighborIndex::new(&[[0.0; 3]]), NeighborIndex::new(&[]));
        let nowhere = [[f64::NAN, 0.0, 0.0]];
        assert_eq!(some.nearest(&nowhere[0]), None);
        let silent = Progress::silent();
        assert!(matches!(
            some.nearest_all(&nowhere, &silent),
            Err(Error::InvalidArgument { .. })
        ));
        assert!(matches!(
            none.nearest_all(&[[0.0; 3]], &silent),
            Err(Error::TooFewPoints { .. })
        ));
        assert_eq!(none.nearest_all(&[], &silent), Ok(vec![]));
    }

    #[test]
    fn a_tree_built_in_parallel_answers_like_one_built_serially() {
        let mut stream = Stream::new(2, "neighbors", 0);
        let points: Vec<Point> = (0..40_000)
            .map(|_| [0; 3].map(|_| (50.0 * stream.uniform()).round()))
            .collect();
        let build = |n_threads| {
            parallel::with_threads(Some(n_threads), || Ok(NeighborIndex::new(&points))).unwrap()
        };
        let (one, four) = (build(1), build(4));
        let (mut a, mut b) = (Vec::new(), Vec::new());
        for place in points.iter().step_by(500) {
            one.k_nearest(place, 30, &mut a);
            four.k_nearest(place, 30, &mut b);
            assert_eq!(a, b);
        }
    }

    proptest! {
        #[test]
        fn coarse_coordinates_full_of_ties_agree_with_brute_force(
            cells in prop::collection::vec([0_i8..4, 0_i8..4, 0_i8..2], 0..120),
            place in [-9_i8..9, -9_i8..9, -9_i8..9],
        ) {
            let points: Vec<Point> = cells.iter().map(|c| c.map(f64::from)).collect();
            agrees_with_brute_force(&points, &[place.map(|v| f64::from(v) / 2.0)]);
        }
    }
}
