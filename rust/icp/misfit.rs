//! How far the surfaces of a pair are apart: along the plane that they share, or as two flat pebbles.
//!
//! Why both surfaces: two sensors differ in noise, and which cloud has the better planes is not known
//! beforehand. The normals of both are averaged, each by what its own scatter says of its accuracy, so
//! that the smoother cloud decides, wherever it is the smoother one.
//! Source: Segal, Haehnel & Thrun (2009), Eq. (2), for planes against planes; Rusinkiewicz (2019) for
//! using both normals. Deviates: the thickness of a plane is its own scatter; the combined covariance
//! is inverted in closed form from the two normals, without the part that is no plane's.

use crate::cloud::{Point, dot};
use crate::normals::Surface;
use crate::surface_cloud::N_NORMAL_NEIGHBORS;

/// The plane that two surfaces share.
#[derive(Debug, Clone, Copy)]
pub(super) struct CommonPlane {
    pub(super) normal: Point,
    /// Variance of the slope of the normal along each direction in the plane.
    pub(super) slope_variance: f64,
}

/// Variance of the slope of a normal: points that scatter by σ about a disc of radius r give
/// σ² / (k·r²/4), and the two are the eigenvalues that the curvature compares. What is bent in truth
/// counts as scatter; that errs on the safe side.
fn slope_variance(surface: &Surface) -> f64 {
    /// Points that lie on a plane exactly are not free of error.
    const LEAST: f64 = 1e-6;
    // The plane has taken three degrees of freedom out of the scatter.
    (thickness(surface) / (N_NORMAL_NEIGHBORS - 3) as f64).max(LEAST)
}

/// Variance across the surface by the mean variance along it.
fn thickness(surface: &Surface) -> f64 {
    2.0 * surface.curvature / (1.0 - surface.curvature)
}

fn is_known(surface: &Surface) -> bool {
    surface.normal != [0.0; 3]
}

/// The plane between the target's surface and the source's, whose normal is turned into the target's
/// frame. `None` where neither has a normal, or both have and disagree by more than 60°.
pub(super) fn common_plane(target: &Surface, source: Option<Surface>) -> Option<CommonPlane> {
    const LEAST_COSINE: f64 = 0.5;
    let alone = |surface: &Surface| CommonPlane {
        normal: surface.normal,
        slope_variance: slope_variance(surface),
    };
    let source = match source {
        Some(source) if is_known(&source) => source,
        _ => return is_known(target).then(|| alone(target)),
    };
    if !is_known(target) {
        return Some(alone(&source));
    }
    let cosine = dot(&target.normal, &source.normal);
    if cosine.abs() < LEAST_COSINE {
        return None;
    }
    let weights = [target, &source].map(|surface| 1.0 / slope_variance(surface));
    let of_source = weights[1].copysign(cosine);
    let sum: Point = std::array::from_fn(|axis| {
        weights[0] * target.normal[axis] + of_source * source.normal[axis]
    });
    let length = dot(&sum, &sum).sqrt();
    Some(CommonPlane {
        normal: sum.map(|v| v / length),
        slope_variance: 1.0 / (weights[0] + weights[1]),
    })
}

/// What the planes add to the inverse of the combined covariance of two points on them, in units of
/// the variance along a plane: entries xx, yx, yy, zx, zy, zz.
///
/// A point has the variance 1 along its plane and its thickness ε across: I − a·n·nᵀ with a = 1 − ε.
/// Two together, 2·I − a₁·n₁·n₁ᵀ − a₂·n₂·n₂ᵀ, are inverted by Woodbury's identity. The inverse of 2·I
/// is left out: it pulls points along their planes to partners that merely happened to be sampled,
/// which holds back every step and no pose.
pub(super) fn between_planes(target: &Surface, source: &Surface) -> [f64; 6] {
    /// Segal, Haehnel & Thrun's ε: no plane is thinner.
    const THINNEST: f64 = 1e-3;
    let flatness = |surface: &Surface| {
        if is_known(surface) {
            1.0 - thickness(surface).clamp(THINNEST, 1.0)
        } else {
            0.0
        }
    };
    let (m, n) = (&target.normal, &source.normal);
    let (a, b, cosine) = (flatness(target), flatness(source), dot(m, n));
    let determinant = (1.0 - 0.5 * a) * (1.0 - 0.5 * b) - 0.25 * a * b * cosine * cosine;
    let of_target = 0.25 * a * (1.0 - 0.5 * b) / determinant;
    let of_source = 0.25 * b * (1.0 - 0.5 * a) / determinant;
    let of_both = 0.125 * a * b * cosine / determinant;
    let entry = |r: usize, c: usize| {
        of_target * m[r] * m[c] + of_source * n[r] * n[c] + of_both * (m[r] * n[c] + n[r] * m[c])
    };
    [
        entry(0, 0),
        entry(1, 0),
        entry(1, 1),
        entry(2, 0),
        entry(2, 1),
        entry(2, 2),
    ]
}

/// vᵀ·W·v
pub(super) fn quadratic([xx, yx, yy, zx, zy, zz]: &[f64; 6], v: &Point) -> f64 {
    xx * v[0] * v[0]
        + yy * v[1] * v[1]
        + zz * v[2] * v[2]
        + 2.0 * (yx * v[0] * v[1] + zx * v[0] * v[2] + zy * v[1] * v[2])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Stream;
    use nalgebra::{Matrix3, Vector3};

    fn surface(normal: Point, curvature: f64) -> Surface {
        Surface {
            normal: Vector3::from(normal).normalize().into(),
            curvature,
            roughness_m: 0.0,
        }
    }

    #[test]
    fn the_smoother_surface_decides_the_plane() {
        let (smooth, rough) = (
            surface([0.0, 0.0, 1.0], 1e-4),
            surface([0.3, 0.0, -1.0], 1e-2),
        );
        for (target, source) in [(smooth, rough), (rough, smooth)] {
            let plane = common_plane(&target, Some(source)).unwrap();
            // Averaged with weights of 100 to 1, whatever way the normals point.
            assert!((plane.normal[0] / plane.normal[2]).abs() < 0.004);
            assert!(plane.slope_variance < slope_variance(&smooth));
        }
        assert!(common_plane(&smooth, Some(surface([1.0, 0.0, 0.5], 0.0))).is_none());
        let alone = common_plane(&smooth, Some(Surface::NONE)).unwrap();
        assert_eq!(
            alone.normal,
            common_plane(&Surface::NONE, Some(smooth)).unwrap().normal
        );
        assert!(common_plane(&Surface::NONE, None).is_none());
    }

    #[test]
    fn the_inverse_in_closed_form_is_the_inverse() {
        let mut stream = Stream::new(1, "misfit", 0);
        for trial in 0..200 {
            let mut draw = || {
                let normal = [0; 3].map(|_| stream.normal());
                surface(normal, 0.3 * stream.uniform().powi(4))
            };
            let mut pair = [draw(), draw()];
            if trial % 10 == 0 {
                pair[1] = Surface::NONE;
            }
            let covariance = pair.iter().fold(Matrix3::zeros(), |sum, s| {
                let n = Vector3::from(s.normal);
                sum + Matrix3::identity() - (1.0 - thickness(s).max(1e-3)) * n * n.transpose()
            });
            let inverse: Matrix3<f64> =
                covariance.try_inverse().unwrap() - 0.5 * Matrix3::identity();
            let got = between_planes(&pair[0], &pair[1]);
            let wanted = [(0, 0), (1, 0), (1, 1), (2, 0), (2, 1), (2, 2)].map(|at| inverse[at]);
            for (a, b) in got.iter().zip(wanted) {
                assert!(
                    (a - b).abs() < 1e-9 * (1.0 + inverse.amax()),
                    "{got:?} {wanted:?}"
                );
            }
        }
    }
}
