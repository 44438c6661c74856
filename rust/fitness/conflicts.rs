//! What two clouds cannot both have seen: surface of one a little above or below surface of the other.
//!
//! Why: ground lies on ground anywhere, also upside down, as closely as it is rough. But where two
//! surfaces are not the same they cross, and beside the line where they do, one lies above the other. At the right
//! pose what has no partner lies beside the other cloud, in its holes or beyond its border.
//! Source: ours; measured in docs/robust_search.md. The like with known places of the sensors, free-space
//! violation: Huber & Hebert (2003).

use super::{FindsPartner, Witnesses};
use crate::cloud::{Point, difference, distance_sq, dot};

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

/// Whether a witness that was moved to `place`, where nothing is within the tolerance, lies above or below the
/// surface of the other cloud.
#[inline]
pub(super) fn conflicts<P: FindsPartner>(
    place: &Point,
    (to, finder): (&Witnesses, &P),
    tolerance_m: f64,
) -> bool {
    let (least_sq, most_m) = ((FROM * tolerance_m).powi(2), TO * tolerance_m);
    if !to.cloud.is_near_box(place, most_m) {
        return false;
    }
    let Some(partner) = finder.far_partner(place, most_m * most_m) else {
        return false;
    };
    let (nearest, normal) = (
        &to.cloud.points()[partner],
        &to.cloud.surfaces[partner].normal,
    );
    distance_sq(place, nearest) > least_sq && lies_off(place, nearest, normal)
}
