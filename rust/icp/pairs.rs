//! The partner of every source point, and which pairs count.

use std::ops::Range;

use super::sizes::Sizes;
use crate::cloud::Point;
use crate::error::Result;
use crate::neighbors::{Follower, NeighborIndex};
use crate::progress::Progress;
use crate::similarity::Similarity;

/// The partner of every source point at a pose. Found anew for each pose in the same memory.
pub(super) struct Pairs {
    followers: Vec<Follower>,
    /// Squared distances, to be put in order.
    distances: Vec<f64>,
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
            distances: Vec::with_capacity(n_source),
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
        self.max_sq = match kept_share {
            Some(share) => self.limit_of_share(share),
            None => self.limit_of_overlap(),
        };
        self.n_kept = self.kept().count();
        Ok(())
    }

    /// Squared distances of all pairs.
    fn all_sq(&self) -> impl Iterator<Item = f64> {
        let found = self.followers.iter().filter_map(Follower::found);
        found.map(|(_, sq)| sq).filter(|sq| *sq <= self.limit_sq)
    }

    fn limit_of_share(&mut self, share: f64) -> f64 {
        let mut distances = std::mem::take(&mut self.distances);
        distances.clear();
        distances.extend(self.all_sq());
        self.distances = distances;
        let n_kept = (self.distances.len() as f64 * share).ceil() as usize;
        match n_kept {
            0 => f64::NEG_INFINITY,
            n if n == self.distances.len() => f64::MAX,
            n => {
                *self
                    .distances
                    .select_nth_unstable_by(n - 1, f64::total_cmp)
                    .1
            }
        }
    }

    fn limit_of_overlap(&self) -> f64 {
        let mut sizes = Sizes::up_to(self.all_sq().fold(0.0, f64::max));
        self.all_sq().for_each(|distance_sq| sizes.add(distance_sq));
        sizes.limit_of_overlap(self.followers.len())
    }

    /// The largest squared distance of a pair that counts.
    pub(super) fn largest_sq(&self) -> f64 {
        self.distances_sq().fold(0.0, f64::max)
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
        let max_sq = self.max_sq.min(self.limit_sq);
        let counts =
            move |follower: &Follower| follower.found().is_some_and(|(_, sq)| sq <= max_sq);
        let followers = range.clone().zip(&self.followers[range]);
        followers.filter(move |(_, follower)| counts(follower))
    }

    fn distances_sq(&self) -> impl Iterator<Item = f64> {
        self.all_sq()
            .filter(|distance_sq| *distance_sq <= self.max_sq)
    }

    /// Root mean squared distance of the pairs that count.
    pub(super) fn rmse(&self) -> f64 {
        (self.distances_sq().sum::<f64>() / self.n_kept as f64).sqrt()
    }
}
