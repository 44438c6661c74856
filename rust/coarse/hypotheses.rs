//! Poses proposed by points whose surroundings look alike in both clouds.
//!
//! Most matches of descriptors are wrong. Right ones keep their distances and the angles between
//! their normals from one cloud to the other: they form a dense spot in the graph of matches that
//! agree with each other, and each spot proposes a pose.
//! Source: mutual matches and a compatibility graph as in Leordeanu & Hebert (2005) and Chen et al.
//! (2022, second-order measure); ours in its details.

use crate::cloud::{Point, distance_sq};
use crate::descriptors::{Described, Descriptor, SOME, SomeDescriptors};
use crate::error::Result;
use crate::freedom::Freedom;
use crate::kabsch::PairSums;
use crate::parallel;
use crate::progress::Progress;
use crate::rigid::Rigid;
use crate::surface_cloud::SurfaceCloud;
use crate::vectorize::widest;

use super::differ_rigid;

/// As shares of the unit: the voxel of the described clouds, where normals and descriptors look.
const VOXEL: f64 = 0.02;
const NORMAL_RADIUS: f64 = 0.03;
const RADIUS: f64 = 0.075;
/// Matching costs the product of the numbers of points: larger clouds are described more coarsely.
const MAX_PRODUCT: f64 = 3e7;
/// This share of each cloud, what is least like the rest of it, is also matched alone: level ground looks alike everywhere,
/// and its matches, closest of all, crowd out those that tell a place. Where little is shared they are needed.
const LEAST_USUAL: f64 = 0.5;

const MAX_MATCHES: usize = 2000;
const N_SEEDS: usize = 200;
const N_MATES: usize = 20;
const MAX_HYPOTHESES: usize = 60;
/// Matches agree where distances differ by less than this many voxels, and the angles between
/// normals by less than this.
const TOLERANCE_IN_VOXELS: f64 = 1.5;
const ANGLE_RAD: f64 = 23.0 * std::f64::consts::PI / 180.0;
const SAME_RAD: f64 = 8.0 * std::f64::consts::PI / 180.0;

/// A pose, and how many matches it explains.
#[derive(Debug, Clone, Copy)]
pub(super) struct Hypothesis {
    pub(super) pose: Rigid,
    pub(super) consensus: usize,
}

/// Proposes poses of the moving cloud in the fixed one, those that explain most matches first.
pub(super) fn propose(
    moving: &SurfaceCloud,
    fixed: &SurfaceCloud,
    unit_m: f64,
    freedom: Freedom,
    progress: &Progress<'_>,
) -> Result<Vec<Hypothesis>> {
    let thinned = |voxel_m: f64| {
        let of = |cloud: &SurfaceCloud| cloud.one_for_each_cell(voxel_m);
        parallel::both(|| of(moving), || of(fixed))
    };
    let mut voxel_m = VOXEL * unit_m;
    let mut points = thinned(voxel_m);
    let product = points.0.len() as f64 * points.1.len() as f64;
    if product > MAX_PRODUCT {
        // Points grow with the square of the voxel's edge, their product with the fourth power.
        voxel_m *= (product / MAX_PRODUCT).powf(0.25);
        points = thinned(voxel_m);
    }
    let describe = |cloud: &SurfaceCloud, points: &[Point]| {
        let normal_m = (NORMAL_RADIUS * unit_m).max(1.5 * voxel_m);
        let radius_m = (RADIUS * unit_m).max(3.75 * voxel_m);
        Described::new(cloud, points, normal_m, radius_m, progress)
    };
    let (a, b) = parallel::both(
        || describe(moving, &points.0),
        || describe(fixed, &points.1),
    );
    let (a, b) = (a?, b?);
    let tolerance_m = TOLERANCE_IN_VOXELS * voxel_m;
    let of_all = propose_for(&a, &b, tolerance_m, freedom);
    progress.check()?;
    let (a, b) = (a.least_usual(LEAST_USUAL), b.least_usual(LEAST_USUAL));
    let of_least_usual = propose_for(&a, &b, tolerance_m, freedom);
    progress.check()?;
    // In turns, as what explains most matches is not comparable between the two.
    let n = of_all.len().max(of_least_usual.len());
    let in_turns = (0..n).flat_map(|i| [of_all.get(i), of_least_usual.get(i)]);
    Ok(distinct(in_turns.flatten().copied(), tolerance_m))
}

/// The first of each of several poses that hardly differ.
fn distinct(hypotheses: impl Iterator<Item = Hypothesis>, tolerance_m: f64) -> Vec<Hypothesis> {
    let mut kept: Vec<Hypothesis> = Vec::new();
    for hypothesis in hypotheses {
        let is_new =
            |k: &Hypothesis| differ_rigid(&k.pose, &hypothesis.pose, SAME_RAD, 2.0 * tolerance_m);
        if kept.len() < MAX_HYPOTHESES && kept.iter().all(is_new) {
            kept.push(hypothesis);
        }
    }
    kept
}

/// The same from the matches between two described clouds.
fn propose_for(
    a: &Described,
    b: &Described,
    tolerance_m: f64,
    freedom: Freedom,
) -> Vec<Hypothesis> {
    let matches = mutual_matches(&a.descriptors, &b.descriptors);
    let graph = Graph::new(a, b, &matches, tolerance_m, freedom);
    let pairs: Vec<(Point, Point)> = matches
        .iter()
        .map(|m| (a.points[m.0 as usize], b.points[m.1 as usize]))
        .collect();
    let seeds = graph.seeds();
    let found = parallel::map(seeds.len(), |i| {
        let mates = graph.mates(seeds[i]);
        pose_from(&pairs, &mates, tolerance_m, freedom)
    });
    let mut found: Vec<Hypothesis> = found.into_iter().flatten().collect();
    found.sort_by_key(|hypothesis| std::cmp::Reverse(hypothesis.consensus));
    distinct(found.into_iter(), tolerance_m)
}

/// Pairs of points that are each other's most similar one, the most similar pairs first.
fn mutual_matches(a: &[Descriptor], b: &[Descriptor]) -> Vec<(u32, u32)> {
    let parts = a.len().div_ceil(PART);
    let found = parallel::map(parts, |part| {
        let first = part * PART;
        most_similar(&a[first..a.len().min(first + PART)], b)
    });
    // Of equals the first wins: parts come in order.
    let mut back = vec![NOBODY; b.len()];
    for (part, (_, from_b)) in found.iter().enumerate() {
        for (best, (score, i)) in back.iter_mut().zip(from_b) {
            if *score > best.0 {
                *best = (*score, (part * PART) as u32 + i);
            }
        }
    }
    let forth = found.into_iter().flat_map(|(from_a, _)| from_a);
    let mut mutual: Vec<(f32, u32, u32)> = (0_u32..)
        .zip(forth)
        .filter(|(i, (_, j))| back.get(*j as usize).is_some_and(|(_, k)| k == i))
        .map(|(i, (score, j))| (score, i, j))
        .collect();
    mutual.sort_by(|a, b| b.0.total_cmp(&a.0));
    mutual.truncate(MAX_MATCHES);
    mutual.into_iter().map(|(_, i, j)| (i, j)).collect()
}

/// Descriptors of one cloud that are compared in one piece of work.
const PART: usize = 128;
/// How similar the most similar one is, and which it is.
type MostSimilar = (f32, u32);
const NOBODY: MostSimilar = (f32::NEG_INFINITY, u32::MAX);

/// For each of either side the most similar of the other; of equals the first.
fn most_similar(a: &[Descriptor], b: &[Descriptor]) -> (Vec<MostSimilar>, Vec<MostSimilar>) {
    let (mut of_a, mut of_b) = (vec![NOBODY; a.len()], vec![NOBODY; b.len()]);
    widest(
        #[inline(always)]
        || {
            for (block, (b, of_b)) in b.chunks(SOME).zip(of_b.chunks_mut(SOME)).enumerate() {
                let some = SomeDescriptors::new(b);
                let (mut most, mut who) = ([f32::NEG_INFINITY; SOME], [u32::MAX; SOME]);
                for (i, (a, of_a)) in (0_u32..).zip(a.iter().zip(&mut of_a)) {
                    let scores = some.similarities(a);
                    for lane in 0..SOME {
                        let is_more = scores[lane] > most[lane];
                        most[lane] = if is_more { scores[lane] } else { most[lane] };
                        who[lane] = if is_more { i } else { who[lane] };
                    }
                    let greatest = scores[..b.len()].iter().copied().fold(of_a.0, f32::max);
                    if greatest > of_a.0 {
                        let lane = scores.iter().position(|score| *score == greatest);
                        *of_a = (greatest, (block * SOME + lane.unwrap_or(0)) as u32);
                    }
                }
                for (of_b, most) in of_b.iter_mut().zip(most.into_iter().zip(who)) {
                    *of_b = most;
                }
            }
        },
    );
    (of_a, of_b)
}

/// Which matches agree with which, a bit each.
struct Graph {
    words: usize,
    bits: Vec<u64>,
    n: usize,
}

impl Graph {
    fn new(
        a: &Described,
        b: &Described,
        matches: &[(u32, u32)],
        tolerance_m: f64,
        freedom: Freedom,
    ) -> Self {
        let n = matches.len();
        let words = n.div_ceil(64);
        let angle = |normals: &[Point], i: u32, j: u32| {
            let (p, q) = (normals[i as usize], normals[j as usize]);
            (p[0] * q[0] + p[1] * q[1] + p[2] * q[2])
                .clamp(-1.0, 1.0)
                .acos()
        };
        let agree = |i: usize, j: usize| {
            let ((a1, b1), (a2, b2)) = (matches[i], matches[j]);
            let (p, q) = (&a.points[a1 as usize], &a.points[a2 as usize]);
            let (r, s) = (&b.points[b1 as usize], &b.points[b2 as usize]);
            let (here, there) = (distance_sq(p, q).sqrt(), distance_sq(r, s).sqrt());
            // Pairs that lie close together agree whatever the pose.
            if (here - there).abs() > tolerance_m || here < 2.0 * tolerance_m {
                return false;
            }
            if freedom == Freedom::Levelled && ((p[2] - q[2]) - (r[2] - s[2])).abs() > tolerance_m {
                return false;
            }
            (angle(&a.normals, a1, a2) - angle(&b.normals, b1, b2)).abs() < ANGLE_RAD
        };
        let rows = parallel::map(n, |i| {
            let mut row = vec![0_u64; words];
            for j in (0..n).filter(|j| *j != i) {
                if agree(i, j) {
                    row[j / 64] |= 1 << (j % 64);
                }
            }
            row
        });
        Self {
            words,
            bits: rows.into_iter().flatten().collect(),
            n,
        }
    }

    fn row(&self, i: usize) -> &[u64] {
        &self.bits[i * self.words..(i + 1) * self.words]
    }

    fn in_common(&self, i: usize, j: usize) -> u32 {
        let pairs = self.row(i).iter().zip(self.row(j));
        pairs.map(|(a, b)| (a & b).count_ones()).sum()
    }

    fn neighbors(&self, i: usize) -> impl Iterator<Item = usize> {
        (0..self.n).filter(move |j| self.row(i)[j / 64] >> (j % 64) & 1 == 1)
    }

    /// The matches in the densest spots: those with most triangles.
    fn seeds(&self) -> Vec<usize> {
        let triangles = parallel::map(self.n, |i| {
            self.neighbors(i)
                .map(|j| u64::from(self.in_common(i, j)))
                .sum::<u64>()
        });
        let mut order: Vec<usize> = (0..self.n).filter(|i| triangles[*i] > 0).collect();
        order.sort_by_key(|i| std::cmp::Reverse(triangles[*i]));
        order.truncate(N_SEEDS);
        order
    }

    /// The seed and the matches that have most agreeing matches in common with it.
    fn mates(&self, seed: usize) -> Vec<usize> {
        let mut mates: Vec<usize> = self.neighbors(seed).collect();
        mates.sort_by_cached_key(|j| std::cmp::Reverse(self.in_common(seed, *j)));
        mates.truncate(N_MATES);
        mates.push(seed);
        mates
    }
}

/// The pose of some matches, fitted again to all that it explains.
fn pose_from(
    pairs: &[(Point, Point)],
    mates: &[usize],
    tolerance_m: f64,
    freedom: Freedom,
) -> Option<Hypothesis> {
    const REFITS: usize = 2;
    let solve = |sums: &PairSums| match freedom {
        Freedom::Levelled => sums.solve_levelled(),
        Freedom::Rigid | Freedom::Similarity => sums.solve(),
    };
    let mut sums = PairSums::default();
    for i in mates {
        sums.add(&pairs[*i].0, &pairs[*i].1, 1.0);
    }
    let mut pose = solve(&sums)?;
    let explained = |pose: &Rigid| {
        let max_sq = tolerance_m * tolerance_m;
        let pose = *pose;
        pairs
            .iter()
            .filter(move |(p, q)| distance_sq(&pose.apply(p), q) <= max_sq)
    };
    for _ in 0..REFITS {
        let mut sums = PairSums::default();
        explained(&pose).for_each(|(p, q)| sums.add(p, q, 1.0));
        match solve(&sums) {
            Some(better) => pose = better,
            None => break,
        }
    }
    Some(Hypothesis {
        consensus: explained(&pose).count(),
        pose,
    })
}
