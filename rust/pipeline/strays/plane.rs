//! The plane that most of what stands round a voxel lies on, and whether the voxel lies on it, of eight at a time.
//!
//! Why: where a third of all points are strays, this is asked of every voxel, a million times; side by side eight
//! cost little more than one.
//! Source: iteratively reweighted least squares; the least eigenvalue by Halley's steps, which from below the roots of
//! a polynomial never pass the first.

use std::array;

use crate::cloud::{Point, distance_sq};
use crate::error::Result;
use crate::neighbors::{NeighborIndex, Places, WIDTH};
use crate::progress::Progress;
use crate::vectorize::prelude::*;
use crate::vectorize::{Eight, InEights, Mask, Simd, in_eights};

/// Voxels round about that tell what surface there is, the voxel itself among them. All lengths below are
/// shares of the distance of the farthest.
const N_NEAR: usize = 16;
/// How far off the plane a voxel still pulls at it, step by step.
const PULLS: [f64; 6] = [1.0, 0.5, 0.25, 0.125, 0.125, 0.125];
/// What lies within this of the plane is the surface, of which there has to be so much,
const IN_SURFACE: f64 = 0.19;
const LEAST_IN_SURFACE: f64 = 0.5;
/// and a voxel that is no stray lies within this.
const ON_SURFACE: f64 = 0.1;

/// Which of some places at points of a cloud lie on the plane that most of what stands round them lies on; true also
/// where that tells no plane. In the order in which the places were given.
///
/// # Errors
/// [`crate::Error::Cancelled`].
pub(super) fn lie_on_planes(
    index: &NeighborIndex,
    places: &Places,
    progress: &Progress<'_>,
) -> Result<Vec<bool>> {
    index.map_groups_of_k_nearest(places, N_NEAR, progress, |first, near, answers| {
        let own = array::from_fn(|lane| *places.point(first + lane.min(near.len() - 1)));
        let are_on = in_eights(AreOnPlanes { own, near });
        answers.extend((0..near.len()).map(|lane| are_on >> lane & 1 == 1));
    })
}

/// A bit for each of up to eight places, whether it lies on its plane.
struct AreOnPlanes<'a> {
    own: [Point; WIDTH],
    near: &'a [Vec<Point>],
}

impl InEights for AreOnPlanes<'_> {
    type Answer = u64;

    #[inline(always)]
    fn run<S: Simd>(self, machine: S) -> u64 {
        Neighborhoods::new(machine, &self.own, self.near).are_middles_on_planes(machine)
    }
}

/// What stands round each of eight places, about it and in shares of the distance of the farthest.
struct Neighborhoods<S: Simd> {
    near: [[Eight<S>; 3]; N_NEAR],
    /// What is missing weighs nothing.
    is_there: [Eight<S>; N_NEAR],
    n: Eight<S>,
}

impl<S: Simd> Neighborhoods<S> {
    #[inline(always)]
    fn new(machine: S, own: &[Point; WIDTH], near: &[Vec<Point>]) -> Self {
        let (mut offsets, mut is_there) = ([[[0.0; WIDTH]; 3]; N_NEAR], [[0.0; WIDTH]; N_NEAR]);
        let mut n = [0.0; WIDTH];
        for (lane, (own, near)) in own.iter().zip(near).enumerate() {
            let farthest_sq = near.iter().map(|p| distance_sq(own, p)).fold(0.0, f64::max);
            // Where all coincide that is no number, and there is no plane.
            let by_reach = 1.0 / farthest_sq.sqrt();
            for (i, p) in near.iter().enumerate() {
                for axis in 0..3 {
                    offsets[i][axis][lane] = (p[axis] - own[axis]) * by_reach;
                }
                is_there[i][lane] = 1.0;
            }
            n[lane] = near.len() as f64;
        }
        let nothing = Eight::splat(machine, 0.0);
        let mut made = Self {
            near: [[nothing; 3]; N_NEAR],
            is_there: [nothing; N_NEAR],
            n: Eight::simd_from(machine, n),
        };
        for i in 0..N_NEAR {
            made.is_there[i] = Eight::simd_from(machine, is_there[i]);
            for axis in 0..3 {
                made.near[i][axis] = Eight::simd_from(machine, offsets[i][axis]);
            }
        }
        made
    }

    #[inline(always)]
    fn are_middles_on_planes(&self, machine: S) -> u64 {
        let nothing = Eight::splat(machine, 0.0);
        let (mut weights, mut off, mut own_off) = (self.is_there, [nothing; N_NEAR], nothing);
        let mut is_settled = nothing.simd_lt(0.0);
        for pull in PULLS {
            let Moments { middle, scatter } = self.moments(nothing, &weights);
            let (normal, is_plane) = scatter.flattest(nothing);
            let of_middle = dot(&normal, &middle);
            own_off = of_middle.abs();
            let mut is_anyone_off = nothing.simd_lt(0.0);
            for i in 0..N_NEAR {
                off[i] = (dot(&normal, &self.near[i]) - of_middle).abs();
                is_anyone_off |= off[i].simd_ge(ON_SURFACE);
                let by_pull = off[i] * (1.0 / pull);
                weights[i] = self.is_there[i] * bell(by_pull);
            }
            // Where nobody stands off it, there is no other plane to be drawn to.
            is_settled |= !(is_plane & is_anyone_off);
            if is_settled.all_true() {
                break;
            }
        }
        let mut n_in = nothing;
        for (is_there, off) in self.is_there.iter().zip(&off) {
            n_in += off.simd_lt(IN_SURFACE).select(*is_there, nothing);
        }
        let is_on = own_off.simd_lt(ON_SURFACE) & n_in.simd_gt(self.n * LEAST_IN_SURFACE);
        (is_settled | is_on).to_bitmask()
    }

    /// The middles of what stands round about, each counting by its weight, and the scatter about these.
    #[inline(always)]
    fn moments(&self, nothing: Eight<S>, weights: &[Eight<S>; N_NEAR]) -> Moments<S> {
        let (mut total, mut sums) = (nothing, [nothing; 3]);
        let (mut squares, mut products) = ([nothing; 3], [nothing; 3]);
        for (weight, [x, y, z]) in weights.iter().zip(&self.near) {
            let [by_x, by_y, by_z] = [*weight * *x, *weight * *y, *weight * *z];
            total += *weight;
            sums = [sums[0] + by_x, sums[1] + by_y, sums[2] + by_z];
            squares = [
                squares[0] + by_x * *x,
                squares[1] + by_y * *y,
                squares[2] + by_z * *z,
            ];
            products = [
                products[0] + by_y * *z,
                products[1] + by_x * *z,
                products[2] + by_x * *y,
            ];
        }
        let middle = sums.map(|sum| sum / total);
        let about_middle = |of: [Eight<S>; 3], a: [usize; 3], b: [usize; 3]| {
            array::from_fn(|i| of[i] - sums[a[i]] * middle[b[i]])
        };
        let scatter = Scatter {
            squares: about_middle(squares, [0, 1, 2], [0, 1, 2]),
            products: about_middle(products, [1, 0, 0], [2, 2, 1]),
        };
        Moments { middle, scatter }
    }
}

struct Moments<S: Simd> {
    middle: [Eight<S>; 3],
    scatter: Scatter<S>,
}

/// Symmetric 3×3 matrices: xx, yy, zz; and yz, xz, xy, each beside the axis that it lacks.
struct Scatter<S: Simd> {
    squares: [Eight<S>; 3],
    products: [Eight<S>; 3],
}

impl<S: Simd> Scatter<S> {
    /// The unit eigenvector of the least eigenvalue, and whether the second is clearly larger.
    #[inline(always)]
    fn flattest(&self, nothing: Eight<S>) -> ([Eight<S>; 3], Mask<S>) {
        const N_STEPS: usize = 5;
        const CLOSE: f64 = 1e-3;
        let [xx, yy, zz] = self.squares;
        let by_trace = 1.0 / (xx + yy + zz);
        let [xx, yy, zz] = self.squares.map(|of| of * by_trace);
        let [yz, xz, xy] = self.products.map(|of| of * by_trace);
        // λ³ − λ² + `linear`·λ − `constant`: the trace is 1.
        let (yz_sq, xz_sq, xy_sq) = (yz * yz, xz * xz, xy * xy);
        let linear = (xx * yy - xy_sq) + (xx * zz - xz_sq) + (yy * zz - yz_sq);
        let constant = xx * (yy * zz - yz_sq) - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz);
        let mut least = nothing;
        for _ in 0..N_STEPS {
            let value = ((least - 1.0) * least + linear) * least - constant;
            let slope = (least * 3.0 - 2.0) * least + linear;
            let bend = least * 6.0 - 2.0;
            let below = slope * slope * 2.0 - value * bend;
            // At a double root there is nothing to divide by.
            let step = (value * slope * 2.0) / below;
            least -= below.simd_gt(0.0).select(step, nothing);
        }
        // The other two add up to `both` and lie so far `apart`.
        let both = 1.0 - least;
        let apart_sq = both * both - (linear - least * both) * 4.0;
        let apart = apart_sq.simd_gt(0.0).select(apart_sq, nothing).sqrt();
        let is_plane = ((both - apart) * 0.5 - least).simd_gt((both + apart) * (0.5 * CLOSE));
        // The rows of what is left without it span a plane; its normal is sharpest from the two rows that lie most
        // apart.
        let (x, y, z) = (xx - least, yy - least, zz - least);
        let mut normal = [yz * xy - xz * y, xz * xy - yz * x, x * y - xy * xy];
        let mut longest_sq = dot(&normal, &normal);
        for across in [
            [xy * z - yz * xz, xz * xz - x * z, x * yz - xy * xz],
            [y * z - yz * yz, yz * xz - xy * z, xy * yz - y * xz],
        ] {
            let length_sq = dot(&across, &across);
            let is_longer = length_sq.simd_gt(longest_sq);
            normal = array::from_fn(|axis| is_longer.select(across[axis], normal[axis]));
            longest_sq = is_longer.select(length_sq, longest_sq);
        }
        let by_length = 1.0 / longest_sq.sqrt();
        (normal.map(|of| of * by_length), is_plane)
    }
}

#[inline(always)]
fn dot<S: Simd>(a: &[Eight<S>; 3], b: &[Eight<S>; 3]) -> Eight<S> {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// exp(−x²/2) for |x| up to 16, to 2·10⁻⁵ of it where it is above a tenth: by multiplications alone.
#[inline(always)]
fn bell<S: Simd>(x: Eight<S>) -> Eight<S> {
    const DOUBLINGS: i32 = 8;
    let part = x * x * (0.5 / f64::from(1 << DOUBLINGS));
    let mut power = 1.0 - part + part * part * 0.5;
    for _ in 0..DOUBLINGS {
        power *= power;
    }
    power
}

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix3, SymmetricEigen, Vector3};

    use super::*;
    use crate::random::Stream;

    struct Flattest([[f64; WIDTH]; 3], [[f64; WIDTH]; 3]);

    impl InEights for Flattest {
        type Answer = ([[f64; WIDTH]; 3], u64);

        fn run<S: Simd>(self, machine: S) -> Self::Answer {
            let eights = |of: [[f64; WIDTH]; 3]| of.map(|of| Eight::simd_from(machine, of));
            let scatter = Scatter {
                squares: eights(self.0),
                products: eights(self.1),
            };
            let (normal, is_plane) = scatter.flattest(Eight::splat(machine, 0.0));
            (normal.map(|of| of.to_array()), is_plane.to_bitmask())
        }
    }

    struct Bell([f64; WIDTH]);

    impl InEights for Bell {
        type Answer = [f64; WIDTH];

        fn run<S: Simd>(self, machine: S) -> [f64; WIDTH] {
            bell(Eight::simd_from(machine, self.0)).to_array()
        }
    }

    #[test]
    fn the_flattest_direction_is_that_of_nalgebra() {
        let mut stream = Stream::new(1, "flattest", 0);
        for _ in 0..200 {
            let (mut squares, mut products) = ([[0.0; WIDTH]; 3], [[0.0; WIDTH]; 3]);
            let twins: Vec<Matrix3<f64>> = (0..WIDTH)
                .map(|lane| {
                    // From round to as flat as a sheet, and to a needle.
                    let widths = Vector3::new(1.0, stream.uniform(), stream.uniform().powi(4));
                    let mut twin = Matrix3::zeros();
                    for _ in 0..12 {
                        let v = widths.map(|width| width * stream.normal());
                        twin += v * v.transpose();
                    }
                    for axis in 0..3 {
                        squares[axis][lane] = twin[(axis, axis)];
                        products[axis][lane] = twin[((axis + 1) % 3, (axis + 2) % 3)];
                    }
                    twin
                })
                .collect();
            let (normal, are_planes) = in_eights(Flattest(squares, products));
            for (lane, twin) in twins.into_iter().enumerate() {
                let eigen = SymmetricEigen::new(twin);
                let at = eigen.eigenvalues.imin();
                let mut sorted: Vec<f64> = eigen.eigenvalues.iter().copied().collect();
                sorted.sort_by(f64::total_cmp);
                let gap = (sorted[1] - sorted[0]) / sorted[2];
                if gap > 0.02 {
                    let found = Vector3::from(normal.map(|of| of[lane]));
                    let cosine = found.dot(&eigen.eigenvectors.column(at)).abs();
                    assert!(
                        are_planes >> lane & 1 == 1 && 1.0 - cosine < 1e-6,
                        "{gap} {cosine}"
                    );
                }
            }
        }
    }

    /// Whether the first of these lies on the plane of the others.
    fn lies_on_plane(points: &[Point]) -> bool {
        let index = NeighborIndex::new(points);
        let place = Places::as_given(&points[..1]);
        lie_on_planes(&index, &place, &Progress::silent()).unwrap()[0]
    }

    #[test]
    fn a_point_off_a_floor_is_told_though_others_are_off_it_too() {
        let floor = (1..12).map(|i| {
            let angle = 0.7 * f64::from(i);
            [angle.cos(), angle.sin(), 0.01 * angle.sin()]
        });
        let off = [[0.2, 0.1, 0.6], [-0.4, 0.3, 0.8], [0.1, -0.5, -0.7]];
        let among = |height: f64| -> Vec<Point> {
            (std::iter::once([0.0, 0.0, height])
                .chain(floor.clone())
                .chain(off))
            .collect()
        };
        assert!(lies_on_plane(&among(0.02)));
        assert!(!lies_on_plane(&among(0.4)));
        assert!(!lies_on_plane(&among(-0.4)));
    }

    #[test]
    fn where_there_is_no_plane_nothing_is_off_it() {
        assert!(lies_on_plane(&[[1.0; 3]; 20]));
        let line: Vec<Point> = (0..20).map(|i| [f64::from(i), 0.0, 0.0]).collect();
        assert!(lies_on_plane(&line));
        assert!(lies_on_plane(&[[0.0; 3]]));
    }

    #[test]
    fn the_bell_is_that_of_the_exponential_function() {
        for i in 0..20 {
            let x: [f64; WIDTH] = array::from_fn(|lane| 0.8 * f64::from(i) + 0.1 * lane as f64);
            let found = in_eights(Bell(x));
            assert_eq!(found, in_eights(Bell(x.map(|x| -x))));
            for (x, found) in x.iter().zip(found) {
                let expected = (-0.5 * x * x).exp();
                assert!((found - expected).abs() < 2e-5 * expected.max(0.2), "{x}");
            }
        }
    }
}
