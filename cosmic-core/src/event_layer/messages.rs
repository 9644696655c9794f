//! Messages longer than a frame, on a non real-time channel.
//!
//! A [`MessageChannel`] says what its messages are: any [`Content`] of up to 1024 bytes. Its
//! [fragments](MessageChannel::fragments) are a channel as any other, which is announced and subscribed to. The
//! publisher wraps its publication in a [`MessagePublisher`], each subscriber its subscription in a
//! [`MessageSubscriber`]; the header that they put before each fragment is that of
//! [`crate::network::fragments`]. Only one fragment at a time is in the node's queue, so a long message does not
//! keep other events waiting. A message arrives whole or not at all, and what is dropped is counted.
//!
//! ```
//! use cosmic_core::Subject;
//! use cosmic_core::event_layer::{Bytes, Importance, MessageChannel, NonRealTimeAttributes};
//!
//! /// Lines of up to 80 bytes, from one publisher at a time.
//! const LOGBOOK: MessageChannel<Bytes<80>, 80, 1> = MessageChannel::new(
//!     Subject::new(0xC05A_1C00_0000_0005).unwrap(),
//!     NonRealTimeAttributes { importance: Importance::LEAST, validity: None },
//! );
//! ```

use super::{Channel, Content, Delivered, EventRate, NonRealTimeAttributes, Publication, Subscription};
use crate::can::{Etag, Frame, Id, Payload, Priority};
use crate::network::fragments::{
    Fragmenter, MAX_MESSAGE_LEN, Message, Reassembler, ReassemblyCounters, StartError,
};
use crate::protocol::LayoutHash;
use crate::time::{Duration, Instant};
use crate::uid::Subject;
use core::marker::PhantomData;

/// A channel of messages with content `C` of up to `LEN` bytes, from up to `PUBLISHERS` nodes at once.
#[derive(Debug)]
pub struct MessageChannel<C, const LEN: usize, const PUBLISHERS: usize> {
    fragments: Channel<Payload>,
    content: PhantomData<fn() -> C>,
}

impl<C, const LEN: usize, const PUBLISHERS: usize> Clone for MessageChannel<C, LEN, PUBLISHERS> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<C, const LEN: usize, const PUBLISHERS: usize> Copy for MessageChannel<C, LEN, PUBLISHERS> {}

impl<C: Content, const LEN: usize, const PUBLISHERS: usize> MessageChannel<C, LEN, PUBLISHERS> {
    /// A channel of messages. The broker gives its etag.
    pub const fn new(subject: Subject, attributes: NonRealTimeAttributes) -> Self {
        const { assert!(LEN <= MAX_MESSAGE_LEN, "a message has at most 1024 bytes") };
        const { assert!(C::LEN <= LEN, "the content is longer than a message of this channel") };
        const { assert!(PUBLISHERS > 0, "somebody publishes") };
        let fragments = Channel::non_real_time(subject, attributes).in_pieces_of(C::LAYOUT);
        Self { fragments, content: PhantomData }
    }

    /// The channel with a fixed etag, for a cluster that has no broker.
    pub const fn with_etag(self, etag: Etag) -> Self {
        Self { fragments: self.fragments.with_etag(etag), ..self }
    }

    /// As [`Channel::with_layout`].
    pub const fn with_layout(self, layout: LayoutHash) -> Self {
        Self { fragments: self.fragments.with_layout(layout), ..self }
    }

    /// As [`Channel::with_rate`]; a message counts as one event, however many frames it has.
    pub const fn with_rate(self, rate: EventRate) -> Self {
        Self { fragments: self.fragments.with_rate(rate), ..self }
    }

    /// The channel as its frames are published: each carries a piece of a message.
    pub const fn fragments(&self) -> &Channel<Payload> {
        &self.fragments
    }

    /// Its subject.
    pub const fn subject(&self) -> Subject {
        self.fragments.subject()
    }
}

/// The sending side of a channel of messages of up to `LEN` bytes.
#[derive(Debug)]
pub struct MessagePublisher<const LEN: usize> {
    publication: Publication<Payload>,
    fragmenter: Fragmenter<LEN>,
    /// What the channel had sent and discarded when the fragment that is out was published.
    seen: (u32, u32),
    /// How many fragments there were, and the last one.
    given: (u32, Payload),
}

impl<const LEN: usize> MessagePublisher<LEN> {
    /// A sender of messages. Nothing else may be published with this publication.
    pub const fn new(publication: Publication<Payload>) -> Self {
        Self { publication, fragmenter: Fragmenter::new(), seen: (0, 0), given: (0, Payload::EMPTY) }
    }

    /// Takes a copy of a message; then call [`send_message`](crate::EventHalf::send_message).
    ///
    /// # Errors
    /// If it is too long, or the one before it is not yet sent. Then nothing has changed.
    pub fn start(&mut self, content: &[u8]) -> Result<(), StartError> {
        self.fragmenter.start(content)
    }

    /// As [`start`](Self::start), with the bytes of a content.
    ///
    /// # Errors
    /// As there.
    pub fn start_content<C: Content>(&mut self, content: &C) -> Result<(), StartError> {
        self.fragmenter.start_with(C::LEN, |bytes| {
            content.encode(bytes);
            content.encoded_len()
        })
    }

    /// Messages of which a frame was discarded, so that nobody received them.
    pub const fn discarded(&self) -> u32 {
        self.fragmenter.discarded()
    }

    /// Gives the publication back, to be cancelled. What is under way is not sent to its end.
    pub fn into_publication(self) -> Publication<Payload> {
        self.publication
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

    /// Returns whether the next frame is the first of its message.
    pub(crate) fn is_at_first(&self) -> bool {
        self.fragmenter.is_at_first()
    }

    /// How many fragments were published so far, which wraps, and the last one.
    pub const fn last_fragment(&self) -> (u32, Payload) {
        self.given
    }

    pub(crate) fn next(&mut self) -> Option<Payload> {
        let fragment = self.fragmenter.poll()?;
        self.given = (self.given.0.wrapping_add(1), fragment);
        Some(fragment)
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

    /// Gives the subscription back, to be cancelled.
    pub fn into_subscription(self) -> Subscription<Payload> {
        self.subscription
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
