//! What is known of a pose beside the clouds: a prior pose, and pairs of control points.
//!
//! Why: a GNSS position, a levelled tripod, a rough manual alignment or a few targets seen by both
//! sensors hold what the clouds leave open, and contradict a pose that is wrong.
//! Source: least squares with observed parameters (Gauss–Markov); the left Jacobian of SO(3) as in
//! Barfoot (2017), Section 7.1. Deviates: nowhere.
//! Absent on purpose: anything about clouds; names of files.

mod local;

use nalgebra::Matrix6;
use serde::{Deserialize, Serialize};

use crate::cloud::Point;
use crate::error::{Error, Result, require_positive};
use crate::rigid::Rigid;

use local::LocalPrior;
pub use local::{ControlPose, LocalObservations};

/// Observations of the pose, in the coordinates of the clouds as they were given.
///
/// ```
/// use tmchho::observations::{ControlPoint, Observations};
/// let mut known = Observations::default();
/// known.control_points.push(ControlPoint {
///     source: [1.0, 2.0, 3.0],
///     target: [500_001.0, 4_000_002.0, 103.0],
///     sigma_m: 0.01,
/// });
/// known.check()?;
/// known.control_points[0].sigma_m = 0.0;
/// assert!(known.check().unwrap_err().to_string().contains("control_points[0].sigma_m"));
/// # Ok::<(), tmchho::Error>(())
/// ```
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Observations {
    /// A pose that is known roughly.
    pub prior: Option<PosePrior>,
    /// Places measured in both clouds.
    pub control_points: Vec<ControlPoint>,
}

/// A pose that is known with some uncertainty. A scale is never prior knowledge: control points
/// give it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PosePrior {
    /// The 4×4 matrix from source to target, row by row.
    pub target_from_source: [[f64; 4]; 4],
    /// Standard deviations of the rotation about the axes of the target, in radians. `None`: the
    /// rotation is not known.
    #[serde(default)]
    pub rotation_rad: Option<[f64; 3]>,
    /// Standard deviations of the position of `about`, along the axes of the target. `None`: the
    /// position is not known.
    #[serde(default)]
    pub translation_m: Option<[f64; 3]>,
    /// Covariance of rotation and position in the place of the standard deviations, in rad² and m².
    #[serde(default)]
    pub covariance: Option<[[f64; 6]; 6]>,
    /// The place in the source whose position is known, such as the scanner's. `None`: the middle of
    /// the source.
    #[serde(default)]
    pub about: Option<Point>,
}

/// One place in both clouds.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ControlPoint {
    /// In the source.
    pub source: Point,
    /// In the target.
    pub target: Point,
    /// Standard deviation of each coordinate of the difference, both measurements together; > 0.
    pub sigma_m: f64,
}

impl Observations {
    /// Whether nothing is known.
    pub fn is_empty(&self) -> bool {
        self.prior.is_none() && self.control_points.is_empty()
    }

    /// Refuses what cannot be weighed.
    ///
    /// # Errors
    /// [`Error::InvalidArgument`] naming the entry.
    pub fn check(&self) -> Result<()> {
        self.about([0.0; 3], [0.0; 3]).map(drop)
    }

    /// The same with so much more uncertainty: what a pose from a coarse search can be held against.
    pub fn loosened(&self, angle_rad: f64, distance_m: f64) -> Self {
        let prior = self.prior.as_ref().map(|prior| PosePrior {
            rotation_rad: prior.rotation_rad.map(|s| s.map(|s| s.hypot(angle_rad))),
            translation_m: prior.translation_m.map(|s| s.map(|s| s.hypot(distance_m))),
            covariance: prior.covariance.map(|mut covariance| {
                for (i, row) in covariance.iter_mut().enumerate() {
                    row[i] += if i < 3 { angle_rad } else { distance_m }.powi(2);
                }
                covariance
            }),
            ..prior.clone()
        });
        let loosen = |point: &ControlPoint| ControlPoint {
            sigma_m: point.sigma_m.hypot(distance_m),
            ..*point
        };
        Self {
            prior,
            control_points: self.control_points.iter().map(loosen).collect(),
        }
    }

    /// The same for a source that was multiplied by `scale`; `middle` is that of the source as given.
    pub fn for_scaled_source(&self, scale: f64, middle: Point) -> Self {
        let grow = |p: &Point| p.map(|v| scale * v);
        let prior = self.prior.as_ref().map(|prior| {
            let about = prior.about.unwrap_or(middle);
            // The place keeps its position in the target.
            let mut matrix = prior.target_from_source;
            for row in matrix.iter_mut().take(3) {
                let turned: f64 = (0..3).map(|axis| row[axis] * about[axis]).sum();
                row[3] += (1.0 - scale) * turned;
            }
            PosePrior {
                target_from_source: matrix,
                about: Some(grow(&about)),
                ..prior.clone()
            }
        });
        let scaled = |point: &ControlPoint| ControlPoint {
            source: grow(&point.source),
            ..*point
        };
        Self {
            prior,
            control_points: self.control_points.iter().map(scaled).collect(),
        }
    }

    /// The same about the origins of the two clouds, in whose local coordinates poses are sought.
    ///
    /// # Errors
    /// As [`Observations::check`].
    pub fn about(&self, source_origin: Point, target_origin: Point) -> Result<LocalObservations> {
        let local = |p: &Point, origin: Point| std::array::from_fn(|axis| p[axis] - origin[axis]);
        let prior = match &self.prior {
            None => None,
            Some(prior) => {
                let mean = Rigid::from_matrix4(&prior.target_from_source)
                    .map_err(|error| within("prior.target_from_source", error))?;
                let about = prior.about.unwrap_or(source_origin);
                require_finite("prior.about", &about)?;
                Some(LocalPrior {
                    mean: mean.between_local_coordinates(source_origin, target_origin),
                    about: local(&about, source_origin),
                    whitening: prior.whitening()?,
                })
            }
        };
        let mut control_points = Vec::with_capacity(self.control_points.len());
        for (i, point) in self.control_points.iter().enumerate() {
            require_finite(&format!("control_points[{i}].source"), &point.source)?;
            require_finite(&format!("control_points[{i}].target"), &point.target)?;
            require_positive(&format!("control_points[{i}].sigma_m"), point.sigma_m)?;
            control_points.push(ControlPoint {
                source: local(&point.source, source_origin),
                target: local(&point.target, target_origin),
                sigma_m: point.sigma_m,
            });
        }
        Ok(LocalObservations {
            prior,
            control_points,
        })
    }
}

impl PosePrior {
    /// W with Wᵀ·W = the inverse of the covariance; rows of zeros for what is not known.
    fn whitening(&self) -> Result<Matrix6<f64>> {
        let Some(covariance) = &self.covariance else {
            if self.rotation_rad.is_none() && self.translation_m.is_none() {
                return Err(Error::argument(
                    "prior",
                    "says nothing: give rotation_rad, translation_m or covariance",
                ));
            }
            let mut whitening = Matrix6::zeros();
            for (name, sigmas, first) in [
                ("prior.rotation_rad", self.rotation_rad, 0),
                ("prior.translation_m", self.translation_m, 3),
            ] {
                for (axis, sigma) in sigmas.iter().flatten().enumerate() {
                    require_positive(name, *sigma)?;
                    whitening[(first + axis, first + axis)] = 1.0 / sigma;
                }
            }
            return Ok(whitening);
        };
        let refuse = |problem: &str| Error::argument("prior.covariance", problem);
        if self.rotation_rad.is_some() || self.translation_m.is_some() {
            return Err(refuse(
                "stands for the standard deviations: give one or the other",
            ));
        }
        let covariance = Matrix6::from_fn(|r, c| covariance[r][c]);
        let uneven = (covariance - covariance.transpose()).amax();
        if !uneven.is_finite() || uneven > 1e-9 * covariance.amax() {
            return Err(refuse("must be symmetric, of finite numbers"));
        }
        covariance
            .cholesky()
            .and_then(|root| root.l().try_inverse())
            .ok_or_else(|| refuse("must be positive definite"))
    }
}

fn within(name: &str, error: Error) -> Error {
    match error {
        Error::InvalidArgument { problem, .. } => Error::argument(name, problem),
        other => other,
    }
}

fn require_finite(name: &str, point: &Point) -> Result<()> {
    if point.iter().all(|v| v.is_finite()) {
        Ok(())
    } else {
        Err(Error::argument(name, "must hold three finite numbers"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn prior() -> PosePrior {
        PosePrior {
            target_from_source: Rigid::from_euler([0.3, -0.2, 1.1], [50.0, 60.0, 7.0]).to_matrix4(),
            rotation_rad: Some([0.01, 0.02, 0.05]),
            translation_m: Some([0.1, 0.2, 0.3]),
            covariance: None,
            about: None,
        }
    }

    #[test]
    fn what_cannot_be_weighed_is_named() {
        let refused = |change: &dyn Fn(&mut PosePrior)| {
            let mut prior = prior();
            change(&mut prior);
            let known = Observations {
                prior: Some(prior),
                ..Observations::default()
            };
            known.check().unwrap_err().to_string()
        };
        assert!(
            refused(&|p| p.target_from_source[0][0] = 3.0).contains("prior.target_from_source")
        );
        assert!(
            refused(&|p| p.rotation_rad = Some([0.1, 0.0, 0.1])).contains("prior.rotation_rad")
        );
        assert!(
            refused(&|p| p.translation_m = Some([f64::NAN; 3])).contains("prior.translation_m")
        );
        assert!(refused(&|p| p.about = Some([f64::INFINITY; 3])).contains("prior.about"));
        assert!(refused(&|p| p.covariance = Some([[1.0; 6]; 6])).contains("one or the other"));
        let alone = |p: &mut PosePrior| (p.rotation_rad, p.translation_m) = (None, None);
        assert!(refused(&alone).contains("says nothing"));
        let with = |covariance: [[f64; 6]; 6]| {
            refused(&|p| {
                alone(p);
                p.covariance = Some(covariance);
            })
        };
        assert!(with([[1.0; 6]; 6]).contains("positive definite"));
        let mut uneven = [[0.0; 6]; 6];
        uneven[1][2] = 1.0;
        assert!(with(uneven).contains("symmetric"));
        let mut known = Observations::default();
        assert!(known.is_empty() && known.check().is_ok());
        let nowhere = ControlPoint {
            source: [0.0; 3],
            target: [0.0, 0.0, f64::NAN],
            sigma_m: 0.1,
        };
        known.control_points = vec![nowhere];
        assert!(
            known
                .check()
                .unwrap_err()
                .to_string()
                .contains("control_points[0].target")
        );
    }
}
