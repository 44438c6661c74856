//! The normal of a surface in the ball, of several, in which it is flattest.

use crate::cloud::Point;
use crate::neighbors::NeighborIndex;
use crate::normals::Symmetric;

/// The normal in that of the balls in which the points are flattest, and its radius; NaN where none
/// of them holds three points that span a plane.
pub(super) fn flattest_normal(
    place: &Point,
    cloud: &NeighborIndex,
    radii_m: &[f64],
    orientation: &Point,
) -> (Point, f64) {
    let largest_m = radii_m.iter().fold(0.0, |largest: f64, r| largest.max(*r));
    let mut balls = vec![Moments::default(); radii_m.len()];
    cloud.each_in_ball(place, largest_m, |offset, distance_sq| {
        for (ball, radius_m) in balls.iter_mut().zip(radii_m) {
            if distance_sq <= radius_m * radius_m {
                ball.add(offset);
            }
        }
    });
    let mut best = (f64::NEG_INFINITY, [f64::NAN; 3], f64::NAN);
    for (ball, radius_m) in balls.iter().zip(radii_m) {
        let Some((lambda, normal)) = ball.plane() else {
            continue;
        };
        let flatness = (lambda[1] - lambda[2]) / lambda[0];
        if flatness > best.0 {
            best = (flatness, normal, *radius_m);
        }
    }
    let (_, normal, radius_m) = best;
    let side: f64 = (0..3).map(|axis| normal[axis] * orientation[axis]).sum();
    (
        if side < 0.0 {
            normal.map(|v| -v)
        } else {
            normal
        },
        radius_m,
    )
}

/// Offsets summed up.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Moments {
    pub(super) n: u32,
    sum: Point,
    squares: Symmetric,
}

impl Moments {
    #[inline]
    pub(super) fn add(&mut self, offset: Point) {
        self.n += 1;
        for axis in 0..3 {
            self.sum[axis] += offset[axis];
        }
        self.squares.add(offset, 1.0);
    }

    /// Eigenvalues of the scatter in falling order, and the normal.
    pub(super) fn plane(&self) -> Option<([f64; 3], Point)> {
        /// Points whose width is a millionth of their length lie on a line.
        const LINE: f64 = 1e-12;
        if self.n < 3 {
            return None;
        }
        let n = f64::from(self.n);
        let mut scatter = self.squares;
        scatter.add(self.sum.map(|v| v / n), -n);
        let (lambda, vectors) = scatter.eigen();
        (lambda[1] > LINE * lambda[0]).then_some((lambda, vectors[2]))
    }
}
