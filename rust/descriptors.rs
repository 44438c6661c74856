//! What the surface round a point looks like, in numbers that do not depend on the pose.
//!
//! Why: where two clouds share little, no descent from a blind start leads to the pose; points
//! whose surroundings look alike propose it.
//! Source: fast point feature histograms (Rusu, Blodow & Beetz 2009). Deviates: normals have no
//! sign, so each is turned to the side to which the surface bends, and neighbours' normals to the
//! same side; histograms are compared by Hellinger's distance.
//! Absent on purpose: keypoints; every point of a thinned cloud is described.

use crate::cloud::{Point, cross, difference, dot};
use crate::error::Result;
use crate::neighbors::{NeighborIndex, Places};
use crate::normals;
use crate::progress::Progress;
use crate::surface_cloud::SurfaceCloud;

/// Bins for each of the three angles.
const BINS: usize = 11;
/// Three histograms.
const LENGTH: usize = 3 * BINS;

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
    /// Describes `points`, some of `cloud`, by those of them within `radius_m` of each; normals come from the points of
    /// the cloud within `normal_radius_m`. Points without a normal are left out.
    ///
    /// # Errors
    /// [`crate::Error::InvalidArgument`] for lengths that are not above 0,
    /// [`crate::Error::Cancelled`].
    pub fn new(
        cloud: &SurfaceCloud,
        points: &[Point],
        normal_radius_m: f64,
        radius_m: f64,
        progress: &Progress<'_>,
    ) -> Result<Self> {
        // In the order of places: what is described together lies together.
        let thinned = Places::new(points);
        let thinned: Vec<Point> = (0..thinned.len()).map(|at| *thinned.point(at)).collect();
        let surfaces =
            normals::estimate_within(&thinned, &cloud.index, normal_radius_m, 3, progress)?;
        let (points, unsigned): (Vec<Point>, Vec<Point>) = thinned
            .iter()
            .zip(&surfaces)
            .filter(|(_, surface)| surface.normal != [0.0; 3])
            .map(|(p, surface)| (*p, surface.normal))
            .unzip();
        let index = NeighborIndex::new(&points);
        let places = index.places();
        // Neighbours are sought twice: that costs less than to keep them.
        let simple = index.map_indices_within(&places, radius_m, progress, |i, around| {
            let normal = towards(unsigned[i], &way_to_middle(&points[i], around, &points));
            let simple = simple_histogram(&points[i], &normal, around, &points, &unsigned);
            (normal, simple)
        })?;
        let descriptors = index.map_indices_within(&places, radius_m, progress, |i, around| {
            blended(i, &points, around, |j| &simple[j].1)
        })?;
        Ok(Self {
            normals: simple.iter().map(|(normal, _)| *normal).collect(),
            points,
            descriptors,
        })
    }

    /// The `share` of the points, 0 to 1, whose descriptors are least like the mean of all, in their order.
    ///
    /// What looks like most of a cloud tells no place in it (the persistent features of Rusu, Blodow & Beetz 2009,
    /// who draw the line at deviations from the mean).
    pub fn least_usual(&self, share: f64) -> Self {
        let mut mean = [0.0_f32; LENGTH];
        for descriptor in &self.descriptors {
            for (sum, v) in mean.iter_mut().zip(descriptor) {
                *sum += v;
            }
        }
        let likeness = |descriptor: &Descriptor| -> f32 {
            descriptor.iter().zip(&mean).map(|(a, b)| a * b).sum()
        };
        let likenesses = self.descriptors.iter().map(likeness);
        let mut order: Vec<(f32, usize)> = likenesses.zip(0..).collect();
        order.sort_by(|a, b| a.0.total_cmp(&b.0));
        order.truncate((share * self.len() as f64).ceil() as usize);
        let mut kept: Vec<usize> = order.into_iter().map(|(_, i)| i).collect();
        kept.sort_unstable();
        Self {
            points: kept.iter().map(|i| self.points[*i]).collect(),
            normals: kept.iter().map(|i| self.normals[*i]).collect(),
            descriptors: kept.iter().map(|i| self.descriptors[*i]).collect(),
        }
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

/// Descriptors that are compared at once.
pub const SOME: usize = 16;

/// A few descriptors side by side, bin by bin.
#[derive(Debug, Clone, Copy)]
pub struct SomeDescriptors([[f32; SOME]; LENGTH]);

impl SomeDescriptors {
    /// The first [`SOME`] of `descriptors`; where there are fewer, the others are zeros.
    pub fn new(descriptors: &[Descriptor]) -> Self {
        let of = |lane: usize, bin: usize| descriptors.get(lane).map_or(0.0, |d| d[bin]);
        Self(std::array::from_fn(|bin| {
            std::array::from_fn(|lane| of(lane, bin))
        }))
    }

    /// The product of `other` with each of them: 1 alike, 0 nothing in common.
    #[inline(always)]
    pub fn similarities(&self, other: &Descriptor) -> [f32; SOME] {
        let mut sums = [0.0; SOME];
        for (bins, theirs) in self.0.iter().zip(other) {
            for lane in 0..SOME {
                sums[lane] += bins[lane] * theirs;
            }
        }
        sums
    }
}

/// From `p` to the middle of what stands round it.
fn way_to_middle(p: &Point, around: &[u32], points: &[Point]) -> Point {
    let mut sum = [0.0; 3];
    for &j in around {
        for axis in 0..3 {
            sum[axis] += points[j as usize][axis] - p[axis];
        }
    }
    sum
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
        for (which, value) in [tilt, rise].into_iter().enumerate() {
            let bin = ((value + 1.0) * 0.5 * BINS as f64) as u32 as usize;
            histogram[which * BINS + bin.min(BINS - 1)] += 1.0;
        }
        histogram[2 * BINS + bin_of_turn(dot(&w, &other), dot(normal, &other))] += 1.0;
    }
    let n = histogram[..BINS].iter().sum::<f32>().max(1.0);
    histogram.map(|v| v / n)
}

/// The bin of the angle with that sine and cosine, by a common factor; the cosine is not below 0. Of the bins
/// over all angles only the middle seven are reached.
fn bin_of_turn(sine: f64, cosine: f64) -> usize {
    const FIRST: usize = (BINS - 7) / 2;
    /// Sine and cosine of π/11, 3π/11 and 5π/11, where one bin ends and another begins.
    const BORDERS: [[f64; 2]; 3] = [
        [0.281_732_556_841_429_67, 0.959_492_973_614_497_4],
        [0.755_749_574_354_258_3, 0.654_860_733_945_285_1],
        [0.989_821_441_880_932_7, 0.142_314_838_273_285_14],
    ];
    let is_beyond = |of: bool| usize::from(of);
    let beyond = BORDERS
        .map(|[s, c]| is_beyond(sine * c >= cosine * s) + is_beyond(sine * c >= -cosine * s));
    FIRST + beyond.iter().sum::<usize>()
}

/// A point's own histogram and those of its neighbours, the nearer the heavier.
fn blended<'a>(
    i: usize,
    points: &[Point],
    neighbors: &[u32],
    simple: impl Fn(usize) -> &'a Descriptor,
) -> Descriptor {
    let own = simple(i);
    let mut around = [0.0_f32; LENGTH];
    let mut weights = 0.0;
    for &j in neighbors {
        let way = difference(&points[j as usize], &points[i]);
        let distance = dot(&way, &way).sqrt();
        if distance > 0.0 {
            let weight = (1.0 / distance) as f32;
            weights += weight;
            let theirs = simple(j as usize);
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
        let bumpy = bumpy(pose);
        let thinned = bumpy.one_for_each_cell(0.03);
        Described::new(&bumpy, &thinned, 0.04, 0.12, &Progress::silent()).unwrap()
    }

    fn product(a: &Descriptor, b: &Descriptor) -> f32 {
        a.iter().zip(b).map(|(a, b)| a * b).sum()
    }

    #[test]
    fn some_are_compared_as_one_by_one() {
        let descriptors = described(&Rigid::identity()).descriptors;
        let (some, few) = (&descriptors[..SOME], &descriptors[..5]);
        let one = &descriptors[40];
        let expected: Vec<f32> = some.iter().map(|other| product(one, other)).collect();
        assert_eq!(
            SomeDescriptors::new(some).similarities(one).as_slice(),
            expected
        );
        let found = SomeDescriptors::new(few).similarities(one);
        assert_eq!(
            (&found[..5], &found[5..]),
            (&expected[..5], &[0.0; SOME - 5][..])
        );
    }

    #[test]
    fn the_bin_of_a_turn_is_that_of_its_angle() {
        for i in 0..500 {
            let turn = f64::from(i) / 499.0 - 0.5;
            let (sine, cosine) = (turn * std::f64::consts::PI).sin_cos();
            let bin = ((turn + 1.0) * 0.5 * BINS as f64) as usize;
            assert_eq!(bin_of_turn(3.0 * sine, 3.0 * cosine), bin, "{turn}");
        }
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
            let look = |j: usize| product(&still.descriptors[i], &turned.descriptors[j]);
            alike.push(look(same.index as usize));
            unlike.push(look((same.index as usize + 311) % turned.len()));
        }
        let mean = |values: &[f32]| values.iter().sum::<f32>() / values.len() as f32;
        assert!(alike.len() > 100, "{}", alike.len());
        assert!(mean(&alike) > 0.95, "{}", mean(&alike));
        assert!(mean(&alike) - mean(&unlike) > 0.05, "{}", mean(&unlike));
    }

    #[test]
    fn what_is_least_usual_stands_out_of_level_ground() {
        // Rough ground of 2 × 1, with waves on the last 0.6.
        let mut stream = Stream::new(4, "ground", 0);
        let points: Vec<Point> = (0..12_000)
            .map(|_| {
                [
                    2.0 * stream.uniform(),
                    stream.uniform(),
                    0.002 * stream.normal(),
                ]
            })
            .map(|[x, y, z]| {
                let height = if x > 1.4 {
                    0.06 * (16.0 * x).sin() * (14.0 * y).cos()
                } else {
                    0.0
                };
                [x, y, z + height]
            })
            .collect();
        let cloud = Cloud::of_any_shape("ground", &points).unwrap();
        let cloud = SurfaceCloud::new(&cloud, 0, &Progress::silent()).unwrap();
        let thinned = cloud.one_for_each_cell(0.03);
        let silent = Progress::silent();
        let all = Described::new(&cloud, &thinned, 0.04, 0.12, &silent).unwrap();
        let (n, of_each): (usize, Vec<(Point, Descriptor)>) = {
            let pairs = all
                .points
                .iter()
                .copied()
                .zip(all.descriptors.iter().copied());
            (all.len(), pairs.collect())
        };
        let least_usual = all.least_usual(0.3);
        assert_eq!(least_usual.len(), (0.3 * n as f64).ceil() as usize);
        let is_wavy = |p: &&Point| p[0] + cloud.origin[0] > 1.3;
        let n_wavy = least_usual.points.iter().filter(is_wavy).count();
        assert!(n_wavy as f64 > 0.8 * least_usual.len() as f64, "{n_wavy}");
        // They keep their order and what was said of them.
        let mut rest = of_each.iter();
        for (p, descriptor) in least_usual.points.iter().zip(&least_usual.descriptors) {
            assert!(rest.any(|other| other == &(*p, *descriptor)));
        }
    }

    #[test]
    fn descriptors_have_length_one_and_normals_point_to_the_hollow_side() {
        let found = described(&Rigid::identity());
        for descriptor in &found.descriptors {
            assert!((product(descriptor, descriptor) - 1.0).abs() < 1e-5);
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
        let thinned = cloud.one_for_each_cell(0.1);
        let bowl = Described::new(&cloud, &thinned, 0.15, 0.3, &Progress::silent()).unwrap();
        let inside = bowl
            .points
            .iter()
            .zip(&bowl.normals)
            .filter(|(p, _)| p[0].hypot(p[1]) < 0.6);
        assert!(inside.clone().count() > 50);
        assert!(inside.clone().all(|(_, normal)| normal[2] > 0.0));
    }
}
