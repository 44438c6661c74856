//! Two clouds made comparable: one voxel for both, surfaces, and witnesses.

use std::sync::OnceLock;

use super::VOXELS_PER_EXTENT;
use super::strays::{share_of_strays, surfaces_on_surfaces, without_strays};
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
use crate::voxel::downsample;

/// Where 30 % of the points are strays, a quarter to a half of all voxels are.
const MANY_STRAYS: f64 = 0.25;

/// Two clouds as the search and the fine stage read them.
#[derive(Debug)]
pub(super) struct Prepared {
    /// By which the source was multiplied beforehand.
    pub(super) source_scale: f64,
    pub(super) source_voxels: Cloud,
    pub(super) target_voxels: Cloud,
    pub(super) source: Witnesses,
    pub(super) target: Witnesses,
    /// The extent of the smaller cloud, which every derived length is a share of.
    pub(super) unit_m: f64,
    pub(super) voxel_size_m: f64,
    /// Of source and target, once somebody asks.
    shares_of_strays: OnceLock<[f64; 2]>,
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
        let scaled;
        let source = match source_scale {
            1.0 => source,
            _ => {
                scaled = grown(source, source_scale);
                &scaled
            }
        };
        let unit_m = extent_of_smaller(source, target)?;
        let voxel_size_m = match config.voxel.voxel_size_m {
            Some(asked_m) if asked_m > unit_m => {
                return Err(Error::argument(
                    "voxel.voxel_size_m",
                    format!(
                        "must not exceed the extent of the smaller cloud, {unit_m:.3e}, got {asked_m}"
                    ),
                ));
            }
            asked_m => asked_m.unwrap_or(unit_m / VOXELS_PER_EXTENT),
        };
        let thinned = |cloud: &Cloud| downsample(cloud, voxel_size_m, progress);
        let (of_source, of_target) = parallel::both(|| thinned(source), || thinned(target));
        let voxels = [of_source?.cloud, of_target?.cloud];
        Self::of_voxels(
            voxels,
            source_scale,
            (unit_m, voxel_size_m),
            config,
            progress,
        )
    }

    /// Whether, on average over the two clouds, many voxels are those of strays.
    ///
    /// # Errors
    /// [`crate::Error::Cancelled`].
    pub(super) fn is_strewn(&self, progress: &Progress<'_>) -> Result<bool> {
        let [of_source, of_target] = self.shares_of_strays(progress)?;
        Ok((of_source + of_target) / 2.0 > MANY_STRAYS)
    }

    /// Whether in each of the clouds many voxels are those of strays.
    ///
    /// # Errors
    /// [`crate::Error::Cancelled`].
    pub(super) fn are_both_strewn(&self, progress: &Progress<'_>) -> Result<bool> {
        let [of_source, of_target] = self.shares_of_strays(progress)?;
        Ok(of_source.min(of_target) > MANY_STRAYS)
    }

    fn shares_of_strays(&self, progress: &Progress<'_>) -> Result<[f64; 2]> {
        if let Some(shares) = self.shares_of_strays.get() {
            return Ok(*shares);
        }
        let share = |of: &Witnesses| share_of_strays(&of.cloud, progress);
        let (of_source, of_target) = parallel::both(|| share(&self.source), || share(&self.target));
        let shares = [of_source?, of_target?];
        Ok(*self.shares_of_strays.get_or_init(|| shares))
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
        let [of_source, of_target] = self.shares_of_strays(progress)?;
        let source = (&self.source.cloud, of_source);
        let target = (&self.target.cloud, of_target);
        let (back, back_m) = (pose.inverse(), max_distance_m / pose.scale);
        let (forth, back) = parallel::both(
            || surfaces_on_surfaces(source.0, target, pose, max_distance_m, progress),
            || surfaces_on_surfaces(target.0, source, &back, back_m, progress),
        );
        Ok((forth? + back?) / 2.0 < 1.0)
    }

    /// The same without the voxels of strays; `None` where hardly any would go, or hardly any stay.
    pub(super) fn without_strays(
        &self,
        source: &Cloud,
        target: &Cloud,
        config: &Config,
        progress: &Progress<'_>,
    ) -> Result<Option<Self>> {
        /// Fewer of all voxels change nothing.
        const LEAST_SHARE: f64 = 0.05;
        let cleaned = |cloud: &Cloud| -> Result<Cloud> {
            let voxels = downsample(cloud, self.voxel_size_m, progress)?;
            without_strays(&voxels, self.voxel_size_m, progress)
        };
        let (of_source, of_target) = parallel::both(|| cleaned(source), || cleaned(target));
        let voxels = [of_source?, of_target?];
        let before = [&self.source_voxels, &self.target_voxels];
        let keeps_most = |(after, before): (&Cloud, &Cloud)| {
            after.len() as f64 > (1.0 - LEAST_SHARE) * before.len() as f64
        };
        let changes_nothing = voxels.iter().zip(before).all(keeps_most);
        if changes_nothing || voxels.iter().any(|cloud| cloud.len() < MIN_POINTS) {
            return Ok(None);
        }
        let lengths = (self.unit_m, self.voxel_size_m);
        Self::of_voxels(voxels, self.source_scale, lengths, config, progress).map(Some)
    }

    fn of_voxels(
        [source_voxels, target_voxels]: [Cloud; 2],
        source_scale: f64,
        (unit_m, voxel_size_m): (f64, f64),
        config: &Config,
        progress: &Progress<'_>,
    ) -> Result<Self> {
        let surfaces = |voxels: &Cloud| SurfaceCloud::new(voxels, config.seed, progress);
        let (of_source, of_target) =
            parallel::both(|| surfaces(&source_voxels), || surfaces(&target_voxels));
        let surfaces = [of_source?, of_target?];
        let [source, target] = Witnesses::of_both(
            surfaces,
            coarse::N_WITNESSES,
            coarse::WITNESS_RADIUS * unit_m,
            voxel_size_m,
            progress,
        )?;
        Ok(Self {
            source_scale,
            source_voxels,
            target_voxels,
            source,
            target,
            unit_m,
            voxel_size_m,
            shares_of_strays: OnceLock::new(),
        })
    }

    /// What is known, about the origins of the prepared clouds.
    pub(super) fn known(&self, known: &Observations) -> Result<LocalObservations> {
        let (source_origin, target_origin) = (self.source.cloud.origin, self.target.cloud.origin);
        if self.source_scale == 1.0 {
            return known.about(source_origin, target_origin);
        }
        known
            .for_scaled_source(self.source_scale, self.source_pivot())
            .about(source_origin, target_origin)
    }

    /// The pose between these clouds, from one between the clouds that were given.
    pub(super) fn pose_from_given(&self, pose: &Similarity) -> Similarity {
        let from_scaled = Similarity {
            scale: pose.scale / self.source_scale,
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
        self.source.cloud.origin.map(|v| v / self.source_scale)
    }

    /// Where the target's pivot lies in the coordinates given.
    pub(super) fn target_pivot(&self) -> Point {
        self.target.cloud.origin
    }

    /// The pose about the pivots of the clouds that were given, from one of the prepared ones.
    pub(super) fn about_pivots(&self, pose: &Similarity) -> Similarity {
        Similarity {
            scale: self.source_scale * pose.scale,
            ..*pose
        }
    }
}

/// The cloud multiplied by `scale`.
fn grown(cloud: &Cloud, scale: f64) -> Cloud {
    let grow = |p: &Point| p.map(|v| scale * v);
    Cloud::from_local(
        grow(&cloud.origin()),
        cloud.points().iter().map(grow).collect(),
    )
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

fn extent_of_smaller(source: &Cloud, target: &Cloud) -> Result<f64> {
    for (what, cloud) in [("source cloud", source), ("target cloud", target)] {
        if cloud.len() < MIN_POINTS {
            return Err(Error::TooFewPoints {
                what: format!("{what}, after outlier removal,"),
                found: cloud.len(),
                needed: MIN_POINTS,
            });
        }
    }
    let (of_source, of_target) = parallel::both(|| source.extent_m(), || target.extent_m());
    Ok(of_source.min(of_target))
}
