//! Calls of the objective: a batch at a time, on all cores where that pays.

use std::time::{Duration, Instant};

use crate::parallel;

use super::Objective;

/// Waking other threads costs some microseconds; work below this stays on one.
const WORTH_SHARING: Duration = Duration::from_micros(100);

/// The values at `points`, in order.
///
/// A value that is not below `limit` may be any number that is not. The clock decides how many
/// threads share the work, and nothing else.
pub(super) fn values(objective: &dyn Objective, points: &[Vec<f64>], limit: f64) -> Vec<f64> {
    let value = |x: &[f64]| {
        if limit == f64::INFINITY {
            objective.evaluate(x)
        } else {
            objective.evaluate_below(x, limit)
        }
    };
    let [first, others @ ..] = points else {
        return Vec::new();
    };
    if others.is_empty() {
        return vec![value(first)];
    }
    let begun = Instant::now();
    let mut values = Vec::with_capacity(points.len());
    values.push(value(first));
    if begun.elapsed() * others.len() as u32 > WORTH_SHARING {
        values.extend(parallel::map(others.len(), |i| value(&others[i])));
    } else {
        values.extend(others.iter().map(|x| value(x)));
    }
    values
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_come_in_the_order_of_the_points_dear_or_cheap() {
        let points: Vec<Vec<f64>> = (0..20).map(|i| vec![f64::from(i)]).collect();
        let expected: Vec<f64> = (0..20).map(|i| f64::from(i * i)).collect();
        let cheap = |x: &[f64]| x[0] * x[0];
        let dear = |x: &[f64]| {
            std::thread::sleep(Duration::from_millis(1));
            x[0] * x[0]
        };
        assert_eq!(values(&cheap, &points, f64::INFINITY), expected);
        assert_eq!(values(&dear, &points, f64::INFINITY), expected);
        assert_eq!(values(&cheap, &points[3..4], 10.0), [9.0]);
        assert!(values(&cheap, &[], f64::INFINITY).is_empty());
    }
}
