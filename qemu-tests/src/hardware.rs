//! A CAN controller as an application sees it: mailboxes, two receive FIFOs and three interrupts.
//!
//! Behind it is the [`Controller`] model. The application has a task of a priority above all its own that
//! calls [`advance`](CanHardware::advance) at the instants that [`next_event`](CanHardware::next_event)
//! names; from there on everything goes by interrupts, as on a chip.

use cortex_m::peripheral::NVIC;
use cosmic_core::can::{BitRate, Command, Frame, Mailbox, Outcome, Priority};
use cosmic_core::time::Instant;
use heapless::Deque;

use crate::controller::{Controller, Sender, Sent};
use crate::device::Interrupt;

/// Something is in receive FIFO 0: hard real-time frames.
pub const RX0: Interrupt = Interrupt::GPIO0_4;
/// A mailbox has an outcome.
pub const TX: Interrupt = Interrupt::GPIO0_5;
/// Something is in receive FIFO 1: all other frames.
pub const RX1: Interrupt = Interrupt::GPIO0_6;

/// A controller with its interrupts, on a bus with a peer.
pub struct CanHardware {
    controller: Controller,
    outcomes: [Option<Outcome>; 3],
    fifos: [Deque<Frame, FIFO_DEPTH>; 2],
    lost: [u32; 2],
    sent: [u32; 3],
}

/// Frames that a receive FIFO holds.
pub const FIFO_DEPTH: usize = 3;

impl CanHardware {
    /// A controller on an idle bus.
    pub const fn new(bit_rate: BitRate) -> Self {
        Self {
            controller: Controller::new(bit_rate),
            outcomes: [None; 3],
            fifos: [Deque::new(), Deque::new()],
            lost: [0; 2],
            sent: [0; 3],
        }
    }

    /// Carries a command out; the outcome comes with the interrupt [`TX`].
    pub fn execute(&mut self, command: Command, now: Instant) {
        if let Some((mailbox, outcome)) = self.controller.execute(command, now) {
            self.set_outcome(mailbox, outcome);
        }
    }

    /// The peer wants to send a frame.
    pub fn peer_sends(&mut self, frame: Frame, now: Instant) {
        self.controller.peer_sends(frame, now);
    }

    /// What became of a frame that was loaded into this mailbox.
    pub fn take_outcome(&mut self, mailbox: Mailbox) -> Option<Outcome> {
        self.outcomes[mailbox as usize].take()
    }

    /// The oldest frame in FIFO 0 or 1.
    pub fn receive(&mut self, fifo: usize) -> Option<Frame> {
        self.fifos[fifo].pop_front()
    }

    /// How many received frames were lost since the last call because the FIFO was full.
    pub fn take_losses(&mut self, fifo: usize) -> u32 {
        core::mem::take(&mut self.lost[fifo])
    }

    /// How many frames were sent from a mailbox.
    pub fn sent(&self, mailbox: Mailbox) -> u32 {
        self.sent[mailbox as usize]
    }

    /// When [`advance`](Self::advance) has to be called next.
    pub fn next_event(&self) -> Instant {
        self.controller.next_event()
    }

    /// What has happened on the bus by `now` becomes visible, with its interrupts.
    pub fn advance(&mut self, now: Instant) {
        while let Some(Sent { from, frame, .. }) = self.controller.advance(now) {
            match from {
                Sender::Mailbox(mailbox) => self.set_outcome(mailbox, Outcome::Sent),
                Sender::Peer => {
                    let (fifo, interrupt) =
                        if frame.id.priority() == Priority::HARD { (0, RX0) } else { (1, RX1) };
                    if self.fifos[fifo].push_back(frame).is_err() {
                        self.lost[fifo] += 1;
                    }
                    NVIC::pend(interrupt);
                }
            }
        }
    }

    fn set_outcome(&mut self, mailbox: Mailbox, outcome: Outcome) {
        self.sent[mailbox as usize] += u32::from(outcome == Outcome::Sent);
        self.outcomes[mailbox as usize] = Some(outcome);
        NVIC::pend(TX);
    }
}
