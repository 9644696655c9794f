//! What the middleware asks of a CAN controller, as a trait.

use super::{Command, ErrorCounters, Frame, Mailbox, Outcome};
use crate::time::Instant;

/// A controller in the hands of one owner, for a host in which nothing runs concurrently with it.
///
/// A host that gives each interrupt its own part of the controller, as RTIC firmware does with bxCAN, has no
/// single owner and does not use this trait; its parts keep the same contract.
///
/// # Calling order
/// * [`load`](Self::load) is called only for a mailbox whose last frame had its outcome. The middleware keeps
///   this order by itself, so a host just passes its commands to [`execute`](Self::execute).
/// * [`withdraw`](Self::withdraw) may come at any time after it, and waits for nothing.
/// * When the controller raises its interrupt, and at [`next_wakeup`](Self::next_wakeup):
///   [`outcome`](Self::outcome) until it returns `None`, [`receive`](Self::receive) until it returns `None`,
///   then [`status`](Self::status).
///
/// # What may be lost, and how it is told
/// * Each loaded frame has exactly one outcome, also after errors and bus-off: the controller repeats it
///   until it is sent or withdrawn.
/// * Received frames are lost when the host comes too late. [`Status::lost`] counts them; hand them to the event
///   half as [`Input::Overrun`](crate::event_half::Input::Overrun).
/// * Frames that are no extended data frames are not returned by `receive`. [`Status::foreign`] counts them.
/// * After an `Err` nothing is known of the transfer: the host resets the controller and starts anew.
///
/// # Work
/// Every call does a bounded number of accesses to the controller and never waits for the bus.
pub trait Controller {
    /// Why the controller could not be reached; for one in the same chip, [`core::convert::Infallible`].
    type Error;

    /// Puts a frame into a mailbox, which is empty, and requests its transmission.
    ///
    /// # Errors
    /// The controller could not be reached.
    fn load(&mut self, mailbox: Mailbox, frame: &Frame) -> Result<(), Self::Error>;

    /// Requests that the frame be withdrawn; an empty mailbox ignores it. A pending frame leaves the mailbox;
    /// one on the wire completes, or is dropped if it fails. The outcome tells which.
    ///
    /// # Errors
    /// The controller could not be reached.
    fn withdraw(&mut self, mailbox: Mailbox, now: Instant) -> Result<(), Self::Error>;

    /// The outcome of one mailbox whose frame is done, once; `None` if there is none by now.
    ///
    /// # Errors
    /// The controller could not be reached; the outcome comes at the next call.
    fn outcome(&mut self, now: Instant) -> Result<Option<(Mailbox, Outcome)>, Self::Error>;

    /// The next received frame, if there is one.
    ///
    /// # Errors
    /// The controller could not be reached; a frame may have been lost.
    fn receive(&mut self) -> Result<Option<Frame>, Self::Error>;

    /// The error counters, and what was lost so far.
    ///
    /// # Errors
    /// The controller could not be reached.
    fn status(&mut self) -> Result<Status, Self::Error>;

    /// When [`outcome`](Self::outcome) must be called though no interrupt comes; [`Instant::FAR_FUTURE`] if never.
    fn next_wakeup(&self) -> Instant {
        Instant::FAR_FUTURE
    }

    /// Carries out a command.
    ///
    /// # Errors
    /// The controller could not be reached.
    fn execute(&mut self, command: &Command, now: Instant) -> Result<(), Self::Error> {
        match command {
            Command::Load(mailbox, frame) => self.load(*mailbox, frame),
            Command::Withdraw(mailbox) => self.withdraw(*mailbox, now),
        }
    }
}

/// How a controller stands towards the bus, and what it did not hand over.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Status {
    /// The error counters.
    pub errors: ErrorCounters,
    /// It has left the bus after too many errors.
    pub is_bus_off: bool,
    /// Times that a received frame was lost because the one before it had not been fetched. Wraps.
    pub lost: u32,
    /// Frames that were no extended data frames. Wraps.
    pub foreign: u32,
}
