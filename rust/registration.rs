//! What a registration leaves behind: the pose, the verdict, and what every stage did.

use std::time::Instant;

use crate::cloud::Point;
use crate::config::Config;
use crate::error::Result;
use crate::evaluate::DistanceStatistics;
use crate::icp::IcpStop;
use crate::progress::{Event, Progress, Stage};
use crate::similarity::Similarity;
use crate::uncertainty::PoseUncertainty;
use crate::verdict::{Strength, Verdict};

/// What one stage did.
#[derive(Debug, Clone, PartialEq)]
pub struct StageRecord {
    /// Which stage.
    pub stage: Stage,
    /// Points of the source that went in and came out.
    pub n_source: (usize, usize),
    /// Points of the target that went in and came out.
    pub n_target: (usize, usize),
    /// Wall time.
    pub seconds: f64,
}

/// The result of a registration. Poses take source coordinates to target coordinates, as given.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Registration {
    /// The pose.
    pub target_from_source: Similarity,
    /// The same pose about two pivots: q = s·R·(p − source pivot) + t + target pivot. Small numbers,
    /// so that nothing is lost where the matrix is written as text.
    pub about_pivots: Similarity,
    /// Pivot in the source: its centroid.
    pub source_pivot: Point,
    /// Pivot in the target: its centroid.
    pub target_pivot: Point,
    /// The verdict.
    pub verdict: Verdict,
    /// Why, the weightiest first.
    pub reasons: Vec<String>,
    /// Source voxels with a partner within `max_distance_m`, by all source voxels.
    pub fitness: f64,
    /// Root mean squared distance of those pairs.
    pub inlier_rmse_m: f64,
    /// The same of the target voxels with a partner in the source.
    pub inlier_rmse_back_m: f64,
    /// Number of source voxels with a partner.
    pub n_inliers: usize,
    /// Share of the source points, at full density, within `max_distance_m` of a target point.
    pub overlap_of_source: f64,
    /// Share of the target points, at full density, within `max_distance_m` of a source point.
    pub overlap_of_target: f64,
    /// Surface of both clouds with a partner and an agreeing normal, by twice that of the smaller
    /// cloud.
    pub inlier_share: f64,
    /// Score of the best pose by the score of its best rival; NaN in paper mode.
    pub ambiguity_ratio: f64,
    /// The ambiguity ratio above which this pose is accepted; infinite where nothing is shared.
    pub least_ambiguity_ratio: f64,
    /// How firmly the common surface holds the pose.
    pub strength: Strength,
    /// Score of the best pose by the best that a few random poses reach; NaN in paper mode.
    pub lead_over_chance: f64,
    /// Root mean squared distance of the pairs held out of the fit by that of others; NaN where there
    /// are too few.
    pub held_out_ratio: f64,
    /// How far the surfaces lie apart, by how rough they are themselves; NaN where there are too few
    /// pairs.
    pub misfit: f64,
    /// Surface of both clouds that lies above or below the other's, by that and what has a partner.
    pub conflict_share: f64,
    /// The share of inliers, less what conflicts with it.
    pub net_share: f64,
    /// How far even surfaces lie apart once their noise is averaged out; NaN where hardly any is even, or points
    /// are too few.
    pub surface_offset_m: f64,
    /// The surface offset up to which this pose is accepted.
    pub most_surface_offset_m: f64,
    /// Extent of the smaller cloud, which lengths that are not given are derived from.
    pub extent_m: f64,
    /// Whether the time was up before the search was done.
    pub ended_early: bool,
    /// How accurate the pose is, about a place relative to the target's pivot; `None` where the pairs
    /// are too few to tell.
    pub uncertainty: Option<PoseUncertainty>,
    /// The best poses found, best first: (pose, score).
    pub candidates: Vec<(Similarity, f64)>,
    /// Poses for which the clouds were compared during the search.
    pub n_evaluations: usize,
    /// Best score of the search so far, step by step.
    pub history: Vec<f64>,
    /// Why ICP ended.
    pub icp_stop: IcpStop,
    /// Iterations of ICP.
    pub n_icp_iterations: usize,
    /// Mean squared distance after each iteration of ICP.
    pub icp_history: Vec<f64>,
    /// Distances from every source point to the target, at full density.
    pub source_to_target: DistanceStatistics,
    /// Distances from every target point to the source, at full density.
    pub target_to_source: DistanceStatistics,
    /// Points dropped because a coordinate was NaN or infinite: source, target.
    pub n_non_finite: (usize, usize),
    /// Radius of the outlier removal: source, target.
    pub outlier_radius_m: (f64, f64),
    /// Edge of the voxels.
    pub voxel_size_m: f64,
    /// Distance within which a partner supports the pose.
    pub max_distance_m: f64,
    /// What each stage did.
    pub stages: Vec<StageRecord>,
    /// The configuration with everything that was derived filled in.
    pub config: Config,
}

/// Tells the caller where the route is, and keeps what each stage did.
pub(crate) struct StageLog<'a> {
    progress: &'a Progress<'a>,
    pub(crate) records: Vec<StageRecord>,
    began: Instant,
}

impl<'a> StageLog<'a> {
    pub(crate) fn new(progress: &'a Progress<'a>) -> Self {
        Self {
            progress,
            records: Vec::new(),
            began: Instant::now(),
        }
    }

    /// A stage begins with so many points.
    pub(crate) fn begin(&mut self, stage: Stage, n_source: usize, n_target: usize) -> Result<()> {
        self.began = Instant::now();
        self.records.push(StageRecord {
            stage,
            n_source: (n_source, n_source),
            n_target: (n_target, n_target),
            seconds: 0.0,
        });
        self.progress.emit(&Event::Started { stage })
    }

    /// The running stage left so many points.
    pub(crate) fn end(&mut self, n_source: usize, n_target: usize) {
        if let Some(record) = self.records.last_mut() {
            record.n_source.1 = n_source;
            record.n_target.1 = n_target;
        }
        self.keep();
    }

    /// The running stage left the points as they were.
    pub(crate) fn keep(&mut self) {
        if let Some(record) = self.records.last_mut() {
            record.seconds = self.began.elapsed().as_secs_f64();
        }
    }
}
