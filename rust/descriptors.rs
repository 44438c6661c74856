//! What the surface round a point looks like, in numbers that do not depend on the pose.
//!
//! Why: where two clouds share little, no descent from a blind start leads to the pose; points
//! whose surroundings look alike propose it.
//! Source: fast point feature histograms (Rusu, Blodow & Beetz 2009). Deviates: normals have no
//! sign, so each is turned to the side to which the surface bends, and neighbours' normals to the
//! same side; histograms are compared by Hellinger's distance.
//! Absent on purpose: keypoints; every point of a thinned cloud is described.

use crate::cloud::{Point, centroid, cross, difference, dot};
use crate::error::Result;
use crate::neighbors::{Neighbor, NeighborIndex};
use crate::normals;
use crate::parallel;
use crate::progress::Progress;
use crate::surface_cloud::SurfaceCloud;

/// Bins for each of the three angles.
const BINS: usize = 11;
/// Three histograms, and zeros up to a multiple of four.
const LENGTH: usize = 36;

/// Square roots of the shares of three histograms, of length 1: the product of two is 1 where the
/// surroundings are alike.
pub type Descriptor = [f32; LENGTH];

/// A thinned cloud whose points are described.
#[derive(Debug)]
pub struct Described {
    /// Points about the origin of the cloud that was described.
    pub points: Vec<Point>,
    /// Unit normals, turned to the side to which the surface bends.
    pub normals: Vec<Point>,
    /// One for each point.
    pub descriptors: Vec<Descriptor>,
}

impl Described {
    /// Describes one point of `cloud` for each cell of edge `voxel_m`, by what lies within `radius_m` of
    /// each point; normals come from within `normal_radius_m`. Points without a normal are left
    /// out.
    ///
    /// # Errors
    /// [`crate::Error::InvalidArgument`] for lengths that are not above 0,
    /// [`crate::Error::Cancelled`].
    pub fn new(
        cloud: &SurfaceCloud,
        voxel_m: f64,
        normal_radius_m: f64,
        radius_m: f64,
        progress: &Progress<'_>,
    ) -> Result<Self> {
        let thinned = cloud.one_for_each_cell(voxel_m);
        let surfaces =
            normals::estimate_within(&thinned, &cloud.index, normal_radius_m, 3, progress)?;
        let (points, unsigned): (Vec<Point>, Vec<Point>) = thinned
            .iter()
            .zip(&surfaces)
            .filter(|(_, surface)| surface.normal != [0.0; 3])
            .map(|(p, surface)| (*p, surface.normal))
            .unzip();
        let index = NeighborIndex::new(&points);
        let found = parallel::map_cheap(points.len(), progress, |i| {
            let mut found: Vec<Neighbor> = Vec::new();
            index.within(&points[i], radius_m, &mut found);
            let neighbors: Vec<u32> = found
                .iter()
                .map(|n| n.index)
                .filter(|n| *n as usize != i)
                .collect();
            let around: Vec<Point> = found.iter().map(|n| points[n.index as usize]).collect();
            let normal = towards(unsigned[i], &difference(&centroid(&around), &points[i]));
            let simple = simple_histogram(&points[i], &normal, &neighbors, &points, &unsigned);
            (neighbors, normal, simple)
        })?;
        let descriptors = parallel::map_cheap(points.len(), progress, |i| {
            blended(i, &points, |j| (&found[j].0, &found[j].2))
        })?;
        Ok(Self {
            normals: found.iter().map(|(_, normal, _)| *normal).collect(),
            points,
            descriptors,
        })
    }

    /// Number of described points.
    pub fn len(&self) -> usize {
        self.points.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.points.is_empty()
    }
}

/// The product of two descriptors: 1 alike, 0 nothing in common.
#[inline]
pub fn similarity(a: &Descriptor, b: &Descriptor) -> f32 {
    let mut sums = [0.0_f32; 4];
    for (a, b) in a.as_chunks::<4>().0.iter().zip(b.as_chunks::<4>().0) {
        for lane in 0..4 {
            sums[lane] += a[lane] * b[lane];
        }
    }
    (sums[0] + sums[1]) + (sums[2] + sums[3])
}

/// The angles between the normal at `p`, those of its neighbours, and the way there.
fn simple_histogram(
    p: &Point,
    normal: &Point,
    neighbors: &[u32],
    points: &[Point],
    unsigned: &[Point],
) -> Descriptor {
    let mut histogram = [0.0; LENGTH];
    for &j in neighbors {
        let way = difference(&points[j as usize], p);
        let length = dot(&way, &way).sqrt();
        let way = way.map(|v| v / length);
        let across = cross(&way, normal);
        let width = dot(&across, &across).sqrt();
        // Neighbours straight above or below tell no direction; copies of the point none at all.
        if width.is_nan() || width <= 1e-9 {
            continue;
        }
        let v = across.map(|x| x / width);
        let w = cross(normal, &v);
        let other = towards(unsigned[j as usize], normal);
        let tilt = dot(&v, &other);
        let rise = dot(normal, &way);
        let turn = dot(&w, &other).atan2(dot(normal, &other)) / std::f64::consts::PI;
        for (which, value) in [tilt, rise, turn].into_iter().enumerate() {
            let bin = ((value + 1.0) * 0.5 * BINS as f64) as usize;
            histogram[which * BINS + bin.min(BINS - 1)] += 1.0;
        }
    }
    let n = histogram[..BINS].iter().sum::<f32>().max(1.0);
    histogram.map(|v| v / n)
}

/// A point's own histogram and those of its neighbours, the nearer the heavier.
fn blended<'a>(
    i: usize,
    points: &[Point],
    of: impl Fn(usize) -> (&'a Vec<u32>, &'a Descriptor),
) -> Descriptor {
    let (neighbors, own) = of(i);
    let mut around = [0.0_f32; LENGTH];
    let mut weights = 0.0;
    for &j in neighbors {
        let way = difference(&points[j as usize], &points[i]);
        let distance = dot(&way, &way).sqrt();
        if distance > 0.0 {
            let weight = (1.0 / distance) as f32;
            weights += weight;
            let theirs = of(j as usize).1;
            for bin in 0..LENGTH {
                around[bin] += weight * theirs[bin];
            }
        }
    }
    let scale = if weights > 0.0 { 1.0 / weights } else { 0.0 };
    let mut blend: Descriptor = std::array::from_fn(|bin| own[bin] + scale * around[bin]);
    let total = blend.iter().sum::<f32>();
    if total > 0.0 {
        blend = blend.map(|v| (v / total).sqrt());
    }
    blend
}

/// `normal`, or its opposite, whichever points more along `way`.
fn towards(normal: Point, way: &Point) -> Point {
    if dot(&normal, way) < 0.0 {
        normal.map(|v| -v)
    } else {
        normal
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cloud::Cloud;
    use crate::random::Stream;
    use crate::rigid::Rigid;

    fn bumpy(pose: &Rigid) -> SurfaceCloud {
        let mut stream = Stream::new(3, "bumpy", 0);
        let points: Vec<Point> = (0..6000)
            .map(|_| [stream.uniform(), stream.uniform()])
            .map(|[x, y]| {
                [
                    x,
                    y,
                    0.2 * (9.0 * x).sin() * (7.0 * y).cos() + 0.1 * (20.0 * x * y).sin(),
                ]
            })
            .map(|p| pose.apply(&p))
            .collect();
        let cloud = Cloud::of_any_shape("cloud", &points).unwrap();
        SurfaceCloud::new(&cloud, 0, &Progress::silent()).unwrap()
    }

    fn described(pose: &Rigid) -> Described {
        Described::new(&bumpy(pose), 0.03, 0.04, 0.12, &Progress::silent()).unwrap()
    }

    #[test]
    fn a_place_looks_the_same_however_the_cloud_is_turned_and_unlike_other_places() {
        let turn = Rigid::from_euler([0.4, -1.0, 2.0], [30.0, -4.0, 2.0]);
        let (still, turned) = (described(&Rigid::identity()), described(&turn));
        let origin = |pose: &Rigid| bumpy(pose).origin;
        let there = turn.between_local_coordinates(origin(&Rigid::identity()), origin(&turn));
        let index = NeighborIndex::new(&turned.points);
        let (mut alike, mut unlike) = (Vec::new(), Vec::new());
        for i in 0..still.len() {
            let place = there.apply(&still.points[i]);
            let Some(same) = index.nearest_within(&place, 0.01_f64.powi(2)) else {
                continue;
            };
            let look = |j: usize| similarity(&still.descriptors[i], &turned.descriptors[j]);
            alike.push(look(same.index as usize));
            unlike.push(look((same.index as usize + 311) % turned.len()));
        }
        let mean = |values: &[f32]| values.iter().sum::<f32>() / values.len() as f32;
        assert!(alike.len() > 100, "{}", alike.len());
        assert!(mean(&alike) > 0.95, "{}", mean(&alike));
        assert!(mean(&alike) - mean(&unlike) > 0.05, "{}", mean(&unlike));
    }

    #[test]
    fn descriptors_have_length_one_and_normals_point_to_the_hollow_side() {
        let found = described(&Rigid::identity());
        for descriptor in &found.descriptors {
            assert!((similarity(descriptor, descriptor) - 1.0).abs() < 1e-5);
        }
        // On a bowl that opens upwards every normal points up.
        let bowl: Vec<Point> = (0..2500)
            .map(|i| {
                [
                    f64::from(i % 50) / 25.0 - 1.0,
                    f64::from(i / 50) / 25.0 - 1.0,
                ]
            })
            .map(|[x, y]| [x, y, 0.5 * (x * x + y * y)])
            .collect();
        let cloud = Cloud::of_any_shape("bowl", &bowl).unwrap();
        let cloud = SurfaceCloud::new(&cloud, 0, &Progress::silent()).unwrap();
        let bowl = Described::new(&cloud, 0.1, 0.15, 0.3, &Progress::silent()).unwrap();
        let inside = bowl
            .points
            .iter()
            .zip(&bowl.normals)
            .filter(|(p, _)| p[0].hypot(p[1]) < 0.6);
        assert!(inside.clone().count() > 50);
        assert!(inside.clone().all(|(_, normal)| normal[2] > 0.0));
    }
}
