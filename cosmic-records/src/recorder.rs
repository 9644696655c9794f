//! The observer who writes the records.

use core::marker::PhantomData;

use cosmic_core::Subject;
use cosmic_core::can::Payload;
use cosmic_core::event_layer::{Content, Delivered, Exception, Filter, Policy, PublishError};
use cosmic_core::plan::ChannelPlan;
use cosmic_core::time::Instant;
use cosmic_rtic::{CalendarObserver, Observer, Observes};

use crate::record::{Digest, Queue, Record, RecordKind};

/// Where records go.
pub trait Sink: 'static {
    /// Takes a record whole or not at all, at once. Returns whether it did.
    fn write(&mut self, record: &[u8; Record::LEN]) -> bool;
}

/// Writes a record of everything that happens to events at its node. `C` watches the calendar task.
///
/// Work per call: the bytes of a content once, and a search among the channels of the plan.
pub struct Recorder<S, C = ()> {
    sink: S,
    channels: &'static [ChannelPlan],
    /// Records that found no room.
    lost: u32,
    _calendar: PhantomData<fn() -> C>,
}

impl<S: Sink, C> Recorder<S, C> {
    /// Writes to this sink. `channels`: those of the plan, `&plan::CHANNELS`.
    pub const fn new(sink: S, channels: &'static [ChannelPlan]) -> Self {
        Self { sink, channels, lost: 0, _calendar: PhantomData }
    }

    fn write(&mut self, subject: Option<Subject>, at: Instant, kind: RecordKind) {
        // How many records are missing is said before the next one, so that it is known where they are missing.
        if self.lost > 0 {
            let kind = RecordKind::Lost { count: self.lost };
            if self.sink.write(&Record { channel: None, at, kind }.encode()) {
                self.lost = 0;
            }
        }
        let place = subject.and_then(|subject| self.channels.iter().position(|it| it.subject == subject));
        let channel = place.and_then(|place| u16::try_from(place).ok());
        if self.lost > 0 || !self.sink.write(&Record { channel, at, kind }.encode()) {
            self.lost = self.lost.saturating_add(1);
        }
    }
}

impl<S: Sink, C: CalendarObserver> Observer for Recorder<S, C> {
    type Calendar = C;

    fn exception(&mut self, exception: &Exception) {
        self.write(exception.subject, exception.at, RecordKind::Exception(exception.kind));
    }

    fn subscribed(&mut self, subject: Subject, filter: Filter, policy: Policy, at: Instant) {
        let queue = match policy {
            Policy::Latest => Queue::Latest,
            Policy::Fifo(depth) | Policy::DeadlineOrder(depth) => Queue::Fifo(depth.get().into()),
        };
        let filtered = filter != Filter::ALL;
        self.write(Some(subject), at, RecordKind::Subscribed { queue, filtered });
    }

    fn cancelled(&mut self, subject: Subject, at: Instant) {
        self.write(Some(subject), at, RecordKind::Cancelled);
    }
}

impl<T: Content, S: Sink, C: CalendarObserver> Observes<T> for Recorder<S, C> {
    fn published(&mut self, subject: Subject, content: &T, at: Instant, result: Result<(), PublishError>) {
        let (len, digest) = described(content);
        let kind = match result {
            Ok(()) => RecordKind::Published { len, digest },
            Err(error) => RecordKind::Refused { digest, queue_full: error == PublishError::QueueFull },
        };
        self.write(Some(subject), at, kind);
    }

    fn delivered(&mut self, subject: Subject, event: &Delivered<T>, at: Instant) {
        let (publisher, visible_at) = (event.publisher, event.received_at);
        let digest = described(&event.content).1;
        self.write(Some(subject), at, RecordKind::Delivered { digest, publisher, visible_at });
    }
}

/// Length and digest of a content.
fn described<T: Content>(content: &T) -> (u8, Digest) {
    let mut bytes = [0; Payload::MAX_LEN];
    // An event fits into a frame; of one that did not, nothing would have been sent.
    let len = content.encoded_len().min(Payload::MAX_LEN);
    let place = T::LEN.min(Payload::MAX_LEN);
    if let Some(bytes) = bytes.get_mut(..place) {
        content.encode(bytes);
    }
    (len as u8, Digest::of(bytes.get(..len).unwrap_or_default()))
}
