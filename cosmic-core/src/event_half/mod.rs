//! The event-triggered half of a node: owner of the event layer and of the soft and non real-time path.
//!
//! A node is two halves. The time-triggered half is a [`Dispatcher`](crate::network::hard::Dispatcher) in
//! the task of the highest priority. This is the other one. Its parts never call each other; it takes
//! what one of them produces to the next.
//!
//! Calls, in any order, each with the present local time:
//!
//! * from the application: [`announce`](EventHalf::announce), [`publish`](EventHalf::publish),
//!   [`subscribe`](EventHalf::subscribe), [`next`](EventHalf::next) or
//!   [`poll_next`](EventHalf::poll_next), [`take_exception`](EventHalf::take_exception);
//! * from the driver and the dispatcher's task: [`on_input`](EventHalf::on_input), with what [`receive`]
//!   makes of a received frame, [`outcome`] of a frame that has left its mailbox, and with the
//!   [notices](Input::Notice) of the dispatcher;
//! * after any of them, and at the instant named last: [`poll`](EventHalf::poll), until it says
//!   [`Step::SleepUntil`].
//!
//! A method that returns [`Due`] wants it carried out by the driver before the next call.
//!
//! Every host (firmware, simulation, a test) does the same three things: it hands in [`Input`]s, carries out
//! commands, and polls again at an instant. Who gets a frame is decided here, not by the host.

mod capacity;
mod channels;
mod drive;
mod half;
mod input;
mod interest;

pub use crate::event_layer::Delivered;
pub use capacity::{
    Capacity, Sizes, URGENT_WAITING, frames_waiting, notices_waiting, outcomes_waiting, stated_or_usual,
};
pub use half::Half;
pub use input::{Input, outcome, receive};
pub use interest::Interest;

use crate::calendar::Calendar;
use crate::can::filter_banks::{Fifo, Wanted};
use crate::can::{Command, ErrorCounters, TxNode};
use crate::event_layer::{
    Accepted, ChannelCounters, Declared, EventLayer, Exception, ExceptionKind, Exceptions, Listed,
};
use crate::network::hard::{Counters, Exceptional, HrtBuffers, Role};
use crate::network::soft::{self, Etch, EtchCounters, PriorityMap, Tag};
use crate::services::{NodeView, Services};
use crate::time::Instant;
use crate::uid::Subject;
use core::task::{Poll, Waker};

/// Access to the HRT message buffers, which the two halves share.
///
/// The [`EventHalf`] owns one, and its interrupts and the calendar task have one each. The buffers themselves
/// implement it, for a program in which nothing runs concurrently: then the half owns them, and the dispatcher
/// reaches them by [`EventHalf::hard_mut`]. In firmware, an implementation locks them for the time of the
/// call, which copies at most one event.
pub trait HardAccess<B> {
    /// Calls `access` with the buffers.
    fn with<R>(&mut self, access: impl FnOnce(&mut B) -> R) -> R;
}

impl<const SLOTS: usize> HardAccess<Self> for HrtBuffers<SLOTS> {
    #[inline]
    fn with<R>(&mut self, access: impl FnOnce(&mut Self) -> R) -> R {
        access(self)
    }
}

/// What the driver must carry out before the next call: a command, or nothing.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[must_use = "a command that is not carried out leaves the mailboxes in a state that the core does not expect"]
pub struct Due(Option<Command>);

impl Due {
    /// Nothing is to be done.
    pub const NOTHING: Self = Self(None);

    /// The command, if there is one.
    #[inline]
    pub const fn command(self) -> Option<Command> {
        self.0
    }
}

/// What the owner of an [`EventHalf`] is to do next.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[must_use]
pub enum Step {
    /// Have the driver carry this out, then poll again.
    Command(Command),
    /// Nothing is to be done before this instant, if nothing else happens.
    SleepUntil(Instant),
}

const PUBLISHES: Role = Role { publishes: true, subscribes: false };
const SUBSCRIBES: Role = Role { publishes: false, subscribes: true };

const SERVICES: Tag = Tag::SERVICES;

/// The event-triggered half of a node.
///
/// | capacity | of |
/// |---|---|
/// | `SLOTS` | slots of the calendar in which the node takes part, a power of two; or zero |
/// | `CHANNELS` | channels that it announces or subscribes to, a power of two |
/// | `SUBSCRIPTIONS` | subscriptions |
/// | `EVENTS` | received events that wait, in all queues together |
/// | `SOFT`, `NRT` | events that wait to be sent; `SOFT` may be zero |
///
/// Exceptions wait for the application like events that have no deadline, `EXCEPTIONS` at most: further ones are counted
/// only.
///
/// A node without slots, or that sends nothing in soft real-time, has no code for it. It is refused such channels, but may
/// subscribe to soft ones.
///
/// `S` are the [services](crate::services) that it takes part in, `H` is its [access](HardAccess) to the HRT
/// message buffers. `D` is how it keeps what it knows of a channel: by a copy, or by
/// `&'static` where all channels are constants.
#[derive(Debug)]
// In this order for the reason that the event layer is in its order.
#[repr(C)]
pub struct EventHalf<
    const SLOTS: usize,
    const CHANNELS: usize,
    const SUBSCRIPTIONS: usize,
    const EVENTS: usize,
    const SOFT: usize,
    const NRT: usize,
    S = (),
    H = HrtBuffers<SLOTS>,
    D = Declared,
    const EXCEPTIONS: usize = NRT,
> {
    calendar: &'static Calendar,
    own: Own,
    /// Received frames that concern nobody here.
    foreign: u32,
    layer: EventLayer<CHANNELS, SUBSCRIPTIONS, EVENTS, D>,
    etch: Etch<SOFT, NRT>,
    /// What the exceptional counts of each HRT message buffer were when they were last looked at.
    seen: [Exceptional; SLOTS],
    exceptions: Exceptions<EXCEPTIONS>,
    exception_waker: Option<Waker>,
    services: S,
    view: NodeView,
    hard: H,
}

impl<
    const SLOTS: usize,
    const CHANNELS: usize,
    const SUBSCRIPTIONS: usize,
    const EVENTS: usize,
    const SOFT: usize,
    const NRT: usize,
    S: Services,
    H: HardAccess<HrtBuffers<SLOTS>>,
    D: Listed,
    const EXCEPTIONS: usize,
> EventHalf<SLOTS, CHANNELS, SUBSCRIPTIONS, EVENTS, SOFT, NRT, S, H, D, EXCEPTIONS>
{
    /// A node in a segment with this calendar. Without a TxNode it publishes nothing; a service may give
    /// it one. With services that [say when it has one](Services::GIVES_TX_NODE) it announces hard real-time
    /// channels of this TxNode at once, but publishes only from then on. Δt_p is that of the
    /// [calendar](Calendar::priority_step).
    pub const fn new(tx_node: Option<TxNode>, calendar: &'static Calendar, services: S, hard: H) -> Self {
        const { assert!(SOFT > 0 || !S::SENDS_URGENT, "the clock is sent in soft real-time: it needs places") };
        let map = PriorityMap::of_calendar(calendar);
        let may_send_as = if S::GIVES_TX_NODE { None } else { tx_node };
        Self {
            calendar,
            own: Own::new(tx_node),
            layer: EventLayer::new(may_send_as, map),
            etch: Etch::new(map),
            seen: [Counters::NONE.exceptional(); SLOTS],
            exceptions: Exceptions::new(),
            exception_waker: None,
            foreign: 0,
            services,
            view: NodeView { exceptions: 0, errors: ErrorCounters::NONE },
            hard,
        }
    }

    /// The services that the node takes part in.
    pub const fn services(&self) -> &S {
        &self.services
    }

    /// As [`services`](Self::services), to ask for something. Then [`poll`](Self::poll).
    pub const fn services_mut(&mut self) -> &mut S {
        &mut self.services
    }

    /// Its access to the HRT message buffers.
    pub const fn hard(&self) -> &H {
        &self.hard
    }

    /// As [`hard`](Self::hard), for the dispatcher of a program in which nothing runs concurrently.
    pub const fn hard_mut(&mut self) -> &mut H {
        &mut self.hard
    }

    /// Fetches the oldest exception.
    pub fn take_exception(&mut self) -> Option<Exception> {
        self.exceptions.take()
    }

    /// As [`take_exception`](Self::take_exception) in a task: if there is none, the next wakes it.
    pub fn poll_exception(&mut self, waker: &Waker) -> Poll<Exception> {
        match self.exceptions.take() {
            Some(exception) => Poll::Ready(exception),
            None => {
                self.exception_waker = Some(waker.clone());
                Poll::Pending
            }
        }
    }

    /// How many exceptions of a kind there were. Wraps.
    pub fn exceptions(&self, kind: ExceptionKind) -> u32 {
        self.exceptions.count(kind)
    }

    /// How many exceptions were counted but not kept, because the application did not fetch them. Wraps.
    pub fn exceptions_dropped(&self) -> u32 {
        self.exceptions.dropped()
    }

    /// What happened on a channel at this node.
    pub fn channel_counters(&self, subject: Subject) -> Option<ChannelCounters> {
        self.layer.counters(subject)
    }

    /// Soft and non real-time events that wait to be sent, those of the services included: for an application
    /// that publishes as much as the bus takes.
    pub fn waiting(&self) -> usize {
        self.etch.len()
    }

    /// What went through the soft and non real-time path.
    pub fn etch_counters(&self) -> EtchCounters {
        self.etch.counters()
    }

    /// What received frames may concern this node, if that has changed since the last call. A host may keep any other
    /// to itself, and count it as foreign.
    pub fn take_interest(&mut self) -> Option<Interest> {
        if !self.layer.take_renamed() {
            return None;
        }
        // A broker looks at the traffic of all.
        Some(if S::WATCHES_EVENTS { Interest::ALL } else { Interest::of(self.own.get(), self.layer.etags()) })
    }

    /// What a controller whose filters change as it runs is to accept now, beside what is known before: the frames with
    /// this node's TxNode, and of the channels that it subscribes to. Ask again when the
    /// [interest](Self::take_interest) has changed.
    pub fn wanted(&self) -> impl Iterator<Item = Wanted> {
        let of_all = if S::WATCHES_EVENTS { Wanted::BOUND.as_slice() } else { &[] };
        let own = self.own.get().map(|tx_node| Wanted::tx_node(Fifo::Other, tx_node));
        let etags = self.layer.etags().map(|etag| Wanted::etag(Fifo::Other, etag));
        of_all.iter().copied().chain(own).chain(etags)
    }

    /// How many received frames concerned nobody here. Wraps.
    pub fn foreign_frames(&self) -> u32 {
        self.foreign
    }

    #[inline]
    fn note(&mut self, accepted: Accepted, now: Instant) {
        match accepted {
            Accepted::Delivered => {}
            Accepted::Foreign => self.foreign = self.foreign.wrapping_add(1),
            Accepted::Overflowed(subject) => self.raise(Some(subject), ExceptionKind::QueueFull, now),
            Accepted::Malformed(subject) => self.raise(Some(subject), ExceptionKind::Malformed, now),
            Accepted::Unplanned(subject) => self.raise(Some(subject), ExceptionKind::UnplannedPublisher, now),
        }
    }

    fn raise_soft(&mut self, exception: &soft::Incident, at: Instant) {
        if exception.tag == SERVICES {
            // The services count themselves what they could not send.
            return;
        }
        let kind = match exception.kind {
            soft::IncidentKind::MissedDeadline => ExceptionKind::MissedDeadline,
            soft::IncidentKind::Expired => {
                self.layer.note_departure(exception.tag, false);
                ExceptionKind::ValidityExpired
            }
            soft::IncidentKind::IdentifierLost => {
                self.layer.note_departure(exception.tag, false);
                ExceptionKind::IdentifierLost
            }
        };
        let subject = self.layer.subject(exception.tag);
        if let Some(subject) = subject {
            self.services.on_late(subject, at);
        }
        self.raise(subject, kind, at);
    }

    fn raise(&mut self, subject: Option<Subject>, kind: ExceptionKind, at: Instant) {
        self.raise_times(subject, kind, 1, at);
    }

    fn raise_times(&mut self, subject: Option<Subject>, kind: ExceptionKind, times: u32, at: Instant) {
        self.exceptions.raise_times(Exception { subject, kind, at }, times);
        self.wake_exception_handler();
    }

    fn wake_exception_handler(&mut self) {
        if !self.exceptions.is_empty()
            && let Some(waker) = self.exception_waker.take()
        {
            waker.wake();
        }
    }
}

/// The node's TxNode, if it has one, as a number that no other TxNode equals. One compare for each frame.
#[derive(Clone, Copy, Debug)]
struct Own(u8);

impl Own {
    const NONE: Self = Self(u8::MAX);

    const fn new(tx_node: Option<TxNode>) -> Self {
        match tx_node {
            Some(tx_node) => Self(tx_node.get()),
            None => Self::NONE,
        }
    }

    const fn get(self) -> Option<TxNode> {
        TxNode::new(self.0)
    }

    #[inline]
    const fn is(self, tx_node: TxNode) -> bool {
        self.0 == tx_node.get()
    }
}
