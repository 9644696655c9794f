//! What crosses into the event-triggered half, and who gets what.

use super::HardAccess;
use crate::can::{ErrorCounters, Frame, Mailbox, Outcome, Priority};
use crate::network::hard::{BufferId, HrtBuffers};
use crate::time::Instant;

/// Something for the [`EventHalf`](super::EventHalf). Nothing else crosses into it from below. The host notes
/// the instant at which it happened, and hands both to [`on_input`](super::EventHalf::on_input).
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[must_use = "the event half must hear of it"]
pub enum Input {
    /// A frame has arrived; from [`receive`].
    Frame(Frame),
    /// A frame has left the soft or non real-time mailbox; from [`outcome`].
    Outcome(Mailbox, Outcome),
    /// Something has happened to an HRT message buffer; from [`outcome`] or the dispatcher.
    Notice(BufferId),
    /// So many frames, outcomes or notices were lost on the way, because a queue was full.
    Lost(u32),
    /// So many times a frame or more were lost in the controller, because its receive FIFO was full.
    Overrun(u32),
    /// The controller has left the bus after too many errors.
    BusOff,
    /// The error counters of the controller have changed.
    Errors(ErrorCounters),
}

/// A frame has arrived: gives it to the HRT message buffer that it belongs to, or returns what the event half
/// gets. Every host calls this for every received frame. The buffers are accessed for frames of hard real-time
/// priority only; O(1).
#[inline]
pub fn receive<const SLOTS: usize>(
    frame: &Frame,
    received_at: Instant,
    hard: &mut impl HardAccess<HrtBuffers<SLOTS>>,
) -> Option<Input> {
    let is_hard = frame.id.priority() == Priority::HARD;
    if SLOTS > 0 && is_hard && hard.with(|buffers| buffers.on_frame(frame, received_at)) {
        return None;
    }
    Some(Input::Frame(*frame))
}

/// A frame has left its mailbox: tells the HRT message buffers if it was theirs, and returns what the event half
/// gets. Every host calls this for every outcome. O(1).
#[inline]
pub fn outcome<const SLOTS: usize>(
    mailbox: Mailbox,
    outcome: Outcome,
    at: Instant,
    hard: &mut impl HardAccess<HrtBuffers<SLOTS>>,
) -> Option<Input> {
    if mailbox == Mailbox::Hard {
        if SLOTS == 0 {
            return None;
        }
        hard.with(|buffers| buffers.on_outcome(outcome, at)).map(Input::Notice)
    } else {
        Some(Input::Outcome(mailbox, outcome))
    }
}
