//! Order-kept parallelism. The only file that names rayon.
//!
//! Why: a parallel sum in whatever order the threads finish gives different last bits from run to
//! run. Here work is cut into fixed chunks, chunks are computed in parallel, and results are joined
//! in the order of the chunks: the same bits at any number of threads.

use rayon::prelude::*;

use crate::error::{Error, Result};
use crate::progress::Progress;

/// Points per chunk: large enough to drown the cost of a task, small enough to cancel quickly.
pub(crate) const CHUNK: usize = 2048;

/// `f` of every index below `n`, in order.
pub(crate) fn map<T: Send>(n: usize, f: impl Fn(usize) -> T + Sync + Send) -> Vec<T> {
    (0..n).into_par_iter().map(f).collect()
}

/// `f` of every index below `n`, which must not matter to each other.
pub(crate) fn for_each(n: usize, f: impl Fn(usize) + Sync + Send) {
    (0..n).into_par_iter().for_each(f);
}

/// Whether `f` holds for every index below `n`.
pub(crate) fn all(n: usize, f: impl Fn(usize) -> bool + Sync + Send) -> bool {
    (0..n).into_par_iter().all(f)
}

/// `f` of every index below `n`, in order, in chunks of [`CHUNK`], giving up between chunks once
/// the caller wants to stop.
pub(crate) fn map_cheap<T: Send>(
    n: usize,
    progress: &Progress<'_>,
    f: impl Fn(usize) -> T + Sync + Send,
) -> Result<Vec<T>> {
    let chunks = chunks(n, progress, |range| range.map(&f).collect::<Vec<T>>())?;
    Ok(chunks.into_iter().flatten().collect())
}

/// One result per chunk of [`CHUNK`] indices below `n`, in order.
pub(crate) fn chunks<T: Send>(
    n: usize,
    progress: &Progress<'_>,
    f: impl Fn(std::ops::Range<usize>) -> T + Sync + Send,
) -> Result<Vec<T>> {
    (0..n.div_ceil(CHUNK))
        .into_par_iter()
        .map(|chunk| {
            progress.check()?;
            Ok(f(chunk * CHUNK..((chunk + 1) * CHUNK).min(n)))
        })
        .collect()
}

/// `f` of every chunk of [`CHUNK`] items, in order.
pub(crate) fn map_chunks<T: Sync, R: Send>(
    items: &[T],
    f: impl Fn(&[T]) -> R + Sync + Send,
) -> Vec<R> {
    items.par_chunks(CHUNK).map(f).collect()
}

/// Runs `f` on every chunk of `chunk` items of `data` (with the number of the chunk), in parallel.
pub(crate) fn for_each_chunk<T: Send>(
    data: &mut [T],
    chunk: usize,
    f: impl Fn(usize, &mut [T]) + Sync + Send,
) {
    data.par_chunks_mut(chunk)
        .enumerate()
        .for_each(|(i, part)| f(i, part));
}

/// Both results, computed side by side.
pub(crate) fn both<A: Send, B: Send>(
    a: impl FnOnce() -> A + Send,
    b: impl FnOnce() -> B + Send,
) -> (A, B) {
    rayon::join(a, b)
}

/// Sorts; elements that are equal may change places.
pub(crate) fn sort_unstable<T: Ord + Send>(items: &mut [T]) {
    items.par_sort_unstable();
}

/// How many threads share the work at this place.
pub(crate) fn n_threads() -> usize {
    rayon::current_num_threads()
}

/// Runs `work` with `n_threads` threads; `None` takes the machine's (or `RAYON_NUM_THREADS`).
///
/// # Errors
/// [`Error::InvalidArgument`] where the threads cannot be started.
pub(crate) fn with_threads<T: Send>(
    n_threads: Option<usize>,
    work: impl FnOnce() -> Result<T> + Send,
) -> Result<T> {
    match n_threads {
        None => work(),
        Some(n) => rayon::ThreadPoolBuilder::new()
            .num_threads(n)
            .build()
            .map_err(|e| Error::argument("threads", format!("= {n} cannot be started: {e}")))?
            .install(work),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sum_over_chunks_has_the_same_bits_at_any_number_of_threads() {
        let sum = |n_threads| {
            with_threads(Some(n_threads), || {
                let partial = chunks(100_000, &Progress::silent(), |range| {
                    range.map(|i| (i as f64).sin() * 1e10).sum::<f64>()
                })?;
                Ok(partial.iter().sum::<f64>())
            })
            .unwrap()
        };
        assert_eq!(sum(1).to_bits(), sum(2).to_bits());
        assert_eq!(sum(1).to_bits(), sum(4).to_bits());
    }

    #[test]
    fn the_number_of_threads_is_the_one_asked_for() {
        assert_eq!(with_threads(Some(3), || Ok(n_threads())), Ok(3));
    }

    #[test]
    fn both_results_come_back_in_their_places() {
        assert_eq!(both(|| 1 + 1, || "two"), (2, "two"));
    }

    #[test]
    fn a_long_list_is_sorted() {
        let mut items: Vec<u32> = (0..100_000_u32)
            .map(|i| i.wrapping_mul(2_654_435_761))
            .collect();
        sort_unstable(&mut items);
        assert!(items.is_sorted());
    }

    #[test]
    fn order_is_kept_and_a_stop_is_obeyed() {
        let doubled = map_cheap(5000, &Progress::silent(), |i| 2 * i).unwrap();
        assert!(doubled.iter().enumerate().all(|(i, v)| *v == 2 * i));
        let stop = |_: &crate::progress::Event| std::ops::ControlFlow::Break(());
        assert_eq!(
            map_cheap(5000, &Progress::new(&stop), |i| i),
            Err(Error::Cancelled)
        );
    }
}
