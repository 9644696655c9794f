//! The last exceptions, in memory that outlives a reset.
//!
//! What led to a reset is lost with it, unless it lies where the start does not clear: [`Kept`] stands in a section that
//! nobody initialises, as the board's crate provides. After the power was off there is anything in it, and a reset may
//! come while it is written, so each entry has a check of its own, and one that does not pass is none.

use core::cell::UnsafeCell;
use core::mem::MaybeUninit;

use cosmic_core::Subject;
use cosmic_core::event_layer::{Exception, ExceptionKind};
use cosmic_core::time::{Duration, Instant};

use crate::observer::{Observer, Observes};

/// Room for the last [`KEPT`] exceptions. A static in memory that is not initialised; its owner is [`Memory`].
pub struct Kept(UnsafeCell<MaybeUninit<[Entry; KEPT]>>);

// SAFETY: the content is reached through a `Memory` only, and the board's crate hands out one.
unsafe impl Sync for Kept {}

impl Kept {
    /// Whatever is in memory.
    pub const fn uninitialised() -> Self {
        Self(UnsafeCell::new(MaybeUninit::uninit()))
    }
}

/// The exceptions that were [kept](Kept), and those that will be: an [`Observer`] that keeps each exception the
/// application is told of.
pub struct Memory {
    entries: &'static mut [Entry; KEPT],
    next: u32,
}

impl Memory {
    /// Takes over what was kept before.
    ///
    /// # Safety
    /// Nobody else does: it is called once. To be of use, the static stands in a section that the start leaves alone.
    pub unsafe fn new(kept: &'static Kept) -> Self {
        let place: *mut [Entry; KEPT] = kept.0.get().cast();
        // SAFETY: the caller promises that nobody else has a reference. What is read volatile is what lies there, which
        // the compiler must not think it knows, and all patterns of bits are words.
        let entries = unsafe {
            place.write(place.read_volatile());
            &mut *place
        };
        Self { entries, next: 0 }
    }

    /// Calls `tell` with each exception that was kept before the reset, the oldest first, and forgets them.
    pub fn recover(&mut self, mut tell: impl FnMut(Exception)) {
        // At most eight times eight looks.
        let mut after = None;
        while let Some(number) = self.numbers().filter(|number| after.is_none_or(|last| *number > last)).min()
        {
            after = Some(number);
            let exception = self.entries.iter().find(|entry| entry.number() == Some(number));
            if let Some(exception) = exception.and_then(Entry::exception) {
                tell(exception);
            }
        }
        self.clear();
    }

    /// Forgets what was kept, as after the power was off.
    pub fn clear(&mut self) {
        *self.entries = [const { Entry::NONE }; KEPT];
        self.next = 0;
    }

    fn numbers(&self) -> impl Iterator<Item = u32> {
        self.entries.iter().filter_map(Entry::number)
    }

    fn keep(&mut self, exception: &Exception) {
        if let Some(entry) = self.entries.get_mut(self.next as usize % KEPT) {
            *entry = Entry::new(self.next, exception);
            self.next = self.next.wrapping_add(1);
        }
    }
}

impl Observer for Memory {
    type Calendar = ();

    fn exception(&mut self, exception: &Exception) {
        self.keep(exception);
    }
}

impl<C> Observes<C> for Memory {}

/// An exception as words: its number, its kind and whether there is a subject, subject, instant, and a check of these.
#[derive(Clone, Copy, Debug)]
struct Entry([u32; WORDS]);

impl Entry {
    /// Its check is wrong.
    const NONE: Self = Self([0; WORDS]);

    fn new(number: u32, exception: &Exception) -> Self {
        let (subject, at) = (exception.subject, exception.at.since_epoch().as_ticks());
        let kind = exception.kind as u32 | if subject.is_some() { HAS_SUBJECT } else { 0 };
        let subject = subject.map_or(0, Subject::get);
        let mut words =
            [number, kind, subject as u32, (subject >> 32) as u32, at as u32, (at >> 32) as u32, 0];
        words[WORDS - 1] = check(&words);
        Self(words)
    }

    /// Its number, if it passes its check.
    fn number(&self) -> Option<u32> {
        (self.0[WORDS - 1] == check(&self.0)).then_some(self.0[0])
    }

    fn exception(&self) -> Option<Exception> {
        let [_, kind, subject_low, subject_high, at_low, at_high, _] = self.0;
        let long = |low: u32, high: u32| u64::from(high) << 32 | u64::from(low);
        let subject = match kind & HAS_SUBJECT {
            0 => None,
            _ => Some(Subject::new(long(subject_low, subject_high))?),
        };
        let kind = *ExceptionKind::ALL.get((kind & !HAS_SUBJECT) as usize)?;
        let at = Instant::from_epoch(Duration::from_ticks(long(at_low, at_high)));
        Some(Exception { subject, kind, at })
    }
}

/// Of all words but the last (FNV-1a, by words). Not zero for zeros.
fn check(words: &[u32; WORDS]) -> u32 {
    words[..WORDS - 1].iter().fold(0x811C_9DC5, |hash: u32, word| (hash ^ word).wrapping_mul(0x0100_0193))
}

/// Exceptions that are kept.
pub const KEPT: usize = 8;
const WORDS: usize = 7;
const HAS_SUBJECT: u32 = 1 << 31;

#[cfg(test)]
mod tests {
    use super::*;
    use std::boxed::Box;
    use std::vec::Vec;

    fn exception(n: u64) -> Exception {
        let kind = ExceptionKind::ALL[n as usize % ExceptionKind::COUNT];
        Exception {
            subject: Subject::new(n * 0x1_0000_0001),
            kind,
            at: Instant::from_epoch(Duration::from_ticks(n << 33)),
        }
    }

    /// Memory with anything in it.
    fn memory(words: [Entry; KEPT]) -> Memory {
        Memory { entries: Box::leak(Box::new(words)), next: 0 }
    }

    /// What is told after a reset.
    fn recovered(memory: &mut Memory) -> Vec<Exception> {
        let mut told = Vec::new();
        memory.recover(|exception| told.push(exception));
        told
    }

    #[test]
    fn the_last_are_told_once_in_their_order() {
        for count in 0..20 {
            let mut memory = memory([Entry([0x5A5A_5A5A; WORDS]); KEPT]);
            (0..count).for_each(|n| memory.exception(&exception(n)));
            let expected: Vec<_> = (count.saturating_sub(8)..count).map(exception).collect();
            assert_eq!(recovered(&mut memory), expected, "{count}");
            assert_eq!(recovered(&mut memory), []);
        }
    }

    #[test]
    fn an_entry_that_a_reset_caught_half_written_is_none() {
        for word in 0..WORDS {
            let mut memory = memory([Entry::NONE; KEPT]);
            (1..4).for_each(|n| memory.exception(&exception(n)));
            memory.entries[1].0[word] ^= 1 << 7;
            assert_eq!(recovered(&mut memory), [exception(1), exception(3)], "{word}");
        }
    }

    #[test]
    fn memory_as_it_is_after_power_on_tells_nothing() {
        for word in [0, u32::MAX, 0xAAAA_AAAA] {
            assert_eq!(recovered(&mut memory([Entry([word; WORDS]); KEPT])), []);
        }
    }
}
