//! A fine grid close to a cloud: which point is nearest, a few nanoseconds a question.
//!
//! Why: poses are verified by asking for partners tens of thousands of times each. A tree answers
//! exactly in hundreds of nanoseconds; what is asked here, whether surface lies near and how it
//! slopes, does not need the very nearest point.
//! The answer is the point nearest to the *centre of the cell* of the query, to a 300 000th of the squared reach: at
//! most two half diagonals of a cell farther than the nearest one.
//! Memory: 16 bytes for each block of 8×8×8 cells in the box, 2 KiB for each block that was asked
//! about and lies near points, 40 bytes a point; blocks are filled when first asked, whoever asks first alike.
//! Source: ours. The counterpart for the whole box, coarse and without a limit of distance, is
//! [`NearestGrid`](crate::distance_field::NearestGrid).

use std::sync::OnceLock;

use crate::cloud::{Point, bounds, distance_sq};
use crate::parallel;
use crate::vectorize::widest;

const NOBODY: u32 = u32::MAX;
/// Cells along the edge of a block.
const EDGE: usize = 8;
const ROWS: usize = EDGE * EDGE;
/// Where the centre of the last cell of a block lies, from that of the first.
const LAST: f32 = EDGE as f32 - 1.0;
/// A cell whose centre is this many cells from a point may still hold a query at the reach.
const HALF_DIAGONAL: f64 = 0.867;

/// Of a key, for the number of a point; the others are for its squared distance, of which three are added.
const NUMBER_BITS: u32 = 12;
const LAST_NUMBER: u32 = (1 << NUMBER_BITS) - 1;
const FARTHEST: u32 = (1 << (32 - NUMBER_BITS)) / 3;
const OUT_OF_REACH: u32 = FARTHEST << NUMBER_BITS;

type Block = Option<Box<[[u32; EDGE]; ROWS]>>;

/// Nearest points within a short reach of a cloud.
///
/// ```
/// use tmchho::near_field::NearField;
/// let field = NearField::new(&[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]], 0.05, 0.2, 1_000_000).unwrap();
/// let (nearest, distance_sq) = field.nearest(&[0.9, 0.1, 0.0]).unwrap();
/// assert_eq!(nearest, 1);
/// assert!((distance_sq - 0.02).abs() < 1e-12);
/// assert!(field.nearest(&[0.5, 0.0, 0.0]).is_none());
/// ```
#[derive(Debug)]
pub struct NearField {
    low: Point,
    cells_per_m: f64,
    reach_cells: f64,
    n_blocks: [usize; 3],
    blocks: Vec<OnceLock<Block>>,
    /// Points by block: those of block b are `members[starts[b]..starts[b + 1]]`.
    starts: Vec<u32>,
    members: Vec<Member>,
    points: Vec<Point>,
}

impl NearField {
    /// Cells of edge `cell_m` that answer for queries up to `reach_m` from a point; both grow where
    /// there would be more than `max_blocks` blocks. The reach is held to 7 cells. `None` for no
    /// points.
    pub fn new(points: &[Point], cell_m: f64, reach_m: f64, max_blocks: usize) -> Option<Self> {
        if points.is_empty() {
            return None;
        }
        let (low, high) = bounds(points);
        let mut cell_m = cell_m;
        let (margin_m, n_blocks) = loop {
            let block_m = EDGE as f64 * cell_m;
            let margin_m = reach_m.max(cell_m);
            let n_blocks: [usize; 3] = std::array::from_fn(|axis| {
                ((high[axis] - low[axis] + 2.0 * margin_m) / block_m) as usize + 1
            });
            let n = n_blocks.iter().map(|n| *n as f64).product::<f64>();
            if n <= max_blocks.max(1) as f64 {
                break (margin_m, n_blocks);
            }
            cell_m *= (n / max_blocks.max(1) as f64).cbrt().max(1.01);
        };
        let mut field = Self {
            low: low.map(|v| v - margin_m),
            cells_per_m: 1.0 / cell_m,
            reach_cells: (margin_m / cell_m).min(EDGE as f64 - 1.0) + HALF_DIAGONAL,
            n_blocks,
            blocks: Vec::new(),
            starts: Vec::new(),
            members: Vec::new(),
            points: points.to_vec(),
        };
        let n = n_blocks.iter().product();
        field.blocks.resize_with(n, OnceLock::new);
        field.sort_into_blocks(n);
        Some(field)
    }

    /// The points that the field answers with.
    pub fn points(&self) -> &[Point] {
        &self.points
    }

    /// A point near `query` and its squared distance; `None` beyond the reach of all points.
    #[inline]
    pub fn nearest(&self, query: &Point) -> Option<(usize, f64)> {
        let mut block = 0;
        let mut cell = 0;
        for axis in (0..3).rev() {
            let at = (query[axis] - self.low[axis]) * self.cells_per_m;
            // Also false for NaN.
            if !(at >= 0.0 && at < (self.n_blocks[axis] * EDGE) as f64) {
                return None;
            }
            // By way of u32, to which the machine converts at once.
            let at = at as u32 as usize;
            block = block * self.n_blocks[axis] + at / EDGE;
            cell = cell * EDGE + at % EDGE;
        }
        let nearest = self.blocks[block]
            .get_or_init(|| self.fill(block))
            .as_ref()?[cell / EDGE][cell % EDGE];
        if nearest == NOBODY {
            return None;
        }
        let nearest = nearest as usize;
        Some((nearest, distance_sq(query, &self.points[nearest])))
    }

    fn in_cells(&self, p: &Point) -> Point {
        std::array::from_fn(|axis| (p[axis] - self.low[axis]) * self.cells_per_m)
    }

    fn sort_into_blocks(&mut self, n_blocks: usize) {
        let placed = parallel::map(self.points.len(), |i| {
            let at = self.in_cells(&self.points[i]);
            let block: [usize; 3] =
                std::array::from_fn(|axis| (at[axis] as usize / EDGE).min(self.n_blocks[axis] - 1));
            let [nx, ny, _] = self.n_blocks;
            let within: [f32; 3] =
                std::array::from_fn(|axis| (at[axis] - (block[axis] * EDGE) as f64) as f32);
            ((block[2] * ny + block[1]) * nx + block[0], within)
        });
        let mut starts = vec![0_u32; n_blocks + 1];
        for (block, _) in &placed {
            starts[block + 1] += 1;
        }
        for block in 0..n_blocks {
            starts[block + 1] += starts[block];
        }
        let mut next = starts.clone();
        let mut members = vec![Member::default(); self.points.len()];
        for (index, (block, within)) in (0_u32..).zip(placed) {
            members[next[block] as usize] = Member { within, index };
            next[block] += 1;
        }
        (self.starts, self.members) = (starts, members);
    }

    /// The nearest point to the centre of every cell of a block.
    fn fill(&self, block: usize) -> Block {
        let near = self.within_reach_of(block);
        if near.is_empty() {
            return None;
        }
        let mut nearest = Box::new([[NOBODY; EDGE]; ROWS]);
        let mut best = [[OUT_OF_REACH; EDGE]; ROWS];
        for near in near.chunks(1 << NUMBER_BITS) {
            let keys = least_keys(near, self.reach_cells as f32);
            let cells = nearest.as_flattened_mut().iter_mut();
            let keys = keys.as_flattened().iter();
            for ((nearest, best), key) in cells.zip(best.as_flattened_mut()).zip(keys) {
                if *key >> NUMBER_BITS < *best >> NUMBER_BITS {
                    *best = *key;
                    *nearest = near[(*key & LAST_NUMBER) as usize].index;
                }
            }
        }
        Some(nearest)
    }

    /// The points from which some cell of a block may be in reach, relative to the centre of its first cell.
    fn within_reach_of(&self, block: usize) -> Vec<Member> {
        let reach = self.reach_cells as f32;
        let n_round_about = self.round_about(block).map(|(_, members)| members.len());
        let mut near = Vec::with_capacity(n_round_about.sum());
        for (corner, members) in self.round_about(block) {
            let placed = members.iter().map(|member| Member {
                within: std::array::from_fn(|axis| corner[axis] + member.within[axis] - 0.5),
                ..*member
            });
            let is_near = |v: &f32| *v >= -reach && *v <= LAST + reach;
            near.extend(placed.filter(|member| member.within.iter().all(is_near)));
        }
        near
    }

    /// A block and those that touch it: how many cells away each begins, and its points.
    fn round_about(&self, block: usize) -> impl Iterator<Item = ([f32; 3], &[Member])> {
        let [nx, ny, _] = self.n_blocks;
        let at = [block % nx, block / nx % ny, block / nx / ny];
        (0..27).filter_map(move |i| {
            let step = [i % 3, i / 3 % 3, i / 9];
            let mut other = [0; 3];
            for axis in 0..3 {
                other[axis] = (at[axis] + step[axis]).checked_sub(1)?;
                if other[axis] >= self.n_blocks[axis] {
                    return None;
                }
            }
            let other = (other[2] * ny + other[1]) * nx + other[0];
            let (first, end) = (self.starts[other], self.starts[other + 1]);
            let corner = step.map(|step| (step as f32 - 1.0) * EDGE as f32);
            Some((corner, &self.members[first as usize..end as usize]))
        })
    }
}

/// A point, and where it lies in its block, in cells.
#[derive(Debug, Clone, Copy, Default)]
struct Member {
    within: [f32; 3],
    index: u32,
}

/// For every cell the least key of all points: the squared distance, in parts of the reach, and below it the number of
/// the point. So one comparison of whole numbers keeps both.
fn least_keys(near: &[Member], reach: f32) -> [[u32; EDGE]; ROWS] {
    let mut keys = [[OUT_OF_REACH; EDGE]; ROWS];
    widest(
        #[inline(always)]
        || {
            for (number, member) in (0_u32..).zip(near) {
                enter(member.within, number, reach, &mut keys);
            }
        },
    );
    keys
}

/// Enters a point into every cell of a block that it is nearer to than those before it.
#[inline(always)]
fn enter(p: [f32; 3], number: u32, reach: f32, keys: &mut [[u32; EDGE]; ROWS]) {
    // Rounded, which may take a row too many.
    let span = |axis: usize| {
        let (low, high) = ((p[axis] - reach).max(0.0), (p[axis] + reach).min(LAST));
        whole(low) as usize..whole(high) as usize + 1
    };
    let reach_sq = reach * reach;
    let key_per_cell_sq = FARTHEST as f32 / reach_sq;
    let squares = |v: f32| -> [u32; EDGE] {
        std::array::from_fn(|cell| {
            let distance = v - cell as f32;
            // Whatever lies beyond the reach on one axis does so altogether, and no sum overflows.
            whole((distance * distance).min(reach_sq) * key_per_cell_sq) << NUMBER_BITS
        })
    };
    let [xs, ys, zs] = p.map(squares);
    let xs = xs.map(|x_sq| x_sq | number);
    let span_y = span(1);
    for z in span(2) {
        let rows = &mut keys[z * EDGE..(z + 1) * EDGE];
        for (row, y_sq) in rows[span_y.clone()].iter_mut().zip(&ys[span_y.clone()]) {
            let across_sq = zs[z] + y_sq;
            for x in 0..EDGE {
                row[x] = row[x].min(xs[x] + across_sq);
            }
        }
    }
}

/// A number from 0 to 2²² rounded, without the cases that casts care for: so all of a vector are converted at once.
#[inline(always)]
fn whole(v: f32) -> u32 {
    const ONES: f32 = (1 << 23) as f32; // from here on neighbouring numbers are 1 apart
    (v + ONES).to_bits() & ((1 << 23) - 1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::parallel;
    use crate::random::Stream;

    fn some_points(n: usize, stream: &mut Stream) -> Vec<Point> {
        (0..n)
            .map(|_| std::array::from_fn(|axis| stream.uniform() * [1.0, 2.0, 0.3][axis]))
            .collect()
    }

    #[test]
    fn answers_are_as_near_as_promised_and_given_wherever_promised() {
        let (cell_m, reach_m) = (0.02, 0.07);
        let mut stream = Stream::new(1, "near field", 0);
        let points = some_points(300, &mut stream);
        let field = NearField::new(&points, cell_m, reach_m, 1_000_000).unwrap();
        let slack_m = 2.0 * HALF_DIAGONAL * cell_m;
        let mut n_answered = 0;
        for query in some_points(20_000, &mut stream) {
            let query = query.map(|v| 1.2 * v - 0.1);
            let exact = points
                .iter()
                .map(|p| distance_sq(p, &query).sqrt())
                .fold(f64::INFINITY, f64::min);
            match field.nearest(&query) {
                Some((i, found_sq)) => {
                    n_answered += 1;
                    assert_eq!(found_sq, distance_sq(&points[i], &query));
                    assert!(found_sq.sqrt() <= exact + slack_m);
                }
                None => assert!(exact > reach_m, "{exact}"),
            }
        }
        assert!((4000..18_000).contains(&n_answered), "{n_answered}");
    }

    #[test]
    fn the_same_answers_whoever_fills_the_blocks() {
        let mut stream = Stream::new(2, "near field", 0);
        let points = some_points(2000, &mut stream);
        let queries = some_points(20_000, &mut stream);
        let ask = |n_threads| {
            parallel::with_threads(Some(n_threads), || {
                let field = NearField::new(&points, 0.01, 0.03, 1_000_000).unwrap();
                Ok(parallel::map(queries.len(), |i| field.nearest(&queries[i])))
            })
            .unwrap()
        };
        assert_eq!(ask(1), ask(4));
    }

    #[test]
    fn memory_is_bounded_and_odd_queries_are_answered() {
        let points = [[0.0; 3], [1e6, 1e6, 1e6]];
        let field = NearField::new(&points, 1e-3, 1e-2, 1000).unwrap();
        assert!(field.blocks.len() <= 1000);
        assert_eq!(field.nearest(&[1e6, 1e6, 1e6]), Some((1, 0.0)));
        assert!(field.nearest(&[f64::NAN, 0.0, 0.0]).is_none());
        assert!(field.nearest(&[-1e9, 0.0, 0.0]).is_none());
        assert!(NearField::new(&[], 0.1, 0.1, 8).is_none());
    }
}
