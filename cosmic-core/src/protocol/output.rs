//! What a state machine of configuration, binding or broker hands to its owner.

use crate::can::Frame;

/// What the owner of a state machine is to do.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[must_use]
pub enum Output<Event> {
    /// Queue the frame for transmission; it is non real-time.
    Send(Frame),
    /// Withdraw this frame from the queue or the mailbox, if it is still there. If it is on the wire or
    /// was sent, nothing is to be done.
    Withdraw(Frame),
    /// Something that the node wants to know.
    Event(Event),
}
