//! The lengths of M3C2, from the spacing and the roughness of the clouds where nobody gives them.

use super::M3c2Options;
use super::normal::Moments;
use crate::cloud::Point;
use crate::error::{Error, Result, require_positive};
use crate::neighbors::NeighborIndex;
use crate::parallel;
use crate::progress::Progress;

/// Points of the sparser cloud that nine cylinders in ten are to hold.
const POINTS_IN_CYLINDER: usize = 20;
const MOST: f64 = 0.9;

/// The diameter for a normal is at least so many times the roughness across it.
const DIAMETER_IN_ROUGHNESS: f64 = 25.0;
/// Radii for normals that are tried, in cylinder radii, and the one that is taken besides.
const NORMAL_RADII: [f64; 5] = [1.0, 1.5, 2.0, 3.0, 4.0];
const NEXT_NORMAL_SCALE: f64 = 2.0;

/// The cylinder reaches so many of its radii to either side.
const DEPTH_IN_RADII: f64 = 10.0;

/// Most places at which spacing and roughness are looked at.
const SAMPLE_PLACES: usize = 2000;

/// The lengths that were used.
#[derive(Debug, Clone, PartialEq)]
pub struct M3c2Scales {
    /// Radii of the balls in which the normal is sought.
    pub normal_radii_m: Vec<f64>,
    /// Radius of the cylinder.
    pub cylinder_radius_m: f64,
    /// How far it reaches to either side.
    pub max_depth_m: f64,
}

impl M3c2Scales {
    /// What the options leave open, from the spacing and the roughness of both clouds.
    ///
    /// # Errors
    /// [`Error::InvalidArgument`] for the options, [`Error::TooFewPoints`] where a cloud has fewer
    /// than three points and lengths are to be derived from it, [`Error::Cancelled`].
    pub fn derive(
        reference: &NeighborIndex,
        compared: &NeighborIndex,
        options: &M3c2Options,
        progress: &Progress<'_>,
    ) -> Result<Self> {
        let places = [reference, compared].map(sample_places);
        Self::derive_at(
            [&places[0], &places[1]],
            reference,
            compared,
            options,
            progress,
        )
    }

    /// The same from given places of the reference and of the compared cloud, of which nothing but what
    /// lies round these places need be there.
    ///
    /// # Errors
    /// As [`M3c2Scales::derive`].
    pub fn derive_at(
        places: [&[Point]; 2],
        reference: &NeighborIndex,
        compared: &NeighborIndex,
        options: &M3c2Options,
        progress: &Progress<'_>,
    ) -> Result<Self> {
        options.check()?;
        let cylinder_radius_m = match options.cylinder_radius_m {
            Some(radius_m) => radius_m,
            None => radius_of_points(places[0], reference, "reference cloud")?
                .max(radius_of_points(places[1], compared, "compared cloud")?),
        };
        let normal_radii_m = match &options.normal_radii_m {
            Some(radii_m) => radii_m.clone(),
            None => {
                let radius_m = flat_radius(places[0], reference, cylinder_radius_m, progress)?;
                vec![radius_m, NEXT_NORMAL_SCALE * radius_m]
            }
        };
        Ok(Self {
            normal_radii_m,
            cylinder_radius_m,
            max_depth_m: options
                .max_depth_m
                .unwrap_or(DEPTH_IN_RADII * cylinder_radius_m),
        })
    }
}

/// Places at which lengths are looked at: evenly strided points.
fn sample_places(cloud: &NeighborIndex) -> Vec<Point> {
    let stride = cloud.len().div_ceil(SAMPLE_PLACES).max(1);
    cloud.points().iter().step_by(stride).copied().collect()
}

/// The radius within which nine places in ten have 20 points of their own cloud, themselves included.
fn radius_of_points(places: &[Point], cloud: &NeighborIndex, what: &str) -> Result<f64> {
    if cloud.len() < 3 || places.is_empty() {
        return Err(Error::TooFewPoints {
            what: what.into(),
            found: cloud.len(),
            needed: 3,
        });
    }
    let mut radii_sq = parallel::map(places.len(), |i| {
        let mut found = Vec::new();
        cloud.k_nearest(&places[i], POINTS_IN_CYLINDER, &mut found);
        found.last().map_or(0.0, |farthest| farthest.distance_sq)
    });
    let rank = (MOST * (radii_sq.len() - 1) as f64).round() as usize;
    let radius_m = radii_sq
        .select_nth_unstable_by(rank, f64::total_cmp)
        .1
        .sqrt();
    require_positive("cylinder_radius, derived from coincident points,", radius_m)
}

/// The first of the radii across which the surface is flat.
fn flat_radius(
    places: &[Point],
    cloud: &NeighborIndex,
    unit_m: f64,
    progress: &Progress<'_>,
) -> Result<f64> {
    let mut radius_m = unit_m;
    for factor in NORMAL_RADII {
        progress.check()?;
        radius_m = factor * unit_m;
        let mut roughness: Vec<f64> = parallel::map(places.len(), |i| {
            let mut ball = Moments::default();
            cloud.each_in_ball(&places[i], radius_m, |offset, _| ball.add(offset));
            ball.plane().map_or(f64::INFINITY, |(lambda, _)| {
                (lambda[2].max(0.0) / f64::from(ball.n)).sqrt()
            })
        });
        let middle = (roughness.len() - 1) / 2;
        let usual_m = *roughness.select_nth_unstable_by(middle, f64::total_cmp).1;
        if 2.0 * radius_m >= DIAMETER_IN_ROUGHNESS * usual_m {
            break;
        }
    }
    Ok(radius_m)
}
