//! What two clouds cannot both have seen: surface of one a little above or below surface of the other.
//!
//! Why: ground lies on ground anywhere, also upside down, as closely as it is rough. But where two
//! surfaces are not the same they cross, and beside the line where they do, one lies above the other. At the right
//! pose what has no partner lies beside the other cloud, in its holes or beyond its border.
//! Source: ours; measured in docs/robust_search.md. The like with known places of the sensors, free-space
//! violation: Huber & Hebert (2003).

use super::{FindsPartner, Witnesses};
use crate::cloud::{Point, difference, distance_sq, dot};
use crate::similarity::Similarity;

/// Conflicts lie so many tolerances from the other surface: closer it may be noise, farther another surface.
const FROM: f64 = 2.0;
const TO: f64 = 8.0;

/// Whether `place` lies above or below the surface at the point nearest to it, and not beside it: within 32°
/// of the normal there.
#[inline]
pub(crate) fn lies_off(place: &Point, nearest: &Point, normal: &Point) -> bool {
    const MIN_COSINE: f64 = 0.85;
    let off_plane = dot(&difference(place, nearest), normal);
    off_plane * off_plane > MIN_COSINE * MIN_COSINE * distance_sq(place, nearest)
}

/// Counts the witnesses of `from` that lie above or below the surface of the other cloud.
pub(super) fn n_conflicts<P: FindsPartner>(
    from: &Witnesses,
    (witnesses, finder): (&Witnesses, &P),
    to_from: &Similarity,
    tolerance_m: f64,
) -> f64 {
    let (least_sq, most_m) = ((FROM * tolerance_m).powi(2), TO * tolerance_m);
    let to = &witnesses.cloud;
    let is_conflict = |i: &usize| {
        let moved = to_from.apply(&from.cloud.points()[*i]);
        if !to.is_near_box(&moved, most_m) {
            return false;
        }
        let Some(partner) = finder.far_partner(&moved, most_m * most_m) else {
            return false;
        };
        let (nearest, normal) = (&to.points()[partner], &to.surfaces[partner].normal);
        distance_sq(&moved, nearest) > least_sq && lies_off(&moved, nearest, normal)
    };
    from.numbers().filter(is_conflict).count() as f64
}
