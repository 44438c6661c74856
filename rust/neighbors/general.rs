//! kiddo's tree, the general engine for the nearest point. The only file that names kiddo.
//!
//! Its answers near a cloud that fills space are as quick as any; for flat clouds, piles of coincident
//! points and places far outside it is 2 to 70 times slower than our own tree (`blocks.rs`), which
//! therefore answers those.

use kiddo::SquaredEuclidean;

use super::Neighbor;
use crate::cloud::{Point, bounds, distance_sq};

/// kiddo over a cloud that it serves well.
pub(super) struct General {
    tree: kiddo::ImmutableKdTree<f64, 3>,
    low: Point,
    high: Point,
}

impl std::fmt::Debug for General {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("General")
            .field("low", &self.low)
            .field("high", &self.high)
            .finish_non_exhaustive()
    }
}

impl General {
    /// `None` where the cloud is flat along an axis, has piles of coincident points, which kiddo would
    /// search one by one, or cannot be sorted by kiddo.
    pub(super) fn new(points: &[Point], has_piles: bool) -> Option<Self> {
        /// kiddo halves its axes in turn: what a flat axis wastes is slight down to this ratio.
        const FLATTEST: f64 = 1e-3;
        let (low, high) = bounds(points);
        let sides: [f64; 3] = std::array::from_fn(|axis| high[axis] - low[axis]);
        let longest = sides.iter().copied().fold(0.0, f64::max);
        let fills_space = sides.iter().all(|side| *side > FLATTEST * longest);
        if !fills_space || has_piles {
            return None;
        }
        let tree = kiddo::ImmutableKdTree::new_from_slice(points).ok()?;
        Some(Self { tree, low, high })
    }

    /// The nearest of `points`, the ones given to [`General::new`]; of several at the same distance
    /// one, always the same. `None` outside the box of the points.
    pub(super) fn nearest(&self, points: &[Point], place: &Point) -> Option<Neighbor> {
        let inside =
            (0..3).all(|axis| self.low[axis] <= place[axis] && place[axis] <= self.high[axis]);
        if !inside {
            return None;
        }
        let found = self
            .tree
            .query(place)
            .nearest_one::<SquaredEuclidean<f64>>()
            .execute();
        let index = found.item;
        // Measured again, so that both engines state the same bits.
        let distance_sq = distance_sq(place, points.get(index as usize)?);
        Some(Neighbor { index, distance_sq })
    }
}
