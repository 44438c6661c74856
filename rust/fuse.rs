//! Stage 8: one cloud out of two, in which each fills the other's holes.
//!
//! Why: a drone sees the crest and misses the foot, a scanner the other way round.
//! Reads: both clouds with their neighbour indices, each in its own frame, and the pose.
//! Leaves: points in the target's given coordinates, each with its origin, its distance to the
//! other cloud and whether it fills a hole there; no given point more than once.
//! Source: Ren, Zhao & Han (2023), Sec. 5.3, Figure 18.  Deviates: the paper does not say what a
//! hole is; here it is a place farther than the hole radius from every point of the other cloud.
//! Absent on purpose: thinning, meshing, colours; nothing is invented between the points.

use crate::cloud::{Cloud, Point};
use crate::error::{Error, Result, require_positive};
use crate::neighbors::{Neighbor, NeighborIndex};
use crate::overlap;
use crate::parallel;
use crate::progress::Progress;
use crate::similarity::Similarity;
use crate::spacing::nearest_spacing_quantile_m;
use crate::surface_area::SurfaceArea;

/// The derived hole radius is so many times the spacing that nine points in ten of the sparser
/// cloud keep to.
pub(crate) const RADIUS_IN_SPACINGS: f64 = 3.0;
pub(crate) const SPACING_QUANTILE: f64 = 0.9;

/// Which points of the source are taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FuseMode {
    /// All.
    #[default]
    Merge,
    /// All but those that repeat a point of the target: where both clouds show a surface, it does
    /// not become denser than the denser of the two.
    Dedup,
    /// Only those that fill a hole of the target.
    FillHoles,
}

/// How two clouds become one.
#[derive(Debug, Clone, PartialEq, Default, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FuseOptions {
    /// Which points of the source are taken; the target is always kept whole.
    pub mode: FuseMode,
    /// A point farther than this from the other cloud fills a hole; above 0. `None`: three times
    /// the 90 % quantile of the distance to the nearest point, in the sparser of the clouds.
    pub hole_radius_m: Option<f64>,
}

impl FuseOptions {
    pub(crate) fn check(&self) -> Result<()> {
        self.hole_radius_m.map_or(Ok(()), |radius_m| {
            require_positive("fuse.hole_radius_m", radius_m).map(drop)
        })
    }
}

/// The cloud that a fused point comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
#[repr(u8)]
pub enum Origin {
    /// The cloud that stayed.
    Target = 0,
    /// The cloud that was moved.
    Source = 1,
}

/// What the stage left: the points of the target in their order, then those of the source.
#[derive(Debug, Clone, PartialEq)]
pub struct FusedCloud {
    /// The points, in the coordinates in which the target was given.
    pub points: Vec<Point>,
    /// Where each comes from.
    pub origin: Vec<Origin>,
    /// Where each stood in the array that was given for its cloud.
    pub given_index: Vec<u32>,
    /// Whether the other cloud has no point within the hole radius of it.
    pub fills_hole: Vec<bool>,
    /// Its distance to the nearest point of the other cloud.
    pub distance_m: Vec<f64>,
    /// The hole radius that was used.
    pub hole_radius_m: f64,
    /// How many points of the source fill a hole of the target.
    pub n_filled_by_source: usize,
    /// How many points of the target fill a hole of the source.
    pub n_filled_by_target: usize,
    /// Area of the surface that those points of the source show, in the target's unit.
    pub area_filled_by_source_m2: f64,
    /// Area of the surface that those points of the target show.
    pub area_filled_by_target_m2: f64,
    /// How many points of the source were left out because they repeat a point of the target.
    pub n_repeated: usize,
}

/// Joins `target` and `source`. The pose lies between the local coordinates of the two clouds, and
/// each index is that of its cloud's own points.
///
/// ```
/// use tmchho::{Cloud, Rigid, fuse, neighbors::NeighborIndex, progress::Progress};
/// let row = |x: f64| [x, 0.0, 0.0];
/// let target = Cloud::of_any_shape("target cloud", &[0.0, 1.0, 2.0].map(row))?;
/// let source = Cloud::of_any_shape("source cloud", &[1.5, 3.0, 7.0].map(row))?;
/// let (a, b) = (NeighborIndex::new(target.points()), NeighborIndex::new(source.points()));
/// let pose = Rigid::identity().between_local_coordinates(source.origin(), target.origin());
/// let options = fuse::FuseOptions { mode: fuse::FuseMode::FillHoles, hole_radius_m: Some(2.0) };
/// let fused = fuse::fuse(&target, &a, &source, &b, &pose, &options, &Progress::silent())?;
/// assert_eq!(fused.points, [0.0, 1.0, 2.0, 7.0].map(row));
/// assert_eq!((fused.given_index[3], fused.distance_m[3]), (2, 5.0));
/// # Ok::<(), tmchho::Error>(())
/// ```
///
/// # Errors
/// [`Error::InvalidArgument`] where the hole radius is not above 0 or an index is another cloud's,
/// [`Error::TooFewPoints`] where one cloud is empty and the other is not, [`Error::Cancelled`].
pub fn fuse(
    target: &Cloud,
    target_index: &NeighborIndex,
    source: &Cloud,
    source_index: &NeighborIndex,
    target_from_source: impl Into<Similarity>,
    options: &FuseOptions,
    progress: &Progress<'_>,
) -> Result<FusedCloud> {
    let compared = Compared::new(
        (target, target_index),
        (source, source_index),
        target_from_source.into(),
        options,
        progress,
    )?;
    compared.join(target, source, options.mode)
}

/// All that the indices are needed for, so that who is short of memory can give them up before the
/// clouds are joined.
pub(crate) struct Compared {
    hole_radius_m: f64,
    /// The source where the target lies, in the target's local coordinates.
    source_points: Vec<Point>,
    target_distances_m: Vec<f64>,
    source_distances_m: Vec<f64>,
    /// Whether a point of the source repeats one of the target; empty where nobody asked.
    repeated: Vec<bool>,
}

impl Compared {
    /// As [`fuse`].
    pub(crate) fn new(
        (target, target_index): (&Cloud, &NeighborIndex),
        (source, source_index): (&Cloud, &NeighborIndex),
        target_from_source: Similarity,
        options: &FuseOptions,
        progress: &Progress<'_>,
    ) -> Result<Self> {
        if target_index.len() != target.len() || source_index.len() != source.len() {
            return Err(Error::argument(
                "index",
                "must be that of its cloud's points",
            ));
        }
        let hole_radius_m = match options.hole_radius_m {
            Some(radius_m) => require_positive("hole_radius_m", radius_m)?,
            None => derived_hole_radius_m(target_index, source_index, progress)?,
        };
        let target_distances_m = {
            let moved = moved(target.points(), &target_from_source.inverse(), progress)?;
            distances_m(&source_index.nearest_all(&moved, progress)?)
        };
        let source_points = moved(source.points(), &target_from_source, progress)?;
        let source_nearest = target_index.nearest_all(&source_points, progress)?;
        let repeated = match options.mode {
            FuseMode::Dedup => {
                // Beyond the hole radius a point is no repetition, whatever the density.
                let in_reach = |n: &Neighbor| (n.distance_sq.sqrt() <= hole_radius_m).then_some(*n);
                let nearest: Vec<_> = source_nearest.iter().map(in_reach).collect();
                let scale = target_from_source.scale;
                overlap::repeated(&nearest, source_index, scale, target_index, progress)?
            }
            FuseMode::Merge | FuseMode::FillHoles => Vec::new(),
        };
        Ok(Self {
            hole_radius_m,
            source_points,
            target_distances_m,
            source_distances_m: distances_m(&source_nearest),
            repeated,
        })
    }

    /// The fused cloud.
    pub(crate) fn join(self, target: &Cloud, source: &Cloud, mode: FuseMode) -> Result<FusedCloud> {
        let mut fused = FusedCloud::empty(self.hole_radius_m);
        for (i, distance_m) in self.target_distances_m.into_iter().enumerate() {
            let given_index = target.given_index(i) as u32;
            fused.push(target.points()[i], Origin::Target, given_index, distance_m);
        }
        for (i, distance_m) in self.source_distances_m.into_iter().enumerate() {
            if self.repeated.get(i).is_some_and(|repeats| *repeats) {
                fused.n_repeated += 1;
            } else if mode != FuseMode::FillHoles || distance_m > self.hole_radius_m {
                let given_index = source.given_index(i) as u32;
                fused.push(
                    self.source_points[i],
                    Origin::Source,
                    given_index,
                    distance_m,
                );
            }
        }
        fused.area_filled_by_source_m2 = fused.area_filled_by(Origin::Source)?;
        fused.area_filled_by_target_m2 = fused.area_filled_by(Origin::Target)?;
        fused.move_by(target.origin());
        Ok(fused)
    }
}

fn derived_hole_radius_m(
    target_index: &NeighborIndex,
    source_index: &NeighborIndex,
    progress: &Progress<'_>,
) -> Result<f64> {
    let spacing_m = |index| nearest_spacing_quantile_m(index, SPACING_QUANTILE, progress);
    Ok(RADIUS_IN_SPACINGS * spacing_m(target_index)?.max(spacing_m(source_index)?))
}

fn moved(points: &[Point], pose: &Similarity, progress: &Progress<'_>) -> Result<Vec<Point>> {
    parallel::map_cheap(points.len(), progress, |i| pose.apply(&points[i]))
}

fn distances_m(nearest: &[Neighbor]) -> Vec<f64> {
    nearest.iter().map(|n| n.distance_sq.sqrt()).collect()
}

impl FusedCloud {
    fn empty(hole_radius_m: f64) -> Self {
        Self {
            points: Vec::new(),
            origin: Vec::new(),
            given_index: Vec::new(),
            fills_hole: Vec::new(),
            distance_m: Vec::new(),
            hole_radius_m,
            n_filled_by_source: 0,
            n_filled_by_target: 0,
            area_filled_by_source_m2: 0.0,
            area_filled_by_target_m2: 0.0,
            n_repeated: 0,
        }
    }

    fn push(&mut self, point: Point, origin: Origin, given_index: u32, distance_m: f64) {
        let fills_hole = distance_m > self.hole_radius_m;
        match origin {
            Origin::Target => self.n_filled_by_target += usize::from(fills_hole),
            Origin::Source => self.n_filled_by_source += usize::from(fills_hole),
        }
        self.points.push(point);
        self.origin.push(origin);
        self.given_index.push(given_index);
        self.fills_hole.push(fills_hole);
        self.distance_m.push(distance_m);
    }

    /// Cubes as long as the hole radius hold about nine points where the cloud is sparse.
    fn area_filled_by(&self, origin: Origin) -> Result<f64> {
        let filling: Vec<Point> = (0..self.points.len())
            .filter(|&i| self.fills_hole[i] && self.origin[i] == origin)
            .map(|i| self.points[i])
            .collect();
        if filling.is_empty() {
            return Ok(0.0);
        }
        let mut area = SurfaceArea::new(self.hole_radius_m)?;
        area.add(&filling)?;
        Ok(area.total())
    }

    fn move_by(&mut self, shift: Point) {
        for p in &mut self.points {
            *p = std::array::from_fn(|axis| p[axis] + shift[axis]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cloud::distance_sq;
    use crate::random::Stream;
    use crate::rigid::Rigid;

    fn cloud(points: &[Point]) -> Cloud {
        Cloud::of_any_shape("cloud", points).unwrap()
    }

    /// Fuses clouds that are given in one frame, once they are told how the source was moved.
    fn run(
        target: &[Point],
        source: &[Point],
        moved: &Rigid,
        options: &FuseOptions,
    ) -> Result<FusedCloud> {
        let moved_source: Vec<Point> = source.iter().map(|p| moved.apply(p)).collect();
        let (target, source) = (cloud(target), cloud(&moved_source));
        let pose = moved
            .inverse()
            .between_local_coordinates(source.origin(), target.origin());
        fuse(
            &target,
            &NeighborIndex::new(target.points()),
            &source,
            &NeighborIndex::new(source.points()),
            pose,
            options,
            &Progress::silent(),
        )
    }

    fn options(mode: FuseMode, hole_radius_m: Option<f64>) -> FuseOptions {
        FuseOptions {
            mode,
            hole_radius_m,
        }
    }

    #[test]
    fn by_hand() {
        // Target on x at 0 1 2, source at 2 4 6 and one point that is none; hole radius 2.
        let row = |x: f64| [x, 0.0, 0.0];
        let target = [0.0, 1.0, 2.0].map(row);
        let source = [row(2.0), [f64::NAN; 3], row(4.0), row(6.0)];
        let merge = options(FuseMode::Merge, Some(2.0));
        let fused = run(&target, &source, &Rigid::identity(), &merge).unwrap();
        assert_eq!(fused.points, [0.0, 1.0, 2.0, 2.0, 4.0, 6.0].map(row));
        assert_eq!(
            fused.origin.iter().map(|o| *o as u8).collect::<Vec<_>>(),
            [0, 0, 0, 1, 1, 1]
        );
        assert_eq!(fused.given_index, [0, 1, 2, 0, 2, 3]);
        assert_eq!(fused.distance_m, [2.0, 1.0, 0.0, 0.0, 2.0, 4.0]);
        // On the rim of the radius is not beyond it.
        assert_eq!(fused.fills_hole, [false, false, false, false, false, true]);
        assert_eq!((fused.n_filled_by_source, fused.n_filled_by_target), (1, 0));
    }

    #[test]
    fn each_cloud_fills_the_hole_of_the_other_after_any_motion() {
        // One floor, spaced 1: the target lacks x < 10, the source lacks x ≥ 30.
        let mut stream = Stream::new(1, "fuse", 0);
        let floor: Vec<Point> = (0..800)
            .map(|i| [f64::from(i % 40), f64::from(i / 40), 0.2 * stream.normal()])
            .collect();
        let part = |keep: fn(f64) -> bool| -> Vec<Point> {
            floor.iter().filter(|p| keep(p[0])).copied().collect()
        };
        let (target, source) = (part(|x| x >= 10.0), part(|x| x < 30.0));
        let moved = Rigid::from_euler([0.3, -0.6, 2.0], [5e5, 4e6, -30.0]);

        let merged = run(&target, &source, &moved, &FuseOptions::default()).unwrap();
        assert_eq!(merged.points.len(), target.len() + source.len());
        assert!(
            (3.0..4.5).contains(&merged.hole_radius_m),
            "{}",
            merged.hole_radius_m
        );
        for i in 0..merged.points.len() {
            let (own, other) = match merged.origin[i] {
                Origin::Target => (&target, &source),
                Origin::Source => (&source, &target),
            };
            let p = &own[merged.given_index[i] as usize];
            assert!(distance_sq(p, &merged.points[i]).sqrt() < 1e-8);
            let wanted_sq = other
                .iter()
                .map(|q| distance_sq(p, q))
                .fold(f64::INFINITY, f64::min);
            assert!((merged.distance_m[i] - wanted_sq.sqrt()).abs() < 1e-8);
            assert_eq!(
                merged.fills_hole[i],
                merged.distance_m[i] > merged.hole_radius_m
            );
        }

        let fill = options(FuseMode::FillHoles, None);
        let filled = run(&target, &source, &moved, &fill).unwrap();
        let wanted: Vec<u32> = (0..merged.points.len())
            .filter(|&i| merged.origin[i] == Origin::Source && merged.fills_hole[i])
            .map(|i| merged.given_index[i])
            .collect();
        assert_eq!(filled.given_index[target.len()..], wanted);
        assert_eq!(filled.n_filled_by_source, wanted.len());
        assert_eq!(filled.n_filled_by_target, merged.n_filled_by_target);
        // Columns 0 to 6 of the target's hole lie beyond a radius between 3 and 4.5.
        assert!(
            (5 * 20..=7 * 20).contains(&wanted.len()),
            "{}",
            wanted.len()
        );
        assert_eq!(filled.points[..target.len()], merged.points[..target.len()]);
    }

    #[test]
    fn what_repeats_the_target_is_left_out_and_no_place_is_bared() {
        let mut stream = Stream::new(5, "fuse", 0);
        let mut floor = |n: usize, width: f64| -> Vec<Point> {
            let mut draw = || width * stream.uniform();
            (0..n).map(|_| [draw(), draw(), 0.0]).collect()
        };
        // The source is four times as dense, and goes on where the target ends.
        let (target, source) = (floor(2000, 10.0), floor(16_000, 14.0));
        let away = Rigid::from_euler([0.0, 0.0, 2.0], [5e5, 4e6, -30.0]);
        let dedup = options(FuseMode::Dedup, None);
        let fused = run(&target, &source, &away, &dedup).unwrap();
        assert_eq!(fused.points.len() + fused.n_repeated, 18_000);
        assert_eq!(fused.points[..2000].len(), target.len());
        // Nearly every target point replaces about one of the source.
        assert!(
            (500..2000).contains(&fused.n_repeated),
            "{}",
            fused.n_repeated
        );
        let merged = run(&target, &source, &away, &options(FuseMode::Merge, None)).unwrap();
        assert_eq!((merged.points.len(), merged.n_repeated), (18_000, 0));
        assert_eq!(merged.n_filled_by_source, fused.n_filled_by_source);
        // Whatever was left out has a partner in the result, nearer than the clouds are dense.
        let index = NeighborIndex::new(&fused.points);
        for p in &merged.points {
            assert!(index.nearest(p).unwrap().distance_sq.sqrt() < 0.5);
        }
        let twice = run(&target, &target, &away, &dedup).unwrap();
        assert_eq!((twice.points.len(), twice.n_repeated), (2000, 2000));
    }

    #[test]
    fn a_copy_fills_nothing() {
        let mut stream = Stream::new(2, "fuse", 0);
        let points: Vec<Point> = (0..300).map(|_| [0; 3].map(|_| stream.normal())).collect();
        let fill = options(FuseMode::FillHoles, None);
        let fused = run(&points, &points, &Rigid::identity(), &fill).unwrap();
        assert_eq!(fused.points.len(), 300);
        assert_eq!((fused.n_filled_by_source, fused.n_filled_by_target), (0, 0));
    }

    #[test]
    fn what_cannot_be_fused_is_refused() {
        let (some, none) = (vec![[0.0; 3]; 4], vec![]);
        let still = Rigid::identity();
        let radius = |hole_radius_m| options(FuseMode::Merge, Some(hole_radius_m));
        let refused = run(&some, &some, &still, &radius(0.0)).unwrap_err();
        assert!(refused.to_string().contains("hole_radius_m"));
        for (a, b) in [(&some, &none), (&none, &some)] {
            let refused = run(a, b, &still, &radius(1.0));
            assert!(matches!(refused, Err(Error::TooFewPoints { .. })));
        }
        assert!(
            run(&none, &none, &still, &radius(1.0))
                .unwrap()
                .points
                .is_empty()
        );
    }
}
