//! The observations in local coordinates: as rows of a step, as a sum of squares, as a pose.

use nalgebra::{Matrix3, Matrix6, Rotation3, SMatrix, SVector, Vector3};

use super::ControlPoint;
use crate::cloud::Point;
use crate::freedom::Freedom;
use crate::kabsch::PairSums;
use crate::point_to_plane::{ScaledPlaneSums, motion_along};
use crate::rigid::Rigid;
use crate::similarity::Similarity;

/// [`Observations`](super::Observations) about the origins of the two clouds, checked.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct LocalObservations {
    pub(super) prior: Option<LocalPrior>,
    pub(super) control_points: Vec<ControlPoint>,
}

#[derive(Debug, Clone, PartialEq)]
pub(super) struct LocalPrior {
    pub(super) mean: Rigid,
    pub(super) about: Point,
    pub(super) whitening: Matrix6<f64>,
}

/// A pose that follows from control points alone.
#[derive(Debug, Clone, PartialEq)]
pub struct ControlPose {
    /// The pose.
    pub target_from_source: Similarity,
    /// The place in the target about which the covariance is stated: the middle of the points.
    pub middle: Point,
    /// Covariance of rotation (radians), shift of the middle, and logarithm of the scale; rows of
    /// zeros for what was not free.
    pub covariance: SMatrix<f64, 7, 7>,
}

impl LocalObservations {
    /// Whether nothing is known.
    pub fn is_empty(&self) -> bool {
        self.prior.is_none() && self.control_points.is_empty()
    }

    /// Number of numbers that were observed: the degrees of freedom of
    /// [`LocalObservations::chi_squared`] for a pose that was found without them.
    pub fn n_observed(&self) -> usize {
        let known = |prior: &LocalPrior| (0..6).filter(|row| prior.knows(*row)).count();
        self.prior.as_ref().map_or(0, known) + 3 * self.control_points.len()
    }

    /// Sum of squared deviations of a pose from the observations, each in its standard deviation.
    pub fn chi_squared(&self, pose: &Similarity) -> f64 {
        let mut sum = 0.0;
        self.for_each_row(pose, &[0.0; 3], |_, residual, weight| {
            sum += weight * residual * residual;
        });
        sum
    }

    /// Adds the observations to the normal equations of a step about `middle` (in the target).
    /// `variance` is that of one unit of weight of what is in the sums already.
    pub fn add_to(
        &self,
        sums: &mut ScaledPlaneSums,
        pose: &Similarity,
        middle: &Point,
        variance: f64,
    ) {
        self.for_each_row(pose, middle, |row, residual, weight| {
            sums.add_row(row, residual, variance * weight);
        });
    }

    /// Poses that the observations alone suggest, the surest first: from the control points, and the
    /// prior. None where neither fixes all that is free.
    pub fn starts(&self, freedom: Freedom) -> Vec<Similarity> {
        let mut starts = Vec::new();
        if let Some(found) = self.pose_from_control_points(freedom) {
            starts.push(found.target_from_source);
        }
        if let Some(prior) = &self.prior
            && (0..6).all(|row| prior.knows(row))
        {
            starts.push(prior.mean.into());
        }
        starts
    }

    /// The pose of the control points, by least squares; `None` where they leave it open: fewer than
    /// three or all on one line, for a levelled pose fewer than two or all on one vertical.
    pub fn pose_from_control_points(&self, freedom: Freedom) -> Option<ControlPose> {
        /// Points whose width is a thousandth of their length are a line.
        const LINE: f64 = 1e-6;
        let mut pairs = PairSums::default();
        let (mut middle, mut total) = (Vector3::zeros(), 0.0);
        for point in &self.control_points {
            let weight = point.sigma_m.powi(-2);
            pairs.add(&point.source, &point.target, weight);
            middle += weight * Vector3::from(point.target);
            total += weight;
        }
        let middle: Point = (middle / total).into();
        let pose = match freedom {
            Freedom::Levelled => pairs.solve_levelled()?.into(),
            Freedom::Rigid => pairs.solve()?.into(),
            Freedom::Similarity => pairs.solve_similarity()?,
        };
        let mut sums = ScaledPlaneSums::default();
        let points_alone = Self {
            prior: None,
            control_points: self.control_points.clone(),
        };
        points_alone.add_to(&mut sums, &pose, &middle, 1.0);
        let information = sums.information();
        let turning = information.fixed_view::<3, 3>(0, 0).into_owned();
        let firmness = match freedom {
            // Turning about z against turning about the other axes.
            Freedom::Levelled => turning[(2, 2)] / turning.trace(),
            _ => {
                let eigenvalues = turning.symmetric_eigenvalues();
                eigenvalues.min() / eigenvalues.max()
            }
        };
        if firmness.is_nan() || firmness <= LINE {
            return None;
        }
        Some(ControlPose {
            target_from_source: pose,
            middle,
            covariance: freedom.inverse_of_free(&information)?,
        })
    }

    /// Every observation as row · (rotation, translation, growth) + residual = 0, in units whose
    /// weight is that of a variance of 1/weight, for a step about `middle`.
    fn for_each_row(
        &self,
        pose: &Similarity,
        middle: &Point,
        mut each: impl FnMut(&[f64; 7], f64, f64),
    ) {
        let place = |p: &Point, target: &Point| {
            let moved = pose.apply(p);
            let about = std::array::from_fn(|axis| moved[axis] - middle[axis]);
            let residual = Vector3::from_fn(|axis, _| moved[axis] - target[axis]);
            (shifts_of(&about), residual)
        };
        if let Some(prior) = &self.prior {
            let turned = pose.rigid.rotation * prior.mean.rotation.transpose();
            let turn = Rotation3::from_matrix_unchecked(turned).scaled_axis();
            let (shifts, shift) = place(&prior.about, &prior.mean.apply(&prior.about));
            let mut rows = SMatrix::<f64, 6, 7>::zeros();
            rows.fixed_view_mut::<3, 3>(0, 0)
                .copy_from(&inverse_left_jacobian(&turn));
            rows.fixed_view_mut::<3, 7>(3, 0).copy_from(&shifts);
            let residual =
                SVector::from_fn(|row, _| if row < 3 { turn[row] } else { shift[row - 3] });
            let (rows, residual) = (prior.whitening * rows, prior.whitening * residual);
            for r in (0..6).filter(|row| prior.knows(*row)) {
                each(&std::array::from_fn(|c| rows[(r, c)]), residual[r], 1.0);
            }
        }
        for point in &self.control_points {
            let (shifts, residual) = place(&point.source, &point.target);
            let weight = point.sigma_m.powi(-2);
            for r in 0..3 {
                each(
                    &std::array::from_fn(|c| shifts[(r, c)]),
                    residual[r],
                    weight,
                );
            }
        }
    }
}

impl LocalPrior {
    fn knows(&self, row: usize) -> bool {
        self.whitening[(row, row)] != 0.0
    }
}

/// How a point moves with each parameter of a step about 0.
fn shifts_of(p: &Point) -> SMatrix<f64, 3, 7> {
    let mut shifts = SMatrix::zeros();
    for axis in 0..3 {
        let mut along = [0.0; 3];
        along[axis] = 1.0;
        for (column, value) in motion_along(p, &along).iter().enumerate() {
            shifts[(axis, column)] = *value;
        }
        shifts[(axis, 6)] = p[axis];
    }
    shifts
}

/// How the rotation vector of a pose changes with a small turn on its left.
fn inverse_left_jacobian(turn: &Vector3<f64>) -> Matrix3<f64> {
    let angle = turn.norm();
    let cross = turn.cross_matrix();
    let second = if angle < 1e-4 {
        1.0 / 12.0
    } else {
        // (1 + cos) / sin, written so that it holds up to a half turn.
        1.0 / (angle * angle) - 1.0 / (2.0 * angle * (0.5 * angle).tan())
    };
    Matrix3::identity() - 0.5 * cross + second * cross * cross
}

#[cfg(test)]
mod tests {
    use super::super::{Observations, PosePrior};
    use super::*;
    use crate::random::Stream;

    fn matrix(pose: &Rigid) -> [[f64; 4]; 4] {
        pose.to_matrix4()
    }

    fn truth() -> Rigid {
        Rigid::from_euler([0.3, -0.2, 1.1], [50.0, 60.0, 7.0])
    }

    fn controls(pose: &Similarity, n: usize, noise: f64, seed: u64) -> Vec<ControlPoint> {
        let mut stream = Stream::new(seed, "controls", 0);
        (0..n)
            .map(|i| {
                let source = [30.0, 20.0, 5.0].map(|width| width * stream.normal());
                let sigma_m = noise * (1.0 + (i % 2) as f64);
                let target = pose.apply(&source).map(|v| v + sigma_m * stream.normal());
                ControlPoint {
                    source,
                    target,
                    sigma_m,
                }
            })
            .collect()
    }

    fn prior(pose: &Rigid) -> PosePrior {
        PosePrior {
            target_from_source: matrix(pose),
            rotation_rad: Some([0.01, 0.02, 0.05]),
            translation_m: Some([0.1, 0.2, 0.3]),
            covariance: None,
            about: None,
        }
    }

    #[test]
    fn what_is_loosened_or_scaled_still_says_the_same() {
        let pose = truth();
        let known = Observations {
            prior: Some(prior(&pose)),
            control_points: controls(&pose.into(), 3, 0.0, 1)
                .into_iter()
                .map(|point| ControlPoint {
                    sigma_m: 0.01,
                    ..point
                })
                .collect(),
        };
        let (middle, scale) = ([3.0, -2.0, 40.0], 0.25);
        let scaled = known.for_scaled_source(scale, middle);
        let grown = Similarity {
            scale: 1.0 / scale,
            rigid: pose,
        };
        // The pose of the small source has to grow it; the prior, which knows no scale, then holds
        // at the middle alone.
        let local = scaled.about([0.0; 3], [0.0; 3]).unwrap();
        let of_points = local.pose_from_control_points(Freedom::Similarity).unwrap();
        assert!((of_points.target_from_source.scale - grown.scale).abs() < 1e-9);
        let mean = Rigid::from_matrix4(&scaled.prior.as_ref().unwrap().target_from_source).unwrap();
        let (there, wanted) = (mean.apply(&middle.map(|v| scale * v)), pose.apply(&middle));
        assert!((0..3).all(|axis| (there[axis] - wanted[axis]).abs() < 1e-9));

        let off = Rigid::from_euler([0.0; 3], [0.3, 0.0, 0.0]) * pose;
        let chi = |known: &Observations| {
            known
                .about([0.0; 3], [0.0; 3])
                .unwrap()
                .chi_squared(&off.into())
        };
        assert!(chi(&known.loosened(0.1, 1.0)) < 0.1 * chi(&known));
    }

    #[test]
    fn a_deviation_counts_in_standard_deviations() {
        let known = Observations {
            prior: Some(PosePrior {
                about: Some([1.0, 2.0, 3.0]),
                ..prior(&truth())
            }),
            control_points: vec![ControlPoint {
                source: [1.0, 2.0, 3.0],
                target: truth().apply(&[1.0, 2.0, 3.0]),
                sigma_m: 0.05,
            }],
        };
        let local = known.about([1.0, 1.0, 1.0], [10.0, 0.0, 0.0]).unwrap();
        let at = |pose: Rigid| {
            let pose = pose.between_local_coordinates([1.0, 1.0, 1.0], [10.0, 0.0, 0.0]);
            local.chi_squared(&pose.into())
        };
        assert!(at(truth()) < 1e-18);
        assert_eq!(local.n_observed(), 9);
        // 0.2 along x: two standard deviations of the prior, four of the control point.
        let shifted = Rigid::from_euler([0.0; 3], [0.2, 0.0, 0.0]) * truth();
        assert!((at(shifted) - 20.0).abs() < 1e-9);
        // Turned about the known place by 0.03 about z, whose standard deviation is 0.05.
        let place = truth().apply(&[1.0, 2.0, 3.0]);
        let there = Rigid::from_euler([0.0; 3], place);
        let turn = Rigid::from_rotation_vector(Vector3::new(0.0, 0.0, 0.03), Vector3::zeros());
        assert!((at(there * turn * there.inverse() * truth()) - 0.36).abs() < 1e-9);
    }

    #[test]
    fn a_covariance_of_squares_is_the_standard_deviations() {
        let by_sigmas = prior(&truth());
        let mut covariance = [[0.0; 6]; 6];
        let sigmas = [0.01, 0.02, 0.05, 0.1, 0.2, 0.3_f64];
        (0..6).for_each(|i| covariance[i][i] = sigmas[i].powi(2));
        let by_covariance = PosePrior {
            rotation_rad: None,
            translation_m: None,
            covariance: Some(covariance),
            ..by_sigmas.clone()
        };
        let pose = Rigid::from_euler([0.4, -0.1, 1.0], [51.0, 59.0, 7.5]).into();
        let [a, b] = [by_sigmas, by_covariance].map(|prior| {
            let known = Observations {
                prior: Some(prior),
                ..Observations::default()
            };
            known
                .about([5.0; 3], [50.0, 60.0, 7.0])
                .unwrap()
                .chi_squared(&pose)
        });
        assert!((a - b).abs() < 1e-9 * a && a > 1.0, "{a} {b}");
    }

    #[test]
    fn steps_lead_to_the_least_chi_squared() {
        // A prior and control points that contradict each other: Gauss and Newton's steps must end
        // where no small motion lowers the sum.
        let pose = Similarity {
            scale: 1.1,
            rigid: truth(),
        };
        let known = Observations {
            prior: Some(PosePrior {
                about: Some([4.0, -3.0, 2.0]),
                ..prior(&truth())
            }),
            control_points: controls(&pose, 5, 0.2, 3),
        };
        let local = known.about([0.0; 3], [50.0, 60.0, 7.0]).unwrap();
        let middle = [3.0, -2.0, 1.0];
        let about_middle = Similarity::from(Rigid::from_euler([0.0; 3], middle));
        let mut found = Similarity::identity();
        for _ in 0..30 {
            let mut sums = ScaledPlaneSums::default();
            local.add_to(&mut sums, &found, &middle, 1.0);
            let step = sums.solve(Freedom::Similarity).unwrap();
            found = about_middle * step * about_middle.inverse() * found;
        }
        let least = local.chi_squared(&found);
        assert!(least > 1.0);
        for parameter in 0..7 {
            for step in [-1e-4, 1e-4] {
                let mut v = [0.0; 7];
                v[parameter] = step;
                let turn = Vector3::new(v[0], v[1], v[2]);
                let shift = Vector3::new(v[3], v[4], v[5]);
                let motion = Similarity {
                    scale: 1.0 + v[6],
                    rigid: Rigid::from_rotation_vector(turn, shift),
                };
                assert!(local.chi_squared(&(motion * found)) > least, "{parameter}");
            }
        }
    }

    #[test]
    fn control_points_give_a_pose_with_an_honest_covariance() {
        let pose = Similarity {
            scale: 0.9,
            rigid: truth(),
        };
        for freedom in [Freedom::Rigid, Freedom::Similarity] {
            let truth = match freedom {
                Freedom::Similarity => pose,
                _ => pose.rigid.into(),
            };
            let (mut sum, n_trials) = (0.0, 200);
            for trial in 0..n_trials {
                let known = Observations {
                    prior: None,
                    control_points: controls(&truth, 6, 0.02, trial),
                };
                let local = known.about([0.0; 3], [0.0; 3]).unwrap();
                let found = local.pose_from_control_points(freedom).unwrap();
                // Where a place beside the middle comes to lie, against what the covariance expects.
                let place: Point = std::array::from_fn(|axis| found.middle[axis] + 25.0);
                let source = truth.inverse().apply(&place);
                let error = found.target_from_source.apply(&source)[0] - place[0];
                let row = shifts_of(&[25.0; 3]).row(0).into_owned();
                sum += error * error / (row * found.covariance * row.transpose())[0];
                assert_eq!(local.starts(freedom).len(), 1);
            }
            let ratio = sum / n_trials as f64;
            assert!((0.7..1.4).contains(&ratio), "{freedom:?} {ratio}");
        }
    }

    #[test]
    fn points_that_leave_the_pose_open_give_none() {
        let pose = truth().into();
        let with = |points: &[Point]| {
            let pair = |p: &Point| ControlPoint {
                source: *p,
                target: truth().apply(p),
                sigma_m: 0.1,
            };
            let control_points = points.iter().map(pair).collect();
            let known = Observations {
                prior: None,
                control_points,
            };
            known.about([0.0; 3], [0.0; 3]).unwrap()
        };
        let line = with(&[[0.0; 3], [1.0, 1.0, 0.0], [3.0, 3.0, 0.0], [7.0, 7.0, 0.0]]);
        assert!(line.pose_from_control_points(Freedom::Rigid).is_none());
        assert!(line.pose_from_control_points(Freedom::Levelled).is_some());
        let triangle = with(&[[0.0; 3], [1.0, 1.0, 0.0], [3.0, 0.0, 0.0]]);
        assert!(triangle.chi_squared(&pose) < 1e-20);
        let found = triangle.pose_from_control_points(Freedom::Rigid).unwrap();
        assert!((found.target_from_source.rigid.rotation - pose.rigid.rotation).amax() < 1e-12);
        assert!(with(&[]).pose_from_control_points(Freedom::Rigid).is_none());
        assert!(
            with(&[[1.0; 3]])
                .pose_from_control_points(Freedom::Levelled)
                .is_none()
        );
        assert!(LocalObservations::default().is_empty());
        assert!(
            LocalObservations::default()
                .starts(Freedom::Rigid)
                .is_empty()
        );
    }
}
