//! Stage 1: points that stand almost alone are taken away.
//!
//! Why: birds, dust and mixed pixels would become keypoints and pull at every pose.
//! Reads: a checked cloud and its neighbour index.  Leaves: the points kept, in their order, and
//! where they stood.
//! Source: Ren, Zhao & Han (2023), Sec. 4.2: keep a point with at least k neighbours within r.
//! Deviates: the paper gives neither k nor r; r is derived from the spacing of the cloud.
//! Absent on purpose: repeated passes; one removal does not call for the next.

use crate::cloud::Cloud;
use crate::error::{Error, Result, require_positive};
use crate::neighbors::NeighborIndex;
use crate::parallel;
use crate::progress::Progress;
use crate::spacing::rough_spacing_quantile_m;

/// The derived radius is so many times the spacing that nine points in ten keep to: a scanner's
/// points lie ten times farther apart at the far end of the scan than in the middle of it.
const RADIUS_IN_SPACINGS: f64 = 4.0;
const SPACING_QUANTILE: f64 = 0.9;

/// Which points stand alone.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct OutlierOptions {
    /// Radius of the neighbourhood, above 0. `None`: four times the 90 % quantile of the distance
    /// to the nearest point.
    pub radius_m: Option<f64>,
    /// Fewest neighbours, the point itself not counted, that keep a point; 0 keeps all.
    pub min_neighbors: usize,
}

impl Default for OutlierOptions {
    fn default() -> Self {
        Self {
            radius_m: None,
            min_neighbors: 3,
        }
    }
}

/// What the stage left.
#[derive(Debug, Clone, PartialEq)]
pub struct OutlierResult {
    /// The points kept, about the origin of the cloud that went in.
    pub cloud: Cloud,
    /// Their indices in the cloud that went in, rising.
    pub kept: Vec<u32>,
    /// The radius that was used.
    pub radius_m: f64,
}

/// Keeps the points of `cloud` that have enough neighbours; points at the same position are
/// neighbours too. `index` is that of the cloud's points.
///
/// ```
/// use tmchho::{Cloud, neighbors::NeighborIndex, outlier, progress::Progress};
/// let mut points: Vec<_> = (0..100).map(|i| [f64::from(i % 10), f64::from(i / 10), 0.0]).collect();
/// points.push([5.0, 5.0, 80.0]);
/// let cloud = Cloud::of_any_shape("cloud", &points)?;
/// let index = NeighborIndex::new(cloud.points());
/// let cleaned = outlier::remove_outliers(&cloud, &index, &Default::default(), &Progress::silent())?;
/// assert_eq!((cleaned.cloud.len(), cleaned.radius_m), (100, 4.0));
/// # Ok::<(), tmchho::Error>(())
/// ```
///
/// # Errors
/// [`Error::InvalidArgument`] where the radius is not above 0 or `index` is another cloud's,
/// [`Error::Cancelled`].
pub fn remove_outliers(
    cloud: &Cloud,
    index: &NeighborIndex,
    options: &OutlierOptions,
    progress: &Progress<'_>,
) -> Result<OutlierResult> {
    if index.len() != cloud.len() {
        return Err(Error::argument(
            "index",
            "must be that of the cloud's points",
        ));
    }
    let radius_m = match options.radius_m {
        Some(radius_m) => require_positive("radius_m", radius_m)?,
        None => RADIUS_IN_SPACINGS * rough_spacing_quantile_m(index, SPACING_QUANTILE, progress)?,
    };
    let points = cloud.points();
    let needed = options.min_neighbors.saturating_add(1); // the point itself is found as well
    let n_near = index.count_around_all(radius_m, needed, progress)?;
    let kept = parallel::chunks(points.len(), progress, |range| {
        let is_kept = |i: &usize| n_near[*i] == needed;
        let kept = range.filter(is_kept).map(|i| i as u32);
        kept.collect::<Vec<u32>>()
    })?;
    let kept = kept.concat();
    let kept_points = parallel::map(kept.len(), |at| points[kept[at] as usize]);
    Ok(OutlierResult {
        cloud: Cloud::from_local(cloud.origin(), kept_points),
        kept,
        radius_m,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cloud::{Point, distance_sq};
    use crate::random::Stream;

    fn clean(
        points: &[Point],
        radius_m: Option<f64>,
        min_neighbors: usize,
    ) -> Result<OutlierResult> {
        let cloud = Cloud::of_any_shape("cloud", points).unwrap();
        let index = NeighborIndex::new(cloud.points());
        let options = OutlierOptions {
            radius_m,
            min_neighbors,
        };
        remove_outliers(&cloud, &index, &options, &Progress::silent())
    }

    #[test]
    fn by_hand() {
        // On a line at 0 1 2 4 4 8: neighbours within 2 (rim included) are 2 2 4 2 2 0.
        let points = [0.0, 1.0, 2.0, 4.0, 4.0, 8.0].map(|x| [x, 0.0, 0.0]);
        assert_eq!(clean(&points, Some(2.0), 2).unwrap().kept, [0, 1, 2, 3, 4]);
        assert_eq!(clean(&points, Some(2.0), 3).unwrap().kept, [2]);
        assert_eq!(clean(&points, Some(2.0), 0).unwrap().kept.len(), 6);
        assert!(
            clean(&points, Some(2.0), usize::MAX)
                .unwrap()
                .kept
                .is_empty()
        );
    }

    #[test]
    fn agrees_with_brute_force() {
        let mut stream = Stream::new(1, "outlier", 0);
        let points: Vec<Point> = (0..700).map(|_| [0; 3].map(|_| stream.normal())).collect();
        let (radius_m, min_neighbors) = (0.35, 4);
        let wanted: Vec<u32> = (0_u32..)
            .zip(&points)
            .filter(|(_, p)| {
                let near = points
                    .iter()
                    .filter(|q| distance_sq(p, q).sqrt() <= radius_m);
                near.count() > min_neighbors
            })
            .map(|(i, _)| i)
            .collect();
        let cleaned = clean(&points, Some(radius_m), min_neighbors).unwrap();
        assert_eq!(cleaned.kept, wanted);
        assert!(!wanted.is_empty() && wanted.len() < points.len());
    }

    #[test]
    fn the_derived_radius_keeps_the_thin_end_of_a_scan_and_drops_the_birds() {
        // Rings round a scanner, ten times sparser outside than inside, and birds above.
        let mut stream = Stream::new(2, "outlier", 0);
        let mut points: Vec<Point> = (0..100)
            .flat_map(|ring| (0..120).map(move |ray| (f64::from(ring), f64::from(ray))))
            .map(|(ring, ray)| {
                let (r, angle) = (
                    2.0 * 1.023_f64.powf(ring),
                    ray * std::f64::consts::TAU / 120.0,
                );
                [r * angle.cos(), r * angle.sin(), 0.01 * stream.normal()]
            })
            .collect();
        let n_ground = points.len() as u32;
        points.extend((0..40).map(|_| {
            let (x, y) = (
                stream.uniform_between(-20.0, 20.0),
                stream.uniform_between(-20.0, 20.0),
            );
            [x, y, stream.uniform_between(8.0, 40.0)]
        }));
        let cleaned = clean(&points, None, 3).unwrap();
        let n_kept_ground = cleaned.kept.iter().filter(|i| **i < n_ground).count();
        let n_kept_birds = cleaned.kept.len() - n_kept_ground;
        assert_eq!((n_kept_ground, n_kept_birds), (n_ground as usize, 0));
    }

    #[test]
    fn the_edges_of_the_domain() {
        assert!(clean(&[], None, 3).unwrap().cloud.is_empty());
        assert!(clean(&[[1.0; 3]], None, 1).unwrap().kept.is_empty());
        // Coincident points are neighbours, though their spacing and so the radius is 0.
        let pile = clean(&[[1.0; 3]; 5], None, 4).unwrap();
        assert_eq!((pile.kept.len(), pile.radius_m), (5, 0.0));
        for radius_m in [0.0, -1.0, f64::NAN] {
            assert!(clean(&[[1.0; 3]], Some(radius_m), 3).is_err());
        }
        let cloud = Cloud::of_any_shape("cloud", &[[1.0; 3]]).unwrap();
        let other = NeighborIndex::new(&[]);
        let options = OutlierOptions::default();
        assert!(remove_outliers(&cloud, &other, &options, &Progress::silent()).is_err());
    }
}
