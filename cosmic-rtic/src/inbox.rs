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
    wake: Signal,
    wake_calendar: Signal,
    lost: AtomicU32,
    times_off: AtomicU32,
}

/// The end of a queue that one interrupt or task writes.
pub(crate) struct Sender {
    queue: Producer<Item>,
    wake: &'static Signal,
    lost: &'static AtomicU32,
}

/// Counts how often the controller left the bus.
pub(crate) struct BusOffSender {
    wake: &'static Signal,
    times_off: &'static AtomicU32,
}

/// All that the event-triggered half receives.
pub(crate) struct Inbox {
    frames: Consumer<Item>,
    urgent: Consumer<Item>,
    outcomes: Consumer<Item>,
    notices: Consumer<Item>,
    wake: &'static Signal,
    lost: &'static AtomicU32,
    times_off: &'static AtomicU32,
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
            wake: Signal::new(),
            wake_calendar: Signal::new(),
            lost: AtomicU32::new(0),
            times_off: AtomicU32::new(0),
        }
    }

    /// Takes the queues apart. Once, since it borrows them for good.
    pub(crate) fn split(&'static mut self) -> Ends {
        let (frames_in, frames) = self.frames.split();
        let (urgent_in, urgent) = self.urgent.split();
        let (outcomes_in, outcomes) = self.outcomes.split();
        let (notices_in, notices) = self.notices.split();
        let (wake, wake_calendar) = (&self.wake, &self.wake_calendar);
        let (lost, times_off) = (&self.lost, &self.times_off);
        let sender = |queue| Sender { queue, wake, lost };
        Ends {
            frames: sender(frames_in),
            urgent: sender(urgent_in),
            outcomes: sender(outcomes_in),
            notices: sender(notices_in),
            bus_off: BusOffSender { wake, times_off },
            inbox: Inbox { frames, urgent, outcomes, notices, wake, lost, times_off },
            wake,
            wake_calendar,
        }
    }
}

impl Sender {
    /// Hands something over and wakes the receiver. When the queue is full it is lost, and counted.
    #[inline]
    pub(crate) fn send(&mut self, input: Input, at: Instant) {
        if !self.queue.put(Item { input, at }) {
            self.count_lost(1);
        }
        self.wake.raise();
    }

    /// Counts what was lost before it got here.
    #[inline]
    pub(crate) fn count_lost(&mut self, times: u32) {
        if times > 0 {
            self.lost.fetch_add(times, Ordering::Relaxed);
            self.wake.raise();
        }
    }
}

impl BusOffSender {
    pub(crate) fn count(&mut self) {
        self.times_off.fetch_add(1, Ordering::Relaxed);
        self.wake.raise();
    }

    pub(crate) fn wake(&mut self) {
        self.wake.raise();
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
        self.wake.wait()
    }

    /// How many things were lost because a queue or FIFO was full, since the last call.
    #[inline]
    pub(crate) fn take_lost(&mut self) -> u32 {
        self.lost.swap(0, Ordering::Relaxed)
    }

    /// How often the controller left the bus since the last call.
    #[inline]
    pub(crate) fn take_times_off(&mut self) -> u32 {
        self.times_off.swap(0, Ordering::Relaxed)
    }
}
