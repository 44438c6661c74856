//! The area of a surface that is known by points.
//!
//! Why: "37 m² of the crest were filled" says more than a number of points does.
//! Reads: points in any number of parts.  Leaves: an area.
//! Source: integral geometry (Cauchy, Crofton): a plane with the unit normal n, laid anywhere across
//! a grid of cubes of edge e, meets (|nx| + |ny| + |nz|) / e² of them per unit of its area; so each
//! cube that is met stands for e² / (|nx| + |ny| + |nz|).  Deviates: nowhere.
//! Accuracy: about a tenth, on the low side: a cube that the surface cuts at a corner may hold no point.
//! Absent on purpose: meshes; loops over the table, whose order nobody can foretell.

use std::collections::HashMap;

use nalgebra::{Matrix3, SymmetricEigen};

use crate::cloud::Point;
use crate::error::{Error, Result, require_positive};
use crate::parallel;
use crate::rigid::Rigid;

/// Fewest points in a cube from which its normal is taken; others get the mean of those.
const LEAST_POINTS: f64 = 6.0;
/// More cubes are not kept: their edge is doubled instead.
const MAX_CUBES: usize = 1 << 18;
/// By which the grid is turned against the axes of the points. What people build is level and square:
/// a floor of 1 cm of noise in a plane of the grid would be met twice.
const TURN_RAD: [f64; 3] = [0.5, 0.9, 0.3];
/// The mean of |nx| + |ny| + |nz| over all directions, where no cube has enough points.
const MEAN_SUM: f64 = 1.5;

/// Adds up the area of a surface, part by part.
///
/// ```
/// use tmchho::surface_area::SurfaceArea;
/// // A roof of 40 by 30, pitched by 45°.
/// let roof: Vec<[f64; 3]> = (0..120_000)
///     .map(|i| (0.1 * f64::from(i % 400), 0.1 * f64::from(i / 400) / 2.0_f64.sqrt()))
///     .map(|(x, y)| [x, y, y])
///     .collect();
/// let mut area = SurfaceArea::new(0.5)?;
/// area.add(&roof)?;
/// assert!((area.total() / 1200.0 - 1.0).abs() < 0.1);
/// # Ok::<(), tmchho::Error>(())
/// ```
#[derive(Debug)]
pub struct SurfaceArea {
    turn: Rigid,
    edge_m: f64,
    max_cubes: usize,
    numbers: HashMap<[i64; 3], u32>,
    cubes: Vec<Moments>,
}

/// Number of points, their sums and the sums of their products, about the corner of the cube.
type Moments = [f64; 10];

impl SurfaceArea {
    /// A grid of cubes with this edge: a few times the distance between points.
    ///
    /// # Errors
    /// [`Error::InvalidArgument`] where it is not above 0.
    pub fn new(edge_m: f64) -> Result<Self> {
        Ok(Self {
            turn: Rigid::from_euler(TURN_RAD, [0.0; 3]),
            edge_m: require_positive("edge_m", edge_m)?,
            max_cubes: MAX_CUBES,
            numbers: HashMap::new(),
            cubes: Vec::new(),
        })
    }

    /// Adds the next part of the surface.
    ///
    /// # Errors
    /// [`Error::InvalidArgument`] where a coordinate is not finite or too large for the edge.
    pub fn add(&mut self, points: &[Point]) -> Result<()> {
        for point in points {
            let point = self.turn.rotate(point);
            let cell = point.map(|v| (v / self.edge_m).floor());
            if !cell.iter().all(|v| v.abs() < 9e15) {
                return Err(Error::argument(
                    "points",
                    "hold a coordinate that is too large",
                ));
            }
            let n_cubes = self.cubes.len();
            let key = cell.map(|v| v as i64);
            let number = *self.numbers.entry(key).or_insert(n_cubes as u32) as usize;
            if number == n_cubes {
                self.cubes.push([0.0; 10]);
            }
            let [x, y, z] = std::array::from_fn(|axis| point[axis] / self.edge_m - cell[axis]);
            let terms = [1.0, x, y, z, x * x, y * y, z * z, x * y, x * z, y * z];
            for (sum, term) in self.cubes[number].iter_mut().zip(terms) {
                *sum += term;
            }
            while self.cubes.len() > self.max_cubes {
                self.coarsen();
            }
        }
        Ok(())
    }

    /// Doubles the edge: eight cubes become one.
    fn coarsen(&mut self) {
        self.edge_m *= 2.0;
        let old = std::mem::take(&mut self.cubes);
        let mut keys = vec![[0; 3]; old.len()];
        // Whatever the order of the table, each key is put in its place.
        self.numbers
            .drain()
            .for_each(|(key, number)| keys[number as usize] = key);
        for (key, moments) in keys.iter().zip(old) {
            let n_cubes = self.cubes.len();
            let coarse = key.map(|v| v.div_euclid(2));
            let number = *self.numbers.entry(coarse).or_insert(n_cubes as u32) as usize;
            if number == n_cubes {
                self.cubes.push([0.0; 10]);
            }
            let moved = in_a_cube_twice_as_long(&moments, key.map(|v| v.rem_euclid(2) as f64));
            for (sum, more) in self.cubes[number].iter_mut().zip(moved) {
                *sum += more;
            }
        }
    }

    /// The area of all that was added.
    pub fn total(&self) -> f64 {
        let sums: Vec<Option<f64>> =
            parallel::map(self.cubes.len(), |i| sum_of_normal(&self.cubes[i]));
        let inverse = |sum: f64| 1.0 / sum;
        let (n, known) = sums
            .iter()
            .flatten()
            .fold((0.0, 0.0), |(n, all), sum| (n + 1.0, all + inverse(*sum)));
        let mean = if n > 0.0 {
            known / n
        } else {
            inverse(MEAN_SUM)
        };
        let n_unknown = sums.iter().filter(|sum| sum.is_none()).count();
        self.edge_m * self.edge_m * (known + mean * n_unknown as f64)
    }
}

/// The moments about the corner of a cube twice as long, in which the old one stands at `place`.
fn in_a_cube_twice_as_long(moments: &Moments, [a, b, c]: Point) -> Moments {
    let [n, x, y, z, xx, yy, zz, xy, xz, yz] = *moments;
    let first = [x + a * n, y + b * n, z + c * n].map(|sum| sum / 2.0);
    let second = [
        xx + 2.0 * a * x + a * a * n,
        yy + 2.0 * b * y + b * b * n,
        zz + 2.0 * c * z + c * c * n,
        xy + a * y + b * x + a * b * n,
        xz + a * z + c * x + a * c * n,
        yz + b * z + c * y + b * c * n,
    ]
    .map(|sum| sum / 4.0);
    let ([x, y, z], [xx, yy, zz, xy, xz, yz]) = (first, second);
    [n, x, y, z, xx, yy, zz, xy, xz, yz]
}

/// |nx| + |ny| + |nz| of the plane through the points of a cube.
fn sum_of_normal(moments: &Moments) -> Option<f64> {
    let [n, x, y, z, xx, yy, zz, xy, xz, yz] = *moments;
    if n < LEAST_POINTS {
        return None;
    }
    let (x, y, z) = (x / n, y / n, z / n);
    let (xy, xz, yz) = (xy / n - x * y, xz / n - x * z, yz / n - y * z);
    let spread = Matrix3::new(
        xx / n - x * x,
        xy,
        xz,
        xy,
        yy / n - y * y,
        yz,
        xz,
        yz,
        zz / n - z * z,
    );
    let eigen = SymmetricEigen::new(spread);
    let normal = eigen.eigenvectors.column(eigen.eigenvalues.imin());
    Some(normal.iter().map(|v| v.abs()).sum())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Stream;

    /// A square of 20 by 20, with 100 points per unit of area, turned and moved.
    fn square(turn: [f64; 3], seed: u64) -> Vec<Point> {
        let mut stream = Stream::new(seed, "area", 0);
        let away = Rigid::from_euler(turn, [500_000.3, 4_000_000.7, -12.0]);
        (0..40_000)
            .map(|_| [20.0 * stream.uniform(), 20.0 * stream.uniform(), 0.0])
            .map(|p| away.apply(&p))
            .collect()
    }

    fn area(points: &[Point], edge_m: f64) -> f64 {
        let mut area = SurfaceArea::new(edge_m).unwrap();
        for part in points.chunks(777) {
            area.add(part).unwrap();
        }
        area.total()
    }

    #[test]
    fn a_noisy_floor_counts_once_wherever_it_lies() {
        let mut stream = Stream::new(9, "area", 0);
        for height in [0.0, 0.24, 0.5] {
            let mut draw = |width: f64| width * stream.uniform();
            let floor: Vec<Point> = (0..40_000)
                .map(|_| [draw(20.0), draw(20.0), height + draw(0.02) - 0.01])
                .collect();
            let found = area(&floor, 0.5);
            assert!((360.0..420.0).contains(&found), "{height}: {found}");
        }
    }

    #[test]
    fn a_square_keeps_its_area_however_it_lies() {
        let mut stream = Stream::new(1, "turns", 0);
        for seed in 0..12 {
            let turn = std::array::from_fn(|_| stream.uniform_between(-3.0, 3.0));
            let found = area(&square(turn, seed), 0.5);
            assert!((350.0..450.0).contains(&found), "{found} at {turn:?}");
        }
    }

    #[test]
    fn a_limit_makes_cubes_longer_and_moves_nothing() {
        let points = square([0.3, 0.9, -1.2], 3);
        let mut limited = SurfaceArea {
            max_cubes: 2000,
            ..SurfaceArea::new(0.125).unwrap()
        };
        limited.add(&points).unwrap();
        assert!(limited.edge_m > 0.2 && limited.cubes.len() <= 2000);
        let wanted = area(&points, limited.edge_m);
        assert!((limited.total() / wanted - 1.0).abs() < 1e-6);
    }

    #[test]
    fn sparse_points_take_the_mean_and_none_have_no_area() {
        assert_eq!(area(&[], 1.0), 0.0);
        assert_eq!(area(&[[0.5; 3]], 3.0), 9.0 / 1.5);
        let flat: Vec<Point> = (0..100)
            .map(|i| [f64::from(i % 10), f64::from(i / 10), 0.25])
            .collect();
        // At most nine points a cube; along its sides the square is 9 to 10 long.
        let found = area(&flat, 3.0);
        assert!((80.0..130.0).contains(&found), "{found}");
    }

    #[test]
    fn what_has_no_area_is_refused_by_name() {
        assert!(
            SurfaceArea::new(0.0)
                .unwrap_err()
                .to_string()
                .contains("edge_m")
        );
        let mut area = SurfaceArea::new(1e-9).unwrap();
        assert!(area.add(&[[f64::NAN, 0.0, 0.0]]).is_err());
        assert!(area.add(&[[1e9, 0.0, 0.0]]).is_err());
    }
}
