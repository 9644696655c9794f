//! Messages longer than a frame, on a non real-time channel.
//!
//! The channel is declared with [`Payload`] as its content. The publisher wraps its publication in a
//! [`MessagePublisher`], each subscriber its subscription in a [`MessageSubscriber`]; the header that
//! they put before each fragment is that of [`crate::network::fragments`]. Only one fragment at a time
//! is in the node's queue, so a long message does not keep other events waiting. A message arrives whole or
//! not at all, and what is dropped is counted.
//!
//! ```
//! use cosmic_core::Subject;
//! use cosmic_core::can::{Etag, Payload};
//! use cosmic_core::event_layer::{Channel, Importance, NonRealTimeAttributes};
//!
//! const LOGBOOK: Channel<Payload> = Channel::non_real_time(
//!     Subject::new(0xC05A_1C00_0000_0005).unwrap(),
//!     NonRealTimeAttributes { importance: Importance::LEAST, validity: None },
//! );
//! ```

use super::{Delivered, Publication, Subscription};
use crate::can::{Etag, Frame, Id, Payload, Priority};
use crate::network::fragments::{Fragmenter, Message, Reassembler, ReassemblyCounters, StartError};
use crate::time::{Duration, Instant};

/// The sending side of a channel of messages of up to `LEN` bytes.
#[derive(Debug)]
pub struct MessagePublisher<const LEN: usize> {
    publication: Publication<Payload>,
    fragmenter: Fragmenter<LEN>,
    /// What the channel had sent and discarded when the fragment that is out was published.
    seen: (u32, u32),
}

impl<const LEN: usize> MessagePublisher<LEN> {
    /// A sender of messages. Nothing else may be published with this publication.
    pub const fn new(publication: Publication<Payload>) -> Self {
        Self { publication, fragmenter: Fragmenter::new(), seen: (0, 0) }
    }

    /// Takes a copy of a message; then call [`send_message`](crate::EventHalf::send_message).
    ///
    /// # Errors
    /// If it is too long, or the one before it is not yet sent. Then nothing has changed.
    pub fn start(&mut self, content: &[u8]) -> Result<(), StartError> {
        self.fragmenter.start(content)
    }

    /// Returns whether everything has been sent.
    pub fn is_idle(&self) -> bool {
        self.fragmenter.is_idle()
    }

    pub(crate) const fn publication(&self) -> &Publication<Payload> {
        &self.publication
    }

    /// The fragment that is out has left the node if the counters of the channel have changed.
    pub(crate) fn note_departures(&mut self, sent: u32, discarded: u32) {
        if discarded != self.seen.1 {
            self.fragmenter.on_discarded();
        } else if sent != self.seen.0 {
            self.fragmenter.on_sent();
        }
        self.seen = (sent, discarded);
    }

    pub(crate) fn next(&mut self) -> Option<Payload> {
        self.fragmenter.poll()
    }

    pub(crate) fn give_up(&mut self) {
        self.fragmenter.on_discarded();
    }
}

/// The receiving side of a channel of messages of up to `LEN` bytes, from up to `PLACES` publishers at once.
#[derive(Debug)]
pub struct MessageSubscriber<const PLACES: usize, const LEN: usize> {
    subscription: Subscription<Payload>,
    reassembler: Reassembler<PLACES, LEN>,
}

impl<const PLACES: usize, const LEN: usize> MessageSubscriber<PLACES, LEN> {
    /// A receiver of messages; one that stops is dropped after `time_out`. The subscription is first in,
    /// first out, and deep enough for what arrives between two calls of
    /// [`receive_messages`](crate::EventHalf::receive_messages).
    pub fn new(subscription: Subscription<Payload>, time_out: Duration) -> Self {
        Self { subscription, reassembler: Reassembler::new(time_out) }
    }

    /// What was delivered and dropped.
    pub const fn counters(&self) -> &ReassemblyCounters {
        self.reassembler.counters()
    }

    /// When [`receive_messages`](crate::EventHalf::receive_messages) has a message to drop of which nothing came
    /// any more, if no frame comes before. Calls may be early or late.
    pub fn next_wakeup(&self) -> Instant {
        self.reassembler.next_wakeup()
    }

    pub(crate) const fn subscription(&self) -> &Subscription<Payload> {
        &self.subscription
    }

    pub(crate) fn take(&mut self, etag: Etag, fragment: &Delivered<Payload>) -> Option<Message<'_>> {
        // The reassembly tells messages apart by etag and TxNode; the priority plays no part.
        let id = Id::new(Priority::LEAST, fragment.publisher, etag);
        self.reassembler.on_frame(&Frame::new(id, fragment.content), fragment.received_at)
    }

    pub(crate) fn drop_stale(&mut self, now: Instant) {
        self.reassembler.on_time(now);
    }
}
