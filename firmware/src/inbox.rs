//! How interrupts and the calendar task hand over to the event-triggered half: one queue without locks
//! for each, and a signal that wakes it.

use core::sync::atomic::{AtomicU32, Ordering};

use cosmic_core::Input;
use cosmic_core::time::Instant;
use heapless::spsc::{Consumer, Producer, Queue};
use rtic_sync::signal::{Signal, SignalReader, SignalWriter};

/// Something for the event-triggered half, and when it happened.
#[derive(Clone, Copy, Debug)]
pub struct Item {
    /// What.
    pub input: Input,
    /// When.
    pub at: Instant,
}

/// The queues, before they are split. One for each app, in the `local` resources of its `init`.
pub struct Storage {
    frames: Queue<Item, 32>,
    urgent: Queue<Item, 8>,
    outcomes: Queue<Item, 8>,
    notices: Queue<Item, 16>,
    wake: Signal<()>,
    wake_calendar: Signal<()>,
    lost: AtomicU32,
}

/// The end of a queue that one interrupt or task writes.
pub struct Sender {
    queue: Producer<'static, Item>,
    wake: SignalWriter<'static, ()>,
    lost: &'static AtomicU32,
}

/// All that the event-triggered half receives.
pub struct Inbox {
    frames: Consumer<'static, Item>,
    urgent: Consumer<'static, Item>,
    outcomes: Consumer<'static, Item>,
    notices: Consumer<'static, Item>,
    wake: SignalReader<'static, ()>,
    lost: &'static AtomicU32,
}

/// The ends of the queues, for their owners.
pub struct Ends {
    /// For `CAN1_RX1`.
    pub frames: Sender,
    /// For `CAN1_RX0`: what is not hard real-time.
    pub urgent: Sender,
    /// For `CAN1_TX`.
    pub outcomes: Sender,
    /// For the calendar task.
    pub notices: Sender,
    /// For the application: wakes the event-triggered half.
    pub wake: SignalWriter<'static, ()>,
    /// For the event-triggered half.
    pub inbox: Inbox,
    /// For the application: wakes the calendar task, to look at the slots again.
    pub wake_calendar: SignalWriter<'static, ()>,
    /// For the calendar task.
    pub calendar_wakes: SignalReader<'static, ()>,
}

impl Storage {
    /// Empty queues.
    pub const fn new() -> Self {
        Self {
            frames: Queue::new(),
            urgent: Queue::new(),
            outcomes: Queue::new(),
            notices: Queue::new(),
            wake: Signal::new(),
            wake_calendar: Signal::new(),
            lost: AtomicU32::new(0),
        }
    }

    /// Takes the queues apart.
    pub fn split(&'static mut self) -> Ends {
        let (frames_in, frames) = self.frames.split();
        let (urgent_in, urgent) = self.urgent.split();
        let (outcomes_in, outcomes) = self.outcomes.split();
        let (notices_in, notices) = self.notices.split();
        let (wake, reader) = self.wake.split();
        let (wake_calendar, calendar_wakes) = self.wake_calendar.split();
        let lost = &self.lost;
        let sender = |queue| Sender { queue, wake: wake.clone(), lost };
        Ends {
            frames: sender(frames_in),
            urgent: sender(urgent_in),
            outcomes: sender(outcomes_in),
            notices: sender(notices_in),
            inbox: Inbox { frames, urgent, outcomes, notices, wake: reader, lost },
            wake,
            wake_calendar,
            calendar_wakes,
        }
    }
}

impl Default for Storage {
    fn default() -> Self {
        Self::new()
    }
}

impl Sender {
    /// Hands something over and wakes the receiver. When the queue is full it is lost, and counted.
    #[inline]
    pub fn send(&mut self, input: Input, at: Instant) {
        if self.queue.enqueue(Item { input, at }).is_err() {
            self.count_lost(1);
        }
        self.wake.write(());
    }

    /// Counts what was lost before it got here.
    #[inline]
    pub fn count_lost(&mut self, times: u32) {
        if times > 0 {
            self.lost.fetch_add(times, Ordering::Relaxed);
        }
    }
}

impl Inbox {
    /// The next thing: outcomes first, since a mailbox is idle until its outcome is known; frames last.
    #[inline]
    pub fn take(&mut self) -> Option<Item> {
        let Self { frames, urgent, outcomes, notices, .. } = self;
        [outcomes, notices, urgent, frames].into_iter().find_map(Consumer::dequeue)
    }

    /// Waits until something may have arrived.
    pub async fn wait(&mut self) {
        self.wake.wait().await;
    }

    /// How many things were lost because a queue or FIFO was full, since the last call.
    pub fn take_lost(&mut self) -> u32 {
        self.lost.swap(0, Ordering::Relaxed)
    }
}
