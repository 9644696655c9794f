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
//! * from the driver: [`on_frame`](EventHalf::on_frame) for every received frame that is not hard real-time,
//!   [`on_outcome`](EventHalf::on_outcome) for every frame that has left the soft or non real-time mailbox;
//! * from the dispatcher's task: [`on_notify`](EventHalf::on_notify);
//! * after any of them, and at the instant named last: [`poll`](EventHalf::poll), until it says
//!   [`Step::SleepUntil`].
//!
//! A method that returns a [`Command`] wants it carried out by the driver before the next call.

use crate::calendar::{Calendar, Slot};
use crate::can::{Command, Frame, Id, Mailbox, Outcome, Payload, Priority, TxNode};
pub use crate::event_layer::Delivered;
use crate::event_layer::{
    Accepted, AnnounceError, Attributes, Channel, ChannelCounters, Content, Declared, Event, EventLayer,
    Exception, ExceptionKind, Exceptions, Filter, MessagePublisher, MessageSubscriber, Policy, Publication,
    PublishError, Published, Quality, Received, SubscribeError, Subscription, encode,
};
use crate::network::fragments::Message;
use crate::network::hard::{Attach, AttachError, BufferId, Counters, HrtBuffers, Role};
use crate::network::soft::{self, Etch, EtchCounters, Outgoing, PriorityMap, Tag};
use crate::services::{Declaration, NodeView, Request, Services, TooMany};
use crate::time::Instant;
use crate::uid::Subject;
use core::task::{Poll, Waker};

/// Access to the HRT message buffers, which the two halves share.
///
/// The buffers themselves implement it, for a program in which nothing runs concurrently. In firmware, an
/// implementation locks them for the time of the call, which copies at most one event.
pub trait HardAccess<const SLOTS: usize> {
    /// Calls `access` with the buffers.
    fn with<R>(&mut self, access: impl FnOnce(&mut HrtBuffers<SLOTS>) -> R) -> R;
}

impl<const SLOTS: usize> HardAccess<SLOTS> for HrtBuffers<SLOTS> {
    fn with<R>(&mut self, access: impl FnOnce(&mut HrtBuffers<SLOTS>) -> R) -> R {
        access(self)
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

/// Exceptions that wait for the application; further ones are counted only.
const EXCEPTIONS: usize = 16;

/// The event-triggered half of a node.
///
/// | capacity | of |
/// |---|---|
/// | `SLOTS` | slots of the calendar in which the node takes part, a power of two |
/// | `CHANNELS` | channels that it announces or subscribes to, a power of two |
/// | `SUBSCRIPTIONS` | subscriptions |
/// | `EVENTS` | received events that wait, in all queues together |
/// | `SOFT`, `NRT` | events that wait to be sent |
///
/// `S` are the [services](crate::services) that it takes part in.
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
> {
    calendar: &'static Calendar,
    own: Own,
    /// Received frames that concern nobody here.
    foreign: u32,
    layer: EventLayer<CHANNELS, SUBSCRIPTIONS, EVENTS>,
    etch: Etch<SOFT, NRT>,
    /// What the counters of each HRT message buffer were when they were last looked at.
    seen: [Counters; SLOTS],
    exceptions: Exceptions<EXCEPTIONS>,
    exception_waker: Option<Waker>,
    services: S,
    view: NodeView,
}

impl<
    const SLOTS: usize,
    const CHANNELS: usize,
    const SUBSCRIPTIONS: usize,
    const EVENTS: usize,
    const SOFT: usize,
    const NRT: usize,
    S: Services,
> EventHalf<SLOTS, CHANNELS, SUBSCRIPTIONS, EVENTS, SOFT, NRT, S>
{
    /// A node in a segment with this calendar. Without a TxNode it publishes nothing; a service may give
    /// it one. Δt_p is one longest frame.
    pub const fn new(tx_node: Option<TxNode>, calendar: &'static Calendar, services: S) -> Self {
        let map = PriorityMap::of(calendar.segment().bit_rate);
        Self {
            calendar,
            own: Own::new(tx_node),
            layer: EventLayer::new(tx_node, map),
            etch: Etch::new(map),
            seen: [Counters::NONE; SLOTS],
            exceptions: Exceptions::new(),
            exception_waker: None,
            foreign: 0,
            services,
            view: NodeView { exceptions: 0, transmit_errors: 0, receive_errors: 0 },
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

    /// Announces a channel, on which this node may publish from now on. A hard real-time channel must
    /// stand in the calendar. O(CHANNELS + slots of the calendar · SLOTS).
    ///
    /// # Errors
    /// [`AnnounceError`]; nothing has changed then.
    pub fn announce<C: Content>(
        &mut self,
        channel: &Channel<C>,
        hard: &mut impl HardAccess<SLOTS>,
    ) -> Result<Publication<C>, AnnounceError> {
        let publication = self.layer.announce(channel)?;
        match self.attach(&channel.declared(), PUBLISHES, hard) {
            Ok(buffer) => {
                self.layer.set_buffer(&publication, buffer);
            }
            Err(error) => {
                self.layer.cancel_publication(&publication);
                return Err(error);
            }
        }
        if let Err(error) = self.declare(&channel.declared()) {
            // Nothing has been published, so there is nothing to withdraw.
            let _ = self.cancel_publication(publication, hard);
            return Err(error);
        }
        Ok(publication)
    }

    /// Subscribes to a channel. O(CHANNELS + SUBSCRIPTIONS + slots of the calendar · SLOTS).
    ///
    /// # Errors
    /// [`SubscribeError`]; nothing has changed then.
    pub fn subscribe<C: Content>(
        &mut self,
        channel: &Channel<C>,
        filter: Filter,
        policy: Policy,
        hard: &mut impl HardAccess<SLOTS>,
    ) -> Result<Subscription<C>, SubscribeError> {
        let subscription = self.layer.subscribe(channel, filter, policy)?;
        let joined = self.attach(&channel.declared(), SUBSCRIBES, hard);
        match joined.and_then(|_| self.declare(&channel.declared())) {
            Ok(()) => Ok(subscription),
            Err(error) => {
                self.cancel_subscription(subscription, hard);
                Err(SubscribeError::Channel(error))
            }
        }
    }

    /// Gives up an announcement. When it was the last one of the channel, events that wait to be sent are
    /// discarded; the commands do so in the mailboxes.
    pub fn cancel_publication<C>(
        &mut self,
        publication: Publication<C>,
        hard: &mut impl HardAccess<SLOTS>,
    ) -> [Option<Command>; 2] {
        let declared = self.layer.declared(publication.tag());
        let Some(buffer) = self.layer.cancel_publication(&publication) else { return [None, None] };
        detach(buffer, PUBLISHES, hard);
        if let Some(declared) = declared {
            // Giving up takes no room.
            let _ = self.declare(&declared);
        }
        self.etch.recall(|outgoing| outgoing.tag == publication.tag())
    }

    /// Gives up a subscription, with the events that wait for it.
    pub fn cancel_subscription<C>(
        &mut self,
        subscription: Subscription<C>,
        hard: &mut impl HardAccess<SLOTS>,
    ) {
        let Some(declared) = self.layer.cancel_subscription(subscription) else { return };
        let _ = self.declare(&declared);
        let Some(etag) = declared.etag.filter(|etag| etag.is_hard()) else { return };
        for slot in self.calendar.slots().iter().filter(|slot| slot.etag == etag) {
            let buffer = hard.with(|buffers| buffers.find(etag, slot.publisher));
            detach(buffer, SUBSCRIBES, hard);
        }
    }

    /// Publishes an event. Local subscribers get it too: a hard real-time event at its delivery instant,
    /// any other at once. O(1) on an idle node, O(log SOFT) or O(log NRT) otherwise, and as
    /// [`on_frame`](Self::on_frame) for local subscribers.
    ///
    /// # Errors
    /// [`PublishError`]; the event is not sent.
    #[inline]
    pub fn publish<C: Content>(
        &mut self,
        now: Instant,
        publication: &Publication<C>,
        event: &Event<C>,
        hard: &mut impl HardAccess<SLOTS>,
    ) -> Result<Option<Command>, PublishError> {
        let (payload, quality) = (encode(&event.content), Quality::of(event));
        if quality.is_plain() {
            self.submit::<true>(now, publication.tag(), payload, &quality, hard)
        } else {
            self.submit::<false>(now, publication.tag(), payload, &quality, hard)
        }
    }

    /// Publishes an event, `PLAIN` or with times or context of its own. In two versions, so that the one
    /// does not bear what the other costs.
    #[inline(never)]
    fn submit<const PLAIN: bool>(
        &mut self,
        now: Instant,
        tag: Tag,
        payload: Payload,
        quality: &Quality,
        hard: &mut impl HardAccess<SLOTS>,
    ) -> Result<Option<Command>, PublishError> {
        let quality = if PLAIN { &Quality::PLAIN } else { quality };
        match self.layer.publish(now, tag, payload, quality)? {
            Published::Hard(buffer, payload) => {
                if hard.with(|buffers| buffers.publish(buffer, payload)) {
                    self.raise_replaced(tag, now);
                }
                Ok(None)
            }
            Published::Soft(outgoing) => {
                let submitted = self.etch.submit_soft(now, outgoing);
                self.conclude(now, outgoing, submitted)
            }
            Published::NonRealTime(outgoing) => {
                let submitted = self.etch.submit_non_real_time(now, outgoing);
                self.conclude(now, outgoing, submitted)
            }
        }
    }

    /// The event has been submitted, or there was no room for it.
    #[inline]
    fn conclude(
        &mut self,
        now: Instant,
        outgoing: Outgoing,
        submitted: Result<Option<Command>, soft::Full>,
    ) -> Result<Option<Command>, PublishError> {
        let Ok(command) = submitted else {
            self.raise(self.layer.subject(outgoing.tag), ExceptionKind::TransmitQueueFull, now);
            return Err(PublishError::QueueFull);
        };
        if self.layer.is_subscribed(outgoing.tag) {
            self.deliver_locally(outgoing, now);
        }
        Ok(command)
    }

    /// Fetches the next event of a subscription. Content that is no value of the channel's type is passed
    /// over, with an exception. O(1) for each event that is fetched.
    #[inline]
    pub fn next<C: Content>(&mut self, subscription: &Subscription<C>) -> Option<Delivered<C>> {
        loop {
            match self.layer.next(subscription)? {
                Ok(delivered) => return Some(delivered),
                Err(received_at) => self.raise_malformed(subscription, received_at),
            }
        }
    }

    /// As [`next`](Self::next) in a task: if there is none, the next event wakes it.
    pub fn poll_next<C: Content>(
        &mut self,
        subscription: &Subscription<C>,
        waker: &Waker,
    ) -> Poll<Delivered<C>> {
        match self.next(subscription) {
            Some(delivered) => Poll::Ready(delivered),
            None => {
                self.layer.set_waker(subscription, waker);
                Poll::Pending
            }
        }
    }

    /// A frame has arrived, that is not hard real-time. One map look-up, then O(1) for each subscriber of
    /// its channel, or O(EVENTS) for one who wants the earliest deadline first.
    // In the receive task, where it is called once.
    #[inline(always)]
    pub fn on_frame(&mut self, frame: &Frame, received_at: Instant) {
        match self.layer.receive(frame, received_at) {
            Received::Delivered => {}
            Received::Foreign => return self.reject(frame, received_at),
            Received::Undelivered => self.deliver(frame, received_at),
        }
        if self.is_mine(frame) {
            // No node hears itself: another one uses this TxNode.
            self.services.on_frame(frame, received_at);
        }
    }

    /// Sends the next frame of a message, if the one before it has left the node and there is room. Call it
    /// after [`MessagePublisher::start`], and whenever [`on_outcome`](Self::on_outcome) was called.
    ///
    /// # Errors
    /// As [`publish`](Self::publish); the message is given up.
    pub fn send_message<const LEN: usize>(
        &mut self,
        now: Instant,
        publisher: &mut MessagePublisher<LEN>,
        hard: &mut impl HardAccess<SLOTS>,
    ) -> Result<Option<Command>, PublishError> {
        let counters = self.layer.counters_of(publisher.publication().tag());
        publisher.note_departures(counters.sent, counters.discarded);
        if !self.etch.has_room_for_non_real_time() {
            return Ok(None);
        }
        let Some(fragment) = publisher.next() else { return Ok(None) };
        let published = self.publish(now, publisher.publication(), &Event::new(fragment), hard);
        published.inspect_err(|_| publisher.give_up())
    }

    /// Takes the frames that wait, and hands each message that they complete to `each`.
    pub fn receive_messages<const PLACES: usize, const LEN: usize>(
        &mut self,
        subscriber: &mut MessageSubscriber<PLACES, LEN>,
        now: Instant,
        mut each: impl FnMut(Message<'_>),
    ) {
        let Some(etag) = self.layer.etag_of(subscriber.subscription()) else { return };
        while let Some(fragment) = self.next(subscriber.subscription()) {
            if let Some(message) = subscriber.take(etag, &fragment) {
                each(message);
            }
        }
        subscriber.drop_stale(now);
    }

    /// A frame has left the soft or non real-time mailbox. O(log SOFT) or O(log NRT).
    pub fn on_outcome(&mut self, mailbox: Mailbox, outcome: Outcome, at: Instant) {
        let departure = self.etch.on_outcome(mailbox, outcome, at);
        match departure.sent {
            Some(sent) if sent.tag == SERVICES => self.services.on_sent(&sent.frame, at),
            Some(sent) => self.layer.note_departure(sent.tag, true),
            None => {}
        }
        if let Some(exception) = departure.exception {
            self.raise_soft(&exception, at);
        }
    }

    /// The dispatcher has said that something happened to an HRT message buffer.
    pub fn on_notify(&mut self, buffer: BufferId, now: Instant, hard: &mut impl HardAccess<SLOTS>) {
        let (delivery, counters) = hard.with(|buffers| (buffers.take(buffer), buffers.counters(buffer)));
        if let Some(delivery) = delivery {
            let frame = delivery.frame();
            if let Received::Undelivered = self.layer.receive(&frame, now) {
                self.deliver(&frame, now);
            }
        }
        let Some(counters) = counters else { return };
        let Some(seen) = self.seen.get_mut(buffer.index()) else { return };
        let before = core::mem::replace(seen, counters);
        let mut pairs = before.exceptional().into_iter().zip(counters.exceptional());
        if pairs.any(|(before, after)| before != after) {
            let mismatch = hard.with(|buffers| buffers.is_inhibited());
            let etag = hard.with(|buffers| buffers.etag(buffer));
            let subject = etag.and_then(|etag| self.layer.subject_of(etag));
            self.raise_hard(subject, (&before, &counters), mismatch, now);
        }
    }

    /// Raises what has happened in the slots of a buffer.
    fn raise_hard(
        &mut self,
        subject: Option<Subject>,
        (before, after): (&Counters, &Counters),
        mismatch: bool,
        at: Instant,
    ) {
        let silence = if mismatch { ExceptionKind::CalendarMismatch } else { ExceptionKind::ClockOutOfBound };
        let kinds = [
            ExceptionKind::OmissionDegreeExceeded,
            ExceptionKind::NothingPublished,
            ExceptionKind::SlotSkipped,
            ExceptionKind::MissedEvent,
            ExceptionKind::QueueFull,
            silence,
        ];
        let counts = before.exceptional().into_iter().zip(after.exceptional());
        for (kind, (before, after)) in kinds.into_iter().zip(counts) {
            // A buffer that was attached anew counts from zero.
            let times = if after >= before { after - before } else { after };
            self.exceptions.raise_times(Exception { subject, kind, at }, times);
        }
        self.wake_exception_handler();
    }

    /// What is to be done now; at most one command a call. O(SOFT + NRT), and what the services need.
    pub fn poll(&mut self, now: Instant, hard: &mut impl HardAccess<SLOTS>) -> Step {
        loop {
            while let Some(request) = self.next_request(now) {
                if let Some(command) = self.carry_out(request, now, hard) {
                    return Step::Command(command);
                }
            }
            match self.etch.poll(now) {
                soft::Step::Command(command) => return Step::Command(command),
                // What was discarded has left room for the services.
                soft::Step::Exception(exception) => self.raise_soft(&exception, now),
                soft::Step::SleepUntil(instant) => {
                    return Step::SleepUntil(instant.min(self.services_wakeup()));
                }
            }
        }
    }

    /// What has no room now is asked for again when a frame has left. If only the non real-time queue is
    /// full, because more urgent events of others fill the bus, the clock must go on.
    fn next_request(&mut self, now: Instant) -> Option<Request> {
        let view = NodeView { exceptions: self.exceptions.total(), ..self.view };
        match () {
            () if self.etch.has_room_for_services() => self.services.poll(now, &view),
            () if self.etch.has_room_for_urgent() => self.services.poll_urgent(now, &view),
            () => None,
        }
    }

    fn services_wakeup(&self) -> Instant {
        match () {
            () if self.etch.has_room_for_services() => self.services.next_wakeup(),
            () if self.etch.has_room_for_urgent() => self.services.next_urgent_wakeup(),
            () => Instant::FAR_FUTURE,
        }
    }

    fn carry_out(
        &mut self,
        request: Request,
        now: Instant,
        hard: &mut impl HardAccess<SLOTS>,
    ) -> Option<Command> {
        let submitted = match request {
            Request::SendUrgent(frame, expires_at) => {
                self.etch.submit_urgent(now, SERVICES, frame, expires_at)
            }
            Request::Send(frame) => {
                let forever = Instant::FAR_FUTURE;
                let outgoing = Outgoing { tag: SERVICES, frame, deadline: forever, expires_at: forever };
                self.etch.submit_non_real_time(now, outgoing)
            }
            Request::Withdraw(frame) => {
                let [_, command] =
                    self.etch.recall(|outgoing| outgoing.tag == SERVICES && outgoing.frame == frame);
                Ok(command)
            }
            Request::Clock(clock) => {
                hard.with(|buffers| buffers.set_clock(clock));
                Ok(None)
            }
            Request::Inhibit(inhibited) => {
                hard.with(|buffers| buffers.inhibit(inhibited));
                if inhibited {
                    self.raise(None, ExceptionKind::CalendarMismatch, now);
                }
                Ok(None)
            }
            Request::TxNode(tx_node) => {
                if self.own.get().is_some_and(|former| Some(former) != tx_node) {
                    // The frames that wait bear an id that is another node's.
                    self.etch.expire(now, |outgoing| outgoing.tag != SERVICES);
                }
                self.own = Own::new(tx_node);
                self.layer.set_tx_node(tx_node);
                Ok(None)
            }
            Request::Bound(subject, etag) => {
                if self.layer.bind(subject, etag).is_err() {
                    self.raise(Some(subject), ExceptionKind::BindingRefused, now);
                }
                let named = self.layer.look_up(etag).map(|route| self.etch.rename(route.tag, etag));
                Ok(named.flatten())
            }
            Request::Unbound(subject) => {
                self.layer.unbind(subject);
                if let Some(tag) = self.layer.tag_of(subject) {
                    // Under the old etag they would be another channel's.
                    self.etch.expire(now, |outgoing| outgoing.tag == tag);
                }
                Ok(None)
            }
            Request::Exception(subject, kind) => {
                self.raise(subject, kind, now);
                Ok(None)
            }
        };
        submitted.unwrap_or_else(|soft::Full| {
            self.raise(None, ExceptionKind::TransmitQueueFull, now);
            None
        })
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

    /// How many received frames concerned nobody here. Wraps.
    pub fn foreign_frames(&self) -> u32 {
        self.foreign
    }

    /// The controller's error counters (TEC and REC), for the status that the node tells.
    pub fn set_error_counters(&mut self, transmit_errors: u8, receive_errors: u8) {
        self.view = NodeView { transmit_errors, receive_errors, ..self.view };
    }

    /// The controller has left the bus.
    pub fn on_bus_off(&mut self, now: Instant) {
        self.raise(None, ExceptionKind::BusOff, now);
    }

    /// Takes part in the slots of a hard real-time channel; nothing for the others.
    fn attach(
        &mut self,
        declared: &Declared,
        role: Role,
        hard: &mut impl HardAccess<SLOTS>,
    ) -> Result<Option<BufferId>, AnnounceError> {
        let Attributes::Hard(attributes) = declared.attributes else { return Ok(None) };
        if role.publishes && self.own.get().is_none() {
            return Err(AnnounceError::NoTxNode);
        }
        let fits = |slot: &&Slot| {
            Some(slot.etag) == declared.etag
                && slot.period == attributes.period
                && slot.periodic == attributes.periodic
                && slot.omission_degree == attributes.omission_degree
                && usize::from(slot.len) >= declared.len
                && (role.subscribes || self.own.is(slot.publisher))
        };
        let mut buffer = None;
        for slot in self.calendar.slots().iter().filter(fits) {
            let request = Attach { calendar: self.calendar, slot, role };
            let attached = hard.with(|buffers| buffers.attach(&request));
            buffer = Some(attached.map_err(|AttachError::Full| AnnounceError::TooManySlots)?);
        }
        buffer.map(Some).ok_or(AnnounceError::NotInCalendar)
    }

    /// Tells the services what the node does on a channel now.
    fn declare(&mut self, declared: &Declared) -> Result<(), AnnounceError> {
        let (publishes, subscribes) = self.layer.roles(declared.subject);
        let declaration = Declaration {
            subject: declared.subject,
            etag: declared.etag,
            class: declared.attributes.class(),
            layout: declared.layout,
            publishes,
            subscribes,
        };
        self.services.declare(&declaration).map_err(|TooMany| AnnounceError::TooManyChannels)
    }

    #[inline]
    fn is_mine(&self, frame: &Frame) -> bool {
        self.own.is(frame.id.tx_node())
    }

    #[inline]
    fn reject(&mut self, frame: &Frame, received_at: Instant) {
        if frame.id.etag().is_reserved() || self.is_mine(frame) {
            self.services.on_frame(frame, received_at);
        } else {
            self.foreign = self.foreign.wrapping_add(1);
        }
    }

    /// The long way: out of line, and the channel is looked up again, so that the short one needs fewer
    /// registers.
    #[inline(never)]
    fn deliver(&mut self, frame: &Frame, received_at: Instant) {
        if let Some(route) = self.layer.look_up(frame.id.etag()) {
            let accepted = self.layer.deliver(route.tag, frame, received_at);
            self.note(accepted, received_at);
        }
    }

    /// A publication reaches the subscribers on this node, too, with the priority that its frame would
    /// have now.
    #[inline(never)]
    fn deliver_locally(&mut self, outgoing: Outgoing, now: Instant) {
        let id = outgoing.frame.id;
        let priority = match id.priority() {
            priority if priority > Priority::SOFT_LEAST_URGENT => priority,
            _ => self.etch.priority_map().priority(outgoing.deadline.saturating_since(now)),
        };
        let frame = Frame::new(Id::new(priority, id.tx_node(), id.etag()), outgoing.frame.payload);
        let accepted = self.layer.deliver(outgoing.tag, &frame, now);
        self.note(accepted, now);
    }

    #[cold]
    fn raise_replaced(&mut self, tag: Tag, now: Instant) {
        self.raise(self.layer.subject(tag), ExceptionKind::EventReplaced, now);
    }

    #[cold]
    fn raise_malformed<C>(&mut self, subscription: &Subscription<C>, received_at: Instant) {
        let subject = self.layer.note_malformed(subscription);
        self.raise(subject, ExceptionKind::Malformed, received_at);
    }

    #[inline]
    fn note(&mut self, accepted: Accepted, now: Instant) {
        match accepted {
            Accepted::Delivered => {}
            Accepted::Foreign => self.foreign = self.foreign.wrapping_add(1),
            Accepted::Overflowed(subject) => self.raise(Some(subject), ExceptionKind::QueueFull, now),
            Accepted::Malformed(subject) => self.raise(Some(subject), ExceptionKind::Malformed, now),
        }
    }

    fn raise_soft(&mut self, exception: &soft::Exception, at: Instant) {
        if exception.tag == SERVICES {
            // The services count themselves what they could not send.
            return;
        }
        let kind = match exception.kind {
            soft::ExceptionKind::MissedDeadline => ExceptionKind::MissedDeadline,
            soft::ExceptionKind::Expired => {
                self.layer.note_departure(exception.tag, false);
                ExceptionKind::ValidityExpired
            }
        };
        self.raise(self.layer.subject(exception.tag), kind, at);
    }

    fn raise(&mut self, subject: Option<Subject>, kind: ExceptionKind, at: Instant) {
        self.exceptions.raise_times(Exception { subject, kind, at }, 1);
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

fn detach<const SLOTS: usize>(buffer: Option<BufferId>, role: Role, hard: &mut impl HardAccess<SLOTS>) {
    if let Some(buffer) = buffer {
        hard.with(|buffers| buffers.detach(buffer, role));
    }
}
