//! How interrupts and the calendar task hand over to the event-triggered half: one queue without locks
//! for each, and a signal that wakes it.

use core::sync::atomic::{AtomicU32, Ordering};

use cosmic_core::event_half::Input;
use cosmic_core::time::Instant;

use crate::signal::Signal;
use crate::spsc::{Consumer, Producer, Queue};

/// Something for the event-triggered half, and when it happened.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Item {
    pub(crate) input: Input,
    pub(crate) at: Instant,
}

/// The queues, before they are split.
pub(crate) struct Queues {
    frames: Queue<Item, 32>,
    urgent: Queue<Item, 8>,
    outcomes: Queue<Item, 8>,
    notices: Queue<Item, 16>,
    counts: Counts,
    wake_calendar: Signal,
}

/// What is counted on the way to the event-triggered half, and what wakes it.
struct Counts {
    wake: Signal,
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
pub(crate) struct Ends {
    pub(crate) frames: Sender,
    pub(crate) urgent: Sender,
    pub(crate) outcomes: Sender,
    pub(crate) notices: Sender,
    pub(crate) bus_off: BusOffSender,
    /// Wakes the event-triggered half.
    pub(crate) wake: &'static Signal,
    pub(crate) inbox: Inbox,
    /// Wakes the calendar task, to look at the slots again.
    pub(crate) wake_calendar: &'static Signal,
}

impl Queues {
    pub(crate) const fn new() -> Self {
        Self {
            frames: Queue::new(),
            urgent: Queue::new(),
            outcomes: Queue::new(),
            notices: Queue::new(),
            counts: Counts {
                wake: Signal::new(),
                lost: AtomicU32::new(0),
                overruns: AtomicU32::new(0),
                times_off: AtomicU32::new(0),
            },
            wake_calendar: Signal::new(),
        }
    }

    /// Takes the queues apart. Once, since it borrows them for good.
    pub(crate) fn split(&'static mut self) -> Ends {
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
        }
        self.counts.wake.raise();
    }

    /// Counts overruns of the FIFO that this is of.
    #[inline]
    pub(crate) fn count_overruns(&mut self, times: u32) {
        if times > 0 {
            self.counts.overruns.fetch_add(times, Ordering::Relaxed);
            self.counts.wake.raise();
        }
    }
}

impl BusOffSender {
    pub(crate) fn count(&mut self) {
        self.counts.times_off.fetch_add(1, Ordering::Relaxed);
        self.wake();
    }

    pub(crate) fn wake(&mut self) {
        self.counts.wake.raise();
    }
}

impl Inbox {
    /// The next thing: outcomes first, since a mailbox is idle until its outcome is known; frames last.
    #[inline]
    pub(crate) fn take(&mut self) -> Option<Item> {
        let Self { frames, urgent, outcomes, notices, .. } = self;
        [outcomes, notices, urgent, frames].into_iter().find_map(Consumer::take)
    }

    /// Waits until something may have arrived.
    pub(crate) fn wait(&mut self) -> impl Future<Output = ()> {
        self.counts.wake.wait()
    }

    /// What was counted since the last call.
    #[inline]
    pub(crate) fn take_counted(&mut self) -> Counted {
        let take = |count: &AtomicU32| count.swap(0, Ordering::Relaxed);
        let Counts { lost, overruns, times_off, .. } = self.counts;
        Counted { lost: take(lost), overruns: take(overruns), times_off: take(times_off) }
    }
}
