//! What the interrupts of the receive FIFOs tell apart without the node: frames that concern nobody here.
//!
//! On a bus most frames are for others, and the acceptance filters of the controller may not tell them all: etags share a
//! bank where there are too few, a plan may need a mask that is wide, and not every board has filters. To hand one to
//! the event task would cost ten times as much as to receive it.

use core::sync::atomic::{AtomicU8, AtomicU32, Ordering};

use cosmic_core::can::Id;
use cosmic_core::event_half::Interest;

/// What the node is interested in, for interrupts to read, and what they have counted.
pub(crate) struct Sieve {
    etags: [AtomicU32; Interest::WORDS],
    tx_node: AtomicU8,
    foreign: AtomicU32,
}

impl Sieve {
    /// Nothing but the protocol passes, and what has TxNode 0. All zeros, so that the static that this is a part of takes no
    /// flash.
    pub(crate) const fn new() -> Self {
        let etags = [const { AtomicU32::new(0) }; Interest::WORDS];
        Self { etags, tx_node: AtomicU8::new(0), foreign: AtomicU32::new(0) }
    }

    /// A frame that comes meanwhile is taken as if it had come before, or behind.
    pub(crate) fn set(&self, interest: &Interest) {
        for (word, etags) in self.etags.iter().zip(interest.etags) {
            word.store(etags, Ordering::Relaxed);
        }
        self.tx_node.store(interest.tx_node, Ordering::Relaxed);
    }

    /// Returns whether a frame may concern the node; counts it if not.
    #[inline]
    pub(crate) fn passes(&self, id: Id) -> bool {
        let etags = |word| self.etags.get(word).map_or(0, |word: &AtomicU32| word.load(Ordering::Relaxed));
        let passes = Interest::is_covered(id, self.tx_node.load(Ordering::Relaxed), etags);
        if !passes {
            self.foreign.fetch_add(1, Ordering::Relaxed);
        }
        passes
    }

    /// How many did not pass. Wraps.
    pub(crate) fn foreign(&self) -> u32 {
        self.foreign.load(Ordering::Relaxed)
    }
}
