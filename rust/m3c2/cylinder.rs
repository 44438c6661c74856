//! What is known of the points of a cloud in a cylinder: their mean place along its axis, their
//! spread, and how well the mean is known where neighbouring points err alike.

use crate::cloud::{Point, cross, dot};

/// A cylinder is cut into slabs about as thick as its radius, the core in the middle one, but into no
/// more to either side than this.
const MAX_SLABS_BESIDE: f64 = 32.0;

/// Each slab is cut into sixths, told by the sides of three lines on which a point lies.
const SIDES: usize = 8;

/// Student's t at 95 %, two-sided, for 1, 2, … degrees of freedom.
const T_95: [f64; 14] = [
    12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228, 2.201, 2.179, 2.160,
    2.145,
];

/// The points of one cloud in a cylinder, by their places along its axis, summed up about the first
/// of them so that nothing cancels.
pub(super) struct Along {
    /// Directions across the axis.
    across: [Point; 2],
    depth_m: f64,
    slab_m: f64,
    first: Option<f64>,
    parts: Vec<Part>,
    n: u32,
    sum: f64,
    sum_sq: f64,
}

/// The points of a sixth of a slab.
#[derive(Debug, Clone, Copy, Default)]
struct Part {
    n: u32,
    sum: f64,
}

impl Along {
    pub(super) fn new(across: [Point; 2], radius_m: f64, depth_m: f64) -> Self {
        let n_beside = (depth_m / radius_m).round().min(MAX_SLABS_BESIDE);
        let n_slabs = 2.0 * n_beside + 1.0; // odd: a surface through the core lies in one
        Self {
            across,
            depth_m,
            slab_m: 2.0 * depth_m / n_slabs,
            first: None,
            parts: vec![Part::default(); SIDES * n_slabs as usize],
            n: 0,
            sum: 0.0,
            sum_sq: 0.0,
        }
    }

    #[inline]
    pub(super) fn add(&mut self, along: f64, offset: &Point) {
        let y = dot(offset, &self.across[1]);
        let slope = dot(offset, &self.across[0]) * 3.0_f64.sqrt();
        let side = usize::from(y > 0.0) + 2 * usize::from(y > slope) + 4 * usize::from(y > -slope);
        let slab = ((along + self.depth_m) / self.slab_m) as usize;
        let at = (SIDES * slab + side).min(self.parts.len() - 1);
        let d = along - *self.first.get_or_insert(along);
        self.parts[at].n += 1;
        self.parts[at].sum += d;
        self.n += 1;
        self.sum += d;
        self.sum_sq += d * d;
    }

    pub(super) fn n(&self) -> u32 {
        self.n
    }

    /// NaN of nothing.
    pub(super) fn mean(&self) -> f64 {
        self.first.unwrap_or(f64::NAN) + self.sum / f64::from(self.n)
    }

    /// Divided by n − 1; NaN of fewer than two.
    pub(super) fn variance(&self) -> f64 {
        if self.n < 2 {
            return f64::NAN;
        }
        let n = f64::from(self.n);
        ((self.sum_sq - self.sum * self.sum / n) / (n - 1.0)).max(0.0)
    }

    /// The variance of the mean where the points of each part count as one observation, and its
    /// degrees of freedom; `None` where all points lie in one part.
    fn clustered_variance(&self) -> Option<(f64, f64)> {
        let n = f64::from(self.n);
        let mean = self.sum / n;
        let (mut n_parts, mut squares) = (0, 0.0);
        for part in self.parts.iter().filter(|part| part.n > 0) {
            n_parts += 1;
            squares += (part.sum - f64::from(part.n) * mean).powi(2);
        }
        let parts = f64::from(n_parts);
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_slab_has_six_parts() {
        let mut along = Along::new(across(&[0.0, 0.0, 1.0]), 1.0, 0.5);
        for degrees in 0..360 {
            let angle = (f64::from(degrees) + 0.5).to_radians();
            along.add(0.0, &[angle.cos(), angle.sin(), 0.0]);
        }
        let counts: Vec<u32> = along
            .parts
            .iter()
            .map(|part| part.n)
            .filter(|n| *n > 0)
            .collect();
        assert_eq!(counts, [60; 6]);
    }

    #[test]
    fn clusters_by_hand() {
        let empty = || Along::new(across(&[0.0, 0.0, 1.0]), 4.0, 4.0);
        let mut along = empty();
        // Two points in one sixth, one in another: the mean is 0, the parts pull by −1 and 1.
        for (t, x) in [(-1.0, 0.5), (0.0, 0.6), (1.0, -0.5)] {
            along.add(t, &[x, 0.1, t]);
        }
        assert_eq!((along.mean(), along.variance()), (0.0, 1.0));
        let (variance, dof) = along.clustered_variance().unwrap();
        assert!((variance - 2.0 / 9.0 * 2.0).abs() < 1e-15);
        assert_eq!(dof, 1.0);
        // Alike twice over: two degrees of freedom.
        let wanted = 4.303 * (8.0_f64 / 9.0).sqrt();
        assert!((clustered_half_width(&along, &along) - wanted).abs() < 1e-12);
        let mut lone = empty();
        lone.add(1.0, &[0.5, 0.1, 1.0]);
        assert_eq!(clustered_half_width(&along, &lone), f64::INFINITY);
        // Three slabs: what lies 1.4 below the core is in another one, the rim in the last.
        lone.add(-1.0, &[0.5, 0.1, -1.0]);
        assert!(lone.clustered_variance().is_none());
        lone.add(-1.4, &[0.5, 0.1, -1.4]);
        assert_eq!(lone.clustered_variance().unwrap().1, 1.0);
        lone.add(4.0, &[0.5, 0.1, 4.0]);
        assert_eq!(lone.clustered_variance().unwrap().1, 2.0);
        assert_eq!(lone.n(), 4);
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
