//! Calls of the objective, counted and limited.

use crate::parallel;

use super::Objective;

/// Every call of the objective goes through here; values that are not a number become +∞.
pub(super) struct Evaluator<'a> {
    objective: &'a dyn Objective,
    max_evaluations: usize,
    pub(super) n_evaluations: usize,
    pub(super) n_nan: usize,
}

impl<'a> Evaluator<'a> {
    /// At most `max_evaluations` calls; `None` for no limit.
    pub(super) fn new(objective: &'a dyn Objective, max_evaluations: Option<usize>) -> Self {
        Self {
            objective,
            max_evaluations: max_evaluations.unwrap_or(usize::MAX),
            n_evaluations: 0,
            n_nan: 0,
        }
    }

    pub(super) fn is_spent(&self) -> bool {
        self.n_evaluations >= self.max_evaluations
    }

    /// The value at `x`, or `None` once the calls are used up.
    pub(super) fn one(&mut self, x: &[f64]) -> Option<f64> {
        if self.is_spent() {
            return None;
        }
        Some(self.count(self.objective.evaluate(x)))
    }

    /// The value at `x` where it is below `limit`, else any that is not; `None` once the calls are
    /// used up.
    pub(super) fn one_below(&mut self, x: &[f64], limit: f64) -> Option<f64> {
        if self.is_spent() {
            return None;
        }
        Some(self.count(self.objective.evaluate_below(x, limit)))
    }

    /// The values at all `points`, in order and in parallel; only the first ones where the calls
    /// do not suffice.
    pub(super) fn many(&mut self, points: &[&[f64]]) -> Vec<f64> {
        let n = points.len().min(self.max_evaluations - self.n_evaluations);
        let values = parallel::map(n, |i| self.objective.evaluate(points[i]));
        values.into_iter().map(|value| self.count(value)).collect()
    }

    fn count(&mut self, value: f64) -> f64 {
        self.n_evaluations += 1;
        if value.is_nan() {
            self.n_nan += 1;
            return f64::INFINITY;
        }
        value
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn calls_are_counted_and_end_at_the_limit() {
        let objective = |x: &[f64]| x[0].sqrt();
        let mut evaluator = Evaluator::new(&objective, Some(4));
        assert_eq!(evaluator.many(&[&[4.0], &[-1.0]]), [2.0, f64::INFINITY]);
        assert_eq!(evaluator.one(&[9.0]), Some(3.0));
        assert_eq!(evaluator.many(&[&[16.0], &[25.0]]), [4.0]);
        assert!(evaluator.is_spent());
        assert_eq!(evaluator.one(&[9.0]), None);
        assert_eq!(evaluator.one_below(&[9.0], 1.0), None);
        assert!(evaluator.many(&[&[1.0]]).is_empty());
        assert_eq!((evaluator.n_evaluations, evaluator.n_nan), (4, 1));
    }
}
