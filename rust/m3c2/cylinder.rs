//! What is known of the points of a cloud in a cylinder: their mean place along its axis, their
//! spread, and how well the mean is known where neighbouring points err alike.

use crate::cloud::Point;

/// A cylinder is parted into quarters, and these into an inner and an outer half of the same size.
const N_PARTS: usize = 8;

/// Student's t at 95 %, two-sided, for 1, 2, … degrees of freedom.
const T_95: [f64; 14] = [
    12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228, 2.201, 2.179, 2.160,
    2.145,
];

/// The points of one cloud in a cylinder, by their places along its axis, summed up about the first
/// of them so that nothing cancels.
pub(super) struct Along {
    /// Directions across the axis, which part the cylinder into eighths.
    across: [Point; 2],
    /// What parts the inner half of the cylinder from the outer one.
    half_radius_sq: f64,
    n: [u32; N_PARTS],
    first: Option<f64>,
    sum: [f64; N_PARTS],
    sum_sq: f64,
}

impl Along {
    pub(super) fn new(across: [Point; 2], radius_m: f64) -> Self {
        Self {
            across,
            half_radius_sq: 0.5 * radius_m * radius_m,
            n: [0; N_PARTS],
            first: None,
            sum: [0.0; N_PARTS],
            sum_sq: 0.0,
        }
    }

    #[inline]
    pub(super) fn add(&mut self, along: f64, offset: &Point) {
        let [x, y] = [dot(offset, &self.across[0]), dot(offset, &self.across[1])];
        let is_outer = x * x + y * y > self.half_radius_sq;
        let part = usize::from(x > 0.0) + 2 * usize::from(y > 0.0) + 4 * usize::from(is_outer);
        let d = along - *self.first.get_or_insert(along);
        self.n[part] += 1;
        self.sum[part] += d;
        self.sum_sq += d * d;
    }

    pub(super) fn n(&self) -> u32 {
        self.n.iter().sum()
    }

    /// About the first; NaN of nothing.
    fn local_mean(&self) -> f64 {
        self.sum.iter().sum::<f64>() / f64::from(self.n())
    }

    /// NaN of nothing.
    pub(super) fn mean(&self) -> f64 {
        self.first.unwrap_or(f64::NAN) + self.local_mean()
    }

    /// Divided by n − 1; NaN of fewer than two.
    pub(super) fn variance(&self) -> f64 {
        let n = self.n();
        if n < 2 {
            return f64::NAN;
        }
        let sum = self.sum.iter().sum::<f64>();
        ((self.sum_sq - sum * sum / f64::from(n)) / f64::from(n - 1)).max(0.0)
    }

    /// The variance of the mean where the points of each part count as one observation, and its
    /// degrees of freedom; `None` where all points lie in one part.
    fn clustered_variance(&self) -> Option<(f64, f64)> {
        let mean = self.local_mean();
        let (mut n_parts, mut squares) = (0, 0.0);
        for (n, sum) in self.n.iter().zip(&self.sum).filter(|(n, _)| **n > 0) {
            n_parts += 1;
            squares += (sum - f64::from(*n) * mean).powi(2);
        }
        let (n, parts) = (f64::from(self.n()), f64::from(n_parts));
        (n_parts > 1).then(|| (squares / (n * n) * parts / (parts - 1.0), parts - 1.0))
    }
}

/// The half width at 95 % of the difference of two means whose points are clustered; infinite where
/// it is not known.
pub(super) fn clustered_half_width(first: &Along, second: &Along) -> f64 {
    let (Some((var_1, dof_1)), Some((var_2, dof_2))) =
        (first.clustered_variance(), second.clustered_variance())
    else {
        return f64::INFINITY;
    };
    let variance = var_1 + var_2;
    // Welch (1947): how many observations the two together are worth.
    let dof = variance * variance / (var_1 * var_1 / dof_1 + var_2 * var_2 / dof_2);
    let at = if dof.is_finite() {
        dof as usize
    } else {
        T_95.len()
    };
    T_95[at.clamp(1, T_95.len()) - 1] * variance.sqrt()
}

/// Two unit vectors across a unit vector and each other.
pub(super) fn across(axis: &Point) -> [Point; 2] {
    let least = (0..3).fold(0, |a, b| if axis[b].abs() < axis[a].abs() { b } else { a });
    let mut other = [0.0; 3];
    other[least] = 1.0;
    let first = cross(axis, &other);
    let length = dot(&first, &first).sqrt();
    let first = first.map(|v| v / length);
    [first, cross(axis, &first)]
}

fn cross(a: &Point, b: &Point) -> Point {
    std::array::from_fn(|i| {
        let (j, k) = ((i + 1) % 3, (i + 2) % 3);
        a[j] * b[k] - a[k] * b[j]
    })
}

#[inline]
fn dot(a: &Point, b: &Point) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn clusters_by_hand() {
        let mut along = Along::new(across(&[0.0, 0.0, 1.0]), 2.0);
        // Two points in one eighth, one in another: the mean is 2, the parts pull by −1 and 1.
        for (t, x) in [(1.0, 0.5), (2.0, 0.6), (3.0, -0.5)] {
            along.add(t, &[x, 0.1, t]);
        }
        assert_eq!((along.mean(), along.variance()), (2.0, 1.0));
        let (variance, dof) = along.clustered_variance().unwrap();
        assert!((variance - 2.0 / 9.0 * 2.0).abs() < 1e-15);
        assert_eq!(dof, 1.0);
        // Alike twice over: two degrees of freedom.
        let wanted = 4.303 * (8.0_f64 / 9.0).sqrt();
        assert!((clustered_half_width(&along, &along) - wanted).abs() < 1e-12);
        let mut lone = Along::new(across(&[0.0, 0.0, 1.0]), 2.0);
        lone.add(1.0, &[0.5, 0.1, 1.0]);
        assert_eq!(clustered_half_width(&along, &lone), f64::INFINITY);
        for axis in [[0.0, 0.0, 1.0], [0.6, 0.0, -0.8], [1.0, 0.0, 0.0]] {
            let [x, y] = across(&axis);
            for (a, b, wanted) in [
                (&x, &y, 0.0),
                (&x, &axis, 0.0),
                (&x, &x, 1.0),
                (&y, &y, 1.0),
            ] {
                assert!((dot(a, b) - wanted).abs() < 1e-15);
            }
        }
    }
}
