//! The direction that most of a cloud's surface faces: up or down, of nearly all surveys.
//!
//! Why: a model without control points has its axes anywhere, and levelled poses are the only ones that are found
//! under much noise. Ground is level in many places, and nothing else faces one way as exactly.
//! Source: normals of wide patches, whose noise is averaged out, and the mode of these axes by mean shift (Cheng 1995)
//! with a kernel that is narrow enough for slopes not to pull; measured in docs/robust_search.md.

use crate::cloud::{Point, dot};
use crate::error::Result;
use crate::normals::{Surface, Symmetric, estimate_within};
use crate::parallel;
use crate::progress::Progress;
use crate::surface_cloud::SurfaceCloud;

/// Patches that are looked at, and their radius by the unit.
const N_PATCHES: usize = 1000;
const PATCH_RADIUS: f64 = 0.045;
const LEAST_POINTS: usize = 8;
/// Standard deviation of the kernel.
const KERNEL_RAD: f64 = 3.0 * std::f64::consts::PI / 180.0;
const N_SHIFTS: usize = 10;

/// The axis that most surface of `cloud` faces, as a unit vector of either sign; `None` where no surface can be told.
///
/// # Errors
/// [`crate::Error::Cancelled`].
pub(super) fn most_faced(
    cloud: &SurfaceCloud,
    unit_m: f64,
    progress: &Progress<'_>,
) -> Result<Option<Point>> {
    let places = cloud.points_of(&cloud.drawn_in_order(N_PATCHES));
    let radius_m = PATCH_RADIUS * unit_m;
    let patches = estimate_within(&places, &cloud.index, radius_m, LEAST_POINTS, progress)?;
    let is_told = |patch: &&Surface| patch.normal != Surface::NONE.normal;
    let axes: Vec<Point> = (patches.iter().filter(is_told))
        .map(|patch| patch.normal)
        .collect();
    let densities = parallel::map(axes.len(), |i| -> f64 {
        axes.iter().map(|axis| kernel(axis, &axes[i])).sum()
    });
    let densest = (0..axes.len()).max_by(|a, b| densities[*a].total_cmp(&densities[*b]));
    Ok(densest.map(|at| shifted_to_mode(&axes, axes[at])))
}

fn shifted_to_mode(axes: &[Point], start: Point) -> Point {
    let mut mode = start;
    for _ in 0..N_SHIFTS {
        let mut scatter = Symmetric::default();
        for axis in axes {
            scatter.add(*axis, kernel(axis, &mode));
        }
        mode = scatter.eigen().1[0];
    }
    mode
}

/// How much one axis counts at another, of either sign.
fn kernel(a: &Point, b: &Point) -> f64 {
    let sine_sq = 1.0 - dot(a, b).powi(2);
    (-0.5 * sine_sq / (KERNEL_RAD * KERNEL_RAD)).exp()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cloud::Cloud;
    use crate::random::Stream;
    use crate::rigid::Rigid;

    /// A level bench beside a slope of twice its size that rises ever more steeply, both thick with noise.
    fn bench_and_slope(turn: &Rigid) -> SurfaceCloud {
        let mut stream = Stream::new(1, "bench", 0);
        let points: Vec<Point> = (0..12_000)
            .map(|_| {
                let (x, y) = (3.0 * stream.uniform(), stream.uniform());
                let height = 0.25 * (x - 1.0).max(0.0).powi(2);
                turn.apply(&[x, y, height + 0.02 * stream.normal()])
            })
            .collect();
        SurfaceCloud::new(&Cloud::new(&points).unwrap(), 1, &Progress::silent()).unwrap()
    }

    #[test]
    fn up_is_what_level_ground_faces_whatever_lies_beside_it() {
        for euler in [[0.0; 3], [0.4, -2.0, 1.0], [1.6, 0.1, 0.0]] {
            let turn = Rigid::from_euler(euler, [5.0, -3.0, 8.0]);
            let cloud = bench_and_slope(&turn);
            let found = most_faced(&cloud, 3.2, &Progress::silent())
                .unwrap()
                .unwrap();
            let cosine = dot(&found, &turn.rotate(&[0.0, 0.0, 1.0])).abs();
            let off_deg = cosine.min(1.0).acos().to_degrees();
            assert!(off_deg < 2.0, "{off_deg}");
        }
    }

    #[test]
    fn where_no_surface_can_be_told_nothing_is_faced() {
        let cloud = bench_and_slope(&Rigid::identity());
        // No patch of that size holds enough points.
        assert_eq!(most_faced(&cloud, 1e-3, &Progress::silent()).unwrap(), None);
    }
}
