//! Two thinned clouds made comparable: surfaces, and witnesses.

use super::strays::surfaces_on_surfaces;
use super::thin::{Thinned, Voxels};
use crate::cloud::{Cloud, MIN_POINTS, Point};
use crate::coarse;
use crate::config::Config;
use crate::error::{Error, Result};
use crate::fitness::Witnesses;
use crate::observations::{LocalObservations, Observations};
use crate::parallel;
use crate::progress::Progress;
use crate::similarity::Similarity;
use crate::surface_cloud::SurfaceCloud;

/// Two clouds as the search and the fine stage read them.
#[derive(Debug)]
pub(super) struct Prepared {
    pub(super) thinned: Thinned,
    pub(super) source: Witnesses,
    pub(super) target: Witnesses,
}

impl Prepared {
    /// Thins both clouds, the source multiplied by `source_scale`, and looks at their surfaces.
    pub(super) fn new(
        source: &Cloud,
        target: &Cloud,
        source_scale: f64,
        config: &Config,
        progress: &Progress<'_>,
    ) -> Result<Self> {
        let thinned = Thinned::new(source, target, source_scale, config, progress)?;
        Self::of(thinned, config, progress)
    }

    /// Looks at the surfaces of thinned clouds.
    ///
    /// # Errors
    /// [`crate::Error::Cancelled`].
    pub(super) fn of(thinned: Thinned, config: &Config, progress: &Progress<'_>) -> Result<Self> {
        let surfaces = |of: &Voxels| SurfaceCloud::of(of.indexed.clone(), config.seed, progress);
        let (of_source, of_target) =
            parallel::both(|| surfaces(&thinned.source), || surfaces(&thinned.target));
        let [source, target] = Witnesses::of_both(
            [of_source?, of_target?],
            coarse::N_WITNESSES,
            coarse::WITNESS_RADIUS * thinned.unit_m,
            thinned.voxel_size_m,
            progress,
        )?;
        Ok(Self {
            thinned,
            source,
            target,
        })
    }

    /// Whether at `pose` the surfaces of the clouds lie on each other's strays, not on surfaces.
    ///
    /// # Errors
    /// [`crate::Error::Cancelled`].
    pub(super) fn lies_on_strays(
        &self,
        pose: &Similarity,
        max_distance_m: f64,
        progress: &Progress<'_>,
    ) -> Result<bool> {
        let [of_source, of_target] = self.thinned.shares_of_strays(progress)?;
        let source = (&self.source.cloud, of_source);
        let target = (&self.target.cloud, of_target);
        let (back, back_m) = (pose.inverse(), max_distance_m / pose.scale);
        let (forth, back) = parallel::both(
            || surfaces_on_surfaces(source.0, target, pose, max_distance_m, progress),
            || surfaces_on_surfaces(target.0, source, &back, back_m, progress),
        );
        Ok((forth? + back?) / 2.0 < 1.0)
    }

    /// What is known, about the origins of the prepared clouds.
    pub(super) fn known(&self, known: &Observations) -> Result<LocalObservations> {
        let (source_origin, target_origin) = (self.source.cloud.origin, self.target.cloud.origin);
        if self.thinned.source_scale == 1.0 {
            return known.about(source_origin, target_origin);
        }
        known
            .for_scaled_source(self.thinned.source_scale, self.source_pivot())
            .about(source_origin, target_origin)
    }

    /// The pose between these clouds, from one between the clouds that were given.
    pub(super) fn pose_from_given(&self, pose: &Similarity) -> Similarity {
        let from_scaled = Similarity {
            scale: pose.scale / self.thinned.source_scale,
            ..*pose
        };
        from_scaled.between_local_coordinates(self.source.cloud.origin, self.target.cloud.origin)
    }

    /// The pose between the clouds that were given, from one between these.
    pub(super) fn pose_to_given(&self, pose: &Similarity) -> Similarity {
        self.about_pivots(pose)
            .between_given_coordinates(self.source_pivot(), self.target_pivot())
    }

    /// Where the source's pivot lies in the coordinates given.
    pub(super) fn source_pivot(&self) -> Point {
        self.source
            .cloud
            .origin
            .map(|v| v / self.thinned.source_scale)
    }

    /// Where the target's pivot lies in the coordinates given.
    pub(super) fn target_pivot(&self) -> Point {
        self.target.cloud.origin
    }

    /// The pose about the pivots of the clouds that were given, from one of the prepared ones.
    pub(super) fn about_pivots(&self, pose: &Similarity) -> Similarity {
        Similarity {
            scale: self.thinned.source_scale * pose.scale,
            ..*pose
        }
    }
}

/// The points of `cloud` between two corners, in the coordinates given.
///
/// # Errors
/// [`Error::TooFewPoints`] where hardly any lie there.
pub(super) fn cropped(what: &str, cloud: &Cloud, corners: &[Point; 2]) -> Result<Cloud> {
    let (low, high) = (corners[0], corners[1]);
    let origin = cloud.origin();
    let is_inside = |p: &&Point| {
        (0..3).all(|axis| (low[axis]..=high[axis]).contains(&(p[axis] + origin[axis])))
    };
    let points: Vec<Point> = cloud.points().iter().filter(is_inside).copied().collect();
    if points.len() < MIN_POINTS {
        return Err(Error::TooFewPoints {
            what: format!("{what}, in its crop,"),
            found: points.len(),
            needed: MIN_POINTS,
        });
    }
    Ok(Cloud::from_local(origin, points))
}
