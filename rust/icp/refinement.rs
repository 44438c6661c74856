//! What stays from one iteration to the next, and the step that an iteration makes.

use super::gauss_newton::Pass;
use super::pairs::Pairs;
use super::{Clouds, IcpKernel, IcpMethod, IcpOptions};
use crate::cloud::{Point, distance_sq};
use crate::error::Result;
use crate::freedom::Freedom;
use crate::kabsch::PairSums;
use crate::observations::LocalObservations;
use crate::parallel;
use crate::point_to_plane::ScaledPlaneSums;
use crate::progress::Progress;
use crate::rigid::Rigid;
use crate::similarity::Similarity;
use crate::uncertainty::{PoseUncertainty, effective_variance, open_motions};

/// Tukey's constant: standard deviations beyond which a pair has no influence.
const TUKEY: f64 = 4.685;

/// How much firmer than by all planes together an open motion is held.
const FIRM: f64 = 1e3;

/// What one iteration leads to.
pub(super) struct Step {
    pub(super) pose: Similarity,
    pub(super) mean_squared: f64,
}

/// What stays from one iteration to the next.
pub(super) struct Refinement<'a> {
    pub(super) clouds: &'a Clouds<'a>,
    pub(super) freedom: Freedom,
    pub(super) known: &'a LocalObservations,
    pub(super) options: &'a IcpOptions,
    pub(super) method: IcpMethod,
    pub(super) pairs: Pairs,
    /// Squared residual without influence, from the residuals of the iteration before.
    pub(super) limit_sq: f64,
    /// The middle of the first pairs, in the target: steps turn about it.
    pub(super) middle: Point,
    /// Motions that the first pairs leave open: none is made along them.
    pub(super) open: Vec<[f64; 7]>,
}

impl Refinement<'_> {
    pub(super) fn step(
        &mut self,
        pose: &Similarity,
        progress: &Progress<'_>,
    ) -> Result<Option<Step>> {
        let is_plain = self.options.kernel_of(self.method) == IcpKernel::LeastSquares;
        if self.method == IcpMethod::PointToPoint && is_plain && self.known.is_empty() {
            return self.step_in_closed_form(pose, progress);
        }
        if !is_plain && self.limit_sq.is_infinite() {
            let first = self.pass(pose).gather(progress)?;
            self.limit_sq = TUKEY * TUKEY * first.variance(self.method);
        }
        let pass = self.pass(pose);
        let gathered = pass.gather(progress)?;
        let (middle, mut sums) = (self.middle, gathered.sums);
        if gathered.n_pairs < 6 && self.known.is_empty() {
            return Ok(None);
        }
        if !self.known.is_empty() {
            let rows = pass.rows(self.method, self.limit_sq, 1);
            let cell_m = self.cell_m(self.pairs.rmse());
            // Pairs in too few cells cannot speak for themselves: then each counts alone.
            let variance = effective_variance(&rows, self.freedom, cell_m)
                .unwrap_or_else(|| gathered.mean_squared());
            self.known.add_to(&mut sums, pose, &middle, variance);
        }
        // Open motions are in units of arcs, like shifts.
        let information = sums.information();
        let firm = FIRM * (3..6).map(|axis| information[(axis, axis)]).sum::<f64>();
        for row in &self.open {
            sums.add_row(row, 0.0, firm);
        }
        if !is_plain {
            self.limit_sq = TUKEY * TUKEY * gathered.variance(self.method);
        }
        let to_middle = Similarity::from(Rigid::from_euler([0.0; 3], middle.map(|v| -v)));
        Ok(sums.solve(self.freedom).map(|step| Step {
            pose: to_middle.inverse() * step * to_middle * *pose,
            mean_squared: gathered.mean_squared(),
        }))
    }

    /// Eq. (8): the pose with the least mean squared distance between the pairs.
    fn step_in_closed_form(
        &self,
        pose: &Similarity,
        progress: &Progress<'_>,
    ) -> Result<Option<Step>> {
        let source = self.clouds.source;
        // What is not free is done to the points beforehand.
        let fixed = match self.freedom {
            Freedom::Levelled => *pose,
            Freedom::Rigid => Similarity {
                scale: pose.scale,
                rigid: Rigid::identity(),
            },
            Freedom::Similarity => Similarity::identity(),
        };
        let chunks = parallel::chunks(source.len(), progress, |range| {
            let mut sums = PairSums::default();
            for (i, partner) in self.pairs.places_within(range) {
                sums.add(&fixed.apply(&source[i]), partner, 1.0);
            }
            sums
        })?;
        let mut sums = PairSums::default();
        chunks.iter().for_each(|chunk| sums.merge(chunk));
        let found = match self.freedom {
            Freedom::Levelled => sums.solve_levelled().map(Similarity::from),
            Freedom::Rigid => sums.solve().map(Similarity::from),
            Freedom::Similarity => sums.solve_similarity(),
        };
        let Some(found) = found else {
            return Ok(None);
        };
        let pose = found * fixed;
        let chunks = parallel::chunks(source.len(), progress, |range| {
            let pairs = self.pairs.places_within(range);
            pairs
                .map(|(i, partner)| distance_sq(&pose.apply(&source[i]), partner))
                .sum::<f64>()
        })?;
        Ok(Some(Step {
            pose,
            mean_squared: chunks.iter().sum::<f64>() / self.pairs.n_kept as f64,
        }))
    }

    /// Settles once for all iterations what steps turn about and what they must not do.
    pub(super) fn settle(&mut self, pose: &Similarity) {
        /// So many pairs tell which motions are open.
        const ENOUGH_TO_SETTLE: usize = 5000;
        let n = self.pairs.n_kept as f64;
        for (i, _) in self.pairs.kept() {
            let moved = pose.apply(&self.clouds.source[i]);
            (0..3).for_each(|axis| self.middle[axis] += moved[axis] / n);
        }
        if self.method != IcpMethod::PointToPoint {
            let stride = self.clouds.source.len().div_ceil(ENOUGH_TO_SETTLE) | 1;
            let rows = self.pass(pose).rows(self.method, f64::INFINITY, stride);
            self.open = open_motions(&rows, self.freedom, &self.others(pose));
        }
    }

    /// The observations beside the clouds, alone.
    fn others(&self, pose: &Similarity) -> ScaledPlaneSums {
        let mut others = ScaledPlaneSums::default();
        self.known.add_to(&mut others, pose, &self.middle, 1.0);
        others
    }

    fn pass(&self, pose: &Similarity) -> Pass<'_> {
        Pass {
            clouds: self.clouds,
            pairs: &self.pairs,
            pose: *pose,
            middle: self.middle,
            method: self.method,
            limit_sq: self.limit_sq,
        }
    }

    /// Edge of the cells in which residuals hang together: a few spacings of the points, which the
    /// distances of the pairs tell.
    fn cell_m(&self, rmse_m: f64) -> f64 {
        const SPACINGS: f64 = 4.0;
        let reach_m = self.options.max_distance_m.unwrap_or(rmse_m);
        SPACINGS * reach_m.max(f64::MIN_POSITIVE)
    }

    /// How accurate the pose is, by the planes of the pairs whatever the method.
    pub(super) fn uncertainty(&self, pose: &Similarity, rmse_m: f64) -> Option<PoseUncertainty> {
        if self.clouds.target_surfaces.is_empty() {
            return None;
        }
        let cell_m = self.cell_m(rmse_m);
        let (method, limit_sq) = match self.method {
            IcpMethod::PointToPoint => (IcpMethod::PointToPlane, f64::INFINITY),
            method => (method, self.limit_sq),
        };
        let rows = self.pass(pose).rows(method, limit_sq, 1);
        PoseUncertainty::of_pairs(&rows, self.middle, self.freedom, &self.others(pose), cell_m)
    }
}
