//! Stage 7 besides: signed change along the normal, and whether it can be told from noise.
//!
//! Why: a distance says nothing without the distance that chance would have made. M3C2 averages both
//! clouds in a cylinder along the normal of the surface and states, for each place, the change that
//! can be detected: from the roughness of both surfaces there and from the error of the registration.
//! Reads: places (cores) and the neighbour indices of both clouds, in one frame.  Leaves: for each
//! core the change and its level of detection.
//! Source: Lague, Brodu & Leroux (2013), Eq. 1 and Sec. 3; scales that follow from spacing and
//! roughness as they advise (Sec. 4): 20 points in a cylinder, a normal over 25 times the roughness.
//! Of several normal scales the flattest is taken, as in py4dgeo.
//! Deviates: the published level takes every point for an observation of its own, which edges and
//! rough ground punish with false alarms. A change is significant here only where it also exceeds
//! the level for clustered points (Liang & Zeger 1986), with Student's t for so few clusters.
//! Absent on purpose: the error of the registration itself, which `uncertainty.rs` knows.

mod cylinder;
mod normal;
mod scales;

pub use scales::M3c2Scales;

use cylinder::{Along, across, clustered_half_width};
use normal::flattest_normal;

use crate::cloud::Point;
use crate::error::{Error, Result, require_at_least, require_between, require_positive};
use crate::neighbors::{NeighborIndex, map_places};
use crate::progress::Progress;

/// Of a normal distribution 95 % lie within so many standard deviations.
const SIGMAS_OF_95: f64 = 1.96;

/// How change is measured.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct M3c2Options {
    /// Radii of the balls in which the normal is sought; the flattest is taken. `None`: the first of
    /// 1, 1½, 2, 3 and 4 cylinder radii whose diameter is 25 times the roughness across it, and twice
    /// that.
    pub normal_radii_m: Option<Vec<f64>>,
    /// Radius of the cylinder in which points are averaged ("d/2"). `None`: nine in ten hold 20 points
    /// of the sparser cloud.
    pub cylinder_radius_m: Option<f64>,
    /// How far the cylinder reaches to either side of the core. `None`: ten radii.
    pub max_depth_m: Option<f64>,
    /// The term "reg": what the registration may be wrong by, 1σ.
    pub registration_error_m: f64,
    /// Normals point to this side.
    pub orientation: Point,
    /// A change is significant only where each cloud has so many points in the cylinder; at least 2.
    pub min_points: usize,
}

impl Default for M3c2Options {
    fn default() -> Self {
        Self {
            normal_radii_m: None,
            cylinder_radius_m: None,
            max_depth_m: None,
            registration_error_m: 0.0,
            orientation: [0.0, 0.0, 1.0],
            min_points: 5,
        }
    }
}

/// The change at a core. Numbers are NaN where there is nothing to tell them from.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct M3c2Change {
    /// Unit normal of the reference.
    pub normal: Point,
    /// Radius of the ball in which it was found.
    pub normal_radius_m: f64,
    /// From the reference to the compared cloud along the normal: their mean places in the cylinder.
    pub distance_m: f64,
    /// The level of detection at 95 % as published: 1.96·(√(σ₁²/n₁ + σ₂²/n₂) + reg).
    pub level_of_detection_m: f64,
    /// The smallest change that is significant here: the level of detection, or the one in which
    /// neighbouring points, which err alike, count as one observation, whichever is larger; infinite
    /// where all points of a cloud are neighbours. Neighbours lie in the same sixth of the cylinder and
    /// in the same slab of it, about as thick as its radius.
    pub significant_from_m: f64,
    /// Standard deviation along the normal in the reference and in the compared cloud (n − 1).
    pub spread_m: (f64, f64),
    /// Points of both in the cylinder.
    pub n_points: (u32, u32),
    /// Whether the change exceeds that, and each cloud has enough points.
    pub is_significant: bool,
}

impl M3c2Options {
    fn check(&self) -> Result<()> {
        if let Some(radii_m) = &self.normal_radii_m {
            require_at_least("normal_radii: its length", radii_m.len(), 1)?;
            for radius_m in radii_m {
                require_positive("normal_radii", *radius_m)?;
            }
        }
        let lengths = [
            ("cylinder_radius", self.cylinder_radius_m),
            ("max_depth", self.max_depth_m),
        ];
        for (name, length_m) in lengths {
            length_m.map_or(Ok(0.0), |length_m| require_positive(name, length_m))?;
        }
        require_between(
            "registration_error",
            self.registration_error_m,
            0.0,
            f64::MAX,
        )?;
        require_at_least("min_points", self.min_points, 2)?;
        let length_sq = self.orientation.iter().map(|v| v * v).sum::<f64>();
        if length_sq.is_finite() && length_sq > 0.0 {
            return Ok(());
        }
        Err(Error::argument(
            "orientation",
            "must be a direction, not zero",
        ))
    }
}

/// The change from `reference` to `compared` at each of `cores`, in their order.
///
/// ```
/// use tmchho::{m3c2::{M3c2Options, M3c2Scales, m3c2}, neighbors::NeighborIndex, progress::Progress};
/// let floor = |z: f64| -> Vec<[f64; 3]> {
///     (0..400).map(|i| [f64::from(i % 20), f64::from(i / 20), z]).collect()
/// };
/// let (before, after) = (NeighborIndex::new(&floor(0.0)), NeighborIndex::new(&floor(-0.25)));
/// let scales = M3c2Scales { normal_radii_m: vec![3.0], cylinder_radius_m: 2.0, max_depth_m: 1.0 };
/// let options = M3c2Options { registration_error_m: 0.1, ..M3c2Options::default() };
/// let silent = Progress::silent();
/// let change = m3c2(&[[10.0, 10.0, 0.0]], &before, &after, &scales, &options, &silent)?[0];
/// assert_eq!((change.normal, change.distance_m), ([0.0, 0.0, 1.0], -0.25));
/// assert!((change.level_of_detection_m - 0.196).abs() < 1e-12 && change.is_significant);
/// # Ok::<(), tmchho::Error>(())
/// ```
///
/// # Errors
/// [`Error::InvalidArgument`] for the options, [`Error::Cancelled`].
pub fn m3c2(
    cores: &[Point],
    reference: &NeighborIndex,
    compared: &NeighborIndex,
    scales: &M3c2Scales,
    options: &M3c2Options,
    progress: &Progress<'_>,
) -> Result<Vec<M3c2Change>> {
    options.check()?;
    let no_scratch = || ();
    map_places(cores, progress, no_scratch, |(), i| {
        change_at(&cores[i], [reference, compared], scales, options)
    })
}

fn change_at(
    core: &Point,
    clouds: [&NeighborIndex; 2],
    scales: &M3c2Scales,
    options: &M3c2Options,
) -> M3c2Change {
    let (radius_m, depth_m) = (scales.cylinder_radius_m, scales.max_depth_m);
    let radii_m = &scales.normal_radii_m;
    let (normal, normal_radius_m) = flattest_normal(core, clouds[0], radii_m, &options.orientation);
    let axes = across(&normal);
    let [first, second] = clouds.map(|cloud| {
        let mut along = Along::new(axes, radius_m, depth_m);
        if normal_radius_m.is_finite() {
            cloud.each_in_cylinder(core, &normal, radius_m, depth_m, |t, offset| {
                along.add(t, &offset);
            });
        }
        along
    });
    let distance_m = second.mean() - first.mean();
    let (n_1, n_2) = (first.n(), second.n());
    let by_chance = (first.variance() / f64::from(n_1) + second.variance() / f64::from(n_2)).sqrt();
    let systematic = SIGMAS_OF_95 * options.registration_error_m;
    let level_of_detection_m = SIGMAS_OF_95 * by_chance + systematic;
    let clustered_m = clustered_half_width(&first, &second) + systematic;
    let significant_from_m = if level_of_detection_m.is_nan() {
        f64::NAN
    } else {
        level_of_detection_m.max(clustered_m)
    };
    M3c2Change {
        normal,
        normal_radius_m,
        distance_m,
        level_of_detection_m,
        significant_from_m,
        spread_m: (first.variance().sqrt(), second.variance().sqrt()),
        n_points: (n_1, n_2),
        is_significant: distance_m.abs() > significant_from_m
            && n_1.min(n_2) as usize >= options.min_points,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Stream;

    fn ground(n: usize, noise_m: f64, lift_m: f64, stream: &mut Stream) -> Vec<Point> {
        (0..n)
            .map(|_| {
                let (x, y) = (
                    stream.uniform_between(0.0, 20.0),
                    stream.uniform_between(0.0, 20.0),
                );
                [x, y, 0.4 * x + lift_m + noise_m * stream.normal()]
            })
            .collect()
    }

    fn cores(stream: &mut Stream) -> Vec<Point> {
        (0..400)
            .map(|_| {
                let (x, y) = (
                    stream.uniform_between(3.0, 17.0),
                    stream.uniform_between(3.0, 17.0),
                );
                [x, y, 0.4 * x]
            })
            .collect()
    }

    /// Sums over all points of the same cylinder.
    fn by_brute_force(
        core: &Point,
        normal: &Point,
        cloud: &[Point],
        scales: &M3c2Scales,
    ) -> Vec<f64> {
        let along = |p: &Point| {
            let offset: Point = std::array::from_fn(|axis| p[axis] - core[axis]);
            let t: f64 = (0..3).map(|axis| offset[axis] * normal[axis]).sum();
            let across_sq = offset.iter().map(|v| v * v).sum::<f64>() - t * t;
            let radius_m = scales.cylinder_radius_m;
            (across_sq <= radius_m * radius_m && t.abs() <= scales.max_depth_m).then_some(t)
        };
        cloud.iter().filter_map(along).collect()
    }

    #[test]
    fn every_number_is_what_the_formulas_say() {
        let mut stream = Stream::new(1, "m3c2", 0);
        let before = ground(8000, 0.02, 0.0, &mut stream);
        let after = ground(6000, 0.05, -0.3, &mut stream);
        let cores = cores(&mut stream);
        let (a, b) = (NeighborIndex::new(&before), NeighborIndex::new(&after));
        let silent = Progress::silent();
        let options = M3c2Options {
            registration_error_m: 0.004,
            ..M3c2Options::default()
        };
        let scales = M3c2Scales::derive(&a, &b, &options, &silent).unwrap();
        assert_eq!(scales.max_depth_m, 10.0 * scales.cylinder_radius_m);
        let found = m3c2(&cores, &a, &b, &scales, &options, &silent).unwrap();
        for (core, change) in cores.iter().zip(found) {
            let variance = |t: &[f64]| {
                let mean = t.iter().sum::<f64>() / t.len() as f64;
                let squares = t.iter().map(|v| (v - mean) * (v - mean)).sum::<f64>();
                (mean, squares / (t.len() - 1) as f64)
            };
            let first = by_brute_force(core, &change.normal, &before, &scales);
            let second = by_brute_force(core, &change.normal, &after, &scales);
            assert_eq!(change.n_points, (first.len() as u32, second.len() as u32));
            let ((mean_1, var_1), (mean_2, var_2)) = (variance(&first), variance(&second));
            assert!((change.distance_m - (mean_2 - mean_1)).abs() < 1e-12);
            let (n_1, n_2) = (first.len() as f64, second.len() as f64);
            let wanted = 1.96 * ((var_1 / n_1 + var_2 / n_2).sqrt() + 0.004);
            assert!((change.level_of_detection_m - wanted).abs() < 1e-12);
            assert!((change.spread_m.0 - var_1.sqrt()).abs() < 1e-12);
            assert!((change.distance_m + 0.3 / 1.16_f64.sqrt()).abs() < 0.06);
            assert!(change.is_significant);
        }
    }

    #[test]
    fn one_change_in_twenty_exceeds_the_published_level_by_chance() {
        let mut stream = Stream::new(2, "m3c2", 0);
        let (a, b) = (
            NeighborIndex::new(&ground(40_000, 0.03, 0.0, &mut stream)),
            NeighborIndex::new(&ground(40_000, 0.02, 0.0, &mut stream)),
        );
        let silent = Progress::silent();
        let options = M3c2Options::default();
        let scales = M3c2Scales::derive(&a, &b, &options, &silent).unwrap();
        let cores: Vec<Point> = (0..5).flat_map(|_| cores(&mut stream)).collect();
        let found = m3c2(&cores, &a, &b, &scales, &options, &silent).unwrap();
        let share = |is: &dyn Fn(&M3c2Change) -> bool| {
            found.iter().filter(|change| is(change)).count() as f64 / found.len() as f64
        };
        let exceed = share(&|c| c.distance_m.abs() > c.level_of_detection_m);
        assert!((0.03..0.08).contains(&exceed), "{exceed}");
        let significant = share(&|c| c.is_significant);
        assert!((0.01..0.05).contains(&significant), "{significant}");
    }

    #[test]
    fn points_that_err_alike_do_not_add_up_to_certainty() {
        // Waves a little wider than the cylinder, each survey with its own.
        let mut stream = Stream::new(5, "m3c2", 0);
        let mut wavy = |phase: f64| -> Vec<Point> {
            let smooth = ground(60_000, 0.002, 0.0, &mut stream);
            let wave = |p: &Point| 0.02 * (5.0 * p[0] + phase).sin() * (5.0 * p[1] - phase).sin();
            smooth
                .iter()
                .map(|p| [p[0], p[1], p[2] + wave(p)])
                .collect()
        };
        let (a, b) = (
            NeighborIndex::new(&wavy(0.0)),
            NeighborIndex::new(&wavy(2.0)),
        );
        let (silent, options) = (Progress::silent(), M3c2Options::default());
        let scales = M3c2Scales {
            normal_radii_m: vec![1.0],
            cylinder_radius_m: 0.4,
            max_depth_m: 1.0,
        };
        let found = m3c2(&cores(&mut stream), &a, &b, &scales, &options, &silent).unwrap();
        let of = |is: &dyn Fn(&M3c2Change) -> bool| found.iter().filter(|c| is(c)).count();
        let exceed = of(&|c| c.distance_m.abs() > c.level_of_detection_m);
        assert!(exceed > 80, "{exceed} of 400");
        assert!(of(&|c| c.is_significant) < 20);
    }

    #[test]
    fn any_number_of_threads_gives_the_same_bits() {
        let mut stream = Stream::new(6, "m3c2", 0);
        let (a, b) = (
            ground(20_000, 0.03, 0.0, &mut stream),
            ground(20_000, 0.03, 0.1, &mut stream),
        );
        let places: Vec<Point> = (0..10).flat_map(|_| cores(&mut stream)).collect();
        let measured = |n_threads| {
            crate::parallel::with_threads(Some(n_threads), || {
                let (a, b) = (NeighborIndex::new(&a), NeighborIndex::new(&b));
                let (silent, options) = (Progress::silent(), M3c2Options::default());
                let scales = M3c2Scales::derive(&a, &b, &options, &silent)?;
                let found = m3c2(&places, &a, &b, &scales, &options, &silent)?;
                let bits = |c: &M3c2Change| [c.distance_m, c.significant_from_m].map(f64::to_bits);
                Ok(found.iter().map(bits).collect::<Vec<_>>())
            })
        };
        let one = measured(1);
        assert!(one.is_ok());
        assert_eq!(one, measured(4));
    }

    #[test]
    fn twenty_points_and_a_flat_normal() {
        let mut stream = Stream::new(3, "m3c2", 0);
        // Dense and smooth against sparse and rough: the sparse one sets the cylinder.
        let dense = NeighborIndex::new(&ground(40_000, 0.001, 0.0, &mut stream));
        let sparse = NeighborIndex::new(&ground(10_000, 0.3, 0.0, &mut stream));
        let (silent, options) = (Progress::silent(), M3c2Options::default());
        let smooth = M3c2Scales::derive(&dense, &dense, &options, &silent).unwrap();
        let mixed = M3c2Scales::derive(&dense, &sparse, &options, &silent).unwrap();
        assert!(mixed.cylinder_radius_m > 1.9 * smooth.cylinder_radius_m);
        let r = smooth.cylinder_radius_m;
        assert_eq!(smooth.normal_radii_m, [r, 2.0 * r]);
        let rough = M3c2Scales::derive(&sparse, &dense, &options, &silent).unwrap();
        assert!(rough.normal_radii_m[0] > rough.cylinder_radius_m);
        let given = M3c2Options {
            normal_radii_m: Some(vec![0.5]),
            cylinder_radius_m: Some(0.25),
            max_depth_m: Some(3.0),
            ..options
        };
        let nothing = NeighborIndex::new(&[]);
        let scales = M3c2Scales::derive(&nothing, &nothing, &given, &silent).unwrap();
        assert_eq!((scales.cylinder_radius_m, scales.max_depth_m), (0.25, 3.0));
    }

    #[test]
    fn where_a_cloud_is_missing_nothing_is_told() {
        let mut stream = Stream::new(4, "m3c2", 0);
        let a = NeighborIndex::new(&ground(2000, 0.01, 0.0, &mut stream));
        let scales = M3c2Scales {
            normal_radii_m: vec![2.0],
            cylinder_radius_m: 1.0,
            max_depth_m: 2.0,
        };
        let (silent, options) = (Progress::silent(), M3c2Options::default());
        let lone = NeighborIndex::new(&[[10.0, 10.0, 4.1]]);
        let places = [[10.0, 10.0, 4.0], [100.0, 0.0, 0.0], [f64::NAN; 3]];
        let found = m3c2(&places, &a, &lone, &scales, &options, &silent).unwrap();
        assert_eq!(found[0].n_points.1, 1);
        assert!((found[0].distance_m - 0.1 / 1.16_f64.sqrt()).abs() < 0.01);
        assert!(found[0].level_of_detection_m.is_nan() && !found[0].is_significant);
        for change in &found[1..] {
            assert!(change.distance_m.is_nan() && change.normal_radius_m.is_nan());
            assert_eq!(change.n_points, (0, 0));
        }
    }

    #[test]
    fn wrong_options_are_refused() {
        let index = NeighborIndex::new(&[[0.0; 3]; 9]);
        let silent = Progress::silent();
        let refused = |options: M3c2Options| {
            M3c2Scales::derive(&index, &index, &options, &silent)
                .unwrap_err()
                .to_string()
        };
        let default = M3c2Options::default;
        for (options, word) in [
            (
                M3c2Options {
                    normal_radii_m: Some(vec![]),
                    ..default()
                },
                "normal_radii",
            ),
            (
                M3c2Options {
                    cylinder_radius_m: Some(0.0),
                    ..default()
                },
                "cylinder_radius",
            ),
            (
                M3c2Options {
                    max_depth_m: Some(f64::NAN),
                    ..default()
                },
                "max_depth",
            ),
            (
                M3c2Options {
                    registration_error_m: -1.0,
                    ..default()
                },
                "registration_error",
            ),
            (
                M3c2Options {
                    min_points: 1,
                    ..default()
                },
                "min_points",
            ),
            (
                M3c2Options {
                    orientation: [0.0; 3],
                    ..default()
                },
                "orientation",
            ),
            (default(), "coincident"),
        ] {
            let message = refused(options);
            assert!(message.contains(word), "{message}");
        }
    }
}
