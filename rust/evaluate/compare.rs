//! Two clouds measured against each other at a pose, both ways.
//!
//! Why: everything is measured in the frame and the unit of the target, with one index a cloud.
//! Reads: two checked clouds and the pose between their local coordinates.  Leaves: a distance per
//! point, and the spacing that limits what it can tell.

use super::surface::{DistanceMethod, surface_distances};
use crate::cloud::{Cloud, Point};
use crate::error::Result;
use crate::neighbors::NeighborIndex;
use crate::parallel;
use crate::progress::Progress;
use crate::similarity::Similarity;
use crate::spacing::nearest_spacing_quantile_m;
use crate::surface_cloud::N_NORMAL_NEIGHBORS;

/// Most places at which the spacing is looked at.
const SAMPLE_PLACES: usize = 2000;

/// What most points of a cloud keep to.
const MOST: f64 = 0.9;

/// How distances are measured.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CompareOptions {
    /// To the nearest point, or to the surface between the points.
    pub method: DistanceMethod,
    /// How many points a plane goes through; at least 3.
    pub n_neighbors: usize,
}

impl Default for CompareOptions {
    fn default() -> Self {
        Self {
            method: DistanceMethod::Nearest,
            n_neighbors: N_NORMAL_NEIGHBORS,
        }
    }
}

/// Distances from the points of one cloud to the other.
#[derive(Debug, Clone, PartialEq)]
pub struct Direction {
    /// One for each point; NaN where the method has none.
    pub distances_m: Vec<f64>,
    /// Where distances were measured to: the median distance from a point of the other cloud to the
    /// nearest one at another place there. 0 where it has one place only.
    pub spacing_there_m: f64,
}

/// Two clouds measured against each other.
#[derive(Debug, Clone, PartialEq)]
pub struct Comparison {
    /// From each point of the source.
    pub source_to_target: Direction,
    /// From each point of the target.
    pub target_to_source: Direction,
    /// The spacing that nine points in ten of the sparser cloud keep to.
    pub wide_spacing_m: f64,
}

/// Measures `source` and `target` against each other, in the unit of the target; the pose lies between
/// their local coordinates.
///
/// ```
/// use tmchho::{Cloud, Rigid, evaluate::{CompareOptions, compare}, progress::Progress};
/// let row = |x: f64| [x, 0.0, 0.0];
/// let source = Cloud::of_any_shape("source cloud", &[0.0, 1.0, 2.0].map(row))?;
/// let target = Cloud::of_any_shape("target cloud", &[1.5, 3.0].map(row))?;
/// let pose = Rigid::identity().between_local_coordinates(source.origin(), target.origin());
/// let found = compare(&source, &target, pose, &CompareOptions::default(), &Progress::silent())?;
/// assert_eq!(found.source_to_target.distances_m, [1.5, 0.5, 0.5]);
/// assert_eq!(found.target_to_source.distances_m, [0.5, 1.0]);
/// # Ok::<(), tmchho::Error>(())
/// ```
///
/// # Errors
/// As [`surface_distances`].
pub fn compare(
    source: &Cloud,
    target: &Cloud,
    target_from_source: impl Into<Similarity>,
    options: &CompareOptions,
    progress: &Progress<'_>,
) -> Result<Comparison> {
    let pose = target_from_source.into();
    let moved = parallel::map_cheap(source.len(), progress, |i| pose.apply(&source.points()[i]))?;
    let (source, target) = (
        NeighborIndex::new(&moved),
        NeighborIndex::new(target.points()),
    );
    let measured = |from: &NeighborIndex, to: &NeighborIndex| {
        let CompareOptions {
            method,
            n_neighbors,
        } = *options;
        let distances_m = if method == DistanceMethod::Nearest {
            to.distances_to(&from.places(), progress)? // which are sorted already
        } else {
            surface_distances(from.points(), to, method, n_neighbors, progress)?
        };
        let spacing_there_m = spacing_at(from.points(), to);
        Ok(Direction {
            distances_m,
            spacing_there_m,
        })
    };
    let wide = |index| nearest_spacing_quantile_m(index, MOST, progress);
    Ok(Comparison {
        source_to_target: measured(&source, &target)?,
        target_to_source: measured(&target, &source)?,
        wide_spacing_m: wide(&source)?.max(wide(&target)?),
    })
}

/// The median spacing of `to` at its points nearest to `places`.
fn spacing_at(places: &[Point], to: &NeighborIndex) -> f64 {
    let stride = places.len().div_ceil(SAMPLE_PLACES).max(1);
    let mut spacings: Vec<f64> = parallel::map(places.len().div_ceil(stride), |i| {
        let foot = to.nearest_within(&places[i * stride], f64::INFINITY)?;
        to.nearest_elsewhere(&to.points()[foot.index as usize])
    })
    .into_iter()
    .flatten()
    .map(|neighbor| neighbor.distance_sq.sqrt())
    .collect();
    if spacings.is_empty() {
        return 0.0;
    }
    let middle = (spacings.len() - 1) / 2;
    *spacings.select_nth_unstable_by(middle, f64::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rigid::Rigid;

    #[test]
    fn a_scaled_source_is_measured_in_the_unit_of_the_target() {
        let at = |x: f64| [x, 0.0, 0.0];
        let source = Cloud::of_any_shape("source", &[1.0, 2.0, 3.0].map(at)).unwrap();
        let target = Cloud::of_any_shape("target", &[2.5, 6.0, 40.0].map(at)).unwrap();
        let pose = Similarity::from_matrix4(&[
            [2.0, 0.0, 0.0, 0.0],
            [0.0, 2.0, 0.0, 0.0],
            [0.0, 0.0, 2.0, 0.0],
            [0.0, 0.0, 0.0, 1.0],
        ])
        .unwrap();
        let pose = pose.between_local_coordinates(source.origin(), target.origin());
        let options = CompareOptions::default();
        let found = compare(&source, &target, pose, &options, &Progress::silent()).unwrap();
        assert_eq!(found.source_to_target.distances_m, [0.5, 1.5, 0.0]);
        assert_eq!(found.target_to_source.distances_m, [0.5, 0.0, 34.0]);
        assert_eq!(found.target_to_source.spacing_there_m, 2.0);
        // Where the source is, the target has steps of 3.5; the stray is no partner of anything.
        assert_eq!(found.source_to_target.spacing_there_m, 3.5);
        assert_eq!(found.wide_spacing_m, 34.0);
    }

    #[test]
    fn one_place_has_no_spacing() {
        let cloud = Cloud::of_any_shape("cloud", &[[1.0, 2.0, 3.0]; 4]).unwrap();
        let pose = Rigid::identity().between_local_coordinates(cloud.origin(), cloud.origin());
        let options = CompareOptions::default();
        let found = compare(&cloud, &cloud, pose, &options, &Progress::silent()).unwrap();
        assert_eq!(found.source_to_target.spacing_there_m, 0.0);
        assert_eq!(found.source_to_target.distances_m, [0.0; 4]);
    }
}
