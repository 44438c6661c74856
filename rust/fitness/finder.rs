//! Who finds partners: the index of a cloud exactly, its grids about twenty times faster.

use crate::cloud::Point;
use crate::distance_field::NearestGrid;
use crate::near_field::NearField;
use crate::neighbors::{NeighborIndex, WIDTH};

/// Finds points of a cloud near a place.
pub trait FindsPartner {
    /// For each of `places`, which should lie close together, a point of the cloud at most `max_sq` from there,
    /// squared; a near one, if not the nearest. `None` for a place that is not finite.
    fn partners(&self, places: &[Point; WIDTH], max_sq: f64) -> [Option<usize>; WIDTH];

    /// The same of one place, where the point may be far away, and answers may be rougher.
    fn far_partner(&self, place: &Point, max_sq: f64) -> Option<usize>;
}

impl FindsPartner for NeighborIndex {
    #[inline]
    fn partners(&self, places: &[Point; WIDTH], max_sq: f64) -> [Option<usize>; WIDTH] {
        self.nearest_of_some_within(places, max_sq)
            .map(|found| found.map(|neighbor| neighbor.index as usize))
    }

    #[inline]
    fn far_partner(&self, place: &Point, max_sq: f64) -> Option<usize> {
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
    fn partners(&self, places: &[Point; WIDTH], max_sq: f64) -> [Option<usize>; WIDTH] {
        places.each_ref().map(|place| {
            let (partner, distance_sq) = self.fine.nearest(place)?;
            (distance_sq <= max_sq).then_some(partner)
        })
    }

    #[inline]
    fn far_partner(&self, place: &Point, max_sq: f64) -> Option<usize> {
        let (partner, distance_sq) = self.coarse.nearest(place);
        (distance_sq <= max_sq).then_some(partner)
    }
}
