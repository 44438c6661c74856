//! How far apart even surfaces of two clouds lie once their noise is averaged out.
//!
//! Why: noise hides that surfaces lie apart. Dams of one plan lie within metres of each other, and where
//! the photogrammetry is as noisy as that, the wrong dam fits as closely as its own. Averaged, noise goes, also what
//! of it neighbours have in common, and what lies apart stays.
//! Source: the distances are those of M3C2 (Lague, Brodu & Leroux 2013, Eq. 1 and Sec. 3), of trimmed means; their
//! average and its quantile are ours, measured in docs/robust_search.md.

use super::median;
use crate::cloud::{Point, dot};
use crate::error::Result;
use crate::neighbors::NeighborIndex;
use crate::normals::{Surface, estimate_within};
use crate::parallel;
use crate::progress::Progress;
use crate::similarity::Similarity;
use crate::surface_cloud::SurfaceCloud;

/// Where the normal is sought, by the unit: wide enough to average noise, narrow enough for a slope not to bend.
const NORMAL_RADIUS: f64 = 0.028;
/// Radius of a patch, in which points are averaged, and how far it reaches to either side: surfaces farther
/// apart are different ones.
const RADIUS: f64 = 0.02;
const DEPTH: f64 = 0.017;
/// How far the middle of a patch lies from the other cloud.
const NEAR: f64 = 0.01;
/// Patches within this distance are averaged: neighbours err alike, and not so far.
const REGION_RADIUS: f64 = 0.07;
/// One place is looked at in each cell of this edge, near the other cloud: they lie evenly, and what is found
/// depends little on which they are.
const PLACE_CELL: f64 = 0.02;
/// Fewer points in a patch tell nothing, nor do patches at fewer of the places: where points are few, they are
/// those on steps and bends. Nor do fewer patches round about, of the 38 that a flat region has.
const LEAST_POINTS: usize = 10;
const LEAST_EVEN: f64 = 0.25;
const LEAST_ROUND_ABOUT: usize = 12;

/// A patch of both clouds, in the fixed one's frame.
#[derive(Clone, Copy)]
struct Patch {
    place: Point,
    normal: Point,
    /// From the fixed surface to the moving one, along the normal.
    apart_m: f64,
}

/// How far apart even surfaces of both clouds lie at `pose` (fixed from moving), their noise averaged out, in the
/// unit of the fixed cloud: the distance along the normal, averaged round about each patch and less what noise adds
/// to the average, that nine tenths of the patches stay below. NaN where hardly any surface near the other cloud is
/// even, or nowhere much of it: in a canopy, in a cloud of few points. `unit_m` is the extent of the smaller cloud.
///
/// # Errors
/// [`crate::Error::Cancelled`].
pub fn surface_offset_m(
    moving: &SurfaceCloud,
    fixed: &SurfaceCloud,
    pose: &Similarity,
    unit_m: f64,
    progress: &Progress<'_>,
) -> Result<f64> {
    /// A tenth of a place may have changed; but dams of one plan lie together in most parts.
    const QUANTILE: f64 = 0.9;
    /// Normals of patches that are averaged agree within 37°.
    const MIN_COSINE: f64 = 0.8;
    let places = places_near(moving, fixed, pose, unit_m);
    let patches = even_patches(&places, moving, fixed, pose, unit_m, progress)?;
    if (patches.len() as f64) < LEAST_EVEN * places.len() as f64 {
        return Ok(f64::NAN);
    }
    let places: Vec<Point> = patches.iter().map(|patch| patch.place).collect();
    let index = NeighborIndex::new(&places);
    let squares = parallel::map(patches.len(), |i| {
        let patch = &patches[i];
        let mut apart = Sample::default();
        let mut round_about = Vec::new();
        index.within(&patch.place, REGION_RADIUS * unit_m, &mut round_about);
        for neighbor in round_about {
            let other = &patches[neighbor.index as usize];
            let cosine = dot(&patch.normal, &other.normal);
            if cosine.abs() > MIN_COSINE {
                apart.add(other.apart_m * cosine.signum());
            }
        }
        (apart.n >= LEAST_ROUND_ABOUT).then(|| apart.squared_mean_but_noise())
    });
    let mut squares: Vec<f64> = squares.into_iter().flatten().collect();
    if squares.is_empty() {
        return Ok(f64::NAN);
    }
    let at = ((squares.len() - 1) as f64 * QUANTILE) as usize;
    let (_, square, _) = squares.select_nth_unstable_by(at, f64::total_cmp);
    Ok(square.max(0.0).sqrt())
}

/// How far apart patches lie that are averaged.
#[derive(Default)]
struct Sample {
    n: usize,
    sum: f64,
    sum_of_squares: f64,
}

impl Sample {
    fn add(&mut self, apart_m: f64) {
        self.n += 1;
        self.sum += apart_m;
        self.sum_of_squares += apart_m * apart_m;
    }

    /// The square of the mean, less what noise adds to it on average: the square of the mean's standard error.
    /// Below zero where there is less than that.
    fn squared_mean_but_noise(&self) -> f64 {
        /// A point is part of so many patches: they are no independent samples.
        const SHARED_BY: f64 = std::f64::consts::PI * (RADIUS / PLACE_CELL) * (RADIUS / PLACE_CELL);
        let n = self.n as f64;
        let squared_mean = (self.sum / n).powi(2);
        let variance = (self.sum_of_squares - n * squared_mean) / (n - 1.0);
        squared_mean - SHARED_BY * variance / n
    }
}

/// Points of the fixed cloud, one for each cell, that have a point of the other one near.
fn places_near(
    moving: &SurfaceCloud,
    fixed: &SurfaceCloud,
    pose: &Similarity,
    unit_m: f64,
) -> Vec<Point> {
    let to_moving = pose.inverse();
    let near_m = NEAR * to_moving.scale * unit_m;
    let places = fixed.one_for_each_cell(PLACE_CELL * unit_m);
    let is_near = parallel::map(places.len(), |i| {
        let moved = to_moving.apply(&places[i]);
        moving.is_near_box(&moved, near_m)
            && (moving.index.nearest_within(&moved, near_m * near_m)).is_some()
    });
    let near = places.into_iter().zip(is_near).filter(|(_, is)| *is);
    near.map(|(place, _)| place).collect()
}

/// Patches where both clouds show a surface that is even and of one direction.
fn even_patches(
    places: &[Point],
    moving: &SurfaceCloud,
    fixed: &SurfaceCloud,
    pose: &Similarity,
    unit_m: f64,
    progress: &Progress<'_>,
) -> Result<Vec<Patch>> {
    /// Edges, and noise thicker than a fourth of a patch's width, tell no normal.
    const MAX_CURVATURE: f64 = 0.1;
    /// Normals agree within 14°, whichever way they point.
    const MIN_COSINE: f64 = 0.97;

    let to_moving = pose.inverse();
    // The unit as the moving cloud's frame has it.
    let (scale, moving_unit_m) = (to_moving.scale, to_moving.scale * unit_m);
    let moved: Vec<Point> = places.iter().map(|p| to_moving.apply(p)).collect();
    let surfaces = |cloud: &SurfaceCloud, places: &[Point], unit_m: f64| {
        let radius_m = NORMAL_RADIUS * unit_m;
        estimate_within(places, &cloud.index, radius_m, LEAST_POINTS, progress)
    };
    let (theirs, own) = parallel::both(
        || surfaces(fixed, places, unit_m),
        || surfaces(moving, &moved, moving_unit_m),
    );
    let (theirs, own) = (theirs?, own?);
    let is_even = |surface: &Surface| {
        surface.normal != Surface::NONE.normal && surface.curvature <= MAX_CURVATURE
    };
    let found = parallel::map(places.len(), |i| {
        let normal = theirs[i].normal;
        let axis = to_moving.rigid.rotate(&normal);
        let agrees = dot(&axis, &own[i].normal).abs() > MIN_COSINE;
        if !agrees || !is_even(&theirs[i]) || !is_even(&own[i]) {
            return None;
        }
        let theirs_m = mean_along(&fixed.index, &places[i], &normal, unit_m)?;
        let own_m = mean_along(&moving.index, &moved[i], &axis, moving_unit_m)?;
        Some(Patch {
            place: places[i],
            normal,
            apart_m: own_m / scale - theirs_m,
        })
    });
    Ok(found.into_iter().flatten().collect())
}

/// Where the surface of a cloud lies along `axis`, from `place`: the mean of what lies near the median, as strays
/// are no part of it. `None` where there are too few points.
fn mean_along(cloud: &NeighborIndex, place: &Point, axis: &Point, unit_m: f64) -> Option<f64> {
    /// In medians of the deviations; 2.5 standard deviations of a normal law.
    const FARTHEST: f64 = 3.7;
    let mut along = Vec::new();
    cloud.each_in_cylinder(place, axis, RADIUS * unit_m, DEPTH * unit_m, |t, _| {
        along.push(t);
    });
    if along.len() < LEAST_POINTS {
        return None;
    }
    let middle = median(&mut along);
    let mut off: Vec<f64> = along.iter().map(|t| (t - middle).abs()).collect();
    let farthest = FARTHEST * median(&mut off);
    along.retain(|t| (t - middle).abs() <= farthest);
    Some(along.iter().sum::<f64>() / along.len() as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cloud::Cloud;
    use crate::random::Stream;

    /// The extent of a cloud of edge 1, about.
    const UNIT_M: f64 = 1.4;

    fn surface_cloud(points: &[Point], seed: u64) -> SurfaceCloud {
        SurfaceCloud::new(&Cloud::new(points).unwrap(), seed, &Progress::silent()).unwrap()
    }

    /// Waves over a square of edge 1, so much higher, with normal noise in all directions.
    fn waves(n: usize, height_m: f64, noise_m: f64, seed: u64) -> Vec<Point> {
        let mut stream = Stream::new(seed, "waves", 0);
        let mut draw = || {
            let (x, y) = (stream.uniform(), stream.uniform());
            let z = height_m + 0.05 * (4.0 * x).sin() * (5.0 * y).cos();
            [x, y, z].map(|v| v + noise_m * stream.normal())
        };
        (0..n).map(|_| draw()).collect()
    }

    /// The pose under which both lie as they were drawn, seen from their centroids.
    fn as_drawn(moving: &SurfaceCloud, fixed: &SurfaceCloud) -> Similarity {
        let identity = Similarity::identity();
        identity.between_local_coordinates(moving.origin, fixed.origin)
    }

    /// The seed draws the points that are looked at.
    fn offset_of_seed_m(moving: &[Point], fixed: &[Point], seed: u64) -> f64 {
        let (moving, fixed) = (surface_cloud(moving, seed), surface_cloud(fixed, seed));
        let pose = as_drawn(&moving, &fixed);
        surface_offset_m(&moving, &fixed, &pose, UNIT_M, &Progress::silent()).unwrap()
    }

    fn offset_m(moving: &[Point], fixed: &[Point]) -> f64 {
        offset_of_seed_m(moving, fixed, 0)
    }

    #[test]
    fn what_lies_apart_shows_through_noise_as_large() {
        const NOISE_M: f64 = 0.006;
        let smooth = waves(30_000, 0.0, 0.0005, 1);
        for (lift_m, at_least_m, at_most_m) in [
            (0.0, 0.0, 0.0008),
            (0.003, 0.0025, 0.0035),
            (0.006, 0.0055, 0.0065),
        ] {
            let noisy = waves(30_000, lift_m, NOISE_M, 2);
            for found_m in [offset_m(&noisy, &smooth), offset_m(&smooth, &noisy)] {
                assert!(
                    (at_least_m..=at_most_m).contains(&found_m),
                    "{lift_m}: {found_m}"
                );
            }
        }
    }

    #[test]
    fn what_the_mean_leaves_of_noise_counts_little() {
        let (few, many) = (waves(8_000, 0.0, 0.009, 1), waves(30_000, 0.0, 0.0005, 2));
        // Nine tenths of the means lie within 0.95 mm.
        let sum_m: f64 = (0..6).map(|seed| offset_of_seed_m(&few, &many, seed)).sum();
        assert!(sum_m / 6.0 < 0.00075, "{sum_m}");
    }

    #[test]
    fn which_points_are_looked_at_matters_little() {
        // Lumps wider than a region, as photogrammetry has them.
        let lumpy: Vec<Point> = waves(30_000, 0.0, 0.004, 1)
            .iter()
            .map(|p| {
                [
                    p[0],
                    p[1],
                    p[2] + 0.004 * (25.0 * p[0]).sin() * (22.0 * p[1]).sin(),
                ]
            })
            .collect();
        // Half of the points stand on a fourth of the area.
        let uneven: Vec<Point> = waves(40_000, 0.0, 0.002, 2)
            .into_iter()
            .enumerate()
            .filter(|(i, p)| p[0] < 0.25 || i % 3 == 0)
            .map(|(_, p)| p)
            .collect();
        let mut found_m: Vec<f64> = (0..8)
            .map(|seed| offset_of_seed_m(&lumpy, &uneven, seed))
            .collect();
        found_m.sort_unstable_by(f64::total_cmp);
        assert!(found_m[7] < 1.2 * found_m[0], "{found_m:?}");
    }

    #[test]
    fn it_is_told_in_the_unit_of_the_fixed_cloud() {
        let (moving, fixed) = (waves(20_000, 0.006, 0.001, 1), waves(20_000, 0.0, 0.001, 2));
        let shrunk: Vec<Point> = moving.iter().map(|p| p.map(|v| v / 1000.0)).collect();
        let (moving, fixed) = (surface_cloud(&shrunk, 0), surface_cloud(&fixed, 0));
        let grown = Similarity {
            scale: 1000.0,
            ..Similarity::identity()
        };
        let pose = grown.between_local_coordinates(moving.origin, fixed.origin);
        let found_m = surface_offset_m(&moving, &fixed, &pose, UNIT_M, &Progress::silent());
        assert!((0.0055..0.0065).contains(&found_m.unwrap()));
    }

    #[test]
    fn where_nothing_is_even_it_is_not_known() {
        let mut stream = Stream::new(1, "canopy", 0);
        let mut canopy = || -> Vec<Point> {
            (0..20_000)
                .map(|_| [0; 3].map(|_| stream.uniform()))
                .collect()
        };
        assert!(offset_m(&canopy(), &canopy()).is_nan());
        // Nor where the clouds do not meet.
        let (here, there) = (waves(5000, 0.0, 0.0, 1), waves(5000, 0.5, 0.0, 2));
        assert!(offset_m(&here, &there).is_nan());
    }
}
