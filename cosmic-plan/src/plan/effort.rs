//! How much work is put into a plan.
//!
//! Work is counted in steps, not in seconds: the same cluster gets the same answer on every machine, however fast or
//! busy it is. A step is about a nanosecond on a computer of 2024. One budget is for everything: search, the reasons
//! why nothing was found, and the ways out.

use std::cell::Cell;
use std::fmt;

/// A budget of steps, and who is told what it is spent on.
#[derive(Clone)]
pub struct Effort<'a> {
    left: Cell<u64>,
    watch: Option<&'a dyn Fn(&str)>,
}

impl Default for Effort<'_> {
    fn default() -> Self {
        Self::of(USUAL)
    }
}

impl fmt::Debug for Effort<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Effort").field("left", &self.left).finish_non_exhaustive()
    }
}

impl<'a> Effort<'a> {
    /// So many steps.
    pub const fn of(steps: u64) -> Self {
        Self { left: Cell::new(steps), watch: None }
    }

    /// As many as [`Effort::default`]; `watch` is called now and then with what is being done, for a progress bar.
    pub fn watched(watch: &'a dyn Fn(&str)) -> Self {
        Self { watch: Some(watch), ..Self::default() }
    }

    /// How many steps are left.
    pub fn left(&self) -> u64 {
        self.left.get()
    }

    /// Spends steps. Returns whether some are left.
    pub(crate) fn spend(&self, steps: u64) -> bool {
        self.left.set(self.left.get().saturating_sub(steps));
        self.left.get() > 0
    }

    /// Runs something with a part of the steps: at most so many.
    pub(crate) fn within<T>(&self, most: u64, run: impl FnOnce(&Effort<'_>) -> T) -> T {
        let given = self.left.get().min(most);
        let part = Effort { left: Cell::new(given), watch: self.watch };
        let result = run(&part);
        self.spend(given - part.left());
        result
    }

    /// Tells what is being done.
    pub(crate) fn report(&self, what: &str) {
        if let Some(watch) = self.watch {
            watch(what);
        }
    }
}

/// Some ten seconds.
const USUAL: u64 = 12_000_000_000;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_part_is_taken_from_the_whole() {
        let effort = Effort::of(100);
        assert!(effort.spend(10));
        assert!(effort.within(50, |part| part.spend(20)));
        assert_eq!(effort.left(), 70);
        assert!(!effort.within(50, |part| part.spend(60)));
        assert_eq!(effort.left(), 20);
        assert!(!effort.within(50, |part| part.spend(20)));
        assert_eq!(effort.left(), 0);
        assert!(!effort.spend(0));
    }
}
