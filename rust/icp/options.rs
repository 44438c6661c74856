//! How ICP runs.

use serde::{Deserialize, Serialize};

use crate::error::{Result, require_between, require_count, require_positive};

/// What is made small.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum IcpMethod {
    /// Distances between points: Eq. (8), the paper's.
    PointToPoint,
    /// Distances from points to the planes that they share with their partners.
    PointToPlane,
    /// Distances between points, as far as the planes of both leave them no room (GICP).
    PlaneToPlane,
}

/// What a large residual counts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum IcpKernel {
    /// Its square, like all others.
    LeastSquares,
    /// Less and less, and nothing beyond 4.7 standard deviations, which are estimated from the median.
    Tukey,
}

/// How ICP runs. `None` means "derive this one from the data or the mode".
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct IcpOptions {
    /// `None`: point-to-plane in robust mode, point-to-point in paper mode.
    pub method: Option<IcpMethod>,
    /// `None`: Tukey's for the methods with planes, least squares for point-to-point.
    pub kernel: Option<IcpKernel>,
    /// Partners farther away do not count. `None`: two and a half voxels in robust mode, no limit in
    /// paper mode.
    pub max_distance_m: Option<f64>,
    /// Share of the pairs that count, closest first, in (0, 1]. `None`: estimated from their distances
    /// for the methods with planes, all for point-to-point.
    pub kept_share: Option<f64>,
    /// Whether samples of the source, each eight times as large as the one before, come to rest before
    /// all its points do: the same pose in a fraction of the time. `None`: yes, but not in paper mode.
    pub coarse_to_fine: Option<bool>,
    /// At most so many iterations, at least 1; of every sample as well.
    pub max_iterations: usize,
    /// Stop when the mean squared distance changes by less than this share of itself.
    pub relative_tolerance: f64,
}

impl Default for IcpOptions {
    fn default() -> Self {
        Self {
            method: None,
            kernel: None,
            max_distance_m: None,
            kept_share: None,
            coarse_to_fine: None,
            max_iterations: 50,
            relative_tolerance: 1e-6,
        }
    }
}

impl IcpOptions {
    pub(crate) fn check(&self) -> Result<()> {
        if let Some(max_distance) = self.max_distance_m {
            require_positive("icp.max_distance_m", max_distance)?;
        }
        if let Some(kept_share) = self.kept_share {
            require_positive("icp.kept_share", kept_share)?;
            require_between("icp.kept_share", kept_share, 0.0, 1.0)?;
        }
        require_count("icp.max_iterations", self.max_iterations, 1, 1_000_000)?;
        require_between("icp.relative_tolerance", self.relative_tolerance, 0.0, 1.0)?;
        Ok(())
    }

    /// The kernel that runs with `method`.
    pub(crate) fn kernel_of(&self, method: IcpMethod) -> IcpKernel {
        self.kernel.unwrap_or(match method {
            IcpMethod::PointToPoint => IcpKernel::LeastSquares,
            IcpMethod::PointToPlane | IcpMethod::PlaneToPlane => IcpKernel::Tukey,
        })
    }

    /// The share that counts with `method`; `None` for one that is estimated.
    pub(crate) fn kept_share_of(&self, method: IcpMethod) -> Option<f64> {
        match method {
            IcpMethod::PointToPoint => self.kept_share.or(Some(1.0)),
            IcpMethod::PointToPlane | IcpMethod::PlaneToPlane => self.kept_share,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn options_out_of_range_are_named() {
        let refused = |options: IcpOptions| options.check().unwrap_err().to_string();
        let no_share = IcpOptions {
            kept_share: Some(0.0),
            ..IcpOptions::default()
        };
        assert!(refused(no_share).contains("icp.kept_share"));
        let no_iterations = IcpOptions {
            max_iterations: 0,
            ..IcpOptions::default()
        };
        assert!(refused(no_iterations).contains("icp.max_iterations"));
    }
}
