//! The event half as a runtime sees it, whatever room it has.

use super::{Due, EventHalf, HardAccess, Input, Interest, Step};
use crate::can::Payload;
use crate::can::filter_banks::Wanted;
use crate::event_layer::{
    AnnounceError, Channel, ChannelCounters, Content, Declared, Delivered, Event, Exception, ExceptionKind,
    Filter, Listed, MessagePublisher, MessageSubscriber, Policy, Publication, PublishError, SubscribeError,
    Subscription,
};
use crate::network::fragments::Message;
use crate::network::hard::HrtBuffers;
use crate::services::Services;
use crate::time::Instant;
use crate::uid::Subject;
use core::task::{Poll, Waker};

/// What a runtime and an application call of an [`EventHalf`], whatever its capacities. Each method is the one of
/// the same name there, where its contract stands.
pub trait Half {
    /// The services that the node takes part in.
    type Services: Services;

    /// As [`EventHalf::on_input`].
    fn on_input(&mut self, input: &Input, at: Instant) -> bool;

    /// As [`EventHalf::poll`].
    fn poll(&mut self, now: Instant) -> Step;

    /// As [`EventHalf::services`].
    fn services(&self) -> &Self::Services;

    /// As [`EventHalf::services_mut`].
    fn services_mut(&mut self) -> &mut Self::Services;

    /// As [`EventHalf::announce`].
    ///
    /// # Errors
    /// As there.
    fn announce<C: Content>(&mut self, channel: &'static Channel<C>)
    -> Result<Publication<C>, AnnounceError>;

    /// As [`EventHalf::subscribe`].
    ///
    /// # Errors
    /// As there.
    fn subscribe<C: Content>(
        &mut self,
        channel: &'static Channel<C>,
        filter: Filter,
        policy: Policy,
    ) -> Result<Subscription<C>, SubscribeError>;

    /// As [`EventHalf::cancel_publication`].
    fn cancel_publication<C>(&mut self, publication: Publication<C>) -> [Due; 2];

    /// As [`EventHalf::cancel_subscription`].
    fn cancel_subscription<C>(&mut self, subscription: Subscription<C>);

    /// As [`EventHalf::publish`].
    ///
    /// # Errors
    /// As there.
    fn publish<C: Content>(
        &mut self,
        now: Instant,
        publication: &Publication<C>,
        event: &Event<C>,
    ) -> Result<Due, PublishError>;

    /// As [`EventHalf::next`].
    fn next<C: Content>(&mut self, subscription: &Subscription<C>) -> Option<Delivered<C>>;

    /// As [`EventHalf::poll_next`].
    fn poll_next<C: Content>(&mut self, subscription: &Subscription<C>, waker: &Waker) -> Poll<Delivered<C>>;

    /// As [`EventHalf::send_message`].
    ///
    /// # Errors
    /// As there.
    fn send_message<const LEN: usize>(
        &mut self,
        now: Instant,
        publisher: &mut MessagePublisher<LEN>,
    ) -> Result<Due, PublishError>;

    /// As [`EventHalf::receive_messages`].
    fn receive_messages<const PLACES: usize, const LEN: usize>(
        &mut self,
        subscriber: &mut MessageSubscriber<PLACES, LEN>,
        now: Instant,
        each: impl FnMut(Message<'_>),
    );

    /// As [`EventHalf::poll_message`].
    fn poll_message<const PLACES: usize, const LEN: usize, R>(
        &mut self,
        subscriber: &mut MessageSubscriber<PLACES, LEN>,
        now: Instant,
        waker: &Waker,
        each: impl FnMut(&Delivered<Payload>),
        decode: impl FnMut(Message<'_>) -> Option<R>,
    ) -> Poll<R>;

    /// As [`EventHalf::take_exception`].
    fn take_exception(&mut self) -> Option<Exception>;

    /// As [`EventHalf::poll_exception`].
    fn poll_exception(&mut self, waker: &Waker) -> Poll<Exception>;

    /// As [`EventHalf::exceptions`].
    fn exceptions(&self, kind: ExceptionKind) -> u32;

    /// As [`EventHalf::exceptions_dropped`].
    fn exceptions_dropped(&self) -> u32;

    /// As [`EventHalf::channel_counters`].
    fn channel_counters(&self, subject: Subject) -> Option<ChannelCounters>;

    /// As [`EventHalf::take_interest`].
    fn take_interest(&mut self) -> Option<Interest>;

    /// As [`EventHalf::wanted`].
    fn wanted(&self) -> impl Iterator<Item = Wanted>;

    /// As [`EventHalf::foreign_frames`].
    fn foreign_frames(&self) -> u32;

    /// As [`EventHalf::waiting`].
    fn waiting(&self) -> usize;
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
    D: Listed + From<&'static Declared>,
    const EXCEPTIONS: usize,
> Half for EventHalf<SLOTS, CHANNELS, SUBSCRIPTIONS, EVENTS, SOFT, NRT, S, H, D, EXCEPTIONS>
{
    type Services = S;

    #[inline]
    fn on_input(&mut self, input: &Input, at: Instant) -> bool {
        Self::on_input(self, input, at)
    }

    #[inline]
    fn poll(&mut self, now: Instant) -> Step {
        Self::poll(self, now)
    }

    fn services(&self) -> &Self::Services {
        Self::services(self)
    }

    fn services_mut(&mut self) -> &mut Self::Services {
        Self::services_mut(self)
    }

    fn announce<C: Content>(
        &mut self,
        channel: &'static Channel<C>,
    ) -> Result<Publication<C>, AnnounceError> {
        Self::announce(self, channel)
    }

    fn subscribe<C: Content>(
        &mut self,
        channel: &'static Channel<C>,
        filter: Filter,
        policy: Policy,
    ) -> Result<Subscription<C>, SubscribeError> {
        Self::subscribe(self, channel, filter, policy)
    }

    fn cancel_publication<C>(&mut self, publication: Publication<C>) -> [Due; 2] {
        Self::cancel_publication(self, publication)
    }

    fn cancel_subscription<C>(&mut self, subscription: Subscription<C>) {
        Self::cancel_subscription(self, subscription)
    }

    #[inline]
    fn publish<C: Content>(
        &mut self,
        now: Instant,
        publication: &Publication<C>,
        event: &Event<C>,
    ) -> Result<Due, PublishError> {
        Self::publish(self, now, publication, event)
    }

    #[inline]
    fn next<C: Content>(&mut self, subscription: &Subscription<C>) -> Option<Delivered<C>> {
        Self::next(self, subscription)
    }

    fn poll_next<C: Content>(&mut self, subscription: &Subscription<C>, waker: &Waker) -> Poll<Delivered<C>> {
        Self::poll_next(self, subscription, waker)
    }

    fn send_message<const LEN: usize>(
        &mut self,
        now: Instant,
        publisher: &mut MessagePublisher<LEN>,
    ) -> Result<Due, PublishError> {
        Self::send_message(self, now, publisher)
    }

    fn receive_messages<const PLACES: usize, const LEN: usize>(
        &mut self,
        subscriber: &mut MessageSubscriber<PLACES, LEN>,
        now: Instant,
        each: impl FnMut(Message<'_>),
    ) {
        Self::receive_messages(self, subscriber, now, each)
    }

    fn poll_message<const PLACES: usize, const LEN: usize, R>(
        &mut self,
        subscriber: &mut MessageSubscriber<PLACES, LEN>,
        now: Instant,
        waker: &Waker,
        each: impl FnMut(&Delivered<Payload>),
        decode: impl FnMut(Message<'_>) -> Option<R>,
    ) -> Poll<R> {
        Self::poll_message(self, subscriber, now, waker, each, decode)
    }

    fn take_exception(&mut self) -> Option<Exception> {
        Self::take_exception(self)
    }

    fn poll_exception(&mut self, waker: &Waker) -> Poll<Exception> {
        Self::poll_exception(self, waker)
    }

    fn exceptions(&self, kind: ExceptionKind) -> u32 {
        Self::exceptions(self, kind)
    }

    fn exceptions_dropped(&self) -> u32 {
        Self::exceptions_dropped(self)
    }

    fn channel_counters(&self, subject: Subject) -> Option<ChannelCounters> {
        Self::channel_counters(self, subject)
    }

    fn take_interest(&mut self) -> Option<Interest> {
        Self::take_interest(self)
    }

    fn wanted(&self) -> impl Iterator<Item = Wanted> {
        Self::wanted(self)
    }

    fn foreign_frames(&self) -> u32 {
        Self::foreign_frames(self)
    }

    fn waiting(&self) -> usize {
        Self::waiting(self)
    }
}
