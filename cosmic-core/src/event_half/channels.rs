//! What the application calls: announce, publish, subscribe, and what it fetches.

use super::{Due, EventHalf, HardAccess, PUBLISHES, SUBSCRIBES};
use crate::calendar::Slot;
use crate::can::{Command, Frame, Id, Payload, Priority};
use crate::event_layer::{
    AnnounceError, Attributes, Channel, Content, Declared, Delivered, Event, ExceptionKind, Filter, Listed,
    MessagePublisher, MessageSubscriber, Policy, Publication, PublishError, Published, Quality,
    SubscribeError, Subscription, encode,
};
use crate::network::fragments::Message;
use crate::network::hard::{Attach, AttachError, Attaching, BufferId, Counters, Detaching, HrtBuffers, Role};
use crate::network::soft::{self, Outgoing, Tag, Unsent};
use crate::services::{Declaration, Services, TooMany};
use crate::time::Instant;
use core::task::{Poll, Waker};

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
    /// Announces a channel, on which this node may publish from now on. A hard real-time channel must
    /// stand in the calendar. O(CHANNELS + slots of the calendar · SLOTS).
    ///
    /// # Errors
    /// [`AnnounceError`]; nothing has changed then.
    pub fn announce<'c, C: Content>(
        &mut self,
        channel: &'c Channel<C>,
    ) -> Result<Publication<C>, AnnounceError>
    where
        D: From<&'c Declared>,
    {
        let publication = self.layer.announce(channel)?;
        match self.attach(channel.declared(), PUBLISHES) {
            Ok(buffer) => {
                self.layer.set_buffer(&publication, buffer);
            }
            Err(error) => {
                self.layer.cancel_publication(&publication);
                return Err(error);
            }
        }
        if let Err(error) = self.declare(channel.declared()) {
            // Nothing has been published, so there is nothing to withdraw.
            let _ = self.cancel_publication(publication);
            return Err(error);
        }
        Ok(publication)
    }

    /// Subscribes to a channel. O(CHANNELS + SUBSCRIPTIONS + slots of the calendar · SLOTS).
    ///
    /// # Errors
    /// [`SubscribeError`]; nothing has changed then.
    pub fn subscribe<'c, C: Content>(
        &mut self,
        channel: &'c Channel<C>,
        filter: Filter,
        policy: Policy,
    ) -> Result<Subscription<C>, SubscribeError>
    where
        D: From<&'c Declared>,
    {
        let subscription = self.layer.subscribe(channel, filter, policy)?;
        let joined = self.attach(channel.declared(), SUBSCRIBES);
        match joined.and_then(|_| self.declare(channel.declared())) {
            Ok(()) => Ok(subscription),
            Err(error) => {
                self.cancel_subscription(subscription);
                Err(SubscribeError::Channel(error))
            }
        }
    }

    /// As [`subscribe`](Self::subscribe), at a host whose clock is not good enough for the calendar: it hands in
    /// hard real-time frames by [`on_early_frame`](Self::on_early_frame). The subscription takes no HRT message
    /// buffer; of the calendar only the etag is looked at, so that content can be taken as plain bytes of any length.
    ///
    /// # Errors
    /// [`SubscribeError`]; nothing has changed then.
    pub fn subscribe_early<'c, C: Content>(
        &mut self,
        channel: &'c Channel<C>,
        filter: Filter,
        policy: Policy,
    ) -> Result<Subscription<C>, SubscribeError>
    where
        D: From<&'c Declared>,
    {
        let declared = channel.declared();
        let etag = declared.etag.filter(|etag| etag.is_hard());
        if etag.is_some_and(|etag| !self.calendar.slots().iter().any(|slot| slot.etag == etag)) {
            return Err(SubscribeError::Channel(AnnounceError::NotInCalendar));
        }
        let subscription = self.layer.subscribe(channel, filter, policy)?;
        if let Err(error) = self.declare(declared) {
            self.cancel_subscription(subscription);
            return Err(SubscribeError::Channel(error));
        }
        Ok(subscription)
    }

    /// Gives up an announcement. When it was the last one of the channel, events that wait to be sent are
    /// discarded; the commands do so in the mailboxes.
    pub fn cancel_publication<C>(&mut self, publication: Publication<C>) -> [Due; 2] {
        let declared = self.layer.declared(publication.tag()).copied();
        let Some(buffer) = self.layer.cancel_publication(&publication) else { return [Due::NOTHING; 2] };
        self.detach(buffer, PUBLISHES);
        if let Some(declared) = declared {
            // Giving up takes no room.
            let _ = self.declare(declared.borrow());
        }
        self.etch.recall(&Unsent::Of(publication.tag())).map(Due)
    }

    /// Gives up a subscription, with the events that wait for it.
    pub fn cancel_subscription<C>(&mut self, subscription: Subscription<C>) {
        let Some(declared) = self.layer.cancel_subscription(subscription) else { return };
        let _ = self.declare(declared.borrow());
        let Some(etag) = declared.borrow().etag.filter(|etag| SLOTS > 0 && etag.is_hard()) else { return };
        for slot in self.calendar.slots().iter().filter(|slot| slot.etag == etag) {
            let buffer = self.hard.with(|buffers| buffers.find(etag, slot.publisher));
            self.detach(buffer, SUBSCRIBES);
        }
    }

    /// Publishes an event. Local subscribers get it too: a hard real-time event at its delivery instant,
    /// any other at once. O(1) on an idle node, O(log SOFT) or O(log NRT) otherwise, and as
    /// [`on_input`](Self::on_input) for local subscribers.
    ///
    /// # Errors
    /// [`PublishError`]; the event is not sent.
    #[inline]
    pub fn publish<C: Content>(
        &mut self,
        now: Instant,
        publication: &Publication<C>,
        event: &Event<C>,
    ) -> Result<Due, PublishError> {
        let (payload, quality) = (encode(&event.content), Quality::of(event));
        if quality.is_plain() {
            self.submit::<true>(now, publication.tag(), payload, &quality)
        } else {
            self.submit::<false>(now, publication.tag(), payload, &quality)
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
    ) -> Result<Due, PublishError> {
        let quality = if PLAIN { &Quality::PLAIN } else { quality };
        let published = match self.layer.publish(now, tag, payload, quality) {
            Ok(published) => published,
            // A plain event is looked at no closer, but on a soft channel, which may be demoted.
            Err(error) if PLAIN && SOFT == 0 => {
                return self.submit_otherwise::<true>(now, tag, payload, quality, error);
            }
            Err(error) => return self.submit_otherwise::<false>(now, tag, payload, quality, error),
        };
        match published {
            Published::Hard(buffer, payload) => {
                if SLOTS > 0 && self.hard.with(|buffers| buffers.publish(buffer, payload)) {
                    self.raise_replaced(tag, now);
                }
                Ok(Due::NOTHING)
            }
            // Such a channel is not announced.
            Published::Soft(_) if SOFT == 0 => Err(PublishError::NotAnnounced),
            Published::Soft(outgoing) if !PLAIN && self.layer.is_demoted(tag) => {
                let frame = outgoing.frame;
                let frame = Frame::new(frame.id.with_priority(Priority::LEAST), frame.payload);
                let outgoing = Outgoing { frame, ..outgoing };
                let submitted = self.etch.submit_non_real_time(now, outgoing);
                self.conclude(now, outgoing, submitted)
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

    /// The event is not published, unless that is only because its channel has a rate: then it is charged, and
    /// submitted again.
    #[cold]
    fn submit_otherwise<const PLAIN: bool>(
        &mut self,
        now: Instant,
        tag: Tag,
        payload: Payload,
        quality: &Quality,
        error: PublishError,
    ) -> Result<Due, PublishError> {
        match self.layer.open(now, tag) {
            Ok(true) => {
                let submitted = self.submit::<PLAIN>(now, tag, payload, quality);
                self.layer.close(tag);
                submitted
            }
            Ok(false) => Err(self.refuse(tag, now, error)),
            Err(too_fast) => Err(self.refuse(tag, now, too_fast)),
        }
    }

    /// The event has been submitted, or there was no room for it.
    #[inline]
    fn conclude(
        &mut self,
        now: Instant,
        outgoing: Outgoing,
        submitted: Result<Option<Command>, soft::Full>,
    ) -> Result<Due, PublishError> {
        let Ok(command) = submitted else {
            return Err(self.refuse_full(outgoing.tag, now));
        };
        if self.layer.is_subscribed(outgoing.tag) {
            self.deliver_locally(outgoing, now);
        }
        Ok(Due(command))
    }

    /// Fetches the next event of a subscription. Content that is no value of the channel's type is passed
    /// over, with an exception. O(1) for each event that is fetched.
    // In a task that waits for the events of its channel, which calls it once.
    #[inline(always)]
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

    /// Sends the next frame of a message, if the one before it has left the node and there is room. Call it
    /// after [`MessagePublisher::start`], and whenever an [`Outcome`](super::Input::Outcome)
    /// was handed in.
    ///
    /// # Errors
    /// As [`publish`](Self::publish); the message is given up.
    pub fn send_message<const LEN: usize>(
        &mut self,
        now: Instant,
        publisher: &mut MessagePublisher<LEN>,
    ) -> Result<Due, PublishError> {
        let counters = self.layer.counters_of(publisher.publication().tag());
        publisher.note_departures(counters.sent, counters.discarded);
        if !self.etch.has_room_for_non_real_time() {
            return Ok(Due::NOTHING);
        }
        let first = publisher.is_at_first();
        let Some(fragment) = publisher.next() else { return Ok(Due::NOTHING) };
        let tag = publisher.publication().tag();
        let charged =
            self.layer.charge_message(now, tag, first).map_err(|error| self.refuse(tag, now, error));
        let published =
            charged.and_then(|()| self.publish(now, publisher.publication(), &Event::new(fragment)));
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

    /// Takes the frames that wait until they complete a message that `decode` can read, and returns what it makes of
    /// it. One that it cannot read is passed over, with an exception. If there is none, the next frame wakes the
    /// task. `each` is told of every frame.
    pub fn poll_message<const PLACES: usize, const LEN: usize, R>(
        &mut self,
        subscriber: &mut MessageSubscriber<PLACES, LEN>,
        now: Instant,
        waker: &Waker,
        mut each: impl FnMut(&Delivered<Payload>),
        mut decode: impl FnMut(Message<'_>) -> Option<R>,
    ) -> Poll<R> {
        if let Some(etag) = self.layer.etag_of(subscriber.subscription()) {
            while let Some(fragment) = self.next(subscriber.subscription()) {
                each(&fragment);
                match subscriber.take(etag, &fragment).map(&mut decode) {
                    Some(Some(decoded)) => return Poll::Ready(decoded),
                    Some(None) => self.raise_malformed(subscriber.subscription(), fragment.received_at),
                    None => {}
                }
            }
            subscriber.drop_stale(now);
        }
        self.layer.set_waker(subscriber.subscription(), waker);
        Poll::Pending
    }

    /// Takes part in the slots of a hard real-time channel; nothing for the others.
    fn attach(&mut self, declared: &Declared, role: Role) -> Result<Option<BufferId>, AnnounceError> {
        let Attributes::Hard(attributes) = declared.attributes else {
            let is_soft = matches!(declared.attributes, Attributes::Soft(_));
            return if SOFT == 0 && is_soft && role.publishes {
                Err(AnnounceError::TooManyChannels)
            } else {
                Ok(None)
            };
        };
        if SLOTS == 0 {
            return Err(AnnounceError::TooManySlots);
        }
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
            let mut attaching = Attaching::new(&Attach { calendar: self.calendar, slot, role });
            // In steps, between which the calendar task is let in.
            let attached = loop {
                if let Some(attached) = self.hard.with(|buffers| buffers.attach_step(&mut attaching)) {
                    break attached;
                }
            };
            buffer = Some(attached.map_err(|AttachError::Full| AnnounceError::TooManySlots)?);
        }
        buffer.map(Some).ok_or(AnnounceError::NotInCalendar)
    }

    pub(super) fn detach(&mut self, buffer: Option<BufferId>, role: Role) {
        if SLOTS > 0
            && let Some(buffer) = buffer
        {
            let mut detaching = Detaching::new(buffer, role);
            while !self.hard.with(|buffers| buffers.detach_step(&mut detaching)) {}
            let is_gone = self.hard.with(|buffers| buffers.etag(buffer)).is_none();
            if is_gone && let Some(seen) = self.seen.get_mut(buffer.index()) {
                // The next one in its place counts from zero.
                *seen = Counters::NONE.exceptional();
            }
        }
    }

    /// Tells the services what the node does on a channel now.
    fn declare(&mut self, declared: &Declared) -> Result<(), AnnounceError> {
        let (publishes, subscribes) = self.layer.roles(declared.subject);
        let declaration = Declaration {
            subject: declared.subject,
            etag: declared.etag,
            class: declared.attributes.class(),
            layout: declared.layout,
            offer: declared.offer(),
            publishes,
            subscribes,
        };
        let gate = self.services.permits(&declaration)?;
        self.services.declare(&declaration).map_err(|TooMany| AnnounceError::TooManyChannels)?;
        if !matches!(declared.attributes, Attributes::Hard(_)) {
            self.layer.set_publishers(declared.subject, self.services.publishers(declared.subject));
            self.layer.set_gate(declared.subject, gate);
        }
        Ok(())
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
    fn refuse(&mut self, tag: Tag, now: Instant, error: PublishError) -> PublishError {
        self.layer.note_refusal(tag, false);
        if error == PublishError::TooFast {
            self.raise(self.layer.subject(tag), ExceptionKind::RateExceeded, now);
        }
        error
    }

    #[cold]
    fn refuse_full(&mut self, tag: Tag, now: Instant) -> PublishError {
        self.layer.note_refusal(tag, true);
        self.raise(self.layer.subject(tag), ExceptionKind::TransmitQueueFull, now);
        PublishError::QueueFull
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
}
