//! The value of a rank among many, side by side.
//!
//! Why: medians and quantiles of every point of a cloud are wanted at several places; selecting in place needs a copy of
//! all and one thread.
//! Source: Floyd & Rivest (1975): a sample brackets the value, one pass counts what lies below and keeps what lies within.
//! Deviates: the sample is evenly strided, the same each time.

use crate::parallel;

/// Fewer values are selected among at once.
const MANY: usize = 16_384;
/// Values of the sample.
const N_SAMPLED: usize = 1024;
/// How many values of the sample the bracket reaches to either side: four standard deviations of the rank in it.
const REACH: usize = 64;

/// The value of `rank`, from 0 for the smallest, among `value(i)` of all `i` below `n`, none of them NaN.
///
/// # Panics
/// Where there are no more than `rank`.
pub(crate) fn nth_smallest(
    n: usize,
    rank: usize,
    value: impl Fn(usize) -> f64 + Sync + Send,
) -> f64 {
    assert!(rank < n, "rank {rank} among {n}");
    if n >= MANY
        && let Some(found) = nth_within_bracket(n, rank, &value)
    {
        return found;
    }
    select(&mut parallel::map(n, value), rank)
}

/// The same, unless the sample misleads.
fn nth_within_bracket(
    n: usize,
    rank: usize,
    value: &(impl Fn(usize) -> f64 + Sync + Send),
) -> Option<f64> {
    let mut sample: Vec<f64> = (0..N_SAMPLED).map(|at| value(at * n / N_SAMPLED)).collect();
    sample.sort_unstable_by(f64::total_cmp);
    let at = rank * N_SAMPLED / n;
    let low = at
        .checked_sub(REACH)
        .map_or(f64::NEG_INFINITY, |at| sample[at]);
    let high = sample.get(at + REACH).copied().unwrap_or(f64::INFINITY);
    let chunks = parallel::map(n.div_ceil(parallel::CHUNK), |chunk| {
        let (mut n_below, mut within) = (0, Vec::new());
        for i in chunk * parallel::CHUNK..n.min((chunk + 1) * parallel::CHUNK) {
            let value = value(i);
            if value < low {
                n_below += 1;
            } else if value <= high {
                within.push(value);
            }
        }
        (n_below, within)
    });
    let n_below: usize = chunks.iter().map(|(n_below, _)| n_below).sum();
    let mut within: Vec<f64> = chunks.into_iter().flat_map(|(_, within)| within).collect();
    let rank = rank.checked_sub(n_below)?;
    (rank < within.len()).then(|| select(&mut within, rank))
}

fn select(values: &mut [f64], rank: usize) -> f64 {
    *values.select_nth_unstable_by(rank, f64::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Stream;

    #[test]
    fn it_is_what_sorting_says() {
        let mut stream = Stream::new(1, "rank", 0);
        let by_chance: Vec<f64> = (0..50_021).map(|_| stream.normal().powi(3)).collect();
        let rising: Vec<f64> = (0..50_021).map(f64::from).collect();
        let few_kinds: Vec<f64> = by_chance.iter().map(|v| v.round()).collect();
        // Every sampled value is 0, though hardly any is: the sample misleads.
        let sampled: std::collections::BTreeSet<usize> = (0..N_SAMPLED)
            .map(|at| at * rising.len() / N_SAMPLED)
            .collect();
        let misleading: Vec<f64> = (rising.iter().enumerate())
            .map(|(i, v)| if sampled.contains(&i) { 0.0 } else { *v })
            .collect();
        for values in [
            &by_chance,
            &rising,
            &few_kinds,
            &misleading,
            &by_chance[..99].to_vec(),
        ] {
            let mut sorted = values.clone();
            sorted.sort_by(f64::total_cmp);
            let n = values.len();
            for rank in [0, 1, n / 7, n / 2, n * 199 / 200, n - 1] {
                assert_eq!(nth_smallest(n, rank, |i| values[i]), sorted[rank]);
            }
        }
    }
}
