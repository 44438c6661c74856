//! Points that testify to a pose: which of them, and what each weighs.
//!
//! Source: ours; measured in docs/robust_search.md.

use crate::cloud::Point;
use crate::error::Result;
use crate::neighbors::NeighborIndex;
use crate::normals::{self, Surface};
use crate::parallel;
use crate::progress::Progress;
use crate::spacing::rough_spacing_quantile_m;
use crate::surface_cloud::SurfaceCloud;

/// The points of a cloud that testify to a pose, drawn at random. All points have a weight.
///
/// What half of a cloud looks like tells no place from another: planes agree anywhere along themselves,
/// and so does ground in the thickness of its noise. So a point weighs by how much more the surface round
/// it bends than at half of all points, looked at from far enough that noise does not count as shape; and
/// a pair of points weighs as the one that weighs less.
#[derive(Debug)]
pub struct Witnesses {
    /// The cloud.
    pub cloud: SurfaceCloud,
    /// One weight for each point: of a witness its own, of any other that of the witness nearest to it.
    pub weights: Vec<f64>,
    /// How much surface the cloud covers, in a unit that it shares with the other one: points where both
    /// are as dense as their voxels, else cells that the sparser one fills.
    pub size: usize,
    /// The numbers of the witnesses, rising.
    witnesses: Vec<u32>,
}

impl Witnesses {
    /// Witnesses of two clouds, as many of either on the same area: about `n` of the smaller cloud; of a
    /// cloud that has fewer points there, all. `radius_m` is how far a surface is looked at, `voxel_size_m`
    /// the edge of the voxels to which both were thinned.
    ///
    /// # Errors
    /// [`crate::Error::Cancelled`].
    pub fn of_both(
        clouds: [SurfaceCloud; 2],
        n: usize,
        radius_m: f64,
        voxel_size_m: f64,
        progress: &Progress<'_>,
    ) -> Result<[Self; 2]> {
        let (spacings_m, sizes) = measured(&clouds, voxel_size_m, progress)?;
        let smaller = sizes[0].min(sizes[1]).max(1);
        let density = n as f64 / smaller as f64;
        let of = |cloud: SurfaceCloud, size: usize, spacing_m: f64| -> Result<Self> {
            let n = cloud.len().min((size as f64 * density).ceil() as usize);
            let witnesses = cloud.drawn_in_order(n);
            let index = NeighborIndex::new(&cloud.points_of(&witnesses));
            let own = curvature_weights(&cloud, index.points(), radius_m, spacing_m, progress)?;
            let nearest = index.nearest_to(&cloud.index.places(), progress)?;
            let weights = nearest.iter().map(|it| own[it.index as usize]).collect();
            Ok(Self {
                cloud,
                weights,
                size,
                witnesses,
            })
        };
        let [first, second] = clouds;
        let (first, second) = parallel::both(
            || of(first, sizes[0], spacings_m[0]),
            || of(second, sizes[1], spacings_m[1]),
        );
        Ok([first?, second?])
    }

    /// The same in a mirror.
    pub fn mirrored(&self) -> Self {
        Self {
            cloud: self.cloud.mirrored(),
            weights: self.weights.clone(),
            size: self.size,
            witnesses: self.witnesses.clone(),
        }
    }

    /// The numbers of the witnesses among the points of the cloud, rising.
    pub fn numbers(&self) -> &[u32] {
        &self.witnesses
    }

    /// Number of witnesses.
    pub fn len(&self) -> usize {
        self.witnesses.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.witnesses.is_empty()
    }

    /// Sum of the weights of the witnesses.
    pub fn total_weight(&self) -> f64 {
        self.numbers()
            .iter()
            .map(|i| self.weights[*i as usize])
            .sum()
    }

    /// How much of the cloud's size one witness stands for; 0 where there are none.
    pub fn size_of_each(&self) -> f64 {
        self.size as f64 / self.len().max(1) as f64
    }
}

/// How far the points of each cloud lie apart, at least the edge of its voxels, and how large each is.
fn measured(
    clouds: &[SurfaceCloud; 2],
    voxel_size_m: f64,
    progress: &Progress<'_>,
) -> Result<([f64; 2], [usize; 2])> {
    /// A cloud whose median spacing is more than this many voxels is sparser than its voxels.
    const SPARSE: f64 = 1.3;
    /// A cell of so many median spacings that the surface crosses holds a point nine times in ten.
    const FILLED: f64 = 5.0;
    let spacing = |cloud: &SurfaceCloud| -> Result<f64> {
        let median_m = rough_spacing_quantile_m(&cloud.index, 0.5, progress)?;
        Ok(if median_m > SPARSE * voxel_size_m {
            median_m
        } else {
            voxel_size_m
        })
    };
    let (first, second) = parallel::both(|| spacing(&clouds[0]), || spacing(&clouds[1]));
    let spacings_m = [first?, second?];
    let sparser_m = spacings_m[0].max(spacings_m[1]);
    let sizes = clouds.each_ref().map(|cloud| {
        if sparser_m > voxel_size_m {
            cloud.one_for_each_cell(FILLED * sparser_m).len()
        } else {
            cloud.len()
        }
    });
    Ok((spacings_m, sizes))
}

/// What is usual weighs little, but not nothing: a scene of planes alone can still be scored.
fn curvature_weights(
    cloud: &SurfaceCloud,
    witnesses: &[Point],
    radius_m: f64,
    spacing_m: f64,
    progress: &Progress<'_>,
) -> Result<Vec<f64>> {
    const FULL_WEIGHT_CURVATURE: f64 = 0.04;
    const LEAST_WEIGHT: f64 = 0.03;
    /// So many neighbours tell a curvature; more would only cost.
    const N_NEIGHBORS: f64 = 60.0;
    let n_within = std::f64::consts::PI * (radius_m / spacing_m).powi(2);
    let n_thinned = (cloud.len() as f64 * (N_NEIGHBORS / n_within).min(1.0)) as usize;
    let index = NeighborIndex::new(&cloud.points_of(&cloud.drawn_in_order(n_thinned)));
    let surfaces = normals::estimate_within(witnesses, &index, radius_m, 3, progress)?;
    let usual = median_curvature(&surfaces);
    let weight = |s: &Surface| {
        ((s.curvature - usual) / FULL_WEIGHT_CURVATURE).clamp(0.0, 1.0) + LEAST_WEIGHT
    };
    Ok(surfaces.iter().map(weight).collect())
}

/// Of the points where there is a surface; 0 where there are none.
fn median_curvature(surfaces: &[Surface]) -> f64 {
    let is_known = |s: &&Surface| s.normal != Surface::NONE.normal;
    let mut curvatures: Vec<f64> =
        (surfaces.iter().filter(is_known).map(|s| s.curvature)).collect();
    if curvatures.is_empty() {
        return 0.0;
    }
    let middle = (curvatures.len() - 1) / 2;
    *curvatures.select_nth_unstable_by(middle, f64::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cloud::Cloud;
    use crate::random::Stream;

    const VOXEL: f64 = 0.01;

    /// A point anywhere in each square of that edge, of waves over a strip of that length, 1 wide.
    fn strip(length: f64, edge: f64, seed: u64) -> SurfaceCloud {
        let mut stream = Stream::new(seed, "strip", 0);
        let n_across = (1.0 / edge).round() as usize;
        let n_along = (length / edge).round() as usize;
        let points: Vec<Point> = (0..n_across * n_along)
            .map(|i| {
                let x = edge * ((i / n_across) as f64 + stream.uniform());
                let y = edge * ((i % n_across) as f64 + stream.uniform());
                [x, y, 0.1 * (9.0 * x).sin() * (7.0 * y).cos()]
            })
            .collect();
        SurfaceCloud::new(&Cloud::new(&points).unwrap(), 0, &Progress::silent()).unwrap()
    }

    fn of_both(a: SurfaceCloud, b: SurfaceCloud, n: usize) -> [Witnesses; 2] {
        Witnesses::of_both([a, b], n, 0.1, VOXEL, &Progress::silent()).unwrap()
    }

    #[test]
    fn as_many_points_on_the_same_area_testify_of_a_dense_cloud_and_of_a_sparse_one() {
        let ratio = |a: usize, b: usize| a as f64 / b as f64;
        // Four times the area: of clouds as dense as their voxels four times the points, and the smaller gives
        // what it should.
        let [small, large] = of_both(strip(1.0, VOXEL, 1), strip(4.0, VOXEL, 2), 1000);
        assert_eq!((small.len(), small.size), (1000, small.cloud.len()));
        assert_eq!((large.len(), large.size), (4000, large.cloud.len()));
        // A ninth of the points that the other has there.
        let [small, large] = of_both(strip(1.0, VOXEL, 1), strip(4.0, 3.0 * VOXEL, 2), 2000);
        assert!(large.cloud.len() < small.cloud.len());
        assert!((ratio(large.size, small.size) / 4.0 - 1.0).abs() < 0.1);
        // It gives all it has, fewer than the area asks for, and each stands for more.
        assert_eq!((small.len(), large.len()), (2000, large.cloud.len()));
        assert!(large.size_of_each() > small.size_of_each());
    }
}
