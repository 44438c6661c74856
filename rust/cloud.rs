//! The checked cloud: finite points about a local origin.
//!
//! Why: national grid coordinates (E 500 000, N 4 000 000) leave only nanometres of `f64` precision
//! for squares and products. Every stage works on coordinates relative to an origin inside the
//! cloud; the origin is put back where a pose or a point leaves the crate.
//! Absent on purpose: attributes, colours, files (they belong to the caller).

use crate::error::{Error, Result};
use crate::parallel;
use crate::rank::nth_smallest;

/// A point: x, y, z.
pub type Point = [f64; 3];

/// Largest absolute coordinate accepted: the square of a thousandth of it is still resolved.
pub const MAX_COORDINATE: f64 = 1e12;

/// Fewest points from which a rigid pose can be verified (three fix it, one checks it).
pub const MIN_POINTS: usize = 4;

/// Finite points relative to an origin inside their box.
///
/// ```
/// let cloud = tmchho::Cloud::new(&[
///     [500_000.0, 4_000_000.0, 10.0],
///     [500_001.0, 4_000_000.0, 10.0],
///     [500_000.0, 4_000_002.0, 10.0],
///     [500_000.0, 4_000_000.0, 13.0],
///     [f64::NAN, 0.0, 0.0],
/// ])?;
/// assert_eq!(cloud.len(), 4);
/// assert_eq!(cloud.n_non_finite(), 1);
/// assert!(cloud.points().iter().flatten().all(|v| v.abs() < 3.0));
/// # Ok::<(), tmchho::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Cloud {
    origin: Point,
    points: Vec<Point>,
    /// Index of every kept point in the array given, only where some were dropped.
    given_index: Option<Vec<u32>>,
    n_given: usize,
}

impl Cloud {
    /// Checks `points` and moves them to a local origin; points with a NaN or infinite coordinate
    /// are dropped and counted.
    ///
    /// # Errors
    /// [`Error::TooFewPoints`] below four finite points, [`Error::CoordinateTooLarge`],
    /// [`Error::Degenerate`] where all points coincide or lie on one line or in one plane.
    pub fn new(points: &[Point]) -> Result<Self> {
        Self::named("cloud", points)
    }

    /// Like [`Cloud::new`], with the words that messages use for this cloud ("source cloud").
    ///
    /// # Errors
    /// As [`Cloud::new`].
    pub fn named(what: &str, points: &[Point]) -> Result<Self> {
        let cloud = Self::of_any_shape(what, points)?;
        if cloud.len() < MIN_POINTS {
            return Err(Error::TooFewPoints {
                what: what.into(),
                found: cloud.len(),
                needed: MIN_POINTS,
            });
        }
        if let Some(shape) = degenerate_shape(&cloud.points, &cloud.origin) {
            return Err(Error::Degenerate {
                what: what.into(),
                shape,
            });
        }
        Ok(cloud)
    }

    /// For stages that make sense on any number of points in any arrangement (distances, voxels,
    /// outliers): finite coordinates are still enforced, shape and number are not.
    ///
    /// # Errors
    /// [`Error::CoordinateTooLarge`].
    pub fn of_any_shape(what: &str, points: &[Point]) -> Result<Self> {
        let finite = |p: &Point| p.iter().all(|v| v.is_finite());
        let parts = parallel::map_chunks(points, |part| {
            let n_finite = part.iter().filter(|p| finite(p)).count();
            (n_finite, corners(part.iter().filter(|p| finite(p))))
        });
        let n_finite: usize = parts.iter().map(|(n, _)| n).sum();
        let (low, _) = corners(parts.iter().map(|(_, (low, _))| low));
        let (_, high) = corners(parts.iter().map(|(_, (_, high))| high));
        for value in low.iter().chain(&high).filter(|_| n_finite > 0) {
            if value.abs() > MAX_COORDINATE {
                return Err(Error::CoordinateTooLarge {
                    what: what.into(),
                    value: *value,
                    limit: MAX_COORDINATE,
                });
            }
        }
        let origin = if n_finite == 0 {
            [0.0; 3]
        } else {
            std::array::from_fn(|axis| 0.5 * (low[axis] + high[axis]))
        };
        let local = |p: &Point| std::array::from_fn(|axis| p[axis] - origin[axis]);
        let (points_local, given_index) = if n_finite == points.len() {
            (parallel::map(points.len(), |i| local(&points[i])), None)
        } else {
            let kept = || points.iter().enumerate().filter(|(_, p)| finite(p));
            (
                kept().map(|(_, p)| local(p)).collect(),
                Some(kept().map(|(i, _)| i as u32).collect()),
            )
        };
        Ok(Self {
            origin,
            points: points_local,
            given_index,
            n_given: points.len(),
        })
    }

    /// For measuring to or from: any number of finite points but none.
    ///
    /// # Errors
    /// [`Error::TooFewPoints`], [`Error::CoordinateTooLarge`].
    pub(crate) fn of_some_points(what: &str, points: &[Point]) -> Result<Self> {
        let cloud = Self::of_any_shape(what, points)?;
        if cloud.is_empty() {
            return Err(Error::TooFewPoints {
                what: what.into(),
                found: 0,
                needed: 1,
            });
        }
        Ok(cloud)
    }

    /// A cloud of other local points about the same kind of origin: what a stage hands on.
    pub(crate) fn from_local(origin: Point, points: Vec<Point>) -> Self {
        let n_given = points.len();
        Self {
            origin,
            points,
            given_index: None,
            n_given,
        }
    }

    /// The origin, in the coordinates given: the centre of the box of the finite points.
    pub fn origin(&self) -> Point {
        self.origin
    }

    /// The points, relative to [`Cloud::origin`].
    pub fn points(&self) -> &[Point] {
        &self.points
    }

    /// Number of finite points.
    pub fn len(&self) -> usize {
        self.points.len()
    }

    /// Whether there is no finite point.
    pub fn is_empty(&self) -> bool {
        self.points.is_empty()
    }

    /// Number of points dropped because a coordinate was NaN or infinite.
    pub fn n_non_finite(&self) -> usize {
        self.n_given - self.points.len()
    }

    /// Where point `index` of this cloud stood in the array that was given.
    pub fn given_index(&self, index: usize) -> usize {
        self.given_index
            .as_ref()
            .map_or(index, |given| given[index] as usize)
    }

    /// The points in the coordinates given.
    pub fn to_given_coordinates(&self) -> Vec<Point> {
        self.points
            .iter()
            .map(|p| std::array::from_fn(|axis| p[axis] + self.origin[axis]))
            .collect()
    }

    /// Lower and upper corner of the box, local. Zero for an empty cloud.
    pub fn bounds(&self) -> (Point, Point) {
        bounds(&self.points)
    }

    /// Diagonal of the box.
    pub fn diagonal_m(&self) -> f64 {
        let (low, high) = self.bounds();
        distance_sq(&low, &high).sqrt()
    }

    /// How large the cloud is: about the diagonal of its box, but the same however the cloud is
    /// turned, and not stretched by stray points.
    ///
    /// It is 2.4 times the radius round the middle that holds 99.5 % of the points, which for real
    /// scans is the mean diagonal over all orientations. 0 for an empty cloud.
    pub fn extent_m(&self) -> f64 {
        const HELD: f64 = 0.995;
        const DIAGONAL_BY_RADIUS: f64 = 2.4;
        if self.points.is_empty() {
            return 0.0;
        }
        let rank = ((self.points.len() - 1) as f64 * HELD) as usize;
        let n = self.points.len();
        let radius_sq =
            |centre: &Point| nth_smallest(n, rank, |i| distance_sq(&self.points[i], centre));
        let median = std::array::from_fn(|axis| nth_smallest(n, n / 2, |i| self.points[i][axis]));
        // The median keeps stray points out; the mean of what it holds does not depend on the axes.
        let held_sq = radius_sq(&median);
        let is_held = |p: &&Point| distance_sq(p, &median) <= held_sq;
        let sums = parallel::map_chunks(&self.points, |part| {
            let held = part.iter().filter(is_held);
            held.fold([0.0; 4], |[x, y, z, n], p| {
                [x + p[0], y + p[1], z + p[2], n + 1.0]
            })
        });
        let total = |of: usize| sums.iter().map(|sum| sum[of]).sum::<f64>();
        let mean = std::array::from_fn(|axis| total(axis) / total(3));
        DIAGONAL_BY_RADIUS * radius_sq(&mean).sqrt()
    }

    /// Mean of the points, local.
    pub fn centroid(&self) -> Point {
        centroid(&self.points)
    }
}

/// Lower and upper corner of the box round `points`; zero where there are none.
pub(crate) fn bounds(points: &[Point]) -> (Point, Point) {
    if points.is_empty() {
        return ([0.0; 3], [0.0; 3]);
    }
    let parts = parallel::map_chunks(points, |part| corners(part.iter()));
    let (low, _) = corners(parts.iter().map(|(low, _)| low));
    let (_, high) = corners(parts.iter().map(|(_, high)| high));
    (low, high)
}

/// Lower and upper corner of the box round `points`; at infinity where there are none.
fn corners<'a>(points: impl Iterator<Item = &'a Point>) -> (Point, Point) {
    let mut low = [f64::INFINITY; 3];
    let mut high = [f64::NEG_INFINITY; 3];
    for p in points {
        for axis in 0..3 {
            low[axis] = low[axis].min(p[axis]);
            high[axis] = high[axis].max(p[axis]);
        }
    }
    (low, high)
}

/// Mean of `points`; zero where there are none.
pub(crate) fn centroid(points: &[Point]) -> Point {
    let mut sum = [0.0; 3];
    for p in points {
        for axis in 0..3 {
            sum[axis] += p[axis];
        }
    }
    let n = points.len().max(1) as f64;
    sum.map(|v| v / n)
}

/// Squared distance of two points.
#[inline]
pub(crate) fn distance_sq(a: &Point, b: &Point) -> f64 {
    let d = difference(a, b);
    dot(&d, &d)
}

/// From `b` to `a`.
#[inline]
pub(crate) fn difference(a: &Point, b: &Point) -> Point {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

#[inline]
pub(crate) fn dot(a: &Point, b: &Point) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[inline]
pub(crate) fn cross(a: &Point, b: &Point) -> Point {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

/// Names the shape of a cloud in which no pose is determined, if it has one.
///
/// A cloud counts as thin below a share of its length that no instrument resolves, plus what
/// rounding leaves on a line far from the origin of the coordinates given.
fn degenerate_shape(points: &[Point], origin: &Point) -> Option<&'static str> {
    const RELATIVE_WIDTH: f64 = 1e-9;
    const ROUNDING: f64 = 32.0 * f64::EPSILON;
    let a = points[0];
    let (length_sq, b) = largest(points, |p| distance_sq(&a, p));
    if length_sq == 0.0 {
        return Some("all points are identical");
    }
    let along: Point = std::array::from_fn(|axis| b[axis] - a[axis]);
    let off_line_sq = |p: &Point| {
        let d: Point = std::array::from_fn(|axis| p[axis] - a[axis]);
        let dot = d[0] * along[0] + d[1] * along[1] + d[2] * along[2];
        distance_sq(&d, &along.map(|v| v * dot / length_sq))
    };
    let (widest_sq, c) = largest(points, off_line_sq);
    let farthest_m = origin.iter().fold(0.0_f64, |most, v| most.max(v.abs())) + length_sq.sqrt();
    let threshold_m = RELATIVE_WIDTH * length_sq.sqrt() + ROUNDING * farthest_m;
    let threshold_sq = threshold_m * threshold_m;
    if widest_sq <= threshold_sq {
        return Some("all points lie on one line");
    }
    let across: Point = std::array::from_fn(|axis| c[axis] - a[axis]);
    let normal = [
        along[1] * across[2] - along[2] * across[1],
        along[2] * across[0] - along[0] * across[2],
        along[0] * across[1] - along[1] * across[0],
    ];
    let normal_sq = distance_sq(&normal, &[0.0; 3]);
    let is_off_plane = |p: &Point| {
        let dot: f64 = (0..3).map(|axis| (p[axis] - a[axis]) * normal[axis]).sum();
        dot * dot / normal_sq > threshold_sq
    };
    (!points.iter().any(is_off_plane)).then_some("all points lie in one plane")
}

/// The largest `value` of all `points`, of which there is one at least, and the first point that has it.
fn largest(points: &[Point], value: impl Fn(&Point) -> f64 + Sync + Send) -> (f64, Point) {
    let larger = |best: (f64, Point), other: (f64, Point)| {
        if other.0 > best.0 { other } else { best }
    };
    let none = (f64::NEG_INFINITY, points[0]);
    let of_parts = parallel::map_chunks(points, |part| {
        part.iter().map(|p| (value(p), *p)).fold(none, larger)
    });
    of_parts.into_iter().fold(none, larger)
}

#[cfg(test)]
mod tests {
    use super::*;

    const CORNER: [Point; 4] = [
        [0.0, 0.0, 0.0],
        [1.0, 0.0, 0.0],
        [0.0, 2.0, 0.0],
        [0.0, 0.0, 4.0],
    ];

    #[test]
    fn national_grid_coordinates_lose_nothing() {
        let offset = [500_000.25, 4_000_000.5, 200.125];
        let moved: Vec<Point> = CORNER
            .iter()
            .map(|p| std::array::from_fn(|axis| p[axis] + offset[axis]))
            .collect();
        let (near, far) = (Cloud::new(&CORNER).unwrap(), Cloud::new(&moved).unwrap());
        assert_eq!(near.points(), far.points());
        assert_eq!(far.to_given_coordinates(), moved);
        assert_eq!(far.diagonal_m(), 21.0_f64.sqrt());
    }

    #[test]
    fn dropped_points_are_counted_and_indices_point_into_what_was_given() {
        let mut points = vec![[f64::INFINITY, 0.0, 0.0]];
        points.extend(CORNER);
        points.insert(3, [0.0, f64::NAN, 0.0]);
        let cloud = Cloud::new(&points).unwrap();
        assert_eq!(cloud.n_non_finite(), 2);
        let given: Vec<usize> = (0..4).map(|i| cloud.given_index(i)).collect();
        assert_eq!(given, [1, 2, 4, 5]);
    }

    #[test]
    fn clouds_without_a_pose_are_refused_by_name() {
        let refused = |points: &[Point]| Cloud::new(points).unwrap_err().to_string();
        assert!(refused(&CORNER[..3]).contains("3 usable points"));
        assert!(refused(&[[7.0, 8.0, 9.0]; 10]).contains("identical"));
        let line: Vec<Point> = (0..10)
            .map(|i| {
                [
                    500_000.0 + 0.1 * f64::from(i),
                    4e6 + 0.3 * f64::from(i),
                    1.0,
                ]
            })
            .collect();
        assert!(refused(&line).contains("one line"));
        let plane: Vec<Point> = (0..50)
            .map(|i| (f64::from(i % 7), f64::from(i / 7)))
            .map(|(u, v)| [500_000.0 + u, 4e6 + v, 0.1 * u - 0.3 * v])
            .collect();
        assert!(refused(&plane).contains("one plane"));
        let huge = [CORNER[0], CORNER[1], CORNER[2], [0.0, 0.0, 1e300]];
        assert!(refused(&huge).contains("1e300"));
    }

    #[test]
    fn the_extent_is_the_same_however_the_cloud_is_turned_and_ignores_stray_points() {
        let mut sheet: Vec<Point> = (0..10_000)
            .map(|i| [f64::from(i % 100), f64::from(i / 100), 0.0])
            .collect();
        let extent = |points: &[Point]| Cloud::of_any_shape("cloud", points).unwrap().extent_m();
        let flat = extent(&sheet);
        // Half a diagonal of 99·√2, but for the outermost half per cent, times 2.4.
        assert!(
            (flat / (2.4 * 0.5 * 99.0 * 2.0_f64.sqrt()) - 1.0).abs() < 0.06,
            "{flat}"
        );
        let pose = crate::Rigid::from_euler([0.4, 0.7, -1.0], [5.0, 6.0, 7.0]);
        let turned: Vec<Point> = sheet.iter().map(|p| pose.apply(p)).collect();
        assert!((extent(&turned) / flat - 1.0).abs() < 0.01);
        sheet.push([1e9, 0.0, 0.0]);
        assert!((extent(&sheet) / flat - 1.0).abs() < 0.01);
    }

    #[test]
    fn an_empty_cloud_of_any_shape_is_harmless() {
        let cloud = Cloud::of_any_shape("cloud", &[]).unwrap();
        assert!(cloud.is_empty());
        assert_eq!(cloud.diagonal_m(), 0.0);
        assert_eq!(cloud.centroid(), [0.0; 3]);
    }
}
