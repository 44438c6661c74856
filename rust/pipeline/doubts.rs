//! What may be wrong with the input, where a pose was not accepted, or does not lead by much.
//!
//! The same search, briefly, for a source that is mirrored or in another unit: if that stands out,
//! and more than the source as given, somebody should be told.

use super::prepare::Prepared;
use super::search;
use crate::cloud::Cloud;
use crate::config::Config;
use crate::deadline::Deadline;
use crate::error::{Error, Result};
use crate::fitness::Witnesses;
use crate::freedom::Freedom;
use crate::progress::Progress;

/// Factors between units that are mixed up: metres and millimetres, metres and feet.
const UNITS: [(f64, &str); 4] = [
    (
        1000.0,
        "is 1000 times too small, as if in metres beside millimetres",
    ),
    (
        0.001,
        "is 1000 times too large, as if in millimetres beside metres",
    ),
    (
        1.0 / 0.3048,
        "is 3.28 times too small, as if in metres beside feet",
    ),
    (
        0.3048,
        "is 3.28 times too large, as if in feet beside metres",
    ),
];

/// Sentences about the source, each tried and found to fit better than a pose of that merit between the
/// clouds as they were `prepared`.
pub(super) fn doubts(
    prepared: &Prepared,
    [source, target]: [&Cloud; 2],
    merit: f64,
    config: &Config,
    deadline: Deadline,
    progress: &Progress<'_>,
) -> Result<Vec<String>> {
    let mut found = Vec::new();
    let quiet = progress.quietly();
    let brief = briefly(config);
    let fits = |source: &Witnesses, target: &Witnesses, unit_m: f64| -> Result<bool> {
        if deadline.is_over() {
            return Ok(false);
        }
        match search::search_from_nothing([source, target], unit_m, &brief, deadline, &quiet) {
            Ok(found) => {
                let stands_out = found.stands_out(search::enough(&brief));
                Ok(stands_out && search::merit(&found) > merit)
            }
            Err(Error::NoSolution { .. }) => Ok(false),
            Err(other) => Err(other),
        }
    };
    if fits(
        &prepared.source.mirrored(),
        &prepared.target,
        prepared.thinned.unit_m,
    )? {
        found.push(
            "the source fits well when mirrored: two axes are swapped, or one has the wrong sign"
                .to_owned(),
        );
    }
    let sizes = (target.extent_m() / source.extent_m()).ln();
    for (scale, words) in UNITS {
        // Only a unit that brings the sizes together explains anything.
        let explains = (sizes - scale.ln()).abs() < 0.5 * sizes.abs();
        if config.dof == Freedom::Similarity || !explains || deadline.is_over() {
            continue;
        }
        let scaled = Prepared::new(source, target, scale, &brief, &quiet)?;
        if fits(&scaled.source, &scaled.target, scaled.thinned.unit_m)? {
            found.push(format!(
                "the source {words}: in the other unit it fits well"
            ));
        }
    }
    Ok(found)
}

/// One round, from nothing. Lengths that were set belong to the unit that was set.
fn briefly(config: &Config) -> Config {
    let mut brief = config.clone();
    brief.dof = Freedom::Rigid;
    brief.voxel.voxel_size_m = None;
    brief.coarse.rotations_per_round.truncate(1);
    brief
}
