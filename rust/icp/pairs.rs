//! The partner of every source point, and which pairs count.

use std::ops::Range;

use super::sizes::Sizes;
use crate::cloud::Point;
use crate::error::Result;
use crate::neighbors::{Follower, NeighborIndex};
use crate::parallel;
use crate::progress::Progress;
use crate::similarity::Similarity;

/// The partner of every source point at a pose. Found anew for each pose in the same memory.
pub(super) struct Pairs {
    followers: Vec<Follower>,
    /// Squared distance of every follower from its partner; infinite where it has none. Beside the followers, as all
    /// of it is read several times for each pose.
    distances_sq: Vec<f64>,
    /// Those of partners, to be put in order.
    in_order: Vec<f64>,
    /// Squared distance beyond which there are no partners.
    limit_sq: f64,
    /// Pairs with a squared distance up to this one count.
    max_sq: f64,
    pub(super) n_kept: usize,
}

impl Pairs {
    pub(super) fn of(n_source: usize) -> Self {
        Self {
            followers: vec![Follower::NEW; n_source],
            distances_sq: vec![f64::INFINITY; n_source],
            in_order: Vec::new(),
            limit_sq: f64::INFINITY,
            max_sq: f64::NEG_INFINITY,
            n_kept: 0,
        }
    }

    /// Finds the partners at `pose` and keeps `kept_share` of the pairs, closest first; `None`
    /// estimates the share from their distances.
    pub(super) fn find(
        &mut self,
        source: &[Point],
        target: &NeighborIndex,
        pose: &Similarity,
        max_distance_m: Option<f64>,
        kept_share: Option<f64>,
        progress: &Progress<'_>,
    ) -> Result<()> {
        let reach_m = max_distance_m.unwrap_or(f64::INFINITY);
        self.limit_sq = reach_m * reach_m;
        let moved = |i: usize| pose.apply(&source[i]);
        target.follow(&mut self.followers, moved, reach_m, progress)?;
        let (followers, limit_sq) = (&self.followers, self.limit_sq);
        parallel::for_each_chunk(
            &mut self.distances_sq,
            parallel::CHUNK,
            |chunk, distances_sq| {
                let followers = &followers[chunk * parallel::CHUNK..];
                for (distance_sq, follower) in distances_sq.iter_mut().zip(followers) {
                    let found = follower.found().map(|(_, sq)| sq);
                    *distance_sq = found.filter(|sq| *sq <= limit_sq).unwrap_or(f64::INFINITY);
                }
            },
        );
        self.max_sq = match kept_share {
            Some(share) => self.limit_of_share(share),
            None => self.limit_of_overlap(),
        };
        self.n_kept = self.kept_sq().count();
        Ok(())
    }

    /// Squared distances of all pairs.
    fn all_sq(&self) -> impl Iterator<Item = f64> {
        let distances_sq = self.distances_sq.iter().copied();
        distances_sq.filter(|sq| sq.is_finite())
    }

    fn limit_of_share(&mut self, share: f64) -> f64 {
        let mut in_order = std::mem::take(&mut self.in_order);
        in_order.clear();
        in_order.extend(self.all_sq());
        let n_kept = (in_order.len() as f64 * share).ceil() as usize;
        let limit = match n_kept {
            0 => f64::NEG_INFINITY,
            n if n == in_order.len() => f64::MAX,
            n => *in_order.select_nth_unstable_by(n - 1, f64::total_cmp).1,
        };
        self.in_order = in_order;
        limit
    }

    fn limit_of_overlap(&self) -> f64 {
        let mut sizes = Sizes::up_to(self.all_sq().fold(0.0, f64::max));
        self.all_sq().for_each(|distance_sq| sizes.add(distance_sq));
        sizes.limit_of_overlap(self.followers.len())
    }

    /// The largest squared distance of a pair that counts.
    pub(super) fn largest_sq(&self) -> f64 {
        self.kept_sq().fold(0.0, f64::max)
    }

    /// (source index, target index) of the pairs that count.
    pub(super) fn kept(&self) -> impl Iterator<Item = (usize, usize)> {
        self.kept_within(0..self.followers.len())
    }

    /// The same of some of the source points.
    pub(super) fn kept_within(&self, range: Range<usize>) -> impl Iterator<Item = (usize, usize)> {
        let followers = self.followers_within(range);
        followers.filter_map(|(i, follower)| Some((i, follower.found()?.0 as usize)))
    }

    /// (source index, where its partner stands) of some of the pairs that count.
    pub(super) fn places_within(
        &self,
        range: Range<usize>,
    ) -> impl Iterator<Item = (usize, &Point)> {
        self.followers_within(range)
            .map(|(i, follower)| (i, follower.nearest()))
    }

    fn followers_within(&self, range: Range<usize>) -> impl Iterator<Item = (usize, &Follower)> {
        let max_sq = self.max_sq;
        let distances_sq = range.clone().zip(&self.distances_sq[range]);
        let kept = distances_sq.filter(move |(_, sq)| sq.is_finite() && **sq <= max_sq);
        kept.map(|(i, _)| (i, &self.followers[i]))
    }

    /// Squared distances of the pairs that count.
    fn kept_sq(&self) -> impl Iterator<Item = f64> {
        self.all_sq().filter(|sq| *sq <= self.max_sq)
    }

    /// Root mean squared distance of the pairs that count.
    pub(super) fn rmse(&self) -> f64 {
        (self.kept_sq().sum::<f64>() / self.n_kept as f64).sqrt()
    }
}
