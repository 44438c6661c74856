//! How accurate a fine pose is: its covariance, and what that means for a point.
//!
//! Why: the usual σ²·(JᵀJ)⁻¹ counts every pair as an observation of its own and promises a tenth of a
//! millimetre. Neighbouring residuals share normals, partners and the errors of their sensors; and a
//! noisy normal looks like a slope that could hold a pose on a flat floor.
//! Source: the sandwich estimator with clusters (Liang & Zeger 1986), cells of space as clusters; the
//! information of noisy normals corrected as in errors-in-variables (Fuller 1987, Section 1.2).
//! Deviates: the size of a cell is the one that gives the largest uncertainty.
//! Absent on purpose: which pairs count; errors that both clouds share, such as a wrong scale bar.

use nalgebra::{SMatrix, SVector, SymmetricEigen};

use crate::cloud::Point;
use crate::freedom::Freedom;
use crate::parallel;
use crate::point_to_plane::{ScaledPlaneSums, motion_along};

type Matrix7 = SMatrix<f64, 7, 7>;
type Vector7 = SVector<f64, 7>;

/// A point and the plane of its partner, about the middle of the pairs.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlanePair {
    /// The moved source point.
    pub point: Point,
    /// Unit normal of the plane.
    pub normal: Point,
    /// Distance from the plane, signed.
    pub residual_m: f64,
    /// What the pair weighs in the fit: its pull is weight · residual.
    pub weight: f64,
    /// How its pull grows with the residual: the weight itself for least squares, less (and below 0)
    /// where a robust kernel lets go.
    pub stiffness: f64,
    /// Variance of the slope of the normal in each direction.
    pub slope_variance: f64,
}

/// The covariance of a pose.
#[derive(Debug, Clone, PartialEq)]
pub struct PoseUncertainty {
    /// The place, in the target, about which it is stated: near the middle of the pairs.
    pub middle: Point,
    /// Rotation about the target's axes (radians), shift of the middle, logarithm of the scale; rows
    /// of zeros for what was not free.
    pub covariance: Matrix7,
    /// The 1σ displacement of a point by the errors of the pose: in all directions together, root mean
    /// square over the points of the overlap, with what the planes would still move the pose by (nothing
    /// to speak of, unless the fit was point-to-point). About the radius of the overlap where the common
    /// surface leaves a direction open.
    ///
    /// It is the term "reg" of the level of detection of M3C2, 1.96·(√(σ₁²/n₁ + σ₂²/n₂) + reg): a
    /// change of the surface that is smaller cannot be told from a wrong pose. Along one direction,
    /// such as the normal there, the displacement is smaller, by 1/√3 where all are alike.
    pub registration_error_m: f64,
    /// Standard error of the scale, relative to it; `None` where it was not free.
    pub scale_standard_error: Option<f64>,
    /// Root mean squared, weighted distance of the pairs from their planes.
    pub residual_m: f64,
    /// Pairs that had a say.
    pub n_pairs: usize,
    /// Cells of space that count as one observation each.
    pub n_cells: usize,
}

impl PoseUncertainty {
    /// From the pairs of a fit that came to rest. `known` is the information of other observations
    /// about the same middle, `smallest_cell_m` the edge of the smallest cells, some spacings of the
    /// points. `None` where fewer than twice as many cells are occupied as parameters are free.
    ///
    /// ```
    /// use tmchho::{freedom::Freedom, random::Stream, uncertainty::{PlanePair, PoseUncertainty}};
    /// // Three walls of a room, 1 cm of noise.
    /// let mut stream = Stream::new(1, "room", 0);
    /// let pairs: Vec<PlanePair> = (0..3000).map(|i| {
    ///     let mut point = [0; 3].map(|_| stream.uniform_between(-5.0, 5.0));
    ///     let mut normal = [0.0; 3];
    ///     (point[i % 3], normal[i % 3]) = (-5.0, 1.0);
    ///     let residual_m = 0.01 * stream.normal();
    ///     PlanePair { point, normal, residual_m, weight: 1.0, stiffness: 1.0, slope_variance: 0.0 }
    /// }).collect();
    /// let none = Default::default();
    /// let found = PoseUncertainty::of_pairs(&pairs, [0.0; 3], Freedom::Rigid, &none, 0.5).unwrap();
    /// assert!((3e-4..3e-3).contains(&found.registration_error_m));
    /// ```
    pub fn of_pairs(
        pairs: &[PlanePair],
        middle: Point,
        freedom: Freedom,
        known: &ScaledPlaneSums,
        smallest_cell_m: f64,
    ) -> Option<Self> {
        let fit = Fit::of(pairs, freedom)?;
        let known = known.information();
        let cells = cells(pairs, smallest_cell_m);
        let levels = std::iter::successors(Some(cells), |cells| Some(coarser(cells)));
        let worst = levels
            .take(N_LEVELS)
            .map_while(|cells| fit.within_cells(&cells, &known))
            .max_by(|a, b| a.0.total_cmp(&b.0));
        let (registration_error_m, covariance, n_cells) = worst?;
        Some(Self {
            middle,
            covariance,
            registration_error_m,
            scale_standard_error: (freedom == Freedom::Similarity)
                .then(|| covariance[(6, 6)].sqrt()),
            residual_m: fit.residual_m,
            n_pairs: pairs.len(),
            n_cells,
        })
    }

    /// The covariance of where a place of the target comes to lie.
    pub fn at(&self, place: &Point) -> SMatrix<f64, 3, 3> {
        let p = std::array::from_fn(|axis| place[axis] - self.middle[axis]);
        let mut shifts = SMatrix::<f64, 3, 7>::zeros();
        for axis in 0..3 {
            let mut along = [0.0; 3];
            along[axis] = 1.0;
            shifts.set_row(axis, &row_of(&p, &along).transpose());
        }
        shifts * self.covariance * shifts.transpose()
    }
}

/// The variance of a pair of weight 1 that would give the same covariance if pairs were independent,
/// by which other observations are weighed against them. `None` where there are too few cells.
pub fn effective_variance(pairs: &[PlanePair], freedom: Freedom, cell_m: f64) -> Option<f64> {
    let fit = Fit::of(pairs, freedom)?;
    let scores = fit.scores(&cells(pairs, cell_m))?;
    let inverse = freedom.inverse_of_free(&fit.information)?;
    Some((inverse * scores).trace() / f64::from(freedom.dof()))
}

/// The motions that nothing but the noise of normals seems to hold, as rows of a step about the middle
/// of the pairs: a flat floor slides. `known` is the information of other observations.
pub fn open_motions(
    pairs: &[PlanePair],
    freedom: Freedom,
    known: &ScaledPlaneSums,
) -> Vec<[f64; 7]> {
    let Some(fit) = Fit::of(pairs, freedom) else {
        return Vec::new();
    };
    let mut open = fit.directions(&known.information());
    open.retain(|direction| direction.held.is_none());
    // A motion m has the part Σ u·m/scale along a direction u of the scaled parameters.
    let row = |direction: Direction| -> [f64; 7] {
        std::array::from_fn(|i| match fit.scale(i) {
            0.0 => 0.0,
            scale => direction.along[i] / scale,
        })
    };
    open.into_iter().map(row).collect()
}

/// What a pass over the pairs leaves.
#[derive(Default)]
struct FitSums {
    information: ScaledPlaneSums,
    of_noise: ScaledPlaneSums,
    displacement: ScaledPlaneSums,
    pull: Vector7,
    squared: f64,
    weight: f64,
}

impl FitSums {
    fn of(pairs: &[PlanePair], usual_variance: f64) -> Self {
        let mut sums = Self::default();
        for pair in pairs {
            let (p, n) = (&pair.point, &pair.normal);
            sums.information.add(p, p, n, pair.stiffness);
            sums.pull -= row_of(p, n) * (pair.weight * pair.residual_m);
            let noise = pair.stiffness * pair.slope_variance.max(usual_variance);
            let across = |r: usize, c: usize| noise * (f64::from(u8::from(r == c)) - n[r] * n[c]);
            let across =
                [(0, 0), (1, 0), (1, 1), (2, 0), (2, 1), (2, 2)].map(|(r, c)| across(r, c));
            sums.of_noise.add_weighed(p, p, across);
            sums.displacement
                .add_weighed(p, p, [1.0, 0.0, 1.0, 0.0, 0.0, 1.0]);
            sums.squared += pair.weight * pair.residual_m * pair.residual_m;
            sums.weight += pair.weight;
        }
        sums
    }

    fn merge(&mut self, other: &Self) {
        self.information.merge(&other.information);
        self.of_noise.merge(&other.of_noise);
        self.displacement.merge(&other.displacement);
        self.pull += other.pull;
        self.squared += other.squared;
        self.weight += other.weight;
    }
}

/// How the pairs hold the pose.
struct Fit {
    freedom: Freedom,
    information: Matrix7,
    /// What all pairs together pull, the negative of the gradient.
    pull: Vector7,
    /// What of the information is noise of the normals.
    of_noise: Matrix7,
    /// Mean over the points of how a motion displaces them: displacement² = motionᵀ · this · motion.
    displacement: Matrix7,
    residual_m: f64,
}

impl Fit {
    fn of(pairs: &[PlanePair], freedom: Freedom) -> Option<Self> {
        let usual_variance = median_slope_variance(pairs);
        let chunks = parallel::map_chunks(pairs, |pairs| FitSums::of(pairs, usual_variance));
        let mut all = FitSums::default();
        chunks.iter().for_each(|chunk| all.merge(chunk));
        let residual_m = (all.squared / all.weight).sqrt();
        residual_m.is_finite().then(|| Self {
            freedom,
            information: all.information.information(),
            pull: all.pull,
            of_noise: all.of_noise.information(),
            displacement: all.displacement.information() / pairs.len() as f64,
            residual_m,
        })
    }

    /// Σ over the cells of the outer product of what each pulls; `None` for too few cells.
    fn scores(&self, cells: &[Cell]) -> Option<Matrix7> {
        let (n, p) = (cells.len() as f64, f64::from(self.freedom.dof()));
        if n < 2.0 * p {
            return None;
        }
        let mut scores = Matrix7::zeros();
        for cell in cells {
            scores += cell.pull * cell.pull.transpose();
        }
        // A fit to few cells leaves residuals that are too small.
        Some(scores * (n / (n - p)))
    }

    /// The 1σ displacement, the covariance and the number of cells.
    fn within_cells(&self, cells: &[Cell], known: &Matrix7) -> Option<(f64, Matrix7, usize)> {
        let scores = self.scores(cells)?;
        let variance = (self.freedom.inverse_of_free(&self.information)? * scores).trace()
            / f64::from(self.freedom.dof());
        let (bread, open) = self.bread(&(variance * known))?;
        let covariance = bread * (scores + variance * variance * known) * bread + open;
        let step = bread * self.pull;
        let error_sq = (self.displacement * covariance).trace()
            + (step.transpose() * self.displacement * step)[0];
        Some((error_sq.max(0.0).sqrt(), covariance, cells.len()))
    }

    /// The inverse of the information, without what noisy normals feign and with what is `known`
    /// beside the clouds; and the covariance of what is open.
    fn bread(&self, known: &Matrix7) -> Option<(Matrix7, Matrix7)> {
        let (mut inverse, mut open) = (Matrix7::zeros(), Matrix7::zeros());
        for Direction { along, held } in self.directions(known) {
            let outer = along * along.transpose();
            match held {
                Some(information) => inverse += outer / information,
                None => open += outer * self.radius_m().powi(2),
            }
        }
        (self.radius_m() > 0.0).then(|| (self.scaled(&inverse), self.scaled(&open)))
    }

    /// The principal directions of what holds the pose.
    fn directions(&self, known: &Matrix7) -> Vec<Direction> {
        /// A direction is open if less than this share of its information is real.
        const LEAST_REAL: f64 = 0.5;
        let all = self.scaled(&(self.information + known));
        let real = SymmetricEigen::new(all - self.scaled(&self.of_noise));
        let least = 1e-12 * all.trace();
        let direction = |i: usize| {
            let (along, information) = (
                real.eigenvectors.column(i).into_owned(),
                real.eigenvalues[i],
            );
            let with_noise = (along.transpose() * all * along)[0];
            let is_held = information > (LEAST_REAL * with_noise).max(least);
            Direction {
                along,
                held: is_held.then_some(information),
            }
        };
        // What is not free stands in directions of its own, all zero.
        let is_free = |direction: &Direction| {
            (0..7).any(|i| self.scale(i) > 0.0 && direction.along[i].abs() > 1e-9)
        };
        (0..7).map(direction).filter(is_free).collect()
    }

    /// Root mean squared distance of the points from the middle.
    fn radius_m(&self) -> f64 {
        self.displacement[(6, 6)].sqrt()
    }

    /// Turning and growing are measured as arcs at the radius; what is not free is left out.
    fn scale(&self, parameter: usize) -> f64 {
        match parameter {
            i if !self.freedom.free().contains(&i) => 0.0,
            3..6 => 1.0,
            _ => 1.0 / self.radius_m(),
        }
    }

    fn scaled(&self, matrix: &Matrix7) -> Matrix7 {
        Matrix7::from_fn(|r, c| matrix[(r, c)] * self.scale(r) * self.scale(c))
    }
}

/// A direction of the scaled parameters, with the information that holds it; `None` if it is open.
struct Direction {
    along: Vector7,
    held: Option<f64>,
}

/// Points that scatter little by chance claim good normals, but have the same as their like.
fn median_slope_variance(pairs: &[PlanePair]) -> f64 {
    let mut variances: Vec<f64> = pairs.iter().map(|pair| pair.slope_variance).collect();
    let middle = variances.len() / 2;
    if variances.is_empty() {
        return 0.0;
    }
    *variances.select_nth_unstable_by(middle, f64::total_cmp).1
}

fn row_of(point: &Point, normal: &Point) -> Vector7 {
    let [a, b, c, d, e, f] = motion_along(point, normal);
    let growth = point[0] * normal[0] + point[1] * normal[1] + point[2] * normal[2];
    SVector::from([a, b, c, d, e, f, growth])
}

/// Sizes of cells that are tried, each twice as large as the one before.
const N_LEVELS: usize = 7;

/// A cell of space, and what its pairs pull together.
struct Cell {
    /// The bits of its place along the three axes in turn, so that a coarser cell is a shorter number.
    code: u64,
    pull: Vector7,
}

/// The occupied cells of edge `edge_m`, by code.
fn cells(pairs: &[PlanePair], edge_m: f64) -> Vec<Cell> {
    /// Bits of a place along an axis.
    const BITS: u32 = 21;
    let code = |p: &Point| -> u64 {
        let place = p.map(|v| (v / edge_m).floor() as i64 + (1 << (BITS - 1)));
        (0..3).fold(0, |code, axis| {
            code | (apart(place[axis] as u64 & ((1 << BITS) - 1)) << axis)
        })
    };
    let mut order: Vec<(u64, u32)> = parallel::map_chunks(pairs, |pairs| {
        pairs
            .iter()
            .map(|pair| code(&pair.point))
            .collect::<Vec<_>>()
    })
    .into_iter()
    .flatten()
    .zip(0..)
    .collect();
    parallel::sort_unstable(&mut order);
    let cells: Vec<&[(u64, u32)]> = order.chunk_by(|a, b| a.0 == b.0).collect();
    parallel::map(cells.len(), |cell| {
        let mut pull = Vector7::zeros();
        for (_, i) in cells[cell] {
            let pair = &pairs[*i as usize];
            pull += row_of(&pair.point, &pair.normal) * (pair.weight * pair.residual_m);
        }
        Cell {
            code: cells[cell][0].0,
            pull,
        }
    })
}

/// The cells of twice the edge.
fn coarser(cells: &[Cell]) -> Vec<Cell> {
    let of_one = |cells: &[Cell]| Cell {
        code: cells[0].code >> 3,
        pull: cells.iter().map(|cell| cell.pull).sum(),
    };
    cells
        .chunk_by(|a, b| a.code >> 3 == b.code >> 3)
        .map(of_one)
        .collect()
}

/// The lowest 21 bits of a number, two zeros after each.
fn apart(bits: u64) -> u64 {
    const STEPS: [(u32, u64); 5] = [
        (32, 0x001f_0000_0000_ffff),
        (16, 0x001f_0000_ff00_00ff),
        (8, 0x100f_00f0_0f00_f00f),
        (4, 0x10c3_0c30_c30c_30c3),
        (2, 0x1249_2492_4924_9249),
    ];
    let spread = |bits: u64, (shift, mask): (u32, u64)| (bits | (bits << shift)) & mask;
    STEPS.into_iter().fold(bits, spread)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Stream;

    /// Pairs on the walls of a room of 10 m; residuals of neighbours within `patch_m` are alike.
    fn room(n: usize, noise_m: f64, patch_m: f64, seed: u64) -> Vec<PlanePair> {
        let mut stream = Stream::new(seed, "room", 0);
        let waves: Vec<Point> = (0..40)
            .map(|_| [0; 3].map(|_| stream.normal() / patch_m))
            .collect();
        let phases: Vec<f64> = (0..40).map(|_| 7.0 * stream.uniform()).collect();
        let pair = |i: usize| {
            let mut point = [0; 3].map(|_| stream.uniform_between(-5.0, 5.0));
            let mut normal = [0.0; 3];
            (point[i % 3], normal[i % 3]) = (if i.is_multiple_of(2) { -5.0 } else { 5.0 }, 1.0);
            // A smooth random field with the standard deviation of the noise.
            let wave = |(w, phase): (&Point, &f64)| {
                (w[0] * point[0] + w[1] * point[1] + w[2] * point[2] + phase).sin()
            };
            let field: f64 = waves.iter().zip(&phases).map(wave).sum();
            PlanePair {
                point,
                normal,
                residual_m: noise_m * field * (2.0_f64 / 40.0).sqrt(),
                weight: 1.0,
                stiffness: 1.0,
                slope_variance: 0.0,
            }
        };
        (0..n).map(pair).collect()
    }

    #[test]
    fn cells_are_those_of_a_plain_grid_at_every_size() {
        let mut stream = Stream::new(4, "cells", 0);
        let pairs = room(2000, 0.02, 0.5, 4);
        let edge_m = 0.01 + stream.uniform();
        let mut found = cells(&pairs, edge_m);
        for level in 0..N_LEVELS as i32 {
            let place = |pair: &PlanePair| {
                let cell = pair.point.map(|v| (v / edge_m).floor() as i64);
                cell.map(|v| v.div_euclid(2_i64.pow(level as u32)))
            };
            let plain: std::collections::BTreeSet<[i64; 3]> = pairs.iter().map(place).collect();
            // Twice the edge halves the places about a corner of the grid, as here.
            assert_eq!(found.len(), plain.len(), "{level}");
            let all: Vector7 = found.iter().map(|cell| cell.pull).sum();
            assert!((all + Fit::of(&pairs, Freedom::Rigid).unwrap().pull).norm() < 1e-9);
            found = coarser(&found);
        }
    }

    /// The displacement, squared and averaged over the points, that a fit to the residuals makes.
    fn displacement_sq(pairs: &[PlanePair]) -> f64 {
        let fit = Fit::of(pairs, Freedom::Rigid).unwrap();
        let step = Freedom::Rigid.inverse_of_free(&fit.information).unwrap() * fit.pull;
        (step.transpose() * fit.displacement * step)[0]
    }

    #[test]
    fn residuals_that_hang_together_do_not_count_as_many() {
        for (patch_m, n_trials) in [(0.05, 40), (0.7, 40)] {
            let (mut errors, mut promised, mut naive) = (0.0, 0.0, 0.0);
            for seed in 0..n_trials {
                let mut pairs = room(3000, 0.02, patch_m, seed);
                errors += displacement_sq(&pairs);
                // At rest nothing pulls: take the fit out of the residuals.
                let fit = Fit::of(&pairs, Freedom::Rigid).unwrap();
                let step = Freedom::Rigid.inverse_of_free(&fit.information).unwrap() * fit.pull;
                for pair in &mut pairs {
                    pair.residual_m += row_of(&pair.point, &pair.normal).dot(&step);
                }
                let none = ScaledPlaneSums::default();
                let of = PoseUncertainty::of_pairs;
                let found = of(&pairs, [0.0; 3], Freedom::Rigid, &none, 0.6).unwrap();
                promised += found.registration_error_m.powi(2);
                let inverse = Freedom::Rigid.inverse_of_free(&fit.information).unwrap();
                naive += (fit.displacement * inverse).trace() * fit.residual_m.powi(2);
            }
            let ratio = (errors / promised).sqrt();
            assert!((0.6..1.3).contains(&ratio), "{patch_m}: {ratio}");
            // The usual formula is right for the one, and far too proud for the other.
            let of_naive = (errors / naive).sqrt();
            assert_eq!(of_naive > 2.0, patch_m > 0.5, "{patch_m}: {of_naive}");
        }
    }

    #[test]
    fn a_floor_is_open_however_noisy_its_normals() {
        let mut stream = Stream::new(2, "floor", 0);
        let slope = 0.01;
        let pairs: Vec<PlanePair> = (0..4000)
            .map(|_| {
                let (x, y) = (
                    stream.uniform_between(-9.0, 9.0),
                    stream.uniform_between(-9.0, 9.0),
                );
                let n =
                    nalgebra::Vector3::new(slope * stream.normal(), slope * stream.normal(), 1.0);
                PlanePair {
                    point: [x, y, 0.0],
                    normal: n.normalize().into(),
                    residual_m: 0.01 * stream.normal(),
                    weight: 1.0,
                    stiffness: 1.0,
                    slope_variance: slope * slope,
                }
            })
            .collect();
        let none = ScaledPlaneSums::default();
        let open = open_motions(&pairs, Freedom::Rigid, &none);
        assert_eq!(open.len(), 3, "x, y and the turn about z");
        for row in &open {
            let [tilt_x, tilt_y, _, _, _, z, _] = row.map(f64::abs);
            assert!(tilt_x < 0.5 && tilt_y < 0.5 && z < 0.1, "{row:?}");
        }
        let of = PoseUncertainty::of_pairs;
        let found = of(&pairs, [0.0; 3], Freedom::Rigid, &none, 1.0).unwrap();
        assert!(found.registration_error_m > 5.0);
        // Up and down it is held, but for the slight slope that open motions have.
        let height_m = found.at(&[0.0; 3])[(2, 2)].sqrt();
        assert!((1e-4..1e-2).contains(&height_m), "{height_m}");
        // Control points close it.
        let mut known = ScaledPlaneSums::default();
        for p in [[5.0, 0.0, 0.0], [-5.0, 3.0, 0.0], [0.0, -4.0, 0.0]] {
            known.add_weighed(&p, &p, [1e4, 0.0, 1e4, 0.0, 0.0, 1e4]);
        }
        assert!(open_motions(&pairs, Freedom::Rigid, &known).is_empty());
        let found = of(&pairs, [0.0; 3], Freedom::Rigid, &known, 1.0).unwrap();
        let wanted = (2.0 * 1e-4 / 3.0_f64).sqrt();
        assert!((0.9 * wanted..3.0 * wanted).contains(&found.registration_error_m));
    }

    #[test]
    fn what_is_not_free_has_no_variance_and_few_cells_give_none() {
        let pairs = room(600, 0.02, 0.1, 9);
        let none = ScaledPlaneSums::default();
        let with =
            |freedom| PoseUncertainty::of_pairs(&pairs, [0.0; 3], freedom, &none, 0.6).unwrap();
        let levelled = with(Freedom::Levelled);
        for (i, variance) in levelled.covariance.diagonal().iter().enumerate() {
            assert_eq!(*variance > 0.0, (2..6).contains(&i), "{i}");
        }
        assert_eq!(levelled.scale_standard_error, None);
        let error = with(Freedom::Similarity).scale_standard_error.unwrap();
        // 1/√(Σ (p·n)²) of 600 points, 5 m from the middle along their normals.
        let wanted = 0.02 / (5.0 * 600.0_f64.sqrt());
        assert!(
            (0.5 * wanted..2.0 * wanted).contains(&error),
            "{error} {wanted}"
        );
        assert!(levelled.registration_error_m < with(Freedom::Rigid).registration_error_m);
        let of = PoseUncertainty::of_pairs;
        assert!(of(&pairs[..8], [0.0; 3], Freedom::Rigid, &none, 0.6).is_none());
        assert!(of(&[], [0.0; 3], Freedom::Rigid, &none, 0.6).is_none());
    }
}
