//! Messages of several frames, put together before they leave their segment.

use std::collections::HashMap;

use cosmic_core::can::{Frame, Payload, TxNode};
use cosmic_core::event_layer::Delivered;
use cosmic_core::network::fragments::{MAX_MESSAGE_LEN, Reassembler, ReassemblyCounters, begins};
use cosmic_core::time::{Duration, Instant};

use crate::counters::{Counters, Outcome};
use crate::segment::Leaving;

/// The messages of one channel on one segment that are on their way: some ten kilobytes, however many publish.
pub(super) struct Assembly {
    reassembler: Box<Reassembler<PLACES, MAX_MESSAGE_LEN>>,
    /// When the message of a publisher that is on its way began.
    begun: HashMap<TxNode, Instant>,
    told: ReassemblyCounters,
}

impl Assembly {
    pub(super) fn new() -> Self {
        Self {
            reassembler: Box::new(Reassembler::new(TIME_OUT)),
            begun: HashMap::new(),
            told: ReassemblyCounters::default(),
        }
    }

    /// A frame of the channel has come. Returns the message that it completes; counts what was given up.
    pub(super) fn on_frame(&mut self, event: &Delivered<Payload>, counters: &Counters) -> Option<Leaving> {
        let (publisher, received_at) = (event.publisher, event.received_at);
        // One entry for each publisher: there are no more of them than identifiers have room for.
        if begins(&event.content) {
            self.begun.insert(publisher, received_at);
        }
        let message = self.reassembler.on_frame(&Frame::new(event.id, event.content), received_at);
        let message = message.map(|message| message.content.to_vec());
        self.tell(counters);
        let began_at = self.begun.get(&publisher).copied().unwrap_or(received_at);
        Some(Leaving { content: message?, publisher, priority: event.id.priority(), began_at, received_at })
    }

    /// Time has passed: counts what is given up of which nothing more came.
    pub(super) fn on_time(&mut self, now: Instant, counters: &Counters) {
        self.reassembler.on_time(now);
        self.tell(counters);
    }

    fn tell(&mut self, counters: &Counters) {
        let (now, before) = (*self.reassembler.counters(), self.told);
        self.told = now;
        let since =
            |count: fn(&ReassemblyCounters) -> u32| u64::from(count(&now).saturating_sub(count(&before)));
        counters.count_many(Outcome::Incomplete, since(|it| it.incomplete.saturating_add(it.timed_out)));
        counters.count_many(Outcome::Incomplete, since(|it| it.corrupt.saturating_add(it.no_room)));
        counters.count_many(Outcome::TooLong, since(|it| it.too_long));
        counters.count_many(Outcome::StrayFrame, since(|it| it.orphans.saturating_add(it.malformed)));
    }
}

/// So many publishers may be in the midst of a message at once.
const PLACES: usize = 8;
/// A message of which nothing has come for so long is given up, as a node does.
const TIME_OUT: Duration = Duration::from_secs(2);

#[cfg(test)]
mod tests {
    use cosmic_core::can::{Etag, Id, Priority};
    use cosmic_core::event_layer::Context;

    use super::*;
    use crate::counters::{Direction, Metrics};
    use crate::keys::Name;

    #[test]
    fn a_message_whose_end_does_not_come_is_counted_though_nothing_comes_behind() {
        let counters = Metrics::default().of(&Name::new("west").unwrap(), Direction::Out);
        let mut assembly = Assembly::new();
        let at = |milliseconds| Instant::from_epoch(Duration::from_millis(milliseconds));
        let publisher = TxNode::new(1).unwrap();
        let id = Id::new(Priority::LEAST, publisher, Etag::BOUND_LAST);
        // The first of several.
        let content = Payload::new(&[0x80, 1, 2, 3, 4, 5, 6, 7]).unwrap();
        let first = Delivered { content, context: Context::EMPTY, publisher, id, received_at: at(0) };
        assert!(assembly.on_frame(&first, &counters).is_none());
        assembly.on_time(at(1_999), &counters);
        assert_eq!(counters.get(Outcome::Incomplete), 0);
        assembly.on_time(at(2_001), &counters);
        assert_eq!(counters.get(Outcome::Incomplete), 1);
    }
}
