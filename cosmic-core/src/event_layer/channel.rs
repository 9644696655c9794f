//! The local event channel list (LECL): what a node knows of the channels that concern it.

use super::attributes::{Attributes, HardAttributes, NonRealTimeAttributes, SoftAttributes};
use super::content::Content;
use super::declared::{Declared, Listed};
use super::filter::Filter;
use super::gate::Gate;
use super::pool::List;
use super::rate::{EventRate, Guard};
use crate::can::{Etag, Id, Priority, TxNode, TxNodes};
use crate::network::hard::BufferId;
use crate::network::soft::Tag;
use crate::protocol::LayoutHash;
use crate::time::Instant;
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
        let declared = Declared {
            subject,
            attributes,
            etag: None,
            context: false,
            layout: C::LAYOUT,
            len: C::LEN,
            rate: None,
        };
        Self { declared, content: PhantomData }
    }

    /// The channel with a fixed etag, for a cluster that has no broker.
    pub const fn with_etag(self, etag: Etag) -> Self {
        assert!(!etag.is_reserved(), "etags 0..=99 are the protocol's own");
        let is_hard = matches!(self.declared.attributes, Attributes::Hard(_));
        assert!(is_hard == etag.is_hard(), "etags 100..=1023 are for hard real-time channels, and only they");
        Self { declared: Declared { etag: Some(etag), ..self.declared }, ..self }
    }

    /// The channel, whose events carry [attributes of context](super::Context) before their content.
    #[expect(clippy::arithmetic_side_effects, reason = "below eight, which was asked")]
    pub const fn with_context(self) -> Self {
        assert!(C::LEN < crate::can::Payload::MAX_LEN, "the context takes at least one byte");
        // Two nodes that disagree on this misread each other just as with another content.
        let layout = LayoutHash::new(!self.declared.layout.get());
        Self { declared: Declared { context: true, layout, len: C::LEN + 1, ..self.declared }, ..self }
    }

    /// The channel, whose content means what this layout says: the plan of the cluster knows more of a content than
    /// the types of its fields, such as a scale. Content that states no layout goes on stating none.
    pub const fn with_layout(self, layout: LayoutHash) -> Self {
        assert!(!self.declared.context, "the layout is that of the content, without its context");
        if self.declared.layout.get() == LayoutHash::UNSTATED.get() {
            return self;
        }
        Self { declared: Declared { layout, ..self.declared }, ..self }
    }

    /// The channel, whose frames are pieces of something with this layout.
    pub(super) const fn in_pieces_of(self, layout: LayoutHash) -> Self {
        Self { declared: Declared { layout, ..self.declared }, ..self }
    }

    /// The channel, whose events come this often: its publishers are held to it, and subscribers of a periodic soft
    /// real-time channel are told if an event does not come. Not for a hard real-time one: its calendar says so.
    pub const fn with_rate(self, rate: EventRate) -> Self {
        let is_hard = matches!(self.declared.attributes, Attributes::Hard(_));
        assert!(!is_hard, "the rate of a hard real-time channel stands in the calendar");
        Self { declared: Declared { rate: Some(rate), ..self.declared }, ..self }
    }

    pub(crate) const fn declared(&self) -> &Declared {
        &self.declared
    }

    /// Its subject.
    pub const fn subject(&self) -> Subject {
        self.declared.subject
    }

    /// How often its events come, if that is stated.
    pub const fn rate(&self) -> Option<EventRate> {
        self.declared.rate
    }

    /// Its quality.
    pub const fn attributes(&self) -> Attributes {
        self.declared.attributes
    }

    /// How its events are laid out.
    pub const fn layout(&self) -> LayoutHash {
        self.declared.layout
    }

    /// Returns whether its events carry [attributes of context](super::Context).
    pub const fn has_context(&self) -> bool {
        self.declared.context
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
    /// Do its events carry attributes of context?
    pub(super) context: bool,
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
    pub(super) const fn new(index: u8, context: bool) -> Self {
        Self { index, context, content: PhantomData }
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
pub(super) struct Entry<D> {
    pub(super) declared: D,
    pub(super) etag: Option<Etag>,
    /// What the frames of its events are called. Closed if the channel has a rate, but for the event that is charged.
    pub(super) outlet: Outlet,
    /// The outlet of a channel with a rate, or one that is sent as non real-time.
    pub(super) guarded_outlet: Outlet,
    pub(super) gate: Gate,
    pub(super) guard: Guard,
    /// In a sealed cluster: whose events are taken. Not for hard real-time channels, where the calendar says so.
    pub(super) publishers: Option<&'static TxNodes>,
    /// From when on the next event of a periodic channel is waited for here: since the last one, but for those that did not
    /// come. [`Instant::FAR_FUTURE`]: it is not.
    pub(super) awaited_since: Instant,
    pub(super) announcements: u8,
    pub(super) subscriptions: u8,
    pub(super) first_subscription: u8,
    /// The HRT-MB through which this node publishes.
    pub(super) buffer: Option<BufferId>,
    pub(super) counters: ChannelCounters,
}

impl<D> Entry<D> {
    /// A channel that nobody uses yet.
    pub(super) const fn new(declared: D, guard: Guard) -> Self {
        Self {
            declared,
            etag: None,
            outlet: Outlet::CLOSED,
            guarded_outlet: Outlet::CLOSED,
            gate: Gate::Open,
            guard,
            publishers: None,
            awaited_since: Instant::FAR_FUTURE,
            announcements: 0,
            subscriptions: 0,
            first_subscription: NONE,
            buffer: None,
            counters: ChannelCounters::NONE,
        }
    }

    /// Returns whether the node publishes on the channel or subscribes to it.
    pub(super) const fn is_used(&self) -> bool {
        self.announcements > 0 || self.subscriptions > 0
    }
}

impl<D: Listed> Entry<D> {
    /// The channel as it was declared.
    #[inline]
    pub(super) fn declared(&self) -> &Declared {
        self.declared.borrow()
    }

    /// Returns whether its events carry attributes of context.
    #[inline]
    pub(super) fn has_context(&self) -> bool {
        D::CONTEXTS && self.declared().context
    }

    /// How often its events come, if they are held to that here.
    #[inline]
    pub(super) fn rate(&self) -> Option<EventRate> {
        if D::RATES { self.declared().rate } else { None }
    }

    /// Returns whether subscribers are told here of events that do not come.
    #[inline]
    pub(super) fn is_awaited(&self) -> bool {
        D::RATES && self.declared().is_awaited()
    }
}

/// The identifier of the frames that this node publishes on a channel, but for the priority; or nothing, as
/// long as it may not publish.
#[derive(Clone, Copy, Debug)]
pub(super) struct Outlet(u32);

impl Outlet {
    pub(super) const CLOSED: Self = Self(u32::MAX);

    pub(super) const fn new(tx_node: TxNode, etag: Etag) -> Self {
        Self(Id::new(Priority::HARD, tx_node, etag).raw())
    }

    pub(super) const fn is_closed(self) -> bool {
        self.0 == Self::CLOSED.0
    }

    /// With this priority.
    #[inline]
    pub(super) const fn id(self, priority: Priority) -> Option<Id> {
        match Id::from_raw(self.0) {
            Some(id) => Some(id.with_priority(priority)),
            None => None,
        }
    }
}

/// What happened on a channel at this node. All counts wrap.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ChannelCounters {
    /// Events published by this node, and taken.
    pub published: u32,
    /// Events that were not taken; [`publish`](crate::EventHalf::publish) has said why.
    pub refused: u32,
    /// Of these, events that came more often than the channel's rate says.
    pub too_fast: u32,
    /// Of the published, soft and non real-time ones that have been sent.
    pub sent: u32,
    /// Of the published, soft and non real-time ones that expired before they were sent.
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
    /// Events that were dropped because the plan of a sealed cluster does not let their sender publish them.
    pub unplanned: u32,
}

impl ChannelCounters {
    const NONE: Self = Self {
        published: 0,
        refused: 0,
        too_fast: 0,
        sent: 0,
        discarded: 0,
        delivered: 0,
        filtered: 0,
        overflowed: 0,
        replaced: 0,
        malformed: 0,
        unplanned: 0,
    };
}

/// What a received frame leads to.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Route {
    /// The channel.
    pub(crate) tag: Tag,
    /// Its only subscriber; [`NONE`] if there is none, or more than one, or the channel has context.
    pub(super) only: u8,
    /// It is noted when events of the channel come, since subscribers are told if one does not.
    pub(super) is_awaited: bool,
}

impl Route {
    /// The bits of its code: there are at most 128 channels.
    pub(super) const BITS: u32 = 16;
    const AWAITED: u32 = 1 << 15;

    #[inline]
    pub(super) const fn decode(code: u32) -> Self {
        Self { tag: Tag((code >> 8 & 0x7F) as u8), only: code as u8, is_awaited: code & Self::AWAITED != 0 }
    }

    pub(super) const fn encode(self) -> u32 {
        let awaited = if self.is_awaited { Self::AWAITED } else { 0 };
        awaited | (self.tag.0 as u32) << 8 | self.only as u32
    }
}

/// A subscription, or a place for one.
#[derive(Debug)]
pub(super) struct Subscriber {
    /// [`NONE`]: the place is vacant.
    pub(super) channel: u8,
    /// The next subscription to the same channel.
    pub(super) next: u8,
    /// As long as fewer than this wait, an event needs no closer look: the subscriber takes every one,
    /// first in first out.
    pub(super) takes_any: u8,
    pub(super) filter: Filter,
    pub(super) policy: Policy,
    pub(super) list: List,
    pub(super) waker: Option<Waker>,
    /// Events put into the queue.
    pub(super) delivered: u32,
}

impl Subscriber {
    pub(super) const VACANT: Self = Self {
        channel: NONE,
        next: NONE,
        takes_any: 0,
        filter: Filter::ALL,
        policy: Policy::Latest,
        list: List::new(),
        waker: None,
        delivered: 0,
    };

    pub(super) fn new(channel: u8, next: u8, filter: Filter, policy: Policy) -> Self {
        let takes_any = match policy {
            Policy::Fifo(depth) if filter == Filter::ALL => depth.get(),
            _ => 0,
        };
        Self { channel, next, takes_any, filter, policy, ..Self::VACANT }
    }

    pub(super) const fn is_vacant(&self) -> bool {
        self.channel == NONE
    }

    /// An event is in the queue: counts it, and wakes the task that waits for it, if one does.
    // A few instructions in the way of each event, fewer than a call when built for size.
    #[inline(always)]
    pub(super) fn note_delivery(&mut self) {
        self.delivered = self.delivered.wrapping_add(1);
        if self.waker.is_some() {
            self.wake_task();
        }
    }

    /// Out of line, so that the way of an event that nobody waits for is short.
    #[inline(never)]
    fn wake_task(&mut self) {
        if let Some(waker) = self.waker.take() {
            waker.wake();
        }
    }
}
