//! Loops in the widest vector instructions of the machine. The only file that names `fearless_simd`.
//!
//! Why: a program that is to run anywhere is compiled for the oldest machines, which compute with two
//! numbers at once. Where a loop takes much of the time it is therefore compiled several times, and the
//! machine is asked once which of them it can run.
//! To know: the results are the same bits on all machines. Only numbers that do not depend on one another
//! are computed at once, and a multiplication and an addition are never joined into one.

use fearless_simd::{Level, dispatch};
pub(crate) use fearless_simd::{Simd, f64x8 as Eight, mask64x8 as Mask, prelude};

/// What `work` gives. It and all that it calls in its loops has to be marked `#[inline(always)]`: what is
/// called is compiled for the oldest machines.
#[inline(always)]
pub(crate) fn widest<R>(work: impl FnOnce() -> R) -> R {
    dispatch!(Level::new(), _ => work())
}

/// Work that is written in [`Eight`] numbers at a time, where the compiler does not find the loops that it could make
/// of it by itself. What it calls has to be marked `#[inline(always)]`.
pub(crate) trait InEights {
    type Answer;
    fn run<S: Simd>(self, machine: S) -> Self::Answer;
}

/// What `work` gives, in the widest instructions of the machine.
#[inline(always)]
pub(crate) fn in_eights<W: InEights>(work: W) -> W::Answer {
    dispatch!(Level::new(), machine => work.run(machine))
}

#[cfg(test)]
mod tests {
    use std::hint::black_box;

    use super::*;

    #[inline(always)]
    fn polynomial(x: f64) -> f64 {
        (0.3 * x - 1.7) * x * x + x / 3.0 + x.sqrt()
    }

    #[test]
    fn many_numbers_at_once_give_the_bits_that_they_give_one_by_one() {
        for n in [0, 1, 7, 8, 101] {
            let numbers: Vec<f64> = (0..n).map(|i| f64::from(i) * 0.737).collect();
            let mut found = numbers.clone();
            widest(
                #[inline(always)]
                || {
                    for x in &mut found {
                        *x = polynomial(*x);
                    }
                },
            );
            let expected: Vec<f64> = (numbers.iter())
                .map(|x| polynomial(black_box(*x)))
                .collect();
            assert_eq!(found, expected);
        }
    }
}
