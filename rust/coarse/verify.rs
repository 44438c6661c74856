//! Few poses, looked at closely: refined, scored in both directions, ranked, compared with rivals.

use super::descent::{self, Fixed, Shrinking};
use super::echoes::echoes;
use super::motion::Motion;
use super::robust::StandingOut;
use super::{differ, starts, without_points};
use crate::cloud::Point;
use crate::deadline::Deadline;
use crate::distance_field::NearestGrid;
use crate::error::Result;
use crate::fitness::{
    Agreement, Grids, Tolerance, Witnesses, agreement, off_plane_noise_m, weighted_share,
};
use crate::freedom::Freedom;
use crate::near_field::NearField;
use crate::normals::Surface;
use crate::observations::LocalObservations;
use crate::parallel;
use crate::progress::{Event, Progress, Stage};
use crate::random::Stream;
use crate::rigid::Rigid;
use crate::similarity::{Similarity, has_run_away};
use crate::surface_cloud::SurfaceCloud;

/// Points of the moving cloud that take part in the refinement.
const N_REFINED: usize = 1200;
/// Poses brought to rest in one turn, and turns at most.
const N_FINALISTS: usize = 4;
const MAX_FINISHING_TURNS: usize = 10;

const REFINE_POINTS: Shrinking = Shrinking {
    first: 0.06,
    last: 0.03,
    n_steps: 10,
};
const REFINE_PLANES: Shrinking = Shrinking {
    first: 0.03,
    last: 0.015,
    n_steps: 7,
};
const FINISH: Shrinking = Shrinking {
    first: 0.05,
    last: 0.006,
    n_steps: 24,
};

/// A partner farther away than this does not verify a pose.
const VERIFY_DISTANCE: f64 = 0.01;
/// Clouds that match exactly are still not compared more closely than this.
const LEAST_OFF_PLANE: f64 = 0.0005;
/// Rivals that are compared with the best pose; the next ones scored less in the first count.
const N_RIVALS: usize = 8;
/// Random poses that tell what chance reaches.
const N_CHANCE: usize = 4;

/// Cells of the near field: about as fine as the voxels.
const FINE_CELL: f64 = 1.0 / 200.0;
const MAX_BLOCKS: usize = 4_000_000;

/// Poses closer than this to the best one are the best one, not its rival.
const SAME_POSE_RAD: f64 = 5.0 * std::f64::consts::PI / 180.0;
const SAME_POSE: f64 = 0.02;

/// A pose that was looked at closely.
#[derive(Debug, Clone, Copy)]
pub(super) struct Verified {
    /// Takes the moving cloud to the fixed one.
    pub(super) pose: Similarity,
    pub(super) agreement: Agreement,
    /// Whether it was brought to rest.
    is_final: bool,
    /// Poses at which the clouds were compared on the way from where the last look left off.
    n_compared: usize,
}

impl Verified {
    /// The same, once so many more poses were compared.
    fn after(self, n_more: usize) -> Self {
        let n_compared = self.n_compared + n_more;
        Self { n_compared, ..self }
    }
}

/// What is known of the pose beforehand.
#[derive(Debug, Clone, Copy)]
pub(super) struct Knowledge<'a> {
    pub(super) known: &'a LocalObservations,
    /// Whether the source, of which it is known, is the cloud that moves.
    pub(super) source_moves: bool,
}

impl Knowledge<'_> {
    /// Whether a pose contradicts it beyond all doubt.
    fn excludes(&self, pose: &Similarity) -> bool {
        /// So many standard deviations of the sum of squares above its mean.
        const BEYOND: f64 = 6.0;
        if self.known.is_empty() {
            return false;
        }
        let n = self.known.n_observed() as f64;
        let most = n + BEYOND * (2.0 * n).sqrt();
        let sum = match self.source_moves {
            true => self.known.chi_squared(pose),
            false => self.known.chi_squared(&pose.inverse()),
        };
        sum > most
    }
}

/// Looks closely at poses and remembers what it saw.
#[derive(Debug)]
pub(super) struct Verifier<'a> {
    moving: &'a Witnesses,
    fixed: &'a Witnesses,
    /// What of the moving cloud is refined.
    points: Vec<Point>,
    surfaces: Vec<Surface>,
    moving_field: NearField,
    fixed_field: NearField,
    moving_grid: &'a NearestGrid,
    fixed_grid: &'a NearestGrid,
    knowledge: Knowledge<'a>,
    unit_m: f64,
    freedom: Freedom,
    /// By falling score.
    verified: Vec<Verified>,
    /// Weighted share of the best pose by that of its best rival; NaN before the first look.
    pub(super) ambiguity_ratio: f64,
    /// Best score so far, after each pose.
    pub(super) history: Vec<f64>,
    pub(super) n_evaluations: usize,
}

impl<'a> Verifier<'a> {
    pub(super) fn new(
        moving: &'a Witnesses,
        fixed: &'a Witnesses,
        [moving_grid, fixed_grid]: [&'a NearestGrid; 2],
        knowledge: Knowledge<'a>,
        unit_m: f64,
        freedom: Freedom,
    ) -> Result<Self> {
        let field = |cloud: &SurfaceCloud| {
            let (cell_m, reach_m) = (FINE_CELL * unit_m, VERIFY_DISTANCE * unit_m);
            NearField::new(cloud.points(), cell_m, reach_m, MAX_BLOCKS).ok_or_else(without_points)
        };
        let (moving_field, fixed_field) =
            parallel::both(|| field(&moving.cloud), || field(&fixed.cloud));
        let cloud = &moving.cloud;
        let refined = cloud.drawn_in_order(N_REFINED);
        Ok(Self {
            moving,
            fixed,
            points: cloud.points_of(&refined),
            surfaces: refined
                .iter()
                .map(|i| cloud.surfaces[*i as usize])
                .collect(),
            moving_field: moving_field?,
            fixed_field: fixed_field?,
            moving_grid,
            fixed_grid,
            knowledge,
            unit_m,
            freedom,
            verified: Vec::new(),
            ambiguity_ratio: f64::NAN,
            history: Vec::new(),
            n_evaluations: 0,
        })
    }

    /// Refines `poses` by what `motion` lets, scores each, and brings the leaders of all poses so far
    /// to rest, in all that is free. The first `n_certain` are looked at even when the deadline is over.
    pub(super) fn look_at(
        &mut self,
        poses: &[Rigid],
        n_certain: usize,
        motion: Motion,
        deadline: Deadline,
        progress: &Progress<'_>,
    ) -> Result<()> {
        let is_bound = motion != self.motion();
        let refined = parallel::map(poses.len(), |i| {
            progress.check()?;
            if i >= n_certain && deadline.is_over() {
                return Ok(None);
            }
            let (refined, n_made) = self.refined(&poses[i], motion);
            // Where noise is as large as a voxel, wrong poses that are free score more than a right one that is not, until
            // it is at rest.
            let looked_at = match is_bound {
                true => self.at_rest_once_bound(refined, motion),
                false => self.scored(refined, false),
            };
            Ok(Some(looked_at.after(n_made)))
        });
        // Somebody may have said stop meanwhile: then nothing more is told.
        let refined = refined.into_iter().collect::<Result<Vec<_>>>()?;
        for (i, verified) in refined.into_iter().enumerate() {
            let Some(verified) = verified else { continue };
            let best = self.best_score_so_far().max(verified.agreement.score());
            self.history.push(best);
            self.n_evaluations += verified.n_compared;
            self.verified.push(verified);
            progress.emit(&Event::Advanced {
                stage: Stage::Coarse,
                done: i + 1,
                total: poses.len(),
                best: Some(best),
            })?;
        }
        self.rank();
        self.finish_leaders(deadline, progress)?;
        self.ambiguity_ratio = self.lead_over_rivals();
        let best = self.best().map_or(0.0, |v| v.agreement.score());
        self.history.push(best.max(self.best_score_so_far()));
        Ok(())
    }

    /// Whether the best pose stands out, also from its `max_echoes` strongest echoes, which are looked
    /// at only where it otherwise would.
    pub(super) fn stands_out(
        &mut self,
        wanted: StandingOut,
        max_echoes: usize,
        deadline: Deadline,
        progress: &Progress<'_>,
    ) -> Result<bool> {
        let Some(best) = self.standing_out(wanted) else {
            return Ok(false);
        };
        let echoes = echoes(self.moving, self.fixed, &best, self.unit_m, max_echoes);
        if !echoes.is_empty() {
            self.look_at(&echoes, 0, self.motion(), deadline, progress)?;
        }
        Ok(self.standing_out(wanted).is_some())
    }

    /// The best pose, without its scale, if it stands out from the rivals met so far.
    pub(super) fn standing_out(&self, wanted: StandingOut) -> Option<Rigid> {
        let best = self.best()?;
        wanted
            .is_met_by(&best.agreement, self.ambiguity_ratio)
            .then_some(best.pose.rigid)
    }

    fn motion(&self) -> Motion {
        Motion::Free(self.freedom)
    }

    fn best_score_so_far(&self) -> f64 {
        self.history.last().copied().unwrap_or(0.0)
    }

    /// A pose refined as far as ranking needs, and how many steps that took.
    fn refined(&self, start: &Rigid, motion: Motion) -> (Similarity, usize) {
        let (points, grid, unit_m) = (&self.points, self.fixed_grid, self.unit_m);
        let pose = descent::to_points(points, grid, *start, motion, REFINE_POINTS.times(unit_m));
        let (pose, n_made) = self.to_planes(pose.into(), None, motion, REFINE_PLANES);
        (pose, REFINE_POINTS.n_steps + n_made)
    }

    fn to_planes(
        &self,
        start: Similarity,
        field: Option<&NearField>,
        motion: Motion,
        truncation: Shrinking,
    ) -> (Similarity, usize) {
        let fixed = Fixed {
            surfaces: &self.fixed.cloud.surfaces,
            grid: self.fixed_grid,
            field,
        };
        descent::to_planes(
            &self.points,
            &self.surfaces,
            fixed,
            start,
            motion,
            truncation.times(self.unit_m),
        )
    }

    /// Brings the leading poses to rest until the best one and its best rivals are: a pose that
    /// slides into the best one was no rival.
    fn finish_leaders(&mut self, deadline: Deadline, progress: &Progress<'_>) -> Result<()> {
        for _ in 0..MAX_FINISHING_TURNS {
            let leaders: Vec<Similarity> = self
                .distinct()
                .take(N_FINALISTS)
                .filter(|v| !v.is_final)
                .map(|v| v.pose)
                .collect();
            if leaders.is_empty() || deadline.is_over() {
                break;
            }
            let finished = parallel::map(leaders.len(), |i| {
                progress.check()?;
                Ok(self.at_rest(leaders[i], self.motion()))
            });
            let finished = finished.into_iter().collect::<Result<Vec<_>>>()?;
            self.n_evaluations += finished.iter().map(|v| v.n_compared).sum::<usize>();
            // What was brought to rest replaces what it came from.
            self.verified.retain(|v| !leaders.contains(&v.pose));
            self.verified.extend(finished);
            self.rank();
        }
        Ok(())
    }

    fn at_rest(&self, pose: Similarity, motion: Motion) -> Verified {
        let (pose, n_made) = self.to_planes(pose, Some(&self.fixed_field), motion, FINISH);
        self.scored(pose, true).after(n_made)
    }

    /// First by what `motion` lets, then by all that is free, unless that draws it off.
    fn at_rest_once_bound(&self, pose: Similarity, motion: Motion) -> Verified {
        let bound = self.at_rest(pose, motion);
        let free = self.at_rest(bound.pose, self.motion());
        match free.agreement.score() < bound.agreement.score() {
            true => bound.after(free.n_compared),
            false => free.after(bound.n_compared),
        }
    }

    fn scored(&self, pose: Similarity, is_final: bool) -> Verified {
        let tolerance = Tolerance::within(VERIFY_DISTANCE * self.unit_m);
        Verified {
            pose,
            agreement: self.agreement(&pose, tolerance),
            is_final,
            n_compared: 1,
        }
    }

    fn agreement(&self, pose: &Similarity, tolerance: Tolerance) -> Agreement {
        agreement(
            (self.moving, &self.moving_grids()),
            (self.fixed, &self.fixed_grids()),
            pose,
            tolerance,
        )
    }

    fn moving_grids(&self) -> Grids<'_> {
        Grids {
            fine: &self.moving_field,
            coarse: self.moving_grid,
        }
    }

    fn fixed_grids(&self) -> Grids<'_> {
        Grids {
            fine: &self.fixed_field,
            coarse: self.fixed_grid,
        }
    }

    fn rank(&mut self) {
        let knowledge = self.knowledge;
        self.verified
            .retain(|v| !has_run_away(v.pose.scale) && !knowledge.excludes(&v.pose));
        self.verified
            .sort_by(|a, b| b.agreement.score().total_cmp(&a.agreement.score()));
    }

    /// The best pose so far.
    pub(super) fn best(&self) -> Option<&Verified> {
        self.verified.first()
    }

    /// Poses, best first, each clearly different from every better one.
    pub(super) fn distinct(&self) -> impl Iterator<Item = &Verified> {
        let mut kept: Vec<&Verified> = Vec::new();
        for verified in &self.verified {
            let is_new = |k: &&Verified| self.are_distinct(&k.pose, &verified.pose);
            if kept.iter().all(is_new) {
                kept.push(verified);
            }
        }
        kept.into_iter()
    }

    /// Counts the best pose and its rivals at the accuracy that the clouds show at the best pose: at a
    /// wrong pose they lie off each other's planes and leave room for rivals.
    fn lead_over_rivals(&self) -> f64 {
        let Some(best) = self.best() else {
            return f64::NAN;
        };
        let distance_m = VERIFY_DISTANCE * self.unit_m;
        let fixed = (self.fixed, &self.fixed_grids());
        let noise_m = off_plane_noise_m(self.moving, fixed, &best.pose, distance_m);
        let off_plane_m = noise_m.clamp(LEAST_OFF_PLANE * self.unit_m, distance_m);
        let tolerance = Tolerance {
            distance_m,
            off_plane_m,
        };
        let leaders: Vec<&Verified> = self.distinct().take(N_RIVALS + 1).collect();
        let scores = parallel::map(leaders.len(), |i| {
            let pose = &leaders[i].pose;
            let moving = (self.moving, &self.moving_grids());
            weighted_share(moving, fixed, pose, tolerance) * leaders[i].agreement.concord()
        });
        let rival = scores[1..].iter().copied().fold(0.0, f64::max);
        if rival > 0.0 {
            scores[0] / rival
        } else {
            f64::INFINITY
        }
    }

    /// What chance reaches: the best score of a few random poses, each refined as every other pose,
    /// that do not end at the best one.
    pub(super) fn chance_score(&self, seed: u64) -> f64 {
        let mut stream = Stream::new(seed, "chance", 0);
        let poses: Vec<Rigid> = (0..N_CHANCE)
            .map(|_| starts::random_pose(self.fixed.cloud.points(), self.freedom, &mut stream))
            .collect();
        let refined = parallel::map(poses.len(), |i| {
            let (refined, _) = self.refined(&poses[i], self.motion());
            self.scored(refined, false)
        });
        let is_other = |v: &&Verified| {
            self.best()
                .is_none_or(|best| self.are_distinct(&best.pose, &v.pose))
        };
        refined
            .iter()
            .filter(is_other)
            .map(|v| v.agreement.score())
            .fold(0.0, f64::max)
    }

    fn are_distinct(&self, a: &Similarity, b: &Similarity) -> bool {
        differ(a, b, SAME_POSE_RAD, SAME_POSE * self.unit_m)
    }
}

#[cfg(test)]
mod tests {
    use super::super::descent::tests::waves;
    use super::*;

    #[test]
    fn a_cloud_that_shrank_to_nothing_leads_nobody() {
        let silent = Progress::silent();
        let clouds = [waves(1), waves(2)];
        let right = Rigid::identity().between_local_coordinates(clouds[0].origin, clouds[1].origin);
        let [moving, fixed] = Witnesses::of_both(clouds, 1000, 0.1, 0.015, &silent).unwrap();
        let grid = |of: &Witnesses| NearestGrid::new(of.cloud.points(), 0.02, 0.2, 1_000_000);
        let (moving_grid, fixed_grid) = (grid(&moving).unwrap(), grid(&fixed).unwrap());
        let nothing = LocalObservations::default();
        let knowledge = Knowledge {
            known: &nothing,
            source_moves: true,
        };
        let free = Freedom::Similarity;
        let grids = [&moving_grid, &fixed_grid];
        let mut verifier = Verifier::new(&moving, &fixed, grids, knowledge, 1.4, free).unwrap();
        let wrong = Rigid::from_euler([0.0, 0.0, 1.0], [0.2, 0.1, 0.0]);
        let scale_of_best = |verifier: &Verifier<'_>| verifier.best().unwrap().pose.scale;
        // On a point of the other cloud, where all of it finds a partner, it scores more than a wrong pose.
        let shrunk = Similarity {
            scale: 0.02,
            rigid: Rigid {
                rotation: right.rotation,
                translation: fixed.cloud.points()[7].into(),
            },
        };
        for pose in [wrong.into(), shrunk] {
            let scored = verifier.scored(pose, true);
            verifier.verified.push(scored);
        }
        let scores = [0, 1].map(|i| verifier.verified[i].agreement.score());
        assert!(scores[1] > scores[0], "{scores:?}");
        verifier.rank();
        assert_eq!(scale_of_best(&verifier), 1.0);
        // One that is nearly right is refined to the right one.
        let near = Rigid::from_euler([0.01, 0.0, 0.02], [0.01, 0.0, 0.01]) * right;
        let never = Deadline::after(None);
        verifier
            .look_at(&[near], 1, Motion::Free(free), never, &silent)
            .unwrap();
        assert!((scale_of_best(&verifier) - 1.0).abs() < 0.01);
        let best = verifier.best().unwrap().pose.rigid;
        assert!((best.translation - right.translation).norm() < 0.01);
    }
}
