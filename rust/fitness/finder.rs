//! Who finds partners: the index of a cloud exactly, its grids about twenty times faster.

use crate::cloud::Point;
use crate::distance_field::NearestGrid;
use crate::near_field::NearField;
use crate::neighbors::NeighborIndex;

/// Finds points of a cloud near a place.
pub trait FindsPartner {
    /// A point of the cloud at most `max_sq` from `place`, squared; a near one, if not the nearest.
    fn partner(&self, place: &Point, max_sq: f64) -> Option<usize>;

    /// The same where the point may be far away, and answers may be rougher.
    fn far_partner(&self, place: &Point, max_sq: f64) -> Option<usize> {
        self.partner(place, max_sq)
    }
}

impl FindsPartner for NeighborIndex {
    #[inline]
    fn partner(&self, place: &Point, max_sq: f64) -> Option<usize> {
        Some(self.nearest_within(place, max_sq)?.index as usize)
    }
}

/// The grids of one cloud: the fine one, which knows what is near, and the coarse one, which knows of the
/// whole box.
#[derive(Debug, Clone, Copy)]
pub struct Grids<'a> {
    /// Answers as far as its reach.
    pub fine: &'a NearField,
    /// Answers anywhere.
    pub coarse: &'a NearestGrid,
}

impl FindsPartner for Grids<'_> {
    #[inline]
    fn partner(&self, place: &Point, max_sq: f64) -> Option<usize> {
        let (partner, distance_sq) = self.fine.nearest(place)?;
        (distance_sq <= max_sq).then_some(partner)
    }

    #[inline]
    fn far_partner(&self, place: &Point, max_sq: f64) -> Option<usize> {
        let (partner, distance_sq) = self.coarse.nearest(place);
        (distance_sq <= max_sq).then_some(partner)
    }
}
