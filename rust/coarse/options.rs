//! How hard the robust search tries.

use serde::{Deserialize, Serialize};

use crate::error::{Result, require_count, require_positive};

/// How hard the robust search tries.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RobustSearchOptions {
    /// Rotations of each round; the next round is only begun while the best pose does not stand
    /// out. At least one round of at least one rotation; places lie closer together from the third on. Before
    /// several rounds there is a brief one, of the first one's rotations at a quarter of its places, and between
    /// them are those of yaws alone, as dense as the second one's rotations, with both clouds upright or level.
    pub rotations_per_round: Vec<usize>,
    /// Poses of each round that are refined and verified; at least 1.
    pub n_verified: usize,
    /// Whether poses are also proposed by descriptors, in a round of its own: the first where one cloud is much
    /// larger than the other, else before the last.
    pub descriptors: bool,
    /// Seconds after which the search hands over the best pose so far, counted from the beginning
    /// of the registration; above 0. `None` for no limit. What is found then depends on the
    /// machine.
    pub max_seconds: Option<f64>,
}

impl Default for RobustSearchOptions {
    fn default() -> Self {
        Self {
            rotations_per_round: vec![60, 240],
            n_verified: 32,
            descriptors: true,
            max_seconds: None,
        }
    }
}

impl RobustSearchOptions {
    pub(crate) fn check(&self) -> Result<()> {
        let rounds = &self.rotations_per_round;
        require_count(
            "the length of coarse.rotations_per_round",
            rounds.len(),
            1,
            1000,
        )?;
        for n in rounds {
            require_count("coarse.rotations_per_round", *n, 1, 100_000)?;
        }
        require_count("coarse.n_verified", self.n_verified, 1, 10_000)?;
        if let Some(max_seconds) = self.max_seconds {
            require_positive("coarse.max_seconds", max_seconds)?;
        }
        Ok(())
    }
}
