//! How squared distances are distributed, and what follows: the share of the source that the target
//! knows, and how far apart pairs usually are.
//!
//! Source: fractional root mean squared distance (Phillips, Liu & Tomasi 2007) for the share.
//! Deviates: counted in classes of size, 16 to each doubling, instead of sorting.

/// Doublings that are told apart below the largest size.
const DOUBLINGS: usize = 40;
/// A class for each of the first four bits after the leading one.
const CLASSES_PER_DOUBLING: usize = 16;
const SHIFT: u32 = 48;
/// Class of the largest size.
const TOP: u64 = 1.0_f64.to_bits() >> SHIFT;

/// Counts of squared distances by size; what is smaller than the smallest class counts there.
#[derive(Debug, Clone)]
pub(super) struct Sizes {
    counts: Vec<u32>,
    /// Sizes are counted as shares of it, whatever the clouds' unit.
    largest: f64,
}

impl Sizes {
    /// None counted yet; `largest` should bound what will be.
    pub(super) fn up_to(largest: f64) -> Self {
        Self {
            counts: vec![0; DOUBLINGS * CLASSES_PER_DOUBLING],
            largest: largest.max(f64::MIN_POSITIVE),
        }
    }

    /// Counts one squared distance (not negative, not NaN).
    #[inline]
    pub(super) fn add(&mut self, distance_sq: f64) {
        let share = distance_sq / self.largest;
        let below = TOP.saturating_sub(share.to_bits() >> SHIFT) as usize;
        let last = self.counts.len() - 1;
        self.counts[last - below.min(last)] += 1;
    }

    pub(super) fn merge(&mut self, other: &Self) {
        for (count, more) in self.counts.iter_mut().zip(&other.counts) {
            *count += more;
        }
    }

    /// The upper end of a class.
    fn end(&self, class: usize) -> f64 {
        let below = (self.counts.len() - 1 - class) as u64;
        self.largest * f64::from_bits((TOP + 1).saturating_sub(below) << SHIFT)
    }

    fn middle(&self, class: usize) -> f64 {
        // Half a class below its end.
        self.end(class) / 2_f64.powf(0.5 / CLASSES_PER_DOUBLING as f64)
    }

    /// The median, to two per cent; `None` of nothing.
    pub(super) fn median(&self) -> Option<f64> {
        let n: u64 = self.counts.iter().map(|count| u64::from(*count)).sum();
        let mut below = 0;
        for (class, count) in self.counts.iter().enumerate() {
            below += u64::from(*count);
            if n > 0 && 2 * below >= n {
                return Some(self.middle(class));
            }
        }
        None
    }

    /// The limit up to which pairs count where `n_all` points have one if the target knows their
    /// place: the one with the least RMSD / shareᵉ.
    ///
    /// A small share lies closer, a large one says more. At the least value the farthest pair is
    /// √(1 + 2e) times as far apart as all are in the root mean square.
    pub(super) fn limit_of_overlap(&self, n_all: usize) -> f64 {
        /// Above 1, lest noise whose density is greatest at 0 be trimmed to nothing; 2 keeps 97 % of
        /// normally distributed distances, and rejects what is 2.2 times as far as the rest.
        const EXPONENT: f64 = 2.0;
        /// Fewer points are no overlap, however close they lie.
        const LEAST_SHARE: f64 = 0.05;
        let (mut sum, mut n) = (0.0, 0.0);
        let (mut best, mut limit) = (f64::INFINITY, f64::MAX);
        for (class, count) in self.counts.iter().enumerate() {
            if *count == 0 {
                continue;
            }
            n += f64::from(*count);
            sum += f64::from(*count) * self.middle(class);
            let share = n / n_all as f64;
            let fractional = sum / n / share.powf(2.0 * EXPONENT);
            if share >= LEAST_SHARE && fractional <= best {
                (best, limit) = (fractional, self.end(class));
            }
        }
        limit
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Stream;

    #[test]
    fn the_median_is_that_of_a_sorted_list() {
        let mut stream = Stream::new(1, "sizes", 0);
        let mut list: Vec<f64> = (0..1001).map(|_| stream.normal().powi(2)).collect();
        let (mut even, mut odd) = (Sizes::up_to(20.0), Sizes::up_to(20.0));
        for (i, v) in list.iter().enumerate() {
            if i % 2 == 0 {
                even.add(*v)
            } else {
                odd.add(*v)
            }
        }
        even.merge(&odd);
        list.sort_by(f64::total_cmp);
        let median = even.median().unwrap();
        assert!(
            (median / list[500] - 1.0).abs() < 0.06,
            "{median} {}",
            list[500]
        );
        assert_eq!(Sizes::up_to(1.0).median(), None);
    }

    #[test]
    fn sizes_beyond_both_ends_are_counted_at_the_ends() {
        let mut sizes = Sizes::up_to(1.0);
        [0.0, 1e-300, 1e-200].iter().for_each(|v| sizes.add(*v));
        [5.0, f64::MAX].iter().for_each(|v| sizes.add(*v));
        assert!(sizes.median().unwrap() < 1e-11);
        assert_eq!(sizes.counts.iter().sum::<u32>(), 5);
        assert!(sizes.end(sizes.counts.len() - 1) > 1.0);
    }

    #[test]
    fn the_overlap_ends_where_distances_jump() {
        // 600 of 1000 points lie within 0.1 of their partners, the rest anywhere up to 10.
        let mut stream = Stream::new(2, "sizes", 0);
        let mut sizes = Sizes::up_to(100.0);
        for i in 0..1000 {
            let reach = if i < 600 { 0.1 } else { 10.0 };
            sizes.add((reach * stream.uniform()).powi(2));
        }
        let limit = sizes.limit_of_overlap(1000).sqrt();
        assert!((0.09..0.2).contains(&limit), "{limit}");
        // All alike: all count.
        let mut alike = Sizes::up_to(100.0);
        (0..500).for_each(|_| alike.add(0.01));
        assert!(alike.limit_of_overlap(1000) > 0.01);
    }
}
