//! The partner of every source point, and which pairs count.

use super::sizes::Sizes;
use crate::cloud::{Point, distance_sq};
use crate::error::Result;
use crate::neighbors::NeighborIndex;
use crate::parallel;
use crate::progress::Progress;
use crate::similarity::Similarity;

const NOBODY: (u32, f64) = (u32::MAX, f64::INFINITY);

/// The partner of every source point at a pose. Found anew for each pose in the same memory.
pub(super) struct Pairs {
    /// (target index, squared distance); an index of `u32::MAX` stands for "nobody near".
    partners: Vec<(u32, f64)>,
    /// Squared distances, to be put in order.
    distances: Vec<f64>,
    /// Pairs with a squared distance up to this one count.
    max_sq: f64,
    pub(super) n_kept: usize,
}

impl Pairs {
    pub(super) fn of(n_source: usize) -> Self {
        Self {
            partners: vec![NOBODY; n_source],
            distances: Vec::with_capacity(n_source),
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
        let limit_sq = max_distance_m.map_or(f64::INFINITY, |m| m * m);
        parallel::for_each_chunk(&mut self.partners, parallel::CHUNK, |chunk, partners| {
            if progress.check().is_err() {
                return;
            }
            for (partner, p) in partners.iter_mut().zip(&source[chunk * parallel::CHUNK..]) {
                let moved = pose.apply(p);
                // The partner of the pose before is near this one too: nobody farther is asked.
                let known_sq = target
                    .points()
                    .get(partner.0 as usize)
                    .map_or(f64::INFINITY, |known| distance_sq(known, &moved));
                let bound_sq = limit_sq.min(known_sq);
                let found = if bound_sq.is_finite() {
                    target.nearest_within(&moved, bound_sq)
                } else {
                    target.nearest(&moved)
                };
                *partner = found.map_or(NOBODY, |n| (n.index, n.distance_sq));
            }
        });
        progress.check()?;
        self.max_sq = match kept_share {
            Some(share) => self.limit_of_share(share),
            None => self.limit_of_overlap(),
        };
        self.n_kept = self.kept().count();
        Ok(())
    }

    fn limit_of_share(&mut self, share: f64) -> f64 {
        let found = self.partners.iter().map(|pair| pair.1);
        self.distances.clear();
        self.distances.extend(found.filter(|d| d.is_finite()));
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
        let found = || {
            self.partners
                .iter()
                .map(|pair| pair.1)
                .filter(|d| d.is_finite())
        };
        let mut sizes = Sizes::up_to(found().fold(0.0, f64::max));
        found().for_each(|distance_sq| sizes.add(distance_sq));
        sizes.limit_of_overlap(self.partners.len())
    }

    /// The largest squared distance of a pair that counts.
    pub(super) fn largest_sq(&self) -> f64 {
        self.distances_sq().fold(0.0, f64::max)
    }

    /// (source index, target index) of the pairs that count.
    pub(super) fn kept(&self) -> impl Iterator<Item = (usize, usize)> {
        self.kept_within(0..self.partners.len())
    }

    /// The same of some of the source points.
    pub(super) fn kept_within(
        &self,
        range: std::ops::Range<usize>,
    ) -> impl Iterator<Item = (usize, usize)> {
        let counted = |(i, pair): (usize, &(u32, f64))| {
            (pair.1 <= self.max_sq).then_some((i, pair.0 as usize))
        };
        range.clone().zip(&self.partners[range]).filter_map(counted)
    }

    fn distances_sq(&self) -> impl Iterator<Item = f64> {
        let all = self.partners.iter().map(|pair| pair.1);
        all.filter(|distance_sq| *distance_sq <= self.max_sq)
    }

    /// Root mean squared distance of the pairs that count.
    pub(super) fn rmse(&self) -> f64 {
        (self.distances_sq().sum::<f64>() / self.n_kept as f64).sqrt()
    }
}
