//! How interrupts and the calendar task hand over to the event-triggered half: one queue without locks
//! for each, and a signal that wakes it.

use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use cosmic_core::event_half::{Capacity, Input, Sizes};
use cosmic_core::time::Instant;

use crate::signal::Signal;
use crate::spsc::{Consumer, Producer, Queue};

/// Something for the event-triggered half, and when it happened.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Item {
    pub(crate) input: Input,
    pub(crate) at: Instant,
}

/// A capacity whose queues between interrupts and the event task have their places: each that
/// [`capacity!`](cosmic_core::capacity) names.
pub trait Queued: Capacity {
    /// The queues, before they are split.
    type Queues: Send + 'static;

    /// Nothing waits.
    const EMPTY: Self::Queues;

    /// Takes the queues apart. Once, since it borrows them for good.
    fn split(queues: &'static mut Self::Queues) -> Ends;
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
> Queued for Sizes<SLOTS, CHANNELS, SUBSCRIPTIONS, EVENTS, SOFT, NRT, FRAMES, OUTCOMES, NOTICES>
{
    type Queues = Queues<FRAMES, OUTCOMES, NOTICES>;

    #[expect(clippy::declare_interior_mutable_const, reason = "what a static begins with")]
    const EMPTY: Self::Queues = Queues::new();

    fn split(queues: &'static mut Self::Queues) -> Ends {
        queues.split()
    }
}

/// The queues, before they are split.
pub struct Queues<const FRAMES: usize, const OUTCOMES: usize, const NOTICES: usize> {
    frames: Queue<Item, FRAMES>,
    urgent: Queue<Item, URGENT>,
    outcomes: Queue<Item, OUTCOMES>,
    notices: Queue<Item, NOTICES>,
    counts: Counts,
    wake_calendar: Signal,
}

/// Frames of the urgent FIFO that wait: those of the clock. Hard real-time frames go into their buffers.
const URGENT: usize = 4;

/// Wakes the event task.
pub(crate) struct Wake {
    signal: Signal,
    due: AtomicBool,
}

impl Wake {
    const fn new() -> Self {
        Self { signal: Signal::new(), due: AtomicBool::new(false) }
    }

    /// Something may be due, or earlier than was said.
    #[inline]
    pub(crate) fn something_due(&self) {
        self.due.store(true, Ordering::Relaxed);
        self.signal.raise();
    }
}

/// What is counted on the way to the event-triggered half, and what wakes it.
struct Counts {
    wake: Wake,
    /// Items that found their queue full.
    lost: AtomicU32,
    /// Overruns of receive FIFOs.
    overruns: AtomicU32,
    /// Times that the controller left the bus.
    times_off: AtomicU32,
}

/// What was counted since the last call.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct Counted {
    pub(crate) lost: u32,
    pub(crate) overruns: u32,
    pub(crate) times_off: u32,
}

/// The end of a queue that one interrupt or task writes.
pub(crate) struct Sender {
    queue: Producer<Item>,
    counts: &'static Counts,
}

/// Counts how often the controller left the bus.
pub(crate) struct BusOffSender {
    counts: &'static Counts,
}

/// All that the event-triggered half receives.
pub(crate) struct Inbox {
    frames: Consumer<Item>,
    urgent: Consumer<Item>,
    outcomes: Consumer<Item>,
    notices: Consumer<Item>,
    counts: &'static Counts,
}

/// The ends of the queues, for their owners.
pub struct Ends {
    pub(crate) frames: Sender,
    pub(crate) urgent: Sender,
    pub(crate) outcomes: Sender,
    pub(crate) notices: Sender,
    pub(crate) bus_off: BusOffSender,
    /// Wakes the event-triggered half.
    pub(crate) wake: &'static Wake,
    pub(crate) inbox: Inbox,
    /// Wakes the calendar task, to look at the slots again.
    pub(crate) wake_calendar: &'static Signal,
}

impl<const FRAMES: usize, const OUTCOMES: usize, const NOTICES: usize> Queues<FRAMES, OUTCOMES, NOTICES> {
    const fn new() -> Self {
        Self {
            frames: Queue::new(),
            urgent: Queue::new(),
            outcomes: Queue::new(),
            notices: Queue::new(),
            counts: Counts {
                wake: Wake::new(),
                lost: AtomicU32::new(0),
                overruns: AtomicU32::new(0),
                times_off: AtomicU32::new(0),
            },
            wake_calendar: Signal::new(),
        }
    }

    fn split(&'static mut self) -> Ends {
        let (frames_in, frames) = self.frames.split();
        let (urgent_in, urgent) = self.urgent.split();
        let (outcomes_in, outcomes) = self.outcomes.split();
        let (notices_in, notices) = self.notices.split();
        let (counts, wake_calendar) = (&self.counts, &self.wake_calendar);
        let sender = |queue| Sender { queue, counts };
        Ends {
            frames: sender(frames_in),
            urgent: sender(urgent_in),
            outcomes: sender(outcomes_in),
            notices: sender(notices_in),
            bus_off: BusOffSender { counts },
            inbox: Inbox { frames, urgent, outcomes, notices, counts },
            wake: &counts.wake,
            wake_calendar,
        }
    }
}

impl Sender {
    /// Hands something over and wakes the receiver. When the queue is full it is lost, and counted.
    #[inline]
    pub(crate) fn send(&mut self, input: Input, at: Instant) {
        if !self.queue.put(Item { input, at }) {
            self.counts.lost.fetch_add(1, Ordering::Relaxed);
            self.counts.wake.something_due();
        }
        self.counts.wake.signal.raise();
    }

    /// Counts overruns of the FIFO that this is of.
    #[inline]
    pub(crate) fn count_overruns(&mut self, times: u32) {
        if times > 0 {
            self.counts.overruns.fetch_add(times, Ordering::Relaxed);
            self.counts.wake.something_due();
        }
    }
}

impl BusOffSender {
    pub(crate) fn count(&mut self) {
        self.counts.times_off.fetch_add(1, Ordering::Relaxed);
        self.wake();
    }

    pub(crate) fn wake(&mut self) {
        self.counts.wake.something_due();
    }
}

impl Inbox {
    /// Hands on the next thing, if there is one: outcomes first, since a mailbox is idle until its outcome is known; frames
    /// last.
    #[inline]
    pub(crate) fn take<R>(&mut self, look: impl FnOnce(&Item) -> R) -> Option<R> {
        let Self { frames, urgent, outcomes, notices, .. } = self;
        // Which one is found first, so that what is done with it stands in the program once.
        [outcomes, notices, urgent, frames].into_iter().find(|queue| queue.has_item())?.take(look)
    }

    /// Waits until something may have arrived.
    pub(crate) fn wait(&mut self) -> impl Future<Output = ()> {
        self.counts.wake.signal.wait()
    }

    /// Returns whether something may be due, or earlier than was said, since the last call.
    #[inline]
    pub(crate) fn take_due(&mut self) -> bool {
        // What comes between the two stays, and has woken again.
        let due = &self.counts.wake.due;
        due.load(Ordering::Relaxed) && due.swap(false, Ordering::Relaxed)
    }

    /// What was counted since the last call.
    #[inline]
    pub(crate) fn take_counted(&mut self) -> Counted {
        // Hardly ever is there any.
        let take = |count: &AtomicU32| match count.load(Ordering::Relaxed) {
            0 => 0,
            _ => count.swap(0, Ordering::Relaxed),
        };
        let Counts { lost, overruns, times_off, .. } = self.counts;
        Counted { lost: take(lost), overruns: take(overruns), times_off: take(times_off) }
    }
}
