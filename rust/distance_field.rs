//! A grid that knows, for every cell, which point of a cloud is nearest.
//!
//! Why: the search asks for millions of nearest points at poses that are mostly wrong. A look-up
//! here costs the same few nanoseconds anywhere, a tree query far from the cloud thousands.
//! The answer is the nearest point *of the cell's centre*: off by at most a cell for a query in the
//! grid, good enough to find a basin, not to state a distance.
//! Source: exact linear-time distance transform with the nearest index (Felzenszwalb & Huttenlocher
//! 2012; Maurer, Qi & Raghavan 2003), one axis after another.
//! Memory: 4 bytes a cell plus 30 bytes a point; the number of cells is bounded.

use crate::cloud::{Point, bounds, distance_sq};
use crate::parallel;

const NOBODY: u32 = u32::MAX;

/// The nearest point for every cell of a box round a cloud.
///
/// ```
/// use tmchho::distance_field::NearestGrid;
/// let points = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]];
/// let grid = NearestGrid::new(&points, 0.05, 0.5, 1_000_000).unwrap();
/// let (nearest, distance_sq) = grid.nearest(&[0.8, 0.1, 0.0]);
/// assert_eq!(nearest, 1);
/// assert!((distance_sq - 0.05).abs() < 1e-12);
/// ```
#[derive(Debug, Clone)]
pub struct NearestGrid {
    low: Point,
    cells_per_m: f64,
    size: [usize; 3],
    /// Nearest point of each cell; x runs fastest, then z, then y.
    nearest: Vec<u32>,
    points: Vec<Point>,
}

impl NearestGrid {
    /// A grid of cells of edge `cell_m` over the box of `points` widened by `margin_m`; the cells
    /// grow where there would be more than `max_cells`. `None` for no points.
    pub fn new(points: &[Point], cell_m: f64, margin_m: f64, max_cells: usize) -> Option<Self> {
        if points.is_empty() {
            return None;
        }
        let (low, high) = bounds(points);
        let low = low.map(|v| v - margin_m);
        let high = high.map(|v| v + margin_m);
        let mut cell_m = cell_m;
        let size = loop {
            let size: [usize; 3] = std::array::from_fn(|axis| {
                ((high[axis] - low[axis]) / cell_m).floor() as usize + 1
            });
            let n_cells = size.iter().map(|n| *n as f64).product::<f64>();
            if n_cells <= max_cells.max(1) as f64 {
                break size;
            }
            cell_m *= (n_cells / max_cells.max(1) as f64).cbrt().max(1.01);
        };
        let mut grid = Self {
            low,
            cells_per_m: 1.0 / cell_m,
            size,
            nearest: Vec::new(),
            points: points.to_vec(),
        };
        grid.fill();
        Some(grid)
    }

    /// The points that the grid answers with.
    pub fn points(&self) -> &[Point] {
        &self.points
    }

    /// Edge of a cell.
    pub fn cell_m(&self) -> f64 {
        1.0 / self.cells_per_m
    }

    /// Number of cells.
    pub fn n_cells(&self) -> usize {
        self.nearest.len()
    }

    /// Index of the point nearest to the centre of the cell of `query`, and the squared distance
    /// from `query` itself to that point. Queries outside the grid ask the border cell.
    #[inline]
    pub fn nearest(&self, query: &Point) -> (usize, f64) {
        let index = self.index_of_nearest(query) as usize;
        (index, distance_sq(query, &self.points[index]))
    }

    /// The same without the distance.
    #[inline]
    pub(crate) fn index_of_nearest(&self, query: &Point) -> u32 {
        let cell: [usize; 3] = std::array::from_fn(|axis| {
            // The cast saturates, negative and NaN become 0; to u32, because the machine does that at once.
            let i = ((query[axis] - self.low[axis]) * self.cells_per_m) as u32;
            (i as usize).min(self.size[axis] - 1)
        });
        self.nearest[self.at(cell)]
    }

    /// Whether `query` lies in the box of the grid.
    #[inline]
    pub fn covers(&self, query: &Point) -> bool {
        (0..3).all(|axis| {
            let i = (query[axis] - self.low[axis]) * self.cells_per_m;
            i >= 0.0 && i < self.size[axis] as f64
        })
    }

    #[inline]
    fn at(&self, [x, y, z]: [usize; 3]) -> usize {
        (y * self.size[2] + z) * self.size[0] + x
    }

    fn fill(&mut self) {
        let [nx, ny, nz] = self.size;
        let cell_of = parallel::map(self.points.len(), |i| self.cell_of(&self.points[i]));
        // Slabs of constant z for the first two axes.
        let mut slabs = vec![NOBODY; nx * ny * nz];
        for (i, cell) in cell_of.iter().enumerate() {
            let [x, y, z] = cell.map(usize::from);
            let slot = &mut slabs[(z * ny + y) * nx + x];
            // Several points in a cell: the one nearest to its centre, the first of equals.
            if *slot == NOBODY
                || self.off_centre_sq(i, cell) < self.off_centre_sq(*slot as usize, cell)
            {
                *slot = i as u32;
            }
        }
        parallel::for_each_chunk(&mut slabs, nx * ny, |_, slab| {
            for row in slab.chunks_exact_mut(nx) {
                nearest_in_row(row, &cell_of);
            }
            let mut envelope = Envelope::default();
            for x in 0..nx {
                envelope.fill(ny, |y| slab[y * nx + x], |seed| square(cell_of[seed][0], x));
                envelope.read(ny, |y, seed| slab[y * nx + x] = seed);
            }
        });
        // Then sheets of constant y for the third.
        self.nearest = vec![NOBODY; slabs.len()];
        parallel::for_each_chunk(&mut self.nearest, nx * nz, |y, sheet| {
            let mut envelope = Envelope::default();
            for x in 0..nx {
                envelope.fill(
                    nz,
                    |z| slabs[(z * ny + y) * nx + x],
                    |seed| square(cell_of[seed][0], x) + square(cell_of[seed][1], y),
                );
                envelope.read(nz, |z, seed| sheet[z * nx + x] = seed);
            }
        });
    }

    fn cell_of(&self, p: &Point) -> [u16; 3] {
        std::array::from_fn(|axis| {
            let i = ((p[axis] - self.low[axis]) * self.cells_per_m) as usize;
            i.min(self.size[axis] - 1).min(usize::from(u16::MAX)) as u16
        })
    }

    fn off_centre_sq(&self, point: usize, cell: &[u16; 3]) -> f64 {
        let centre = std::array::from_fn(|axis| {
            self.low[axis] + (f64::from(cell[axis]) + 0.5) / self.cells_per_m
        });
        distance_sq(&self.points[point], &centre)
    }
}

fn square(a: u16, b: usize) -> f64 {
    let d = f64::from(a) - b as f64;
    d * d
}

/// First axis: the nearer of the last seed to the left and the next one to the right.
fn nearest_in_row(row: &mut [u32], cell_of: &[[u16; 3]]) {
    let mut last = NOBODY;
    for slot in row.iter_mut() {
        if *slot == NOBODY {
            *slot = last;
        } else {
            last = *slot;
        }
    }
    let mut next = NOBODY;
    for x in (0..row.len()).rev() {
        let here = row[x];
        if here != NOBODY && usize::from(cell_of[here as usize][0]) == x {
            next = here;
        } else if next != NOBODY
            && (here == NOBODY
                || square(cell_of[next as usize][0], x) < square(cell_of[here as usize][0], x))
        {
            row[x] = next;
        }
    }
}

/// Lower envelope of the parabolas `height(i) + (x − i)²` along one line of cells.
#[derive(Default)]
struct Envelope {
    /// (cell of the vertex, seed, height, left end of its reign)
    parabolas: Vec<(usize, u32, f64, f64)>,
}

impl Envelope {
    fn fill(&mut self, n: usize, seed: impl Fn(usize) -> u32, height: impl Fn(usize) -> f64) {
        self.parabolas.clear();
        for i in 0..n {
            let seed = seed(i);
            if seed == NOBODY {
                continue;
            }
            let (x, h) = (i as f64, height(seed as usize));
            let mut left = f64::NEG_INFINITY;
            while let Some(&(vertex, _, vertex_height, reign)) = self.parabolas.last() {
                let v = vertex as f64;
                left = ((h + x * x) - (vertex_height + v * v)) / (2.0 * (x - v));
                if left > reign {
                    break;
                }
                self.parabolas.pop();
                left = f64::NEG_INFINITY;
            }
            self.parabolas.push((i, seed, h, left));
        }
    }

    fn read(&self, n: usize, mut write: impl FnMut(usize, u32)) {
        let mut current = 0;
        for i in 0..n {
            while current + 1 < self.parabolas.len() && self.parabolas[current + 1].3 < i as f64 {
                current += 1;
            }
            if let Some(parabola) = self.parabolas.get(current) {
                write(i, parabola.1);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Stream;

    #[test]
    fn every_cell_knows_its_nearest_occupied_cell() {
        let mut stream = Stream::new(3, "grid", 0);
        let points: Vec<Point> = (0..60)
            .map(|_| std::array::from_fn(|axis| stream.uniform() * [1.0, 2.0, 0.7][axis]))
            .collect();
        let grid = NearestGrid::new(&points, 0.1, 0.2, 1_000_000).unwrap();
        let cells: Vec<_> = points.iter().map(|p| grid.cell_of(p)).collect();
        let [nx, ny, nz] = grid.size;
        for (x, y, z) in
            (0..nx).flat_map(|x| (0..ny).flat_map(move |y| (0..nz).map(move |z| (x, y, z))))
        {
            let to = |cell: &[u16; 3]| square(cell[0], x) + square(cell[1], y) + square(cell[2], z);
            let best = cells.iter().map(to).fold(f64::INFINITY, f64::min);
            let found = grid.nearest[grid.at([x, y, z])] as usize;
            assert_eq!(to(&cells[found]), best, "cell {x} {y} {z}");
        }
    }

    #[test]
    fn queries_outside_and_odd_ones_are_answered() {
        let grid = NearestGrid::new(&[[1.0, 1.0, 1.0]], 0.1, 0.0, 8).unwrap();
        assert_eq!(grid.nearest(&[-50.0, 1.0, 1.0]), (0, 51.0 * 51.0));
        assert_eq!(grid.nearest(&[f64::NAN, 0.0, 0.0]).0, 0);
        assert!(!grid.covers(&[f64::NAN, 1.0, 1.0]));
        assert!(NearestGrid::new(&[], 0.1, 0.0, 8).is_none());
    }

    #[test]
    fn memory_is_bounded() {
        let points = [[0.0; 3], [100.0, 50.0, 25.0]];
        let grid = NearestGrid::new(&points, 1e-3, 1.0, 5000).unwrap();
        assert!(grid.n_cells() <= 5000);
        assert_eq!(grid.nearest(&[99.0, 49.0, 24.0]).0, 1);
    }
}
