//! The rigid transform that moves paired points onto each other best, in closed form.
//!
//! Source: Kabsch (1976), Umeyama (1991) for the reflection guard; Ren, Zhao & Han (2023),
//! Section 4.5; Horn (1987), Section 2.E for the scale. Deviates: pairs may carry weights.

use nalgebra::{Matrix3, Vector3};

use crate::cloud::Point;
use crate::rigid::Rigid;
use crate::similarity::Similarity;

/// Running sums over pairs of points, from which the best transform follows.
#[derive(Debug, Clone, Copy)]
pub struct PairSums {
    weight: f64,
    source: Vector3<f64>,
    target: Vector3<f64>,
    /// Σ w · target · sourceᵀ
    product: Matrix3<f64>,
    /// Σ w · |source|², Σ w · |target|²
    source_sq: f64,
    target_sq: f64,
}

impl Default for PairSums {
    fn default() -> Self {
        Self {
            weight: 0.0,
            source: Vector3::zeros(),
            target: Vector3::zeros(),
            product: Matrix3::zeros(),
            source_sq: 0.0,
            target_sq: 0.0,
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
        self.source_sq += weight * norm_sq(source);
        self.target_sq += weight * norm_sq(target);
    }

    /// Adds the sums of other pairs.
    pub fn merge(&mut self, other: &Self) {
        self.weight += other.weight;
        self.source += other.source;
        self.target += other.target;
        self.product += other.product;
        self.source_sq += other.source_sq;
        self.target_sq += other.target_sq;
    }

    /// The transform with the least weighted sum of squared distances; `None` without any weight.
    ///
    /// Where the pairs leave the rotation open (one point, one line) one of the best is returned.
    pub fn solve(&self) -> Option<Rigid> {
        let pairs = self.centred()?;
        let rotation = nearest_rotation(&pairs.covariance)?;
        Some(pairs.turned_by(rotation))
    }

    /// The best transform that only turns about z: both clouds are levelled.
    ///
    /// The sum falls with cos θ · Σ(x·x' + y·y') + sin θ · Σ(x·y' − y·x'), which is greatest where θ
    /// is the direction of those two sums. No turn where they leave it open.
    ///
    /// ```
    /// use tmchho::{Rigid, kabsch::PairSums};
    /// let pose = Rigid::from_euler([0.0, 0.0, 2.0], [5.0, 6.0, 7.0]);
    /// let mut sums = PairSums::default();
    /// for p in [[0.0, 0.0, 0.0], [1.0, 0.0, 0.5]] {
    ///     sums.add(&p, &pose.apply(&p), 1.0);
    /// }
    /// let found = sums.solve_levelled().unwrap();
    /// assert!((found.rotation - pose.rotation).amax() < 1e-14);
    /// ```
    pub fn solve_levelled(&self) -> Option<Rigid> {
        self.solve_about(&Vector3::z(), &Matrix3::identity())
    }

    /// The best transform that turns by `first`, and then about `axis` (a unit vector) alone; no second turn where the
    /// pairs leave it open.
    pub(crate) fn solve_about(&self, axis: &Vector3<f64>, first: &Matrix3<f64>) -> Option<Rigid> {
        let pairs = self.centred()?;
        let c = pairs.covariance * first.transpose();
        let along = axis * axis.transpose();
        let across = Matrix3::identity() - along;
        let spin = Vector3::new(
            c[(2, 1)] - c[(1, 2)],
            c[(0, 2)] - c[(2, 0)],
            c[(1, 0)] - c[(0, 1)],
        );
        let (cosine, sine) = (c.dot(&across), spin.dot(axis));
        let length = cosine.hypot(sine);
        if !(length + c.sum()).is_finite() {
            return None;
        }
        let (cosine, sine) = match length > 0.0 {
            true => (cosine / length, sine / length),
            false => (1.0, 0.0),
        };
        let turn = along + across * cosine + axis.cross_matrix() * sine;
        Some(pairs.turned_by(turn * first))
    }

    /// The best transform with a scale; `None` also where either side stands on one point.
    ///
    /// The scale is the ratio of the two root mean squared radii (Horn's symmetric one), not the
    /// one of least squares in the target: that one takes the source to be free of error and
    /// shrinks with the noise of both clouds, which in ICP drives the scale towards 0 step by step.
    /// Here exchanging the clouds gives the inverse. The rotation is the same either way.
    ///
    /// ```
    /// use tmchho::{kabsch::PairSums};
    /// let mut sums = PairSums::default();
    /// for p in [[0.0, 0.0, 0.0], [1.0, 0.0, 0.5], [0.0, 3.0, 0.0]] {
    ///     sums.add(&p, &p.map(|v| 2.0 * v + 1.0), 1.0);
    /// }
    /// let found = sums.solve_similarity().unwrap();
    /// assert!((found.scale - 2.0).abs() < 1e-14);
    /// ```
    pub fn solve_similarity(&self) -> Option<Similarity> {
        let pairs = self.centred()?;
        let rotation = nearest_rotation(&pairs.covariance)?;
        let spread_of_source = self.source_sq / self.weight - pairs.source.norm_squared();
        let spread_of_target = self.target_sq / self.weight - pairs.target.norm_squared();
        let scale = (spread_of_target / spread_of_source).sqrt();
        (spread_of_source > 0.0 && scale > 0.0 && scale.is_finite()).then(|| Similarity {
            scale,
            rigid: Rigid {
                rotation,
                translation: pairs.target - rotation * (scale * pairs.source),
            },
        })
    }

    fn centred(&self) -> Option<Centred> {
        if self.weight.is_nan() || self.weight <= 0.0 {
            return None;
        }
        let (source, target) = (self.source / self.weight, self.target / self.weight);
        Some(Centred {
            source,
            target,
            covariance: self.product / self.weight - target * source.transpose(),
        })
    }
}

fn norm_sq(v: &Point) -> f64 {
    v[0] * v[0] + v[1] * v[1] + v[2] * v[2]
}

/// The middles of both sides, and the mean of target · sourceᵀ about them.
struct Centred {
    source: Vector3<f64>,
    target: Vector3<f64>,
    covariance: Matrix3<f64>,
}

impl Centred {
    fn turned_by(&self, rotation: Matrix3<f64>) -> Rigid {
        Rigid {
            rotation,
            translation: self.target - rotation * self.source,
        }
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
    use crate::cloud::distance_sq;
    use crate::random::Stream;

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
    fn a_turn_about_any_axis_after_any_other_is_found_and_leaves_the_rest() {
        let axis = Vector3::new(0.48, -0.64, 0.6);
        let first = Rigid::from_euler([0.4, -1.0, 2.0], [0.0; 3]).rotation;
        let mut stream = Stream::new(1, "axis", 0);
        for angle in [0.0, 1.0, -2.5] {
            let turn = Rigid::from_rotation_vector(axis * angle, Vector3::zeros()).rotation;
            let (rotation, translation) = (turn * first, Vector3::new(5.0, -6.0, 7.0));
            let pose = Rigid {
                rotation,
                translation,
            };
            let (mut exact, mut noisy) = (PairSums::default(), PairSums::default());
            for _ in 0..20 {
                let p = [0; 3].map(|_| stream.normal());
                let q = pose.apply(&p);
                exact.add(&p, &q, 1.0);
                noisy.add(&p, &q.map(|v| v + 0.3 * stream.normal()), 1.0);
            }
            let found = exact.solve_about(&axis, &first).unwrap();
            assert!((found.rotation - rotation).amax() < 1e-12);
            assert!((found.translation - translation).amax() < 1e-12);
            // What it may not turn about stays, also where the pairs would have it turn.
            let found = noisy.solve_about(&axis, &first).unwrap().rotation;
            assert!((found * first.transpose() * axis - axis).amax() < 1e-12);
            let free = noisy.solve().unwrap().rotation;
            assert!((free * first.transpose() * axis - axis).amax() > 1e-3);
        }
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

    /// The weighted sum of squared distances at a pose.
    fn cost(pairs: &[(Point, Point, f64)], pose: &Similarity) -> f64 {
        pairs
            .iter()
            .map(|(p, q, w)| w * distance_sq(&pose.apply(p), q))
            .sum()
    }

    fn noisy_pairs(pose: &Similarity, noise: f64) -> Vec<(Point, Point, f64)> {
        let mut stream = Stream::new(5, "pairs", 0);
        (0..60)
            .map(|_| {
                let p = [3.0, 2.0, 1.0].map(|width| width * stream.normal() + 4.0);
                let q = pose.apply(&p).map(|v| v + noise * stream.normal());
                (p, q, 0.2 + stream.uniform())
            })
            .collect()
    }

    fn sums_of(pairs: &[(Point, Point, f64)]) -> PairSums {
        let mut sums = PairSums::default();
        pairs.iter().for_each(|(p, q, w)| sums.add(p, q, *w));
        sums
    }

    #[test]
    fn no_other_levelled_pose_is_better() {
        let truth = Rigid::from_euler([0.1, -0.05, 2.5], [5.0, 6.0, 7.0]);
        let pairs = noisy_pairs(&truth.into(), 0.1);
        let best = sums_of(&pairs).solve_levelled().unwrap();
        assert_eq!(best.rotation[(2, 2)], 1.0);
        let least = cost(&pairs, &best.into());
        for axis in 0..4 {
            for step in [-1e-3, 1e-3] {
                let mut motion = [0.0; 4];
                motion[axis] = step;
                let [yaw, x, y, z] = motion;
                let other = Rigid::from_euler([0.0, 0.0, yaw], [x, y, z]) * best;
                assert!(cost(&pairs, &other.into()) > least, "{motion:?}");
            }
        }
        // Points on one vertical: nothing says how to turn.
        let mut upright = PairSums::default();
        upright.add(&[0.0; 3], &[1.0, 2.0, 3.0], 1.0);
        upright.add(&[0.0, 0.0, 1.0], &[1.0, 2.0, 4.0], 1.0);
        let shifted = upright.solve_levelled().unwrap();
        assert_eq!(shifted, Rigid::from_euler([0.0; 3], [1.0, 2.0, 3.0]));
        assert!(PairSums::default().solve_levelled().is_none());
    }

    #[test]
    fn the_scale_is_symmetric_and_does_not_shrink_with_noise() {
        let truth = Similarity {
            scale: 0.7,
            rigid: Rigid::from_euler([0.4, -1.0, 2.5], [5.0, 6.0, 7.0]),
        };
        let exact = sums_of(&noisy_pairs(&truth, 0.0))
            .solve_similarity()
            .unwrap();
        assert!((exact.scale - 0.7).abs() < 1e-13);
        assert!((exact.rigid.rotation - truth.rigid.rotation).amax() < 1e-13);
        assert!((exact.rigid.translation - truth.rigid.translation).amax() < 1e-12);

        let pairs = noisy_pairs(&truth, 0.5);
        let there = sums_of(&pairs).solve_similarity().unwrap();
        let turned: Vec<_> = pairs.iter().map(|(p, q, w)| (*q, *p, *w)).collect();
        let back = sums_of(&turned).solve_similarity().unwrap();
        assert!((there.scale * back.scale - 1.0).abs() < 1e-13);
        // The one-sided scale of the same pairs is smaller: trace(Rᵀ·C) over the source's spread.
        let sums = sums_of(&pairs);
        let centred = sums.centred().unwrap();
        let spread = sums.source_sq / sums.weight - centred.source.norm_squared();
        let one_sided = (there.rigid.rotation.transpose() * centred.covariance).trace() / spread;
        assert!(one_sided < 0.98 * there.scale);

        let mut one_place = PairSums::default();
        one_place.add(&[1.0; 3], &[2.0; 3], 1.0);
        assert!(one_place.solve_similarity().is_none());
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
