//! Scenes that the tests of the route share: the same bits from the same seed, on any machine.
//!
//! A scene is a surface; a survey is a random sample of it with noise of its own. Two surveys of
//! one scene have no point in common, as two sensors have none.

#![allow(dead_code)] // every test file takes its share

use std::f64::consts::TAU;

use nalgebra::{Quaternion, UnitQuaternion};
use tmchho::config::Config;
use tmchho::pipeline::register;
use tmchho::progress::Progress;
use tmchho::random::Stream;
use tmchho::similarity::Similarity;
use tmchho::{Point, Registration, Rigid};

/// Longest side of every scene.
pub(crate) const SIDE_M: f64 = 100.0;

/// A surface that can be sampled.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Scene {
    /// Rolling ground with boulders and a wall with a corner.
    Field,
    /// A closed body with bumps, no symmetry, as in object scans.
    Body,
    /// Three walls, a floor and boxes on it: planes and edges only.
    Yard,
}

pub(crate) const SCENES: [Scene; 3] = [Scene::Field, Scene::Body, Scene::Yard];

impl Scene {
    /// `n` points of the surface with noise of so many metres; another `survey`, other points.
    pub(crate) fn survey(self, n: usize, noise_m: f64, survey: u64) -> Vec<Point> {
        let mut stream = Stream::new(survey, "survey", self as u64);
        let mut sample = || match self {
            Self::Field => field(&mut stream),
            Self::Body => body(&mut stream),
            Self::Yard => yard(&mut stream),
        };
        let exact: Vec<Point> = (0..n).map(|_| sample()).collect();
        exact
            .iter()
            .map(|p| p.map(|v| v + noise_m * stream.normal()))
            .collect()
    }
}

/// Ground z(x, y).
fn ground(x: f64, y: f64) -> f64 {
    5.0 * (0.071 * x + 0.5).sin() * (0.093 * y).cos()
        + 2.5 * (0.17 * x - 0.11 * y).sin()
        + 1.2 * (0.31 * y + 1.0).cos() * (0.002 * x * y).sin()
}

fn field(stream: &mut Stream) -> Point {
    const N_BOULDERS: usize = 14;
    let kind = stream.uniform();
    if kind < 0.7 {
        let (x, y) = (SIDE_M * stream.uniform(), SIDE_M * stream.uniform());
        [x, y, ground(x, y)]
    } else if kind < 0.85 {
        // The upper half of a ball, each of its own size.
        let which = stream.below(N_BOULDERS);
        let mut place = Stream::new(7, "boulder", which as u64);
        let (x, y) = (
            SIDE_M * place.uniform_between(0.1, 0.9),
            SIDE_M * place.uniform_between(0.1, 0.9),
        );
        let radius = place.uniform_between(2.0, 5.0);
        let d = direction(stream);
        [
            x + radius * d[0],
            y + radius * d[1],
            ground(x, y) + radius * d[2].abs(),
        ]
    } else {
        // A wall of two arms, 8 and 5 metres high.
        let along = stream.uniform();
        let (x, y, height) = if along < 0.65 {
            (30.0 + 60.0 * along, 62.0 + 6.0 * along, 8.0)
        } else {
            (69.0, 66.0 + 60.0 * (along - 0.65), 5.0)
        };
        [x, y, ground(x, y) + height * stream.uniform()]
    }
}

fn body(stream: &mut Stream) -> Point {
    let d = direction(stream);
    let waves = 0.16 * (3.0 * d[0] + 1.0).sin() * (2.0 * d[1]).cos()
        + 0.12 * (4.0 * d[1] * d[2] + 0.4).sin()
        + 0.07 * (7.0 * d[2] - 5.0 * d[0]).cos();
    // A nose and a fin.
    let towards = |axis: Point, width: f64| {
        let cosine: f64 = (0..3).map(|i| axis[i] * d[i]).sum();
        ((cosine - 1.0) / width).exp()
    };
    let radius = 0.28 * SIDE_M * (1.0 + waves)
        + 0.14 * SIDE_M * towards([0.6, 0.0, 0.8], 0.03)
        + 0.10 * SIDE_M * towards([-0.48, 0.8, -0.36], 0.06);
    [1.2, 1.0, 0.8]
        .iter()
        .zip(d)
        .map(|(stretch, v)| stretch * radius * v)
        .collect::<Vec<f64>>()
        .try_into()
        .unwrap_or_default()
}

fn yard(stream: &mut Stream) -> Point {
    // Boxes: lower corner and size. Only the sides that a sensor could see.
    const BOXES: [[f64; 6]; 5] = [
        [12.0, 15.0, 0.0, 20.0, 9.0, 12.0],
        [55.0, 10.0, 0.0, 12.0, 25.0, 7.0],
        [70.0, 48.0, 0.0, 9.0, 9.0, 22.0],
        [20.0, 45.0, 0.0, 6.0, 18.0, 5.0],
        [38.0, 30.0, 0.0, 11.0, 5.0, 16.0],
    ];
    let (u, v) = (stream.uniform(), stream.uniform());
    match stream.below(10) {
        0..4 => [SIDE_M * u, 0.75 * SIDE_M * v, 0.0],
        4 => [SIDE_M * u, 0.0, 25.0 * v],
        5 => [0.0, 0.75 * SIDE_M * u, 18.0 * v],
        _ => {
            let [x, y, z, a, b, c] = BOXES[stream.below(BOXES.len())];
            match stream.below(5) {
                0 => [x + a * u, y + b * v, z + c],
                1 => [x + a * u, y, z + c * v],
                2 => [x + a * u, y + b, z + c * v],
                3 => [x, y + b * u, z + c * v],
                _ => [x + a, y + b * u, z + c * v],
            }
        }
    }
}

/// A direction, each equally likely.
pub(crate) fn direction(stream: &mut Stream) -> Point {
    let z = stream.uniform_between(-1.0, 1.0);
    let (sin, cos) = (TAU * stream.uniform()).sin_cos();
    let radius = (1.0 - z * z).sqrt();
    [radius * cos, radius * sin, z]
}

/// A pose drawn from all of SO(3), with a shift of several times the scene.
pub(crate) fn any_pose(seed: u64) -> Rigid {
    let mut stream = Stream::new(seed, "pose", 0);
    let [w, x, y, z] = std::array::from_fn(|_| stream.normal());
    let shift = std::array::from_fn(|_| 3.0 * SIDE_M * stream.normal());
    Rigid {
        rotation: UnitQuaternion::new_normalize(Quaternion::new(w, x, y, z))
            .to_rotation_matrix()
            .into_inner(),
        ..Rigid::from_euler([0.0; 3], shift)
    }
}

/// Two surveys of one place, and the truth.
#[derive(Debug, Clone)]
pub(crate) struct Pair {
    pub(crate) source: Vec<Point>,
    pub(crate) target: Vec<Point>,
    pub(crate) target_from_source: Rigid,
}

impl Pair {
    /// Two surveys of `n` points, the source moved away by a pose of its own.
    pub(crate) fn new(scene: Scene, n: usize, seed: u64) -> Self {
        let noise_m = 0.03;
        Self::of(
            &scene.survey(n, noise_m, 2 * seed + 1),
            scene.survey(n, noise_m, 2 * seed + 2),
            any_pose(seed),
        )
    }

    /// `source` given in the frame of `target`, then moved away.
    pub(crate) fn of(source: &[Point], target: Vec<Point>, target_from_source: Rigid) -> Self {
        Self {
            source: moved(source, &target_from_source.inverse()),
            target,
            target_from_source,
        }
    }

    /// Keeps of the source what lies below, and of the target what lies above a share of the scene's
    /// side along x, in the frame of the target.
    pub(crate) fn cut(mut self, source_below: f64, target_above: f64) -> Self {
        let pose = self.target_from_source;
        self.source
            .retain(|p| pose.apply(p)[0] < source_below * SIDE_M);
        self.target.retain(|p| p[0] > target_above * SIDE_M);
        self
    }

    pub(crate) fn register(&self, config: &Config) -> Registration {
        register(&self.source, &self.target, config, &Progress::silent()).unwrap()
    }

    /// How far the pose puts a source point from where it belongs, at most.
    pub(crate) fn error_m(&self, pose: impl Into<Similarity>) -> f64 {
        farthest_m(&self.source, pose, self.target_from_source)
    }
}

/// How far apart two poses put a point, at most.
pub(crate) fn farthest_m(
    points: &[Point],
    a: impl Into<Similarity>,
    b: impl Into<Similarity>,
) -> f64 {
    let (a, b) = (a.into(), b.into());
    let apart_m = |p: &Point| distance_m(&a.apply(p), &b.apply(p));
    points.iter().map(apart_m).fold(0.0, f64::max)
}

pub(crate) fn distance_m(a: &Point, b: &Point) -> f64 {
    (0..3).map(|i| (a[i] - b[i]).powi(2)).sum::<f64>().sqrt()
}

pub(crate) fn moved(points: &[Point], pose: &Rigid) -> Vec<Point> {
    points.iter().map(|p| pose.apply(p)).collect()
}

pub(crate) fn scaled(points: &[Point], factor: f64) -> Vec<Point> {
    points.iter().map(|p| p.map(|v| factor * v)).collect()
}

/// Diagonal of the box round the points.
pub(crate) fn diagonal_m(points: &[Point]) -> f64 {
    let side = |axis: usize| {
        let values = points.iter().map(|p| p[axis]);
        values.clone().fold(f64::NEG_INFINITY, f64::max) - values.fold(f64::INFINITY, f64::min)
    };
    (0..3).map(|axis| side(axis).powi(2)).sum::<f64>().sqrt()
}
