//! A station: a controller with three transmit mailboxes, acceptance filters and error counters.

use crate::confinement::{BusOffRecovery, ErrorState};
use crate::filter::Filters;
use crate::frame::{Arbitration, WireFrame};
use crate::time::{FAR_FUTURE, VirtualInstant};
use core::fmt;

/// Transmit mailboxes of a controller, as in bxCAN.
pub const MAILBOXES: usize = 3;

/// A frame was not loaded.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum LoadError {
    /// The mailbox still holds a frame.
    Occupied,
    /// There are only [`MAILBOXES`].
    NoSuchMailbox,
}

impl fmt::Display for LoadError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Occupied => f.write_str("the mailbox is occupied; wait for its Sent or Withdrawn"),
            Self::NoSuchMailbox => write!(f, "no such mailbox; they are numbered 0 to {}", MAILBOXES - 1),
        }
    }
}

impl core::error::Error for LoadError {}

/// A frame in a mailbox.
#[derive(Debug)]
pub(crate) struct Loaded {
    pub(crate) frame: WireFrame,
    /// From start of frame to end of frame.
    pub(crate) bits: u32,
    /// Attempts that failed so far.
    pub(crate) failures: u32,
    /// It is on the wire and is to be dropped if it fails.
    pub(crate) withdrawal_requested: bool,
}

#[derive(Debug)]
pub(crate) struct Station {
    pub(crate) mailboxes: [Option<Loaded>; MAILBOXES],
    pub(crate) filters: Filters,
    pub(crate) errors: ErrorState,
    pub(crate) recovery: BusOffRecovery,
    pub(crate) is_connected: bool,
    /// From here on it receives and acknowledges frames that start.
    pub(crate) listens_from: VirtualInstant,
    /// From here on it may start a frame on a free bus.
    pub(crate) sends_from: VirtualInstant,
}

impl Station {
    pub(crate) fn new(now: VirtualInstant) -> Self {
        Self {
            mailboxes: [const { None }; MAILBOXES],
            filters: Filters::accept_all(),
            errors: ErrorState::NEW,
            recovery: BusOffRecovery::default(),
            is_connected: true,
            listens_from: now,
            sends_from: now,
        }
    }

    /// Takes no part in the traffic from now on.
    pub(crate) const fn silence(&mut self) {
        self.listens_from = FAR_FUTURE;
        self.sends_from = FAR_FUTURE;
    }

    /// Takes part in frames that start at `from` or later.
    pub(crate) const fn take_part_from(&mut self, from: VirtualInstant) {
        self.listens_from = from;
        self.sends_from = from;
    }

    /// The mailbox that the controller sends first: the smallest identifier, then the smallest number.
    pub(crate) fn first_mailbox(&self) -> Option<(Arbitration, usize)> {
        let loaded = self.mailboxes.iter().enumerate();
        loaded.filter_map(|(at, loaded)| Some((loaded.as_ref()?.frame.arbitration(), at))).min()
    }
}
