//! What the middleware asks of a CAN controller, as values.
//!
//! A controller offers three transmit mailboxes, one for each class, so that an urgent frame never
//! waits inside the node behind a less urgent one; among loaded mailboxes the controller sends the
//! smallest identifier first. The middleware issues [`Command`]s; the driver carries them out at once,
//! without waiting, and later reports one [`Outcome`] for every `Load`.

use super::Frame;

/// One transmit mailbox for each class.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
// So wide that a command has no gap before its frame: what has one is copied by bytes, at 150 instructions.
#[repr(u16)]
pub enum Mailbox {
    /// Hard real-time; touched by the time-triggered half only.
    Hard = 0,
    /// Soft real-time: the head of the EDF queue.
    Soft = 1,
    /// Non real-time.
    NonRealTime = 2,
}

impl Mailbox {
    /// All of them, in the order of their numbers.
    pub const ALL: [Self; 3] = [Self::Hard, Self::Soft, Self::NonRealTime];
}

/// What a driver is to do with a transmit mailbox.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[must_use]
pub enum Command {
    /// Put the frame into the mailbox, which is empty, and request its transmission.
    Load(Mailbox, Frame),
    /// Request that the frame be withdrawn. A pending frame leaves the mailbox; one that is on the wire
    /// completes, or is dropped if it fails. The outcome tells which; nobody waits for it here.
    Withdraw(Mailbox),
}

/// What became of a loaded frame. Exactly one outcome follows each [`Command::Load`].
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Outcome {
    /// It was sent and acknowledged.
    Sent,
    /// It was withdrawn before it was sent, or failed after a withdrawal was requested.
    Withdrawn,
}

/// The error counters of a controller (ISO 11898-1, fault confinement).
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ErrorCounters {
    /// Transmit error counter (TEC).
    pub transmit: u8,
    /// Receive error counter (REC).
    pub receive: u8,
}

impl ErrorCounters {
    /// No errors lately.
    pub const NONE: Self = Self { transmit: 0, receive: 0 };
}
