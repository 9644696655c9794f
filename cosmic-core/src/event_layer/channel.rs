//! The local event channel list (LECL): what a node knows of the channels that concern it.

use super::attributes::{Attributes, HardAttributes, NonRealTimeAttributes, SoftAttributes};
use super::content::Content;
use super::filter::Filter;
use super::pool::List;
use crate::can::Etag;
use crate::network::hard::BufferId;
use crate::network::soft::Tag;
use crate::protocol::LayoutHash;
use crate::uid::Subject;
use core::marker::PhantomData;
use core::task::Waker;

/// A channel as the application declares it, once, with the type of its content.
///
/// ```
/// use cosmic_core::event_layer::{Channel, SoftAttributes};
/// use cosmic_core::time::Duration;
/// use cosmic_core::Subject;
///
/// const TEMPERATURE: Channel<i16> = Channel::soft(
///     Subject::new(0x1234_5678_0000_0001).unwrap(),
///     SoftAttributes { deadline: Duration::from_millis(20), validity: Duration::from_millis(50) },
/// );
/// ```
#[derive(Debug)]
pub struct Channel<C> {
    pub(super) declared: Declared,
    content: PhantomData<fn() -> C>,
}

impl<C> Clone for Channel<C> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<C> Copy for Channel<C> {}

/// A channel without the type of its content.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct Declared {
    pub(crate) subject: Subject,
    pub(crate) attributes: Attributes,
    pub(crate) etag: Option<Etag>,
    pub(crate) context: bool,
    pub(crate) layout: LayoutHash,
    /// Bytes of an event, with the byte of presence of a channel with context.
    pub(crate) len: usize,
}

impl<C: Content> Channel<C> {
    /// A hard real-time channel. Its etag is that of the calendar.
    pub const fn hard(subject: Subject, etag: Etag, attributes: HardAttributes) -> Self {
        assert!(etag.is_hard(), "the etag of a hard real-time channel is in 100..=1023");
        Self::new(subject, Attributes::Hard(attributes)).with_etag(etag)
    }

    /// A soft real-time channel.
    pub const fn soft(subject: Subject, attributes: SoftAttributes) -> Self {
        assert!(!attributes.deadline.is_zero(), "a deadline of zero cannot be met");
        assert!(
            attributes.validity.as_ticks() >= attributes.deadline.as_ticks(),
            "an event must not expire before its deadline"
        );
        Self::new(subject, Attributes::Soft(attributes))
    }

    /// A non real-time channel.
    pub const fn non_real_time(subject: Subject, attributes: NonRealTimeAttributes) -> Self {
        Self::new(subject, Attributes::NonRealTime(attributes))
    }

    const fn new(subject: Subject, attributes: Attributes) -> Self {
        assert!(C::LEN <= crate::can::Payload::MAX_LEN, "a frame carries at most eight bytes");
        let declared =
            Declared { subject, attributes, etag: None, context: false, layout: C::LAYOUT, len: C::LEN };
        Self { declared, content: PhantomData }
    }

    /// The channel with a fixed etag, for a cluster that has no broker.
    pub const fn with_etag(self, etag: Etag) -> Self {
        assert!(!etag.is_reserved(), "etags 0..=99 are the protocol's own");
        Self { declared: Declared { etag: Some(etag), ..self.declared }, ..self }
    }

    /// The channel, whose events carry [attributes of context](super::Context) before their content.
    pub const fn with_context(self) -> Self {
        assert!(C::LEN < crate::can::Payload::MAX_LEN, "the context takes at least one byte");
        // Two nodes that disagree on this misread each other just as with another content.
        let layout = LayoutHash::new(!self.declared.layout.get());
        Self { declared: Declared { context: true, layout, len: C::LEN + 1, ..self.declared }, ..self }
    }

    pub(crate) const fn declared(&self) -> Declared {
        self.declared
    }

    /// Its subject.
    pub const fn subject(&self) -> Subject {
        self.declared.subject
    }
}

/// The right to publish on a channel, from `announce`.
#[derive(Debug)]
pub struct Publication<C> {
    pub(super) channel: u8,
    content: PhantomData<fn() -> C>,
}

/// A subscription to a channel, from `subscribe`.
#[derive(Debug)]
pub struct Subscription<C> {
    pub(super) index: u8,
    content: PhantomData<fn() -> C>,
}

impl<C> Publication<C> {
    pub(crate) const fn tag(&self) -> Tag {
        Tag(self.channel)
    }

    pub(super) const fn new(channel: u8) -> Self {
        Self { channel, content: PhantomData }
    }
}

impl<C> Subscription<C> {
    pub(super) const fn new(index: u8) -> Self {
        Self { index, content: PhantomData }
    }
}

/// What becomes of events that wait for a subscriber.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Policy {
    /// First in, first out; when this many wait, a further one is dropped, with an exception.
    Fifo(Depth),
    /// The earliest deadline first; when this many wait, a further one is dropped, with an exception.
    DeadlineOrder(Depth),
    /// Only the latest; an earlier one is replaced and counted.
    Latest,
}

/// How many events may wait: at least one.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Depth(core::num::NonZeroU8);

impl Depth {
    /// `None` for zero: such a queue would lose every event.
    pub const fn new(depth: u8) -> Option<Self> {
        match core::num::NonZeroU8::new(depth) {
            Some(depth) => Some(Self(depth)),
            None => None,
        }
    }

    /// How many.
    pub const fn get(self) -> u8 {
        self.0.get()
    }
}

impl Policy {
    #[inline]
    pub(super) const fn depth(self) -> u8 {
        match self {
            Self::Fifo(depth) | Self::DeadlineOrder(depth) => depth.get(),
            Self::Latest => 1,
        }
    }
}

/// No subscription: the end of a channel's list.
pub(super) const NONE: u8 = u8::MAX;

/// An entry of the LECL (COSMIC section III-A).
#[derive(Clone, Debug)]
pub(super) struct Entry {
    pub(super) declared: Declared,
    pub(super) etag: Option<Etag>,
    pub(super) announcements: u8,
    pub(super) subscriptions: u8,
    pub(super) first_subscription: u8,
    /// The HRT-MB through which this node publishes.
    pub(super) buffer: Option<BufferId>,
    pub(super) counters: ChannelCounters,
}

/// What happened on a channel at this node. All counts wrap.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ChannelCounters {
    /// Events published by this node.
    pub published: u32,
    /// Of these, soft and non real-time ones that have been sent.
    pub sent: u32,
    /// Of these, soft and non real-time ones that expired before they were sent.
    pub discarded: u32,
    /// Events put into a subscriber's queue; one event counts once for each.
    pub delivered: u32,
    /// Events that no filter of a subscriber let through.
    pub filtered: u32,
    /// Events dropped because a subscriber's queue was full.
    pub overflowed: u32,
    /// Events replaced by a later one, for a subscriber that wants only the latest.
    pub replaced: u32,
    /// Events that did not carry what the channel's type says.
    pub malformed: u32,
}

#[derive(Debug)]
pub(super) struct Subscriber {
    pub(super) channel: u8,
    /// Do its events carry attributes of context?
    pub(super) context: bool,
    /// The next subscription to the same channel.
    pub(super) next: u8,
    pub(super) filter: Filter,
    pub(super) policy: Policy,
    pub(super) list: List,
    pub(super) waker: Option<Waker>,
}
