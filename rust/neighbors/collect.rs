//! What a search of the tree is for: the nearest, the k nearest, all within a radius, or a count.

use super::Neighbor;

/// What a search is for.
pub(super) trait Collector {
    /// Squared distance beyond which nothing is of interest any more.
    fn reach_sq(&self) -> f64;
    /// How many of a pile of coincident points are of interest.
    fn most_of_a_pile(&self) -> usize;
    /// Takes note of a point.
    fn offer(&mut self, distance_sq: f64, index: u32);
}

pub(super) struct Nearest {
    pub(super) least_sq: f64,
    pub(super) best: Neighbor,
}

impl Collector for Nearest {
    #[inline]
    fn reach_sq(&self) -> f64 {
        self.best.distance_sq
    }

    fn most_of_a_pile(&self) -> usize {
        1
    }

    #[inline]
    fn offer(&mut self, distance_sq: f64, index: u32) {
        let neighbor = Neighbor { index, distance_sq };
        if comes_before(&neighbor, &self.best) && distance_sq >= self.least_sq {
            self.best = neighbor;
        }
    }
}

pub(super) struct KNearest<'a> {
    pub(super) k: usize,
    /// By rising distance, then index.
    pub(super) found: &'a mut Vec<Neighbor>,
}

impl Collector for KNearest<'_> {
    #[inline]
    fn reach_sq(&self) -> f64 {
        if self.found.len() < self.k {
            f64::INFINITY
        } else {
            self.found.last().map_or(-1.0, |last| last.distance_sq)
        }
    }

    fn most_of_a_pile(&self) -> usize {
        self.k
    }

    #[inline]
    fn offer(&mut self, distance_sq: f64, index: u32) {
        if distance_sq > self.reach_sq() {
            return;
        }
        let neighbor = Neighbor { index, distance_sq };
        if self.found.len() < self.k {
            self.found.push(neighbor);
        }
        // Moves up those that come after; of a full list, the last one out.
        let mut at = self.found.len() - 1;
        while at > 0 && comes_before(&neighbor, &self.found[at - 1]) {
            self.found[at] = self.found[at - 1];
            at -= 1;
        }
        if comes_before(&neighbor, &self.found[at]) {
            self.found[at] = neighbor;
        }
    }
}

pub(super) struct Within<'a> {
    pub(super) radius_sq: f64,
    pub(super) found: &'a mut Vec<Neighbor>,
}

impl Collector for Within<'_> {
    #[inline]
    fn reach_sq(&self) -> f64 {
        self.radius_sq
    }

    fn most_of_a_pile(&self) -> usize {
        usize::MAX
    }

    #[inline]
    fn offer(&mut self, distance_sq: f64, index: u32) {
        if distance_sq <= self.radius_sq {
            self.found.push(Neighbor { index, distance_sq });
        }
    }
}

pub(super) struct Count {
    pub(super) radius_sq: f64,
    pub(super) n_left: usize,
}

impl Collector for Count {
    #[inline]
    fn reach_sq(&self) -> f64 {
        if self.n_left > 0 {
            self.radius_sq
        } else {
            -1.0
        }
    }

    fn most_of_a_pile(&self) -> usize {
        self.n_left
    }

    #[inline]
    fn offer(&mut self, distance_sq: f64, _index: u32) {
        if distance_sq <= self.reach_sq() {
            self.n_left -= 1;
        }
    }
}

/// The order of answers: by rising distance, then index.
#[inline]
fn comes_before(a: &Neighbor, b: &Neighbor) -> bool {
    a.distance_sq < b.distance_sq || (a.distance_sq == b.distance_sq && a.index < b.index)
}
