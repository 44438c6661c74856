//! Stage 3: the points whose surroundings have a direction of their own (ISS keypoints).
//!
//! Why: a pose is sought with the few points that carry shape, not with every point of a plain.
//! Reads: a cloud of even density and its neighbour index.  Leaves: indices of the keypoints.
//! Source: Ren, Zhao & Han (2023), Sec. 4.2, Eqs. (2)–(4), after Zhong (2009).
//! Deviates: at least five neighbours are asked for, which the paper does not say; a radius not
//! given is three voxels, as in its Sec. 5.3. An optional non-maximum suppression is ours.
//! Absent on purpose: weights of coincident points, whose 1/distance has no value.

use crate::cloud::{Cloud, Point};
use crate::error::{Error, Result, require_positive};
use crate::neighbors::{Block, Collector, NeighborIndex, WIDTH, map_places, sum_of_squares};
use crate::normals::Symmetric;
use crate::progress::Progress;

/// The radius of the neighbourhood where none is given, in voxels.
pub const RADIUS_IN_VOXELS: f64 = 3.0;

/// Eigenvalues below so much of the largest are zero but for rounding.
const ZERO: f64 = 1e-14;

/// What makes a keypoint.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct IssOptions {
    /// Radius of the neighbourhood (rim excluded), above 0. `None`: three voxels.
    pub radius_m: Option<f64>,
    /// Fewest neighbours, the point itself and its copies not counted.
    pub min_neighbors: usize,
    /// ε1: λ2/λ1 of a keypoint lies below it.
    pub max_ratio_second_to_first: f64,
    /// ε2: λ3/λ2 of a keypoint lies below it.
    pub max_ratio_third_to_second: f64,
    /// Keeps only keypoints whose λ3 is the largest among the keypoints within this radius; of
    /// equals the first. `None` keeps all.
    pub non_max_radius_m: Option<f64>,
}

impl Default for IssOptions {
    fn default() -> Self {
        Self {
            radius_m: None,
            min_neighbors: 5,
            max_ratio_second_to_first: 0.65,
            max_ratio_third_to_second: 0.6,
            non_max_radius_m: None,
        }
    }
}

/// What the stage found.
#[derive(Debug, Clone, PartialEq)]
pub struct IssResult {
    /// Indices of the keypoints in the cloud, rising.
    pub indices: Vec<u32>,
    /// The radius that was used.
    pub radius_m: f64,
}

/// The keypoints of `cloud`. `index` is that of the cloud's points; `default_radius_m` serves where
/// the options name no radius ([`RADIUS_IN_VOXELS`] times the voxel).
///
/// ```
/// use tmchho::{Cloud, keypoints, neighbors::NeighborIndex, progress::Progress};
/// // A narrow wall on a floor: keypoints stand at its edges, none on the open floor.
/// let mut points: Vec<_> = (0..900).map(|i| [f64::from(i % 30), f64::from(i / 30), 0.0]).collect();
/// points.extend((0..50).map(|i| [14.0 + f64::from(i % 2), 14.0, 1.0 + f64::from(i / 2)]));
/// let cloud = Cloud::new(&points)?;
/// let index = NeighborIndex::new(cloud.points());
/// let found = keypoints::detect(&cloud, &index, &Default::default(), 3.0, &Progress::silent())?;
/// assert!(found.indices.contains(&949) && !found.indices.contains(&155));
/// # Ok::<(), tmchho::Error>(())
/// ```
///
/// # Errors
/// [`Error::InvalidArgument`] where a radius or ratio is not above 0 or `index` is another
/// cloud's, [`Error::Cancelled`].
pub fn detect(
    cloud: &Cloud,
    index: &NeighborIndex,
    options: &IssOptions,
    default_radius_m: f64,
    progress: &Progress<'_>,
) -> Result<IssResult> {
    if index.len() != cloud.len() {
        return Err(Error::argument(
            "index",
            "must be that of the cloud's points",
        ));
    }
    let radius_m = require_positive("radius_m", options.radius_m.unwrap_or(default_radius_m))?;
    require_positive(
        "max_ratio_second_to_first",
        options.max_ratio_second_to_first,
    )?;
    require_positive(
        "max_ratio_third_to_second",
        options.max_ratio_third_to_second,
    )?;
    let fresh = || Covariance::within(radius_m);
    let third = index.map_collected(&index.places(), fresh, progress, |covariance| {
        let lambda = covariance.eigenvalues(options.min_neighbors)?;
        is_keypoint(lambda, options).then_some(lambda[2])
    })?;
    let mut keypoints: Vec<(u32, f64)> = (0_u32..)
        .zip(third)
        .filter_map(|(i, lambda_3)| Some((i, lambda_3?)))
        .collect();
    if let Some(radius_m) = options.non_max_radius_m {
        let radius_m = require_positive("non_max_radius_m", radius_m)?;
        keypoints = largest_within(cloud.points(), &keypoints, radius_m, progress)?;
    }
    Ok(IssResult {
        indices: keypoints.into_iter().map(|(i, _)| i).collect(),
        radius_m,
    })
}

/// The weighted covariance round a place.
#[derive(Clone)]
struct Covariance {
    radius_sq: f64,
    /// xx, yy, zz, yz, xz, xy.
    products: [f64; 6],
    weight: f64,
    n_neighbors: u32,
}

impl Covariance {
    fn within(radius_m: f64) -> Self {
        Self {
            radius_sq: radius_m * radius_m,
            products: [0.0; 6],
            weight: 0.0,
            n_neighbors: 0,
        }
    }

    /// λ1 ≥ λ2 ≥ λ3, unless there are too few neighbours.
    fn eigenvalues(&self, min_neighbors: usize) -> Option<[f64; 3]> {
        if self.n_neighbors == 0 || (self.n_neighbors as usize) < min_neighbors {
            return None;
        }
        let [xx, yy, zz, yz, xz, xy] = self.products.map(|sum| sum / self.weight);
        Some(Symmetric::new([xx, yy, zz], [yz, xz, xy]).eigenvalues())
    }
}

impl Collector for Covariance {
    #[inline(always)]
    fn reach_sq(&self) -> f64 {
        self.radius_sq
    }

    #[inline(always)]
    fn take(&mut self, place: &Point, block: &Block, _: usize) -> bool {
        let offsets = block.offsets(place);
        let distances_sq = sum_of_squares(&offsets);
        let mut neighbors = 0_u32;
        for lane in 0..WIDTH {
            let is_neighbor = distances_sq[lane] > 0.0 && distances_sq[lane] < self.radius_sq;
            neighbors |= u32::from(is_neighbor) << lane;
        }
        self.n_neighbors += neighbors.count_ones();
        let (mut products, mut sum) = (self.products, self.weight);
        while neighbors != 0 {
            let lane = neighbors.trailing_zeros() as usize;
            neighbors &= neighbors - 1;
            let [x, y, z] = offsets.map(|along| along[lane]);
            // Eq. (2)
            let weight = 1.0 / distances_sq[lane].sqrt();
            // Eq. (3)
            let added = [x * x, y * y, z * z, y * z, x * z, x * y];
            for (product, added) in products.iter_mut().zip(added) {
                *product += weight * added;
            }
            sum += weight;
        }
        (self.products, self.weight) = (products, sum);
        false
    }
}

/// Eq. (4)
fn is_keypoint([lambda_1, lambda_2, lambda_3]: [f64; 3], options: &IssOptions) -> bool {
    lambda_1 > 0.0
        && lambda_2 > ZERO * lambda_1
        && lambda_2 / lambda_1 < options.max_ratio_second_to_first
        && lambda_3 / lambda_2 < options.max_ratio_third_to_second
}

/// Those of `keypoints`, pairs of index and λ3, that no other within `radius_m` surpasses.
fn largest_within(
    points: &[Point],
    keypoints: &[(u32, f64)],
    radius_m: f64,
    progress: &Progress<'_>,
) -> Result<Vec<(u32, f64)>> {
    let places: Vec<Point> = keypoints.iter().map(|(i, _)| points[*i as usize]).collect();
    let index = NeighborIndex::new(&places);
    let keep = map_places(&places, progress, Vec::new, |rivals, i| {
        index.within(&places[i], radius_m, rivals);
        let own = keypoints[i].1;
        rivals.iter().map(|rival| rival.index as usize).all(|j| {
            let other = keypoints[j].1;
            other < own || (other == own && j >= i)
        })
    })?;
    let kept = keypoints.iter().zip(keep).filter(|(_, keep)| *keep);
    Ok(kept.map(|(keypoint, _)| *keypoint).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::neighbors::Places;
    use crate::random::Stream;
    use crate::rigid::Rigid;
    use nalgebra::{Matrix3, Vector3};

    fn find(points: &[Point], radius_m: f64, options: &IssOptions) -> Vec<u32> {
        let cloud = Cloud::of_any_shape("cloud", points).unwrap();
        let index = NeighborIndex::new(cloud.points());
        let silent = Progress::silent();
        detect(&cloud, &index, options, radius_m, &silent)
            .unwrap()
            .indices
    }

    /// Roofs, walls and a rough floor.
    fn village() -> Vec<Point> {
        let mut stream = Stream::new(1, "village", 0);
        (0..3000)
            .map(|i| {
                let (x, y) = (
                    stream.uniform_between(0.0, 20.0),
                    stream.uniform_between(0.0, 20.0),
                );
                match i % 3 {
                    0 => [x, y, 0.1 * stream.normal()],
                    1 => [x, 4.0, 0.3 * y],
                    _ => [x, 8.0 + 0.2 * y, 6.0 - (0.2 * y - 2.0).abs()],
                }
            })
            .collect()
    }

    #[test]
    fn eq_2_to_4_by_hand() {
        // ±1 on x, ±2 on y, ±4 on z: weights 1, 1/2, 1/4, twice each, together 7/2. Sums of
        // weight × square: 2, 4, 8, so λ = 16/7, 8/7, 4/7: both ratios are 1/2.
        let mut points = vec![[0.0; 3]];
        for (axis, length) in [(0, 1.0), (1, 2.0), (2, 4.0)] {
            for sign in [-1.0, 1.0] {
                let mut p = [0.0; 3];
                p[axis] = sign * length;
                points.push(p);
            }
        }
        let index = NeighborIndex::new(&points);
        let options = IssOptions::default();
        let round_the_first = |radius_m| {
            let lambda = |covariance: &Covariance| covariance.eigenvalues(options.min_neighbors);
            let place = Places::new(&points[..1]);
            let fresh = || Covariance::within(radius_m);
            index
                .map_collected(&place, fresh, &Progress::silent(), lambda)
                .unwrap()[0]
        };
        let lambda = round_the_first(5.0).unwrap();
        for (got, wanted) in lambda.iter().zip([16.0 / 7.0, 8.0 / 7.0, 4.0 / 7.0]) {
            assert!((got - wanted).abs() < 1e-15);
        }
        assert!(is_keypoint(lambda, &options));
        for (first, second) in [(0.5, 0.6), (0.65, 0.5)] {
            let strict = IssOptions {
                max_ratio_second_to_first: first,
                max_ratio_third_to_second: second,
                ..options.clone()
            };
            assert!(!is_keypoint(lambda, &strict), "the limits are excluded");
        }
        // The rim is excluded: at radius 4 only four neighbours are left.
        assert_eq!(round_the_first(4.0), None);
    }

    #[test]
    fn agrees_with_the_equations_written_plainly() {
        let (points, radius_m, options) = (village(), 1.2, IssOptions::default());
        let wanted: Vec<u32> = (0_u32..)
            .zip(&points)
            .filter(|(_, p)| {
                let p = Vector3::from(**p);
                let (mut sum, mut weights, mut n) = (Matrix3::zeros(), 0.0, 0);
                for q in &points {
                    let d = p - Vector3::from(*q);
                    if d.norm() > 0.0 && d.norm() < radius_m {
                        sum += d * d.transpose() / d.norm();
                        weights += 1.0 / d.norm();
                        n += 1;
                    }
                }
                if n < 5 {
                    return false;
                }
                let lambda = (sum / weights).symmetric_eigenvalues();
                let mut lambda: Vec<f64> = lambda.iter().copied().collect();
                lambda.sort_by(f64::total_cmp);
                lambda[1] / lambda[2] < 0.65 && lambda[0] / lambda[1] < 0.6
            })
            .map(|(i, _)| i)
            .collect();
        assert_eq!(find(&points, radius_m, &options), wanted);
        assert!((100..2900).contains(&wanted.len()), "{}", wanted.len());
    }

    #[test]
    fn keypoints_move_with_the_cloud() {
        let points = village();
        let turn = Rigid::from_euler([0.7, -0.2, 2.5], [5e5, 4e6, 100.0]);
        let moved: Vec<Point> = points.iter().map(|p| turn.apply(p)).collect();
        let options = IssOptions::default();
        let (still, turned) = (find(&points, 1.2, &options), find(&moved, 1.2, &options));
        let differing = still.iter().filter(|i| turned.binary_search(i).is_err());
        assert!(differing.count() < 5 && still.len().abs_diff(turned.len()) < 5);
    }

    #[test]
    fn suppression_keeps_the_largest_of_each_neighbourhood() {
        let points: Vec<Point> = [0.0, 1.0, 2.0, 9.0, 10.0].map(|x| [x, 0.0, 0.0]).to_vec();
        let keypoints = [(0, 0.1), (1, 0.3), (2, 0.2), (3, 0.4), (4, 0.4)];
        let kept = largest_within(&points, &keypoints, 1.5, &Progress::silent()).unwrap();
        assert_eq!(kept, [(1, 0.3), (3, 0.4)]);
        let all = find(&village(), 1.2, &IssOptions::default());
        let options = IssOptions {
            non_max_radius_m: Some(1.2),
            ..IssOptions::default()
        };
        let few = find(&village(), 1.2, &options);
        assert!(!few.is_empty() && few.len() < all.len() / 3);
        assert!(few.iter().all(|i| all.binary_search(i).is_ok()));
    }

    #[test]
    fn neighbourhoods_without_shape_have_no_keypoints() {
        let options = IssOptions::default();
        let line: Vec<Point> = (0..50)
            .map(|i| [0.1 * f64::from(i), 0.2 * f64::from(i), 0.0])
            .collect();
        for points in [vec![], vec![[1.0; 3]; 40], line] {
            assert!(find(&points, 2.0, &options).is_empty());
        }
        let few = [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 0.5, 0.0], [0.0, 0.0, 0.2]];
        assert!(find(&few, 5.0, &options).is_empty());
    }

    #[test]
    fn options_that_say_nothing_are_refused_by_name() {
        let cloud = Cloud::of_any_shape("cloud", &[]).unwrap();
        let index = NeighborIndex::new(&[]);
        let refused = |options: &IssOptions| {
            let found = detect(&cloud, &index, options, 1.0, &Progress::silent());
            found.unwrap_err().to_string()
        };
        let default = IssOptions::default;
        let radius_m = Some(-1.0);
        assert!(
            refused(&IssOptions {
                radius_m,
                ..default()
            })
            .contains("radius_m")
        );
        let non_max_radius_m = Some(0.0);
        assert!(
            refused(&IssOptions {
                non_max_radius_m,
                ..default()
            })
            .contains("non_max")
        );
        let unknown = serde_json::from_str::<IssOptions>(r#"{"radius": 1}"#);
        assert!(unknown.unwrap_err().to_string().contains("radius"));
    }
}
