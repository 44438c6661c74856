//! Two clouds thinned to one voxel, and thinned once more of the voxels of strays.
//!
//! Why: whether there are many strays can be told before their surfaces are, which cost more.

use std::sync::OnceLock;

use super::VOXELS_PER_EXTENT;
use super::strays::{share_of_strays, without_strays};
use crate::cloud::{Cloud, MIN_POINTS, Point};
use crate::coarse;
use crate::config::Config;
use crate::error::{Error, Result};
use crate::parallel;
use crate::progress::Progress;
use crate::surface_cloud::IndexedCloud;
use crate::voxel::{VoxelResult, downsample};

/// Where 30 % of the points are strays, a quarter to a half of all voxels are.
const MANY_STRAYS: f64 = 0.25;
/// So many strays of one cloud may lie on those of the other.
const SOME_STRAYS: f64 = 0.15;

/// Two clouds with one voxel, indexed.
#[derive(Debug)]
pub(super) struct Thinned {
    /// By which the source was multiplied beforehand.
    pub(super) source_scale: f64,
    pub(super) source: Voxels,
    pub(super) target: Voxels,
    /// The extent of the smaller cloud, which every derived length is a share of.
    pub(super) unit_m: f64,
    pub(super) voxel_size_m: f64,
    /// Of source and target, once somebody asks.
    shares_of_strays: OnceLock<[f64; 2]>,
}

/// The voxels of a cloud, about its origin and about their own centroid.
#[derive(Debug)]
pub(super) struct Voxels {
    pub(super) cloud: Cloud,
    pub(super) indexed: IndexedCloud,
    /// How many points each of the indexed voxels stands for, which tells strays; `None` once these are gone.
    n_points: Option<Vec<u32>>,
}

impl Voxels {
    fn new(VoxelResult { cloud, n_points }: VoxelResult) -> Self {
        let (indexed, numbers) = IndexedCloud::new(&cloud);
        let n_points = numbers.iter().map(|i| n_points[*i as usize]).collect();
        Self {
            cloud,
            indexed,
            n_points: Some(n_points),
        }
    }

    fn cleaned(cloud: Cloud) -> Self {
        let (indexed, _) = IndexedCloud::new(&cloud);
        Self {
            cloud,
            indexed,
            n_points: None,
        }
    }

    /// Number of voxels.
    pub(super) fn len(&self) -> usize {
        self.cloud.len()
    }

    fn without_strays(&self, voxel_size_m: f64, progress: &Progress<'_>) -> Result<Option<Cloud>> {
        let Some(n_points) = &self.n_points else {
            return Ok(None);
        };
        let index = &self.indexed.index;
        let kept = without_strays(index, n_points, voxel_size_m, progress)?;
        let points = kept.iter().map(|i| index.points()[*i as usize]).collect();
        Ok(Some(Cloud::from_local(self.indexed.origin, points)))
    }
}

impl Thinned {
    /// Thins both clouds, the source multiplied by `source_scale`.
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
        let thinned = |cloud: &Cloud| downsample(cloud, voxel_size_m, progress).map(Voxels::new);
        let (source, target) = parallel::both(|| thinned(source), || thinned(target));
        Ok(Self {
            source_scale,
            source: source?,
            target: target?,
            unit_m,
            voxel_size_m,
            shares_of_strays: OnceLock::new(),
        })
    }

    /// Whether the search is long from its first round on.
    pub(super) fn has_many_places(&self) -> bool {
        let has_many =
            |of: &Voxels| coarse::has_many_places(of.indexed.index.points(), self.unit_m);
        has_many(&self.source) || has_many(&self.target)
    }

    /// Whether, on average over the two clouds, many voxels are those of strays.
    ///
    /// # Errors
    /// [`crate::Error::Cancelled`].
    pub(super) fn is_strewn(&self, progress: &Progress<'_>) -> Result<bool> {
        Ok(self.mean_share_of_strays(progress)? > MANY_STRAYS)
    }

    /// Whether, on average over the two clouds, there are strays enough to vouch for a pose.
    ///
    /// # Errors
    /// [`crate::Error::Cancelled`].
    pub(super) fn has_some_strays(&self, progress: &Progress<'_>) -> Result<bool> {
        Ok(self.mean_share_of_strays(progress)? > SOME_STRAYS)
    }

    fn mean_share_of_strays(&self, progress: &Progress<'_>) -> Result<f64> {
        let [of_source, of_target] = self.shares_of_strays(progress)?;
        Ok((of_source + of_target) / 2.0)
    }

    /// Whether in each of the clouds many voxels are those of strays.
    ///
    /// # Errors
    /// [`crate::Error::Cancelled`].
    pub(super) fn are_both_strewn(&self, progress: &Progress<'_>) -> Result<bool> {
        let [of_source, of_target] = self.shares_of_strays(progress)?;
        Ok(of_source.min(of_target) > MANY_STRAYS)
    }

    /// Which share of the voxels of source and target are those of strays, by samples.
    ///
    /// # Errors
    /// [`crate::Error::Cancelled`].
    pub(super) fn shares_of_strays(&self, progress: &Progress<'_>) -> Result<[f64; 2]> {
        if let Some(shares) = self.shares_of_strays.get() {
            return Ok(*shares);
        }
        let share = |of: &Voxels| share_of_strays(&of.indexed.index, progress);
        let (of_source, of_target) = parallel::both(|| share(&self.source), || share(&self.target));
        let shares = [of_source?, of_target?];
        Ok(*self.shares_of_strays.get_or_init(|| shares))
    }

    /// The same without the voxels of strays; `None` where hardly any would go, or hardly any stay, or these are gone.
    ///
    /// # Errors
    /// [`crate::Error::Cancelled`].
    pub(super) fn without_strays(&self, progress: &Progress<'_>) -> Result<Option<Self>> {
        /// Fewer of all voxels change nothing.
        const LEAST_SHARE: f64 = 0.05;
        let cleaned = |of: &Voxels| of.without_strays(self.voxel_size_m, progress);
        let (source, target) = parallel::both(|| cleaned(&self.source), || cleaned(&self.target));
        let (Some(source), Some(target)) = (source?, target?) else {
            return Ok(None);
        };
        let keeps_most = |after: &Cloud, before: &Voxels| {
            after.len() as f64 > (1.0 - LEAST_SHARE) * before.len() as f64
        };
        let changes_nothing =
            keeps_most(&source, &self.source) && keeps_most(&target, &self.target);
        if changes_nothing || source.len().min(target.len()) < MIN_POINTS {
            return Ok(None);
        }
        let (source, target) =
            parallel::both(|| Voxels::cleaned(source), || Voxels::cleaned(target));
        Ok(Some(Self {
            source,
            target,
            shares_of_strays: OnceLock::new(),
            ..*self
        }))
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
