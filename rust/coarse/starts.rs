//! Where the search starts: rotations spread evenly, and places where the moving cloud may belong.

use std::f64::consts::{SQRT_2, TAU};

use nalgebra::{Matrix3, Quaternion, UnitQuaternion};

use super::motion::Uprights;
use crate::cloud::{Point, distance_sq};
use crate::freedom::Freedom;
use crate::random::Stream;
use crate::rigid::Rigid;
use crate::surface_cloud::SurfaceCloud;

/// Distance of the places where the moving cloud may belong, in the first rounds and in later ones;
/// all lengths are shares of the unit.
const PITCH: [f64; 2] = [0.2, 0.15];
const N_FIRST_ROUNDS: usize = 2;
const REACH: f64 = 0.4;
const JITTER: f64 = 0.05;
/// Starts turned about a pose: so many rotations, each so often, within so far of where the pose is.
const N_TURNS: usize = 60;
const STARTS_A_TURN: usize = 4;
const JITTER_OF_TURNED: f64 = 0.1;
/// One in so many places, where few are enough.
const FEW: usize = 4;

/// Starts of one kind: every rotation at every place.
pub(super) struct Starts {
    rotations: Vec<Matrix3<f64>>,
    places: Vec<Point>,
    jitter_m: f64,
    /// What the jitter is drawn for: no two rounds share it.
    purpose: &'static str,
    round: u64,
    seed: u64,
}

/// So many points of the fixed cloud tell its places; more would only cost.
pub(super) const N_TO_TELL_PLACES: usize = 4000;

/// Points of the fixed cloud from which places are derived.
pub(super) fn sample(fixed: &SurfaceCloud) -> Vec<Point> {
    fixed.points_of(&fixed.drawn_in_order(N_TO_TELL_PLACES))
}

/// How many places the first rounds start at in a fixed cloud of which some points are given.
pub(super) fn n_places(some: &[Point], unit_m: f64) -> usize {
    anchors(some, PITCH[0] * unit_m, REACH * unit_m).len()
}

impl Starts {
    /// About `n_rotations` rotations, those that are free, at the places of the fixed cloud.
    pub(super) fn new(
        fixed: &SurfaceCloud,
        unit_m: f64,
        freedom: Freedom,
        (round, n_rotations): (usize, usize),
        seed: u64,
    ) -> Self {
        let mut stream = Stream::new(seed, "rotations", round as u64);
        let pitch = PITCH[usize::from(round >= N_FIRST_ROUNDS)];
        Self {
            rotations: rotations(n_rotations, freedom, &mut stream),
            places: anchors(&sample(fixed), pitch * unit_m, REACH * unit_m),
            jitter_m: JITTER * unit_m,
            purpose: "jitter",
            round: round as u64,
            seed,
        }
    }

    /// The same at one in [`FEW`] of those places.
    pub(super) fn few(
        fixed: &SurfaceCloud,
        unit_m: f64,
        freedom: Freedom,
        n_rotations: usize,
        seed: u64,
    ) -> Self {
        let all = Self::new(fixed, unit_m, freedom, (0, n_rotations), seed);
        Self {
            places: all.places.into_iter().step_by(FEW).collect(),
            purpose: "jitter of few",
            ..all
        }
    }

    /// Turns that leave up up, as dense as `n_rotations` are where all is free. No two calls in one search share a
    /// `purpose`.
    pub(super) fn upright(
        fixed: &SurfaceCloud,
        unit_m: f64,
        uprights: &Uprights,
        n_rotations: usize,
        purpose: &'static str,
        seed: u64,
    ) -> Self {
        let which = (0, n_rotations);
        let yaws = Self::new(fixed, unit_m, Freedom::Levelled, which, seed);
        Self {
            rotations: yaws
                .rotations
                .iter()
                .map(|yaw| uprights.rotation(yaw))
                .collect(),
            purpose,
            ..yaws
        }
    }

    /// `pose`, turned about where it brings the middle of the moving cloud, by rotations spread evenly over
    /// those that are free.
    pub(super) fn turned(pose: &Rigid, unit_m: f64, freedom: Freedom, seed: u64) -> Self {
        let mut stream = Stream::new(seed, "turns", 0);
        let turns = rotations(N_TURNS, freedom, &mut stream);
        Self {
            rotations: turns.iter().map(|turn| turn * pose.rotation).collect(),
            places: vec![pose.translation.into(); STARTS_A_TURN],
            jitter_m: JITTER_OF_TURNED * unit_m,
            purpose: "jitter of turned",
            round: 0,
            seed,
        }
    }

    pub(super) fn len(&self) -> usize {
        self.rotations.len() * self.places.len()
    }

    pub(super) fn pose(&self, i: usize) -> Rigid {
        let mut stream = Stream::new(self.seed, self.purpose, (self.round << 32) + i as u64);
        let place = self.places[i / self.rotations.len()];
        Rigid {
            rotation: self.rotations[i % self.rotations.len()],
            translation: place.map(|v| v + self.jitter_m * stream.normal()).into(),
        }
    }
}

/// Rotations spread evenly over those that are free, turned together at random: `n` over all of
/// SO(3), or about as dense round the vertical of levelled clouds.
fn rotations(n: usize, freedom: Freedom, stream: &mut Stream) -> Vec<Matrix3<f64>> {
    /// A descent goes on turning: yaws this many times as dense as needed catch narrow basins.
    const YAWS: f64 = 6.0;
    match freedom {
        Freedom::Rigid | Freedom::Similarity => all_rotations(n, stream),
        Freedom::Levelled => {
            let n = (YAWS * (n as f64).cbrt()).ceil();
            let first = stream.uniform();
            (0..n as usize)
                .map(|i| Rigid::from_euler([0.0, 0.0, TAU * (i as f64 + first) / n], [0.0; 3]))
                .map(|turn| turn.rotation)
                .collect()
        }
    }
}

/// Source: Alexa (2022), super-Fibonacci spirals.
fn all_rotations(n: usize, stream: &mut Stream) -> Vec<Matrix3<f64>> {
    const PSI: f64 = 1.533_751_168_755_204_2;
    let frame = random_rotation(stream);
    (0..n)
        .map(|i| {
            let s = i as f64 + 0.5;
            let t = s / n as f64;
            let (radius, co_radius) = (t.sqrt(), (1.0 - t).sqrt());
            let (alpha, beta) = (TAU * s / SQRT_2, TAU * s / PSI);
            let q = Quaternion::new(
                co_radius * beta.cos(),
                radius * alpha.sin(),
                radius * alpha.cos(),
                co_radius * beta.sin(),
            );
            (frame * UnitQuaternion::new_normalize(q))
                .to_rotation_matrix()
                .into_inner()
        })
        .collect()
}

/// A pose near one that is roughly known, within reach of the descents.
pub(super) fn near(known: &Rigid, unit_m: f64, freedom: Freedom, stream: &mut Stream) -> Rigid {
    const TURN_RAD: f64 = 0.1;
    const SHIFT: f64 = 0.03;
    let [x, y, z] = [0; 3].map(|_| TURN_RAD * stream.normal());
    let turn = match freedom {
        Freedom::Levelled => [0.0, 0.0, z],
        Freedom::Rigid | Freedom::Similarity => [x, y, z],
    };
    Rigid {
        rotation: Rigid::from_euler(turn, [0.0; 3]).rotation * known.rotation,
        translation: known
            .translation
            .map(|v| v + SHIFT * unit_m * stream.normal()),
    }
}

/// A rotation drawn uniformly from those that are free, and a place drawn from the fixed cloud.
pub(super) fn random_pose(fixed: &[Point], freedom: Freedom, stream: &mut Stream) -> Rigid {
    let rotation = match freedom {
        Freedom::Levelled => {
            Rigid::from_euler([0.0, 0.0, TAU * stream.uniform()], [0.0; 3]).rotation
        }
        _ => random_rotation(stream).to_rotation_matrix().into_inner(),
    };
    let place = (stream.uniform() * fixed.len() as f64) as usize;
    Rigid {
        rotation,
        translation: fixed[place].into(),
    }
}

/// A rotation drawn uniformly from SO(3).
fn random_rotation(stream: &mut Stream) -> UnitQuaternion<f64> {
    let [w, x, y, z] = std::array::from_fn(|_| stream.normal());
    UnitQuaternion::new_normalize(Quaternion::new(w, x, y, z))
}

/// Places in the fixed cloud where the centroid of the moving cloud may have to go.
///
/// The moving cloud covers about a ball of `reach` round its centroid; for every block of the fixed
/// cloud the centroid of what lies within that reach is one place, the block itself another;
/// places closer than about half a `pitch` count once. For clouds of equal size this gives a few
/// places round the middle, for a large fixed cloud a few hundred.
fn anchors(fixed_sample: &[Point], pitch: f64, reach: f64) -> Vec<Point> {
    const THINNING: f64 = 0.45;
    let mut blocks: Vec<[i64; 3]> = fixed_sample
        .iter()
        .map(|p| p.map(|v| (v / pitch).floor() as i64))
        .collect();
    blocks.sort_unstable();
    blocks.dedup();
    let reach_sq = reach * reach;
    let mut kept: Vec<Point> = Vec::new();
    let mut keep = |place: Point| {
        let spacing_sq = (THINNING * pitch).powi(2);
        if kept
            .iter()
            .all(|other| distance_sq(other, &place) >= spacing_sq)
        {
            kept.push(place);
        }
    };
    for block in &blocks {
        let centre: Point = block.map(|i| (i as f64 + 0.5) * pitch);
        let (mut sum, mut n) = ([0.0; 3], 0.0);
        for p in fixed_sample {
            if distance_sq(p, &centre) < reach_sq {
                (0..3).for_each(|axis| sum[axis] += p[axis]);
                n += 1.0;
            }
        }
        if n > 0.0 {
            keep(sum.map(|v| v / n));
        }
        keep(centre);
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cloud::Cloud;
    use crate::progress::Progress;

    #[test]
    fn rotations_cover_the_group_evenly() {
        // Any rotation has a start within 30° among 960: half the width of their cells is 20°.
        let mut stream = Stream::new(1, "test", 0);
        let starts = rotations(960, Freedom::Rigid, &mut stream);
        for _ in 0..200 {
            let wanted = random_rotation(&mut stream)
                .to_rotation_matrix()
                .into_inner();
            let nearest = starts
                .iter()
                .map(|r| ((r.transpose() * wanted).trace() - 1.0) / 2.0)
                .fold(-1.0, f64::max);
            assert!(nearest.clamp(-1.0, 1.0).acos().to_degrees() < 30.0);
        }
        assert!(starts.iter().all(|r| (r.determinant() - 1.0).abs() < 1e-12));
    }

    #[test]
    fn a_pose_is_turned_every_way_and_stays_about_where_it_is() {
        let pose = Rigid::from_euler([0.3, -1.0, 2.0], [40.0, -7.0, 3.0]);
        let starts = Starts::turned(&pose, 2.0, Freedom::Rigid, 1);
        let starts: Vec<Rigid> = (0..starts.len()).map(|i| starts.pose(i)).collect();
        let mut stream = Stream::new(1, "test", 0);
        for _ in 0..50 {
            let turn = random_rotation(&mut stream)
                .to_rotation_matrix()
                .into_inner();
            let cosine = |start: &Rigid| {
                let off = (turn * pose.rotation).transpose() * start.rotation;
                (off.trace() - 1.0) / 2.0
            };
            let nearest = starts.iter().map(cosine).fold(-1.0, f64::max);
            assert!(nearest > 60_f64.to_radians().cos(), "{nearest}");
        }
        let shifts = starts
            .iter()
            .map(|s| (s.translation - pose.translation).norm());
        let (n_moved, furthest) = shifts.fold((0, 0.0_f64), |(n, furthest), shift| {
            (n + usize::from(shift > 0.1), furthest.max(shift))
        });
        assert!(n_moved > 200 && furthest < 1.5, "{n_moved} {furthest}");
        let levelled = Starts::turned(&pose, 2.0, Freedom::Levelled, 1);
        let upright = (0..levelled.len()).all(|i| {
            let turn = levelled.pose(i).rotation * pose.rotation.transpose();
            (turn[(2, 2)] - 1.0).abs() < 1e-12
        });
        assert!(upright);
    }

    #[test]
    fn upright_starts_turn_about_the_vertical_alone() {
        let bowl: Vec<Point> = (0..400)
            .map(|i| [f64::from(i % 20), f64::from(i / 20)])
            .map(|[x, y]| [x, y, 0.02 * (x - 10.0).powi(2)])
            .collect();
        let bowl = Cloud::new(&bowl).unwrap();
        let bowl = SurfaceCloud::new(&bowl, 0, &Progress::silent()).unwrap();
        let as_given = Uprights::as_given();
        let starts = Starts::upright(&bowl, 10.0, &as_given, 240, "jitter of upright", 1);
        let poses: Vec<Rigid> = (0..starts.len()).map(|i| starts.pose(i)).collect();
        assert!(
            poses
                .iter()
                .all(|p| (p.rotation[(2, 2)] - 1.0).abs() < 1e-12)
        );
        let mut yaws: Vec<f64> = poses
            .iter()
            .map(|p| p.rotation[(1, 0)].atan2(p.rotation[(0, 0)]))
            .collect();
        yaws.sort_by(f64::total_cmp);
        let widest = yaws.windows(2).map(|w| w[1] - w[0]).fold(0.0, f64::max);
        assert!(widest < 10_f64.to_radians(), "{widest}");
    }

    #[test]
    fn few_starts_stand_at_a_quarter_of_the_places() {
        let slope: Vec<Point> = (0..3600)
            .map(|i| [f64::from(i % 60), f64::from(i / 60)])
            .map(|[x, y]| [x, y, 0.002 * x * x])
            .collect();
        let slope = Cloud::new(&slope).unwrap();
        let slope = SurfaceCloud::new(&slope, 0, &Progress::silent()).unwrap();
        let (unit_m, n_rotations) = (20.0, 10);
        let all = Starts::new(&slope, unit_m, Freedom::Rigid, (0, n_rotations), 1);
        let few = Starts::few(&slope, unit_m, Freedom::Rigid, n_rotations, 1);
        let n_places = n_places(&sample(&slope), unit_m);
        assert_eq!(all.len(), n_rotations * n_places);
        assert_eq!(few.len(), n_rotations * n_places.div_ceil(FEW));
        // The same places, though each start lies elsewhere.
        assert!(few.places.iter().all(|place| all.places.contains(place)));
        let shift = few.pose(0).translation - all.pose(0).translation;
        assert!(shift.norm() > 0.0 && shift.norm() < 10.0 * JITTER * unit_m);
    }

    #[test]
    fn a_large_cloud_has_many_places_and_a_small_one_few() {
        let square = |side: f64| -> Vec<Point> {
            let n = 60;
            (0..n * n)
                .map(|i| [f64::from(i % n), f64::from(i / n)].map(|v| v / f64::from(n) * side))
                .map(|[x, y]| [x, y, 0.0])
                .collect()
        };
        let (few, many) = (
            anchors(&square(0.7), 0.2, 0.4),
            anchors(&square(2.8), 0.2, 0.4),
        );
        assert!((5..60).contains(&few.len()), "{}", few.len());
        assert!(many.len() > 200, "{}", many.len());
        assert!(anchors(&[], 0.2, 0.4).is_empty());
    }
}
