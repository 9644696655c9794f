//! Messages of several frames, put together before they leave their segment.

use std::collections::HashMap;

use cosmic_core::can::{Frame, Payload, TxNode};
use cosmic_core::event_layer::Delivered;
use cosmic_core::network::fragments::{MAX_MESSAGE_LEN, Reassembler, ReassemblyCounters};
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
        if event.content.as_slice().first().is_some_and(|header| header & FIRST != 0) {
            self.begun.insert(publisher, received_at);
        }
        let message = self.reassembler.on_frame(&Frame::new(event.id, event.content), received_at);
        let message = message.map(|message| message.content.to_vec());
        self.tell(counters);
        let began_at = self.begun.get(&publisher).copied().unwrap_or(received_at);
        Some(Leaving { content: message?, publisher, priority: event.id.priority(), began_at, received_at })
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
/// In the header of a frame: a message begins.
const FIRST: u8 = 0x80;
