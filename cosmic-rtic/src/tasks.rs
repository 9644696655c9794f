//! What the tasks of every node do. [The crate](crate) says which runs at which priority.

use core::future::poll_fn;
use core::task::Poll;

use cosmic_core::Capacity as _;
use cosmic_core::can::{Command, Mailbox};
use cosmic_core::event_half::{HardAccess as _, Input};
use cosmic_core::network::hard::CalendarStep;
use cosmic_core::time::Instant;
use rtic_core::Mutex;

use crate::board::{Board, BusChanges as _, RxFifo, TxMailbox as _, TxOutcomes as _};
use crate::inbox::{BusOffSender, Inbox, Sender};
use crate::node::Node;
use crate::observer::{CalendarObserver as _, Observer};
use crate::sieve::Sieve;
use crate::signal::Signal;
use crate::system::{Access, Dispatcher, System};

/// The calendar dispatcher and the TTCH, for the task of the highest priority.
pub struct Calendar<T: System> {
    pub(crate) dispatcher: Dispatcher<T>,
    pub(crate) hard: Access<T>,
    pub(crate) mailbox: <T::Board as Board>::Hard,
    pub(crate) notices: Sender,
    pub(crate) wakes: &'static Signal,
    pub(crate) observer: <T::Observer as Observer>::Calendar,
}

/// For the interrupt of the urgent FIFO: hard real-time frames go into their buffers, others to the event task.
pub struct Urgent<T: System> {
    pub(crate) receiver: Receiver<T, <T::Board as Board>::Urgent>,
}

/// For the interrupt of the other FIFO.
pub struct Other<T: System> {
    pub(crate) receiver: Receiver<T, <T::Board as Board>::Other>,
}

pub(crate) struct Receiver<T: System, F> {
    pub(crate) fifo: F,
    pub(crate) hard: Access<T>,
    pub(crate) sieve: &'static Sieve,
    pub(crate) frames: Sender,
}

/// For the transmit interrupt: what became of loaded frames.
pub struct Outcomes<T: System> {
    pub(crate) outcomes: <T::Board as Board>::Outcomes,
    pub(crate) hard: Access<T>,
    pub(crate) left: Sender,
}

/// For the status change interrupt: the controller has left the bus, or is about to.
pub struct Status<T: System> {
    pub(crate) changes: <T::Board as Board>::Changes,
    pub(crate) bus_off: BusOffSender,
}

/// The event-triggered half's own task: takes in what has arrived, and keeps the mailboxes filled.
pub struct Events {
    pub(crate) inbox: Inbox,
}

impl<T: System> Calendar<T> {
    /// From one instant of the calendar to the next, for ever.
    pub async fn run(&mut self) -> ! {
        loop {
            self.observer.running(true);
            let next = self.attend();
            self.observer.running(false);
            // Either will do: the instant has come, or there is another slot.
            T::Board::calendar_until(next, self.wakes.wait()).await;
        }
    }

    #[inline]
    fn attend(&mut self) -> Instant {
        loop {
            let now = T::Board::now();
            let dispatcher = &mut self.dispatcher;
            match self.hard.with(|buffers| T::Capacity::dispatch(dispatcher, now, buffers)) {
                CalendarStep::Command(Command::Load(_, frame)) => self.mailbox.load(&frame),
                CalendarStep::Command(Command::Withdraw(_)) => self.mailbox.withdraw(),
                CalendarStep::Notify(buffer) => {
                    self.observer.notified();
                    self.notices.send(Input::Notice(buffer), now);
                }
                CalendarStep::Continue => {}
                CalendarStep::SleepUntil(instant) => return instant,
            }
        }
    }
}

impl<T: System> Urgent<T> {
    /// Empties the FIFO.
    #[inline]
    pub fn run(&mut self) {
        self.receiver.run();
    }
}

impl<T: System> Other<T> {
    /// Empties the FIFO.
    #[inline]
    pub fn run(&mut self) {
        self.receiver.run();
    }
}

impl<T: System, F: RxFifo> Receiver<T, F> {
    // Out of line: where both FIFOs are of one type, it stands in the program once.
    #[inline(never)]
    fn run(&mut self) {
        for _ in 0..F::AT_ONCE {
            // Before anything else, since this is the time-stamp.
            let received_at = T::Board::now();
            let Some(frame) = self.fifo.read() else { break };
            if let Some(input) = T::Capacity::receive(&frame, received_at, &mut self.hard)
                && self.sieve.passes(frame.id)
            {
                self.frames.send(input, received_at);
            }
        }
        self.frames.count_overruns(self.fifo.take_losses());
    }
}

impl<T: System> Outcomes<T> {
    /// Takes the outcome of each mailbox that is done.
    #[inline]
    pub fn run(&mut self) {
        let at = T::Board::now();
        for _ in Mailbox::ALL {
            let Some((mailbox, outcome)) = self.outcomes.take() else { return };
            if let Some(input) = T::Capacity::outcome(mailbox, outcome, at, &mut self.hard) {
                self.left.send(input, at);
            }
        }
    }
}

impl<T: System> Status<T> {
    /// Takes note of the change.
    #[inline]
    pub fn run(&mut self) {
        if self.changes.take_bus_off() {
            self.bus_off.count();
        } else {
            // The event task reads the counters.
            self.bus_off.wake();
        }
    }
}

impl Events {
    /// Takes in what arrives and does what is due, for ever.
    pub async fn run<T: System>(&mut self, mut node: impl Mutex<T = Node<T>>) -> ! {
        loop {
            let counted = self.inbox.take_counted();
            let next = node.lock(|node| node.attend(&counted, T::Board::now()));
            // An event that goes to its subscribers changes nothing of what is due, nor when: to ask for that, and to set
            // the timer anew, would cost more than all else that is done for it.
            let nothing_due = poll_fn(|context| {
                while let Poll::Ready(raised) = self.inbox.poll(context.waker()) {
                    if self.take_in(raised, &mut node) {
                        return Poll::Ready(());
                    }
                }
                Poll::Pending
            });
            // Either will do: the instant has come, or something may be due.
            T::Board::until(next, nothing_due).await;
        }
    }

    /// Takes in what has arrived. Returns whether something may be due now, or earlier than was said.
    #[inline(never)]
    fn take_in<T: System>(&mut self, raised: u32, node: &mut impl Mutex<T = Node<T>>) -> bool {
        // One lock for each item, so that the application waits for one only.
        self.inbox.take_all(raised, |item| node.lock(|node| node.take_in(item)))
    }
}
