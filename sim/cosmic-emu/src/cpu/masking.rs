//! For how long a program held back interrupts, by the place where it masked them.
//!
//! Whether an interrupt came in that time makes no difference: the longest time is what any may have to wait.

use core::cell::{Cell, RefCell};
use std::collections::BTreeMap;

/// Where interrupts were masked.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub(crate) struct MaskedAt {
    /// The instruction that masked them.
    pub(crate) pc: u32,
    /// The exception that it belongs to; 0 is the thread.
    pub(crate) exception: u16,
}

/// Measures one priority of one node.
#[derive(Debug, Default)]
pub(crate) struct Masking {
    /// The priority that is watched, as NVIC has it; `None` while nobody asks.
    watched: Cell<Option<u8>>,
    since: Cell<Option<(u64, MaskedAt)>>,
    longest: RefCell<BTreeMap<MaskedAt, u64>>,
}

impl Masking {
    /// Watch interrupts of this priority. What is masked at present counts from its next change on.
    pub(crate) fn watch(&self, priority: u8) {
        self.watched.set(Some(priority));
        self.since.set(None);
        self.longest.borrow_mut().clear();
    }

    /// The priority that is watched.
    pub(crate) fn watched(&self) -> Option<u8> {
        self.watched.get()
    }

    /// The masks have changed. `ceiling` is the smallest priority that they hold back, above 255 for none.
    #[inline]
    pub(crate) fn change(&self, ceiling: u16, cycle: u64, at: MaskedAt) {
        let Some(watched) = self.watched.get() else { return };
        match (ceiling <= u16::from(watched), self.since.get()) {
            (true, None) => self.since.set(Some((cycle, at))),
            (false, Some((since, at))) => {
                self.since.set(None);
                let mut longest = self.longest.borrow_mut();
                let cycles = longest.entry(at).or_default();
                *cycles = (*cycles).max(cycle - since);
            }
            (true, Some(_)) | (false, None) => {}
        }
    }

    /// The core sleeps until `cycle`. A pending interrupt would have ended that, so it does not count.
    pub(crate) fn sleep_until(&self, cycle: u64) {
        self.since.set(self.since.get().map(|(_, at)| (cycle, at)));
    }

    /// The longest time from each place, in cycles.
    pub(crate) fn longest(&self) -> BTreeMap<MaskedAt, u64> {
        self.longest.borrow().clone()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const fn at(pc: u32) -> MaskedAt {
        MaskedAt { pc, exception: 0 }
    }

    #[test]
    fn the_longest_time_counts_for_the_place_that_masked_first() {
        let masking = Masking::default();
        masking.change(0, 5, at(1));
        masking.watch(0x90);
        // A ceiling below the watched priority holds it not back.
        masking.change(0xA0, 10, at(1));
        masking.change(0x90, 20, at(2));
        masking.change(0, 30, at(3));
        masking.change(0xA0, 50, at(3));
        masking.change(0x10, 60, at(2));
        masking.change(256, 70, at(2));
        assert_eq!(masking.longest(), [(at(2), 30)].into());
    }

    #[test]
    fn sleep_is_no_delay() {
        let masking = Masking::default();
        masking.watch(0x90);
        masking.change(0, 10, at(2));
        masking.sleep_until(500);
        masking.change(256, 520, at(2));
        assert_eq!(masking.longest(), [(at(2), 20)].into());
    }
}
