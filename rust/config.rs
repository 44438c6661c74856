//! Every setting of the route, with its default beside its algorithm and nowhere else.
//!
//! `None` means "derive this one from the data". Unknown keys are refused at every level, so that a
//! misspelt option never runs silently with its default.

use serde::{Deserialize, Serialize};

use crate::cloud::Point;
use crate::coarse::{PaperSearchOptions, RobustSearchOptions};
use crate::error::{Error, Result, require_count, require_positive};
use crate::freedom::Freedom;
use crate::fuse::FuseOptions;
use crate::icp::{IcpMethod, IcpOptions};
use crate::keypoints::{IssOptions, RADIUS_IN_VOXELS};
use crate::observations::Observations;
use crate::outlier::OutlierOptions;
use crate::verdict::VerdictOptions;
use crate::voxel::VoxelOptions;

/// Which search is run.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Mode {
    /// Many starts, verified in both directions: what users get.
    #[default]
    Robust,
    /// The paper's method, plain: keypoints, TMCHHO on the RMS of Eq. (1), point-to-point ICP.
    Paper,
}

/// Every doubling of the range costs four more searches.
const MAX_SCALE_RANGE: f64 = 1e4;

/// All settings of [`crate::pipeline::register`].
///
/// ```
/// use tmchho::config::{Config, Mode};
/// let config = Config::from_json(r#"{"mode": "paper", "voxel": {"voxel_size_m": 0.1}}"#)?;
/// assert_eq!(config.mode, Mode::Paper);
/// assert_eq!(config.keypoints.max_ratio_second_to_first, 0.65);
/// let misspelt = Config::from_json(r#"{"voxel": {"voxel_sise_m": 0.1}}"#).unwrap_err();
/// assert!(misspelt.to_string().contains("voxel_sise_m"));
/// # Ok::<(), tmchho::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// Which search is run.
    pub mode: Mode,
    /// Seed of all random numbers.
    pub seed: u64,
    /// Threads; `None` for the machine's. Never changes the result.
    pub n_threads: Option<usize>,
    /// What may differ between the clouds (robust mode): 4, 6 or 7 degrees of freedom.
    pub dof: Freedom,
    /// What is known of the pose beforehand (robust mode): a prior, control points.
    pub known: Observations,
    /// Where the scale is sought with 7 degrees of freedom: by what the source may have to be
    /// multiplied, least and most.
    pub scale_bounds: [f64; 2],
    /// Lower and upper corner of the box in which source points take part in finding the pose, as
    /// given; `None` for all.
    pub source_crop_m: Option<[Point; 2]>,
    /// The same for the target.
    pub target_crop_m: Option<[Point; 2]>,
    /// Stage 1, radius outlier removal.
    pub outliers: OutlierOptions,
    /// Stage 2, voxel centroids.
    pub voxel: VoxelOptions,
    /// Stage 3, ISS keypoints (paper mode).
    pub keypoints: IssOptions,
    /// Stage 4 in robust mode.
    pub coarse: RobustSearchOptions,
    /// Stage 4 in paper mode.
    pub paper: PaperSearchOptions,
    /// Stage 5, ICP.
    pub icp: IcpOptions,
    /// Stage 6, the verdict.
    pub verdict: VerdictOptions,
    /// Stage 8, fusion.
    pub fuse: FuseOptions,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            mode: Mode::default(),
            seed: 0,
            n_threads: None,
            dof: Freedom::default(),
            known: Observations::default(),
            scale_bounds: [0.5, 2.0],
            source_crop_m: None,
            target_crop_m: None,
            outliers: OutlierOptions::default(),
            voxel: VoxelOptions::default(),
            keypoints: IssOptions::default(),
            coarse: RobustSearchOptions::default(),
            paper: PaperSearchOptions::default(),
            icp: IcpOptions::default(),
            verdict: VerdictOptions::default(),
            fuse: FuseOptions::default(),
        }
    }
}

impl Config {
    /// Reads JSON; keys left out keep their defaults.
    ///
    /// # Errors
    /// [`Error::InvalidArgument`] naming an unknown key or a value of the wrong kind.
    pub fn from_json(json: &str) -> Result<Self> {
        serde_json::from_str(json).map_err(|error| {
            // The parser's "at line 1 column 9" means nothing to somebody who wrote TOML.
            let problem = error.to_string();
            let problem = problem.split(" at line ").next().unwrap_or_default();
            Error::argument("the configuration", format!("is not valid: {problem}"))
        })
    }

    /// Writes JSON that [`Config::from_json`] reads back.
    pub fn to_json(&self) -> String {
        // Only maps with keys that are not strings can fail, and there are none.
        serde_json::to_string(self).unwrap_or_default()
    }

    /// Refuses what no stage could work with, before any of them has begun.
    ///
    /// # Errors
    /// [`Error::InvalidArgument`] naming the key.
    pub fn check(&self) -> Result<()> {
        if let Some(n_threads) = self.n_threads {
            require_count("n_threads", n_threads, 1, 1024)?;
        }
        if self.mode == Mode::Paper && self.dof != Freedom::Rigid {
            return Err(Error::argument("dof", "must be 6 in paper mode"));
        }
        if self.mode == Mode::Paper && !self.known.is_empty() {
            return Err(Error::argument(
                "known",
                "must be empty in paper mode, which starts from nothing",
            ));
        }
        self.known.check()?;
        let [least, most] = self.scale_bounds;
        if !(least > 0.0 && least <= most && most / least <= MAX_SCALE_RANGE) {
            return Err(Error::argument(
                "scale_bounds",
                format!(
                    "must be two rising numbers above 0, the second at most {MAX_SCALE_RANGE} times \
                     the first, got {least} and {most}"
                ),
            ));
        }
        for (name, corners) in [
            ("source_crop_m", &self.source_crop_m),
            ("target_crop_m", &self.target_crop_m),
        ] {
            // Also refuses NaN.
            let is_box = |[low, high]: &[Point; 2]| (0..3).all(|axis| low[axis] < high[axis]);
            if !corners.as_ref().is_none_or(is_box) {
                return Err(Error::argument(
                    name,
                    "must be a lower and an upper corner, each coordinate of the first below that of \
                     the second",
                ));
            }
        }
        for (name, value) in [
            ("outliers.radius_m", self.outliers.radius_m),
            ("keypoints.radius_m", self.keypoints.radius_m),
            (
                "keypoints.non_max_radius_m",
                self.keypoints.non_max_radius_m,
            ),
            (
                "keypoints.max_ratio_second_to_first",
                Some(self.keypoints.max_ratio_second_to_first),
            ),
            (
                "keypoints.max_ratio_third_to_second",
                Some(self.keypoints.max_ratio_third_to_second),
            ),
        ] {
            value.map_or(Ok(()), |value| require_positive(name, value).map(drop))?;
        }
        self.voxel.check()?;
        self.coarse.check()?;
        self.paper.check()?;
        self.icp.check()?;
        self.verdict.check()?;
        self.fuse.check()
    }

    /// Fills in what was derived from the data.
    pub(crate) fn resolve(&mut self, voxel_size_m: f64, max_distance_m: f64) {
        self.voxel.voxel_size_m = Some(voxel_size_m);
        let (method, max_distance_m) = match self.mode {
            Mode::Robust => (IcpMethod::PointToPlane, Some(max_distance_m)),
            Mode::Paper => {
                let radius_m = RADIUS_IN_VOXELS * voxel_size_m;
                self.keypoints.radius_m = self.keypoints.radius_m.or(Some(radius_m));
                // The paper's ICP takes all pairs, unless a distance was asked for.
                (IcpMethod::PointToPoint, self.icp.max_distance_m)
            }
        };
        self.icp.method = self.icp.method.or(Some(method));
        let is_robust = self.mode == Mode::Robust;
        self.icp.coarse_to_fine = self.icp.coarse_to_fine.or(Some(is_robust));
        self.icp.max_distance_m = max_distance_m;
    }
}
