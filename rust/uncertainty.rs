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

/// A point and the plane of its partner, about the middle of the pairs.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlanePair {
    /// The moved source point.
    pub point: Point,
    /// Unit normal of the plane.
    pub normal: Point,
    /// Distance from the plane, signed.
    pub residual_m: f64,
    /// What the pair weighs in the fit.
    pub weight: f64,
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
    /// square over the points of the overlap. About the radius of the overlap where the common
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
    ///     PlanePair { point, normal, residual_m, weight: 1.0, slope_variance: 0.0 }
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
        let worst = cells(pairs, smallest_cell_m)
            .iter()
            .map_while(|level| fit.within_cells(pairs, level, &known))
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
    let scores = fit.scores(pairs, cells(pairs, cell_m).first()?)?;
    let inverse = freedom.inverse_of_free(&fit.information)?;
    Some((inverse * scores).trace() / f64::from(freedom.dof()))
}

/// How the pairs hold the pose.
struct Fit {
    freedom: Freedom,
    information: Matrix7,
    /// What of the information is noise of the normals.
    of_noise: Matrix7,
    /// Mean over the points of how a motion displaces them: displacement² = motionᵀ · this · motion.
    displacement: Matrix7,
    residual_m: f64,
}

impl Fit {
    fn of(pairs: &[PlanePair], freedom: Freedom) -> Option<Self> {
        let mut sums = [ScaledPlaneSums::default(); 3];
        let (mut squared, mut weight) = (0.0, 0.0);
        for pair in pairs {
            let (p, n) = (&pair.point, &pair.normal);
            sums[0].add(p, p, n, pair.weight);
            let noise = pair.weight * pair.slope_variance;
            let across = |r: usize, c: usize| noise * (f64::from(u8::from(r == c)) - n[r] * n[c]);
            let across =
                [(0, 0), (1, 0), (1, 1), (2, 0), (2, 1), (2, 2)].map(|(r, c)| across(r, c));
            sums[1].add_weighed(p, p, across);
            sums[2].add_weighed(p, p, [1.0, 0.0, 1.0, 0.0, 0.0, 1.0]);
            squared += pair.weight * pair.residual_m * pair.residual_m;
            weight += pair.weight;
        }
        let [information, of_noise, displacement] = sums.map(|sums| sums.information());
        let residual_m = (squared / weight).sqrt();
        residual_m.is_finite().then(|| Self {
            freedom,
            information,
            of_noise,
            displacement: displacement / pairs.len() as f64,
            residual_m,
        })
    }

    /// Σ over the cells of the outer product of what each pulls; `None` for too few cells.
    fn scores(&self, pairs: &[PlanePair], cells: &[Vec<u32>]) -> Option<Matrix7> {
        let (n, p) = (cells.len() as f64, f64::from(self.freedom.dof()));
        if n < 2.0 * p {
            return None;
        }
        let mut scores = Matrix7::zeros();
        for cell in cells {
            let mut pull = SVector::<f64, 7>::zeros();
            for &i in cell {
                let pair = &pairs[i as usize];
                pull += row_of(&pair.point, &pair.normal) * (pair.weight * pair.residual_m);
            }
            scores += pull * pull.transpose();
        }
        // A fit to few cells leaves residuals that are too small.
        Some(scores * (n / (n - p)))
    }

    /// The 1σ displacement, the covariance and the number of cells.
    fn within_cells(
        &self,
        pairs: &[PlanePair],
        cells: &[Vec<u32>],
        known: &Matrix7,
    ) -> Option<(f64, Matrix7, usize)> {
        let scores = self.scores(pairs, cells)?;
        let variance = (self.freedom.inverse_of_free(&self.information)? * scores).trace()
            / f64::from(self.freedom.dof());
        let (bread, open) = self.bread(&(variance * known))?;
        let covariance = bread * (scores + variance * variance * known) * bread + open;
        let error_sq = (self.displacement * covariance).trace();
        Some((error_sq.max(0.0).sqrt(), covariance, cells.len()))
    }

    /// The inverse of the information, without what noisy normals feign and with what is `known`
    /// beside the clouds; and the covariance of what is open.
    fn bread(&self, known: &Matrix7) -> Option<(Matrix7, Matrix7)> {
        /// A direction is open if less than this share of its information is real.
        const LEAST_REAL: f64 = 0.1;
        let trace = |range: std::ops::Range<usize>| -> f64 {
            range.map(|i| self.displacement[(i, i)]).sum()
        };
        // Turning and growing as arcs at the mean radius.
        let radius_m = trace(6..7).sqrt();
        let free = self.freedom.free();
        let scale = |i: usize| match i {
            _ if !free.contains(&i) => 0.0,
            3..6 => 1.0,
            _ => 1.0 / radius_m,
        };
        let scaled = |m: &Matrix7| Matrix7::from_fn(|r, c| m[(r, c)] * scale(r) * scale(c));
        let feigned = scaled(&(self.information + known));
        let real = scaled(&(self.information + known - self.of_noise));
        let eigen = SymmetricEigen::new(real);
        let least = 1e-12 * feigned.trace();
        let (mut inverse, mut open) = (Matrix7::zeros(), Matrix7::zeros());
        for (i, direction) in eigen.eigenvectors.column_iter().enumerate() {
            // What is not free stands in directions of its own, all zero.
            let of_feigned = (direction.transpose() * feigned * direction)[0];
            let is_free = (0..7).any(|axis| free.contains(&axis) && direction[axis].abs() > 1e-9);
            let outer = direction * direction.transpose();
            if eigen.eigenvalues[i] > (LEAST_REAL * of_feigned).max(least) {
                inverse += outer / eigen.eigenvalues[i];
            } else if is_free {
                open += outer * (radius_m * radius_m);
            }
        }
        (radius_m > 0.0).then(|| (scaled(&inverse), scaled(&open)))
    }
}

fn row_of(point: &Point, normal: &Point) -> SVector<f64, 7> {
    let [a, b, c, d, e, f] = motion_along(point, normal);
    let growth = point[0] * normal[0] + point[1] * normal[1] + point[2] * normal[2];
    SVector::from([a, b, c, d, e, f, growth])
}

/// The pairs by the cell of space that they lie in, for edges that double from `smallest_m`.
fn cells(pairs: &[PlanePair], smallest_m: f64) -> Vec<Vec<Vec<u32>>> {
    const N_LEVELS: u32 = 7;
    /// Bits of a place along an axis.
    const BITS: u32 = 21;
    let code = |p: &Point| -> u64 {
        let place = p.map(|v| (v / smallest_m).floor() as i64 + (1 << (BITS - 1)));
        // The bits of the three axes in turn, so that a coarser cell is a shorter number.
        (0..BITS).fold(0, |code, bit| {
            (0..3).fold(code, |code, axis| {
                code | (((place[axis] >> bit) & 1) as u64) << (3 * bit + axis as u32)
            })
        })
    };
    let mut order: Vec<(u64, u32)> = (0..)
        .zip(pairs)
        .map(|(i, pair)| (code(&pair.point), i))
        .collect();
    parallel::sort_unstable(&mut order);
    (0..N_LEVELS)
        .map(|level| {
            order
                .chunk_by(|a, b| a.0 >> (3 * level) == b.0 >> (3 * level))
                .map(|cell| cell.iter().map(|(_, i)| *i).collect())
                .collect()
        })
        .collect()
}
