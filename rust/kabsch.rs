//! The rigid transform that moves paired points onto each other best, in closed form.
//!
//! Source: Kabsch (1976), Umeyama (1991) for the reflection guard; Ren, Zhao & Han (2023),
//! Section 4.5. Deviates: pairs may carry weights.

use nalgebra::{Matrix3, Vector3};

use crate::cloud::Point;
use crate::rigid::Rigid;

/// Running sums over pairs of points, from which the best transform follows.
#[derive(Debug, Clone, Copy)]
pub struct PairSums {
    weight: f64,
    source: Vector3<f64>,
    target: Vector3<f64>,
    /// Σ w · target · sourceᵀ
    product: Matrix3<f64>,
}

impl Default for PairSums {
    fn default() -> Self {
        Self {
            weight: 0.0,
            source: Vector3::zeros(),
            target: Vector3::zeros(),
            product: Matrix3::zeros(),
        }
    }
}

impl PairSums {
    /// Adds a pair.
    #[inline]
    pub fn add(&mut self, source: &Point, target: &Point, weight: f64) {
        self.weight += weight;
        for row in 0..3 {
            self.source[row] += weight * source[row];
            self.target[row] += weight * target[row];
            let scaled = weight * target[row];
            for column in 0..3 {
                self.product[(row, column)] += scaled * source[column];
            }
        }
    }

    /// Adds the sums of other pairs.
    pub fn merge(&mut self, other: &Self) {
        self.weight += other.weight;
        self.source += other.source;
        self.target += other.target;
        self.product += other.product;
    }

    /// The transform with the least weighted sum of squared distances; `None` without any weight.
    ///
    /// Where the pairs leave the rotation open (one point, one line) one of the best is returned.
    pub fn solve(&self) -> Option<Rigid> {
        if self.weight.is_nan() || self.weight <= 0.0 {
            return None;
        }
        let (source, target) = (self.source / self.weight, self.target / self.weight);
        let covariance = self.product / self.weight - target * source.transpose();
        let rotation = nearest_rotation(&covariance)?;
        Some(Rigid {
            rotation,
            translation: target - rotation * source,
        })
    }
}

/// The best transform from `source` onto `target`, point by point.
///
/// `None` where there are no pairs; the slices are read as far as the shorter one goes.
///
/// ```
/// use tmchho::{Rigid, kabsch};
/// let source = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 3.0]];
/// let pose = Rigid::from_euler([0.3, -0.2, 1.1], [5.0, 6.0, 7.0]);
/// let target = source.map(|p| pose.apply(&p));
/// let found = kabsch::fit(&source, &target).unwrap();
/// assert!((found.rotation - pose.rotation).amax() < 1e-14);
/// ```
pub fn fit(source: &[Point], target: &[Point]) -> Option<Rigid> {
    let mut sums = PairSums::default();
    for (p, q) in source.iter().zip(target) {
        sums.add(p, q, 1.0);
    }
    sums.solve()
}

/// The rotation R with the greatest trace of Rᵀ·M (M = U·S·Vᵀ gives U·Vᵀ, mirrored back where its
/// determinant is −1).
fn nearest_rotation(matrix: &Matrix3<f64>) -> Option<Matrix3<f64>> {
    let scale = matrix.amax();
    if !scale.is_finite() {
        return None;
    }
    if scale == 0.0 {
        return Some(Matrix3::identity());
    }
    let svd = (matrix / scale).svd_unordered(true, true);
    let (mut u, v_t) = (svd.u?, svd.v_t?);
    if (u * v_t).determinant() < 0.0 {
        let weakest = svd.singular_values.imin();
        u.column_mut(weakest).neg_mut();
    }
    Some(u * v_t)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mirrored_cloud_never_gives_a_mirror() {
        let source = [
            [0.0, 0.0, 0.0],
            [1.0, 0.0, 0.0],
            [0.0, 2.0, 0.0],
            [0.0, 0.0, 3.0],
        ];
        let mirrored = source.map(|p| [-p[0], p[1], p[2]]);
        let found = fit(&source, &mirrored).unwrap();
        assert!((found.rotation.determinant() - 1.0).abs() < 1e-12);
    }

    #[test]
    fn two_pairs_by_hand() {
        // From the x axis onto the y axis, shifted by one: a quarter turn about z.
        let found = fit(
            &[[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]],
            &[[1.0, 0.0, 0.0], [1.0, 2.0, 0.0]],
        )
        .unwrap();
        let q = found.apply(&[3.0, 0.0, 0.0]);
        for (got, wanted) in q.iter().zip([1.0, 4.0, 0.0]) {
            assert!((got - wanted).abs() < 1e-12, "{q:?}");
        }
        assert!((found.rotation.determinant() - 1.0).abs() < 1e-12);
    }

    #[test]
    fn weights_count_and_nothing_gives_nothing() {
        let mut sums = PairSums::default();
        assert!(sums.solve().is_none());
        sums.add(&[0.0; 3], &[1.0, 0.0, 0.0], 3.0);
        sums.add(&[0.0; 3], &[5.0, 0.0, 0.0], 1.0);
        assert!((sums.solve().unwrap().translation[0] - 2.0).abs() < 1e-15);
        sums.add(&[f64::NAN; 3], &[0.0; 3], 1.0);
        assert!(sums.solve().is_none());
    }
}
