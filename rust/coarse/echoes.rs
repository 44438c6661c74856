//! Where else a pose would fit if the clouds repeat themselves: a row of windows, of piers, of steps.
//!
//! Why: few starts meet the best pose and miss the same pose a period further on. Along a façade the
//! plane agrees anywhere, so a coarse cost does not see the period; the points of high curvature do.
//! Every pair of them votes for the shift that brings one onto the other; shifts with about as many
//! votes as none at all are echoes. Source: ours, after the generalised Hough transform (Ballard 1981).

use nalgebra::Vector3;

use crate::cloud::{Point, difference, distance_sq, dot};
use crate::fitness::Witnesses;
use crate::parallel;
use crate::rigid::Rigid;

/// Witnesses of the moving cloud that vote: those of the highest curvature.
const N_VOTERS: usize = 300;
/// Edge of the cells that votes are counted in, and how far away echoes are sought; shares of the
/// unit, as all lengths.
const CELL: f64 = 0.02;
const REACH: f64 = 0.6;
/// Nearer shifts are the pose itself.
const ITSELF: f64 = 0.05;
/// Votes for an echo by those for no shift, at least.
const LEAST_VOTES: f64 = 0.5;
/// Echoes are at least this far apart.
const APART: f64 = 0.04;
/// Surfaces slope alike within 37°, whichever way their normals point.
const MIN_COSINE: f64 = 0.8;

/// The pose shifted to its strongest echoes, at most `max`, the strongest first.
pub(super) fn echoes(
    moving: &Witnesses,
    fixed: &Witnesses,
    pose: &Rigid,
    unit_m: f64,
    max: usize,
) -> Vec<Rigid> {
    let Some((voters, least_weight)) = of_highest_curvature(moving) else {
        return Vec::new();
    };
    let surface = |of: &Witnesses, i: usize| (of.cloud.points()[i], of.cloud.surfaces[i].normal);
    let voters: Vec<(Point, Point)> = voters
        .into_iter()
        .map(|i| surface(moving, i))
        .map(|(p, normal)| (pose.apply(&p), pose.rotate(&normal)))
        .collect();
    let of_fixed = fixed.numbers().iter().map(|j| *j as usize);
    let places: Vec<(Point, Point)> = of_fixed
        .filter(|j| fixed.weights[*j] >= least_weight)
        .map(|j| surface(fixed, j))
        .collect();
    let votes_of = |voters: &[(Point, Point)]| {
        let mut votes = Votes::new(CELL * unit_m, REACH * unit_m);
        for (place, slope) in &places {
            for (p, normal) in voters {
                if dot(normal, slope).abs() > MIN_COSINE {
                    votes.add(difference(place, p));
                }
            }
        }
        votes
    };
    let (first, second) = voters.split_at(voters.len() / 2);
    let (mut votes, others) = parallel::both(|| votes_of(first), || votes_of(second));
    votes.merge(&others);
    let shifted = |shift: Point| Rigid {
        rotation: pose.rotation,
        translation: pose.translation + Vector3::from(shift),
    };
    let peaks = votes.peaks(ITSELF * unit_m, APART * unit_m, LEAST_VOTES, max);
    peaks.into_iter().map(shifted).collect()
}

/// The witnesses that weigh most, and the least weight among them. Planes have none to speak of.
fn of_highest_curvature(of: &Witnesses) -> Option<(Vec<usize>, f64)> {
    let drawn = of.cloud.drawn(of.len());
    let mut order: Vec<usize> = drawn.iter().map(|i| *i as usize).collect();
    // A stable sort: of equals those drawn first, which lie spread over the cloud.
    order.sort_by(|a, b| of.weights[*b].total_cmp(&of.weights[*a]));
    order.truncate(N_VOTERS);
    let least = of.weights[*order.last()?];
    Some((order, least))
}

/// Votes for shifts, counted in cells.
struct Votes {
    cells_per_m: f64,
    /// Cells along each edge of a cube round no shift.
    edge: usize,
    counts: Vec<u32>,
}

impl Votes {
    fn new(cell_m: f64, reach_m: f64) -> Self {
        let edge = 2 * (reach_m / cell_m).ceil() as usize + 2;
        Self {
            cells_per_m: 1.0 / cell_m,
            edge,
            counts: vec![0; edge * edge * edge],
        }
    }

    fn merge(&mut self, other: &Self) {
        for (count, more) in self.counts.iter_mut().zip(&other.counts) {
            *count += more;
        }
    }

    #[inline]
    fn add(&mut self, shift: Point) {
        let middle = self.edge as f64 / 2.0;
        let mut cell = 0;
        for v in shift {
            let at = v * self.cells_per_m + middle;
            // Also false for NaN.
            if !(at >= 0.0 && at < self.edge as f64) {
                return;
            }
            cell = cell * self.edge + at as usize;
        }
        self.counts[cell] += 1;
    }

    /// Shifts with the most votes, each `apart` from those before it and none nearer than `itself`,
    /// as long as they have `least` of the votes of no shift at all.
    fn peaks(&self, itself: f64, apart: f64, least: f64, max: usize) -> Vec<Point> {
        // Eight cells together, so that no peak is lost on a border between cells.
        let n = self.edge;
        let together = |x: usize, y: usize, z: usize| -> u32 {
            let pair = |x: usize, y: usize| {
                let row = (x * n + y) * n + z;
                self.counts[row] + self.counts[row + 1]
            };
            pair(x, y) + pair(x + 1, y) + pair(x, y + 1) + pair(x + 1, y + 1)
        };
        let middle = n / 2 - 1;
        let least = least * f64::from(together(middle, middle, middle));
        let mut found: Vec<(u32, Point)> = Vec::new();
        for x in 0..n - 1 {
            for y in 0..n - 1 {
                for z in 0..n - 1 {
                    let votes = together(x, y, z);
                    if f64::from(votes) >= least {
                        let at = |i: usize| (i as f64 - middle as f64) / self.cells_per_m;
                        found.push((votes, [at(x), at(y), at(z)]));
                    }
                }
            }
        }
        found.sort_by_key(|(votes, _)| std::cmp::Reverse(*votes));
        let far = |a: &Point, b: &Point, distance: f64| distance_sq(a, b) >= distance * distance;
        let mut peaks: Vec<Point> = Vec::new();
        for (_, shift) in found {
            if peaks.len() == max {
                break;
            }
            if far(&shift, &[0.0; 3], itself) && peaks.iter().all(|p| far(p, &shift, apart)) {
                peaks.push(shift);
            }
        }
        peaks
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cloud::Cloud;
    use crate::progress::Progress;
    use crate::random::Stream;
    use crate::surface_cloud::SurfaceCloud;

    /// Ground with a cone of 0.1 at each of the places.
    fn cones(places: &[[f64; 2]], survey: u64) -> SurfaceCloud {
        let mut stream = Stream::new(survey, "cones", 0);
        let points: Vec<Point> = (0..12_000)
            .map(|_| {
                let [x, y] = [stream.uniform(), 0.3 * stream.uniform()];
                let height = |c: &[f64; 2]| 0.06 - (x - c[0]).hypot(y - c[1]);
                let z = places.iter().map(height).fold(0.0, f64::max);
                [x, y, z]
            })
            .collect();
        let cloud = Cloud::new(&points).unwrap();
        SurfaceCloud::new(&cloud, survey, &Progress::silent()).unwrap()
    }

    fn shifts(places: &[[f64; 2]]) -> Vec<Point> {
        let clouds = [cones(places, 1), cones(places, 2)];
        // The pose of two clouds that lie in one place, in their own coordinates.
        let pose = Rigid::identity().between_local_coordinates(clouds[0].origin, clouds[1].origin);
        let silent = Progress::silent();
        let [moving, fixed] = Witnesses::of_both(clouds, 2000, 0.035, 0.005, &silent).unwrap();
        echoes(&moving, &fixed, &pose, 1.0, 8)
            .iter()
            .map(|echo| (echo.translation - pose.translation).into())
            .collect()
    }

    #[test]
    fn a_row_repeats_itself_a_period_further_on() {
        let row: Vec<[f64; 2]> = (0..6).map(|i| [0.1 + 0.16 * f64::from(i), 0.15]).collect();
        let found = shifts(&row);
        for period in [-0.16, 0.16] {
            let is_near = |s: &Point| distance_sq(s, &[period, 0.0, 0.0]).sqrt() < CELL;
            assert!(found.iter().any(is_near), "{found:?}");
        }
    }

    #[test]
    fn what_does_not_repeat_itself_has_no_echo() {
        let places = [
            [0.1, 0.08],
            [0.23, 0.21],
            [0.48, 0.1],
            [0.67, 0.2],
            [0.91, 0.13],
        ];
        assert_eq!(shifts(&places), Vec::<Point>::new());
    }
}
