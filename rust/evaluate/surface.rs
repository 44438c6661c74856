//! Distances to the surface between the points of a cloud, unsigned or signed.
//!
//! Why: the nearest point of a sparse cloud lies half a spacing to the side. Its distance tells of the
//! spacing; the distance to a plane through the points round it tells of the surface.
//! Source: the local least squares plane of CloudCompare's cloud-to-cloud distances, with its rule
//! that a model never makes a distance larger; heights over a plane z = a + bx + cy as in a DEM of
//! difference.  Deviates: a plane is not extended beyond the points it was fitted to.
//! Absent on purpose: meshes; sides in and out, which a cloud does not know: up is positive.

use crate::cloud::{Point, centroid, distance_sq};
use crate::error::{Result, require_at_least};
use crate::neighbors::{Neighbor, NeighborIndex, Places, map_places};
use crate::normals::Symmetric;
use crate::progress::Progress;

/// Three points span a plane.
const LEAST_POINTS: usize = 3;

/// A surface steeper than this (80°) has no height that means anything.
const MAX_SLOPE: f64 = 5.671_281_819_617_709;

/// What is measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum DistanceMethod {
    /// To the nearest point.
    #[default]
    Nearest,
    /// To the plane through the points round the nearest one; to that point itself where this is
    /// nearer, or where the plane ends.
    Plane,
    /// The same along the upward normal of the plane: positive above, NaN where the plane ends.
    Normal,
    /// Along z, to the plane through the points nearest in plan: positive above, NaN where it ends
    /// or is steeper than 80°.
    Vertical,
}

/// The distance from each of `from` to the surface of `to`, in metres, in their order. A plane goes
/// through `n_neighbors` points.
///
/// ```
/// use tmchho::{evaluate::{DistanceMethod, surface_distances}, neighbors::NeighborIndex};
/// let floor: Vec<[f64; 3]> = (0..25).map(|i| [f64::from(i % 5), f64::from(i / 5), 7.0]).collect();
/// let floor = NeighborIndex::new(&floor);
/// let place = [[2.5, 2.5, 6.0]];
/// let silent = tmchho::progress::Progress::silent();
/// let to = |method| surface_distances(&place, &floor, method, 9, &silent);
/// assert_eq!(to(DistanceMethod::Nearest)?, [1.5_f64.sqrt()]);
/// assert_eq!(to(DistanceMethod::Plane)?, [1.0]);
/// assert_eq!(to(DistanceMethod::Vertical)?, [-1.0]);
/// # Ok::<(), tmchho::Error>(())
/// ```
///
/// # Errors
/// [`Error::InvalidArgument`](crate::Error::InvalidArgument) where `n_neighbors` is below three, and
/// as [`NeighborIndex::nearest_all`].
pub fn surface_distances(
    from: &[Point],
    to: &NeighborIndex,
    method: DistanceMethod,
    n_neighbors: usize,
    progress: &Progress<'_>,
) -> Result<Vec<f64>> {
    require_at_least("n_neighbors", n_neighbors, LEAST_POINTS)?;
    if method == DistanceMethod::Vertical {
        let plan: Vec<Point> = to.points().iter().map(|p| [p[0], p[1], 0.0]).collect();
        let plan = NeighborIndex::new(&plan);
        let buffers = || (Vec::new(), Vec::new());
        return map_places(from, progress, buffers, |(found, round), i| {
            let p = &from[i];
            plan.k_nearest(&[p[0], p[1], 0.0], n_neighbors, found);
            points_of(found, to, round);
            height_above(p, round)
        });
    }
    if method == DistanceMethod::Nearest {
        return to.distances_to(&Places::new(from), progress);
    }
    let nearest = to.nearest_all(from, progress)?;
    let buffers = || (Vec::new(), Vec::new());
    map_places(from, progress, buffers, |(found, round), i| {
        let foot = &to.points()[nearest[i].index as usize];
        to.k_nearest(foot, n_neighbors, found);
        points_of(found, to, round);
        let signed = above_plane(&from[i], round);
        if method == DistanceMethod::Normal {
            return signed;
        }
        signed.abs().min(nearest[i].distance_sq.sqrt()) // of NaN and a number, the number
    })
}

fn points_of(found: &[Neighbor], to: &NeighborIndex, round: &mut Vec<Point>) {
    round.clear();
    round.extend(found.iter().map(|n| to.points()[n.index as usize]));
}

/// How far `place` lies above the plane of least squares through `points`; NaN where they span none
/// or its foot lies beyond them.
fn above_plane(place: &Point, points: &[Point]) -> f64 {
    /// Points whose width is a millionth of their length lie on a line.
    const LINE: f64 = 1e-12;
    if points.len() < LEAST_POINTS {
        return f64::NAN;
    }
    let centre = centroid(points);
    let (mut scatter, mut reach_sq) = (Symmetric::default(), 0.0_f64);
    for p in points {
        scatter.add(std::array::from_fn(|axis| p[axis] - centre[axis]), 1.0);
        reach_sq = reach_sq.max(distance_sq(p, &centre));
    }
    let (lambda, vectors) = scatter.eigen();
    if lambda[1] <= LINE * lambda[0] {
        return f64::NAN;
    }
    let normal = upward(vectors[2]);
    let distance = (0..3)
        .map(|axis| normal[axis] * (place[axis] - centre[axis]))
        .sum::<f64>();
    let beside_sq = distance_sq(place, &centre) - distance * distance;
    if beside_sq > reach_sq {
        f64::NAN
    } else {
        distance
    }
}

/// Turned so that z is positive; of a level one x, then y.
fn upward(normal: Point) -> Point {
    let leading = [normal[2], normal[0], normal[1]]
        .into_iter()
        .find(|v| *v != 0.0);
    if leading.is_some_and(|v| v < 0.0) {
        normal.map(|v| -v)
    } else {
        normal
    }
}

/// How far `place` lies above the plane z = a + bx + cy of least squares through `points`; NaN where
/// there is none, it is too steep, or the place lies beyond them in plan.
fn height_above(place: &Point, points: &[Point]) -> f64 {
    if points.len() < LEAST_POINTS {
        return f64::NAN;
    }
    let centre = centroid(points);
    let [mut xx, mut xy, mut yy, mut xz, mut yz, mut reach_sq] = [0.0_f64; 6];
    for p in points {
        let [x, y, z] = std::array::from_fn(|axis| p[axis] - centre[axis]);
        (xx, xy, yy) = (xx + x * x, xy + x * y, yy + y * y);
        (xz, yz) = (xz + x * z, yz + y * z);
        reach_sq = reach_sq.max(x * x + y * y);
    }
    let determinant = xx * yy - xy * xy;
    if determinant <= 1e-12 * (xx + yy) * (xx + yy) {
        return f64::NAN;
    }
    let east = (xz * yy - yz * xy) / determinant;
    let north = (yz * xx - xz * xy) / determinant;
    let [x, y, z] = std::array::from_fn(|axis| place[axis] - centre[axis]);
    if x * x + y * y > reach_sq || east.hypot(north) > MAX_SLOPE {
        return f64::NAN;
    }
    z - east * x - north * y
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Stream;

    const SLOPE: [f64; 2] = [0.3, -0.2];

    /// A grid of 30 by 30, each point shaken by a third of the spacing.
    fn slope(stream: &mut Stream) -> Vec<Point> {
        (0..900)
            .map(|i| {
                let mut at = |cell: i32| 0.3 * f64::from(cell) + 0.1 * stream.uniform();
                let (x, y) = (at(i % 30), at(i / 30));
                [x, y, 4.0 + SLOPE[0] * x + SLOPE[1] * y]
            })
            .collect()
    }

    fn measured(from: &[Point], to: &[Point], method: DistanceMethod) -> Vec<f64> {
        let silent = Progress::silent();
        surface_distances(from, &NeighborIndex::new(to), method, 12, &silent).unwrap()
    }

    #[test]
    fn a_slope_lifted_by_a_known_height() {
        let mut stream = Stream::new(1, "surface", 0);
        let to = slope(&mut stream);
        let from: Vec<Point> = slope(&mut stream)
            .iter()
            .map(|p| std::array::from_fn(|axis| 4.5 + 0.8 * (p[axis] - 4.5)))
            .map(|p: Point| [p[0], p[1], 4.0 + SLOPE[0] * p[0] + SLOPE[1] * p[1] - 0.35])
            .collect();
        let across = 0.35 / (1.0_f64 + 0.3 * 0.3 + 0.2 * 0.2).sqrt();
        for (method, wanted) in [
            (DistanceMethod::Plane, across),
            (DistanceMethod::Normal, -across),
            (DistanceMethod::Vertical, -0.35),
        ] {
            for got in measured(&from, &to, method) {
                assert!((got - wanted).abs() < 1e-9, "{method:?}: {got}");
            }
        }
        let nearest = measured(&from, &to, DistanceMethod::Nearest);
        assert!(nearest.iter().all(|d| *d >= across));
    }

    #[test]
    fn a_plane_ends_where_its_points_end() {
        let mut stream = Stream::new(2, "surface", 0);
        let to = slope(&mut stream);
        let beyond = [[14.0, 4.0, 4.0 + 0.3 * 14.0 - 0.2 * 4.0 + 0.1]];
        assert!(measured(&beyond, &to, DistanceMethod::Normal)[0].is_nan());
        assert!(measured(&beyond, &to, DistanceMethod::Vertical)[0].is_nan());
        let nearest = measured(&beyond, &to, DistanceMethod::Nearest);
        assert!(nearest[0] > 4.0);
        assert_eq!(measured(&beyond, &to, DistanceMethod::Plane), nearest);
    }

    #[test]
    fn walls_have_no_height_and_lines_no_plane() {
        let wall: Vec<Point> = (0..100)
            .map(|i| [f64::from(i % 10), 0.0, f64::from(i / 10)])
            .collect();
        let before = [[4.5, 0.3, 4.5]];
        assert!(measured(&before, &wall, DistanceMethod::Vertical)[0].is_nan());
        assert!((measured(&before, &wall, DistanceMethod::Normal)[0] - 0.3).abs() < 1e-12);
        let line: Vec<Point> = (0..20).map(|i| [f64::from(i), 0.0, 0.0]).collect();
        assert_eq!(
            measured(&[[3.0, 2.0, 0.0]], &line, DistanceMethod::Plane),
            [2.0]
        );
        for method in [DistanceMethod::Normal, DistanceMethod::Vertical] {
            assert!(measured(&[[3.0, 2.0, 0.0]], &line, method)[0].is_nan());
            assert!(measured(&[[0.0; 3]], &line[..2], method)[0].is_nan());
        }
    }

    #[test]
    fn normals_point_up() {
        assert_eq!(upward([0.1, 0.2, -0.9]), [-0.1, -0.2, 0.9]);
        assert_eq!(upward([-1.0, 0.0, 0.0]), [1.0, 0.0, 0.0]);
        assert_eq!(upward([0.0, -1.0, 0.0]), [0.0, 1.0, 0.0]);
    }

    #[test]
    fn too_few_neighbours_are_refused() {
        let to = NeighborIndex::new(&[[0.0; 3]]);
        let silent = Progress::silent();
        assert!(surface_distances(&[], &to, DistanceMethod::Plane, 2, &silent).is_err());
    }
}
