//! Nodes of any size: for runtimes, which are written once for all of them.

use super::{EventHalf, Half, HardAccess, Input, outcome, receive};
use crate::calendar::Calendar;
use crate::can::{Frame, Mailbox, Outcome, TxNode};
use crate::event_layer::Constant;
use crate::network::hard::{self, Dispatcher, HrtBuffers};
use crate::services::Services;
use crate::time::{GlobalClock, Instant};

/// How much a node has room for, as one type: what [`capacity!`](crate::capacity) names, mostly for a plan.
///
/// A runtime that is generic over it need not know the numbers. Its functions are those of the types that it
/// names. It is sealed: that its functions do no more than the core's own is what lets a runtime lock around them.
pub trait Capacity: 'static {
    /// Only the core can state it.
    #[doc(hidden)]
    const SEAL: sealed::Seal;

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
/// `URGENT` is the same of frames of the clock: [`URGENT_WAITING`], or none. `CONTEXTS` and `RATES` stand at
/// [`Listed`](crate::event_layer::Listed).
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
    const CONTEXTS: bool,
    const RATES: bool,
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

/// What was stated, if anything was, or what is usual.
#[doc(hidden)]
pub const fn stated_or_usual<T: Copy>(stated: &[T], usual: T) -> T {
    match stated.first() {
        Some(&stated) => stated,
        None => usual,
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
    const CONTEXTS: bool,
    const RATES: bool,
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
        CONTEXTS,
        RATES,
    >
{
    const SEAL: sealed::Seal = sealed::Seal;

    type Buffers = HrtBuffers<SLOTS>;
    type Dispatcher = Dispatcher<SLOTS>;
    type Half<S: Services, H: HardAccess<Self::Buffers>> = EventHalf<
        SLOTS,
        CHANNELS,
        SUBSCRIPTIONS,
        EVENTS,
        SOFT,
        NRT,
        S,
        H,
        Constant<CONTEXTS, RATES>,
        EXCEPTIONS,
    >;

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
    /// Has no name outside.
    #[derive(Debug)]
    pub struct Seal;
}

/// Names a [`Capacity`].
///
/// The last four may be left out. Each is for a node that does without something, and then has no code for it:
///
/// - `exceptions`, that wait for the application, are as many as non real-time events otherwise. A node that fetches none
///   says zero, and they are only counted.
/// - `urgent: 0` is for a node without slots whose services do not
///   [hear the clock](crate::services::Services::HEARS_CLOCK): it has no task for the urgent FIFO, and no queue.
/// - `contexts: false`: no event of its channels carries [attributes of context](crate::event_layer::Context), so there
///   is nothing to filter by. Such channels, and filters, are refused.
/// - `rates: false`: nothing holds what it publishes to the [rates](crate::event_layer::EventRate) of its channels, and
///   nobody is told of events that do not come. The plan's promises to soft real-time events of others rest on these
///   rates, so this is for a node that publishes in non real-time only, or whose application paces itself.
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
            $(, urgent: $urgent:expr)?
            $(, contexts: $contexts:expr)?
            $(, rates: $rates:expr)? $(,)?
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
            { $crate::event_half::stated_or_usual(&[$($exceptions)?], $non_real_time) },
            { $crate::event_half::stated_or_usual(&[$($urgent)?], $crate::event_half::URGENT_WAITING) },
            { $crate::event_half::stated_or_usual(&[$($contexts)?], true) },
            { $crate::event_half::stated_or_usual(&[$($rates)?], true) },
        >;
    };
}
