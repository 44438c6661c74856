//! Where two clouds show the same surface: the points of one that repeat the other.
//!
//! Why: a merged cloud should not show one surface twice as densely as either survey did.
//! Reads: neighbours, and the index of either cloud.  Leaves: flags.
//! Source: this project.  Deviates: nowhere.
//! Absent on purpose: the hole radius, which is the caller's.

use crate::error::Result;
use crate::neighbors::{Neighbor, NeighborIndex};
use crate::parallel;
use crate::progress::Progress;

/// Which points of a cloud repeat what another shows: those whose `nearest` point in the other lies
/// nearer than the nearest other point of their own cloud, and than the nearest other point of that
/// partner in its cloud. Where the one cloud is dense and the other sparse, little is a repetition.
///
/// `nearest` belongs to the points of `own` in their order; its distances are `scale` times as long
/// as those in `own`, because the clouds may be in different frames.
///
/// ```
/// use tmchho::{neighbors::NeighborIndex, overlap::repeated, progress::Progress};
/// let row = |x: f64| [x, 0.0, 0.0];
/// let own = NeighborIndex::new(&[0.0, 1.0, 2.0].map(row));
/// let other = NeighborIndex::new(&[0.25, 9.0].map(row));
/// let nearest = other.nearest_all_within(&own.places(), 4.0, &Progress::silent())?;
/// // Two lie nearer to 0.25 than to their own neighbours, and than 0.25 to its own.
/// let flags = repeated(&nearest, &own, 1.0, &other, &Progress::silent())?;
/// assert_eq!(flags, [true, true, false]);
/// # Ok::<(), tmchho::Error>(())
/// ```
///
/// # Errors
/// [`crate::Error::Cancelled`].
pub fn repeated(
    nearest: &[Option<Neighbor>],
    own: &NeighborIndex,
    scale: f64,
    other: &NeighborIndex,
    progress: &Progress<'_>,
) -> Result<Vec<bool>> {
    let scale_sq = scale * scale;
    let is_nearer = |distance_sq: f64, index: &NeighborIndex, at: usize, scale_sq: f64| {
        // Of points that all coincide, any other at their place is a repetition.
        index
            .nearest_elsewhere(&index.points()[at])
            .is_none_or(|neighbor| distance_sq < scale_sq * neighbor.distance_sq)
    };
    parallel::map_cheap(nearest.len(), progress, |i| {
        nearest[i].is_some_and(|partner| {
            is_nearer(partner.distance_sq, own, i, scale_sq)
                && is_nearer(partner.distance_sq, other, partner.index as usize, 1.0)
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cloud::{Point, distance_sq};
    use crate::random::Stream;

    fn draw(n: usize, seed: u64) -> Vec<Point> {
        let mut stream = Stream::new(seed, "overlap", 0);
        (0..n).map(|_| [0; 3].map(|_| stream.normal())).collect()
    }

    /// By looking at every pair.
    fn least_sq(p: &Point, others: &[Point]) -> f64 {
        others
            .iter()
            .filter(|q| *q != p)
            .fold(f64::INFINITY, |least, q| least.min(distance_sq(p, q)))
    }

    #[test]
    fn a_repetition_is_nearer_than_both_clouds_are_dense() {
        let (own, other) = (draw(500, 3), draw(400, 4));
        let (a, b) = (NeighborIndex::new(&own), NeighborIndex::new(&other));
        let nearest = b
            .nearest_all_within(&a.places(), f64::INFINITY, &Progress::silent())
            .unwrap();
        let flags = repeated(&nearest, &a, 1.0, &b, &Progress::silent()).unwrap();
        for (i, flag) in flags.iter().enumerate() {
            let partner = nearest[i].unwrap();
            let wanted = partner.distance_sq < least_sq(&own[i], &own)
                && partner.distance_sq < least_sq(&other[partner.index as usize], &other);
            assert_eq!(*flag, wanted);
        }
        let n = flags.iter().filter(|flag| **flag).count();
        assert!((50..450).contains(&n), "{n}");
    }

    #[test]
    fn by_hand_with_a_scale() {
        // Own points 1 apart, in a unit twice that of the other, whose points are 3 apart.
        let own = NeighborIndex::new(&[0.0, 1.0, 2.0].map(|x| [x, 0.0, 0.0]));
        let other = NeighborIndex::new(&[0.0, 3.0].map(|x| [x, 0.0, 0.0]));
        let partner = |distance: f64| {
            Some(Neighbor {
                index: 0,
                distance_sq: distance * distance,
            })
        };
        let nearest = [partner(1.9), partner(2.0), None];
        let flags = |scale| repeated(&nearest, &own, scale, &other, &Progress::silent()).unwrap();
        assert_eq!(flags(2.0), [true, false, false]);
        assert_eq!(flags(4.0), [true, true, false]); // now the other's spacing decides
    }
}
