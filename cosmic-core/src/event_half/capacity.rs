//! Nodes of any size: for runtimes, which are written once for all of them.

use super::{Due, EventHalf, HardAccess, Input, Interest, Step, outcome, receive};
use crate::calendar::Calendar;
use crate::can::filter_banks::Wanted;
use crate::can::{Frame, Mailbox, Outcome, Payload, TxNode};
use crate::event_layer::{
    AnnounceError, Channel, ChannelCounters, Content, Declared, Delivered, Event, Exception, ExceptionKind,
    Filter, MessagePublisher, MessageSubscriber, Policy, Publication, PublishError, SubscribeError,
    Subscription,
};
use crate::network::fragments::Message;
use crate::network::hard::{self, Dispatcher, HrtBuffers};
use crate::services::Services;
use crate::time::{GlobalClock, Instant};
use crate::uid::Subject;
use core::borrow::Borrow;
use core::task::{Poll, Waker};

/// How much a node has room for, as one type: what [`capacity!`](crate::capacity) names, mostly for a plan.
///
/// A runtime that is generic over it need not know the numbers. Its functions are those of the types that it
/// names. It is sealed: that its functions do no more than the core's own is what lets a runtime lock around them.
pub trait Capacity: sealed::Sealed + 'static {
    /// The HRT message buffers.
    type Buffers: Send + 'static;
    /// The time-triggered half.
    type Dispatcher: Send + 'static;
    /// The event-triggered half, with its services and its access to the buffers.
    type Half<S: Services, H: HardAccess<Self::Buffers>>: Half<Services = S>;

    /// Buffers of a node whose clock is not synchronised yet.
    const BUFFERS: Self::Buffers;

    /// As [`Dispatcher::new`].
    fn dispatcher(calendar: &Calendar) -> Self::Dispatcher;

    /// As [`EventHalf::new`].
    fn half<S: Services, H: HardAccess<Self::Buffers>>(
        tx_node: Option<TxNode>,
        calendar: &'static Calendar,
        services: S,
        hard: H,
    ) -> Self::Half<S, H>;

    /// As [`HrtBuffers::set_clock`].
    fn set_clock(buffers: &mut Self::Buffers, clock: GlobalClock);

    /// As [`Dispatcher::poll`].
    fn dispatch(
        dispatcher: &mut Self::Dispatcher,
        now: Instant,
        buffers: &mut Self::Buffers,
    ) -> hard::CalendarStep;

    /// As [`receive`].
    fn receive(frame: &Frame, at: Instant, hard: &mut impl HardAccess<Self::Buffers>) -> Option<Input>;

    /// As [`outcome`].
    fn outcome(
        mailbox: Mailbox,
        outcome: Outcome,
        at: Instant,
        hard: &mut impl HardAccess<Self::Buffers>,
    ) -> Option<Input>;
}

/// The [`Capacity`] with these numbers; [`capacity!`](crate::capacity) names them. What each is of stands at
/// [`EventHalf`]. `FRAMES`, `OUTCOMES` and `NOTICES` follow from the others: what waits for a half whose task is not this
/// one's, in a runtime that has queues for it. They are [`frames_waiting`], [`outcomes_waiting`] and [`notices_waiting`].
/// `URGENT` is the same of frames of the clock: [`URGENT_WAITING`], or none.
#[derive(Debug)]
pub struct Sizes<
    const SLOTS: usize,
    const CHANNELS: usize,
    const SUBSCRIPTIONS: usize,
    const EVENTS: usize,
    const SOFT: usize,
    const NRT: usize,
    const FRAMES: usize,
    const OUTCOMES: usize,
    const NOTICES: usize,
    const EXCEPTIONS: usize,
    const URGENT: usize,
>;

/// Received frames that wait to be taken in, of a node with so many events that wait for the application: as many, and no
/// more than come in three milliseconds. A power of two.
pub const fn frames_waiting(events: usize) -> usize {
    match events.checked_next_power_of_two() {
        Some(places) if places < 32 => places,
        _ => 32,
    }
}

/// Outcomes that wait to be taken in. The soft and the non real-time mailbox are idle until theirs was, so there is one of
/// each; of hard real-time frames there are more if the event half is late. A power of two.
pub const fn outcomes_waiting(slots: usize) -> usize {
    if slots == 0 { 2 } else { 8 }
}

/// Frames of the clock that wait to be taken in. Hard real-time frames go into their buffers.
pub const URGENT_WAITING: usize = 4;

/// What was stated, if anything was, before what is usual: the first of these.
#[doc(hidden)]
pub const fn stated_or_usual(numbers: &[usize]) -> usize {
    match numbers.first() {
        Some(&number) => number,
        None => 0,
    }
}

/// Notices of the dispatcher that wait to be taken in: a slot may have four before the event half is there. A power of
/// two, or none where there are no slots.
pub const fn notices_waiting(slots: usize) -> usize {
    match slots.saturating_mul(4).checked_next_power_of_two() {
        Some(places) if slots > 0 => places,
        _ => 0,
    }
}

impl<
    const SLOTS: usize,
    const CHANNELS: usize,
    const SUBSCRIPTIONS: usize,
    const EVENTS: usize,
    const SOFT: usize,
    const NRT: usize,
    const FRAMES: usize,
    const OUTCOMES: usize,
    const NOTICES: usize,
    const EXCEPTIONS: usize,
    const URGENT: usize,
> Capacity
    for Sizes<
        SLOTS,
        CHANNELS,
        SUBSCRIPTIONS,
        EVENTS,
        SOFT,
        NRT,
        FRAMES,
        OUTCOMES,
        NOTICES,
        EXCEPTIONS,
        URGENT,
    >
{
    type Buffers = HrtBuffers<SLOTS>;
    type Dispatcher = Dispatcher<SLOTS>;
    type Half<S: Services, H: HardAccess<Self::Buffers>> =
        EventHalf<SLOTS, CHANNELS, SUBSCRIPTIONS, EVENTS, SOFT, NRT, S, H, &'static Declared, EXCEPTIONS>;

    const BUFFERS: Self::Buffers = HrtBuffers::new(GlobalClock::unsynchronised());

    fn dispatcher(calendar: &Calendar) -> Self::Dispatcher {
        Dispatcher::new(calendar)
    }

    fn half<S: Services, H: HardAccess<Self::Buffers>>(
        tx_node: Option<TxNode>,
        calendar: &'static Calendar,
        services: S,
        hard: H,
    ) -> Self::Half<S, H> {
        EventHalf::new(tx_node, calendar, services, hard)
    }

    fn set_clock(buffers: &mut Self::Buffers, clock: GlobalClock) {
        buffers.set_clock(clock);
    }

    #[inline]
    fn dispatch(
        dispatcher: &mut Self::Dispatcher,
        now: Instant,
        buffers: &mut Self::Buffers,
    ) -> hard::CalendarStep {
        dispatcher.poll(now, buffers)
    }

    #[inline]
    fn receive(frame: &Frame, at: Instant, hard: &mut impl HardAccess<Self::Buffers>) -> Option<Input> {
        receive(frame, at, hard)
    }

    #[inline]
    fn outcome(
        mailbox: Mailbox,
        what: Outcome,
        at: Instant,
        hard: &mut impl HardAccess<Self::Buffers>,
    ) -> Option<Input> {
        outcome(mailbox, what, at, hard)
    }
}

mod sealed {
    pub trait Sealed {}

    impl<
        const SLOTS: usize,
        const CHANNELS: usize,
        const SUBSCRIPTIONS: usize,
        const EVENTS: usize,
        const SOFT: usize,
        const NRT: usize,
        const FRAMES: usize,
        const OUTCOMES: usize,
        const NOTICES: usize,
        const EXCEPTIONS: usize,
        const URGENT: usize,
    > Sealed
        for super::Sizes<
            SLOTS,
            CHANNELS,
            SUBSCRIPTIONS,
            EVENTS,
            SOFT,
            NRT,
            FRAMES,
            OUTCOMES,
            NOTICES,
            EXCEPTIONS,
            URGENT,
        >
    {
    }
}

/// Names a [`Capacity`].
///
/// Two numbers may be left out: `exceptions`, that wait for the application, are as many as non real-time events otherwise;
/// a node that fetches none says zero, and they are only counted. `urgent: 0` is for a node without slots whose services do
/// not [hear the clock](crate::services::Services::HEARS_CLOCK): it has no task for the urgent FIFO, and no queue.
///
/// ```
/// cosmic_core::capacity! {
///     /// What the robot's nodes have room for.
///     pub Robot {
///         slots: 4,
///         channels: 8,
///         subscriptions: 8,
///         events: 32,
///         soft: 8,
///         non_real_time: 8,
///     }
/// }
/// ```
#[macro_export]
macro_rules! capacity {
    (
        $(#[$attribute:meta])*
        $visibility:vis $name:ident {
            slots: $slots:expr,
            channels: $channels:expr,
            subscriptions: $subscriptions:expr,
            events: $events:expr,
            soft: $soft:expr,
            non_real_time: $non_real_time:expr
            $(, exceptions: $exceptions:expr)?
            $(, urgent: $urgent:expr)? $(,)?
        }
    ) => {
        $(#[$attribute])*
        $visibility type $name = $crate::event_half::Sizes<
            { $slots },
            { $channels },
            { $subscriptions },
            { $events },
            { $soft },
            { $non_real_time },
            { $crate::event_half::frames_waiting($events) },
            { $crate::event_half::outcomes_waiting($slots) },
            { $crate::event_half::notices_waiting($slots) },
            { $crate::event_half::stated_or_usual(&[$($exceptions,)? $non_real_time]) },
            { $crate::event_half::stated_or_usual(&[$($urgent,)? $crate::event_half::URGENT_WAITING]) },
        >;
    };
}

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
    D: Borrow<Declared> + From<&'static Declared> + Copy,
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
