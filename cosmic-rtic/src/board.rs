//! What a board must give: time, three transmit mailboxes, two receive FIFOs, the error state of its CAN
//! controller. Values only, no protocol.
//!
//! A board is brought up by its own crate, with the bit rate and the acceptance filters that the node's
//! [plan](cosmic_core::plan::NodePlan) names. From then on the runtime owns it, part by part: each part belongs to
//! one task or interrupt, so that none needs a lock.

use core::future::poll_fn;
use core::pin::pin;
use core::task::Poll;

use cosmic_core::can::filter_banks::Wanted;
use cosmic_core::can::{ErrorCounters, Frame, Mailbox, Outcome};
use cosmic_core::time::Instant;

/// A board with one CAN controller.
pub trait Board: Sized + 'static {
    /// The transmit mailbox of the calendar.
    type Hard: TxMailbox;
    /// The transmit mailbox of the EDF queue.
    type Soft: TxMailbox;
    /// The transmit mailbox of the non real-time queue.
    type NonRealTime: TxMailbox;
    /// Tells what became of loaded frames.
    type Outcomes: TxOutcomes;
    /// The receive FIFO that [`Fifo::Urgent`](cosmic_core::can::filter_banks::Fifo::Urgent) filters fill.
    type Urgent: RxFifo;
    /// The receive FIFO that [`Fifo::Other`](cosmic_core::can::filter_banks::Fifo::Other) filters fill.
    type Other: RxFifo;
    /// Reads the error counters.
    type Status: BusStatus;
    /// Tells that the error state has become worse.
    type Changes: BusChanges;
    /// Takes what the controller is to accept as the node runs: `()` where its filters cannot change then.
    type Filters: Filters;

    /// Whether the controller, once it is off the bus, waits until it is [asked](BusStatus::ask_to_rejoin) to take part
    /// again: the event task asks, after a pause that grows. If not, it comes back by itself.
    const REJOINS_ON_REQUEST: bool = false;

    /// Local time: free-running, never stepped. Called from every priority up to that of the calendar task.
    fn now() -> Instant;

    /// Waits until local time has reached `instant`; returns at once if it has.
    fn delay_until(instant: Instant) -> impl Future<Output = ()>;

    /// Waits until local time has reached `instant` or `other` has ended. A board whose timer can do both in one
    /// spares the calendar task some instructions.
    fn until(instant: Instant, other: impl Future<Output = ()>) -> impl Future<Output = ()> {
        either(other, Self::delay_until(instant))
    }

    /// As [`until`](Self::until), for the calendar task: a timer may have a way of its own for it, which is shorter.
    fn calendar_until(instant: Instant, other: impl Future<Output = ()>) -> impl Future<Output = ()> {
        Self::until(instant, other)
    }

    /// Takes the board apart.
    fn split(self) -> BoardParts<Self>;
}

/// The parts of a board, each for one owner.
pub struct BoardParts<B: Board> {
    /// For the calendar task.
    pub hard: B::Hard,
    /// For the event task.
    pub soft: B::Soft,
    /// For the event task.
    pub non_real_time: B::NonRealTime,
    /// For the transmit interrupt.
    pub outcomes: B::Outcomes,
    /// For the interrupt of the urgent FIFO.
    pub urgent: B::Urgent,
    /// For the interrupt of the other FIFO.
    pub other: B::Other,
    /// For the event task.
    pub status: B::Status,
    /// For the status change interrupt.
    pub changes: B::Changes,
    /// For the event task.
    pub filters: B::Filters,
}

/// One transmit mailbox. No method waits.
pub trait TxMailbox {
    /// Puts a frame into the mailbox, which is empty, and requests its transmission.
    fn load(&mut self, frame: &Frame);

    /// Requests that the frame be withdrawn; an empty mailbox ignores it. The outcome tells what became of it.
    fn withdraw(&mut self);
}

/// What became of loaded frames.
pub trait TxOutcomes {
    /// The outcome of one mailbox whose frame is done, which is thereby acknowledged; `None` if there is none.
    fn take(&mut self) -> Option<(Mailbox, Outcome)>;
}

/// A receive FIFO.
pub trait RxFifo {
    /// So many frames an interrupt reads at most. It comes again if there are more.
    const AT_ONCE: usize;

    /// The next frame, if there is one.
    fn read(&mut self) -> Option<Frame>;

    /// How many times one frame or more were lost since the last call because the FIFO was full.
    fn take_losses(&mut self) -> u32;
}

/// The error state of the controller.
pub trait BusStatus {
    /// The error counters as they are now.
    fn errors(&self) -> ErrorCounters;

    /// Returns whether the controller is off the bus.
    fn is_off(&self) -> bool {
        false
    }

    /// Takes a step of the request to take part again, without waiting for it, and returns whether it was the last. The
    /// steps are a millisecond apart.
    fn ask_to_rejoin(&mut self) -> bool {
        true
    }
}

/// Changes of the error state.
pub trait BusChanges {
    /// Acknowledges what has changed, and returns whether the controller has left the bus since the last call.
    fn take_bus_off(&mut self) -> bool;
}

/// The acceptance filters of the controller, of a node that is [named at run
/// time](cosmic_core::plan::NodePlan::named_at_run_time).
pub trait Filters {
    /// From now on accepts what is wanted, beside what the plan names; perhaps more, never less. A frame that was wanted
    /// before as it is now is accepted all the while. Does not wait.
    fn set(&mut self, wanted: impl Iterator<Item = Wanted>);
}

/// Filters that stay as they are: such a controller must accept all that may be wanted from the start.
impl Filters for () {
    fn set(&mut self, _: impl Iterator<Item = Wanted>) {}
}

/// Resets the node unless it is fed in time.
pub trait Watchdog {
    /// It starts to count anew.
    fn feed(&mut self);
}

/// Waits until one of them has ended.
async fn either(one: impl Future<Output = ()>, other: impl Future<Output = ()>) {
    let (mut one, mut other) = (pin!(one), pin!(other));
    poll_fn(|context| {
        if one.as_mut().poll(context).is_ready() || other.as_mut().poll(context).is_ready() {
            Poll::Ready(())
        } else {
            Poll::Pending
        }
    })
    .await;
}
