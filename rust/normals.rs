//! Normals and curvature of the surface that the points lie on.
//!
//! Why: points that lie on surfaces of different slope or bend cannot be the same place, which is
//! what tells a right pose from a nearly right one.
//! Reads: points and a neighbour index.  Leaves: a unit normal and a curvature per point.
//! Source: principal components of the neighbourhood (Hoppe et al. 1992); surface variation
//! λ3/(λ1+λ2+λ3) (Pauly, Gross & Kobbelt 2002); eigenvalues in closed form (Smith 1961), or where that
//! loses digits by Jacobi's rotations.
//! Deviates: nowhere.
//! Absent on purpose: orientation towards a sensor, which a cloud does not know; compare normals
//! by the absolute value of their product.

mod moments;

use moments::Moments;

use crate::cloud::{Point, centroid, cross, distance_sq, dot};
use crate::error::{Result, require_at_least, require_positive};
use crate::neighbors::{NeighborIndex, Places};
use crate::progress::Progress;
use crate::rank::nth_smallest;

/// Three points span a plane.
const LEAST_POINTS: usize = 3;

/// The surface round a point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Surface {
    /// Unit normal; its largest component is positive. Zero where the neighbours are fewer than
    /// three or stand on one line or in one place.
    pub normal: Point,
    /// Smallest eigenvalue of the covariance over the sum of all three: 0 in a plane, 1/3 at most.
    /// 0 where there is no normal.
    pub curvature: f64,
    /// Root mean squared distance of the neighbours from their plane: noise, and what bend there is
    /// across the neighbourhood. 0 where there is no normal.
    pub roughness_m: f64,
}

impl Surface {
    /// Where no plane can be told.
    pub const NONE: Self = Self {
        normal: [0.0; 3],
        curvature: 0.0,
        roughness_m: 0.0,
    };

    /// Of `n` points with this scatter about their centroid. What is far below `squares_m2`, of which the
    /// scatter is the difference, is rounding.
    fn of(scatter: &Symmetric, n: f64, squares_m2: f64) -> Self {
        /// A neighbourhood whose width is a millionth of its length is a line.
        const LINE: f64 = 1e-12;
        if scatter.trace() <= LINE * squares_m2 {
            return Self::NONE;
        }
        let (normal, least) = match scatter.least() {
            Some(found) => found,
            None => {
                let (lambda, vectors) = scatter.eigen();
                if lambda[1] <= LINE * squares_m2 {
                    return Self::NONE;
                }
                (vectors[2], lambda[2].max(0.0))
            }
        };
        Self {
            normal: with_largest_positive(normal),
            curvature: least / scatter.trace(),
            roughness_m: (least / n).sqrt(),
        }
    }

    /// The same in a mirror across x.
    pub fn mirrored(&self) -> Self {
        let [x, y, z] = self.normal;
        Self {
            normal: with_largest_positive([-x, y, z]),
            ..*self
        }
    }
}

/// A normal or its opposite: that whose largest component is positive.
fn with_largest_positive(normal: Point) -> Point {
    let larger = |largest: f64, v: &f64| if v.abs() > largest.abs() { *v } else { largest };
    let largest = normal.iter().fold(0.0, larger);
    match largest < 0.0 {
        true => normal.map(|v| -v),
        false => normal,
    }
}

/// The surface at each of `points` from the `k` points of `index` nearest to it (itself included,
/// where it is one of them).
///
/// ```
/// use tmchho::{neighbors::NeighborIndex, normals, progress::Progress};
/// let floor: Vec<[f64; 3]> = (0..25).map(|i| [f64::from(i % 5), f64::from(i / 5), 7.0]).collect();
/// let index = NeighborIndex::new(&floor);
/// let surfaces = normals::estimate(&floor, &index, 9, &Progress::silent())?;
/// assert!(surfaces.iter().all(|s| s.normal == [0.0, 0.0, 1.0] && s.curvature == 0.0));
/// # Ok::<(), tmchho::Error>(())
/// ```
///
/// # Errors
/// [`Error::InvalidArgument`](crate::Error::InvalidArgument) where `k` is below three,
/// [`Error::Cancelled`](crate::Error::Cancelled).
pub fn estimate(
    points: &[Point],
    index: &NeighborIndex,
    k: usize,
    progress: &Progress<'_>,
) -> Result<Vec<Surface>> {
    require_at_least("k", k, LEAST_POINTS)?;
    from_nearest(&places(points, index), index, k, progress)
}

/// The surface at each point of `index` from about `k` points: from those as near as the `k`-th is at half of
/// some thousand points, or where that is not half of `k`, from the `k` nearest. In half of the time of
/// [`estimate`] where most points lie equally far apart, as voxels do.
///
/// # Errors
/// As [`estimate`].
pub fn estimate_at_all(
    index: &NeighborIndex,
    k: usize,
    progress: &Progress<'_>,
) -> Result<Vec<Surface>> {
    require_at_least("k", k, LEAST_POINTS)?;
    let radius_m = usual_reach_m(index, k, progress)?;
    let places = index.places();
    let fresh = || Moments::within(radius_m);
    let found = index.map_collected(&places, fresh, progress, |near| {
        (2 * near.n() >= k).then(|| near.surface())
    })?;
    let numbers = (0..places.len()).map(|at| places.given(at));
    let sparse: Vec<usize> = numbers.filter(|i| found[*i].is_none()).collect();
    let points: Vec<Point> = sparse.iter().map(|i| index.points()[*i]).collect();
    let of_sparse = from_nearest(&Places::as_given(&points), index, k, progress)?;
    let mut surfaces: Vec<Surface> = found
        .into_iter()
        .map(|s| s.unwrap_or(Surface::NONE))
        .collect();
    for (i, surface) in sparse.into_iter().zip(of_sparse) {
        surfaces[i] = surface;
    }
    Ok(surfaces)
}

/// A trifle farther than the `k`-th nearest point lies, itself included, at half of some thousand points; 0 where there
/// are none.
fn usual_reach_m(index: &NeighborIndex, k: usize, progress: &Progress<'_>) -> Result<f64> {
    const N_ASKED: usize = 1000;
    /// No point should stand on the rim, where rounding decides whether it counts.
    const BEYOND: f64 = 1.001;
    let places = index.some_places(N_ASKED);
    let reach_sq = |place: &Point, near: &[Point]| {
        near.iter()
            .map(|p| distance_sq(place, p))
            .fold(0.0, f64::max)
    };
    let reaches_sq = index.map_k_nearest(&places, k, progress, reach_sq)?;
    if reaches_sq.is_empty() {
        return Ok(0.0);
    }
    let n = reaches_sq.len();
    Ok(BEYOND * nth_smallest(n, n / 2, |i| reaches_sq[i]).sqrt())
}

/// The surface at each of `points` from the points of `index` within `radius_m` of it;
/// [`Surface::NONE`] where they are fewer than `min_neighbors` (itself included).
///
/// # Errors
/// [`Error::InvalidArgument`](crate::Error::InvalidArgument) where `radius_m` is not above 0,
/// [`Error::Cancelled`](crate::Error::Cancelled).
pub fn estimate_within(
    points: &[Point],
    index: &NeighborIndex,
    radius_m: f64,
    min_neighbors: usize,
    progress: &Progress<'_>,
) -> Result<Vec<Surface>> {
    require_positive("radius_m", radius_m)?;
    let fresh = || Moments::within(radius_m);
    index.map_collected(&places(points, index), fresh, progress, |near| {
        match near.n() < min_neighbors {
            true => Surface::NONE,
            false => near.surface(),
        }
    })
}

fn from_nearest(
    places: &Places,
    index: &NeighborIndex,
    k: usize,
    progress: &Progress<'_>,
) -> Result<Vec<Surface>> {
    let through = |_: &Point, near: &[Point]| surface_through(near);
    index.map_k_nearest(places, k, progress, through)
}

/// The points of the index itself are sorted already.
fn places(points: &[Point], index: &NeighborIndex) -> Places {
    if std::ptr::eq(points, index.points()) {
        index.places()
    } else {
        Places::new(points)
    }
}

/// The plane of least squares through `points`.
fn surface_through(points: &[Point]) -> Surface {
    if points.len() < LEAST_POINTS {
        return Surface::NONE;
    }
    let centre = centroid(points);
    let mut scatter = Symmetric::default();
    for p in points {
        scatter.add([p[0] - centre[0], p[1] - centre[1], p[2] - centre[2]], 1.0);
    }
    Surface::of(&scatter, points.len() as f64, scatter.trace())
}

/// A symmetric 3×3 matrix: a sum of weighted outer products.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct Symmetric {
    /// xx, yy, zz.
    diagonal: [f64; 3],
    /// yz, xz, xy: each beside the axis that it lacks.
    off_diagonal: [f64; 3],
}

impl Symmetric {
    pub(crate) fn new(diagonal: [f64; 3], off_diagonal: [f64; 3]) -> Self {
        Self {
            diagonal,
            off_diagonal,
        }
    }

    /// Adds `weight`·v·vᵀ.
    #[inline]
    pub(crate) fn add(&mut self, v: Point, weight: f64) {
        for axis in 0..3 {
            let (next, last) = ((axis + 1) % 3, (axis + 2) % 3);
            self.diagonal[axis] += weight * v[axis] * v[axis];
            self.off_diagonal[axis] += weight * v[next] * v[last];
        }
    }

    /// Eigenvalues in falling order, and the unit eigenvector of each. Exact to the rounding of the
    /// largest; the smallest may come out a trifle below zero.
    pub(crate) fn eigen(&self) -> ([f64; 3], [Point; 3]) {
        self.turned_onto_axes::<true>()
    }

    /// Eigenvalues in falling order, as from [`Symmetric::eigen`], and to the same digits unless the
    /// larger two nearly coincide.
    pub(crate) fn eigenvalues(&self) -> [f64; 3] {
        let closed = self.eigenvalues_in_closed_form();
        closed.unwrap_or_else(|| self.turned_onto_axes::<false>().0)
    }

    /// The unit eigenvector of the smallest eigenvalue, and that eigenvalue, not below zero; `None`
    /// where the second smallest is nearly as small.
    pub(crate) fn least(&self) -> Option<(Point, f64)> {
        let [_, _, least] = self.eigenvalues_in_closed_form()?;
        // The rows of what is left without it span a plane; its normal is sharpest from the two rows
        // that lie most apart.
        let [xx, yy, zz] = self.diagonal.map(|v| v - least);
        let [yz, xz, xy] = self.off_diagonal;
        let rows = [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]];
        let (mut normal, mut longest_sq) = ([0.0; 3], 0.0);
        for (a, b) in [(0, 1), (0, 2), (1, 2)] {
            let across = cross(&rows[a], &rows[b]);
            let length_sq = dot(&across, &across);
            if length_sq > longest_sq {
                (normal, longest_sq) = (across, length_sq);
            }
        }
        let length = longest_sq.sqrt();
        let normal = normal.map(|v| v / length);
        // More digits than the eigenvalue had.
        let along = self.times(&normal);
        (length > 0.0).then(|| (normal, dot(&normal, &along).max(0.0)))
    }

    fn trace(&self) -> f64 {
        self.diagonal[0] + self.diagonal[1] + self.diagonal[2]
    }

    fn times(&self, v: &Point) -> Point {
        let ([xx, yy, zz], [yz, xz, xy]) = (self.diagonal, self.off_diagonal);
        [
            xx * v[0] + xy * v[1] + xz * v[2],
            xy * v[0] + yy * v[1] + yz * v[2],
            xz * v[0] + yz * v[1] + zz * v[2],
        ]
    }

    /// Smith (1961); `None` where the smaller two eigenvalues lie so close together that digits are lost.
    fn eigenvalues_in_closed_form(&self) -> Option<[f64; 3]> {
        const CLOSE: f64 = 1e-3;
        let mean = self.trace() / 3.0;
        let [x, y, z] = self.diagonal.map(|v| v - mean);
        let [yz, xz, xy] = self.off_diagonal;
        let spread = ((x * x + y * y + z * z + 2.0 * (yz * yz + xz * xz + xy * xy)) / 6.0).sqrt();
        let determinant = x * (y * z - yz * yz) - xy * (xy * z - yz * xz) + xz * (xy * yz - y * xz);
        let half = determinant / (2.0 * spread * spread * spread);
        // Also false for a matrix of zeros.
        if !half.is_finite() {
            return None;
        }
        let angle = half.clamp(-1.0, 1.0).acos() / 3.0;
        let first = mean + 2.0 * spread * angle.cos();
        let third = mean + 2.0 * spread * (angle + std::f64::consts::TAU / 3.0).cos();
        let second = 3.0 * mean - first - third;
        (second - third > CLOSE * first).then_some([first, second, third])
    }

    /// The eigenvectors are left out unless `VECTORS`.
    #[inline]
    fn turned_onto_axes<const VECTORS: bool>(&self) -> ([f64; 3], [Point; 3]) {
        const MAX_SWEEPS: usize = 16;
        let (mut d, mut o) = (self.diagonal, self.off_diagonal);
        let mut vectors = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        for _ in 0..MAX_SWEEPS {
            let off_sq = o[0] * o[0] + o[1] * o[1] + o[2] * o[2];
            let diagonal_sq = d[0] * d[0] + d[1] * d[1] + d[2] * d[2];
            if off_sq <= 1e-32 * diagonal_sq {
                break;
            }
            for (p, q, r) in [(0, 1, 2), (0, 2, 1), (1, 2, 0)] {
                if o[r] == 0.0 {
                    continue;
                }
                // The turn in the plane of p and q that clears the element between them. A cotangent too
                // large to be squared stands for no turn at all.
                let cotangent = (d[q] - d[p]) / (2.0 * o[r]);
                let tangent = 1.0_f64.copysign(cotangent)
                    / (cotangent.abs() + (cotangent * cotangent + 1.0).sqrt());
                let cosine = 1.0 / (tangent * tangent + 1.0).sqrt();
                let sine = tangent * cosine;
                d[p] -= tangent * o[r];
                d[q] += tangent * o[r];
                o[r] = 0.0;
                // o[q] stands between r and p, o[p] between r and q.
                (o[q], o[p]) = (cosine * o[q] - sine * o[p], sine * o[q] + cosine * o[p]);
                if VECTORS {
                    let (a, b) = (vectors[p], vectors[q]);
                    vectors[p] = std::array::from_fn(|axis| cosine * a[axis] - sine * b[axis]);
                    vectors[q] = std::array::from_fn(|axis| sine * a[axis] + cosine * b[axis]);
                }
            }
        }
        let mut order = [0, 1, 2];
        order.sort_by(|&a, &b| d[b].total_cmp(&d[a]));
        (order.map(|i| d[i]), order.map(|i| vectors[i]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Stream;
    use crate::rigid::Rigid;
    use nalgebra::{Matrix3, SymmetricEigen, Vector3};

    #[test]
    fn by_hand() {
        // A cross in the plane z = x: along y 2·2² = 8, along (1, 0, 1) 2·(1 + 1) = 4, across 0.
        let cross = [
            [1.0, 0.0, 1.0],
            [-1.0, 0.0, -1.0],
            [0.0, 2.0, 0.0],
            [0.0, -2.0, 0.0],
        ];
        let mut scatter = Symmetric::default();
        for p in cross {
            scatter.add(p, 1.0);
        }
        let (lambda, _) = scatter.eigen();
        for (got, wanted) in lambda.iter().zip([8.0, 4.0, 0.0]) {
            assert!((got - wanted).abs() < 1e-15);
        }
        let surface = surface_through(&cross);
        assert!((dot(&surface.normal, &[1.0, 0.0, -1.0]).abs() - 2_f64.sqrt()).abs() < 1e-15);
        assert!(surface.curvature < 1e-16);
    }

    #[test]
    fn eigenvalues_and_vectors_agree_with_nalgebra() {
        let mut stream = Stream::new(1, "eigen", 0);
        let mut n_quick = 0;
        for trial in 0..2000 {
            // From round to needle-like, some of them along the axes.
            let widths = [1.0, stream.uniform(), stream.uniform().powi(6)];
            let turn = match trial % 10 {
                0 => Rigid::identity(),
                _ => Rigid::from_euler([0; 3].map(|_| 3.0 * stream.normal()), [0.0; 3]),
            };
            let mut scatter = Symmetric::default();
            let mut twin = Matrix3::zeros();
            for _ in 0..10 {
                let v = turn.rotate(&widths.map(|width| width * stream.normal()));
                let weight = stream.uniform();
                scatter.add(v, weight);
                let v = Vector3::from(v);
                twin += weight * v * v.transpose();
            }
            let (lambda, vectors) = scatter.eigen();
            for (quick, exact) in scatter.eigenvalues().iter().zip(lambda) {
                assert!((quick - exact).abs() < 1e-7 * lambda[0]);
            }
            if let Some((normal, least)) = scatter.least() {
                n_quick += 1;
                assert!((least - lambda[2]).abs() < 1e-13 * lambda[0]);
                let apart = lambda[1] - lambda[2];
                assert!(dot(&normal, &vectors[2]).abs() > 1.0 - 1e-12 * lambda[0] / apart);
            }
            let mut wanted: Vec<f64> = SymmetricEigen::new(twin)
                .eigenvalues
                .iter()
                .copied()
                .collect();
            wanted.sort_by(|a, b| b.total_cmp(a));
            for i in 0..3 {
                assert!((lambda[i] - wanted[i]).abs() < 1e-13 * wanted[0]);
                let v = Vector3::from(vectors[i]);
                assert!((twin * v - v * lambda[i]).amax() < 1e-13 * wanted[0]);
                assert!((v.norm() - 1.0).abs() < 1e-13);
            }
        }
        assert!((1500..1990).contains(&n_quick), "{n_quick}");
        assert_eq!(Symmetric::default().eigenvalues(), [0.0; 3]);
    }

    #[test]
    fn a_sphere_has_radial_normals_that_turn_with_it() {
        let mut stream = Stream::new(2, "sphere", 0);
        let sphere: Vec<Point> = (0..4000)
            .map(|_| {
                let v = Vector3::from([0; 3].map(|_| stream.normal()));
                v.normalize().into()
            })
            .collect();
        let index = NeighborIndex::new(&sphere);
        let silent = Progress::silent();
        let by_number = estimate(&sphere, &index, 12, &silent).unwrap();
        let by_radius = estimate_within(&sphere, &index, 0.12, 5, &silent).unwrap();
        for surfaces in [&by_number, &by_radius] {
            let aligned = surfaces
                .iter()
                .zip(&sphere)
                .filter(|(s, p)| dot(&s.normal, p).abs() > 0.99)
                .count();
            assert!(aligned > 3950, "{aligned}");
            assert!(surfaces.iter().all(|s| s.curvature < 0.02));
        }
        let turn = Rigid::from_euler([0.5, -0.8, 2.0], [1e6, -2e6, 3.0]);
        let moved: Vec<Point> = sphere.iter().map(|p| turn.apply(p)).collect();
        let turned = estimate(&moved, &NeighborIndex::new(&moved), 12, &silent).unwrap();
        for (a, b) in by_number.iter().zip(&turned) {
            assert!(dot(&turn.rotate(&a.normal), &b.normal).abs() > 1.0 - 1e-9);
            assert!((a.curvature - b.curvature).abs() < 1e-7);
        }
    }

    fn is_same(a: &Surface, b: &Surface) -> bool {
        let same_normal = (dot(&a.normal, &b.normal) - dot(&b.normal, &b.normal)).abs() < 1e-9;
        let same_bend = (a.curvature - b.curvature).abs() < 1e-12;
        same_normal && same_bend && (a.roughness_m - b.roughness_m).abs() < 1e-9
    }

    #[test]
    fn sums_over_blocks_are_the_plane_through_the_points() {
        let mut stream = Stream::new(3, "moments", 0);
        let points: Vec<Point> = (0..2000)
            .map(|_| [stream.uniform(), stream.uniform(), 0.03 * stream.normal()])
            .collect();
        let index = NeighborIndex::new(&points);
        let radius_m = 0.06;
        let surfaces = estimate_within(&points, &index, radius_m, 9, &Progress::silent()).unwrap();
        let mut near = Vec::new();
        let mut n_surfaces = 0;
        for (place, surface) in points.iter().zip(&surfaces) {
            index.within(place, radius_m, &mut near);
            let near: Vec<Point> = near.iter().map(|n| points[n.index as usize]).collect();
            if near.len() < 9 {
                assert_eq!(*surface, Surface::NONE);
                continue;
            }
            assert!(is_same(surface, &surface_through(&near)));
            n_surfaces += 1;
        }
        assert!((500..1900).contains(&n_surfaces), "{n_surfaces}");
    }

    #[test]
    fn where_points_are_sparse_the_nearest_tell_the_surface() {
        // A strip of points 1 apart, and beyond it one of points 5 apart.
        let mut stream = Stream::new(4, "sparse", 0);
        let mut strip = |n: i32, edge: f64, x: f64| -> Vec<Point> {
            (0..n * n)
                .map(|i| (edge * f64::from(i % n), edge * f64::from(i / n)))
                .map(|(along, across)| [x + along, across, 0.2 * edge * stream.normal()])
                .collect()
        };
        let points = [strip(60, 1.0, 0.0), strip(12, 5.0, 100.0)].concat();
        let (index, silent) = (NeighborIndex::new(&points), Progress::silent());
        let found = estimate_at_all(&index, 16, &silent).unwrap();
        let by_number = estimate(&points, &index, 16, &silent).unwrap();
        // In the middle of the dense strip 21 points stand within √5, and 13 within 2.
        let reach_m = usual_reach_m(&index, 16, &silent).unwrap();
        assert!((2.0..2.4).contains(&reach_m), "{reach_m}");
        let by_radius = estimate_within(&points, &index, reach_m, 8, &silent).unwrap();
        let (dense, sparse) = found.split_at(3600);
        assert!(
            dense
                .iter()
                .zip(&by_radius)
                .filter(|(a, b)| is_same(a, b))
                .count()
                > 3500
        );
        assert!(
            sparse
                .iter()
                .zip(&by_number[3600..])
                .all(|(a, b)| is_same(a, b))
        );
        assert!(estimate_at_all(&index, 2, &silent).is_err());
        let nobody = estimate_at_all(&NeighborIndex::new(&[]), 16, &silent).unwrap();
        assert!(nobody.is_empty());
    }

    #[test]
    fn no_plane_no_normal() {
        let silent = Progress::silent();
        let line: Vec<Point> = (0..20)
            .map(|i| [f64::from(i), 0.3 * f64::from(i), 7.0 - f64::from(i)])
            .collect();
        let same = vec![[1e6, 2e6, 3e6]; 30];
        for points in [&line, &same, &vec![[1.0; 3], [2.0; 3]], &vec![]] {
            let index = NeighborIndex::new(points);
            let surfaces = estimate(points, &index, 10, &silent).unwrap();
            assert_eq!(surfaces, vec![Surface::NONE; points.len()]);
            let surfaces = estimate_at_all(&index, 10, &silent).unwrap();
            assert_eq!(surfaces, vec![Surface::NONE; points.len()]);
        }
        // Two piles: whatever is not 0 across the line through them is rounding.
        let piles: Vec<Point> = (0..30)
            .map(|i| [0.1 * f64::from(i % 2), 0.3, 7.0])
            .collect();
        let index = NeighborIndex::new(&piles);
        for radius_m in [0.05, 1.0] {
            let surfaces = estimate_within(&piles, &index, radius_m, 3, &silent).unwrap();
            assert_eq!(surfaces, vec![Surface::NONE; piles.len()]);
        }
        let beside = estimate_within(&[[0.04, 0.3, 7.0]], &index, 0.05, 3, &silent).unwrap();
        assert_eq!(beside, [Surface::NONE]);
        let index = NeighborIndex::new(&line);
        let alone = estimate_within(&line, &index, 1e-3, 3, &silent).unwrap();
        assert_eq!(alone, vec![Surface::NONE; line.len()]);
        assert!(estimate(&line, &index, 2, &silent).is_err());
        assert!(estimate_within(&line, &index, f64::NAN, 3, &silent).is_err());
    }
}
