//! Where two clouds show the same place: bounded distances, and points that repeat others.
//!
//! Why: clouds larger than memory are compared tile by tile, where a partner beyond the tile's
//! margin is as good as none; and a merged cloud should not show one surface twice as densely as
//! either survey did.
//! Reads: points and a neighbour index in one frame.  Leaves: neighbours; flags.
//! Source: this project.  Deviates: nowhere.
//! Absent on purpose: the hole radius, which is the caller's.

use crate::cloud::{Point, distance_sq};
use crate::error::Result;
use crate::neighbors::{Neighbor, NeighborIndex, map_places};
use crate::parallel;
use crate::progress::Progress;

/// The nearest point of `to` for each of `places`, `None` where none lies within `max_distance_m`.
///
/// ```
/// use tmchho::{neighbors::NeighborIndex, overlap::nearest_within, progress::Progress};
/// let to = NeighborIndex::new(&[[0.0; 3], [10.0, 0.0, 0.0]]);
/// let places = [[9.0, 0.0, 0.0], [5.0, 0.0, 0.0]];
/// let found = nearest_within(&places, &to, 2.0, &Progress::silent())?;
/// assert_eq!(found[0].map(|n| (n.index, n.distance_sq)), Some((1, 1.0)));
/// assert_eq!(found[1], None);
/// # Ok::<(), tmchho::Error>(())
/// ```
///
/// # Errors
/// [`crate::Error::Cancelled`].
pub fn nearest_within(
    places: &[Point],
    to: &NeighborIndex,
    max_distance_m: f64,
    progress: &Progress<'_>,
) -> Result<Vec<Option<Neighbor>>> {
    let max_sq = max_distance_m * max_distance_m;
    // The partner of the place before bounds the search for this one.
    let start = || None;
    map_places(places, progress, start, |last: &mut Option<u32>, i| {
        let bound_sq = last.map_or(f64::INFINITY, |at| {
            distance_sq(&places[i], &to.points()[at as usize])
        });
        let found = to.nearest_within(&places[i], bound_sq.min(max_sq));
        *last = found.map(|neighbor| neighbor.index).or(*last);
        found
    })
}

/// Which points of a cloud repeat what another shows: those whose `nearest` point in the other lies
/// nearer than the nearest other point of their own cloud, and than the nearest other point of that
/// partner in its cloud. Where the one cloud is dense and the other sparse, little is a repetition.
///
/// `nearest` belongs to the points of `own` in their order; its distances are `scale` times as long
/// as those in `own`, because the clouds may be in different frames.
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
    fn bounded_distances_agree_with_brute_force() {
        let (from, to) = (draw(60_000, 1), draw(300, 2));
        let found =
            nearest_within(&from, &NeighborIndex::new(&to), 0.4, &Progress::silent()).unwrap();
        let mut n_found = 0;
        for (p, found) in from.iter().zip(found) {
            let wanted = least_sq(p, &to);
            assert_eq!(
                found.map(|n| n.distance_sq),
                (wanted <= 0.4 * 0.4).then_some(wanted)
            );
            n_found += usize::from(found.is_some());
        }
        assert!((10_000..50_000).contains(&n_found), "{n_found}");
    }

    #[test]
    fn a_repetition_is_nearer_than_both_clouds_are_dense() {
        let (own, other) = (draw(500, 3), draw(400, 4));
        let (a, b) = (NeighborIndex::new(&own), NeighborIndex::new(&other));
        let nearest = nearest_within(&own, &b, f64::INFINITY, &Progress::silent()).unwrap();
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
