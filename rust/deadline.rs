//! When a search has to hand over what it has.

use std::time::{Duration, Instant};

/// A moment after which nothing new is begun.
#[derive(Debug, Clone, Copy, Default)]
pub struct Deadline(Option<Instant>);

impl Deadline {
    /// So many seconds from now; `None` for never.
    pub fn after(seconds: Option<f64>) -> Self {
        let seconds = seconds.and_then(|s| Duration::try_from_secs_f64(s).ok());
        // A moment that the clock cannot tell is never.
        Self(seconds.and_then(|s| Instant::now().checked_add(s)))
    }

    /// Whether it has passed.
    #[inline]
    pub fn is_over(&self) -> bool {
        self.0.is_some_and(|moment| Instant::now() >= moment)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_moment_that_was_set_and_has_come_is_over() {
        assert!(!Deadline::after(None).is_over());
        assert!(!Deadline::after(Some(1e300)).is_over());
        assert!(!Deadline::after(Some(1e6)).is_over());
        assert!(Deadline::after(Some(0.0)).is_over());
    }
}
