//! How interrupts and the calendar task hand over to the event-triggered half: one queue without locks
//! for each, and a signal that wakes it and says which of them has something.

use core::sync::atomic::{AtomicU32, Ordering};
use core::task::{Poll, Waker};

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

    /// Places for frames of the clock.
    const URGENT: usize;

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
    const EXCEPTIONS: usize,
    const URGENT: usize,
    const CONTEXTS: bool,
    const RATES: bool,
> Queued
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
    type Queues = Queues<FRAMES, OUTCOMES, NOTICES, URGENT>;

    const URGENT: usize = URGENT;

    #[expect(clippy::declare_interior_mutable_const, reason = "what a static begins with")]
    const EMPTY: Self::Queues = Queues::new();

    fn split(queues: &'static mut Self::Queues) -> Ends {
        queues.split()
    }
}

/// The queues, before they are split.
pub struct Queues<const FRAMES: usize, const OUTCOMES: usize, const NOTICES: usize, const URGENT: usize> {
    frames: Queue<Item, FRAMES>,
    urgent: Queue<Item, URGENT>,
    outcomes: Queue<Item, OUTCOMES>,
    notices: Queue<Item, NOTICES>,
    counts: Counts,
    wake_calendar: Signal,
}

/// Wakes the event task. The bits are the numbers of the queues in the inbox, and [`DUE`].
pub(crate) struct Wake {
    signal: Signal,
}

impl Wake {
    const fn new() -> Self {
        Self { signal: Signal::new() }
    }

    /// Something may be due, or earlier than was said.
    #[inline(never)]
    pub(crate) fn something_due(&self) {
        self.signal.raise(DUE);
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
    /// The bit of the queue.
    bit: u32,
    counts: &'static Counts,
}

/// Counts how often the controller left the bus.
pub(crate) struct BusOffSender {
    counts: &'static Counts,
}

/// All that the event-triggered half receives.
pub(crate) struct Inbox {
    /// In the order in which they are looked at: outcomes first, since a mailbox is idle until its outcome is known; frames
    /// last.
    queues: [Consumer<Item>; 4],
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

impl<const FRAMES: usize, const OUTCOMES: usize, const NOTICES: usize, const URGENT: usize>
    Queues<FRAMES, OUTCOMES, NOTICES, URGENT>
{
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
        let sender = |queue, number: u32| Sender { queue, bit: 1 << number, counts };
        Ends {
            outcomes: sender(outcomes_in, 0),
            notices: sender(notices_in, 1),
            urgent: sender(urgent_in, 2),
            frames: sender(frames_in, 3),
            bus_off: BusOffSender { counts },
            inbox: Inbox { queues: [outcomes, notices, urgent, frames], counts },
            wake: &counts.wake,
            wake_calendar,
        }
    }
}

impl Sender {
    /// Hands something over and wakes the receiver. When the queue is full it is lost, and counted.
    #[inline]
    pub(crate) fn send(&mut self, input: Input, at: Instant) {
        let mut bits = self.bit;
        if !self.queue.put(Item { input, at }) {
            self.counts.lost.fetch_add(1, Ordering::Relaxed);
            bits |= DUE;
        }
        self.counts.wake.signal.raise(bits);
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
    /// Takes what was raised since the last call: for [`take_all`](Self::take_all). If that is nothing, what is raised next
    /// wakes the task.
    #[inline]
    pub(crate) fn poll(&self, waker: &Waker) -> Poll<u32> {
        self.counts.wake.signal.poll(waker)
    }

    /// Hands on all that has arrived, one after the other. Returns whether something may be due, or earlier than was said:
    /// it was raised, or `look` says so.
    #[inline]
    pub(crate) fn take_all(&mut self, mut raised: u32, mut look: impl FnMut(&Item) -> bool) -> bool {
        let mut is_due = false;
        // Ends: a turn hands on an item or clears a bit, and none is raised without an item.
        loop {
            let number = raised.trailing_zeros();
            let Some(queue) = self.queues.get_mut(number as usize) else { break };
            match queue.take(&mut look) {
                Some(due) => {
                    is_due |= due;
                    raised |= self.counts.wake.signal.take();
                }
                None => raised &= !(1 << number),
            }
        }
        is_due || raised & DUE != 0
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

/// Behind the numbers of the queues.
const DUE: u32 = 1 << 4;

#[cfg(test)]
mod tests {
    use super::*;
    use cosmic_core::can::{Mailbox, Outcome};
    use std::boxed::Box;
    use std::vec::Vec;

    const NOW: Instant = Instant::EPOCH;

    fn taken(inbox: &mut Inbox, mut meanwhile: impl FnMut()) -> (bool, Vec<Input>) {
        let mut inputs = Vec::new();
        let Poll::Ready(raised) = inbox.poll(Waker::noop()) else { return (false, inputs) };
        let is_due = inbox.take_all(raised, |item| {
            inputs.push(item.input);
            meanwhile();
            false
        });
        (is_due, inputs)
    }

    #[test]
    fn what_comes_meanwhile_is_taken_in_its_order() {
        let Ends { mut frames, mut outcomes, mut inbox, wake, .. } =
            Box::leak(Box::new(Queues::<8, 4, 4, 4>::new())).split();
        assert_eq!(taken(&mut inbox, || ()), (false, Vec::new()));
        // The numbers stand for frames.
        frames.send(Input::Lost(1), NOW);
        frames.send(Input::Lost(2), NOW);
        let sent = Input::Outcome(Mailbox::Soft, Outcome::Sent);
        let mut first = true;
        let (is_due, inputs) = taken(&mut inbox, || {
            if core::mem::take(&mut first) {
                outcomes.send(sent, NOW);
                wake.something_due();
            }
        });
        assert_eq!(inputs, [Input::Lost(1), sent, Input::Lost(2)]);
        assert!(is_due, "it was raised meanwhile");
        frames.send(Input::Lost(3), NOW);
        assert_eq!(taken(&mut inbox, || ()), (false, [Input::Lost(3)].to_vec()));
    }

    #[test]
    fn what_is_lost_is_counted_and_due() {
        let Ends { mut urgent, mut inbox, .. } = Box::leak(Box::new(Queues::<8, 4, 4, 4>::new())).split();
        (0..6).for_each(|number| urgent.send(Input::Lost(number), NOW));
        let (is_due, inputs) = taken(&mut inbox, || ());
        assert_eq!((is_due, inputs.len()), (true, 4));
        assert_eq!(inbox.take_counted(), Counted { lost: 2, overruns: 0, times_off: 0 });
    }
}
