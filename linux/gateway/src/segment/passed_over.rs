//! Events that a gateway left to the one that leads: at a take-over, how many of them were perhaps not forwarded.

use std::collections::VecDeque;

use cosmic_core::time::Instant;

/// When the last ones were received.
#[derive(Debug, Default)]
pub(super) struct PassedOver {
    received: VecDeque<Instant>,
    /// There was no room for so many.
    more: u64,
}

impl PassedOver {
    /// One was left to the other.
    pub(super) fn note(&mut self, received_at: Instant) {
        if self.received.len() >= MOST {
            self.received.pop_front();
            self.more += 1;
        }
        self.received.push_back(received_at);
    }

    /// The other has forwarded those that were received before.
    pub(super) fn forget_before(&mut self, at: Instant) {
        self.more = 0;
        while self.received.front().is_some_and(|received| *received < at) {
            self.received.pop_front();
        }
    }

    /// Begins anew, and says how many were received since then.
    pub(super) fn take_since(&mut self, at: Instant) -> u64 {
        let since = self.received.iter().filter(|received| **received >= at).count() as u64;
        let more = std::mem::take(&mut self.more);
        self.received.clear();
        since + more
    }
}

/// More than a full bus carries in the longest time until a take-over.
const MOST: usize = 16_384;

#[cfg(test)]
mod tests {
    use super::*;
    use cosmic_core::time::Duration;

    #[test]
    fn what_was_received_since_then_is_counted() {
        let at = |number: u64| Instant::from_epoch(Duration::from_micros(number));
        let mut passed_over = PassedOver::default();
        (0..100).for_each(|number| passed_over.note(at(number)));
        passed_over.forget_before(at(50));
        assert_eq!(passed_over.take_since(at(60)), 40);
        assert_eq!(passed_over.take_since(at(0)), 0);
        (0..20_000).for_each(|number| passed_over.note(at(number)));
        assert_eq!(passed_over.take_since(at(0)), 20_000, "what did not fit is counted too");
    }
}
