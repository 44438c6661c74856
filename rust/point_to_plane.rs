//! The small step that brings points onto the planes of their partners.
//!
//! Source: Chen & Medioni (1992); linearised rotation as in Low (2004). The step is applied as a
//! full rotation (exponential map), so that no error of linearisation stays in the pose.
//! Deviates: the step may be levelled, or have a scale.

use nalgebra::{Matrix6, SMatrix, SVector, Vector3};

use crate::cloud::{Point, difference};
use crate::freedom::Freedom;
use crate::rigid::Rigid;
use crate::similarity::Similarity;

/// Running sums of the normal equations over (point, partner, normal, weight).
///
/// The innermost loop of the search ends here, hence the plain arrays.
#[derive(Debug, Clone, Copy, Default)]
pub struct PlaneSums {
    /// Σ w · J·Jᵀ with J = (p × n, n): rotation first, in radians, then translation. The lower
    /// triangle, row by row.
    information: [f64; 21],
    /// Σ w · J · residual
    gradient: [f64; 6],
    weight: f64,
}

impl PlaneSums {
    /// Adds a moved source point, its partner in the target, and the unit normal of the plane.
    /// Coordinates should be small numbers about the cloud's middle: the step turns about 0.
    #[inline]
    pub fn add(&mut self, moved: &Point, partner: &Point, normal: &Point, weight: f64) {
        let residual = along(&difference(moved, partner), normal);
        self.add_row(&motion_along(moved, normal), residual, weight);
    }

    /// Adds any observation of the step: `row` · (rotation, translation) + `residual` should be 0.
    #[inline]
    pub fn add_row(&mut self, row: &[f64; 6], residual: f64, weight: f64) {
        let mut at = 0;
        for r in 0..6 {
            let scaled = weight * row[r];
            self.gradient[r] += scaled * residual;
            for c in 0..=r {
                self.information[at] += scaled * row[c];
                at += 1;
            }
        }
        self.weight += weight;
    }

    /// Adds the sums of other points.
    pub fn merge(&mut self, other: &Self) {
        add_all(&mut self.information, &other.information);
        add_all(&mut self.gradient, &other.gradient);
        self.weight += other.weight;
    }

    /// Sum of the weights.
    pub fn weight(&self) -> f64 {
        self.weight
    }

    /// The 6×6 information matrix: rotation (radians) first, then translation.
    pub fn information(&self) -> Matrix6<f64> {
        let entry = |row: usize, column: usize| self.information[row * (row + 1) / 2 + column];
        Matrix6::from_fn(|r, c| entry(r.max(c), r.min(c)))
    }

    /// The step to apply on the left of the pose; `None` where there is no weight.
    ///
    /// Directions that the planes leave open (a flat floor slides) are damped to no motion
    /// instead of being thrown about.
    pub fn solve(&self) -> Option<Rigid> {
        let step = damped_step(self.information(), self.gradient.into(), 3, 3)?;
        Some(rigid_step(
            [step[0], step[1], step[2]],
            [step[3], step[4], step[5]],
        ))
    }

    /// The same, turning about z only: both clouds are levelled.
    ///
    /// ```
    /// use tmchho::point_to_plane::PlaneSums;
    /// let mut sums = PlaneSums::default();
    /// for (x, n) in [(1.0, [0.0, 1.0, 0.0]), (-1.0, [0.0, 1.0, 0.0]), (0.0, [0.6, 0.0, 0.8])] {
    ///     let wall = [x, 0.0, 0.0];
    ///     sums.add(&[x, 0.01 * x, 0.0], &wall, &n, 1.0);
    /// }
    /// let step = sums.solve_levelled().unwrap();
    /// assert!((step.rotation[(1, 0)] + 0.01).abs() < 1e-6 && step.rotation[(2, 2)] == 1.0);
    /// ```
    pub fn solve_levelled(&self) -> Option<Rigid> {
        self.solve_about(&Vector3::z())
    }

    /// The same, turning about `axis` (a unit vector) only.
    pub(crate) fn solve_about(&self, axis: &Vector3<f64>) -> Option<Rigid> {
        let mut free = SMatrix::<f64, 6, 4>::zeros();
        free.fixed_view_mut::<3, 1>(0, 0).copy_from(axis);
        free.fixed_view_mut::<3, 3>(3, 1).fill_with_identity();
        let part = free.transpose() * self.information() * free;
        let gradient = free.transpose() * SVector::from(self.gradient);
        let step = damped_step(part, gradient, 1, 3)?;
        Some(rigid_step(
            (axis * step[0]).into(),
            [step[1], step[2], step[3]],
        ))
    }
}

/// The same sums with the scale as a seventh parameter.
///
/// ```
/// use tmchho::{freedom::Freedom, point_to_plane::ScaledPlaneSums};
/// // The six faces of a cube of edge 2, points of a cube that is one per cent too large.
/// let mut sums = ScaledPlaneSums::default();
/// for axis in 0..3 {
///     for (u, v, side) in [(0.5, 0.1, 1.0), (-0.3, 0.7, 1.0), (0.2, -0.6, -1.0)] {
///         let (mut face, mut normal) = ([u, v, 0.0], [0.0; 3]);
///         face.swap(axis, 2);
///         (face[axis], normal[axis]) = (side, 1.0);
///         sums.add(&face.map(|x| 1.01 * x), &face, &normal, 1.0);
///     }
/// }
/// let step = sums.solve(Freedom::Similarity).unwrap();
/// assert!((step.scale * 1.01 - 1.0).abs() < 2e-4);
/// ```
#[derive(Debug, Clone, Copy, Default)]
pub struct ScaledPlaneSums {
    planes: PlaneSums,
    /// Σ w · J₇ · J with J₇ = p·n, the motion along the normal for a growth about 0; the last entry
    /// is J₇ with itself.
    information: [f64; 7],
    gradient: f64,
}

impl ScaledPlaneSums {
    /// Adds a moved source point, its partner in the target, and the unit normal of the plane.
    /// The step turns and grows about 0, which should be the middle of the points.
    #[inline]
    pub fn add(&mut self, moved: &Point, partner: &Point, normal: &Point, weight: f64) {
        let residual = along(&difference(moved, partner), normal);
        let [a, b, c, d, e, f] = motion_along(moved, normal);
        self.add_row(&[a, b, c, d, e, f, along(moved, normal)], residual, weight);
    }

    /// Adds any observation of the step: `row` · (rotation, translation, growth) + `residual`
    /// should be 0.
    #[inline]
    pub fn add_row(&mut self, row: &[f64; 7], residual: f64, weight: f64) {
        let [a, b, c, d, e, f, growth] = *row;
        self.planes.add_row(&[a, b, c, d, e, f], residual, weight);
        let scaled = weight * growth;
        for (sum, value) in self.information.iter_mut().zip(row) {
            *sum += scaled * value;
        }
        self.gradient += scaled * residual;
    }

    /// Adds the sums of other points.
    pub fn merge(&mut self, other: &Self) {
        self.planes.merge(&other.planes);
        add_all(&mut self.information, &other.information);
        self.gradient += other.gradient;
    }

    /// Sum of the weights.
    pub fn weight(&self) -> f64 {
        self.planes.weight
    }

    /// The sums without the scale.
    pub fn rigid(&self) -> &PlaneSums {
        &self.planes
    }

    /// The 7×7 information matrix: rotation (radians), translation, growth.
    pub fn information(&self) -> SMatrix<f64, 7, 7> {
        let rigid = self.planes.information();
        SMatrix::from_fn(|r, c| match r.max(c) {
            6 => self.information[r.min(c)],
            _ => rigid[(r, c)],
        })
    }

    /// Adds a moved source point and its partner whose difference weighs by a matrix: the entries
    /// xx, yx, yy, zx, zy, zz of the inverse of its covariance.
    ///
    /// Σ J·W·Jᵀ with J = (p ×, 1, p), by the columns of W: as quick as a single plane.
    #[inline]
    pub fn add_weighed(
        &mut self,
        moved: &Point,
        partner: &Point,
        [xx, yx, yy, zx, zy, zz]: [f64; 6],
    ) {
        let (p, d) = (moved, difference(moved, partner));
        let columns = [[xx, yx, zx], [yx, yy, zy], [zx, zy, zz]];
        // (p × w, w) of every column: the rows of the translation.
        let rows = columns.map(|w| motion_along(p, &w));
        let mut at = 0;
        for r in 0..3 {
            let (next, last) = ((r + 1) % 3, (r + 2) % 3);
            for c in 0..=r {
                // Row r of [p]× times the rows of the translation.
                self.planes.information[at] += p[next] * rows[last][c] - p[last] * rows[next][c];
                at += 1;
            }
        }
        for r in 0..3 {
            for c in 0..4 + r {
                self.planes.information[at] += rows[r][c];
                at += 1;
            }
        }
        for r in 0..6 {
            let grown = rows[0][r] * p[0] + rows[1][r] * p[1] + rows[2][r] * p[2];
            let pulled = rows[0][r] * d[0] + rows[1][r] * d[1] + rows[2][r] * d[2];
            self.information[r] += grown;
            self.planes.gradient[r] += pulled;
        }
        let weighed = columns.map(|w| along(p, &w));
        self.information[6] += along(p, &weighed);
        self.gradient += along(&d, &weighed);
        self.planes.weight += 1.0;
    }

    /// The step to apply on the left of the pose, with what is free; `None` where there is no
    /// weight. Open directions are damped to no motion.
    pub fn solve(&self, freedom: Freedom) -> Option<Similarity> {
        match freedom {
            Freedom::Levelled => self.planes.solve_levelled().map(Similarity::from),
            Freedom::Rigid => self.planes.solve().map(Similarity::from),
            Freedom::Similarity => self.solve_with_scale(),
        }
    }

    fn solve_with_scale(&self) -> Option<Similarity> {
        let gradient = SVector::from_fn(|row, _| match row {
            6 => self.gradient,
            _ => self.planes.gradient[row],
        });
        let step = damped_step(self.information(), gradient, 3, 3)?;
        Some(Similarity {
            // The exponential keeps the scale above 0 however large the step.
            scale: step[6].exp(),
            rigid: rigid_step([step[0], step[1], step[2]], [step[3], step[4], step[5]]),
        })
    }
}

/// How far `p` moves along `normal` for each small rotation about 0 and each translation.
#[inline]
pub(crate) fn motion_along(p: &Point, normal: &Point) -> [f64; 6] {
    let n = normal;
    [
        p[1] * n[2] - p[2] * n[1],
        p[2] * n[0] - p[0] * n[2],
        p[0] * n[1] - p[1] * n[0],
        n[0],
        n[1],
        n[2],
    ]
}

#[inline]
fn along(v: &Point, normal: &Point) -> f64 {
    v[0] * normal[0] + v[1] * normal[1] + v[2] * normal[2]
}

fn add_all(sums: &mut [f64], others: &[f64]) {
    for (sum, other) in sums.iter_mut().zip(others) {
        *sum += other;
    }
}

/// Solves information · step = −gradient; `None` without a finite answer.
///
/// The first `n_turning` parameters turn, the next `n_shifting` shift, the rest scale. Each kind is
/// damped by a trifle of its own mean, because their sizes differ by the square of the clouds' unit.
fn damped_step<const N: usize>(
    mut information: SMatrix<f64, N, N>,
    gradient: SVector<f64, N>,
    n_turning: usize,
    n_shifting: usize,
) -> Option<SVector<f64, N>> {
    const RELATIVE_DAMPING: f64 = 1e-9;
    let unscaled = n_turning + n_shifting;
    for motion in [0..n_turning, n_turning..unscaled, unscaled..N] {
        let n = motion.len().max(1) as f64;
        let mean = motion.clone().map(|i| information[(i, i)]).sum::<f64>() / n;
        if !mean.is_finite() || (mean <= 0.0 && motion.start == n_turning) {
            return None;
        }
        for i in motion {
            // What no plane sees at all stays where it is: any damping will do.
            information[(i, i)] += if mean > 0.0 {
                RELATIVE_DAMPING * mean
            } else {
                1.0
            };
        }
    }
    let step = -information.cholesky()?.solve(&gradient);
    step.iter().all(|v| v.is_finite()).then_some(step)
}

fn rigid_step(rotation_rad: [f64; 3], translation: [f64; 3]) -> Rigid {
    Rigid::from_rotation_vector(Vector3::from(rotation_rad), Vector3::from(translation))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Stream;

    #[test]
    fn a_shift_along_z_is_undone_in_one_step() {
        // Points of three faces of a cube, moved by (0, 0, 0.1): the exact answer is −0.1 in z.
        let mut sums = PlaneSums::default();
        for (u, v) in [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)] {
            for axis in 0..3 {
                let mut partner = [0.0; 3];
                partner[(axis + 1) % 3] = u;
                partner[(axis + 2) % 3] = v;
                let mut normal = [0.0; 3];
                normal[axis] = 1.0;
                let moved = [partner[0], partner[1], partner[2] + 0.1];
                sums.add(&moved, &partner, &normal, 1.0);
            }
        }
        let step = sums.solve().unwrap();
        assert!((step.translation - Vector3::new(0.0, 0.0, -0.1)).amax() < 1e-8);
        assert!(step.rotation_angle_rad() < 1e-8);
    }

    #[test]
    fn a_single_plane_moves_only_along_its_normal() {
        let mut sums = PlaneSums::default();
        for (x, y) in [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0), (-1.0, 0.3)] {
            sums.add(&[x, y, 0.2], &[x, y, 0.0], &[0.0, 0.0, 1.0], 1.0);
        }
        let step = sums.solve().unwrap();
        assert!((step.translation - Vector3::new(0.0, 0.0, -0.2)).amax() < 1e-6);
        assert!(PlaneSums::default().solve().is_none());
    }

    /// Points on a bumpy ball, their normals, and their partners at a small motion away.
    fn ball(motion: &Similarity) -> Vec<(Point, Point, Point)> {
        let mut stream = Stream::new(3, "ball", 0);
        (0..200)
            .map(|_| {
                let n = Vector3::from([0; 3].map(|_| stream.normal())).normalize();
                let p = n * (2.0 + 0.3 * stream.normal());
                let tilt = Vector3::from([0; 3].map(|_| 0.3 * stream.normal()));
                let partner = motion.apply(&p.into());
                let normal = motion.rigid.rotation * (n + tilt).normalize();
                (p.into(), partner, normal.into())
            })
            .collect()
    }

    #[test]
    fn a_levelled_step_is_the_best_one_about_z() {
        let motion = Rigid::from_euler([0.0, 0.0, 1e-4], [1e-4, -2e-4, 3e-4]);
        let mut sums = PlaneSums::default();
        for (p, q, n) in ball(&motion.into()) {
            sums.add(&p, &q, &n, 1.0);
        }
        let step = sums.solve_levelled().unwrap();
        assert!((step.rotation - motion.rotation).amax() < 1e-7);
        assert!((step.translation - motion.translation).amax() < 1e-7);
        assert_eq!(step.rotation[(2, 2)], 1.0);
        // Its equations are rows and columns 3 to 6 of the full ones, without the damping.
        let (a, g) = (sums.information(), sums.gradient);
        let a = a.fixed_view::<4, 4>(2, 2).into_owned();
        let x = -a
            .lu()
            .solve(&SVector::<f64, 4>::from_row_slice(&g[2..]))
            .unwrap();
        assert!((step.translation - Vector3::new(x[1], x[2], x[3])).amax() < 1e-11);
        // A level floor: nothing says how to turn, and only z moves.
        let mut floor = PlaneSums::default();
        floor.add(&[1.0, 0.0, 0.2], &[1.0, 0.0, 0.0], &[0.0, 0.0, 1.0], 1.0);
        floor.add(&[-1.0, 2.0, 0.2], &[-1.0, 2.0, 0.0], &[0.0, 0.0, 1.0], 1.0);
        let step = floor.solve_levelled().unwrap();
        assert_eq!(step.rotation, nalgebra::Matrix3::identity());
        assert!((step.translation - Vector3::new(0.0, 0.0, -0.2)).amax() < 1e-6);
        assert!(PlaneSums::default().solve_levelled().is_none());
    }

    #[test]
    fn a_step_about_any_axis_is_the_levelled_one_seen_from_elsewhere() {
        let tilt = Rigid::from_euler([0.7, -0.4, 1.3], [0.0; 3]);
        let mut stream = Stream::new(1, "axis", 0);
        let (mut upright, mut tilted) = (PlaneSums::default(), PlaneSums::default());
        for _ in 0..30 {
            let p = [0; 3].map(|_| stream.normal());
            let q = p.map(|v| v + 0.05 * stream.normal());
            let normal = Vector3::from([0; 3].map(|_| stream.normal()))
                .normalize()
                .into();
            upright.add(&p, &q, &normal, 1.0);
            tilted.add(&tilt.apply(&p), &tilt.apply(&q), &tilt.rotate(&normal), 1.0);
        }
        let expected = tilt * upright.solve_levelled().unwrap() * tilt.inverse();
        let axis = tilt.rotation.column(2).into_owned();
        let found = tilted.solve_about(&axis).unwrap();
        assert!((found.rotation - expected.rotation).amax() < 1e-12);
        assert!((found.translation - expected.translation).amax() < 1e-12);
        assert!((found.rotation * axis - axis).amax() < 1e-12);
    }

    #[test]
    fn a_step_with_a_scale_finds_all_seven() {
        let motion = Similarity {
            scale: 1.0003,
            rigid: Rigid::from_euler([1e-4, -2e-4, 3e-4], [1e-4, -2e-4, 3e-4]),
        };
        let (mut sums, mut halves) = (ScaledPlaneSums::default(), [ScaledPlaneSums::default(); 2]);
        let mut rigid = PlaneSums::default();
        for (i, (p, q, n)) in ball(&motion).iter().enumerate() {
            sums.add(p, q, n, 0.5);
            halves[i % 2].add(p, q, n, 0.5);
            rigid.add(p, q, n, 0.5);
        }
        let step = sums.solve(Freedom::Similarity).unwrap();
        assert!((step.scale - motion.scale).abs() < 1e-6);
        assert!((step.rigid.rotation - motion.rigid.rotation).amax() < 1e-6);
        assert!((step.rigid.translation - motion.rigid.translation).amax() < 1e-6);
        // What lies in its first six rows is the rigid step's.
        let seven = sums.information();
        assert_eq!(seven.fixed_view::<6, 6>(0, 0), rigid.information());
        assert_eq!(seven, seven.transpose());
        assert_eq!((sums.weight(), sums.rigid().weight()), (100.0, 100.0));
        let mut joined = halves[0];
        joined.merge(&halves[1]);
        assert!((joined.solve(Freedom::Similarity).unwrap().scale - step.scale).abs() < 1e-12);
        assert!(
            ScaledPlaneSums::default()
                .solve(Freedom::Similarity)
                .is_none()
        );
    }

    #[test]
    fn a_matrix_weighs_like_its_planes() {
        // W = 2·a·aᵀ + 0.5·b·bᵀ is two planes through the partner.
        let mut stream = Stream::new(4, "weighed", 0);
        let mut draw = || -> Point { [0; 3].map(|_| stream.normal()) };
        let (mut by_planes, mut by_matrix) =
            (ScaledPlaneSums::default(), ScaledPlaneSums::default());
        for _ in 0..20 {
            let (p, q, a, b) = (draw(), draw(), draw(), draw());
            by_planes.add(&p, &q, &a, 2.0);
            by_planes.add(&p, &q, &b, 0.5);
            let w = |r: usize, c: usize| 2.0 * a[r] * a[c] + 0.5 * b[r] * b[c];
            let w = [w(0, 0), w(1, 0), w(1, 1), w(2, 0), w(2, 1), w(2, 2)];
            by_matrix.add_weighed(&p, &q, w);
        }
        let difference = by_planes.information() - by_matrix.information();
        assert!(difference.amax() < 1e-12 * by_planes.information().amax());
        let [a, b] = [by_planes, by_matrix].map(|sums| sums.solve(Freedom::Similarity).unwrap());
        assert!((a.scale - b.scale).abs() < 1e-12);
        assert!((a.rigid.translation - b.rigid.translation).amax() < 1e-12);
        assert!((a.rigid.rotation - b.rigid.rotation).amax() < 1e-12);
    }
}
