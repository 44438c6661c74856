//! How far apart the points of a cloud lie.
//!
//! Why: radii that suit a scanner at 5 mm and a drone at 20 cm alike are derived from the spacing,
//! never written down as metres.
//! Reads: a neighbour index.  Leaves: a length in metres.
//! Source: this project.  Deviates: nowhere.
//! Absent on purpose: random samples; the sample is every so-many-th point, the same each time.

use crate::neighbors::NeighborIndex;
use crate::parallel;

/// Most points whose spacing is looked at; quantiles change by about 1 % beyond.
const SAMPLE_POINTS: usize = 10_000;

/// The distance from a point to the nearest one at another position, as the `quantile` (0 to 1) of
/// it over at most 10 000 evenly strided points. 0 where no two points differ in position.
///
/// ```
/// use tmchho::{neighbors::NeighborIndex, spacing::nearest_spacing_quantile_m};
/// let index = NeighborIndex::new(&[[0.0; 3], [1.0, 0.0, 0.0], [3.0, 0.0, 0.0], [8.0, 0.0, 0.0]]);
/// assert_eq!(nearest_spacing_quantile_m(&index, 0.0), 1.0); // spacings 1 1 2 5
/// assert_eq!(nearest_spacing_quantile_m(&index, 1.0), 5.0);
/// ```
pub fn nearest_spacing_quantile_m(index: &NeighborIndex, quantile: f64) -> f64 {
    let stride = index.len().div_ceil(SAMPLE_POINTS).max(1);
    let n_sampled = index.len().div_ceil(stride);
    let mut spacings: Vec<f64> = parallel::map(n_sampled, |i| {
        index.nearest_elsewhere(&index.points()[i * stride])
    })
    .into_iter()
    .flatten()
    .map(|neighbor| neighbor.distance_sq.sqrt())
    .collect();
    if spacings.is_empty() {
        return 0.0;
    }
    let rank = (quantile.clamp(0.0, 1.0) * (spacings.len() - 1) as f64).round() as usize;
    *spacings.select_nth_unstable_by(rank, f64::total_cmp).1
}

/// The median of the distance from a point to the nearest one at another position.
pub fn median_spacing_m(index: &NeighborIndex) -> f64 {
    nearest_spacing_quantile_m(index, 0.5)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cloud::{Point, distance_sq};
    use crate::random::Stream;

    #[test]
    fn a_grid_with_one_stray_and_one_copy() {
        let mut points: Vec<Point> = (0..100)
            .map(|i| [0.25 * f64::from(i % 10), 0.25 * f64::from(i / 10), 0.0])
            .collect();
        points.push([0.0, 0.0, 9.0]);
        points.push(points[0]);
        let index = NeighborIndex::new(&points);
        assert_eq!(median_spacing_m(&index), 0.25);
        assert_eq!(nearest_spacing_quantile_m(&index, 0.9), 0.25);
        assert_eq!(nearest_spacing_quantile_m(&index, 1.0), 9.0);
    }

    #[test]
    fn quantiles_agree_with_brute_force() {
        let mut stream = Stream::new(3, "spacing", 0);
        let points: Vec<Point> = (0..801).map(|_| [0; 3].map(|_| stream.normal())).collect();
        let mut spacings: Vec<f64> = points
            .iter()
            .map(|p| {
                let others = points.iter().filter(|q| *q != p);
                others.fold(f64::INFINITY, |least, q| least.min(distance_sq(p, q)))
            })
            .map(f64::sqrt)
            .collect();
        spacings.sort_by(f64::total_cmp);
        let index = NeighborIndex::new(&points);
        for (quantile, rank) in [(0.0, 0), (0.25, 200), (0.5, 400), (0.9, 720), (1.0, 800)] {
            let got = nearest_spacing_quantile_m(&index, quantile);
            assert_eq!(got, spacings[rank]);
        }
    }

    #[test]
    fn clouds_without_two_places_have_no_spacing() {
        for points in [vec![], vec![[1.0, 2.0, 3.0]], vec![[1.0, 2.0, 3.0]; 30_000]] {
            assert_eq!(median_spacing_m(&NeighborIndex::new(&points)), 0.0);
        }
    }

    #[test]
    fn a_large_cloud_is_sampled_and_scales_with_its_unit() {
        let line = |unit: f64| -> Vec<Point> {
            (0..25_000)
                .map(|i| [unit * f64::from(i), 0.0, 0.0])
                .collect()
        };
        let metres = median_spacing_m(&NeighborIndex::new(&line(1.0)));
        let kilometres = median_spacing_m(&NeighborIndex::new(&line(1024.0)));
        assert_eq!((metres, kilometres), (1.0, 1024.0));
    }
}
