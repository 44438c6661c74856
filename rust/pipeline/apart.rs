//! Stages that make sense on their own, at a pose that is already known.

use super::distances;
use crate::cloud::{Cloud, Point};
use crate::error::Result;
use crate::fuse::{Compared, FuseOptions, FusedCloud};
use crate::neighbors::NeighborIndex;
use crate::progress::{Event, Progress, Stage};
use crate::similarity::Similarity;

/// Cloud-to-cloud distances of two clouds at a pose: from every point to the nearest of the other.
#[derive(Debug, Clone, PartialEq)]
pub struct Evaluation {
    /// From each finite source point to the target.
    pub source_to_target_m: Vec<f64>,
    /// From each finite target point to the source.
    pub target_to_source_m: Vec<f64>,
}

/// Stage 7 alone: the distances at a pose that is already known.
///
/// # Errors
/// [`Error::TooFewPoints`](crate::Error::TooFewPoints) for a cloud without finite points;
/// [`Error::Cancelled`](crate::Error::Cancelled).
pub fn evaluate(
    source: &[Point],
    target: &[Point],
    target_from_source: impl Into<Similarity>,
    progress: &Progress<'_>,
) -> Result<Evaluation> {
    let source = Cloud::of_some_points("source cloud", source)?;
    let target = Cloud::of_some_points("target cloud", target)?;
    let local = target_from_source
        .into()
        .between_local_coordinates(source.origin(), target.origin());
    let source_index = NeighborIndex::new(source.points());
    let target_index = NeighborIndex::new(target.points());
    let (forth, back) = distances(&source_index, &target_index, &local, progress)?;
    Ok(Evaluation {
        source_to_target_m: forth,
        target_to_source_m: back,
    })
}

/// Stage 8 alone: one cloud from two, at a pose that is already known.
///
/// # Errors
/// [`Error::TooFewPoints`](crate::Error::TooFewPoints) for a cloud without finite points;
/// [`Error::InvalidArgument`](crate::Error::InvalidArgument) for the options;
/// [`Error::Cancelled`](crate::Error::Cancelled).
pub fn fuse_clouds(
    source: &[Point],
    target: &[Point],
    target_from_source: impl Into<Similarity>,
    options: &FuseOptions,
    progress: &Progress<'_>,
) -> Result<FusedCloud> {
    progress.emit(&Event::Started { stage: Stage::Fuse })?;
    let source = Cloud::of_some_points("source cloud", source)?;
    let target = Cloud::of_some_points("target cloud", target)?;
    let local = target_from_source
        .into()
        .between_local_coordinates(source.origin(), target.origin());
    let source_index = NeighborIndex::new(source.points());
    let target_index = NeighborIndex::new(target.points());
    let compared = Compared::new(
        (&target, &target_index),
        (&source, &source_index),
        local,
        options,
        progress,
    )?;
    drop((source_index, target_index));
    compared.join(&target, &source, options.mode)
}
