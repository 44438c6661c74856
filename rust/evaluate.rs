//! Stage 7: how far two clouds lie apart.
//!
//! Why: the distances from one cloud to the other are what a surveyor signs.
//! Reads: points and the neighbour index of the other cloud, in one frame.  Leaves: a distance per
//! point, and the numbers that sum them up.
//! Source: Ren, Zhao & Han (2023), Sec. 5.3, Table 7: cloud-to-cloud distances, their average,
//! best, worst and standard deviation.  Deviates: root mean square, median and 95 % percentile are
//! given besides, and distances to the surface between the points (`evaluate/surface.rs`).
//! Absent on purpose: survey areas and tolerances, which the caller chooses.

mod compare;
mod surface;

pub use compare::{CompareOptions, Comparison, Direction, compare};
pub use surface::{DistanceMethod, surface_distances};

use crate::cloud::Point;
use crate::error::Result;
use crate::neighbors::NeighborIndex;
use crate::parallel;
use crate::progress::Progress;
use crate::rank::nth_smallest;

/// The distance from each of `from` to the nearest point of `to`, in metres, in their order.
///
/// ```
/// use tmchho::{evaluate, neighbors::NeighborIndex, progress::Progress};
/// let to = NeighborIndex::new(&[[0.0; 3], [10.0, 0.0, 0.0]]);
/// let distances =
///     evaluate::nearest_distances(&[[3.0, 4.0, 0.0], [9.0, 0.0, 0.0]], &to, &Progress::silent())?;
/// assert_eq!(distances, [5.0, 1.0]);
/// # Ok::<(), tmchho::Error>(())
/// ```
///
/// # Errors
/// As [`NeighborIndex::nearest_all`].
pub fn nearest_distances(
    from: &[Point],
    to: &NeighborIndex,
    progress: &Progress<'_>,
) -> Result<Vec<f64>> {
    to.distances_to(&to.places_to_ask(from), progress)
}

/// Distances summed up, in metres. Of signed ones the mean and the median keep the sign; best, worst
/// and the percentile are of what they amount to without it.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct DistanceStatistics {
    /// How many distances.
    pub n_points: usize,
    /// Their mean ("Avg" in Table 7).
    pub mean_m: f64,
    /// The smallest amount.
    pub best_m: f64,
    /// The largest amount.
    pub worst_m: f64,
    /// Standard deviation of the population (divided by n): `rms_m`² = `mean_m`² + `std_m`².
    pub std_m: f64,
    /// Root of the mean square.
    pub rms_m: f64,
    /// Half of the distances lie below it.
    pub median_m: f64,
    /// 95 % of the amounts lie below it.
    pub percentile_95_m: f64,
}

impl DistanceStatistics {
    /// Sums up `distances_m`; `None` where there are none, or one of them is not finite.
    ///
    /// ```
    /// use tmchho::evaluate::DistanceStatistics;
    /// let statistics = DistanceStatistics::from_distances(&[3.0, 1.0, 1.0, 3.0]).unwrap();
    /// assert_eq!((statistics.mean_m, statistics.std_m, statistics.median_m), (2.0, 1.0, 2.0));
    /// assert_eq!(DistanceStatistics::from_distances(&[]), None);
    /// ```
    pub fn from_distances(distances_m: &[f64]) -> Option<Self> {
        let (n, of) = (distances_m.len(), |i: usize| distances_m[i]);
        if n == 0 || !parallel::all(n, |i| of(i).is_finite()) {
            return None;
        }
        let mean_m = mean_of(distances_m, |d| d);
        let extremes = parallel::map_chunks(distances_m, |part| {
            let amounts = part.iter().map(|d| d.abs());
            amounts.fold((f64::INFINITY, 0.0), |(least, most), d| {
                (f64::min(least, d), f64::max(most, d))
            })
        });
        let (bests, worsts) = (extremes.iter().map(|e| e.0), extremes.iter().map(|e| e.1));
        Some(Self {
            n_points: n,
            mean_m,
            best_m: bests.fold(f64::INFINITY, f64::min),
            worst_m: worsts.fold(0.0, f64::max),
            std_m: mean_of(distances_m, |d| (d - mean_m) * (d - mean_m)).sqrt(),
            rms_m: mean_of(distances_m, |d| d * d).sqrt(),
            median_m: quantile(n, 0.5, of),
            percentile_95_m: quantile(n, 0.95, |i| of(i).abs()),
        })
    }
}

/// The share, 0 to 1, of `distances_m` that do not exceed `tolerance_m` to either side; 0 where there
/// are none.
pub fn share_within(distances_m: &[f64], tolerance_m: f64) -> f64 {
    let is_within = |d: &&f64| d.abs() <= tolerance_m;
    let n_within = distances_m.iter().filter(is_within).count();
    n_within as f64 / distances_m.len().max(1) as f64
}

/// By a sum of partial sums: its error stays small, and its bits the same, however many there are.
fn mean_of(values: &[f64], f: impl Fn(f64) -> f64 + Sync + Send) -> f64 {
    let partial = |chunk: &[f64]| chunk.iter().map(|v| f(*v)).sum::<f64>();
    parallel::map_chunks(values, partial).iter().sum::<f64>() / values.len() as f64
}

/// Between the two values round the rank, in proportion, of `value(i)` of all `i` below `n`.
fn quantile(n: usize, share: f64, value: impl Fn(usize) -> f64 + Sync + Send) -> f64 {
    let rank = share * (n - 1) as f64;
    let at = rank.floor() as usize;
    let below = nth_smallest(n, at, &value);
    match rank.fract() {
        0.0 => below,
        fract => below + (nth_smallest(n, at + 1, &value) - below) * fract,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cloud::distance_sq;
    use crate::error::Error;
    use crate::random::Stream;

    #[test]
    fn by_hand() {
        let statistics = DistanceStatistics::from_distances(&[1.0, 2.0, 2.0, 7.0, 8.0]).unwrap();
        let wanted = DistanceStatistics {
            n_points: 5,
            mean_m: 4.0,
            best_m: 1.0,
            worst_m: 8.0,
            std_m: 8.4_f64.sqrt(),  // (9 + 4 + 4 + 9 + 16) / 5
            rms_m: 24.4_f64.sqrt(), // (1 + 4 + 4 + 49 + 64) / 5
            median_m: 2.0,
            percentile_95_m: 7.8, // rank 3.8: 7 + 0.8
        };
        assert!((statistics.percentile_95_m - 7.8).abs() < 1e-15);
        assert_eq!(
            DistanceStatistics {
                percentile_95_m: 7.8,
                ..statistics
            },
            wanted
        );
        assert_eq!(share_within(&[1.0, 2.0, 2.0, 7.0, 8.0], 2.0), 0.6);
    }

    #[test]
    fn signed_distances_by_hand() {
        let statistics = DistanceStatistics::from_distances(&[-4.0, 1.0, -2.0, 3.0]).unwrap();
        assert_eq!((statistics.mean_m, statistics.median_m), (-0.5, -0.5));
        assert_eq!((statistics.best_m, statistics.worst_m), (1.0, 4.0));
        assert!((statistics.percentile_95_m - 3.85).abs() < 1e-15); // rank 2.85 of 1 2 3 4
        assert_eq!(statistics.rms_m, 7.5_f64.sqrt());
        assert_eq!(share_within(&[-4.0, 1.0, -2.0, 3.0], 2.0), 0.5);
    }

    #[test]
    fn root_mean_square_mean_and_deviation_belong_together() {
        let mut stream = Stream::new(1, "evaluate", 0);
        let distances: Vec<f64> = (0..50_000).map(|_| 1e6 + stream.normal()).collect();
        let s = DistanceStatistics::from_distances(&distances).unwrap();
        assert!((s.std_m - 1.0).abs() < 0.02 && (s.median_m - 1e6).abs() < 0.03);
        assert!((s.percentile_95_m - 1e6 - 1.645).abs() < 0.05);
        assert!((s.rms_m.powi(2) / (s.mean_m.powi(2) + s.std_m.powi(2)) - 1.0).abs() < 1e-14);
    }

    #[test]
    fn distances_agree_with_brute_force() {
        let mut stream = Stream::new(2, "evaluate", 0);
        let mut draw =
            |n| -> Vec<Point> { (0..n).map(|_| [0; 3].map(|_| stream.normal())).collect() };
        let (from, to) = (draw(400), draw(300));
        let got = nearest_distances(&from, &NeighborIndex::new(&to), &Progress::silent()).unwrap();
        for (p, got) in from.iter().zip(got) {
            let wanted = to
                .iter()
                .map(|q| distance_sq(p, q))
                .fold(f64::INFINITY, f64::min);
            assert_eq!(got, wanted.sqrt());
        }
    }

    #[test]
    fn nothing_to_measure() {
        let none = NeighborIndex::new(&[]);
        let refused = nearest_distances(&[[0.0; 3]], &none, &Progress::silent());
        assert!(matches!(refused, Err(Error::TooFewPoints { .. })));
        assert_eq!(
            DistanceStatistics::from_distances(&[1.0, f64::INFINITY]),
            None
        );
        assert_eq!(share_within(&[], 1.0), 0.0);
        let one = DistanceStatistics::from_distances(&[0.25]).unwrap();
        assert_eq!(
            (one.std_m, one.median_m, one.percentile_95_m),
            (0.0, 0.25, 0.25)
        );
    }
}
